"""The parts of a scene as values: membranes, cables, bars, friction, loads on the membrane.

Knows their properties and units. Must not know unknowns, energies or load steps.
"""
