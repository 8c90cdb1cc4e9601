"""Soap films between two rings: Kratos' validation example of a catenoid.

Kratos' page `catenoid_formfinding` has rings of radius 10 m; 12 m apart a catenoid forms, 14 m
apart two planes remain. It has no other number: neck and area are those of the closed form, which
ends at 13.25487 m. The page was read in a stored copy of kratosmultiphysics.github.io/Examples.

    ./run python benchmarks/validation/film.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import ConvergenceError, meshes
from crms_fenicsx.design.form_finding import FoundForm, find_form
from crms_fenicsx.foundation.meshes import MembraneMesh
from validation.table import COMM, OURS, PUBLISHED, Row, labels, over_sizes, panels, report, save

RADIUS, FORMS, BREAKS = 10.0, 12.0, 14.0


def catenoid(height: float) -> tuple[float, float]:
    """Radius of the neck, and area."""
    neck = float(brentq(lambda a: a * np.cosh(height / 2 / a) - RADIUS, 0.56 * RADIUS, RADIUS))
    return neck, float(np.pi * neck * (height + neck * np.sinh(height / neck)))


def cylinder(n: int, height: float) -> MembraneMesh:
    """The start: n cells around, n / 4 high."""
    rows = n // 4
    turn = 2 * np.pi * np.arange(n) / n
    ring = RADIUS * np.column_stack([np.cos(turn), np.sin(turn)])
    levels = np.linspace(0.0, height, rows + 1)
    points = np.concatenate([np.column_stack([ring, np.full(n, z)]) for z in levels])
    first = np.arange(rows)[:, None] * n
    a, b = (first + np.arange(n)).ravel(), (first + (np.arange(n) + 1) % n).ravel()
    cells = np.vstack([np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])])
    return meshes.from_arrays(COMM, points, cells, outside=meshes.AwayFrom((0.0, 0.0, height / 2)))


def film(n: int, height: float) -> FoundForm:
    """The form with equal forces in all directions."""
    return find_form(cylinder(n, height), 1.0, fixed=["boundary"])


def neck(found: FoundForm) -> float:
    """Smallest distance of a vertex from the axis."""
    x = found.mesh.mesh.geometry.x
    return float(np.hypot(x[:, 0], x[:, 1]).min())


def breaks() -> bool:
    """Whether no form is found for rings 14 m apart."""
    try:
        film(24, BREAKS)
    except ConvergenceError:
        return True
    return False


def main() -> None:
    """Print the table and draw the picture."""
    sizes = (16, 32, 64)
    found = {n: film(n, FORMS) for n in sizes}
    exact = catenoid(FORMS)
    values = {"radius of the neck (m)": [neck(f) for f in found.values()],
              "area (m2)": [f.area for f in found.values()]}  # fmt: skip
    rows = []
    for (name, series), value in zip(values.items(), exact, strict=True):
        best, bar = series[-1] + (series[-1] - series[-2]) / 3, abs(series[-1] - series[-2])
        rows.append(Row(f"rings 12 m apart: {name}", value, best, bar, "closed form; Kratos' page: "
                        "a catenoid forms"))  # fmt: skip
    rows.append(Row("rings 14 m apart: forms found", 0.0, float(not breaks()), 0.0,
                    "first hand: Kratos' page has none there", zero=1.0))  # fmt: skip
    report("soap film", rows)
    figure, (left, right) = panels()
    x = found[32].mesh.mesh.geometry.x
    z = np.linspace(0.0, FORMS, 100)
    left.plot(exact[0] * np.cosh((z - FORMS / 2) / exact[0]), z, color=PUBLISHED, label="catenoid")
    left.plot(np.hypot(x[:, 0], x[:, 1]), x[:, 2], ".", color=OURS, markersize=3, label="vertices")
    labels(left, "radius [m]", "z [m]", "rings 12 m apart")
    for (name, series), value, mark in zip(values.items(), exact, "os", strict=True):
        right.plot([1 / n for n in sizes], [100 * abs(one / value - 1) for one in series],
                   mark + "-", color=OURS, mfc="none", label=name.partition(" (")[0])  # fmt: skip
    over_sizes(right, [1 / n for n in sizes])
    labels(right, "1 / cells around", "error [%]", "convergence")
    save(figure, "film")


if __name__ == "__main__":
    main()
