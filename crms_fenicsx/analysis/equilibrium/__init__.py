"""The equilibrium of a load step."""
