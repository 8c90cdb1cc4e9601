"""Membranes of code_aster's tests: SSNS115 (an inflated disk) and SSNS116 (a heavy strip).

The figures were read in the test files `ssns115a.comm` to `ssns115d.comm` and `ssns116a.comm` to
`ssns116c.comm` of a public copy of its repository (state of November 2020). They do not tell the
radius of the disk, which is in a binary mesh: 1000 mm is deduced, as code_aster's rises follow.

    ./run python benchmarks/validation/code_aster.py
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from scipy.integrate import quad
from scipy.optimize import brentq

sys.path.insert(0, str(Path(__file__).parents[1]))
from crms_fenicsx import IsotropicMembrane, Scene, Solver, UflMembrane, meshes
from crms_fenicsx.design.study import Quantity, convergence
from crms_fenicsx.foundation.meshes import MembraneMesh
from validation.disks import by_ode, disk, inflated, limit, neo_hooke, rise, saint_venant
from validation.table import COMM, OURS, PUBLISHED, Row, labels, panels, report, save

RADIUS, E, NU, THICKNESS, PRESSURE = 1000.0, 2.0, 0.3, 1.0, 0.025
"""Of the disk (mm, MPa)."""
REFERENCE, RISES = 2448.0, (2472.96756522, 2494.19523571, 2483.58012316)
"""Rise of the disk (mm): by another program, and by code_aster in SSNS115a, b, c."""
RUBBER = {250.0: (109.55, 116.5680106083), 500.0: (531.73, 519.3927878135),
          750.0: (995.8, 1009.419099280), 1000.0: (1276.2, 1306.684950716)}  # fmt: skip
"""By rises (mm), pressures (1e-6 MPa) of SSNS115d: by another program, and by code_aster."""
SPAN, WIDTH, AREA = 325.0, 10.0, 2.2783e-4
YOUNG, POISSON, RHO, GRAVITY = 5.7e10, 0.49, 2844.23, 9.81
"""Of the strip (m, N, kg). Its `N_INIT` starts Newton's method only: the sag is that without it."""
ANALYTIC, SAGS = 6.352, (6.34942183815, 6.34895127982, 6.34895127557)
"""Sag of the strip (m): the test's analytic one, and by code_aster in SSNS116a, b, c."""


def rubber(strain: Any) -> Any:
    """Neo-Hookean energy as in code_aster, mu/2 (I1 - 3 - 2 ln J) + lame/2 (ln J)^2.

    Plane stress makes the square of the stretch through the thickness, exp(y), a root of
    mu (exp(y) - 1) + lame/2 (ln det C + y) = 0, which three of Newton's steps find.
    """
    mu, lame = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
    C = ufl.Identity(2) + 2 * strain
    plane = ufl.ln(ufl.det(C))
    y = -lame / (2 * mu + lame) * plane
    for _ in range(3):
        y -= (mu * (ufl.exp(y) - 1) + lame / 2 * (plane + y)) / (mu * ufl.exp(y) + lame / 2)
    ln_j = (plane + y) / 2
    return THICKNESS * (mu / 2 * (ufl.tr(C) + ufl.exp(y) - 3 - 2 * ln_j) + lame / 2 * ln_j**2)


def sheet() -> IsotropicMembrane:
    """The disk's material in SSNS115a to c."""
    return IsotropicMembrane(E, NU, THICKNESS)


def strip(mesh: MembraneMesh) -> Solver:
    """The heavy strip, hanging."""
    thickness = AREA / WIDTH
    scene = Scene(mesh, IsotropicMembrane(YOUNG, POISSON, thickness))
    scene.fix("ends", "xz")
    scene.fix("side", "y")
    scene.put_load((0.0, 0.0, -RHO * thickness * GRAVITY), name="weight", per="material")
    solver = Solver(scene)
    solver.advance(load=1.0)
    return solver


def strip_mesh(cells: int) -> MembraneMesh:
    """A row of cells, an even number of them."""
    x = np.repeat(np.linspace(0.0, SPAN, cells + 1), 2)
    points = np.column_stack([x, np.tile([0.0, WIDTH], cells + 1)])
    first = 2 * np.arange(cells)
    lower, upper = np.add.outer(first, [0, 2, 3]), np.add.outer(first, [0, 3, 1])
    sides = np.add.outer(first, [0, 2])
    ends = np.array([[0, 1], [2 * cells, 2 * cells + 1]])
    return meshes.from_arrays(COMM, points, np.vstack([lower, upper]),
                              edges={"side": sides, "ends": ends})  # fmt: skip


def sag(solver: Solver) -> float:
    """Of the strip."""
    return -float(solver.scene.positions()[:, 2].min())


