"""Materials: stiffness, stress laws against a search over all stresses, refused input."""

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from term_scene import FABRIC, ISOTROPIC, STIFF, STIFF_FABRIC, irregular_square
from term_twins import density, energy_at_angle, relaxed_energy

from crms_fenicsx import InputError, Scene, meshes
from crms_fenicsx.energy.terms import compiled_laws as compiled
from crms_fenicsx.foundation.runtime.compat import interpolation_points
from crms_fenicsx.model.materials import (
    LINEAR,
    TENSION_FIELD,
    IsotropicMembrane,
    OrthotropicMembrane,
    law_terms,
)

TENSED = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=0.7)
TENSED_FABRIC = replace(FABRIC, prestress=(2.0, 1.0))
LAWS = {
    "wrinkling": ISOTROPIC,
    "wrinkling, prestressed": TENSED,
    "auxetic": IsotropicMembrane(E=10.0, nu=-0.6, thickness=0.5),
    "linear": STIFF,
    "orthotropic, linear, prestressed": replace(STIFF_FABRIC, prestress=(2.0, 1.0)),
    "orthotropic, wrinkling": FABRIC,
    "orthotropic, wrinkling, prestressed": TENSED_FABRIC,
    "warm": replace(TENSED, expansion=2e-4, dT=60.0),
    "orthotropic, warm": replace(TENSED_FABRIC, expansion=(2e-4, -1e-4), dT=60.0),
    "cold": replace(TENSED, expansion=2e-4, dT=-60.0),
}
law = pytest.mark.parametrize("material", LAWS.values(), ids=LAWS.keys())
closed = [name for name, own in LAWS.items() if own.law in (LINEAR, TENSION_FIELD)]
law_in_ufl = pytest.mark.parametrize("material", [LAWS[name] for name in closed], ids=closed)


def random_strains(n, seed=0):
    """Strains (n, 3) as (E11, E22, 2 E12), taut, wrinkled and slack ones, and special cases."""
    rng = np.random.default_rng(seed)
    mean, radius = rng.uniform(-0.1, 0.15, n), rng.uniform(0, 0.12, n)
    angle = rng.uniform(0, np.pi, n)
    e = np.stack([mean + radius * np.cos(angle), mean - radius * np.cos(angle)], axis=-1)
    e = np.column_stack([e, 2 * radius * np.sin(angle)])
    e[:4] = [(0.05, 0.05, 0.0), (-0.05, -0.05, 0.0), (0.0, 0.0, 0.0), (0.1, -0.2, 0.0)]
    return e


def evaluate(material, e, floor=0.0):
    """Compiled energies (n,), section forces (n, 3), states (n,) and tangents (n, 3, 3)."""
    s, C, results = np.empty(3), np.empty((3, 3)), []
    for strain in e:
        number, p = material.law, material.parameters
        orthotropic = compiled.orthotropic_flag(number)
        energy, state = compiled.stress(number, p, strain, s, orthotropic)
        compiled.tangent(number, p, strain, floor, C, orthotropic)
        results.append((energy, s.copy(), state, C.copy()))
    return tuple(np.array(part) for part in zip(*results, strict=True))


def test_isotropic_stiffness_is_the_inverse_of_the_compliance():
    E, nu, t = 300.0, 0.25, 0.08
    compliance = np.array([[1, -nu, 0], [-nu, 1, 0], [0, 0, 2 * (1 + nu)]]) / (E * t)
    np.testing.assert_allclose(ISOTROPIC.stiffness @ compliance, np.eye(3), atol=1e-14)
    assert pytest.approx(E * t) == ISOTROPIC.reference_modulus


def test_orthotropic_stiffness_is_the_inverse_of_the_compliance():
    E1, E2, G12, nu21, t = 1394.0, 140.0, 12.0, 0.065, 0.5
    # a stress along weft strains the warp by -nu21 times the weft's strain
    nu12 = nu21 * E1 / E2
    compliance = np.array([[1 / E1, -nu21 / E2, 0], [-nu12 / E1, 1 / E2, 0], [0, 0, 1 / G12]]) / t
    fabric = OrthotropicMembrane(E1, E2, G12, nu21, t)
    np.testing.assert_allclose(fabric.stiffness @ compliance, np.eye(3), atol=1e-13)
    assert fabric.reference_modulus == pytest.approx(t * np.sqrt(E1 * E2))


@pytest.mark.parametrize("material", [ISOTROPIC, TENSED, LAWS["auxetic"], FABRIC, TENSED_FABRIC])
def test_relaxed_energy_is_the_best_of_all_tensile_stresses(material):
    e = random_strains(1500)
    energy, _, state, _ = evaluate(material, e)
    assert set(state) == {0, 1, 2}, "all states must occur"
    np.testing.assert_allclose(energy, density(material, e), rtol=1e-10, atol=1e-13)


