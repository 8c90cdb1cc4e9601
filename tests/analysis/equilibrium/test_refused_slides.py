"""Lines that would slide over what stays on the fabric, and friction that cannot act on a line: by
name, with a remedy, on all processes, and the scene keeps its last good state."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import FOIL, SIDE
from grids import alternating, grid, numbered
from mpi4py import MPI
from same_state import assert_same_state
from sliding_rows import EA, PRESSURE

from crms_fenicsx import (
    Bar,
    Cable,
    ConvergenceError,
    Friction,
    InputError,
    IsotropicMembrane,
    LaidCable,
    Scene,
    Solver,
    meshes,
)

OTHER = IsotropicMembrane(E=400.0, nu=0.25, thickness=0.08)
K, LOW, HIGH = 20, 4, 6


def obstructed(comm: MPI.Intracomm, what: str) -> tuple[Scene, LaidCable]:
    """A square with the line "A", laid in an arc and slack, which pulled taut would rest beyond
    the arc "B" that does not move."""
    at, numbers = np.linspace(0.0, SIDE, K + 1), numbered(K + 1, K + 1)
    points, cells = grid(at, at, other=alternating(K, K))
    for i, x in enumerate(at):
        aside = np.sin(np.pi * x / SIDE)
        y = [0.0, 20.0 + 25.0 * aside, 30.0 + 30.0 * aside, SIDE]
        points[numbers[i], 1] = np.interp(np.arange(K + 1), [0, LOW, HIGH, K], y)
    rows = {"A": numbers[:, HIGH], "B": numbers[:, LOW]}
    edges = {name: np.stack([row[:-1], row[1:]], axis=1) for name, row in rows.items()}
    squares = np.arange(len(cells)) // 2 % K
    parts = {"low": np.flatnonzero(squares < LOW), "high": np.flatnonzero(squares >= LOW)}
    mesh = meshes.from_arrays(comm, points, cells, edges=edges, parts=parts)
    scene = Scene(mesh, {"low": OTHER, "high": FOIL} if what == "material" else FOIL)
    scene.fix("boundary")
    if what == "row":
        scene.lay_cable(Cable(EA), along="B", hold="pocket")
    if what == "joint":
        x, y, z = points[numbers[K // 2, LOW]]
        scene.add_bar(Bar(EA=1.0), scene.vertex_at((x, y, z)), (x, y, z + 30.0))
    return scene, scene.lay_cable(Cable(EA), along="A", L0=140.0)


WORDS = {
    "material": "the border of another part or material",
    "row": "B, which it cannot pass",
    "joint": "a joint",
    "rim": "a support",
}


@pytest.mark.ranks
@pytest.mark.parametrize("what", WORDS)
def test_slides_over_what_stays(comm: MPI.Intracomm, what: str) -> None:
    scene, cable = obstructed(comm, what)
    if what == "rim":  # "A" is laid far from the rim, and its supports move nowhere
        scene.fix(lambda x: np.abs(x[1] - (20.0 + 25.0 * np.sin(np.pi * x[0] / SIDE))) < 10.0)
    solver = Solver(scene, max_halvings=0)
    solver.advance(pressure=PRESSURE)
    kept = solver.snapshot()
    with pytest.raises(ConvergenceError) as told:
        solver.advance(L0={cable: SIDE})
    words = ("A would slide so far", WORDS[what], "slide=False", "by its path")
    assert all(some in str(told.value) for some in words), str(told.value)
    assert_same_state(scene.state, kept)


def beside(comm: MPI.Intracomm, gap: float) -> tuple[Scene, list[LaidCable]]:
    """Two lines with one cell in between whose cables pull them to a distance; under pressure the
    fabric between them draws them together."""
    at, numbers = np.linspace(0.0, SIDE, K + 1), numbered(K + 1, K + 1)
    points, cells = grid(at, at, other=alternating(K, K))
    for i, x in enumerate(at):
        aside = 8.0 * np.sin(np.pi * x / SIDE)
        y = [0.0, 30.0 - aside, 30.0 + gap + aside, SIDE]
        points[numbers[i], 1] = np.interp(np.arange(K + 1), [0, 6, 7, K], y)
    rows = {"A": numbers[:, 6], "B": numbers[:, 7]}
    edges = {name: np.stack([row[:-1], row[1:]], axis=1) for name, row in rows.items()}
    scene = Scene(meshes.from_arrays(comm, points, cells, edges=edges), FOIL)
    scene.fix("boundary")
    return scene, [scene.lay_cable(Cable(EA), along=name, L0=SIDE) for name in rows]


@pytest.mark.ranks
@pytest.mark.parametrize("gap", [0.3, 0.005])
def test_lines_that_come_to_lie_on_each_other(comm: MPI.Intracomm, gap: float) -> None:
    """Both are named, and what lines cannot do; the larger gap ended never."""
    scene, _ = beside(comm, gap)
    kept = scene.state
    with pytest.raises(ConvergenceError, match=r"come so close to each other.*without `along`"):
        Solver(scene, max_halvings=0).advance(pressure=PRESSURE)
    assert_same_state(scene.state, kept)


def test_lines_that_come_to_lie_side_by_side(comm: MPI.Intracomm) -> None:
    """At a twentieth of a cell."""
    scene, cables = beside(comm, 1.0)
    step = Solver(scene).advance(pressure=PRESSURE)
    assert step.verification.passed
    one, other = (cable.state.positions[1:-1] for cable in cables)
    assert 0.1 < np.linalg.norm(one - other, axis=1).min() < 0.3


@pytest.mark.ranks
def test_friction_that_cannot_act_on_a_line(comm: MPI.Intracomm) -> None:
    """The paper's friction elements belong to edges that a cable crosses."""
    scene, _ = obstructed(comm, "none")
    before = scene.state
    rope = Cable(EA, friction=Friction(0.1, law="step"))
    with pytest.raises(InputError, match=r"'B'.*law=\"step\".*coulomb.*without `along`"):
        scene.lay_cable(rope, along="B")
    assert_same_state(scene.state, before)
