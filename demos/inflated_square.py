"""Inflated square
===============

A cable tightened over an inflated square membrane (the paper's model 2).

The square is inflated in 5 steps. A cable is then laid across its middle, anchored 80 cm beside the
square (assumed, as the paper's drawing is lost), and both ends are pulled down by 15 cm in 5 steps.
At first the cable touches only the top of the membrane, at the end its whole width. No mesh line
lies under the cable: it folds the cells that it crosses. Units: kgf, cm.

::

    ./run python demos/inflated_square.py [--resume]
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.output import draw, draw_history, join_pictures

RESULTS = "results/inflated_square"
LOOK = {
    "colour": "height",
    "limits": (0.0, 10.2),
    "view": (-50.0, 25.0),
    "box": ((-83.0, -3.0, -16.0), (183.0, 103.0, 12.0)),
    "unit": "cm",
    "force": "kgf",
    "width": 5.5,
    "dpi": 165,
}

# %%
# The membrane
# ------------
# A mesh, a material and supports make a scene. A solver advances the scene from one equilibrium to
# the next, and with ``results`` writes each one for ParaView.
mesh = meshes.rectangle(MPI.COMM_WORLD, width=100.0, depth=100.0, size=4.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
scene.fix("boundary")
solver = Solver(scene, results=RESULTS, resume="--resume" in sys.argv)

# %%
# Inflation
# ---------
# The sheet starts flat and without stress, so the first load step is the hardest.
solver.advance(pressure=0.01, steps=5)
draw(solver, f"{RESULTS}/inflated.png", title="Inflated: 0.01 kgf/cm²", **LOOK)
top, inflated = scene.comm.allreduce(scene.positions()[:, 2].max(), MPI.MAX), scene.energy

# %%
# The cable
# ---------
# Both ends lie beside the membrane and above its clamped boundary, so they are anchors. The
# unstressed length makes the cable just taut over the inflated square.
cable = scene.lay_cable(Cable(EA=32000.0), path=[(-80.0, 50.0, 0.0), (180.0, 50.0, 0.0)])
solver.advance(move={cable: (0.0, 0.0, -15.0)}, steps=5)
draw(solver, f"{RESULTS}/tightened.png", title="Tightened: cable ends 15 cm lower", **LOOK)
draw_history(solver.history, f"{RESULTS}/history.png", unit="cm", force="kgf")
middle = np.interp(50.0, cable.line[:, 0], cable.line[:, 2])

# %%
# The result
# ----------
# With several processes, each holds a part of the membrane, and the first one prints.
if scene.comm.rank == 0:
    join_pictures(f"{RESULTS}/both.png", [f"{RESULTS}/inflated.png", f"{RESULTS}/tightened.png"])
    print(f"inflated   highest vertex   {top:8.3f} cm")
    print(f"           energy           {inflated:8.2f} kgf cm")
    print(f"tightened  cable's middle   {middle:8.3f} cm")
    print(f"           cable's tension  {cable.tension:8.2f} kgf")
    print(f"           energy           {scene.energy:8.2f} kgf cm")
    print(f"files: {RESULTS}")

# sphinx_gallery_thumbnail_number = 2
