"""The analysis: a scene, its equilibrium under each load step, and the verification of it.

Knows the loops of a load step. Must not know files or pictures.
"""
