"""The current state as arrays that are looked at: surface, lines and points with their data."""
