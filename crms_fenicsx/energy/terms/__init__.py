"""Terms of the total potential energy."""
