"""Paths of cables over the cells of the membrane, and how they change."""
