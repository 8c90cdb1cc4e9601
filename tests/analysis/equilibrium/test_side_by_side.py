"""Cables with diameters along lines side by side: they slide until they touch, press, and part."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cabled_square import SIDE
from grids import Floats, alternating, grid, numbered
from mpi4py import MPI
from same_state import assert_same_state
from sliding_rows import EA, PRESSURE

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    InputError,
    IsotropicMembrane,
    LaidCable,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.equilibrium.cable_contribution import CableContribution
from crms_fenicsx.analysis.verification.row_checks import row_checks
from crms_fenicsx.cabling.contact.side_by_side import facing_on_mesh, overlaps

FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
STIFF = IsotropicMembrane(E=1e3, nu=0.3, thickness=1.0, wrinkling=False)
SLOPE = 2.0
"""Of the square of the waisted surface's radius: r^2 = 1 + SLOPE z^2."""


def waisted(comm: MPI.Intracomm, n: int, diameter: float, bow: float) -> tuple[Scene, LaidCable]:
    """Half a rigid hyperboloid with two cables around it whose ends lie a diameter apart, and whose
    middles lie farther from the waist, to which they slide."""

    def place(x: Floats, y: Floats) -> Floats:
        return 0.0 * x

    heights = np.array([-3.0, -1.5, -1.0, 0.0, 1.0, 1.5, 3.0])
    points, cells = grid(np.linspace(0.0, np.pi, n + 1), heights, place, alternating(n, 6))
    angle, z = points[:, 0], diameter / 2 * points[:, 1]
    z *= 1.0 + bow * np.sin(angle) * (np.abs(points[:, 1]) < 2.0)
    r = np.sqrt(1.0 + SLOPE * z**2)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    number = numbered(n + 1, 7)
    rows = {"A": number[:, 2], "B": number[:, 4]}
    edges = {name: np.stack([row[:-1], row[1:]], axis=1) for name, row in rows.items()}
    scene = Scene(meshes.from_arrays(comm, points, cells, edges=edges, outside=(0, 1, 0)), STIFF)
    scene.fix(lambda x: np.full(x.shape[1], True))
    for name in rows:
        scene.lay_cable(Cable(EA=10.0, diameter=diameter), along=name)
    return scene, scene.cables[0]


@pytest.mark.ranks
def test_known_side_forces(comm: MPI.Intracomm) -> None:
    """On a rigid waist a parallel's geodesic curvature times the tension presses on the other; the
    same on any number of processes, where vertices that face each other belong to several."""
    D, errors = 0.4, []
    for n in (20, 40):
        scene, cable = waisted(comm, n, D, 0.5)
        solver = Solver(scene, rtol=1e-10)
        step = solver.advance(L0=dict.fromkeys(scene.cables, 3.1))
        assert step.verification.passed and not step.verification.doubtful
        assert np.abs(cable.line[:, 2] + D / 2).max() < 1e-4 * D
        without = row_checks(solver.system, unloaded(solver), scene.net.strip_shape(), {})
        assert without[cable]["sideways balance"] > 0.1  # the verification counts what touches
        r = np.sqrt(1.0 + SLOPE * (D / 2) ** 2)
        rise = SLOPE * (D / 2) / r
        known = cable.tension * rise / np.hypot(1.0, rise) * np.pi * (1.0 - 1.0 / n)
        one, other = (solver.contact_forces(own).beside.sum(axis=0) for own in scene.cables)
        np.testing.assert_allclose(one, -other, rtol=0.0, atol=1e-12)
        assert np.abs(one[:2]).max() < 1e-3 * known
        errors.append(abs(one[2] / known + 1.0))
    assert cable.tension == pytest.approx(0.547904044, rel=1e-8)
    assert errors[1] < 3e-3 and errors[1] < 0.5 * errors[0]


