"""Friction along cables on lines of the mesh where two of them cross: the fabric, which slides
below both, takes all of it, and the other cable none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import simpson
from scipy.optimize import minimize
from taylor import OnMesh, dense, gradient_order, is_semidefinite, noise
from term_scene import on_mesh

from crms_fenicsx import Cable, Friction, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.verification.row_checks import row_checks
from crms_fenicsx.cabling.contact.contact_force import forces_at
from crms_fenicsx.cabling.friction.axial import (
    RestPlaces,
    _rest_at,
    gripped_nodes,
    reference_arcs,
)
from crms_fenicsx.energy.terms.axial_friction import CapstanTension
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.friction import AxialFrictionState

EA, TENSION = 1e3, 5.0
STRETCH = 1 + TENSION / EA
OFF_CENTRE = {"a": [(0.0, 3.0), (10.0, 6.0)], "b": [(2.0, 0.0), (5.0, 10.0)]}
EVEN = {"a": [(0.0, 4.0), (10.0, 6.0)], "b": [(4.0, 0.0), (6.0, 10.0)]}
Lines = Mapping[str, Sequence[tuple[float, float]]]


def crossed(
    comm: MPI.Intracomm, along: float = 0.1, lines: Lines = OFF_CENTRE, lined: bool = True
) -> Scene:
    """Two cables that cross on a square of 10, along lines or across the cells."""
    given = {name: list(path) for name, path in lines.items()}
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.3, lines=given if lined else None)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0))
    scene.fix("boundary")
    rope = Cable(EA, friction=Friction(0.0, along=along))
    for name, path in given.items():
        choice: dict[str, Any] = {"along": name} if lined else {"path": path}
        scene.lay_cable(rope, tension=TENSION, **choice)
    return scene


def common(cables: Sequence[LaidCable]) -> list[int]:
    """Node of each of two cables at their common vertex."""
    at = [{n.support: k for k, n in enumerate(c.state.nodes) if n.kind == "vertex"} for c in cables]
    (vertex,) = at[0].keys() & at[1].keys()
    return [own[vertex] for own in at]


def test_a_shifted_place_takes_cable_along_by_hand(comm: MPI.Intracomm) -> None:
    """On a sheet with one gradient F a place that shifts by w moves by F w; the part along the
    cable, unstressed, is new rest arc. On the flat sheet this is what rests beside the vertex."""
    scene = crossed(comm)
    starts = [cable.state.positions for cable in scene.cables]
    for F in (np.eye(3), np.array([[1.04, 0.03, 0.0], [0.01, 0.98, 0.0], [0.2, 0.1, 1.0]])):
        X = scene.membrane.stress_free
        scene.u.x.array[:] = (X @ F.T - X).ravel()
        shape = scene.net.strip_shape()
        for cable, k, places in zip(scene.cables, common(scene.cables), starts, strict=True):
            cable.update(positions=places @ F.T)
            way = (places[-1] - places[0]) / np.linalg.norm(places[-1] - places[0])
            found, grip = reference_arcs(cable, shape), cable.state.law.axial
            assert grip is not None
            along = F.T @ F @ way / np.linalg.norm(F @ way) / STRETCH
            by_shift = found.by_shift[found.nodes.index(k)]
            np.testing.assert_allclose(by_shift[:2], along[:2], atol=1e-12)
            beside = _rest_at(grip, places[k] + np.outer([0.0, 0.01], way))
            assert np.diff(beside)[0] == pytest.approx(0.01 / STRETCH, rel=1e-9)


def rubbing(comm: MPI.Intracomm, bound: float, eps: float) -> System:
    """Before a solve, with given bounds of about this size."""
    scene, rng = crossed(comm), np.random.default_rng(0)
    for cable in scene.cables:
        grip = cable.state.law.axial
        assert grip is not None
        n = len(grip.supports)
        bounds = bound * rng.uniform(0.5, 1.5, n)
        cable.update(axial=replace(grip, bounds=bounds, eps=np.full(n, eps)))
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    return system


def term_of(f: OnMesh) -> CapstanTension:
    (term,) = f.potential.terms
    assert isinstance(term, CapstanTension)
    return term


def shaken(system: System) -> Array:
    """Places stretched by 2 %, and shifted, both at random."""
    X = system.unknowns.X[: system.unknowns.n_owned]
    x = 0.02 * X + 0.01 * noise(X, 1)
    x[system.unknowns.n_vertices :] = 0.02 * noise(X[system.unknowns.n_vertices :], 2)
    return x


def ways(system: System) -> dict[str, Array]:
    """Random directions of the vertices x, of the shifts s, and of both."""
    n, d = system.unknowns.n_vertices, noise(system.unknowns.X[: system.unknowns.n_owned], 3)
    x, s = d.copy(), d.copy()
    x[n:], s[:n] = 0.0, 0.0
    return {"x": x, "s": s, "x and s": d}


def twin(system: System, arcs: Sequence[RestPlaces], x: Array) -> float:
    """The energy as it is written down, minimised by an all-purpose method; on one process."""
    assert system.cables is not None
    numbering, energy = system.cables.numbering, 0.0
    places, shifts = system.unknowns.X[: len(x)] + x, numbering.shifts
    shift_of = dict(zip(shifts.vertices, x[numbering.shift_blocks], strict=True))
    for c, (cable, own) in enumerate(zip(system.scene.cables, arcs, strict=True)):
        grip, contacts = cable.state.law.axial, cable.contacts()
        assert grip is not None
        points = np.array([places[numbering.block(c, k)] for k in contacts])
        passed = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        spans = np.diff(passed[[0, *(contacts.index(k) for k in own.nodes), -1]])
        shifted = [shift_of.get(cable.state.nodes[k].support[0], np.zeros(3)) for k in own.nodes]
        rest = own.rest + np.sum(own.by_shift * shifted, axis=1)

        def value(
            y: Array, rest: Array = rest, spans: Array = spans, L0: float = cable.L0,
            grip: AxialFrictionState = grip,
        ) -> float:  # fmt: skip
            d, size = np.diff([0.0, *(rest + y * grip.eps), L0]), np.abs(y)
            law = np.where(size < 1.0, size**2 - size**3 / 3, size - 1 / 3)
            strain = EA / 2 * np.sum(np.maximum(spans - d, 0.0) ** 2 / d)
            return float(strain + np.sum(grip.bounds * grip.eps * law))

        best = minimize(value, np.zeros(len(rest)), method="BFGS", options={"gtol": 1e-7})
        energy += float(best.fun)
    return energy


@pytest.mark.parametrize(("bound", "eps"), [(0.3, 0.05), (3.0, 0.02)])
def test_energy_and_forces_are_the_twins(bound: float, eps: float) -> None:
    system = rubbing(MPI.COMM_SELF, bound, eps)
    shape = system.scene.net.strip_shape()
    arcs = [reference_arcs(cable, shape) for cable in system.scene.cables]
    f, x = on_mesh(system, "CapstanTension"), shaken(system)

    def slowly(x: Array) -> float:
        f.value(x)  # puts anchors and shifts where they may be
        return twin(system, arcs, f.potential.x[: len(x)])

    energy, g = f.value(x)
    assert energy == pytest.approx(slowly(x), rel=1e-8)
    for name, d in ways(system).items():
        h = 2e-4
        ahead, behind = (slowly(x + sign * h * d) for sign in (1.0, -1.0))
        assert f.dot(g, d) == pytest.approx((ahead - behind) / (2 * h), rel=2e-4), name


@pytest.mark.ranks
@pytest.mark.parametrize(("bound", "eps"), [(0.3, 0.05), (3.0, 0.02), (1e4, 1.0)])
def test_gradient(comm: MPI.Intracomm, bound: float, eps: float) -> None:
    """Where it sticks, slides, and both; by places, by shifts, and by both."""
    system = rubbing(comm, bound, eps)
    f, x = on_mesh(system, "CapstanTension"), shaken(system)
    f.value(x)
    assert bound > 1.0 or np.abs(term_of(f).slips).max() > eps
    for name, d in ways(system).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03), name


@pytest.mark.ranks
def test_stiffness(comm: MPI.Intracomm) -> None:
    """Semidefinite; a vertex that sticks holds its place by the two spans beside it."""
    system = rubbing(comm, 1e6, 1e-3)
    f = on_mesh(system, "CapstanTension")
    A = f.assembled(np.zeros_like(shaken(system)))
    K = dense(A)
    assert is_semidefinite(K)
    assert system.cables is not None
    numbering, scene = system.cables.numbering, system.scene
    (k, other), shape = common(scene.cables), scene.net.strip_shape()
    (at,) = np.nonzero(numbering.shifts.vertices == scene.cables[0].state.nodes[k].support[0])
    block = 0
    if at[0] in numbering.own_shifts:
        block = A.getOwnershipRange()[0] + 3 * int(numbering.shift_blocks[at[0]])
    block = comm.allreduce(block, op=MPI.MAX)
    expected = np.zeros((3, 3))
    for cable, node in zip(scene.cables, (k, other), strict=True):
        way = np.diff(cable.state.positions[node - 1 : node + 2], axis=0)
        lengths = np.linalg.norm(way, axis=1)
        along = way.sum(axis=0) / lengths.sum()
        # EA/d of both spans for unstressed arc 1/STRETCH by shift; each stretches by STRETCH
        expected += EA * STRETCH * (1 / lengths).sum() * np.outer(along, along)
        np.testing.assert_allclose(
            reference_arcs(cable, shape).by_shift[gripped_nodes(cable).index(node)],
            along / STRETCH, atol=1e-12,
        )  # fmt: skip
    found = K[block : block + 3, block : block + 3]
    np.testing.assert_allclose(found, expected, rtol=1e-2, atol=1e-8 * np.abs(expected).max())


def jump(cable: LaidCable, k: int) -> float:
    """How much the tension changes at a node (force)."""
    at = cable.contacts().index(k)
    return float(cable.part_tensions[at] - cable.part_tensions[at - 1])


@pytest.mark.ranks
def test_the_other_cable_takes_none_of_the_friction(comm: MPI.Intracomm) -> None:
    """Its sideways force is that of the mesh, as without friction; and friction changes the energy
    by as much as for cables across the cells, which do not rub where they cross."""
    aside, energies = [], []
    for along in (0.0, 0.1):
        scene = crossed(comm, along)
        step = Solver(scene, rtol=1e-8).advance(pressure=2.0)
        assert step.verification.passed
        assert step.verification["sideways balance"].value < 1e-6
        at = list(zip(scene.cables, common(scene.cables), strict=True))
        shape = scene.net.strip_shape()
        aside.append([float(forces_at(cable, [k], shape)[1][0]) for cable, k in at])
        energies.append(scene.energy)
        scene = crossed(comm, along, lined=False)
        Solver(scene, rtol=1e-8).advance(pressure=2.0)
        energies.append(scene.energy)
    jumps = [abs(jump(cable, k)) for cable, k in at]
    assert min(jumps) > 0.1
    np.testing.assert_allclose(*aside, rtol=0, atol=0.01 * min(jumps))
    assert energies[2] - energies[0] == pytest.approx(energies[3] - energies[1], rel=0.05)


def test_what_friction_takes_is_missing_in_the_energy(comm: MPI.Intracomm) -> None:
    """Shortened at their last ends, cables put in T + T^2/(2 EA) of these per length. Friction
    counts with the forces at the end of each step; on the other cable it left five percent."""
    scene = crossed(comm, 0.2)
    solver = Solver(scene, rtol=1e-8)
    solver.advance(pressure=2.0)
    first = np.array([cable.L0 for cable in scene.cables])
    energy, before, pulls = scene.energy, scene.dissipated, []
    shares = np.linspace(0.0, 0.02, 17)
    for share in shares:
        if share > 0.0:
            lengths = (1 - share) * first
            solver.advance(L0=dict(zip(scene.cables, map(float, lengths), strict=True)))
        ends = np.array([cable.tensions[-1] for cable in scene.cables])
        pulls.append(first @ (ends + ends**2 / (2 * EA)))
    lost = scene.dissipated - before
    assert simpson(pulls, x=shares) - (scene.energy - energy) == pytest.approx(lost, rel=0.02)


def test_rows_rest_as_soon_as_without_a_crossing(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a few solves; rest arcs that did not shift with the places took thousands."""
    solves, plain = [0], System.minimize

    def counted(system: System, *given: Any) -> Any:
        solves[0] += 1
        return plain(system, *given)

    monkeypatch.setattr(System, "minimize", counted)
    for lines in (EVEN, OFF_CENTRE):
        solves[0] = 0
        Solver(crossed(comm, 0.05, lines), rtol=1e-8).advance(pressure=2.0)
        assert solves[0] <= 15


def test_the_check_finds_friction_that_the_fabric_does_not_take(comm: MPI.Intracomm) -> None:
    """As of a cable whose tension changes more at the crossing than what rubs there."""
    scene = crossed(comm)
    solver = Solver(scene, rtol=1e-8)
    solver.advance(pressure=2.0)
    cable, (k, _) = scene.cables[0], common(scene.cables)
    grip, at = cable.state.law.axial, cable.contacts().index(k)
    assert grip is not None
    tensions = grip.tensions.copy()
    tensions[at:] += 0.5 * jump(cable, k)
    cable.update(axial=replace(grip, tensions=tensions))
    none = np.zeros((solver.system.unknowns.n_local, 3))
    found = row_checks(solver.system, none, scene.net.strip_shape(), {})
    assert found[cable]["sideways balance"] > 2e-3
