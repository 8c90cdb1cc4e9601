"""Scenes with a crossing cable: what must not matter does not, and forces and energies balance."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    IsotropicMembrane,
    LaidCable,
    OrthotropicMembrane,
    PathWarning,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.equilibrium import search
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

FREE = "free"
"""A mesh whose cells the cable crosses anywhere."""
LINE = "line"
"""A mesh of squares, and a cable that runs from vertex to vertex for half of its way."""
PATHS = {
    FREE: [(0.0, 37.0, 0.0), (100.0, 44.0, 0.0)],
    LINE: [(0.0, 50.0, 0.0), (50.0, 50.0, 0.0), (100.0, 56.0, 0.0)],
}


@dataclass
class Variant:
    """One scene told in different ways: units, place in space, numbering, ranks."""

    force: float = 1.0
    length: float = 1.0
    turn: Array = field(default_factory=lambda: np.eye(3))
    shift: Array = field(default_factory=lambda: np.zeros(3))
    seed: int | None = None
    comm: MPI.Intracomm = field(default_factory=lambda: MPI.COMM_WORLD)

    def place(self, x: npt.ArrayLike) -> Array:
        """Points (n, 3) in the variant's space and units."""
        return (np.asarray(x) @ self.turn.T + self.shift) * self.length


@dataclass
class Result:
    """What a scene came to, in the units and the place of the first variant."""

    tension: float
    energies: dict[str, float]
    positions: Array
    iterations: list[int]
    factorizations: list[int]

    @property
    def energy(self) -> float:
        return sum(self.energies.values())


def arrays(kind: str) -> tuple[Array, npt.NDArray[np.int64]]:
    """Points and cells of the square, 100 x 100, the same on all ranks."""
    size, structured = (16.0, False) if kind == FREE else (12.5, True)
    mesh = meshes.rectangle(MPI.COMM_SELF, 100.0, 100.0, size, structured=structured).mesh
    return mesh.geometry.x.copy(), geometry_dofmap(mesh).astype(np.int64)


def renumbered(
    points: Array, cells: npt.NDArray[np.int64], seed: int
) -> tuple[Array, npt.NDArray[np.int64]]:
    """The same mesh with vertices and cells in another order, cells begun at another corner."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(points))
    cells = np.argsort(order)[cells[rng.permutation(len(cells))]]
    first = rng.integers(3, size=len(cells))
    return points[order], np.take_along_axis(cells, (first[:, None] + np.arange(3)) % 3, axis=1)


def solved(kind: str, variant: Variant) -> tuple[Scene, LaidCable, Solver]:
    """The square with a cable that is slack until inflated, then with its ends pulled down."""
    points, cells = arrays(kind)
    if variant.seed is not None:
        points, cells = renumbered(points, cells, variant.seed)
    up = variant.turn @ [0.0, 0.0, 1.0]
    mesh = meshes.from_arrays(variant.comm, variant.place(points), cells, outside=tuple(up))
    stress, t = variant.force / variant.length**2, 0.08 * variant.length
    warp = tuple(variant.turn @ [0.8, 0.6, 0.0])
    materials = {
        FREE: IsotropicMembrane(300.0 * stress, 0.25, t),
        LINE: OrthotropicMembrane(900.0 * stress, 300.0 * stress, 90.0 * stress, 0.2, t, warp),
    }
    scene = clamped(mesh, materials[kind])
    cable = scene.lay_cable(
        Cable(32000.0 * variant.force), variant.place(PATHS[kind]), L0=102.5 * variant.length
    )
    solver = Solver(scene)
    down = tuple(variant.turn @ [0.0, 0.0, -1.5] * variant.length)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        solver.advance(pressure=0.01 * stress)
        solver.advance(move={cable: down}, steps=2)
    return scene, cable, solver


def result(kind: str, variant: Variant) -> Result:
    scene, cable, solver = solved(kind, variant)
    work = variant.force * variant.length
    return Result(
        cable.tension / variant.force,
        {name: energy / work for name, energy in scene.energies.items()},
        (cable.state.positions / variant.length - variant.shift) @ variant.turn,
        [step.outcome.iterations for step in solver.steps],
        [step.outcome.factorizations for step in solver.steps],
    )


def rotation(seed: int) -> Array:
    """A random rotation."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return np.asarray(q * np.sign(np.linalg.det(q)))


pytestmark = pytest.mark.usefixtures("comm")
VARIANTS = {
    "mirrored": Variant(turn=np.diag([1.0, -1.0, 1.0])),
    "mirrored upside down": Variant(turn=np.diag([1.0, 1.0, -1.0])),
    "turned": Variant(turn=rotation(0), shift=np.array([30.0, -200.0, 70.0])),
    "turned otherwise": Variant(turn=rotation(1), shift=np.array([-500.0, 20.0, 10.0])),
    "renumbered": Variant(seed=2),
    "renumbered otherwise": Variant(seed=3),
    "in N and m": Variant(force=9.80665, length=0.01),
    "in N and mm": Variant(force=9.80665, length=10.0),
    "in GN and km": Variant(force=9.80665e-9, length=1e-5),
    "all at once": Variant(4.4e3, 0.03, rotation(4), np.array([10.0, 20.0, -30.0]), 5),
}


