"""The square bulge test: J. J. Vlassak and W. D. Nix (1992).

A clamped square membrane, 2 a wide, of thickness t and with the stress s rises by w under

    p = C1 s t w / a^2 + C2(nu) E t w^3 / ((1 - nu) a^4),  C1 = 3.393, C2 = (0.800 + 0.062 nu)^-3.

The constants are quoted from memory. C1 is that of a linear membrane, which a series has exactly;
C2 was fitted to an approximate solution. The sheet resists compression here, as theirs does.

    ./run python benchmarks/validation/square_bulge.py
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.design.study import Quantity, convergence
from crms_fenicsx.foundation.meshes import MembraneMesh
from validation.disks import rise
from validation.table import COMM, OURS, PUBLISHED, Row, labels, panels, report, save

POISSONS = (0.0, 0.25, 0.4)
C1, OWN = 3.393, {0.0: 2.038, 0.25: 1.8885, 0.4: 1.8020}
"""OWN: C2 of another computation of ours, with elements of the second order."""
SMALL, TINY = 1e-9, 1e-4
"""Pressures on a square with a = 1 and E t = 1, the second where it has the stress s t = 1."""


def c2(nu: float) -> float:
    """Their fit."""
    return float((0.800 + 0.062 * nu) ** -3)


def bulge(mesh: MembraneMesh, nu: float, prestress: float) -> Solver:
    """A quarter of the square under a small pressure."""
    material = IsotropicMembrane(1.0, nu, 1.0, prestress=prestress, wrinkling=False)
    scene = Scene(mesh, material)
    scene.fix("left", "x")
    scene.fix("front", "y")
    scene.fix("right")
    scene.fix("back")
    solver = Solver(scene)
    solver.advance(pressure=TINY if prestress else SMALL)
    return solver


def quarter(n: int) -> MembraneMesh:
    """Its mesh, n cells a side."""
    return meshes.rectangle(COMM, 1.0, 1.0, 1.0 / n, structured=True)


def constant(nu: float | None, n: int = 8, levels: int = 4) -> Quantity:
    """C2 of a Poisson's ratio, or C1."""

    def value(solver: Solver) -> float:
        if nu is None:
            return TINY / rise(solver)
        return (1 - nu) * SMALL / rise(solver) ** 3

    return convergence(
        lambda mesh: bulge(mesh, nu or 0.0, float(nu is None)), quarter(n), levels,
        quantities={"C": value},
    )["C"]  # fmt: skip


def series() -> float:
    """C1 of the linear membrane: its Fourier series."""
    odd = np.arange(1, 400, 2)
    sign = np.where(odd % 4 == 1, 1.0, -1.0)
    m, n = np.meshgrid(odd, odd)
    total = float(np.sum(np.outer(sign, sign) / (m * n * (m**2 + n**2))))
    return float(np.pi**4 / (64 * total))


def main() -> None:
    """Print the table and draw the picture."""
    one = constant(None)
    rows = [Row("C1", C1, one.limit, one.bar, f"from memory, four digits; series {series():.5f}")]
    found = {}
    for nu in POISSONS:
        found[nu] = one = constant(nu)
        rows.append(Row(f"C2, nu = {nu}", round(c2(nu), 3), one.limit, one.bar,
                        f"from memory; a rough fit; own second order {OWN[nu]}"))  # fmt: skip
    report("square bulge", rows)
    figure, (left, right) = panels()
    solver = bulge(quarter(16), 0.25, 0.0)
    x = solver.scene.positions()
    height = x[:, 2] / x[:, 2].max()
    points = solver.scene.V.tabulate_dof_coordinates()
    drawn = left.tricontourf(points[:, 0], points[:, 1], height, 10, cmap="cividis")
    figure.colorbar(drawn, ax=left, shrink=0.8).ax.tick_params(labelsize=8)
    left.set_aspect("equal")
    labels(left, "x / a", "y / a", "height / rise, nu = 0.25", legend=False)
    ratios = np.linspace(0.0, 0.45, 50)
    right.plot(ratios, [c2(value) for value in ratios], color=PUBLISHED, label="Vlassak and Nix")
    right.plot(list(found), [one.limit for one in found.values()], "o", color=OURS, label="package")
    right.plot(list(OWN), list(OWN.values()), "x", color="0.3", label="own, second order")
    labels(right, "Poisson's ratio", "C2", "coefficient of the cube")
    save(figure, "square_bulge")


if __name__ == "__main__":
    main()
