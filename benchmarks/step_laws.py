"""The paper's step-wise laws against the total ones on model 2, by number of steps.

Prints a table: height of the inflated square, then tension and height of the cable after its ends
have been pulled down, for each law alone and for all of them. The stepwise constant pressure tends
to the follower pressure. Incremental strain and (2.2-2) tend to logarithmic laws, which differ from
the total ones by the order of the strain. A second table thus has loads a thousand times smaller
and strains a hundred times smaller: there all laws tend to one answer.

    ./run python benchmarks/step_laws.py
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

LAWS: dict[str, dict[str, str]] = {
    "total (default)": {},
    "step pressure (2.4)": {"pressure": "step"},
    "step strain (2.3)": {"strain": "step"},
    "step cable (2.2-2)": {"cable": "step"},
    "all of them": {"pressure": "step", "strain": "step", "cable": "step"},
}


def model2(steps: int, scale: float, cable: str = "total", **laws: str) -> tuple[float, ...]:
    """Height of the inflated square; tension and middle height of the tightened cable."""
    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / 17, structured=True)
    material = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
    scene = Scene(mesh, material, **laws)  # type: ignore[arg-type]
    scene.fix("boundary")
    solver = Solver(scene)
    solver.advance(pressure=0.01 * scale**3, steps=steps)
    w = scene.comm.allreduce(float(scene.positions()[:, 2].max()), op=MPI.MAX)
    ends = [(-50.0, 50.0, 0.0), (150.0, 50.0, 0.0)]
    rope = Cable(EA=32000.0, law=cable)  # type: ignore[arg-type]
    laid = scene.lay_cable(rope, ends, measured_on="facets")  # as the step-wise law has it
    solver.advance(move={laid: (0.0, 0.0, -15.0 * scale)}, steps=steps)
    x = laid.positions[1:-1]
    return w, laid.tension, float(np.interp(50.0, x[:, 0], x[:, 2]))


def main() -> None:
    """Print the table."""
    for scale in (1.0, 0.1):
        if MPI.COMM_WORLD.rank == 0:
            print(f"\npressure {0.01 * scale**3:g} kgf/cm2, cable ends down by {15 * scale:g} cm")
            print(f"{'law':22}{'steps':>6}{'w':>12}{'T':>14}{'z of cable':>14}")
        for name, laws in LAWS.items():
            for steps in (5, 10, 20, 40):
                w, T, z = model2(steps, scale, **laws)
                if MPI.COMM_WORLD.rank == 0:
                    print(f"{name:22}{steps:6}{w:12.5f}{T:14.5f}{z:14.6f}", flush=True)


if __name__ == "__main__":
    main()
