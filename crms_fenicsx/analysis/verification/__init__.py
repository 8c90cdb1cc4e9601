"""Independent checks of an equilibrium."""