def test_no_tensile_stress_does_better_than_the_twin():
    e, D = random_strains(200), ISOTROPIC.stiffness
    angles = np.linspace(0, np.pi, 5000)
    grid = energy_at_angle(np.linalg.inv(D), e[:, None, :], angles).max(axis=1)
    twin = relaxed_energy(D, e)
    assert np.all(grid <= twin + 1e-13)
    assert np.all(grid >= twin - 1e-6)
    # any other stress in the cone of tensile ones, by its square root
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(4000, 2, 2)) * np.sqrt(rng.uniform(0, 4, (4000, 1, 1)))
    stresses = roots @ roots.transpose(0, 2, 1)
    s = np.stack([stresses[:, 0, 0], stresses[:, 1, 1], stresses[:, 0, 1]], axis=-1)
    values = e @ s.T - np.einsum("ni,ij,nj->n", s, np.linalg.inv(D), s) / 2
    assert np.all(values.max(axis=1) <= twin + 1e-13)


@law
def test_stress_is_the_energys_slope(material):
    e, h = random_strains(400)[4:], 1e-6
    _, stress, state, _ = evaluate(material, e)
    for i, shift in enumerate(h * np.eye(3)):
        up, down = evaluate(material, e + shift), evaluate(material, e - shift)
        same = (up[2] == state) & (down[2] == state)
        assert same.sum() > 380
        slope = (up[0] - down[0]) / (2 * h)
        # sigma : dE = S11 dE11 + S22 dE22 + S12 d(2 E12)
        np.testing.assert_allclose(slope[same], stress[same, i], atol=2e-7)


@law
def test_tangent_is_the_stress_slope(material):
    e, h = random_strains(400)[4:], 1e-7
    _, _, state, tangent = evaluate(material, e)
    size = np.abs(material.stiffness).max()
    for i, shift in enumerate(h * np.eye(3)):
        up, down = evaluate(material, e + shift), evaluate(material, e - shift)
        same = (up[2] == state) & (down[2] == state)
        slope = (up[1] - down[1]) / (2 * h)
        np.testing.assert_allclose(slope[same], tangent[same, :, i], atol=1e-5 * size)


@pytest.mark.parametrize("material", [ISOTROPIC, TENSED, FABRIC])
def test_floor_adds_taut_stiffness(material):
    e = random_strains(100)
    with_floor, without = evaluate(material, e, 0.3)[3], evaluate(material, e)[3]
    added = np.broadcast_to(0.3 * material.stiffness, with_floor.shape)
    np.testing.assert_allclose(with_floor - without, added, atol=1e-12)


@law_in_ufl
def test_compiled_law_is_the_ufl_law(material, comm):
    mesh = meshes.rectangle(comm, 1.0, 1.0, 1 / 28, structured=True).mesh
    strain = fem.Function(fem.functionspace(mesh, ("DG", 0, (3,))))
    n = len(strain.x.array) // 3
    e = random_strains(n, seed=comm.rank)
    strain.x.array[:] = e.ravel()
    E = ufl.as_matrix([[strain[0], strain[2] / 2], [strain[2] / 2, strain[1]]])
    terms = law_terms(material.law, E, fem.Constant(mesh, material.parameters))
    units = [ufl.as_matrix(m) for m in ([[1, 0], [0, 0]], [[0, 0], [0, 1]], [[0, 0.5], [0.5, 0]])]
    parts = [terms.energy, terms.stress[0, 0], terms.stress[1, 1], terms.stress[0, 1], terms.state]
    parts += [tangent(a, b) for tangent in (terms.tangent, terms.taut_tangent)
              for a in units for b in units]  # fmt: skip
    result = fem.Function(fem.functionspace(mesh, ("DG", 0, (len(parts),))))
    points = interpolation_points(result.function_space.element)
    result.interpolate(fem.Expression(ufl.as_vector(parts), points))
    values = result.x.array.reshape(n, -1)
    energy, stress, state, tangent = evaluate(material, e)
    assert comm.allreduce(n) >= 1000
    # At no strain taut and slack are the same, and rounding decides.
    same = state == values[:, 4]
    assert np.all(same | (np.abs(e + material.parameters[9:12]).max(axis=1) < 1e-15))
    size = np.abs(material.stiffness).max()
    np.testing.assert_allclose(values[:, 0], energy, rtol=1e-11, atol=1e-14 * size)
    np.testing.assert_allclose(values[:, 1:4], stress, rtol=1e-11, atol=1e-14 * size)
    np.testing.assert_allclose(
        values[same, 5:14].reshape(-1, 3, 3), tangent[same], rtol=1e-9, atol=1e-12 * size
    )
    taut = np.broadcast_to(material.stiffness, (n, 3, 3))
    np.testing.assert_allclose(values[:, 14:].reshape(n, 3, 3), taut, atol=1e-13 * size)


def test_orthotropic_wrinkling_is_not_in_ufl():
    with pytest.raises(ValueError, match="law 2 has no UFL"):
        law_terms(FABRIC.law, None, None)


