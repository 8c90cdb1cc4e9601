"""Each check fires on stiff and soft membranes, and on a weak part beside strong ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from cabled_square import advanced, clamped, put
from mpi4py import MPI
from spoilt_states import alarms, cabled, checked, masts, names, pressing

from crms_fenicsx import Cable, Friction, LaidCable, Solver, meshes
from crms_fenicsx.analysis.verification.verifier import Verifier
from crms_fenicsx.foundation.runtime.arrays import Array

pytestmark = pytest.mark.usefixtures("comm")

BOTH = Friction(0.3, along=0.3)
CABLED = ("stiff membrane", "soft membrane", "weak cable")
FRAMES = {"bars, soft membrane": 1.0, "bars": 100.0, "bars, stiff membrane": 1e6}


def folds(cable: LaidCable) -> list[int]:
    """Nodes with which a cable lies on edges that fold."""
    return [
        k
        for k, node in enumerate(cable.state.nodes)
        if node.kind == "fold" and not cable.state.lifted[k]
    ]


def slide(solver: Solver, k: int, fraction: float) -> None:
    """Put a node of the first cable elsewhere on its edge, and nothing else."""
    cable, shape = solver.scene.cables[0], solver.scene.net.strip_shape()
    ends = shape.current[np.searchsorted(shape.strip.vertices, cable.state.nodes[k].support)]
    put(cable, "fractions", k, fraction)
    put(cable, "positions", k, (1 - fraction) * ends[0] + fraction * ends[1])


def side_ends(solver: Solver, left: bool) -> dict[int, int]:
    """For each fold of the first cable the end of its edge, 0 or 1, on that side of the cable."""
    cable, shape = solver.scene.cables[0], solver.scene.net.strip_shape()
    ends = {}
    for k in folds(cable):
        a, b = shape.current[np.searchsorted(shape.strip.vertices, cable.state.nodes[k].support)]
        ahead = cable.state.positions[k + 1] - cable.state.positions[k - 1]
        ends[k] = int((np.cross(ahead, b - a)[2] > 0.0) == left)
    return ends


def onto_vertex(solver: Solver, aside: float = 0.0) -> int:
    """Put the points on all edges at a vertex beside the cable's middle on it, or beside it."""
    cable = solver.scene.cables[0]
    k = pressing(cable)
    vertex = cable.state.nodes[k].support[side_ends(solver, left=True)[k]]
    for n in folds(cable):
        if vertex in cable.state.nodes[n].support:
            slide(solver, n, abs(cable.state.nodes[n].support.index(vertex) - aside))
    return vertex


def onto_line(solver: Solver) -> None:
    """Put the middle of the cable on the vertices to its left."""
    middle = len(solver.scene.cables[0].state.nodes) // 2
    for k, end in side_ends(solver, left=True).items():
        if abs(k - middle) < 6:
            slide(solver, k, float(end))


def zigzag(solver: Solver) -> None:
    """Slide three points in the cable's middle to and fro on their edges."""
    ends = side_ends(solver, left=True)
    cable = solver.scene.cables[0]
    for i, k in enumerate(sorted(ends, key=lambda n: abs(n - pressing(cable)))[:3]):
        to = ends[k] if i == 0 else 1 - ends[k]
        slide(solver, k, 0.5 * (cable.state.fractions[k] + to))


def swap_places(solver: Solver) -> None:
    """Exchange the edges of two nodes of the cable's path."""
    cable = solver.scene.cables[0]
    nodes, path = list(cable.state.nodes), folds(cable)
    a, b = path[2], path[-3]
    nodes[a], nodes[b] = nodes[b], nodes[a]
    cable.update(nodes=tuple(nodes))


def dip(solver: Solver, depth: float, lifted: bool) -> None:
    """Put a node of the cable under the membrane, by a part of its spans."""
    cable = solver.scene.cables[0]
    k = pressing(cable)
    span = np.linalg.norm(cable.state.positions[k + 1] - cable.state.positions[k - 1])
    if lifted:
        put(cable, "lifted", k, True)
        solver.system.rebuild()
        solver.system.read_scene()
        solver.system.potential.sum_up()
    put(cable, "positions", k, cable.state.positions[k] - [0.0, 0.0, depth * span])


