"""The paper's laws against the default ones, each alone and all at once, on its models 1 to 3.

    ./run python benchmarks/step_laws.py [1] [2] [mesh] [3] [small] [--quick]

Tables in Markdown, as on the page "The paper and this package":

1
    One element: tension after the ends have moved 12 cm normal to it.
2
    The inflated square of 17 cells a side: its height, then tension and height of the cable whose
    ends have been pulled down by 15 cm.
mesh
    The same cable, pulled down by 5 cm only, over finer and finer meshes, under the three laws of
    the pressure. The paper loads the corners of folded elements and no fold point, the others both.
3
    The cable dragged sideways over the fabric by 5 and by 10 cm, with friction.
small
    Model 2 with loads a thousand times and strains a hundred times smaller. Incremental strain and
    (2.2-2) tend to logarithmic laws, which differ from the total ones by the order of the strain;
    here all laws but the corner forces tend to one answer.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, Friction, IsotropicMembrane, OrthotropicMembrane, Scene, Solver
from crms_fenicsx import meshes as shapes

SHEET: dict[str, Any] = {"E": 300.0, "nu": 0.25, "thickness": 0.08}
FABRIC: dict[str, Any] = {
    "E1": 1394.0, "E2": 140.0, "G12": 12.0, "nu21": 0.065, "thickness": 1.0,
    "warp": (0.0, 1.0, 0.0),
}  # fmt: skip
PENALTY = 5.0
"""The paper's coefficient mu = nu, whose value is lost (kgf cm)."""

ALL = {"strain": "step", "pressure": "step", "cable": "step", "friction": "step"}
LAWS: dict[str, dict[str, Any]] = {
    "default": {"wrinkling": True},
    "without wrinkling": {},
    "strain (2.3)": {"strain": "step"},
    "pressure (2.4)": {"pressure": "step"},
    "penalty (2.5)": {"penalty": PENALTY},
    "cable (2.2)": {"cable": "step"},
    "friction (3.2, 3.3)": {"friction": "step"},
    "all of them": {**ALL, "penalty": PENALTY},
}


def scene_of(mesh: shapes.MembraneMesh, material: type, data: dict[str, Any], laws: Any) -> Scene:
    """A scene with some of the paper's laws."""
    return Scene(
        mesh,
        material(**data, wrinkling=laws.get("wrinkling", False)),
        strain=laws.get("strain", "total"),
        pressure=laws.get("pressure", "total"),
        literal_penalty=laws.get("penalty"),
    )


def model_1(steps: int, **laws: Any) -> tuple[float, ...]:
    """Tension of the cable over one element."""
    corners = [(0.0, 0.0), (25.0, 60.0), (70.0, 0.0)]
    mesh = shapes.from_arrays(
        MPI.COMM_WORLD, corners, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]}
    )
    scene = scene_of(mesh, IsotropicMembrane, SHEET, laws)
    scene.fix("corners")
    path = [(-20.0, 30.0, 0.0), (90.0, 24.0, 0.0)]
    cable = scene.lay_cable(Cable(32000.0, law=laws.get("cable", "total")), path, hold="sleeve")
    Solver(scene).advance(move={cable: (0.0, 0.0, 12.0)}, steps=steps)
    return (cable.tension,)


def model_2(
    steps: int, cells: int = 17, drop: float = 15.0, scale: float = 1.0, **laws: Any
) -> tuple[float, ...]:
    """Height of the inflated square; tension and middle height of the tightened cable."""
    mesh = shapes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / cells, structured=True)
    scene = scene_of(mesh, IsotropicMembrane, SHEET, laws)
    scene.fix("boundary")
    solver = Solver(scene)
    solver.advance(pressure=0.01 * scale**3, steps=steps)
    w = scene.comm.allreduce(float(scene.positions()[:, 2].max()), op=MPI.MAX)
    rope = Cable(32000.0, law=laws.get("cable", "total"))
    ends = [(-50.0, 50.0, 0.0), (150.0, 50.0, 0.0)]
    cable = scene.lay_cable(rope, ends, measured_on="facets")  # as the step-wise law has it
    solver.advance(move={cable: (0.0, 0.0, -drop * scale)}, steps=steps)
    x, _, z = cable.line[1:-1].T
    return w, cable.tension, float(np.interp(50.0, x, z))


def model_3(
    steps: int, size: float = 5.0, structured: bool = False, **laws: Any
) -> tuple[float, ...]:
    """Tensions of the cable dragged by 5 and by 10 cm, and how far its middle has followed."""
    mesh = shapes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, size, structured=structured)
    scene = scene_of(mesh, OrthotropicMembrane, FABRIC, laws)
    scene.fix("front")
    scene.fix("back")
    friction = Friction(0.7, law=laws.get("friction", "coulomb"))
    rope = Cable(47638.0, law=laws.get("cable", "total"), friction=friction)
    cable = scene.lay_cable(rope, [(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)])
    solver = Solver(scene)
    solver.advance(move={cable: (0.0, 0.0, -10.0)}, steps=5)
    tensions = []
    for _ in range(2):
        solver.advance(move={cable: (0.0, 5.0, 0.0)}, steps=steps // 2)
        tensions.append(cable.tension)
    x, y, _ = cable.line.T
    return *tensions, float(np.interp(50.0, x, y)) - 50.0, scene.dissipated


def table(head: str, rows: Sequence[tuple[str, Callable[[], tuple[float, ...]]]]) -> None:
    """Print a table in Markdown, row by row as it comes."""
    first = MPI.COMM_WORLD.rank == 0
    if first:
        print(f"\n| {head} |\n" + "|---" * (head.count("|") + 1) + "|")
    for name, run in rows:
        values = run()
        if first:
            print(f"| {name} | {' | '.join(f'{value:.6g}' for value in values)} |", flush=True)


def main(asked: list[str]) -> None:
    """Print the tables asked for."""
    quick = "--quick" in asked
    names = [name for name in asked if name != "--quick"] or ["1", "2", "mesh", "3", "small"]
    steps = (5, 20) if quick else (5, 20, 80)

    def of_laws(model: Callable[..., tuple[float, ...]], without: tuple[str, ...], **fixed: Any):
        return [
            (f"{law} | {n}", lambda n=n, own=own: model(n, **fixed, **own))
            for law, own in LAWS.items()
            if not law.startswith(without)
            for n in steps
        ]

    if "1" in names:
        table("law | steps | T", of_laws(model_1, ("pressure", "friction")))
    if "2" in names:
        table("law | steps | w | T | z", of_laws(model_2, ("friction",)))
    if "mesh" in names:
        table("pressure | cells | w | T | z", [
            (f"{law} | {n}", lambda n=n, law=law: model_2(20, n, 5.0, pressure=law))
            for n in ((5, 9) if quick else (5, 9, 17, 33, 65))
            for law in ("total", "lagged", "step")
        ])  # fmt: skip
    if "3" in names:
        kinds = {"gmsh": False, "structured": True}
        for kind, structured in kinds.items():
            fixed: dict[str, Any] = {"structured": structured, "size": 10.0 if quick else 5.0}
            table(
                f"{kind}, law | steps | T at 5 cm | T at 10 cm | y | dissipated",
                of_laws(model_3, ("pressure",), **fixed),
            )
    if "small" in names:
        table("law | steps | w | T | z", of_laws(model_2, ("friction", "penalty"), scale=0.1))


if __name__ == "__main__":
    main(sys.argv[1:])
