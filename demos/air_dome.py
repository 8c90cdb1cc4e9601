"""Stadium roof, in parallel
=========================

The air-supported roof of a stadium with a net of sliding cables, on any number of ranks.

A spherical cap of 200 m span and 28 m rise of glass-fibre fabric, held down by two families of 14
steel cables, 8.5 m apart, that cross at right angles: a roof of the size of the Tokyo Dome's. The
cables run along great circles, which are lines of the mesh, just taut, and are anchored at their
ends only; they slide without friction over the fabric, with their lines, and over each other. The
roof is inflated, and the pressure is then raised as for a storm. Units: m, kN.

::

    ./run python demos/air_dome.py [UNKNOWNS] [--resume]
    ./run mpirun -n 2 python demos/air_dome.py 100000

with the approximate number of unknowns of the fabric without its lines, 10 000 by default.
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes, nets
from crms_fenicsx.results.output import draw, join_pictures

RESULTS = "results/air_dome"
RADIUS, HEIGHT = 100.0, 28.0
SPACING, CABLES = 8.5, 14
CALM, STORM = 0.3, 0.5  # kPa

# %%
# The roof
# --------
# The script is the same for any number of processes: ``mpirun`` distributes the mesh over them.
unknowns = float(next((word for word in sys.argv[1:] if word[:1].isdigit()), 1e4))
area = np.pi * (RADIUS**2 + HEIGHT**2)
size = np.sqrt(2 / np.sqrt(3) * area * 3 / unknowns)  # equilateral triangles
lines = {
    f"{family}{k + 1}": nets.great_circle(RADIUS, HEIGHT, angle, SPACING * (k - (CABLES - 1) / 2))
    for family, angle in (("A", np.pi / 4), ("B", -np.pi / 4))
    for k in range(CABLES)
}
mesh = meshes.spherical_cap(MPI.COMM_WORLD, RADIUS, HEIGHT, size, lines=lines)
scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
scene.fix("boundary")
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)
for name in lines:
    scene.lay_cable(Cable(EA=600e3), along=name)

# %%
# Calm and storm
# --------------
LOOK = {
    "dpi": 110,
    "colour": "stress",
    "limits": (0.0, 12.0),
    "line_limits": (0.0, 600.0),
    "unit": "m",
    "force": "kN",
    "view": (-110.0, 28.0),
    "width": 7.5,
}
tensions = {}
for name, pressure in (("calm", CALM), ("storm", STORM)):
    solver.advance(pressure=pressure)
    draw(solver, f"{RESULTS}/{name}.png", title=f"{name.title()}: {pressure} kPa inside", **LOOK)
    tensions[name] = np.array([cable.tension for cable in scene.cables])

# %%
# Balance
# -------
# The supports and the ends of the cables must balance the lift of the air.
boundary = solver.reactions("boundary")
ends = sum(force[2] for force in boundary.parts.values())
lift = STORM * np.pi * RADIUS**2
if scene.comm.rank == 0:
    join_pictures(
        f"{RESULTS}/both.png", [f"{RESULTS}/calm.png", f"{RESULTS}/storm.png"], upright=True
    )
    for name, forces in tensions.items():
        print(f"{name:6} tensions from {forces.min():.0f} to {forces.max():.0f} kN")
    print(f"the air lifts the roof with {lift / 1e3:.2f} MN; the cables hold {-ends / 1e3:.2f} MN")
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
