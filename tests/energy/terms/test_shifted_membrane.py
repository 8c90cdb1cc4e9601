"""Cells with shifted corners: against a twin, plain cells and moved meshes, Taylor, stiffness."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from taylor import (
    DenseBlocks,
    OnMesh,
    TermOnPoints,
    gradient_order,
    is_semidefinite,
    noise,
    stiffness_error,
    stiffness_order,
)
from term_scene import (
    FABRIC,
    ISOTROPIC,
    STIFF,
    TENSED,
    TENSED_FABRIC,
    TRIANGLE,
    WARM,
    directions,
    displaced,
    every_material,
    irregular_square,
    rotation,
)
from term_twins import axes_of, density, strain

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.newton import NewtonMethod
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.minimization.strategy import STRATEGY
from crms_fenicsx.energy.minimization.taylor import TermsOnLayout
from crms_fenicsx.energy.terms.folded_membrane import FoldedCells, FoldedMembraneEnergy
from crms_fenicsx.energy.terms.kinematics import FLOOR
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.energy.terms.shifted_membrane import ShiftedCells, ShiftedMembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.materials import (
    LINEAR,
    MembraneMaterial,
)

LOAD = np.array([0.3, -0.2, 0.9])
MOVES = {
    2: 0.25 * TRIANGLE + 0.1,
    1: TRIANGLE * (0.3, -0.7, 0.1) @ np.array([(1, 0.2, 0), (-0.4, 1, 0), (0, 0, 1)]),
    0: -0.3 * TRIANGLE,
}
"""Displacements of the triangle's corners by the state they bring."""
RESIDUAL = np.array([0.7, 0.4, -0.2])
every_load = pytest.mark.parametrize(
    ("load", "residual"),
    [(0 * LOAD, 0 * RESIDUAL), (LOAD, 0 * RESIDUAL), (LOAD, RESIDUAL)],
    ids=["bare", "loaded", "with residual forces"],
)
every_state = pytest.mark.parametrize("state", MOVES, ids=["taut", "wrinkled", "slack"])
PLACES = np.array([(0.4, 0.3, -0.2), (-0.3, 0.5, 0.1), (0.2, -0.4, 0.3)])
"""Shifts of its stress-free corners."""


def no_stiffening(prestress: float = 0.0, floor: float = FLOOR) -> Any:
    """As much of a `Stiffening` as terms read, without a mesh."""
    return SimpleNamespace(
        prestress=SimpleNamespace(value=prestress), floor=SimpleNamespace(value=floor)
    )


class ExactOnPoints(TermOnPoints):
    """A term with its second derivatives."""

    def matrix(self, x: Array) -> Array:
        self.term.sums(x, self.sums)
        n, A = len(self.X), DenseBlocks(len(self.X))
        self.term.add_hessian(x, self.sums, A)
        return A.values.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)


def triangle_table(
    material: MembraneMaterial,
    places: Array = TRIANGLE,
    load: Array | tuple[float, ...] = (0.0, 0.0, 0.0),
    shifts: Integers | tuple[int, ...] = (3, 4, 5),
    residual: Array | tuple[float, ...] = (0.0, 0.0, 0.0),
) -> ShiftedCells:
    """One cell with corners 0, 1, 2."""
    axes = axes_of(places, material.warp)
    return ShiftedCells(
        cells=np.zeros(1, dtype=np.int32),
        corners=np.array([[0, 1, 2]], dtype=np.int32),
        shifts=np.array([shifts], dtype=np.int32),
        sides=((places[1:] - places[0]) @ axes.T)[None],
        axes=axes[None],
        laws=np.array([material.law], dtype=np.int32),
        parameters=material.parameters[None],
        loads=np.array([load], dtype=float),
        residual=np.array([residual], dtype=float),
    )


def shifted_triangle(
    material: MembraneMaterial,
    load: Array | tuple[float, ...] = (0.0, 0.0, 0.0),
    kind: type[TermOnPoints] = ExactOnPoints,
    residual: Array | tuple[float, ...] = (0.0, 0.0, 0.0),
) -> ExactOnPoints:
    """One cell whose three corners shift: the term on its six points, corners first."""
    table = triangle_table(material, load=load, residual=residual)
    return kind(ShiftedMembraneEnergy(table, no_stiffening()), np.vstack([TRIANGLE, TRIANGLE]))