def beside(
    comm: MPI.Intracomm, gap: float, diameter: float, *, k: int = 20, between: int = 1, **law: Any
) -> tuple[Scene, list[LaidCable]]:
    """Two lines on a square with some cells in between whose cables pull them to a distance; under
    pressure the fabric between them draws them together."""
    at, numbers = np.linspace(0.0, SIDE, k + 1), numbered(k + 1, k + 1)
    points, cells = grid(at, at, other=alternating(k, k))
    a = round(0.3 * k)
    b = a + between
    for i, x in enumerate(at):
        aside = 8.0 * np.sin(np.pi * x / SIDE)
        y = [0.0, 30.0 - aside, 30.0 + gap + aside, SIDE]
        points[numbers[i], 1] = np.interp(np.arange(k + 1), [0, a, b, k], y)
    rows = {"A": numbers[:, a], "B": numbers[:, b]}
    edges = {name: np.stack([row[:-1], row[1:]], axis=1) for name, row in rows.items()}
    scene = Scene(meshes.from_arrays(comm, points, cells, edges=edges), FOIL)
    scene.fix("boundary")
    rope = Cable(EA, diameter=diameter, **law)
    return scene, [scene.lay_cable(rope, along=name, L0=SIDE) for name in rows]


def unloaded(solver: Solver) -> Floats:
    """No forces on the blocks of a solver's layout."""
    return np.zeros((solver.system.unknowns.n_local, 3))


def distances(cables: list[LaidCable]) -> Floats:
    """Distances of vertices that lie opposite each other, without the ends."""
    one, other = (cable.state.positions[1:-1] for cable in cables)
    return np.linalg.norm(one - other, axis=1)


@pytest.mark.ranks
def test_they_touch_part_and_touch_again(comm: MPI.Intracomm) -> None:
    """Cells between them become a 300th of their first width; the state does not depend on the
    way, nor on the number of processes."""
    scene, cables = beside(comm, 0.3, 0.05)
    solver = Solver(scene, rtol=1e-10)
    known = [67.962663208, 69.734910612]
    for way in range(2):
        step = solver.advance(pressure=PRESSURE, L0=dict.fromkeys(cables, SIDE))
        assert step.verification.passed and not step.verification.doubtful
        assert step.verification["depth in a cable beside"].value < 2e-4
        assert 0.9998 * 0.05 < distances(cables).min() < 0.05
        assert (distances(cables) < 0.0502).sum() >= 9
        assert [cable.tension for cable in cables] == pytest.approx(known, rel=1e-7), way
        solver.advance(pressure=PRESSURE / 4, L0={cables[0]: 1.02 * SIDE})
        assert distances(cables).min() > 0.25
        assert not solver.contact_forces(cables[0]).beside.any()


@pytest.mark.ranks
@pytest.mark.parametrize("told", [True, False])
def test_they_meet_from_afar(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, told: bool
) -> None:
    """Vertices that are too far apart to touch at the start are told of each other on the way;
    those that are not run into each other, which makes the state doubtful."""
    if not told:
        monkeypatch.setattr(CableContribution, "faces_all", True)
    scene, cables = beside(comm, 3.0, 2.5, between=3)
    step = Solver(scene, max_halvings=0).advance(pressure=PRESSURE)
    depth = step.verification["depth in a cable beside"]
    assert step.verification.passed
    if not told:
        assert depth.value > 0.01 and depth in step.verification.doubtful
        return
    assert not step.verification.doubtful
    assert depth.value < 2e-4
    assert 2.499 < distances(cables).min() < 2.5


@pytest.mark.ranks
def test_friction_beside(comm: MPI.Intracomm) -> None:
    """What a cable beside it carries is no friction: it is several times as large here."""
    scene, cables = beside(comm, 0.3, 0.2, friction=0.02)
    solver = Solver(scene)
    step = solver.advance(pressure=PRESSURE)
    assert step.verification.passed and not step.verification.doubtful
    assert step.verification["friction beyond its bound"].value < 1e-2
    assert distances(cables).min() == pytest.approx(0.2, rel=1e-3)
    forces = solver.contact_forces(cables[0])
    middle = slice(8, 13)
    assert (np.abs(forces.beside[middle, 1]) > 4 * 0.02 * forces.bearing[middle]).all()
    assert (np.abs(forces.lateral[middle]) < 1.1 * 0.02 * forces.bearing[middle]).all()


