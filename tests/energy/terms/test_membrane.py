"""Strain energy of the plain cells: twin, Taylor, stiffness, rigid motion, patch tests, warp."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from taylor import OnMesh, gradient_order, is_semidefinite, noise, stiffness_error, stiffness_order
from term_scene import (
    FABRIC,
    ISOTROPIC,
    STIFF,
    STIFF_FABRIC,
    WARM,
    WARM_FABRIC,
    cable_square,
    corners,
    irregular_square,
    moved,
    on_mesh,
)
from term_twins import area, axes_of, density, strain

from crms_fenicsx import InputError, IsotropicMembrane, OrthotropicMembrane, Scene, meshes
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.compat import interpolation_points


def turning_warp(x):
    """A warp direction that turns with the place, not in the surface."""
    return np.array([np.cos(x[0] / 30), np.sin(x[0] / 30), 0.2 + 0 * x[1]])


TURNING = OrthotropicMembrane(
    1394.0, 140.0, 12.0, 0.065, 1.0, warp=turning_warp, prestress=(2.0, 1.0)
)
STIFF_TURNING = replace(TURNING, wrinkling=False)
TENSED = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=0.7)
MATERIALS = {
    "relaxed": ISOTROPIC,
    "relaxed, prestressed": TENSED,
    "relaxed, warm": WARM,
    "orthotropic, warm": WARM_FABRIC,
    "raw": STIFF,
    "orthotropic": STIFF_FABRIC,
    "orthotropic, relaxed": FABRIC,
    "turning warp, prestressed": STIFF_TURNING,
    "turning warp, prestressed, relaxed": TURNING,
    "two parts": {"left": ISOTROPIC, "right": STIFF_TURNING},
    "two parts, relaxed": {"left": ISOTROPIC, "right": TURNING},
    "two fabrics": {"left": TURNING, "right": FABRIC},
}
every_material = pytest.mark.parametrize("material", MATERIALS.values(), ids=MATERIALS.keys())


def membrane_on(comm, material, lift=20.0):
    """The term on a lifted square, its scene, and positions of the owned vertices."""
    scene = Scene(irregular_square(comm, lift), material)
    term = MembraneEnergy(scene.u, scene.materials, scene.membrane.cell_tags)
    unknowns = Unknowns(scene.V)
    return scene, term, OnMesh(unknowns, scene.u, [term]), unknowns.X[: unknowns.n_owned]


def twin_energy(scene, term):
    """Sum over the cells of area x density at the strain of F^T F."""
    total, stress_free, current = 0.0, *corners(scene)
    tags = term.material_tags(np.arange(len(current)))
    for tag in np.unique(tags):
        material, strains, areas = term.materials[int(tag)], [], []
        for was, now in zip(stress_free[tags == tag], current[tags == tag], strict=True):
            warp = material.warp(was.mean(axis=0)) if callable(material.warp) else material.warp
            strains.append(strain(was, now, axes_of(was, warp)))
            areas.append(area(was))
        total += float(np.array(areas) @ density(material, np.array(strains)))
    return scene.comm.allreduce(total)


@every_material
@pytest.mark.parametrize("stretch, size", [(1.1, 0.3), (1.0, 3.0), (0.8, 1.0)])
def test_energy_is_that_of_each_cells_deformation_gradient(comm, material, stretch, size):
    scene, term, f, X = membrane_on(comm, material)
    energy, _ = f.value((stretch - 1) * X + size * noise(X, 1))
    assert energy == pytest.approx(twin_energy(scene, term), rel=1e-9)


def states_of(scene, term):
    """State of each cell of the only material, on all ranks."""
    (law, *_), = term.terms.values()  # fmt: skip
    V = fem.functionspace(scene.mesh.mesh, ("DG", 0))
    state = fem.Function(V)
    state.interpolate(fem.Expression(law.state, interpolation_points(V.element)))
    return set().union(*scene.comm.allgather(set(state.x.array.tolist())))


@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC])
def test_the_shapes_tested_have_all_states(comm, material):
    scene, term, f, X = membrane_on(comm, material)
    f.value(0.15 * X + 0.2 * noise(X, 1))
    assert states_of(scene, term) == {2.0}
    f.value(3.0 * noise(X, 1) - 0.03 * X)
    assert states_of(scene, term) == {0.0, 1.0, 2.0}


@pytest.mark.ranks
@every_material
@pytest.mark.parametrize("stretch, size", [(1.15, 0.2), (0.97, 3.0)])
def test_gradient(comm, material, stretch, size):
    _, _, f, X = membrane_on(comm, material)
    x = (stretch - 1) * X + size * noise(X, 1)
    assert gradient_order(f, x, noise(X, 2)) == pytest.approx(2, abs=0.02)


def test_a_wrong_gradient_has_order_one(comm):
    _, _, f, X = membrane_on(comm, ISOTROPIC)
    right = f.value
    f.value = lambda x: (right(x)[0], 1.001 * right(x)[1])
    assert gradient_order(f, 0.15 * X + 0.2 * noise(X, 1), noise(X, 2)) < 1.9


@pytest.mark.ranks
@every_material
def test_stiffness_is_exact_where_all_is_taut(comm, material):
    _, term, f, X = membrane_on(comm, material)
    term.stiffening.floor.value = 0.0
    x, d = 0.4 * X + 0.2 * noise(X, 1), noise(X, 2)
    assert stiffness_error(f, x, d) < 1e-8
    assert stiffness_order(f, x, d) == pytest.approx(3, abs=0.1)


@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC, TURNING])
def test_stiffness_is_exact_where_wrinkled(comm, material):
    scene, term, f, X = membrane_on(comm, material, lift=0.0)
    term.stiffening.floor.value = 0.0
    x = X * (0.2, -0.35, 0.0) + 0.05 * noise(X, 1)
    f.value(x)
    assert states_of(scene, term) == {1.0}
    assert stiffness_error(f, x, noise(X, 2), h=3e-5) < 1e-8


@every_material
def test_stiffness_is_semidefinite_everywhere(comm, material):
    _, _, f, X = membrane_on(comm, material)
    assert is_semidefinite(f.matrix(3.0 * noise(X, 1) - 0.03 * X))


@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC])
def test_tangent_floor_keeps_slack_cells_stiff(comm, material):
    scene, term, f, X = membrane_on(comm, material)
    slack = -0.2 * X
    f.value(slack)
    assert states_of(scene, term) == {0.0}
    d = f.times(slack, noise(X, 2))
    assert f.dot(d, d) > 0
    taut = f.value(0.2 * X)[0]
    term.stiffening.floor.value = 0.0
    d = f.times(slack, noise(X, 2))
    assert f.dot(d, d) == 0.0
    assert f.value(0.2 * X)[0] == taut, "the floor is no part of the energy"


def test_prestress_for_the_stiffness_alone(comm):
    """It adds the stiffness of ``h0/2 |grad u|^2``, and nothing to energy and forces."""
    scene, term, f, X = membrane_on(comm, ISOTROPIC)
    x, d = 0.1 * X, noise(X, 2)
    energy, g = f.value(x)
    without = f.dot(d, f.times(x, d))
    term.stiffening.prestress.value = 0.3
    added = f.dot(d, f.times(x, d)) - without
    assert f.value(x)[0] == energy
    assert np.array_equal(f.value(x)[1], g)
    f.value(d)  # the square of the gradient of the displacement d, cell by cell
    total = 0.0
    for was, now in zip(*corners(scene), strict=True):
        edges = axes_of(was) @ (was[1:] - was[0]).T
        shift = now - was
        H = (shift[1:] - shift[0]).T @ np.linalg.inv(edges)
        total += 0.3 * area(was) * float(np.sum(H**2))
    assert added == pytest.approx(comm.allreduce(total), rel=1e-10)


@every_material
def test_rigid_motion_changes_nothing(comm, material):
    _, _, f, X = membrane_on(comm, material)
    x = 0.05 * X + 2.0 * noise(X, 1)
    energy, g = f.value(x)
    rigid = moved(f.unknowns, x)
    again, turned = f.value(rigid)
    assert again == pytest.approx(energy, rel=1e-11)
    assert f.dot(turned, turned) == pytest.approx(f.dot(g, g), rel=1e-11)
    size = np.sqrt(f.dot(g, g))
    force = comm.allreduce(turned.sum(axis=0), op=MPI.SUM)
    moment = comm.allreduce(np.cross(X + rigid, turned).sum(axis=0), op=MPI.SUM)
    np.testing.assert_allclose(force, 0, atol=1e-11 * size)
    np.testing.assert_allclose(moment, 0, atol=1e-9 * size)


@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC])
def test_no_energy_and_no_forces_without_displacement(comm, material):
    _, _, f, X = membrane_on(comm, material)
    energy, g = f.value(np.zeros_like(X))
    assert energy == 0.0
    assert not np.any(g)


@pytest.mark.ranks
def test_folded_cells_leave_the_term(comm):
    _, term, f, X = membrane_on(comm, ISOTROPIC)
    x = 0.1 * X
    whole = f.value(x)[0]
    owned = term.plain.function_space.dofmap.index_map.size_local
    first = np.arange(owned) < owned // 2
    term.plain.x.array[:owned] = first
    one = f.value(x)[0]
    term.plain.x.array[:owned] = ~first
    assert 0 < one < whole
    assert one + f.value(x)[0] == pytest.approx(whole, rel=1e-13)


F = np.array([(1.03, 0.02), (0.01, 1.05), (0.1, -0.05)])
"""Deformation gradient of the patch tests; it turns the membrane's plane in space."""