def twin(material: MembraneMaterial, u: Array, w: Array, load: Array, residual: Array) -> float:
    """Energy of the triangle: its stress-free corners shift in its axes, and forces on them stay
    where these were."""
    axes = axes_of(TRIANGLE, material.warp)
    flat = (TRIANGLE + w) @ axes.T
    double = np.linalg.det(flat[1:] - flat[0])
    e = strain(np.column_stack([flat, np.zeros(3)]), TRIANGLE + u, np.eye(3)[:2])
    sides, now = (TRIANGLE[1:] - TRIANGLE[0]) @ axes.T, (TRIANGLE + u)[1:] - (TRIANGLE + u)[0]
    away = (w @ axes.T) @ np.linalg.solve(sides, now)
    return double / 2 * (float(density(material, e)) + residual @ e) + (away @ load).sum()


def ways(x: Array) -> dict[str, Array]:
    """Random directions of corners and stress-free places, together and alone."""
    d = np.random.default_rng(4).normal(size=x.shape)
    half, alone, places = len(x) // 2, d.copy(), d.copy()
    alone[half:] = 0.0
    places[:half] = 0.0
    return {"both": d, "corners": alone, "places": places}


@every_material
@every_state
@every_load
def test_energy_and_forces_are_the_twins(
    material: MembraneMaterial, state: int, load: Array, residual: Array
) -> None:
    f = shifted_triangle(material, load, residual=residual)
    x = np.vstack([MOVES[state], PLACES])
    energy, g = f.value(x)
    assert f.term.results[0, 6] == (2 if material.law == LINEAR else state)
    assert energy == pytest.approx(twin(material, x[:3], x[3:], load, residual), rel=1e-10)
    h = 1e-5
    for k, i in np.ndindex(6, 3):
        step = np.zeros_like(x)
        step[k, i] = h
        ahead, behind = x + step, x - step
        slope = twin(material, ahead[:3], ahead[3:], load, residual)
        slope -= twin(material, behind[:3], behind[3:], load, residual)
        assert g[k, i] == pytest.approx(slope / (2 * h), abs=1e-6 * np.abs(g).max() + 1e-8)


@every_material
@every_state
@every_load
def test_taylor(material: MembraneMaterial, state: int, load: Array, residual: Array) -> None:
    """In x, X and both: gradient by the energy, second derivatives by the gradient."""
    f = shifted_triangle(material, load, residual=residual)
    x = np.vstack([MOVES[state], PLACES])
    for way, d in ways(x).items():
        assert gradient_order(f, x, d) > 1.97, way
        if np.any(load) or np.any(residual) or f.term.results[0, 6] > 0:
            assert stiffness_error(f, x, d, h=1e-5) < 1e-7, way
        assert stiffness_order(f, x, d, 0.02 * 0.5 ** np.arange(5)) > 2.9, way
    K = f.matrix(x)
    np.testing.assert_allclose(K, K.T, atol=1e-13 * np.abs(K).max(initial=0.0))


@every_material
@every_state
@pytest.mark.parametrize("prestress", [0.0, 0.3])
def test_stiffness_is_the_semidefinite_part(
    material: MembraneMaterial, state: int, prestress: float
) -> None:
    """Equal to the second derivatives but for their antisymmetric parts where section forces pull
    and there is no floor."""
    f = shifted_triangle(material, LOAD, TermOnPoints)
    f.term.stiffening = no_stiffening(prestress)
    x = np.vstack([MOVES[state], PLACES])
    K = f.matrix(x)
    assert is_semidefinite(K)
    together = np.vstack([np.eye(3)] * 6) / np.sqrt(6)  # all places translated
    np.testing.assert_allclose(K @ together, 0, atol=1e-12 * np.abs(K).max())


