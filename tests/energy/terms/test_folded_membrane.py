"""Folded cells: against plain cells and explicit unfolding, Taylor, stiffness, rigid motion."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from taylor import (
    OnMesh,
    TermOnPoints,
    gradient_order,
    is_semidefinite,
    stiffness_error,
    stiffness_order,
)
from term_scene import (
    FABRIC,
    ISOTROPIC,
    TENSED_FABRIC,
    TRIANGLE,
    cable_square,
    directions,
    displaced,
    every_material,
    irregular_square,
    moved,
    on_mesh,
    straight,
)
from term_twins import area, axes_of, density, strain, unfolded

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.terms.folded_membrane import FoldedCells, FoldedMembraneEnergy
from crms_fenicsx.energy.terms.kinematics import FLOOR
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes import from_arrays
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.materials import LINEAR

FOLDS = {
    "none": ((), (), ()),
    "one on two sides": ((0.3,), (0.6,), ()),
    "two cables on an edge": ((0.25, 0.7), (0.4,), (0.55,)),
    "two cables on every edge": ((0.25, 0.7), (0.1, 0.4), (0.5, 0.9)),
}
every_fold = pytest.mark.parametrize("folds", FOLDS.values(), ids=FOLDS.keys())


def no_stiffening():
    """As much of a `Stiffening` as terms read, without a mesh."""
    return SimpleNamespace(prestress=SimpleNamespace(value=0.0), floor=SimpleNamespace(value=FLOOR))


def folded_triangle(material, folds, corners=TRIANGLE, eps=0.0):
    """One cell with fold points at fractions of its sides: the term on its points, lines of
    blocks along the sides."""
    X, lines = list(corners), []
    for k, fractions in enumerate(folds):
        a, b = corners[k], corners[(k + 1) % 3]
        own = list(range(len(X), len(X) + len(fractions)))
        X += [a + s * (b - a) for s in fractions]
        lines.append([k, *own, (k + 1) % 3])
    pairs = [list(pairwise(line)) for line in lines]
    counts = np.cumsum([0] + [len(own) for own in pairs])
    axes = axes_of(corners, material.warp)
    table = FoldedCells(
        cells=np.zeros(1, dtype=np.int32),
        segments=np.array([pair for own in pairs for pair in own], dtype=np.int32),
        eps=np.full(counts[-1], eps),
        side_pointers=counts.astype(np.int32),
        side_segments=np.arange(counts[-1], dtype=np.int32),
        sides=np.array([[0, 1, 2]], dtype=np.int32),
        side_vectors=((np.roll(corners, -1, axis=0) - corners) @ axes.T)[None],
        laws=np.array([material.law], dtype=np.int32),
        parameters=material.parameters[None],
    )
    return TermOnPoints(FoldedMembraneEnergy(table, no_stiffening()), np.array(X)), lines


def plain_triangle(material, shift):
    """Energy and forces (3, 3) of one plain cell, corners displaced by shift (3, 3)."""
    mesh = from_arrays(MPI.COMM_SELF, TRIANGLE, [(0, 1, 2)])
    scene = Scene(mesh, material)
    f = OnMesh(
        Unknowns(scene.V),
        scene.u,
        [MembraneEnergy(scene.u, scene.materials, scene.membrane.cell_tags)],
    )
    order = [int(np.argmin(np.linalg.norm(TRIANGLE - X, axis=1))) for X in f.unknowns.X]
    energy, g = f.value(shift[order])
    forces = np.empty((3, 3))
    forces[order] = g
    return energy, forces


SHIFTS = {
    "taut": 0.2 * TRIANGLE + 0.1,
    "wrinkled": TRIANGLE * (0.2, -0.1, 0.1),
    "slack": -0.1 * TRIANGLE,
    "sheared": np.array([(0.3, -0.2, 0.5), (1.0, 0.4, -0.7), (0.2, 0.6, 0.9)]),
}


@every_material
@every_fold
@pytest.mark.parametrize("shift", SHIFTS.values(), ids=SHIFTS.keys())
def test_cell_with_straight_sides_is_the_plain_cell(material, folds, shift):
    f, lines = folded_triangle(material, folds)
    energy, forces = plain_triangle(material, shift)
    x = np.vstack([shift, np.zeros((len(f.X) - 3, 3))])
    for k, (line, fractions) in enumerate(zip(lines, folds, strict=True)):
        for block, s in zip(line[1:-1], fractions, strict=True):
            # slid along the straight side: material points do not count
            s = 0.9 * s + 0.02
            a, b = TRIANGLE[k] + shift[k], TRIANGLE[(k + 1) % 3] + shift[(k + 1) % 3]
            x[block] = a + s * (b - a) - f.X[block]
    folded, g = f.value(x)
    assert folded == pytest.approx(energy, rel=1e-12, abs=1e-12)
    np.testing.assert_allclose(g[:3], forces, atol=1e-12 * np.abs(forces).max(initial=1.0))
    np.testing.assert_allclose(g[3:], 0, atol=1e-12 * np.abs(forces).max(initial=1.0))


@pytest.mark.ranks
@pytest.mark.parametrize("material", [ISOTROPIC, TENSED_FABRIC], ids=["relaxed", "fabric"])
def test_straight_folds_on_a_mesh_are_plain_cells(comm, material):
    system = cable_square(comm, material)
    f = on_mesh(system, "MembraneEnergy", "FoldedMembraneEnergy")
    energy, g = f.value(straight(system))
    displacement = system.scene.u.x.array.copy()

    scene = Scene(irregular_square(comm), material)
    plain = OnMesh(Unknowns(scene.V), scene.u, [MembraneEnergy(scene.u, scene.materials)])
    n = plain.unknowns.n_owned
    twin, forces = plain.value(displacement.reshape(-1, 3)[:n])
    assert energy == pytest.approx(twin, rel=1e-12)
    size = np.sqrt(plain.dot(forces, forces))
    np.testing.assert_allclose(g[:n], forces, atol=1e-12 * size)
    np.testing.assert_allclose(g[n:], 0, atol=1e-12 * size)


@every_material
@every_fold
def test_bent_cell_unfolds_into_a_triangle(material, folds):
    f, lines = folded_triangle(material, folds)
    rng = np.random.default_rng(7)
    states = set()
    for stretch in (0.75, 0.9, 1.0, 1.1, 1.3):
        for _ in range(4):
            x = (stretch - 1) * f.X + 0.5 * rng.normal(size=f.X.shape)
            energy, _ = f.value(x)
            states.add(f.term.results[0, 6])
            now = f.X + x
            ij, jk, ki = (
                sum(np.linalg.norm(now[b] - now[a]) for a, b in pairwise(line)) for line in lines
            )
            was = [np.linalg.norm(TRIANGLE[(k + 1) % 3] - TRIANGLE[k]) for k in range(3)]
            # strain in the plane of the unfolded stress-free triangle, whose axis x is side ik
            flat, bent = unfolded(was[0], was[1], was[2]), unfolded(ij, jk, ki)
            warp = axes_of(TRIANGLE, material.warp)[0]
            frame = axes_of(TRIANGLE, TRIANGLE[2] - TRIANGLE[0])
            # the unfolded triangle is seen from below: i, j, k run clockwise there
            turned = [warp @ frame[0], -(warp @ frame[1]), 0.0]
            axes = np.array([turned, np.cross((0, 0, -1.0), turned)])
            e = strain(flat, bent, axes)
            np.testing.assert_allclose(f.term.results[0, :3], e, atol=1e-13)
            twin = area(TRIANGLE) * float(density(material, e))
            assert energy == pytest.approx(twin, rel=1e-9, abs=1e-11)
    assert len(states) == (1 if material.law == LINEAR else 3)


@every_material
@every_fold
@pytest.mark.parametrize("stretch", [1.2, 0.95])
def test_gradient_of_a_cell(material, folds, stretch):
    f, _ = folded_triangle(material, folds)
    rng = np.random.default_rng(8)
    x = (stretch - 1) * f.X + 0.3 * rng.normal(size=f.X.shape)
    assert gradient_order(f, x, rng.normal(size=x.shape)) == pytest.approx(2, abs=0.02)


@pytest.mark.ranks
@every_material
@pytest.mark.parametrize("size", [0.3, 3.0])
def test_gradient_on_a_mesh(comm, material, size):
    f = on_mesh(cable_square(comm, material), "FoldedMembraneEnergy")
    x = displaced(f.unknowns, size)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03), name


def evenly_tensed(material, X, tension):
    """Displacements in the cell's plane that bring a section force equal in all directions: it
    pulls on all sides of an acute triangle."""
    force = np.array([tension, tension, 0.0]) - material.prestress_vector
    e = np.linalg.solve(material.stiffness, force)
    axes = axes_of(TRIANGLE, material.warp)
    values, vectors = np.linalg.eigh(np.eye(2) + np.array([(2 * e[0], e[2]), (e[2], 2 * e[1])]))
    stretch = vectors * np.sqrt(values) @ vectors.T
    return (X - X[0]) @ axes.T @ stretch @ axes - (X - X[0])


@every_material
@every_fold
def test_stiffness_is_exact_where_all_sides_pull(material, folds):
    f, _ = folded_triangle(material, folds)
    f.term.stiffening.floor.value = 0.0
    rng = np.random.default_rng(9)
    tension = 0.2 * material.stiffness[1, 1]
    x = evenly_tensed(material, f.X, tension) + 0.01 * rng.normal(size=f.X.shape)
    d = rng.normal(size=f.X.shape)
    f.value(x)
    assert f.term.forces.min() > 0
    assert stiffness_error(f, x, d, h=1e-5) < 1e-7
    assert stiffness_order(f, x, d, 0.01 * 0.5 ** np.arange(5)) == pytest.approx(3, abs=0.1)


def test_stiffness_within_the_smoothed_length():
    """A fold point nearer to a vertex than eps."""
    f, _ = folded_triangle(ISOTROPIC, ((0.01,), (0.6,), ()), eps=0.5)
    f.term.stiffening.floor.value = 0.0
    rng = np.random.default_rng(9)
    x, d = 0.25 * f.X, 0.1 * rng.normal(size=f.X.shape)
    f.value(x)
    assert f.term.lengths.min() < 0.5
    assert f.term.forces.min() > 0
    assert stiffness_error(f, x, d) < 1e-7
    assert gradient_order(f, x, d) == pytest.approx(2, abs=0.02)


@every_material
@every_fold
@pytest.mark.parametrize("stretch", [1.2, 0.97, 0.8])
def test_stiffness_of_a_cell_is_semidefinite(material, folds, stretch):
    f, _ = folded_triangle(material, folds)
    x = (stretch - 1) * f.X + 0.3 * np.random.default_rng(10).normal(size=f.X.shape)
    assert is_semidefinite(f.matrix(x))


def test_stiffness_on_a_mesh_is_semidefinite(comm):
    f = on_mesh(cable_square(comm, FABRIC), "FoldedMembraneEnergy")
    assert is_semidefinite(f.matrix(displaced(f.unknowns, 3.0, stretch=0.95)))


def test_prestress_for_the_stiffness_alone():
    """Each segment gets half of h0 x its length from a cell; energy and forces stay."""
    f, _ = folded_triangle(ISOTROPIC, FOLDS["one on two sides"])
    x = 0.25 * f.X
    energy, without = f.value(x)[0], f.matrix(x)
    f.term.stiffening.prestress.value = 0.3
    assert f.value(x)[0] == energy
    added = f.matrix(x) - without
    twin = np.zeros_like(added)
    for a, b in f.term.table.segments:
        r = (f.X + x)[b] - (f.X + x)[a]
        across = 0.15 * (np.eye(3) - np.outer(r, r) / (r @ r))
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1)):
            twin[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] += sign * across
    np.testing.assert_allclose(added, twin, atol=1e-12 * np.abs(without).max())


def test_cells_share_what_is_on_their_common_side():
    """A segment's force is the sum over its cells: two cells back to back are one twice."""
    one, _ = folded_triangle(FABRIC, FOLDS["one on two sides"])
    t = one.term.table
    double = FoldedCells(
        cells=np.zeros(2, dtype=np.int32), segments=t.segments, eps=t.eps,
        side_pointers=t.side_pointers, side_segments=t.side_segments,
        sides=np.tile(t.sides, (2, 1)), side_vectors=np.tile(t.side_vectors, (2, 1, 1)),
        laws=np.tile(t.laws, 2),
        parameters=np.tile(t.parameters, (2, 1)),
    )  # fmt: skip
    both = TermOnPoints(FoldedMembraneEnergy(double, no_stiffening()), one.X)
    x = 0.2 * one.X + 0.1 * np.random.default_rng(1).normal(size=one.X.shape)
    energy, g = one.value(x)
    assert both.value(x)[0] == pytest.approx(2 * energy, rel=1e-14)
    np.testing.assert_allclose(both.value(x)[1], 2 * g, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(both.matrix(x), 2 * one.matrix(x), rtol=1e-12, atol=1e-10)


@every_material
def test_rigid_motion_changes_nothing(comm, material):
    f = on_mesh(cable_square(comm, material), "FoldedMembraneEnergy")
    X = f.unknowns.X[: f.unknowns.n_owned]
    x = displaced(f.unknowns, 1.0)
    energy, g = f.value(x)
    rigid = moved(f.unknowns, x)
    again, turned = f.value(rigid)
    rigid = f.potential.x[: f.unknowns.n_owned].copy()
    assert again == pytest.approx(energy, rel=1e-11)
    size = np.sqrt(f.dot(g, g))
    assert np.sqrt(f.dot(turned, turned)) == pytest.approx(size, rel=1e-10)
    np.testing.assert_allclose(comm.allreduce(turned.sum(axis=0)), 0, atol=1e-11 * size)
    moment = comm.allreduce(np.cross(X + rigid, turned).sum(axis=0))
    np.testing.assert_allclose(moment, 0, atol=1e-9 * size)


@pytest.mark.ranks
def test_tables_of_the_scene(comm):
    """Folded cells are those that leave the membrane term, with all their area and sides."""
    system = cable_square(comm)
    folded, mesh = system.cables.tables.folded, system.scene.mesh.mesh
    left = np.flatnonzero(system.membrane.energy.plain.x.array == 0)
    np.testing.assert_array_equal(np.sort(folded.cells), left)
    corners = mesh.geometry.x[geometry_dofmap(mesh)[folded.cells]]
    np.testing.assert_allclose(folded.areas, [area(c) for c in corners], rtol=1e-13)
    term = FoldedMembraneEnergy(folded, no_stiffening())
    term.attach(system.unknowns)
    term.sums(np.zeros_like(system.unknowns.X), np.zeros(1))
    for c, sides in enumerate(folded.sides):
        for k, side in enumerate(sides):
            start, end = folded.side_pointers[side : side + 2]
            polyline = term.lengths[folded.side_segments[start:end]].sum()
            straight_line = np.linalg.norm(corners[c, (k + 1) % 3] - corners[c, k])
            assert polyline == pytest.approx(straight_line, rel=1e-13)
