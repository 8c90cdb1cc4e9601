"""Tension field of orthotropic membranes: the law, patches of cells, sheets that wrinkle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from cabled_square import advanced, clamped, square
from mpi4py import MPI
from taylor import fitted_order
from term_scene import FABRIC, irregular_square
from term_twins import axes_of, best_angle, relaxed_energy, strain
from twisted_annulus import radial, reference, small_twist_torque, twisted

from crms_fenicsx import Cable, IsotropicMembrane, OrthotropicMembrane, Scene, Solver
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.energy.minimization.strategy import STRATEGY
from crms_fenicsx.energy.terms import compiled_laws as compiled
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.tolerances import UNSTRAINED

Array = npt.NDArray[Any]


def fabric(E1: float, E2: float, kappa: float, nu: float) -> OrthotropicMembrane:
    """Material with kappa = (2 c12 + c66) / (2 (c11 c22)^(1/2)) and nu = (nu12 nu21)^(1/2)."""
    mean = np.sqrt(E1 * E2)
    return OrthotropicMembrane(E1, E2, mean / (2 * (kappa + nu)), nu * np.sqrt(E2 / E1), 1.0)


def evaluate(material: MembraneMaterial, e: Array, floor: float = 0.0) -> tuple[Array, ...]:
    """Compiled energies (n,), section forces (n, 3), states (n,) and tangents (n, 3, 3)."""
    law, p = material.law, material.parameters
    orthotropic = compiled.orthotropic_flag(law)
    s, C = np.zeros((len(e), 3)), np.zeros((len(e), 3, 3))
    pairs = [compiled.stress(law, p, e[k], s[k], orthotropic) for k in range(len(e))]
    for k in range(len(e)):
        compiled.tangent(law, p, e[k], floor, C[k], orthotropic)
    energy, state = np.array(pairs).T
    return energy, s, state, C


@pytest.mark.parametrize(("orthotropic", "compiles"), [(None, 0), (True, 1)])
def test_the_orthotropic_law_is_compiled_only_for_those_who_have_it(
    orthotropic: bool | None, compiles: int
) -> None:
    import numba

    stress, law = compiled.stress.py_func, compiled._orthotropic
    here = numba.njit(stress)  # not from the cache on disk, and of a type that nothing else has
    before = len(law.signatures)
    p, e = np.ones(18, dtype=np.float32), np.zeros(3, dtype=np.float32)
    here(0, p, e, np.zeros(3, dtype=np.float32), orthotropic)
    assert len(law.signatures) - before == compiles


def linear_energy(material: MembraneMaterial, e: Array) -> Array:
    """Energy without wrinkling, the scale of errors."""
    energy: Array = np.einsum("ni,ij,nj->n", e, material.stiffness, e) / 2
    return energy


def random_fabrics(n: int, rng: np.random.Generator) -> list[OrthotropicMembrane]:
    """Moduli that differ up to 1e3-fold, kappa from .3 to 100, nu 0, any, and near its limits."""
    ratios = 10 ** rng.uniform(-3, 3, n)
    kappas = 10 ** rng.uniform(np.log10(0.3), 2, n)
    nus = rng.uniform(-0.25, 0.95, n)
    nus[::4], nus[1::8] = 0.0, 0.9999
    return [fabric(100 * r, 100.0, k, v) for r, k, v in zip(ratios, kappas, nus, strict=True)]


def random_strains(material: OrthotropicMembrane, n: int, rng: np.random.Generator) -> Array:
    """Strains (n, 3), half of them as large in all directions, half of them of like energies."""
    e = rng.normal(size=(n, 3))
    e[::2] /= np.sqrt(np.diag(material.stiffness) / material.stiffness.max())
    return e


def test_relaxed_energy_is_the_best_of_all_tensile_stresses() -> None:
    rng = np.random.default_rng(0)
    counts = np.zeros(3, dtype=int)
    for material in random_fabrics(100, rng):
        e = random_strains(material, 100, rng)
        energy, stress, state, _ = evaluate(material, e)
        twin = relaxed_energy(material.stiffness, e)
        # the search is exact to rounding; near the limit of nu that is 1e4 times as large
        assert np.all(np.abs(energy - twin) < 1e-10 * linear_energy(material, e)), material
        # tensile, and twice the energy is the stress times the strain
        assert np.all(stress[:, :2].min(axis=1) >= 0)
        size = np.abs(stress).max(axis=1)
        determinant = stress[:, 0] * stress[:, 1] - stress[:, 2] ** 2
        assert np.all(determinant >= -1e-14 * size**2)
        assert np.all(np.abs(determinant[state < 2]) <= 1e-14 * size[state < 2] ** 2)
        np.testing.assert_allclose(np.sum(stress * e, axis=1), 2 * energy, rtol=1e-9, atol=1e-9)
        counts += np.bincount(state.astype(int), minlength=3)
    assert counts.min() > 1000, "all states must occur"


def test_direction_in_extreme_fabrics() -> None:
    """Also beyond the range above, the wrinkled energy is at least that on a grid of directions."""
    rng = np.random.default_rng(1)
    angles = np.linspace(0, np.pi, 2000)
    n = np.stack([np.cos(angles) ** 2, np.sin(angles) ** 2, np.sin(angles) * np.cos(angles)])
    for kappa, nu in [(-0.9, 0.95), (0.01, 0.3), (1.0, 0.0), (1e3, -0.9), (1e6, 0.2)]:
        material = fabric(1e3, 1.0, kappa, nu)
        C = np.linalg.inv(material.stiffness)
        e = random_strains(material, 200, rng)
        energy, stress, state, _ = evaluate(material, e)
        assert np.isfinite(stress).all()
        grid = np.maximum(e @ n, 0) ** 2 / (2 * np.einsum("in,ij,jn->n", n, C, n))
        assert np.all(energy >= grid.max(axis=1) - 1e-12 * linear_energy(material, e))
        assert np.count_nonzero(state == 1) > 50


def test_tangent_is_the_stress_slope_where_wrinkled() -> None:
    """Central differences with h = 1e-5: error h^2 and rounding / h, both below 1e-9, times what
    the curvature of the law adds."""
    rng = np.random.default_rng(2)
    h, compared = 1e-5, 0
    for material in random_fabrics(40, rng):
        e = random_strains(material, 25, rng)
        size = np.diag(material.stiffness).max()
        _, _, state, C = evaluate(material, e)
        slopes, same = np.zeros_like(C), state == 1
        for i, shift in enumerate(h * np.eye(3)):
            up, down = evaluate(material, e + shift), evaluate(material, e - shift)
            slopes[:, :, i] = (up[1] - down[1]) / (2 * h)
            same &= (up[2] == 1) & (down[2] == 1)
        error = np.abs(slopes - C).max(axis=(1, 2))[same] / size
        assert np.median(error) < 1e-9
        assert np.quantile(error, 0.9) < 1e-5, "a few turn sharply within h"
        symmetric = np.abs(C - C.transpose(0, 2, 1)).max(axis=(1, 2))
        assert np.all(symmetric <= 1e-12 * size)
        lowest = np.linalg.eigvalsh(C)[:, 0]
        assert np.all(lowest >= -1e-12 * np.abs(C).max(axis=(1, 2)))
        compared += np.count_nonzero(same)
    assert compared > 300


@pytest.mark.parametrize("nu", [0.0, 0.25, -0.5, 0.999])
def test_isotropic_data_give_the_isotropic_law(nu: float) -> None:
    E, t = 300.0, 0.08
    isotropic = IsotropicMembrane(E, nu, t, prestress=0.3)
    fabric = OrthotropicMembrane(E, E, E / (2 * (1 + nu)), nu, t, prestress=0.3)
    e = np.random.default_rng(3).normal(size=(1000, 3))
    expected, found = evaluate(isotropic, e), evaluate(fabric, e)
    np.testing.assert_array_equal(found[2], expected[2])
    size = np.abs(isotropic.stiffness).max()
    for one, other in zip(expected, found, strict=True):
        # rounding of strains of about 1 (up to 4), times the stiffness
        np.testing.assert_allclose(one, other, rtol=1e-11, atol=1e-13 * size)


def special_strains() -> Array:
    """No strain, and strains with eigenvalues or components that vanish."""
    third = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1)])
    rest = np.array([(0, 0, -1), (1, 1, 0), (-1, -1, 0), (1, -1, 0), (-1, 1, 0), (1, 1, 2)])
    zero_eigenvalue = np.array([(1, 1, -2), (-1, -1, 2), (4, 1, 4), (-4, -1, 4), (1e-3, 0, 1)])
    return np.concatenate([third, rest, zero_eigenvalue]).astype(float)


@pytest.mark.parametrize("prestress", [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0)])
def test_special_strains_of_every_size(prestress: tuple[float, float]) -> None:
    rng = np.random.default_rng(4)
    for material in [*random_fabrics(16, rng), fabric(10.0, 10.0, 1.0, 0.0), FABRIC]:
        tensed = replace(material, prestress=prestress)
        for scale in 2.0 ** np.arange(-40, 1, 8):
            e = scale * np.concatenate([special_strains(), random_strains(material, 20, rng)])
            energy, stress, _, C = evaluate(tensed, e)
            assert np.isfinite(energy).all() and np.isfinite(stress).all() and np.isfinite(C).all()
            if not any(prestress):
                # a power of two is no rounding: the law is homogeneous to the last digit
                np.testing.assert_array_equal(evaluate(material, e / scale)[0] * scale**2, energy)
                np.testing.assert_array_equal(evaluate(material, e / scale)[1] * scale, stress)


def test_unstrained_tangent_is_that_of_the_taut_membrane() -> None:
    e = UNSTRAINED / 4 * np.random.default_rng(5).uniform(-1, 1, (200, 3))
    _, _, state, C = evaluate(FABRIC, e)
    assert {0, 1, 2} == set(state), "rounding decides the state"
    # the shear is soft: what counts as no strain is a part of the stiffest direction
    taut = np.abs(C - FABRIC.stiffness).max(axis=(1, 2)) == 0
    assert taut.all()


def test_no_jumps_between_the_states() -> None:
    """Across both bounds, energy and stress change by rounding as the strain does."""
    rng = np.random.default_rng(6)
    for material in random_fabrics(40, rng):
        D, size = material.stiffness, material.stiffness.max()
        angle = rng.uniform(0, np.pi, 10)
        c, s = np.cos(angle), np.sin(angle)
        n, across = np.stack([c * c, s * s, c * s]), np.stack([s * s, c * c, -2 * c * s])
        # a uniaxial stress without wrinkles; a strain that is zero one way, compression the other
        for at in (np.linalg.solve(D, n).T, -across.T):
            at = at / np.abs(at).max(axis=1)[:, None]
            step = 1e-13 * rng.normal(size=at.shape)
            low, high = evaluate(material, at - step), evaluate(material, at + step)
            assert np.any(low[2] != high[2])
            change = np.abs(low[1] - high[1]).max(axis=1)
            # the law is Lipschitz with the stiffness, and its rounding is that of D e
            assert np.all(change <= 2e-12 * size)
            assert np.all(np.abs(low[0] - high[0]) <= 2e-12 * size)


GRADIENTS = {
    "taut": np.array([(1.05, 0.02), (0.01, 1.06), (0.1, -0.05)]),
    "wrinkled": np.array([(1.05, 0.1), (0.02, 0.85), (0.1, -0.05)]),
    "slack": np.array([(0.95, 0.0), (0.01, 0.9), (0.02, 0.01)]),
}
STATES = {"taut": 2, "wrinkled": 1, "slack": 0}


def turning(x: Array) -> Array:
    """A warp direction that turns with the place."""
    return np.array([np.cos(x[0] / 40), np.sin(x[0] / 40), 0.1 + 0 * x[1]])


def uniaxial_or_linear(material: MembraneMaterial, e: Array, state: int) -> Array:
    """Section forces of a state from scratch."""
    if state == 2:
        return np.asarray(material.stiffness @ e)
    if state == 0:
        return np.zeros(3)
    C = np.linalg.inv(material.stiffness)
    angle = float(best_angle(C, e))
    n = np.array([np.cos(angle) ** 2, np.sin(angle) ** 2, np.sin(angle) * np.cos(angle)])
    return np.asarray((n @ e) / (n @ C @ n) * n)


@pytest.mark.ranks
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("warp", [(1.0, 0.0, 0.0), (1.0, 2.0, 0.3), (-1.0, 0.5, 0.0), turning])
def test_patch(comm: MPI.Intracomm, state: str, warp: Any) -> None:
    """Uniform deformation: exact stress and state of each cell, plain or folded by a cable."""
    material = OrthotropicMembrane(1394.0, 140.0, 30.0, 0.02, 1.0, warp=warp)
    scene = clamped(irregular_square(comm), material)
    F, X = GRADIENTS[state], scene.V.tabulate_dof_coordinates()
    scene.u.x.array[:] = (X[:, :2] @ F.T - X).ravel()
    ends = np.array([(0.0, 31.0), (100.0, 52.0)]) @ F.T
    scene.lay_cable(Cable(32000.0), ends, tension=20.0)
    results = Solver(scene).results()
    assert comm.allreduce(int(results.folded.sum())) > 8
    mesh = scene.mesh.mesh
    corners: Array = mesh.geometry.x[geometry_dofmap(mesh)[: len(results.state)]]
    for k, was in enumerate(corners):
        own = turning(was.mean(axis=0)) if callable(warp) else np.array(warp)
        axes = axes_of(was, own)
        e = strain(was, was[:, :2] @ F.T, axes)
        expected = uniaxial_or_linear(material, e, STATES[state])
        S = np.einsum("n,ni,nj->ij", results.second_piola[k],
                      *(results.second_piola_directions[k],) * 2)  # fmt: skip
        found = [axes[0] @ S @ axes[0], axes[1] @ S @ axes[1], axes[0] @ S @ axes[1]]
        assert results.state[k] == STATES[state]
        np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_parts_of_different_materials(comm: MPI.Intracomm) -> None:
    """Each part has the energy and the state that it has in a membrane of its own."""
    isotropic = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
    mesh = irregular_square(comm)  # one for all: each could be distributed in another way

    def solved(left: MembraneMaterial, right: MembraneMaterial) -> tuple[Scene, Array]:
        scene = Scene(mesh, {"left": left, "right": right})
        X = scene.V.tabulate_dof_coordinates()
        scene.fix("boundary")
        scene.u.x.array[:] = (X[:, :2] @ GRADIENTS["wrinkled"].T - X).ravel()
        results = Solver(scene).results()
        forces = np.zeros((len(results.state), 2))
        forces[:] = results.second_piola
        left_cells = scene.mesh.parts["left"]
        side = np.isin(np.arange(len(forces)), left_cells)
        return scene, np.column_stack([forces, results.state, side])

    (_, a), (_, b) = solved(isotropic, isotropic), solved(FABRIC, FABRIC)
    for left, right, first, second in [(isotropic, FABRIC, a, b), (FABRIC, isotropic, b, a)]:
        _, mixed = solved(left, right)
        expected = np.where(mixed[:, 3:] == 1, first, second)
        np.testing.assert_allclose(mixed, expected, atol=1e-12)


@pytest.mark.ranks
def test_inflated_square_of_isotropic_data(comm: MPI.Intracomm) -> None:
    E, nu, t = 300.0, 0.25, 0.08
    mesh, energies, states = square(comm, 16), [], []
    for material in (
        IsotropicMembrane(E, nu, t),
        OrthotropicMembrane(E, E, E / (2 * (1 + nu)), nu, t, warp=(1.0, 0.7, 0.0)),
    ):
        scene = clamped(mesh, material)
        solver = advanced(Solver(scene), pressure=0.01)
        energies.append(scene.energy)
        states.append(solver.results().state)
    assert energies[1] == pytest.approx(energies[0], rel=1e-10)
    np.testing.assert_array_equal(states[0], states[1])


def test_step_wise_strain_refuses_it(comm: MPI.Intracomm) -> None:
    mesh = irregular_square(comm)
    with pytest.raises(InputError, match=r'strain="step".*OrthotropicMembrane.*wrinkling=False'):
        Scene(mesh, FABRIC, strain="step")
    Scene(mesh, replace(FABRIC, wrinkling=False), strain="step")


def narrowed(comm: MPI.Intracomm, n: int) -> tuple[Scene, Solver, Step]:
    """A clamped square of model 3's fabric, warp along x, that is narrowed by 3 % along x and
    inflated."""
    scene = clamped(square(comm, n), OrthotropicMembrane(1394.0, 140.0, 12.0, 0.065, 1.0))
    u = scene.u.x.array.reshape(-1, 3)
    held = scene.held.all(axis=1)
    u[held, 0] = -0.03 * (scene.V.tabulate_dof_coordinates()[held, 0] - 50.0)
    solver = Solver(scene)
    return scene, solver, solver.advance(pressure=0.01)


def test_narrowed_square(comm: MPI.Intracomm) -> None:
    """Against the figures of an independent program on the same mesh."""
    scene, solver, _ = narrowed(comm, 32)
    assert scene.energy == pytest.approx(-298.014884, abs=1e-6)
    w = comm.allreduce(float(scene.positions()[:, 2].max(initial=-np.inf)), op=MPI.MAX)
    assert w == pytest.approx(7.024815, abs=2e-6)
    state = solver.results().state
    wrinkled = comm.allreduce(int(np.count_nonzero(state == 1)))
    assert wrinkled / comm.allreduce(len(state)) == pytest.approx(0.76, abs=0.005)


def test_narrowed_square_converges(comm: MPI.Intracomm) -> None:
    """Against W extrapolated from N = 32 and 64."""
    sizes = [8, 16, 32]
    errors = [narrowed(comm, n)[0].energy + 298.920301 for n in sizes]
    assert min(errors) > 0
    assert -fitted_order(sizes, errors) == pytest.approx(2, abs=0.15)


TWISTS: dict[str, tuple[MembraneMaterial, float]] = {
    "isotropic": (IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08), 0.1),
    "isotropic, far": (IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08), 0.3),
    "fabric": (OrthotropicMembrane(300.0, 100.0, 20.0, 0.05, 1.0, warp=radial), 0.1),
}


def test_twist_reference_tends_to_the_classical_tension_field() -> None:
    """The error is of the order of the angle: two angles leave its square."""
    D, Et = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08).stiffness, 24.0
    angles = np.array([1e-3, 5e-4])
    error = [reference(D, a)[1] / small_twist_torque(Et, a) - 1 for a in angles]
    assert 1e-4 < abs(error[0]) < 1e-2
    assert error[0] == pytest.approx(2 * error[1], rel=5e-3)
    assert abs(2 * error[1] - error[0]) < 1e-5


def test_twist_reference_has_the_torque_of_its_energy() -> None:
    D, h = TWISTS["fabric"][0].stiffness, 1e-4
    slope = (reference(D, 0.1 + h)[0] - reference(D, 0.1 - h)[0]) / (2 * h)
    # the difference's own error is (h / 0.1)^2 and more
    assert reference(D, 0.1)[1] == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("name", TWISTS)
def test_twisted_annulus_converges(comm: MPI.Intracomm, name: str) -> None:
    """Energy and torque of an annulus that wrinkles everywhere, with order 2."""
    material, angle = TWISTS[name]
    energy, torque = reference(material.stiffness, angle)
    sizes, errors = [1 / 4, 1 / 8, 1 / 16], []
    for n in (4, 8, 16):
        scene, solver, step, found = twisted(comm, n, material, angle)
        errors.append((scene.energy / energy - 1, found / torque - 1))
        state = solver.results().state
        wrinkled = comm.allreduce(int(np.count_nonzero(state == 1)))
        assert wrinkled > 0.9 * comm.allreduce(len(state))
        assert step.outcome.evaluations + STRATEGY.rebuild * step.outcome.factorizations <= 40
    assert np.abs(errors[-1]).max() < 2e-3
    for error in np.array(errors).T:
        assert np.all(error > 0), "the mesh is too stiff"
        assert fitted_order(sizes, list(error)) == pytest.approx(2, abs=0.15)
