"""Cuts of surfaces along lines."""
