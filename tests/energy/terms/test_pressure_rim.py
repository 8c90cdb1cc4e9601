"""Pressure on membranes whose edges slide in planes, as those of symmetric cells, or are free."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from cabled_square import advanced
from grids import grid
from mpi4py import MPI
from scipy.optimize import brentq

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Scene, Solver, meshes

FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
Place = Callable[[np.ndarray], bool]


def sheet(
    comm: MPI.Intracomm, x: np.ndarray, y: np.ndarray, edges: dict[str, Place], **laws: str
) -> Scene:
    """A flat sheet whose diagonals mirror at x = 50 and y = 50, with groups of its rim."""
    points, cells = grid(x, y, other=np.not_equal.outer(x[1:] <= 50.0, y[1:] <= 50.0), by_rows=True)
    sides = Counter(tuple(sorted((t[k], t[k - 1]))) for t in cells.tolist() for k in range(3))
    rim = [side for side, times in sides.items() if times == 1]
    groups = {
        name: [side for side in rim if all(where(points[k]) for k in side)]
        for name, where in edges.items()
    }
    return Scene(meshes.from_arrays(comm, points, cells, edges=groups), FOIL, **laws)


def square(comm: MPI.Intracomm, part: str) -> Scene:
    """The square of 100, or its half or quarter, held in the planes of symmetry."""
    lines = np.linspace(0.0, 100.0, 11)
    x = lines[:6] if part == "quarter" else lines
    y = lines if part == "whole" else lines[:6]
    edges: dict[str, Place] = {"outer": lambda p: p[0] in (0, 100) or p[1] in (0, 100)}
    if part != "whole":
        edges["y"] = lambda p: p[1] == 50.0
    if part == "quarter":
        edges["x"] = lambda p: p[0] == 50.0
    scene = sheet(comm, x, y, edges)
    scene.fix("outer")
    for name in sorted(edges.keys() - {"outer"}):
        scene.fix(name, name)
    return scene


@pytest.mark.ranks
def test_parts_of_a_symmetric_square(comm: MPI.Intracomm) -> None:
    """Energy and volume are those of the whole, also with a cable across the plane."""
    found: dict[str, list[np.ndarray]] = {}
    for part, times in (("whole", 1), ("half", 2), ("quarter", 4)):
        scene, values = square(comm, part), []
        solver = Solver(scene)
        for pressure in (0.01, 0.3):
            solver.advance(pressure=pressure)
            assert scene.energies["pressure"] == pytest.approx(-pressure * scene.volume, rel=1e-12)
            values.append(times * np.array([scene.energy, scene.volume]))
        if part != "quarter":
            solver.advance(pressure=0.01)
            end, L0 = (100.0, 100.5) if part == "whole" else (50.0, 50.25)
            cable = scene.lay_cable(Cable(32000.0), [(50.0, 0.0), (50.0, end)], L0=L0)
            solver.advance()
            values.append(np.array([times * scene.energy, cable.tension]))
        found[part] = values
    for part in ("half", "quarter"):
        for one, other in zip(found[part], found["whole"], strict=False):
            np.testing.assert_allclose(one, other, rtol=1e-9)


def test_a_strip_cut_on_both_sides_is_a_cylinder(comm: MPI.Intracomm) -> None:
    """Its planes are parallel, so that no point lies in both; of second order."""
    Et, nu, L, b, p = 24.0, 0.25, 100.0, 30.0, 0.1

    def unbalanced(R: float) -> float:
        stretch = 2 * R * np.arcsin(L / 2 / R) / L
        return stretch * Et / (1 - nu**2) * (stretch**2 - 1) / 2 - p * R

    R = brentq(unbalanced, 50.0001, 5000.0)
    angle = np.arcsin(L / 2 / R)
    volume = b * R**2 * (angle - np.sin(angle) * np.cos(angle))
    strain = ((2 * R * angle / L) ** 2 - 1) / 2
    energy = Et / (1 - nu**2) * strain**2 / 2 * L * b - p * volume
    errors = []
    for n in (8, 16, 32):
        edges: dict[str, Place] = {
            "ends": lambda q: q[0] in (0, 100),
            "sides": lambda q: q[1] in (7, 37),
        }
        scene = sheet(comm, np.linspace(0, L, n + 1), np.array([7.0, 22.0, 37.0]), edges)
        scene.fix("ends")
        scene.fix("sides", "y")
        solver = advanced(Solver(scene), pressure=p)
        errors.append([scene.volume / volume - 1, scene.energy / energy - 1])
    np.testing.assert_allclose(errors[-1], 0.0, atol=1e-3)
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(rates, 2.0, atol=0.02)
    scene.fix("sides", "z")  # held as it is: moved aside and back it is what it was
    before = scene.energy
    solver.advance(move={"sides": (0.0, 3.0, 0.0)})
    assert abs(scene.energy / before - 1) > 1e-4
    assert scene.energies["pressure"] == pytest.approx(-p * scene.volume, rel=1e-12)
    solver.advance(move={"sides": (0.0, -3.0, 0.0)})
    assert scene.energy == pytest.approx(before, rel=1e-9)


def test_a_cable_that_folds_a_sliding_edge_is_refused(comm: MPI.Intracomm) -> None:
    """Its point there does not stay in the plane."""
    scene = square(comm, "half")
    scene.lay_cable(Cable(32000.0), [(43.0, 0.0, 0.0), (43.0, 70.0, 0.0)], name="ridge")
    with pytest.raises(InputError, match=r"edge slides in a plane, but 'ridge' .* end there"):
        Solver(scene).advance(pressure=0.01)


@pytest.mark.ranks
def test_free_edges_are_in_equilibrium_with_the_follower_pressure(comm: MPI.Intracomm) -> None:
    """After one call with lagged pressure, whatever the steps; with a cable too."""
    energies = []
    for steps in (1, 3):
        edges: dict[str, Place] = {"ends": lambda q: q[0] in (0, 100)}
        lines = np.linspace(0.0, 100.0, 9)
        scene = sheet(comm, lines, lines, edges, pressure="lagged")
        scene.fix("ends")
        cable = scene.lay_cable(Cable(32000.0), [(0.0, 43.0), (100.0, 43.0)], L0=104.0)
        solver = advanced(Solver(scene), pressure=0.05, steps=steps)
        load = comm.allreduce(0.05 * solver.system.pressed_facets()[1].sum(axis=0))
        held = solver.reactions("ends").total
        np.testing.assert_allclose(held, -load, atol=1e-7 * np.abs(load).max())
        energies.append(scene.energies["membrane"] + scene.energies["cables"])
        assert len(solver.steps) == steps
    assert cable.tension > 1.0
    assert energies[0] == pytest.approx(energies[1], rel=1e-7)
