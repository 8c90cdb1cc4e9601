"""What everything stands on: errors, meshes, geometry on surfaces of triangles, unknowns.

Knows MPI, DOLFINx and PETSc. Must not know what a membrane, a cable or a load is.
"""
