"""Edge details of a sail, and the forces at its corners. See docs/benchmarks/edges.md.

A hypar of 6 x 6 m, two corners 2 m up, under snow: its edge cables slide, with friction or without,
slide beside belts, or are bonded to the fabric.

    ./run python benchmarks/edges.py [size ...]
"""

from __future__ import annotations

import sys

from mpi4py import MPI

from crms_fenicsx import Cable, Friction, OrthotropicMembrane, Solver, meshes
from crms_fenicsx.design.form_finding import FormCable, find_form

SIDES = ("front", "right", "back", "left")
CORNERS = ("front left", "front right", "back right", "back left")
EDGES = ("slides", "friction", "belts", "bonded")


def sail(size: float, edge: str) -> Solver:
    """The sail under snow."""
    warp = (1.0, 1.0, 0.0)
    found = find_form(
        meshes.rectangle(MPI.COMM_WORLD, 6.0, 6.0, size),
        stress=3.0,
        fixed=CORNERS,
        lifted=dict.fromkeys(CORNERS[::2], (0.0, 0.0, 2.0)),
        cables=[
            FormCable(side, tension=30.0, hold="bonded" if edge == "bonded" else "pocket")
            for side in SIDES
        ],
        warp=warp,
    )
    fabric = OrthotropicMembrane(600.0, 600.0, 30.0, 0.4, thickness=1.0, warp=warp)
    friction = Friction(0.0, along=0.3) if edge == "friction" else 0.0
    belts = Cable(EA=1500.0) if edge == "belts" else None
    scene = found.scene(fabric, Cable(EA=23.2e3, friction=friction), belts=belts)
    solver = Solver(scene)
    solver.advance()
    scene.put_load((0.0, 0.0, -0.6), name="snow", per="plan")
    solver.advance(load={"snow": 1.0})
    return solver


def main() -> None:
    """Print a row for each edge and size."""
    heads = ("edge", "size", "warp", "weft", "edge cable", "belts", "down")
    print("{:10} {:>5} {:>7} {:>7} {:>17} {:>6} {:>7}".format(*heads))
    for edge in EDGES:
        for size in [float(word) for word in sys.argv[1:]] or [0.4, 0.2, 0.1]:
            solver = sail(size, edge)
            results, scene = solver.results(), solver.scene
            largest = [
                scene.comm.allreduce(float(results.values(way).max(initial=0.0)), op=MPI.MAX)
                for way in ("warp", "weft")
            ]
            cable = scene.cable("front").tensions
            belt = scene.cable("belt front").tensions.max() if edge == "belts" else 0.0
            down = results.at([(3.0, 3.0, 1.0)], on="stress-free").displacement[0, 2]
            if scene.comm.rank == 0:
                span = f"{cable.min():.2f} to {cable.max():.2f}"
                print(
                    f"{edge:10} {size:5g} {largest[0]:7.2f} {largest[1]:7.2f} {span:>17} "
                    f"{belt:6.2f} {down:7.4f}"
                )


if __name__ == "__main__":
    main()
