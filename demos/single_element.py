"""Single element
==============

One folded element and one cable (the paper's model 1).

A cable lies across a single triangle with held corners. Its ends are moved normal to the triangle,
once up and once down, so that the cable tightens and folds the triangle. A sleeve keeps the cable
from lifting off when it moves up. The only unknowns are the six coordinates of the two sliding
nodes. Units: kgf, cm.

::

    ./run python demos/single_element.py [--resume]
"""

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.output import Line, draw, draw_path

CORNERS = [(0.0, 0.0), (25.0, 60.0), (70.0, 0.0)]
PATH = [(-20.0, 30.0, 0.0), (90.0, 24.0, 0.0)]  # both ends are anchors beside the triangle
STEPS = 6
RESULTS = "results/single_element"

# %%
# Up and down
# -----------
# The mesh is given by arrays: three points and one cell.
tracks, cables, tensions = [], [], []
for name, lift in (("up", 12.0), ("down", -12.0)):
    mesh = meshes.from_arrays(
        MPI.COMM_WORLD, CORNERS, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]}
    )
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("corners")
    cable = scene.lay_cable(Cable(EA=32000.0), path=PATH, hold="sleeve")
    solver = Solver(scene, results=f"{RESULTS}/{name}", resume="--resume" in sys.argv)

    positions = [cable.line]
    for _ in range(STEPS):
        solver.advance(move={cable: (0.0, 0.0, lift / STEPS)})
        positions.append(cable.line)
    nodes = np.array(positions)[:, 1:3]
    tracks += [Line(nodes[:, k], name=f"node {k + 2}, {name}") for k in (0, 1)]
    cables.append(Line(positions[-1]))
    tensions.append(cable.tension)
    draw(
        solver, f"{RESULTS}/{name}.png", title=f"Cable ends moved {name} by 12 cm",
        colour="stress", ghost=True, view=(-60.0, 20.0), unit="cm", force="kgf",
    )  # fmt: skip

# %%
# The sliding nodes
# -----------------
# As the cable tightens, the nodes slide along the sides of the triangle.
if MPI.COMM_WORLD.rank == 0:
    draw_path(
        f"{RESULTS}/sliding_nodes.png", tracks, lines=cables,
        points=np.column_stack([CORNERS, np.zeros(3)]), triangles=[(0, 1, 2)],
        view=(-60.0, 20.0), closeups={"node 2 in plan": [0, 2], "node 3 in plan": [1, 3]},
        title="The sliding nodes, step by step", unit="cm", width=9.0,
    )  # fmt: skip
    for name, tension, node_2, node_3 in zip(
        ("up", "down"), tensions, tracks[::2], tracks[1::2], strict=True
    ):
        print(f"ends moved {name} by 12 cm: tension {tension:.3f} kgf")
        print(f"  node 2 at {np.round(node_2.points[-1], 4)}, node 3 at", end=" ")
        print(np.round(node_3.points[-1], 4))
    print(f"files: {RESULTS}")