def catenary() -> float:
    """Sag of the strip by integrals: its force per width is E t l (l^2 - 1) / 2."""
    thickness = AREA / WIDTH
    stiffness, weight = YOUNG * thickness, RHO * thickness * GRAVITY

    def stretch(force: float) -> float:
        def excess(l: float) -> float:  # noqa: E741
            return stiffness * l * (l**2 - 1) / 2 - force

        return float(brentq(excess, 0.9, 1.2, xtol=1e-15))

    def along(H: float, power: int) -> float:
        def part(s: float) -> float:
            force = float(np.hypot(H, weight * s))
            return stretch(force) * (H, weight * s)[power] / force

        return float(quad(part, 0.0, SPAN / 2, epsabs=1e-12)[0])

    H = float(brentq(lambda H: along(H, 0) - SPAN / 2, SPAN * weight, 100 * SPAN * weight))
    return along(H, 1)


def rubber_rises() -> dict[float, Quantity]:
    """Rises of the rubber disk by code_aster's pressures, one after the other."""
    pressures = [pressure for _, pressure in RUBBER.values()]
    rises: dict[Solver, list[float]] = {}

    def build(mesh: MembraneMesh) -> Solver:
        solver = inflated(mesh, UflMembrane(rubber), pressures[0] * 1e-6)
        rises[solver] = [rise(solver)]
        for pressure in pressures[1:]:
            solver.advance(pressure=pressure * 1e-6)
            rises[solver].append(rise(solver))
        return solver

    wanted = {f"{p}": (lambda solver, k=k: rises[solver][k]) for k, p in enumerate(pressures)}
    study = limit(build, RADIUS, quantities=wanted)  # type: ignore[arg-type]
    return {p: study[f"{p}"] for p in pressures}


def main() -> None:
    """Print the table and draw the picture."""
    study = limit(lambda mesh: inflated(mesh, sheet(), PRESSURE), RADIUS, levels=4)["rise"]
    own = by_ode(saint_venant(E * THICKNESS, NU), RADIUS, PRESSURE, 5.0)[0, 2]
    name = "SSNS115a to c, disk, rise (mm)"
    rows = [Row(name, REFERENCE, study.limit, study.bar,
                f"first hand: another program's; our ODE {own:.2f}")]  # fmt: skip
    for letter, value in zip("abc", RISES, strict=True):
        rows.append(Row(f"SSNS115{letter}, disk, rise (mm)", value, study.limit, study.bar,
                        "first hand: code_aster on its mesh"))  # fmt: skip
    found = rubber_rises()
    for height, (_, pressure) in RUBBER.items():
        own = by_ode(neo_hooke(E, NU, THICKNESS), RADIUS, pressure * 1e-6, 2.6)[0, 2]
        one = found[pressure]
        rows.append(Row(f"SSNS115d, rubber disk, rise (mm) at {pressure:.2f} Pa", height,
                        one.limit, one.bar,
                        f"first hand: code_aster's pressure; our ODE {own:.2f}"))  # fmt: skip
    hanging = convergence(strip, strip_mesh(16), 4, quantities={"sag": sag})["sag"]
    remark = f"first hand; our integral {catenary():.6f}"
    rows.append(Row("SSNS116, strip, sag (m)", ANALYTIC, hanging.limit, hanging.bar,
                    f"the test's analytic value, {remark}"))  # fmt: skip
    for letter, value in zip("abc", SAGS, strict=True):
        rows.append(Row(f"SSNS116{letter}, strip, sag (m)", value, hanging.limit, hanging.bar,
                        f"code_aster on its mesh, {remark}"))  # fmt: skip
    report("code_aster", rows)
    draw(found)


def draw(found: dict[float, Quantity]) -> None:
    """Profile of the disk; rises of the rubber disk."""
    figure, (left, right) = panels()
    curve = by_ode(saint_venant(E * THICKNESS, NU), RADIUS, PRESSURE, 5.0)
    solver = inflated(disk(RADIUS, 16), sheet(), PRESSURE)
    x = solver.scene.positions()
    left.plot(curve[:, 1], curve[:, 2], color="0.5", label="our ODE")
    left.plot(np.hypot(x[:, 0], x[:, 1]), x[:, 2], ".", color=OURS, markersize=3, label="vertices")
    left.plot([0.0], [REFERENCE], "D", color=PUBLISHED, mfc="none", label="SSNS115")
    left.set_aspect("equal")
    labels(left, "radius [mm]", "height [mm]", "inflated disk")
    pressures = np.linspace(60.0, 1320.0, 15)
    law = neo_hooke(E, NU, THICKNESS)
    right.plot(pressures, [by_ode(law, RADIUS, p * 1e-6, 2.6)[0, 2] for p in pressures],
               color="0.5", label="our ODE")  # fmt: skip
    right.plot(list(found), [one.limit for one in found.values()], ".", color=OURS, label="package")
    for k, (whose, mark) in enumerate((("another program", "D"), ("code_aster", "s"))):
        right.plot([pair[k] for pair in RUBBER.values()], list(RUBBER), mark, color=PUBLISHED,
                   mfc="none", label=f"SSNS115d, {whose}")  # fmt: skip
    labels(right, "pressure [Pa]", "rise [mm]", "rubber disk")
    save(figure, "code_aster")


if __name__ == "__main__":
    main()