def less_bound(solver: Solver) -> None:
    """Let hardly any friction hold the points at a vertex, which the cable is pulled off."""
    cable = solver.scene.cables[0]
    vertex = onto_vertex(solver)
    grip = cable.state.law.lateral
    assert grip is not None
    bounds = grip.bounds.copy()
    bounds[[vertex in support for support in grip.supports]] *= 1e-3
    cable.update(lateral=replace(grip, bounds=bounds))


def less_friction(solver: Solver, friction: Friction) -> None:
    """Let the cable have had more friction in the solve than it says that it has."""
    cable = solver.scene.cables[0]
    cable.update(cable=replace(cable.cable, friction=friction))


def heated(solver: Solver) -> None:
    """Let friction along the cable have given work."""
    cable = solver.scene.cables[0]
    assert cable.state.law.axial is not None
    loss = -1e-9 * cable.tension * cable.length
    cable.update(axial=replace(cable.state.law.axial, loss=loss))


def turn_end(solver: Solver) -> None:
    """Move the point beside the anchor."""
    cable = solver.scene.cables[0]
    put(cable, "positions", 1, cable.state.positions[1] + 1e-4 * cable.length)


Spoil = Callable[[Solver], object]
SPOILT: dict[str, tuple[str, float | Friction, Spoil]] = {
    "nodes that change places": ("breaks in the path", 0.0, swap_places),
    "a part in compression": (
        "compression", 0.0, lambda s: s.scene.cables[0].update(tension=-1e-6)),
    "a cable called slack": (
        "slack cable too short", 0.0, lambda s: s.scene.cables[0].update(taut=False)),
    "an end that pulls another way": ("pull at the ends", 0.0, turn_end),
    "a point pulled outward": ("pull on the membrane", 0.0, lambda s: dip(s, 0.2, lifted=False)),
    "a point under the membrane": (
        "depth below the membrane", 0.0, lambda s: dip(s, 0.01, lifted=True)),
    "points on a line": ("held by a line of the mesh", 0.0, onto_line),
    "points on a vertex": ("held by vertices", 0.0, onto_vertex),
    "points on a vertex, friction": ("held by vertices", 0.3, onto_vertex),
    "points beside a vertex": (
        "friction beyond its bound", 0.3, lambda s: onto_vertex(s, aside=0.003)),
    "points beside a vertex, both frictions": ("held by vertices", BOTH, onto_vertex),
    "a vertex with less friction": ("held by vertices", 0.3, less_bound),
    "points to and fro": ("sideways force without friction", 0.0, zigzag),
    "points to and fro, friction": ("friction beyond its bound", 0.3, zigzag),
    "points to and fro, both frictions": ("friction beyond its bound", BOTH, zigzag),
    "less friction along": (
        "friction along beyond its bound", BOTH,
        lambda s: less_friction(s, Friction(0.3, along=0.03))),
    "friction that gives work": ("negative dissipation", BOTH, heated),
}  # fmt: skip


@pytest.mark.ranks
@pytest.mark.parametrize("name", CABLED)
@pytest.mark.parametrize("what", SPOILT)
def test_what_is_wrong_with_one_cable_is_found(comm: MPI.Intracomm, name: str, what: str) -> None:
    """On any membrane, and beside cables of much more force; told of this cable."""
    check, friction, spoil = SPOILT[what]
    solver = cabled(comm, name, friction)
    assert alarms(solver) == set()
    found = checked(solver, lambda: spoil(solver))
    assert check in names(found)
    assert found[check].where == solver.scene.cables[0].name


@pytest.mark.ranks
@pytest.mark.parametrize("name", CABLED)
def test_crossing_cables_apart_are_found(comm: MPI.Intracomm, name: str) -> None:
    """By a millionth of the length."""
    solver = cabled(comm, name, crossed=True)
    cable = solver.scene.cables[1]
    (k,) = (n for n, node in enumerate(cable.state.nodes) if node.kind == "crossing")
    assert "crossing cables apart" not in alarms(solver)

    def spoil() -> None:
        put(cable, "positions", k, cable.state.positions[k] + 1e-6 * cable.length)

    assert "crossing cables apart" in names(checked(solver, spoil))


