"""Friction between cables and the membrane, sideways and along."""
