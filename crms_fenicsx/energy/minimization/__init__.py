"""Minimisation of the potential energy."""