@law
def test_prestress_is_the_stress_without_strain_and_energy_starts_at_zero(material):
    energy, stress, state, _ = evaluate(material, np.zeros((1, 3)))
    assert state[0] == 2 or np.any(material.prestress_vector < 0.0)  # one that heat slackens
    if state[0] == 2:
        assert energy[0] == pytest.approx(0.0, abs=1e-14)
        np.testing.assert_allclose(stress[0], material.prestress_vector, atol=1e-13)


NAN, INFINITE = float("nan"), float("inf")


@pytest.mark.parametrize("value", [0.0, -1.0, NAN, INFINITE])
@pytest.mark.parametrize("name", ["E", "thickness"])
def test_isotropic_modulus_and_thickness_must_be_positive(name, value):
    data = {"E": 300.0, "nu": 0.25, "thickness": 0.08} | {name: value}
    with pytest.raises(InputError, match=f"IsotropicMembrane: {name} = {value}"):
        IsotropicMembrane(**data)


@pytest.mark.parametrize("value", [0.0, -1.0, NAN, INFINITE])
@pytest.mark.parametrize("name", ["E1", "E2", "G12", "thickness"])
def test_orthotropic_moduli_and_thickness_must_be_positive(name, value):
    data = {"E1": 10.0, "E2": 5.0, "G12": 1.0, "nu21": 0.1, "thickness": 0.5} | {name: value}
    with pytest.raises(InputError, match=f"OrthotropicMembrane: {name} = {value}"):
        OrthotropicMembrane(**data)


@pytest.mark.parametrize("nu", [1.0, -1.0, 1.3, NAN])
def test_isotropic_poisson_ratio_out_of_range(nu):
    with pytest.raises(InputError, match=f"nu = {nu}"):
        IsotropicMembrane(E=1.0, nu=nu, thickness=1.0)


@pytest.mark.parametrize("nu21", [0.5, -0.5, 0.32, NAN])
def test_indefinite_orthotropic_stiffness(nu21):
    with pytest.raises(InputError, match=f"nu21 = {nu21}"):
        OrthotropicMembrane(E1=10.0, E2=1.0, G12=1.0, nu21=nu21, thickness=1.0)


def test_definite_up_to_the_bound():
    fabric = OrthotropicMembrane(E1=10.0, E2=1.0, G12=1.0, nu21=0.316, thickness=1.0)
    assert np.linalg.eigvalsh(fabric.stiffness).min() > 0


def test_wrinkling_membrane_cannot_be_prestressed_in_compression():
    with pytest.raises(InputError, match=r"prestress = -0\.1 is compressive"):
        IsotropicMembrane(E=1.0, nu=0.2, thickness=1.0, prestress=-0.1)
    stiff = IsotropicMembrane(E=1.0, nu=0.2, thickness=1.0, prestress=-0.1, wrinkling=False)
    assert stiff.prestress_vector[0] == -0.1
    with pytest.raises(
        InputError, match=r"OrthotropicMembrane: prestress = \(1.0, -0.1\) is compr"
    ):
        replace(FABRIC, prestress=(1.0, -0.1))
    assert replace(STIFF_FABRIC, prestress=(1.0, -0.1)).prestress_vector[1] == -0.1


@pytest.mark.parametrize("prestress", [NAN, (1.0, INFINITE), (1.0, 2.0, 3.0), ((1.0, 2.0),)])
def test_prestress_that_is_none(prestress):
    with pytest.raises(InputError, match="prestress"):
        OrthotropicMembrane(10.0, 5.0, 1.0, 0.1, 1.0, prestress=prestress)


def test_isotropic_prestress_has_no_direction():
    with pytest.raises(InputError, match="has a direction"):
        IsotropicMembrane(E=1.0, nu=0.2, thickness=1.0, prestress=(1.0, 2.0))


@pytest.mark.parametrize(
    "warp", [(0.0, 0.0, 0.0), (1.0, 0.0), (1.0, NAN, 0.0), "along x", ((1.0, 0.0, 0.0),)]
)
def test_warp_that_is_no_direction(warp):
    with pytest.raises(InputError, match="warp = "):
        OrthotropicMembrane(10.0, 5.0, 1.0, 0.1, 1.0, warp=warp)


def test_material_for_a_part_that_does_not_exist(comm):
    with pytest.raises(InputError, match="no part 'roof'; it has the parts left, right"):
        Scene(irregular_square(comm), {"left": ISOTROPIC, "roof": FABRIC})


@pytest.mark.ranks
def test_cells_without_material(comm):
    # on one rank or on all: cells of the other part may be on some only
    with pytest.raises(InputError, match="cells have no material"):
        Scene(irregular_square(comm), {"left": ISOTROPIC})
    with pytest.raises(InputError, match="cells have no material"):
        Scene(irregular_square(comm), {})


@pytest.mark.parametrize("material", [None, 300.0, IsotropicMembrane])
def test_material_that_is_none(material, comm):
    with pytest.raises(InputError, match="material"):
        Scene(irregular_square(comm), material)
    with pytest.raises(InputError, match="material of part 'left'"):
        Scene(irregular_square(comm), {"left": material, "right": ISOTROPIC})
