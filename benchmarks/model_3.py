"""The paper's model 3 with varied numerical parameters: steps, slip tolerance, mesh, law.

A cable is pressed 10 cm into an orthotropic sheet and dragged 10 cm sideways over it, mu = 0.7, as
in demos/friction_experiment.py. Tables of the tension, the position y of the cable's middle and the
dissipated energy at the end, and of the work:

steps
    5, 10, 20 and 40 load steps in each direction.
tolerance
    Elastic slip over four decades: a plateau shows where it does not matter.
meshes
    Successively finer ones; one with lines along the cable.
laws
    With static friction, and with the paper's friction element on mesh lines.

    ./run python benchmarks/model_3.py [steps] [tolerance] [meshes] [laws]
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    Friction,
    FrictionWarning,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)

COMM = MPI.COMM_WORLD
FABRIC = OrthotropicMembrane(
    E1=1394.0, E2=140.0, G12=12.0, nu21=0.065, thickness=1.0, warp=(0.0, 1.0, 0.0)
)


def say(*texts: object) -> None:
    """Print on one rank, at once."""
    if COMM.rank == 0:
        print(*texts, flush=True)


def row(
    name: str, friction: Friction, size: float = 5.0, steps: int = 5, structured: bool = False
) -> None:
    """Run it, and print what came out."""
    scene = Scene(meshes.rectangle(COMM, 100.0, 100.0, size, structured=structured), FABRIC)
    scene.fix("front")
    scene.fix("back")
    cable = scene.lay_cable(
        Cable(EA=47638.0, friction=friction), [(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)]
    )
    solver, began = Solver(scene), time.perf_counter()
    solver.advance(move={cable: (0.0, 0.0, -10.0)}, steps=steps)
    solver.advance(move={cable: (0.0, 10.0, 0.0)}, steps=steps)
    x = cable.line
    work = {key: int(np.nansum(solver.history[key])) for key in ("passes", "evaluations", "flips")}
    least = float(np.diff(np.nan_to_num(solver.history["dissipated"])).min())
    say(
        f"{name:>24} {cable.tension:9.3f} {np.interp(50.0, x[:, 0], x[:, 1]):9.4f} "
        f"{scene.dissipated:9.2f} {least:9.2g} {work['passes']:7d} {work['evaluations']:12d} "
        f"{work['flips']:6d} {sum(s.halvings for s in solver.steps):8d} "
        f"{time.perf_counter() - began:8.1f}"
    )


def main() -> None:
    """Print the tables asked for."""
    tables = ("steps", "tolerance", "meshes", "laws")
    parser = argparse.ArgumentParser(description="Model 3: see the head of this file.")
    parser.add_argument("tables", nargs="*", help=f"which, of {', '.join(tables)}; default all")
    wanted = parser.parse_args().tables or tables
    if set(wanted) - set(tables):
        parser.error(f"there are no such tables: {', '.join(set(wanted) - set(tables))}")
    warnings.simplefilter("ignore", FrictionWarning)
    for table in wanted:
        say(f"\n{table:>24}   tension  middle y      heat  least step   passes  evaluations  "
            "flips halvings  seconds")  # fmt: skip
        if table == "steps":
            for steps in (5, 10, 20, 40):
                row(f"{steps}", Friction(0.7), steps=steps)
        elif table == "tolerance":
            for tolerance in (1e-5, 1e-4, 1e-3, 1e-2, 1e-1):
                row(f"{tolerance:g}", Friction(0.7, tolerance=tolerance), steps=10)
        elif table == "meshes":
            for size in (10.0, 7.0, 5.0, 3.5, 2.5):
                row(f"{size:g} cm", Friction(0.7), size=size)
            row("5 cm, on mesh lines", Friction(0.7), structured=True)
        else:
            row("0.7, 1.0 at rest", Friction(0.7, static=1.0))
            for steps in (5, 10, 20):
                row(f"element, {steps} steps", Friction(0.7, law="step"), 5.0, steps, True)


if __name__ == "__main__":
    main()
