"""A rubber balloon, R. S. Rivlin's closed form, as SfePy's example `balloon.py` verifies it.

The pressure of a sphere of a Mooney-Rivlin material as a function of its stretch, and the data c1,
c2, h0 and r0, were read in `sfepy/examples/large_deformation/balloon.py` of SfePy's repository.

    ./run python benchmarks/validation/balloon.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import ufl

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import Scene, Solver, UflMembrane, meshes
from crms_fenicsx.design.study import Quantity, convergence
from crms_fenicsx.foundation.meshes import MembraneMesh
from validation.table import COMM, OURS, PUBLISHED, Row, labels, over_sizes, panels, report, save

C1, C2, THICKNESS, RADIUS = 3e5, 3e4, 1e-2, 1.0
STRETCHES = (1.05, 1.2, 1.4)
"""The pressure is largest at 1.5, beyond which no load step by pressure leads."""


def rivlin(stretch: float) -> float:
    """Pressure of the balloon."""
    shape = 1 / stretch - 1 / stretch**7
    return 4 * THICKNESS / RADIUS * shape * (C1 + C2 * stretch**2)


def rubber(strain: Any) -> Any:
    """Energy of an incompressible Mooney-Rivlin sheet."""
    C = ufl.Identity(2) + 2 * strain
    thin = 1 / ufl.det(C)
    I1, I2 = ufl.tr(C) + thin, ufl.det(C) + ufl.tr(C) * thin
    return THICKNESS * (C1 * (I1 - 3) + C2 * (I2 - 3))


def octant(n: int) -> MembraneMesh:
    """An eighth of a sphere, n cells a side."""
    at = {(i, j): k for k, (i, j) in
          enumerate((i, j) for i in range(n + 1) for j in range(n + 1 - i))}  # fmt: skip
    points = np.array([(i, j, n - i - j) for i, j in at], dtype=float)
    cells = [(at[i, j], at[i + 1, j], at[i, j + 1]) for i, j in at if i + j < n]
    cells += [(at[i + 1, j], at[i + 1, j + 1], at[i, j + 1]) for i, j in at if i + j < n - 1]
    return meshes.from_arrays(COMM, onto_sphere(points.T).T, cells)


def onto_sphere(points: np.ndarray) -> np.ndarray:
    """Points (3, n) moved to the sphere."""
    return np.asarray(RADIUS * points / np.linalg.norm(points, axis=0))


def blown_up(mesh: MembraneMesh, pressure: float) -> Solver:
    """An eighth of the balloon under pressure."""
    scene = Scene(mesh, UflMembrane(rubber))
    for k, axis in enumerate("xyz"):
        scene.fix(lambda x, k=k: np.abs(x[k]) < 1e-9, axis)  # type: ignore[misc]
    solver = Solver(scene)
    solver.advance(pressure=pressure)
    return solver


def stretch_of(solver: Solver) -> float:
    """Mean radius of the vertices, over that without pressure."""
    return float(np.linalg.norm(solver.scene.positions(), axis=1).mean() / RADIUS)


def limit(stretch: float, n: int = 8, levels: int = 3) -> Quantity:
    """Our stretch under Rivlin's pressure of a stretch, extrapolated."""
    pressure = rivlin(stretch)
    return convergence(
        lambda mesh: blown_up(mesh, pressure), octant(n), levels,
        quantities={"stretch": stretch_of}, project=onto_sphere,
    )["stretch"]  # fmt: skip


def main() -> None:
    """Print the table and draw the picture."""
    rows, found = [], {}
    for stretch in STRETCHES:
        found[stretch] = one = limit(stretch)
        rows.append(Row(f"stretch at {rivlin(stretch):.2f} Pa", stretch, one.limit, one.bar,
                        "closed form of Rivlin 1952, first hand from SfePy's example"))  # fmt: skip
    report("SfePy's balloon", rows)
    figure, (left, right) = panels()
    x = np.linspace(1.0, 1.5, 101)
    left.plot(x, [rivlin(s) / 1e3 for s in x], color=PUBLISHED, label="closed form")
    left.plot([one.limit for one in found.values()], [rivlin(s) / 1e3 for s in found], "o",
              color=OURS, label="package")  # fmt: skip
    labels(left, "stretch r / r0", "pressure [kPa]", "Mooney-Rivlin balloon")
    sizes = 1.0 / 8 / 2.0 ** np.arange(3)
    for (stretch, one), mark in zip(found.items(), "os^", strict=True):
        right.plot(sizes, [100 * abs(value / stretch - 1) for value in one.values], mark + "-",
                   color=OURS, label=f"stretch {stretch}")  # fmt: skip
    over_sizes(right, sizes)
    labels(right, "1 / cells along a quarter of the equator", "error [%]", "error of the stretch")
    save(figure, "balloon")


if __name__ == "__main__":
    main()