def test_too_thin_for_their_diameters(comm: MPI.Intracomm) -> None:
    """Cells collapse where cables touch at less than a thousandth of their first distance."""
    scene, _ = beside(comm, 0.3, 0.01)
    kept = scene.state
    with pytest.raises(ConvergenceError, match=r"A and B|B and A.*before they touch.*nearer"):
        Solver(scene, max_halvings=0).advance(pressure=PRESSURE)
    assert_same_state(scene.state, kept)


def refused(scene: Scene, cables: list[LaidCable], one: float, other: float, *words: str) -> None:
    """In place of two cables, the second of two with these diameters is refused in some words."""
    for cable in cables:
        scene.remove(cable)
    scene.lay_cable(Cable(EA, diameter=one), along="A", name="one")
    kept = scene.state
    with pytest.raises(InputError) as told:
        scene.lay_cable(Cable(EA, diameter=other), along="B", name="other")
    for word in words:
        assert word in str(told.value)
    assert_same_state(scene.state, kept)


@pytest.mark.ranks
def test_laid_too_near(comm: MPI.Intracomm) -> None:
    """The refusal names both cables, their distance and diameters, and what to do."""
    scene, cables = beside(comm, 0.3, 0.25)
    words = "'one' would lie 0.3 from 'other'", "0.2 and 0.5", "at 0.35", "further apart"
    refused(scene, cables, 0.2, 0.5, *words)
    scene.lay_cable(Cable(EA, diameter=0.39), along="B", name="other")


def belts(
    comm: MPI.Intracomm, diameter: float, *, k: int = 20, most: float = 8.0
) -> tuple[Scene, list[LaidCable]]:
    """Two lines between the same two points of a square's rim, `most` beside the straight line in
    their middles."""
    a, at, numbers = round(0.3 * k), np.linspace(0.0, SIDE, k + 1), numbered(k + 1, k + 1)
    points, cells = grid(at, at, other=alternating(k, k) ^ (a % 2 == 1))
    for i, x in enumerate(at):
        aside = most * np.sin(np.pi * x / SIDE) if 0 < i < k else SIDE / k
        y = [0.0, 30.0 - aside, 30.0, 30.0 + aside, SIDE]
        points[numbers[i], 1] = np.interp(np.arange(k + 1), [0, a - 1, a, a + 1, k], y)
    edges = {}
    for name, row in (("A", a - 1), ("B", a + 1)):
        line = np.concatenate([numbers[:1, a], numbers[1:-1, row], numbers[-1:, a]])
        edges[name] = np.stack([line[:-1], line[1:]], axis=1)
    scene = Scene(meshes.from_arrays(comm, points, cells, edges=edges), FOIL)
    scene.fix("boundary")
    rope = Cable(EA, diameter=diameter)
    return scene, [scene.lay_cable(rope, along=name, L0=SIDE) for name in edges]


