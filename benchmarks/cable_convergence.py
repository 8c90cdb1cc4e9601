"""Convergence of the tensions of cables with little strain on coarse meshes: experiments.

A ring just taut around an inflated sphere, a hoop around an inflated cylinder, both against an
ordinary differential equation, and a great circle over the cap of `demos/cable_net.py`, and that
demo's net. Units: m, kN. `docs/benchmarks/cable_accuracy.md`
has the conclusions.

    ./run python benchmarks/cable_convergence.py [sphere] [cylinder] [valley] [factor] [cap] [ends]
                                                 [net]
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np
from accuracy.axisymmetric import Revolution
from accuracy.curved_meshes import cap, half_cylinder
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes, nets
from crms_fenicsx.foundation.meshes import MembraneMesh, Refinement
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.tolerances import TOL

COMM = MPI.COMM_WORLD
R, NU, EA = 25.0, 0.3, 30e3
RIM, HEIGHT = 20.0, 10.0
PRESSURE = 0.4
RULES = ("facets", "surface", "true")


@dataclass(frozen=True)
class Case:
    """A shape with a cable.

    Attributes
    ----------
    path
        The cable's path, (k, 2) or (k, 3).
    length
        Its true just-taut length (length).
    Et
        The membrane's extensional stiffness (force / length).
    fix
        Holds a scene.
    """

    path: Array
    length: float
    Et: float
    fix: Callable[[Scene], None]

    def tension(
        self, mesh: MembraneMesh, rule: str, shorter: float = 0.0, penalty: float = 0.1, **how: Any
    ) -> float:
        """Tension under pressure of the cable, whose length is measured by a rule, `RULES`."""
        material = IsotropicMembrane(E=self.Et * 1e3, nu=NU, thickness=1e-3)
        scene = Scene(mesh, material, penalty=penalty)
        self.fix(scene)
        measured_on: Any = "facets" if rule == "true" else rule
        cable = scene.lay_cable(Cable(EA), self.path, measured_on=measured_on)
        L0 = (self.length if rule == "true" else cable.L0) * (1 - shorter)
        scene.remove(cable)
        cable = scene.lay_cable(Cable(EA), self.path, L0=L0)
        Solver(scene, verify=False, **how).advance(pressure=PRESSURE)
        return cable.tension


def fix_half_sphere(scene: Scene) -> None:
    """Hold its rim in z, and what keeps it from moving as a whole, without force."""
    x = scene.membrane.stress_free
    rim = x[np.abs(x[:, 2]) < 1e-9 * R]
    every = np.concatenate(COMM.allgather(rim))
    scene.fix("boundary", "z")
    for end, directions in ((every[:, 1].argmax(), "xy"), (every[:, 1].argmin(), "x")):
        place = every[end]
        scene.fix(lambda x, at=place: np.linalg.norm(x.T - at, axis=1) < 1e-9 * R, directions)


def fix_half_cylinder(scene: Scene) -> None:
    """Hold its ends, and its sides in z."""
    scene.fix(lambda x: np.abs(np.abs(x[0]) - R) < 1e-9 * R)
    scene.fix("boundary", "z")


def sphere(Et: float = 800.0) -> tuple[Case, Revolution]:
    """Half of a sphere under half of a ring, and the whole."""
    line = np.column_stack([np.linspace(-R, R, 9), np.zeros(9)])
    whole = Revolution(
        np.pi * R / 2, lambda s: R * np.cos(s / R), lambda s: R * np.sin(s / R),
        Et, NU, PRESSURE, pole=True,
    )  # fmt: skip
    return Case(line, np.pi * R, Et, fix_half_sphere), whole


def cylinder(Et: float = 200.0) -> tuple[Case, Revolution]:
    """Half of a cylinder, as long as wide, with held ends and half a hoop; and the whole."""
    angle = np.linspace(0.0, np.pi, 61)
    hoop = np.column_stack([0 * angle, R * np.cos(angle), R * np.sin(angle)])
    whole = Revolution(
        R, lambda s: np.full_like(s, R), lambda s: s, Et, NU, PRESSURE, pole=False
    )  # fmt: skip
    return Case(hoop, np.pi * R, Et, fix_half_cylinder), whole


def show(*columns: object) -> None:
    """Print a row on rank 0: numbers in per cent."""
    if COMM.rank == 0:
        text = (f"{c:10.2f}" if isinstance(c, float) else f"{c!s:>12}" for c in columns)
        print("".join(text), flush=True)


def errors(case: Case, mesh: MembraneMesh, exact: float, **how: Any) -> list[float]:
    """Errors of the tension by all rules (per cent)."""
    return [100 * (case.tension(mesh, rule, **how) / exact - 1) for rule in RULES]


def sphere_table() -> None:
    """Directions and sizes of the mesh."""
    case, whole = sphere()
    exact = whole.tension(EA, 2 * case.length)
    valley = R * np.sqrt(PRESSURE * R / 2 / case.Et)
    show(f"\nring around a sphere, T = {exact:.4f} kN; error of T in per cent, L0 by")
    show("mesh", "h / lambda", *RULES)
    for name in ("0", "7", "15", "30", "free"):
        for n in (8, 12, 18, 27):
            h = np.pi * R / 2 / n
            if name == "free":
                mesh = meshes.spherical_cap(COMM, R, R, h)
            else:
                mesh = cap(n, R, R, np.radians(float(name)))
            show(name, h / valley, *errors(case, mesh, exact))


def cylinder_table() -> None:
    """Rows on which the hoop lies, or between which."""
    case, whole = cylinder()
    exact = whole.tension(EA, 2 * case.length)
    valley = R * np.sqrt(NU * PRESSURE * R / case.Et)
    show(f"\nhoop around a cylinder, T = {exact:.4f} kN; error of T in per cent, L0 by")
    show("place", "h / lambda", *RULES)
    for shifted in (False, True):
        for share in (0.0, 0.1, 0.25, 0.5):
            for n in (18, 27, 40):
                mesh = half_cylinder(n, R, R, share, shifted)
                name = f"{'lattice' if shifted else 'grid'} {share}"
                show(name, np.pi * R / n / valley, *errors(case, mesh, exact))


def valley_table() -> None:
    """Membranes of several stiffnesses: errors over (h / lambda)^2."""
    show("\nsphere: error over (h / lambda)^2 in per cent, L0 by")
    show("Et", "mesh", "h / lambda", *RULES)
    for Et in (100.0, 200.0, 400.0, 800.0):
        case, whole = sphere(Et)
        exact = whole.tension(EA, 2 * case.length)
        valley = R * np.sqrt(PRESSURE * R / 2 / Et)
        for turn in (0.0, 15.0):
            ratio = np.pi * R / 2 / 24 / valley
            found = errors(case, cap(24, R, R, np.radians(turn)), exact)
            show(Et, turn, ratio, *(error / ratio**2 for error in found))


def factor_table() -> None:
    """All else that may count, on one mesh."""
    case, whole = sphere()
    exact = whole.tension(EA, 2 * case.length)
    turn = np.radians(15.0)
    mesh = cap(18, R, R, turn)
    show("\nsphere, mesh turned by 15 degrees, 18 rings: error of T in per cent, L0 by")
    show("what", "value", *RULES)
    for penalty in (1e-3, 1e-2, 0.1, 1.0):
        show("penalty", penalty, *errors(case, mesh, exact, penalty=penalty))
    for smoothing in (3e-4, 3e-3, 1e-2):
        with patch.dict(vars(TOL), smoothing=smoothing):
            show("smoothing", str(smoothing), *errors(case, mesh, exact))
    show("held path", "", *errors(case, mesh, exact, slide=False))
    for out in (2.5e-4, 5e-4):
        moved = replace(case, path=case.path * (1 + out))  # else it would end above the rim
        show("moved out", str(out), *errors(moved, cap(18, R, R, turn, out), exact))
    for shorter in (2.5e-3, 1e-2):
        tight = whole.tension(EA, 2 * case.length * (1 - shorter))
        show("shorter by", str(shorter), *errors(case, mesh, tight, shorter=shorter))


def cap_table() -> None:
    """A great circle over the cap of the demo, on lines and across cells, and a finer mesh."""
    arc = (RIM**2 + HEIGHT**2) / HEIGHT * np.arcsin(RIM / R)
    case = Case(nets.great_circle(RIM, HEIGHT, 0.0, 0.0), arc, 800.0, lambda s: s.fix("boundary"))
    coarse, fine = (case.tension(cap(n, RIM, HEIGHT), "true") for n in (32, 64))
    exact = fine + (fine - coarse) / 3
    show(f"\ngreat circle over a cap, L0 = {arc:.5f} m; lines under it, extrapolated: {exact:.4f}")
    show("mesh", "size", *RULES)
    for n in (8, 16, 32):
        show("line", arc / 2 / n, *errors(case, cap(n, RIM, HEIGHT), exact))
    for size in (3.0, 2.0, 1.4, 1.0, 0.7):
        mesh = meshes.spherical_cap(COMM, RIM, HEIGHT, size)
        show("free", size, *errors(case, mesh, exact))
    for size in (3.0, 2.0, 1.4):
        finer = Refinement(case.path.tolist(), size / 2, 8.0)
        mesh = meshes.spherical_cap(COMM, RIM, HEIGHT, size, refinements=[finer])
        show("finer along", size, *errors(case, mesh, exact))


def ends_table() -> None:
    """A great circle that meets the rim beside its vertices."""
    route = nets.great_circle(RIM, HEIGHT, 0.3, 0.0)
    whole = 2 * R * np.arcsin(RIM / R)
    show("\ngreat circle at 0.3 rad; T in kN by L0")
    show("size", "longer, mm", "whole", "between", "surface", "facets")
    for size in (3.0, 2.0, 1.4, 1.0, 0.7):
        mesh = meshes.spherical_cap(COMM, RIM, HEIGHT, size)
        laid = Scene(mesh, IsotropicMembrane(E=800e3, nu=NU, thickness=1e-3)).lay_cable(
            Cable(EA), route
        )
        a, b = laid.state.positions[[0, -1]] - (0.0, 0.0, HEIGHT - R)
        between = R * np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
        cases = [Case(route, length, 800.0, lambda s: s.fix("boundary"))
                 for length in (whole, between)]  # fmt: skip
        T = [case.tension(mesh, "true") for case in cases]
        T += [cases[0].tension(mesh, rule) for rule in ("surface", "facets")]
        show(str(size), 1e3 * float(whole - between), *T)


def net_table() -> None:
    """The net of `demos/cable_net.py` in the calm and in the wind."""
    show("\nnet of 14 cables: mean T in the calm by L0, and greatest T in the wind, kN")
    show("size", *RULES[:2], "wind")
    for size in (3.0, 2.0, 1.6, 1.25, 0.9, 0.5):
        mesh, mean, most = meshes.spherical_cap(COMM, RIM, HEIGHT, size), dict[str, float](), np.nan
        for rule in RULES[:2] if size > 0.5 else RULES[1:2]:
            scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=NU, thickness=1e-3))
            scene.fix("boundary")
            for angle, offset in itertools.product((30.0, -30.0), 4.5 * np.arange(-3, 4)):
                route = nets.great_circle(RIM, HEIGHT, np.radians(angle), offset)
                scene.lay_cable(Cable(EA), route, measured_on=rule)
            solver = Solver(scene, verify=False)
            solver.advance(pressure=PRESSURE, steps=2)
            mean[rule] = float(np.mean([cable.tension for cable in scene.cables]))
        if size > 1.0:
            scene.put_wind(0.75, lambda x, _: np.interp(x[0], [-RIM, 0, RIM], [0.8, -1, -0.3]))
            solver.advance(load=1.0, steps=2)
            most = max(cable.tension for cable in scene.cables)
        show(str(size), *(mean.get(rule, np.nan) for rule in RULES[:2]), most)


TABLES = {
    "sphere": sphere_table,
    "cylinder": cylinder_table,
    "valley": valley_table,
    "factor": factor_table,
    "cap": cap_table,
    "ends": ends_table,
    "net": net_table,
}


def main() -> None:
    """Print the tables, or those asked for."""
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()


if __name__ == "__main__":
    main()
