"""Cables that lie on the membrane and slide over it."""
