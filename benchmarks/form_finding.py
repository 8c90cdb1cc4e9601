"""Cost of form finding, compared with load steps on the form.

A hypar of 10 x 10 m between four points, two of them 3 m higher, with edge cables, and the same
within a straight rim that is held: form finding from the flat mesh, and then ten steps of snow on
what was found. CPU seconds; a coarse one first, not counted, compiles what is needed.

    ./run python benchmarks/form_finding.py [unknowns ...]
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Solver, meshes
from crms_fenicsx.design.form_finding import FormCable, FoundForm, find_form

CORNERS = ("front left", "front right", "back right", "back left")
SIDES = ("front", "right", "back", "left")


def hypar(unknowns: float, rim: str) -> FoundForm:
    """The form."""
    size = 10.0 / round(np.sqrt(unknowns / 3) - 1)
    mesh = meshes.rectangle(MPI.COMM_WORLD, 10.0, 10.0, size, structured=True)
    if rim == "cables":
        return find_form(
            mesh, 2.0, fixed=CORNERS, lifted=dict.fromkeys(CORNERS[::2], (0.0, 0.0, 3.0)),
            cables=[FormCable(side, tension=30.0) for side in SIDES],
        )  # fmt: skip
    return find_form(mesh, 2.0, fixed=["boundary"], lifted={"boundary": raised})


def raised(x: Any) -> Any:
    """Heights of the straight rim, as displacements (3, n)."""
    return np.stack([0 * x[0], 0 * x[0], 1.5 + 0.06 * (x[0] - 5.0) * (x[1] - 5.0)])


def row(unknowns: float, rim: str) -> str:
    """What is measured of one form."""
    began = time.process_time()
    found = hypar(unknowns, rim)
    form = time.process_time()
    scene = found.scene(IsotropicMembrane(1000.0, 0.3, 1.0), Cable(8000.0))
    scene.put_load((0.0, 0.0, -0.6), name="snow", per="plan")
    solver = Solver(scene)
    solver.advance()
    laid = time.process_time()
    solver.advance(load={"snow": 1.0}, steps=10)
    return (
        f"{rim:>10} {3 * scene.V.dofmap.index_map.size_global:10d} {found.iterations:10d} "
        f"{form - began:10.2f} {laid - form:10.2f} {time.process_time() - laid:10.2f}"
    )


def main() -> None:
    """Measure and print a table."""
    heads = ("rim", "unknowns", "iterations", "form s", "scene s", "10 steps s")
    print(" ".join(f"{head:>10}" for head in heads))
    for rim in ("cables", "held"):
        row(300, rim)  # compiles what will be needed
        for unknowns in [float(arg) for arg in sys.argv[1:]] or [3e3, 1e4, 3e4]:
            print(row(unknowns, rim), flush=True)


if __name__ == "__main__":
    main()
