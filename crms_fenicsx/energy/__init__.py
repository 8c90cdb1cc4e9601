"""The total potential energy: its terms, and its minimisation.

Knows tables of elements and a vector of unknowns. Must not know how the path of a cable is found.
"""
