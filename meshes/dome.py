"""Domes of demos and tests: spherical caps; the rim is the edge group "boundary". Units: m.

gmsh's .geo language has no conformal map of the sphere, which `meshes.spherical_cap` uses, so that
a .geo file would have other cells.
"""

from mpi4py import MPI

from crms_fenicsx import meshes

RADIUS, HEIGHT = 20.0, 10.0  # of the rim, and of the top above it
STADIUM_RADIUS, STADIUM_HEIGHT = 100.0, 28.0


def dome(comm: MPI.Intracomm, size: float) -> meshes.MembraneMesh:
    """The dome of demos/cable_net.py, with cells of a size."""
    return meshes.spherical_cap(comm, RADIUS, HEIGHT, size)


def stadium(comm: MPI.Intracomm, size: float) -> meshes.MembraneMesh:
    """The stadium roof of demos/air_dome.py, with cells of a size."""
    return meshes.spherical_cap(comm, STADIUM_RADIUS, STADIUM_HEIGHT, size)