def fan(material: MembraneMaterial) -> ExactOnPoints:
    """Six flat cells around vertex 0, all of whose corners shift."""
    angle = np.arange(6) * np.pi / 3 + 0.2 * np.sin(np.arange(6))
    rim = np.column_stack([5 * np.cos(angle), 4 * np.sin(angle), 0 * angle])
    X = np.vstack([(0.3, -0.2, 0.0), rim])
    cells = np.array([(0, k + 1, (k + 1) % 6 + 1) for k in range(6)], dtype=np.int32)
    parts = [triangle_table(material, X[cell]) for cell in cells]
    table = replace(ShiftedCells.concatenated(parts), corners=cells, shifts=cells + np.int32(7))
    return ExactOnPoints(ShiftedMembraneEnergy(table, no_stiffening(floor=0.0)), np.vstack([X, X]))


@every_material
def test_stiffness_of_even_tension_is_exact(material: MembraneMaterial) -> None:
    """The parts that the stiffness lacks cancel at a vertex within an even field."""
    f = fan(material)
    x = np.vstack([f.X[:7] * (0.2, 0.25, 0.0), np.zeros((7, 3))])
    f.value(x)
    assert np.all(f.term.results[:, 6] == 2)
    assert np.all(f.term.results[:, 3:5] > 0.0)
    K, H = TermOnPoints.matrix(f, x), f.matrix(x)
    inner, size = np.r_[0:3, 21:24], np.abs(H).max()
    np.testing.assert_allclose(K[inner], H[inner], atol=1e-12 * size)
    assert np.abs(K - H).max() > 1e-3 * size


@every_material
@every_state
def test_rigid_motions(material: MembraneMaterial, state: int) -> None:
    """Of the current corners, of the stress-free ones within frozen axes, and of both."""
    f = shifted_triangle(material)
    x = np.vstack([MOVES[state], PLACES])
    energy, g = f.value(x)
    size = np.abs(g).max() + 1e-9
    turn, away = rotation(), np.array([7.0, -3.0, 11.0])
    moved = x.copy()
    moved[:3] = (TRIANGLE + x[:3]) @ turn.T + away - TRIANGLE
    again, turned = f.value(moved)
    assert again == pytest.approx(energy, rel=1e-11, abs=1e-12)
    np.testing.assert_allclose(turned[:3], g[:3] @ turn.T, atol=1e-11 * size)
    np.testing.assert_allclose(turned[3:], g[3:], atol=1e-11 * size)
    for some in (slice(3, 6), slice(0, 6)):
        moved = x.copy()
        moved[some] += away
        again, same = f.value(moved)
        assert again == pytest.approx(energy, rel=1e-12, abs=1e-12)
        np.testing.assert_allclose(same, g, atol=1e-12 * size)
    np.testing.assert_allclose(g[:3].sum(axis=0), 0, atol=1e-13 * size)
    np.testing.assert_allclose(g[3:].sum(axis=0), 0, atol=1e-13 * size)
    np.testing.assert_allclose(np.cross(TRIANGLE + x[:3], g[:3]).sum(axis=0), 0, atol=1e-11 * size)


@pytest.mark.parametrize(
    "material", [ISOTROPIC, STIFF, TENSED, WARM], ids=["relaxed", "raw", "tensed", "warm"]
)
def test_isotropic_cells_may_turn_in_their_plane(material: MembraneMaterial) -> None:
    f = shifted_triangle(material)
    x = np.vstack([MOVES[1], PLACES])
    energy, g = f.value(x)
    a, b = f.term.table.axes[0]
    plane = np.stack([a, b, np.cross(a, b)])
    c, s = np.cos(0.7), np.sin(0.7)
    turn = plane.T @ np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)]) @ plane
    moved = np.vstack([x[:3], (TRIANGLE + PLACES) @ turn.T - TRIANGLE])
    again, turned = f.value(moved)
    assert again == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(turned[3:], g[3:] @ turn.T, atol=1e-12 * np.abs(g).max())
    np.testing.assert_allclose(turned[:3], g[:3], atol=1e-12 * np.abs(g).max())


