"""Sliding cable
=============

A cable that slides sideways to its equilibrium.

The cable is laid over a flat square in an arc, up to 15 cm beside the straight line between its
ends, with the length of that line. It slides to the straight line at once, across mesh edges. Then
the square is inflated in 5 steps, bulges beside the cable, and pushes the cable towards the nearer
side. The cable's path on the fabric (the material curve) differs from its path in space, because
the fabric moves too. Units: kgf, cm.

::

    ./run python demos/sliding_cable.py [--resume]
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.output import Line, draw, draw_paths, join_pictures

RESULTS = "results/sliding_cable"

# %%
# A cable out of place
# --------------------
mesh = meshes.rectangle(MPI.COMM_WORLD, width=100.0, depth=100.0, size=3.0)
scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
scene.fix("boundary")
x = np.linspace(0.0, 100.0, 21)
arc = np.column_stack([x, 30.0 + 15.0 * np.sin(np.pi * x / 100.0)])
cable = scene.lay_cable(Cable(EA=32000.0), path=arc, L0=100.0, name="cable")
start = Line(cable.line, name="as laid")
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)


# %%
# Inflation
# ---------
# In each load step the solver minimises the energy, straightens the cable's path on the resulting
# shape, and minimises again if the path has changed.
def middle(points):
    """Point at which a curve passes x = 50."""
    points = points[np.isfinite(points[:, 0])]  # anchors are not on the fabric
    return np.array([np.interp(50.0, points[:, 0], points[:, i]) for i in range(3)])


ways = []
for pressure in np.linspace(0.0, 0.01, 6):
    step = solver.advance(pressure=pressure)
    ways.append((middle(cable.line), middle(cable.reference_positions)))
    if scene.comm.rank == 0:
        took = f"{step.outcome.solves} solves, {step.outcome.evaluations} evaluations"
        print(f"pressure {pressure:.3f}: tension {cable.tension:7.3f} kgf,", end=" ")
        print("middle at y = {:.4f}, z = {:.4f} cm".format(*ways[-1][0][1:]), end=" ")
        print(f"({took})")

# %%
# Pictures
# --------
# ``cable.line`` is the cable in space, ``cable.reference_positions`` its positions on the
# stress-free fabric.
fabric = cable.reference_positions[np.isfinite(cable.reference_positions[:, 0])]
draw_paths(
    scene,
    f"{RESULTS}/paths.png",
    [start, Line(cable.line, name="inflated"), Line(fabric, name="inflated: on the fabric")],
    [
        Line([place for place, _ in ways], name="its middle, step by step"),
        Line([place for _, place in ways], name="its middle on the fabric"),
    ],
    title="Paths of the cable, in plan",
    closeups={"the middle, inflating": [0, 1]}, unit="cm", width=7.0, dpi=100,
)  # fmt: skip
draw(
    solver, f"{RESULTS}/inflated.png", colour="height", view=(-60.0, 40.0), unit="cm",
    force="kgf", title="Inflated: 0.01 kgf/cm²", width=6.8, dpi=100,
)  # fmt: skip
if scene.comm.rank == 0:
    join_pictures(f"{RESULTS}/both.png", [f"{RESULTS}/paths.png", f"{RESULTS}/inflated.png"])
if scene.comm.rank == 0:
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
