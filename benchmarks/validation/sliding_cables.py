"""Cables that slide across membranes: references that others can compare with.

Nobody seems to publish numbers for a cable that slides across a membrane, so that these are ours,
in `sliding_cables.csv`: each with a bar, how far it may be from the continuum, its source, and the
relative tolerance within which this script computes it again on coarser meshes, by extrapolation.
Scenes are described in `docs/benchmarks/validation.md`.

    ./run python benchmarks/validation/sliding_cables.py
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "scenes"))
from accuracy.cases import CASES, QUANTITIES, Laws, free_square, middle, with_cable
from friction import threshold
from rigid_surfaces import band, curve, sphere

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver
from crms_fenicsx.design.study import Quantity, convergence
from crms_fenicsx.foundation.meshes import MembraneMesh
from validation.table import OURS, PUBLISHED, THIRD, Row, labels, panels, report, save

DATA = Path(__file__).with_suffix(".csv")
CROSSING = (([(50, 0), (50, 100)], 100.3, 1), ([(0, 50), (100, 50)], 100.6, 0))
"""Path, unstressed length and layer of the two crossing cables."""
CELLS = 20
"""Of the sphere's meshes on a radius."""


@dataclass(frozen=True)
class Reference:
    """A line of the file."""

    case: str
    quantity: str
    unit: str
    value: float
    bar: float
    tolerance: float
    source: str


def references() -> list[Reference]:
    """The lines of the file."""
    with DATA.open() as file:
        return [
            Reference(r["case"], r["quantity"], r["unit"], float(r["value"]), float(r["bar"]),
                      float(r["tolerance"]), r["source"])
            for r in csv.DictReader(file)
        ]  # fmt: skip


def crossing(mesh: MembraneMesh) -> Solver:
    """Two cables over the inflated square, across each other."""
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    for path, L0, layer in CROSSING:
        scene.lay_cable(Cable(EA=32000.0), path, L0=L0, layer=layer)
    solver = Solver(scene)
    solver.advance(pressure=0.01)
    return solver


def study(case: str, n: int, levels: int = 3) -> dict[str, Quantity]:
    """Limits of one of the cases of `benchmarks/accuracy`, by the names of the file."""
    names = {
        "tension": QUANTITIES["T"],
        "energy": QUANTITIES["W"],
        "y of the cable at x = 50": lambda solver: float(middle(solver.scene.cables[0])[1]),
        "z of the cable at x = 50": lambda solver: float(middle(solver.scene.cables[0])[2]),
        "sideways displacement of the middle": QUANTITIES["y"],
    }
    run, mesh = CASES[case].run, CASES[case].mesh(n)
    found = convergence(lambda mesh: run(mesh, Laws())[0], mesh, levels, quantities=names)
    return {name: found[name] for name in names}


def crossing_study(n: int = 9, levels: int = 3) -> dict[str, Quantity]:
    """Limits of the two crossing cables."""
    wanted: dict[str, Callable[[Solver], float]] = {
        f"tension of the {name}": lambda solver, k=k: float(solver.scene.cables[k].tension)
        for k, name in enumerate(("first", "second"))
    }
    found = convergence(crossing, free_square(n), levels, quantities=wanted)
    return {name: found[name] for name in wanted}


def holding(latitude: float, seeds: int = 2) -> tuple[float, float]:
    """Least coefficient that holds a cable on a circle of latitude (degrees), and its scatter."""
    way = curve(sphere(np.radians(latitude)), float(np.tan(np.radians(latitude))), 1.0)
    found = [threshold(way, band(way, 1 / CELLS, seed), 1 / CELLS) for seed in range(seeds)]
    exact = np.tan(np.radians(latitude))
    return float(np.mean(found) * exact), float(np.ptp(found) * exact + 0.005 * exact)


def computed(case: str) -> dict[str, tuple[float, float]]:
    """Values and bars of a case of the file."""
    if case.startswith("circle"):
        return {"least mu that holds the cable": holding(float(case.split()[3]))}
    if case.startswith("two"):
        limits = crossing_study()
    else:
        name, n = {
            "cable that slides sideways": ("sliding cable", 9),
            "model 2": ("model 2", 9),
            "model 3 without friction": ("model 3, smooth", 12),
            "model 3 with mu = 0.7": ("model 3, rough", 6),
        }[case]
        limits = study(name, n)
    return {name: (one.limit, one.bar) for name, one in limits.items()}


def main() -> None:
    """Compute all again, print the table, and draw the picture."""
    rows = []
    known = references()
    for case in dict.fromkeys(one.case for one in known):
        ours = computed(case)
        for one in known:
            if one.case == case:
                value, bar = ours[one.quantity]
                rows.append(Row(f"{case}: {one.quantity} ({one.unit})", one.value, value, bar,
                                f"+- {one.bar:g}; {one.source.replace(';', ',')}"))  # fmt: skip
                off = abs(rows[-1].difference)
                if off > one.tolerance:
                    print(f"beyond its tolerance: {case}, {one.quantity}, {off:.1e}")
    report("our references", rows)
    draw()


def draw() -> None:
    """How far cables slide sideways, and their profiles."""
    figure, (left, right) = panels()
    for height, colour in ((12.0, PUBLISHED), (30.0, OURS), (50.0, THIRD)):
        solver, _ = with_cable(height)(free_square(17), Laws())
        x, y, z = solver.scene.cables[0].line.T
        name = f"ends at y = {height:g}"
        left.plot(x, y - height, color=colour, label=name)
        right.plot(x, z, color=colour, label=name)
    left.plot([50.0], [29.60632 - 30.0], "kx", label="reference")
    right.plot([50.0], [3.51323], "kx", label="reference")
    labels(left, "x [cm]", "way sideways [cm]", "plan", legend=False)
    labels(right, "x [cm]", "z [cm]", "profiles")
    save(figure, "sliding_cables")


if __name__ == "__main__":
    main()
