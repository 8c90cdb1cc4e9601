"""Load steps."""
