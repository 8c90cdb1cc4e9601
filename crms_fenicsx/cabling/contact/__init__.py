"""Contact of cables with the membrane and with each other."""