@pytest.mark.parametrize("angle", [0.0, 0.4, 1.1, 2.5])
def test_patch_of_orthotropic_membrane_with_folded_cells(comm, angle):
    """Uniform strain: exact stress in every cell, plain or folded; no forces inside."""
    c, s = np.cos(angle), np.sin(angle)
    fabric = OrthotropicMembrane(
        1394.0, 140.0, 12.0, 0.065, 1.0, warp=(c, s, 0.5), prestress=(2.0, 1.0)
    )
    system = cable_square(comm, fabric)
    f = on_mesh(system, "MembraneEnergy", "FoldedMembraneEnergy")
    X = f.unknowns.X[: f.unknowns.n_owned]
    energy, g = f.value(X[:, :2] @ F.T - X)

    R = np.array([(c, -s), (s, c)])
    E = R.T @ (F.T @ F - np.eye(2)) / 2 @ R
    e = np.array([E[0, 0], E[1, 1], 2 * E[0, 1]])
    stress = fabric.stiffness @ e + fabric.prestress_vector
    assert energy == pytest.approx(100.0**2 * float(density(fabric, e)), rel=1e-11)
    folded = system.folds.energy.results
    assert comm.allreduce(len(folded)) > 20
    np.testing.assert_allclose(folded[:, :3], np.tile(e, (len(folded), 1)), atol=1e-13)
    np.testing.assert_allclose(folded[:, 3:6], np.tile(stress, (len(folded), 1)), rtol=1e-10)
    (law, *_), = system.membrane.energy.terms.values()  # fmt: skip
    V = fem.functionspace(system.scene.mesh.mesh, ("DG", 0, (3,)))
    S = fem.Function(V)
    vector = ufl.as_vector([law.stress[0, 0], law.stress[1, 1], law.stress[0, 1]])
    S.interpolate(fem.Expression(vector, interpolation_points(V.element)))
    plain = S.x.array.reshape(-1, 3)
    np.testing.assert_allclose(plain, np.tile(stress, (len(plain), 1)), rtol=1e-10)
    inside = ~f.unknowns.held[: f.unknowns.n_owned]
    assert comm.allreduce(int(inside.sum())) > 100
    np.testing.assert_allclose(g[inside], 0, atol=1e-10)
    assert comm.allreduce(float(np.abs(g).max(initial=0.0)), op=MPI.MAX) > 1, "the boundary pulls"


