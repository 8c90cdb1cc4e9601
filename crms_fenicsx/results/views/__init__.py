"""The current state as arrays for display: surface, lines and points with their data."""
