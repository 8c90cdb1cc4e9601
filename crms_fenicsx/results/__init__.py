"""Results of an equilibrium."""