def in_a_corner(bad, good):
    """A warp function with one value near a corner of the square, so on one rank, else another."""

    def warp(x):
        corner = (x[0] > 85) & (x[1] > 85)
        return np.where(corner, np.reshape(bad, (3, 1)), np.reshape(good, (3, 1)))

    return warp


@pytest.mark.parametrize("bad", [(0.0, 0.0, 1.0), in_a_corner((0, 0, 1), (1, 0, 0))])
def test_warp_normal_to_the_membrane(comm, bad):
    """Refused on all ranks, though one rank alone may have the cells where it is."""
    fabric = OrthotropicMembrane(10.0, 5.0, 1.0, 0.1, 1.0, warp=bad)
    scene = Scene(irregular_square(comm), fabric)
    with pytest.raises(InputError, match="normal to the membrane at"):
        MembraneEnergy(scene.u, scene.materials)


@pytest.mark.ranks
@pytest.mark.parametrize(
    "bad",
    [
        lambda x: np.ones(3),
        lambda x: np.ones((2, x.shape[1])),
        in_a_corner((np.nan, 0, 0), (1, 0, 0)),
        lambda x: np.zeros_like(x),
    ],
)
def test_warp_function_that_gives_no_directions(comm, bad):
    fabric = OrthotropicMembrane(10.0, 5.0, 1.0, 0.1, 1.0, warp=bad)
    scene = Scene(irregular_square(comm), fabric)
    with pytest.raises(InputError, match="warp"):
        MembraneEnergy(scene.u, scene.materials)


def test_axes_of_folded_cells_are_those_of_the_form(comm):
    scene = Scene(meshes.rectangle(comm, 4.0, 4.0, 1.0, structured=True), TURNING)
    term = MembraneEnergy(scene.u, scene.materials)
    was, _ = corners(scene)
    axes = term.material_axes(np.arange(len(was), dtype=np.int32))
    twin = np.array([axes_of(x, turning_warp(x.mean(axis=0))) for x in was]).reshape(-1, 2, 3)
    np.testing.assert_allclose(axes, twin, atol=1e-14)


def test_a_failed_assembly_leaves_no_trace(comm):
    """What is changed while second derivatives are assembled."""
    scene = Scene(irregular_square(comm), IsotropicMembrane(300.0, 0.25, 0.08))
    term = MembraneEnergy(scene.u, scene.materials)
    term.stiffening.set(0.3)
    parts = term.stiffening.prestress, term.stiffening.floor, term.stiffening.compression
    before = [float(part.value) for part in parts]
    with pytest.raises(AttributeError):
        term.add_hessian(np.zeros((0, 3)), np.zeros(1), None)
    assert [float(part.value) for part in parts] == before
