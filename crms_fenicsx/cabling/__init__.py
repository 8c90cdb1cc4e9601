"""Cables on the membrane: their points in its cells, contact, friction, and paths that change.

Knows the membrane's mesh and one state of it. Must not know load steps.
"""
