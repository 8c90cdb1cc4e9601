"""The net of `demos/cable_net.py`, calm and in the wind: across cells, and along lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes, nets
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from lined import limit, timed

Floats = NDArray[np.float64]

RADIUS, HEIGHT, PRESSURE, GUST, LARGE = 20.0, 10.0, 0.4, 0.75, 3.0
SIZES = (1.6, 1.2, 0.9)


def coefficient(points: Floats, normals: Floats) -> Floats:
    """The demo's pressure coefficients."""
    return np.interp(points[0], [-RADIUS, 0.0, RADIUS], [0.8, -1.0, -0.3])


def calm_and_windy(way: str, size: float) -> tuple[Floats, int, list[int]]:
    """Tensions (2, 14) of both, unknowns, and factorisations of each wind round."""
    lines = {
        f"{family}{k + 1}": nets.great_circle(RADIUS, HEIGHT, angle, 4.5 * (k - 3))
        for family, angle in (("A", np.pi / 6), ("B", -np.pi / 6))
        for k in range(7)
    }
    # both meshes have vertices of the rim at the ends of the cables: on chords these are too short
    ends = sorted((path[k] for path in lines.values() for k in (0, -1)), key=lambda p: p[1])
    across = {f"at {k}": np.array(ends[k : k + 2]) for k in range(0, len(ends), 2)}
    mesh = meshes.spherical_cap(
        MPI.COMM_WORLD, RADIUS, HEIGHT, size, lines=lines if way == "lines" else across
    )
    scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    scene.fix("boundary")
    for name, path in lines.items():
        where: dict[str, Any] = {"along": name} if way == "lines" else {"path": path}
        # of the arc, not of the facets
        scene.lay_cable(Cable(EA=30e3), L0=length(path), name=name, **where)
    solver, rounds = Solver(scene), list[int]()
    solver.advance(pressure=PRESSURE, steps=2)
    calm = [cable.tension for cable in scene.cables]
    scene.put_wind(GUST, coefficient)
    find = EquilibriumSearch.find

    def counted(search: EquilibriumSearch, prestress: tuple[float, ...]) -> Any:
        outcome = find(search, prestress)
        rounds.append(outcome.factorizations)
        return outcome

    EquilibriumSearch.find = counted  # type: ignore[method-assign]
    try:
        solver.advance(load=1.0, steps=2)
    finally:
        EquilibriumSearch.find = find  # type: ignore[method-assign]
    windy = [cable.tension for cable in scene.cables]
    return np.array([calm, windy]), 3 * solver.system.unknowns.n_global, rounds


def length(path: Floats) -> float:
    """Of the great circle through the ends of a route in plan (length)."""
    ball = (RADIUS**2 + HEIGHT**2) / (2 * HEIGHT)
    up = np.full(2, HEIGHT - ball)
    p, q = np.column_stack([path[[0, -1]], -up])
    return float(ball * np.arccos(p @ q / ball**2))


def cable_net(sizes: Sequence[float] = SIZES) -> dict[str, Floats]:
    """Both ways on three meshes, and where they lead to."""
    found = {}
    print(f"\n{'cable net':12}{'size':>6}{'unknowns':>10}{'s':>7}  calm mean   max   in wind, in "
          "order; factorisations of its rounds")  # fmt: skip
    for way in ("folded", "lines"):
        tensions = []
        for size in sizes:
            seconds, (T, unknowns, rounds) = timed(lambda w=way, h=size: calm_and_windy(w, h))  # type: ignore[misc]
            tensions.append(np.sort(T, axis=1))
            said = " ".join(f"{t:.2f}" for t in tensions[-1][1])
            print(
                f"{way:12}{size:6.2f}{unknowns:10}{seconds:7.1f}{T[0].mean():11.2f}"
                f"{T[0].max():6.2f}   {said}  {rounds}",
                flush=True,
            )
        found[way] = limit(sizes, tensions)
        said = " ".join(f"{t:.2f}" for t in found[way][1])
        print(f"{way:12}limit{found[way][0].mean():29.2f}{found[way][0].max():6.2f}   {said}")
    apart = np.abs(found["lines"] / found["folded"] - 1)
    large = found["folded"][1] > LARGE
    mean = abs(found["lines"][0].mean() / found["folded"][0].mean() - 1)
    print(
        f"limits apart: calm, mean {mean:.2%}; wind, largest {apart[1, -1]:.2%}, all above "
        f"{LARGE:g} kN {apart[1][large].max():.2%}",
        flush=True,
    )
    return found