def test_clamps_that_hold_nothing_are_found(comm: MPI.Intracomm) -> None:
    lines = {"a": [(0.0, 47.0), (100.0, 56.0)], "b": [(47.0, 0.0), (56.0, 100.0)]}
    scene = clamped(meshes.rectangle(comm, 100.0, 100.0, 15.0, lines=lines))
    cables = [scene.lay_cable(Cable(3e4), along=name, L0=100.0) for name in lines]
    scene.clamp(*cables)
    solver = advanced(Solver(scene), pressure=0.01)
    assert alarms(solver) == set()
    found = checked(solver, lambda: cables[0].update(parts=None))
    assert "clamps that hold nothing" in names(found)


@pytest.mark.parametrize(("name", "EA"), [("stiff membrane", 0.03), ("weak cable", 0.03)])
def test_cables_held_by_edges_that_the_pressure_bulges_are_found(
    comm: MPI.Intracomm, name: str, EA: float
) -> None:
    """As the solver leaves them: their tension is too small beside pressure times h^2."""
    solver = cabled(comm, name, pressure=0.01, EA=EA)
    assert "sideways force without friction" in alarms(solver)


def solved(comm: MPI.Intracomm, name: str) -> Solver:
    """A scene with cables or with bars."""
    if name in FRAMES:
        return masts(comm, FRAMES[name])
    return cabled(comm, name)


WORKING = ("stiff membrane", "tiny forces", *FRAMES)
"""Scenes whose largest forces do work. In the others these are those of cables on held edges, which
slide along them only: beside these the energy of a smaller force is not seen."""


@pytest.mark.ranks
@pytest.mark.parametrize("name", WORKING)
def test_a_wrong_energy_is_found(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """By virtual work alone; that of the term with the largest forces on what is free."""
    solver = solved(comm, name)
    potential, held = solver.system.potential, solver.system.unknowns.held
    assert alarms(solver) == set()
    forces: list[float] = []
    for term in potential.terms:
        g = np.zeros_like(potential.g)
        term.add_gradient(potential.x, potential.sums_of(term), g)
        g[: len(held)][held] = 0.0
        forces.append(comm.allreduce(float(np.vdot(g, g)), op=MPI.SUM))
    own = potential.terms[int(np.argmax(forces))]
    energy = own.energy
    monkeypatch.setattr(own, "energy", lambda sums: 1.5 * energy(sums))
    assert names(checked(solver)) == {"virtual work"}


BALANCE = ("unbalanced forces", "sum of supports and loads", "moment of supports and loads")


@pytest.mark.ranks
@pytest.mark.parametrize("name", [*CABLED, *FRAMES])
def test_what_is_wrong_with_the_whole_scene_is_found(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """Other loads than the potential's, supports off their way, and no numbers."""
    solver = solved(comm, name)
    scene, unknowns = solver.scene, solver.system.unknowns
    assert alarms(solver) == set()
    right = unknowns.X[:, 0] > scene.membrane.centre[0]
    loads = Verifier._loads
    with monkeypatch.context() as patch:
        patch.setattr(Verifier, "_loads", lambda *own: loads(*own) * (1 + right)[:, None])
        assert set(BALANCE) <= names(checked(solver))
    u: Array = scene.u.x.array.reshape(-1, 3)

    def shift() -> None:
        u[scene.held.all(axis=1)] += 1e-10 * scene.membrane.size

    assert "supports off their place" in names(checked(solver, shift))

    def lose() -> None:
        solver.system.potential.x[: unknowns.n_owned] = np.nan

    assert names(checked(solver, lose)) == {"values not finite"}


@pytest.mark.parametrize("name", CABLED)
def test_a_floor_run_through_is_found(comm: MPI.Intracomm, name: str) -> None:
    """By a part of the size that is rounding for nobody."""
    solver = cabled(comm, name, floor=-60.0)
    scene = solver.scene

    def sink() -> None:
        z = scene.u.x.array.reshape(-1, 3)[~scene.held[:, 2], 2]
        scene.u.x.array.reshape(-1, 3)[~scene.held[:, 2], 2] = np.full_like(z, -60.0 - 1e-9)

    assert "depth below the floor" not in alarms(solver)
    assert "depth below the floor" in names(checked(solver, sink))
