"""Results of an equilibrium: values, arrays to display, files, pictures, reports, checkpoints.

Knows an analysed scene, which it reads only. Must not know how the roof was designed.
"""
