"""Design of a roof: its form, cable nets, loads by code, cutting patterns, studies.

Knows everything below it, and uses the solver as scripts do. Its packages do not know each other.
"""