@pytest.fixture(scope="module", params=[FREE, LINE])
def reference(request: pytest.FixtureRequest) -> tuple[str, Result]:
    kind = str(request.param)
    return kind, result(kind, Variant())


@pytest.mark.ranks
@pytest.mark.parametrize("name", list(VARIANTS))
def test_what_must_not_matter(reference: tuple[str, Result], name: str) -> None:
    kind, expected = reference
    found = result(kind, VARIANTS[name])
    assert found.tension == pytest.approx(expected.tension, rel=1e-8)
    assert found.energy == pytest.approx(expected.energy, rel=1e-8)
    for term, energy in expected.energies.items():
        assert found.energies[term] == pytest.approx(energy, rel=1e-6), term
    np.testing.assert_allclose(found.positions, expected.positions, rtol=0, atol=1e-6)
    if MPI.COMM_WORLD.size == 1:
        assert found.iterations == expected.iterations
        assert found.factorizations == expected.factorizations
    else:  # there the order of sums changes, and with it where rounding ends a line search
        assert sum(found.iterations) < 1.5 * sum(expected.iterations)


def test_the_scene_says_something(reference: tuple[str, Result]) -> None:
    """The cable is taut, bends up out of the plane with the membrane, and slides sideways."""
    kind, found = reference
    assert found.tension > 20.0 and set(found.energies) == {
        "membrane",
        "pressure",
        "cables",
        "penalty",
    }
    nodes = len(found.positions)
    assert found.positions[nodes // 2, 2] > 1.0
    start, end = np.array(PATHS[kind])[[0, -1], :2]
    across = np.array([start[1] - end[1], end[0] - start[0]]) / np.linalg.norm(end - start)
    assert np.ptp((found.positions[1:-1, :2] - start) @ across) > 0.02


@pytest.mark.parametrize("kind", [FREE, LINE])
def test_ends_move_all_the_way(kind: str) -> None:
    """Also if the path, and so the number of nodes, changes from step to step of a call.

    The cable slides along the held edges on which its ends were held at first.
    """
    _, cable, _ = solved(kind, Variant())
    held = np.array(PATHS[kind])[[0, -1]]
    np.testing.assert_allclose(cable.state.positions[[0, -1]], held - [0.0, 0.0, 1.5], atol=1e-12)
    np.testing.assert_allclose(
        cable.state.positions[[1, -2]][:, [0, 2]], held[:, [0, 2]], atol=1e-12
    )
    aside = np.abs(cable.state.positions[[1, -2], 1] - held[:, 1])
    assert (aside < 0.3).all() and {cable.state.nodes[k].kind for k in (1, -2)} <= {
        "edge slider",
        "vertex",
    }


@pytest.mark.ranks
@pytest.mark.parametrize("kind", [FREE, LINE])
def test_the_number_of_processes_does_not_matter(kind: str) -> None:
    """Distributed over all ranks, and whole on each of them."""
    apart = result(kind, Variant())
    alone = result(kind, Variant(comm=MPI.COMM_SELF))
    assert apart.tension == pytest.approx(alone.tension, rel=1e-9)
    assert apart.energy == pytest.approx(alone.energy, rel=1e-9)
    for term, energy in alone.energies.items():
        assert apart.energies[term] == pytest.approx(energy, rel=1e-7), term
    np.testing.assert_allclose(apart.positions, alone.positions, rtol=0, atol=1e-7)


def forces_of(solver: Solver, names: set[str]) -> Array:
    """Nodal forces (n, 3) of the terms with these names on the points that this rank owns."""
    potential = solver.system.potential
    potential.sum_up()
    potential.g[:] = 0.0
    for term in potential.terms:
        if term.name in names:
            term.add_gradient(potential.x, potential.sums_of(term), potential.g)
    potential.unknowns.gather_forces(potential.g_vector, potential.g)
    return potential.g[: potential.unknowns.n_owned].copy()


@pytest.mark.ranks
@pytest.mark.parametrize("kind", [FREE, LINE])
def test_forces_and_energies_balance(kind: str) -> None:
    scene, cable, solver = solved(kind, Variant())
    system, total = solver.system, scene.comm.allreduce
    system.read_scene()
    own = system.unknowns.n_owned
    x = (system.unknowns.X + system.potential.x)[:own]
    held = system.unknowns.held[:own]

    energies = scene.energies
    assert scene.energy == sum(energies.values()) == solver.steps[-1].energy
    assert scene.energy == pytest.approx(system.potential.evaluate(), rel=1e-13)
    assert energies["cables"] == pytest.approx(
        cable.cable.EA / (2 * cable.L0) * (cable.length - cable.L0) ** 2, rel=1e-12
    )

    # what is inside has no resultant and no moment, whichever way it is moved or turned
    scale = cable.tension
    for names in ({"membrane"}, {"cables"}, {"penalty"}):
        force = forces_of(solver, names)
        size = total(float(np.abs(force).sum()))
        assert size > 1e-6 * scale
        assert np.abs(total(force.sum(axis=0))).max() < 1e-12 * size
        assert np.abs(total(np.cross(x, force).sum(axis=0))).max() < 1e-10 * size * 100.0

    # free points are in equilibrium, so that the reactions carry the pressure on them
    internal = forces_of(solver, {"membrane", "cables", "penalty"})
    pressure = forces_of(solver, {"pressure"})
    left = np.zeros_like(system.unknowns.X)
    left[:own] = internal + pressure
    system.unknowns.project(left)  # edge sliders are free along their edges only
    assert np.abs(left[:own][~held]).max() < 1e-8 * scale
    free = ~held.all(axis=1)
    free[system.unknowns.sliders[system.unknowns.sliders < own]] = False
    reactions, carried = total(internal[~free].sum(axis=0)), total(pressure[free].sum(axis=0))
    np.testing.assert_allclose(reactions, carried, rtol=0, atol=1e-7 * scale)
    plan = 100.0**2 * scene.pressure
    assert 0.7 * plan < -carried[2] < plan  # the rest is that of the rim's own nodes


@pytest.mark.parametrize("kind", [FREE, LINE])
def test_work_of_the_ends_is_the_energy_that_comes(kind: str) -> None:
    """dW = sum of reactions x movements, by central differences of whole solutions."""
    scene, cable, solver = solved(kind, Variant())
    system, total = solver.system, scene.comm.allreduce
    h = 1e-3
    reaction = forces_of(solver, {"membrane", "cables", "penalty", "pressure"})
    anchors = {}
    for end in (0, -1):
        numbering = system.cables.numbering
        block = numbering.blocks[numbering.numbers[0, end % len(cable.state.nodes)]]
        mine = 0 <= block < system.unknowns.n_owned
        anchors[end] = total(reaction[block] if mine else np.zeros(3))
        assert np.linalg.norm(anchors[end]) == pytest.approx(cable.tension, rel=1e-6)
    energies = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PathWarning)
        for move in (h, -2 * h):
            solver.advance(move={cable: (0.0, 0.3 * move, -move)})
            energies.append(scene.energy)
    slope = (energies[0] - energies[1]) / (2 * h)
    expected = sum(force @ (0.0, 0.3, -1.0) for force in anchors.values())
    assert slope == pytest.approx(expected, rel=1e-6)


