"""A stadium's air-supported roof with a net of sliding cables, of any size, on any number of ranks.

A spherical cap of 200 m span and 28 m rise of glass-fibre fabric, held down by two families of 14
steel cables 8.5 m apart that cross at right angles: a roof of the size of the Tokyo Dome's. The
cables are laid along great circles, just taut, and held at their ends only; over the fabric and
over each other they slide without friction. The roof is inflated, and then the pressure raised as
for a storm. Units: m, kN.

    ./run python demos/air_dome.py [UNKNOWNS]
    ./run mpirun -n 2 python demos/air_dome.py 100000

with the approximate number of unknowns of the fabric, 10 000 by default. It is the mesh that grows
with it; what the cables take grows with its square root.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

RESULTS = "results/air_dome"
RADIUS, HEIGHT = 100.0, 28.0
SPHERE = (RADIUS**2 + HEIGHT**2) / (2 * HEIGHT)
SPACING, CABLES = 8.5, 14
CALM, STORM = 0.3, 0.5  # kPa


def great_circle(angle, offset):
    """Points in plan of the shortest way over the dome between two points of its rim."""
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    half = np.sqrt(RADIUS**2 - offset**2)
    ends = [offset * across + side * half * along for side in (-1, 1)]
    start, end = (np.append(point, SPHERE - HEIGHT) / SPHERE for point in ends)
    turn = np.arccos(start @ end)
    s = np.linspace(0.0, turn, 33)[:, None]
    return SPHERE * (np.sin(turn - s) * start + np.sin(s) * end)[:, :2] / np.sin(turn)


unknowns = float(sys.argv[1]) if len(sys.argv) > 1 else 1e4
area = np.pi * (RADIUS**2 + HEIGHT**2)
size = np.sqrt(2 / np.sqrt(3) * area * 3 / unknowns)  # of equilateral triangles
mesh = meshes.spherical_cap(MPI.COMM_WORLD, radius=RADIUS, height=HEIGHT, size=size)
scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
scene.fix("boundary")
solver = Solver(scene, results=RESULTS)
for angle in np.radians([45.0, -45.0]):
    for offset in SPACING * (np.arange(CABLES) - (CABLES - 1) / 2):
        scene.lay_cable(Cable(EA=600e3), path=great_circle(angle, offset))

solver.advance(pressure=CALM)
solver.draw(f"{RESULTS}/calm.png", title="Inflated: 0.3 kPa", colour="stress", unit="m", force="kN")
calm = np.array([cable.tension for cable in scene.cables])
solver.advance(pressure=STORM)
storm = np.array([cable.tension for cable in scene.cables])
solver.draw(f"{RESULTS}/storm.png", title="Storm: 0.5 kPa", colour="stress", unit="m", force="kN")
if scene.comm.rank == 0:
    print(f"tensions {calm.min():.0f} to {calm.max():.0f} kN, in the storm {storm.min():.0f} to "
          f"{storm.max():.0f} kN; energy {scene.energy:.0f} kNm")  # fmt: skip
