"""One folded element and one cable (the paper's model 1).

A cable lies across a single triangle whose corners are held. Its ends are moved normal to the
triangle, once up and once down, so that it tightens and folds the triangle. The only unknowns are
the six coordinates of the two sliding nodes. Units: kgf, cm.

    ./run python demos/single_element.py
"""

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.output import Line, draw_path

CORNERS = [(0.0, 0.0), (25.0, 60.0), (70.0, 0.0)]
PATH = [(-20.0, 30.0, 0.0), (90.0, 24.0, 0.0)]  # both ends are anchors beside the triangle
STEPS = 6
RESULTS = "results/single_element"

tracks = []
for name, lift in (("up", 12.0), ("down", -12.0)):
    mesh = meshes.from_arrays(
        MPI.COMM_WORLD, CORNERS, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]}
    )
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("corners")
    cable = scene.lay_cable(Cable(EA=32000.0), path=PATH)
    solver = Solver(scene, results=f"{RESULTS}/{name}")

    nodes = [cable.positions[1:3].copy()]
    for _ in range(STEPS):
        solver.advance(move={cable: (0.0, 0.0, lift / STEPS)})
        nodes.append(cable.positions[1:3].copy())
    track = np.array(nodes)
    tracks += [Line(track[:, k], name=f"node {k + 2}, {name}") for k in (0, 1)]
    solver.draw(f"{RESULTS}/{name}.png", colour="stress", title=f"Ends moved {name} by 12 cm")
    if scene.comm.rank == 0:
        print(f"ends moved {name} by 12 cm: tension {cable.tension:.3f} kgf, sliding nodes at")
        print(np.array2string(track[-1], precision=4))

    # The element is flat at the start, so that both ways are mirror images.
    np.testing.assert_allclose(tracks[0].points * (1, 1, np.sign(lift)), tracks[-2].points)

if MPI.COMM_WORLD.rank == 0:
    corners = np.column_stack([CORNERS, np.zeros(3)])
    draw_path(
        f"{RESULTS}/sliding_nodes.png",
        tracks[2:],
        points=corners,
        triangles=np.array([(0, 1, 2)]),
        unit="cm",
        title="Sliding nodes in plan, step by step",
        zoom=True,
    )