@pytest.mark.ranks
def test_an_end_that_the_membrane_rises_above_is_told(comm: MPI.Intracomm) -> None:
    mesh = meshes.spherical_cap(comm, 10.0, 4.0, 1.5)
    scene = clamped(mesh, IsotropicMembrane(E=100.0, nu=0.3, thickness=1.0))
    solver = advanced(Solver(scene), pressure=0.1)
    top = comm.allreduce(float(scene.positions()[:, 2].max(initial=0.0)), op=MPI.MAX)
    path = [(0.0, 1.0, top + 0.3), (12.0, 2.0, 0.0)]
    scene.lay_cable(Cable(1e3), path, L0=14.0, name="stay")
    assert solver.advance().warnings == ()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PathWarning)
        step = solver.advance(pressure=3.0)
    assert [one.category for one in caught] == [PathWarning] * (comm.rank == 0)
    (found,) = (one for one in step.warnings if one.kind == "cable end")
    assert found.text.startswith("the start of 'stay' at (0, 1, ")
    assert "under the membrane" in found.text
    assert solver.advance(pressure=0.1).warnings == ()
    assert scene.warnings == ()


FOUND = Outcome(True, "found", 0.0, 1.0, 1, 1, 1)


def test_friction_is_renewed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """It settles less sharply: each time it would lead to other lengths, without end."""
    changes, solved = [True, True, True, False], list[str]()

    class Loop:
        def __init__(self, *_: object) -> None: ...

        def solve(self, *_: object) -> Outcome:
            solved.append("friction")
            return replace(FOUND, unsettled=0.03)

    def in_cells(h0_prestress: object, rough: bool) -> Outcome:
        assert not rough
        solved.append("in cells")
        return FOUND

    monkeypatch.setattr(search, "FrictionLoop", Loop)
    system: Any = SimpleNamespace(
        scene=None, renew_smoothing_length=lambda: changes.pop(0), begin_rows=lambda: None
    )
    contacts: Any = SimpleNamespace(solve_in_cells=in_cells)
    found = EquilibriumSearch(system, None)._unsmoothed(FOUND, contacts)
    assert solved == ["friction", "in cells", "in cells"]
    assert found.converged and found.unsettled == 0.03 and found.iterations == 4
