"""Unknowns: their layout on the ranks, and the stiffness matrix."""