@pytest.mark.ranks
@pytest.mark.parametrize("diameter", [0.5, 0.05])
def test_belts_from_common_anchors(comm: MPI.Intracomm, diameter: float) -> None:
    """They touch from their first vertices beyond the anchors on, where the cables part by the
    wedge between them: T D / 2 l on the first vertex at a distance l."""
    scene, cables = belts(comm, diameter)
    solver = Solver(scene, rtol=1e-10)
    step = solver.advance(pressure=PRESSURE)
    assert step.verification.passed and not step.verification.doubtful
    gaps = np.linalg.norm(cables[0].line[1:-1] - cables[1].line[1:-1], axis=1) / diameter
    assert 0.99 < gaps.min() and gaps.max() < 1.0002 and (gaps[1:-1] > 0.9998).all()
    known = [cable.tension for cable in cables]
    forces = [solver.contact_forces(cable).beside[:, 1] for cable in cables]
    assert sum(forces[0]) == pytest.approx(-sum(forces[1]), rel=1e-12)
    for cable, force, sign in zip(cables, forces, (-1.0, 1.0), strict=True):
        along = float(np.median(sign * force[3:-3]))
        first = float(np.linalg.norm(cable.line[1] - cable.line[0]))
        wedge = cable.tension * diameter / 2 / first
        assert 0.98 * wedge < sign * force[1] < 1.02 * wedge + along
        assert 0.08 < along < 0.15 and np.ptp(force[3:-3]) < 0.4 * along
    solver.advance(pressure=PRESSURE / 4, L0={cables[0]: 1.02 * SIDE})
    assert not solver.contact_forces(cables[0]).beside[2:-2].any()
    solver.advance(pressure=PRESSURE, L0=dict.fromkeys(cables, SIDE))
    assert [cable.tension for cable in cables] == pytest.approx(known, rel=1e-7)


@pytest.mark.ranks
def test_which_vertices_of_crossing_cables_face_each_other(comm: MPI.Intracomm) -> None:
    """Of two cables from one corner those farther apart on the mesh than both radii, none of a
    third one that crosses them at large angles: there one lies on top."""
    D = 5.0
    lines = {"a": [(0.0, 0.0), (100.0, 30.0)], "b": [(0.0, 0.0), (100.0, 60.0)],
             "c": [(0.0, 90.0), (100.0, 20.0)]}  # fmt: skip
    scene = Scene(meshes.rectangle(comm, SIDE, SIDE, 10.0, lines=lines), FOIL)
    scene.fix("boundary")
    for name in lines:
        scene.lay_cable(Cable(EA, diameter=D), along=name).update(taut=True)
    assert not overlaps(scene.net)
    nodes = scene.net.nodes
    found = facing_on_mesh(scene.net, scene.materials.values())
    rows, chains = found.blocks[found.pointers[:-1]], found.blocks
    assert set(nodes.cable[chains]) == {0, 1} and len(set(nodes.cable[rows])) == 1
    own = scene.cables[int(nodes.cable[rows[0]])].state.positions
    way = np.array(lines["b" if nodes.cable[rows[0]] == 0 else "a"][1])
    x, y = own[:, 0], own[:, 1]
    away = np.abs(x * way[1] - y * way[0]) / np.hypot(*way)
    beyond = np.flatnonzero((away > D) & (away < D + 10.0))
    assert set(beyond) <= set(nodes.place[rows]) <= set(np.flatnonzero(away > D))
    assert beyond[0] > 1  # some lie on the other cable


@pytest.mark.ranks
def test_belts_that_never_part(comm: MPI.Intracomm) -> None:
    """They would have no contact anywhere, which is refused; two along one line are stacked."""
    scene, cables = belts(comm, 0.5)
    words = "'one'", "'other'", "common vertex", "16.5", "20 and 13", "no contact", "smaller"
    refused(scene, cables, 20.0, 13.0, *words)
    scene.lay_cable(Cable(EA, diameter=11.0), along="B", name="other")
    scene.lay_cable(Cable(EA, diameter=20.0), along="A", name="on top")


def test_diameter_across_the_cells(comm: MPI.Intracomm) -> None:
    """There cables know nothing of each other beside them."""
    scene, _ = beside(comm, 0.3, 0.25)
    kept = scene.state
    with pytest.raises(InputError, match=r"'C'.*diameter 0\.2 but lies across.*along a line"):
        scene.lay_cable(Cable(EA, diameter=0.2), [(0.0, 80.0), (100.0, 80.0)], name="C")
    assert_same_state(scene.state, kept)


@pytest.mark.parametrize("diameter", [-0.1, np.nan, np.inf, "20 mm", None])
def test_bad_diameters(diameter: Any) -> None:
    with pytest.raises(InputError, match=r"Cable: diameter"):
        Cable(EA, diameter=diameter)
