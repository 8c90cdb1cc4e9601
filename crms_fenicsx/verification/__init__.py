"""Checks of an equilibrium by means of their own."""
