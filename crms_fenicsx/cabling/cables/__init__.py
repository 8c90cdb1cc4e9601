"""Cables that lie on the membrane and cross its cells anywhere."""