@every_material
@every_state
def test_the_load_stays_on_the_fabric(material: MembraneMaterial, state: int) -> None:
    """Corners that move to other points of an evenly deformed fabric do no work against it."""
    f = shifted_triangle(material, LOAD)
    x = np.vstack([MOVES[state], 0 * PLACES])
    energy, g = f.value(x)
    away = np.array([2.0, -3.0])
    sides = (TRIANGLE[1:] - TRIANGLE[0]) @ f.term.table.axes[0].T
    now = (TRIANGLE + x[:3])[1:] - (TRIANGLE + x[:3])[0]
    carried = away @ np.linalg.solve(sides, now)
    again, _ = f.value(x + np.repeat([carried, away @ f.term.table.axes[0]], 3, axis=0))
    assert again - 3 * LOAD @ carried == pytest.approx(energy, rel=1e-12)
    slope = np.sum(g[:3] @ carried) + np.sum(g[3:] @ (away @ f.term.table.axes[0]))
    assert slope == pytest.approx(3 * LOAD @ carried, rel=1e-10)


@every_material
@every_state
def test_the_moved_cell_has_the_same_energy(material: MembraneMaterial, state: int) -> None:
    """Once shifts in its plane are part of the mesh: forces and derivatives are those before."""
    f = shifted_triangle(material)
    u = MOVES[state]
    w = PLACES - PLACES @ np.outer(*2 * [np.cross(*f.term.table.axes[0])])
    moved = triangle_table(material, TRIANGLE + w)
    axes = f.term.table.axes
    sides = np.einsum("ki,ai->ka", np.diff((TRIANGLE + w)[[0, 1, 0, 2]], axis=0)[::2], axes[0])
    moved = replace(moved, axes=axes, sides=sides[None])
    after = ExactOnPoints(
        ShiftedMembraneEnergy(moved, no_stiffening()), np.vstack([TRIANGLE + w, TRIANGLE])
    )
    energy, g = f.value(np.vstack([u, w]))
    again, same = after.value(np.vstack([u - w, 0 * w]))
    assert again == pytest.approx(energy, rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(same, g, atol=1e-12 * np.abs(g).max())
    H = f.matrix(np.vstack([u, w]))
    again = after.matrix(np.vstack([u - w, 0 * w]))
    np.testing.assert_allclose(again, H, atol=1e-12 * np.abs(H).max())


def test_units() -> None:
    """A thousandth of the unit of length: energies are a thousand times as large, forces stay."""
    unit = 1e3
    f = shifted_triangle(TENSED_FABRIC, LOAD)
    t, x = f.term.table, np.vstack([MOVES[1], PLACES])
    per_length = np.repeat([1 / unit, 1.0, 1 / unit, 1 / unit, 1.0], [9, 3, 3, 1, 2])
    table = replace(t, sides=unit * t.sides, parameters=per_length * t.parameters)
    other = ExactOnPoints(ShiftedMembraneEnergy(table, no_stiffening()), unit * f.X)
    (energy, g), (large, same) = f.value(x), other.value(unit * x)
    assert large == pytest.approx(unit * energy, rel=1e-13)
    np.testing.assert_allclose(same, g, atol=1e-13 * np.abs(g).max())
    np.testing.assert_allclose(other.term.results[:, :3], f.term.results[:, :3], rtol=1e-11)
    H = f.matrix(x)
    np.testing.assert_allclose(unit * other.matrix(unit * x), H, atol=1e-12 * np.abs(H).max())


@pytest.mark.parametrize("way", [1.0, 1.5], ids=["flat", "turned over"])
def test_cells_that_collapse(way: float) -> None:
    """The energy is not a number, so that a line search shortens its step; other cells are well."""
    f = fan(ISOTROPIC)
    x = np.vstack([0.1 * f.X[:7], np.zeros((7, 3))])
    middle = f.X[1:3].mean(axis=0)
    x[7] = way * (middle - f.X[0])
    energy, g = f.value(x)
    assert np.isnan(energy)
    assert np.isfinite(g).all()
    assert np.isfinite(f.matrix(x)).all()
    assert np.isfinite(TermOnPoints.matrix(f, x)).all()
    x[7] *= 0.9 / way
    assert np.isfinite(f.value(x)[0])


def test_a_newton_step_is_halved_until_no_cell_collapses() -> None:
    scene, unknowns, _, shifted = shifted_square(MPI.COMM_SELF, ISOTROPIC, lift=0.0)
    n, X = unknowns.n_vertices, unknowns.X
    middle = n + int(np.argmin(np.linalg.norm(X[:n] - (50.0, 50.0, 0.0), axis=1)))
    unknowns.held[:] = True
    unknowns.held[middle, :2] = False
    potential = Potential(unknowns, scene.u, [shifted])
    potential.x[:n] = 0.05 * X[:n]
    potential.x[middle] = (1.0, 0.5, 0.0)
    start, forces, x, g, step = (potential.x_vector.duplicate() for _ in range(5))
    energy = potential.evaluate()
    potential.free_gradient(forces)
    potential.x_vector.copy(start)

    def far(given: PETSc.Vec, d: PETSc.Vec) -> None:
        given.copy(d)
        d.scale(200.0 / given.norm())

    h0: Any = SimpleNamespace(slackened=False, solve=far)
    before = potential.evaluations
    assert NewtonMethod(potential, h0, STRATEGY).step(start, forces, energy, x, g, step)
    assert potential.evaluations - before > 4
    assert potential.energy() < energy
    potential.destroy()


@every_material
def test_corners_that_stay_have_no_blocks(material: MembraneMaterial) -> None:
    """The same as if they shifted by nothing, in tables of fewer blocks."""
    whole = shifted_triangle(material, LOAD)
    x = np.vstack([MOVES[1], PLACES])
    rows = np.arange(18)
    for kept in ([], [1], [0, 2]):
        shifts = np.full(3, -1)
        shifts[kept] = 3 + np.arange(len(kept))
        table = triangle_table(material, load=LOAD, shifts=shifts)
        n = 3 + len(kept)
        f = ExactOnPoints(ShiftedMembraneEnergy(table, no_stiffening()), whole.X[:n])
        assert len(f.term.elements.values) == n**2
        same = x.copy()
        same[3:][~np.isin(np.arange(3), kept)] = 0.0
        own = np.append([0, 1, 2], 3 + np.array(kept, dtype=int))
        (energy, g), (twin_energy, twin_g) = f.value(same[own]), whole.value(same)
        assert energy == pytest.approx(twin_energy, rel=1e-14)
        np.testing.assert_allclose(g, twin_g[own], atol=1e-14 * np.abs(twin_g).max())
        at = rows.reshape(6, 3)[own].ravel()
        H = whole.matrix(same)[np.ix_(at, at)]
        np.testing.assert_allclose(f.matrix(same[own]), H, atol=1e-13 * np.abs(H).max())


def test_tables() -> None:
    """Parts and renumbered copies keep track of corners that stay."""
    parts = [triangle_table(FABRIC, shifts=shifts) for shifts in [(3, -1, 4), (-1, -1, 3)]]
    table = ShiftedCells.concatenated(parts)
    pointers, blocks = table.element_blocks
    np.testing.assert_array_equal(pointers, [0, 5, 9])
    np.testing.assert_array_equal(blocks, [0, 1, 2, 3, 4, 0, 1, 2, 3])
    np.testing.assert_array_equal(table.rows_on(np.arange(5) == 4), [0])
    moved = table.some(np.array([1, 0])).renumbered(np.array([7, 6, 5, 9, 8], dtype=np.int32))
    np.testing.assert_array_equal(moved.shifts, [(-1, -1, 9), (9, -1, 8)])
    np.testing.assert_array_equal(moved.corners, [(7, 6, 5)] * 2)
    term = ShiftedMembraneEnergy(table, no_stiffening())
    part = term.of_elements(term.elements_on(np.arange(5) == 4), np.zeros(1))
    assert part.stiffening is term.stiffening
    np.testing.assert_array_equal(part.table.shifts, [(3, -1, 4)])


def shifted_square(
    comm: MPI.Intracomm, material: MembraneMaterial, frames: Array | None = None, lift: float = 8.0
) -> tuple[Scene, Unknowns, MembraneEnergy, ShiftedMembraneEnergy]:
    """All cells of a square as shifted cells, whose vertices all shift, and the term of plain
    cells; blocks of the vertices and their shifts."""
    scene = Scene(irregular_square(comm, lift), material)
    plain = MembraneEnergy(scene.u, scene.materials, scene.membrane.cell_tags, frames)
    vertices = scene.V.dofmap.index_map
    starts = np.array(comm.allgather(vertices.local_range[0]))
    ghosts = [(r, g - starts[r]) for r, g in zip(vertices.owners, vertices.ghosts, strict=True)]
    unknowns = Unknowns(scene.V, vertices.size_local, ghosts)
    of_vertices = unknowns.vertex_blocks()
    of_shifts = np.append(unknowns.owned_point_blocks(), unknowns.ghost_point_blocks())
    unknowns.X[of_shifts] = unknowns.X[of_vertices]
    own = np.arange(scene.mesh.mesh.topology.index_map(2).size_local, dtype=np.int32)
    dofs = scene.V.dofmap.list[own]
    table = ShiftedCells.of(plain, own, of_vertices[dofs], of_shifts[dofs])
    shifted = ShiftedMembraneEnergy(table, plain.stiffening)
    return scene, unknowns, plain, shifted


@pytest.mark.ranks
@every_material
def test_unshifted_cells_are_the_plain_ones(
    comm: MPI.Intracomm, material: MembraneMaterial
) -> None:
    """Energy, forces, results and stiffness, with floor and prestress; the load adds nothing."""
    scene, unknowns, plain, shifted = shifted_square(comm, material)
    shifted.table.loads[:] = LOAD
    n = unknowns.n_vertices
    one = OnMesh(unknowns, scene.u, [shifted])
    x = displaced(unknowns, 2.0, stretch=1.02)
    x[n:] = 0.0
    shifted.stiffening.set(0.2)
    shifted.stiffening.floor.value = 1e-2
    energy, g = one.value(x)
    results, K = shifted.cell_results().copy(), one.matrix(x)
    exact = OnMesh(unknowns, scene.u, [shifted], exact=True)
    H = exact.matrix(x)
    twin = OnMesh(unknowns, scene.u, [plain])
    twin_energy, forces = twin.value(x)
    assert energy == pytest.approx(twin_energy, rel=1e-12)
    size = np.abs(forces).max(initial=1e-3)
    np.testing.assert_allclose(g[:n], forces[:n], atol=1e-12 * size)
    assert np.abs(g[n:]).max() > 0.1 * size
    np.testing.assert_allclose(results, plain.cell_results(), rtol=1e-10, atol=1e-11)
    states = set().union(*comm.allgather(set(results[:, 6])))
    assert len(states) == (1 if material.law == LINEAR else 3)
    rows = np.concatenate([3 * (start + np.arange(n)) for start, n in spans(unknowns)])
    rows = np.ravel(rows[:, None] + np.arange(3))
    part = np.ix_(rows, rows)
    np.testing.assert_allclose(K[part], twin.matrix(x)[part], atol=1e-12 * np.abs(K).max())
    exact = OnMesh(unknowns, scene.u, [plain], exact=True)
    np.testing.assert_allclose(H[part], exact.matrix(x)[part], atol=1e-12 * np.abs(H).max())


def spans(unknowns: Unknowns) -> list[tuple[int, int]]:
    """First global block and number of vertices of each rank."""
    counts = unknowns.comm.allgather(unknowns.n_vertices)
    return list(zip(unknowns.starts[:-1].tolist(), counts, strict=True))


@pytest.mark.ranks
@pytest.mark.parametrize("material", [ISOTROPIC, STIFF, FABRIC], ids=["wrinkling", "raw", "fabric"])
def test_second_derivatives_on_a_mesh(comm: MPI.Intracomm, material: MembraneMaterial) -> None:
    """Where cells are taut, wrinkled and slack at once, and shifted."""
    scene, unknowns, _, shifted = shifted_square(comm, material)
    shifted.table.loads[:] = 0.01 * LOAD
    f = TermsOnLayout(unknowns, scene.u, [shifted], exact=True)
    x = displaced(unknowns, 1.0, stretch=1.02)
    x[unknowns.n_vertices :] = noise(unknowns.X[unknowns.n_vertices : unknowns.n_owned], 5)
    for way, d in directions(unknowns).items():
        assert gradient_order(f, x, d) > 1.9, way
        assert stiffness_error(f, x, d, h=1e-5) < 2e-6, way


@every_material
@every_state
def test_unshifted_cells_are_folded_ones_without_folds(
    material: MembraneMaterial, state: int
) -> None:
    f, sides = shifted_triangle(material), np.roll(TRIANGLE, -1, axis=0) - TRIANGLE
    t = f.term.table
    pairs = np.array([(0, 1), (1, 2), (2, 0)], dtype=np.int32)
    one = np.arange(4, dtype=np.int32)
    table = FoldedCells(
        cells=t.cells,
        segments=pairs,
        eps=np.zeros(3),
        side_pointers=one,
        side_segments=one[:3],
        sides=one[None, :3],
        side_vectors=np.einsum("ki,nai->nka", sides, t.axes),
        laws=t.laws,
        parameters=t.parameters,
    )
    folded = ExactOnPoints(FoldedMembraneEnergy(table, no_stiffening()), TRIANGLE)
    (energy, g), (twin_energy, forces) = f.value(extended(MOVES[state])), folded.value(MOVES[state])
    assert energy == pytest.approx(twin_energy, rel=1e-12)
    size = np.abs(forces).max()
    np.testing.assert_allclose(g[:3], forces, atol=1e-12 * size)
    results = folded.term.results
    np.testing.assert_allclose(f.term.results, results, atol=1e-12 * np.abs(results).max())
    H, K = f.matrix(extended(MOVES[state])), folded.matrix(MOVES[state])
    np.testing.assert_allclose(H[:9, :9], K, atol=1e-12 * np.abs(K).max(initial=1.0))


def extended(u: Array) -> Array:
    """The displacements of unshifted corners."""
    return np.vstack([u, 0 * u])


@every_material
def test_cells_with_shapes_of_their_own(material: MembraneMaterial) -> None:
    """Stress-free shapes of panels, whose images in the mesh are strained and oblique frames."""
    if material.warp is not None:
        material = replace(material, warp=(1.0, 0.0, 0.0))
    mesh = irregular_square(MPI.COMM_SELF, 8.0)
    x = mesh.mesh.geometry.x[geometry_dofmap(mesh.mesh)]
    rng = np.random.default_rng(2)
    frames = np.array([axes_of(places) for places in x])
    frames += np.einsum("nab,nbi->nai", rng.uniform(-0.05, 0.05, (len(frames), 2, 2)), frames)
    scene, unknowns, plain, shifted = shifted_square(MPI.COMM_SELF, material, frames)
    one, twin = (OnMesh(unknowns, scene.u, [term]) for term in (shifted, plain))
    x, n = displaced(unknowns, 2.0, stretch=1.02), unknowns.n_vertices
    x[n:] = 0.0
    (energy, g), (twin_energy, forces) = one.value(x), twin.value(x)
    assert energy == pytest.approx(twin_energy, rel=1e-12)
    size = np.abs(forces).max()
    np.testing.assert_allclose(g[:n], forces[:n], atol=1e-12 * size)
    exact = TermsOnLayout(unknowns, scene.u, [shifted], exact=True)
    x[n:] = noise(unknowns.X[n:], 5)
    for way, d in directions(unknowns).items():
        assert stiffness_error(exact, x, d, h=1e-5) < 2e-6, way


def test_a_mesh_at_rest_is_not_strained() -> None:
    """To the last digit, however far from the origin, and with shifts along the mesh's plane, to
    rounding of these."""
    places = TRIANGLE * (1.0, 1.0, 0.0)
    table = triangle_table(ISOTROPIC, places)
    far = np.vstack([places, places]) + 1e3
    f = ExactOnPoints(ShiftedMembraneEnergy(table, no_stiffening()), far)
    energy, g = f.value(np.full((6, 3), 5.0))
    assert energy == 0.0
    assert np.all(g == 0.0)
    assert np.all(f.term.results == [0, 0, 0, 0, 0, 0, 2])
    shifts = 1e-6 * PLACES * (1.0, 1.0, 0.0)
    f.value(np.vstack([shifts, shifts]))
    assert np.abs(f.term.results[0, :3]).max() < 1e-21
