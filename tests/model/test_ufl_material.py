"""Membranes with a user's energy density."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from cabled_square import advanced, clamped
from grids import grid
from mpi4py import MPI
from taylor import OnMesh, gradient_order, noise, stiffness_error

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    PathError,
    Scene,
    Solver,
    UflMembrane,
    meshes,
)
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes import from_arrays
from crms_fenicsx.model.ufl_material import SMALL, _values

MU = 3.0


def isotropic(E: Any) -> Any:
    """St. Venant-Kirchhoff's density of `STIFF`."""
    Et, nu = 24.0, 0.25
    factor = Et / (1 - nu**2)
    trace = ufl.tr(E)
    return factor / 2 * (nu * trace**2 + (1 - nu) * ufl.inner(E, E))


STIFF = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)


def rubber(E: Any) -> Any:
    """Incompressible neo-Hookean sheet in plane stress."""
    C = ufl.Identity(2) + 2 * E
    return MU / 2 * (ufl.tr(C) + 1 / ufl.det(C) - 3)


def fung(E: Any) -> Any:
    """Fung's exponential law, stiffer along axis 1."""
    return 5.0 * (ufl.exp(E[0, 0] ** 2 + 0.5 * E[1, 1] ** 2 + 0.6 * E[0, 1] ** 2) - 1)


def square(comm: MPI.Intracomm, material: Any, size: float = 12.5, **choices: Any) -> Scene:
    mesh = meshes.rectangle(comm, 100.0, 100.0, size)
    return Scene(mesh, material, **choices)


def test_moduli_are_those_at_zero_strain() -> None:
    own = UflMembrane(isotropic)
    np.testing.assert_allclose(own.stiffness, STIFF.stiffness, rtol=1e-13)
    assert own.reference_modulus == pytest.approx(STIFF.reference_modulus, rel=1e-13)
    np.testing.assert_array_equal(own.prestress_vector, 0.0)
    pulled = UflMembrane(lambda E: isotropic(E) + 2.0 * E[0, 0] + 3.0 * E[0, 1])
    np.testing.assert_allclose(pulled.prestress_vector, (2.0, 0.0, 1.5), rtol=1e-13)
    np.testing.assert_allclose(
        UflMembrane(rubber).stiffness, MU * np.array([[4, 2, 0], [2, 4, 0], [0, 0, 1]]), rtol=1e-12
    )


def test_same_answer_as_the_material_of_the_package(comm: MPI.Intracomm) -> None:
    answers = []
    for material in (STIFF, UflMembrane(isotropic)):
        scene = square(comm, material)
        scene.fix("boundary")
        solver = advanced(Solver(scene, rtol=1e-12), pressure=0.01)
        found = solver.results()
        answers.append(
            (scene.energy, found.true_forces, found.strains, solver.reactions("boundary").total)
        )
    for one, other in zip(*answers, strict=True):
        scale = np.abs(one).max(initial=0.0) if np.ndim(one) else 1.0
        np.testing.assert_allclose(other, one, rtol=1e-10, atol=1e-10 * scale)


@pytest.mark.parametrize("psi", [rubber, fung, isotropic])
def test_taylor_expansions(comm: MPI.Intracomm, psi: Any) -> None:
    scene = square(comm, UflMembrane(psi, warp=(1.0, 0.2, 0.0)))
    term, unknowns = MembraneEnergy(scene.u, scene.materials), Unknowns(scene.V)
    term.stiffening.floor.value = 0.0
    f = OnMesh(unknowns, scene.u, [term])
    X = unknowns.X[: unknowns.n_owned]
    x, d = 0.2 * X + 0.5 * noise(X, 1), noise(X, 2)  # in tension all over
    assert gradient_order(f, x, d) == pytest.approx(2, abs=0.1)
    assert stiffness_error(f, x, d) < 1e-6


def stretched(comm: MPI.Intracomm, psi: Any, F: np.ndarray, sides: str) -> Solver:
    """A square whose boundary is stretched, all of it or ("x") in one direction."""
    scene = square(comm, UflMembrane(psi, warp=(1.0, 0.0, 0.0)))
    X = scene.V.tabulate_dof_coordinates()
    scene.u.x.array[:] = (X @ (F - np.eye(3)).T).ravel()
    scene.fix(lambda x: x[0] >= -1.0, "z")
    if sides == "x":
        scene.fix(lambda x: np.minimum(x[0], 100.0 - x[0]) < 1e-6, "x")
        scene.fix(lambda x: x[1] < 1e-6, "y")
    else:
        scene.fix("boundary")
    inner = ~scene.held
    scene.u.x.array.reshape(-1, 3)[inner] += (0.3 * noise(X, 5))[inner]
    return advanced(Solver(scene))


def test_uniaxial_stretch_of_rubber(comm: MPI.Intracomm) -> None:
    """Across it the sheet gets narrower by the root of the stretch, S11 = mu (1 - stretch^-3)."""
    stretch = 1.5
    F = np.diag([stretch, 1.0, 1.0])
    solver = stretched(comm, rubber, F, "x")
    found, S = solver.results(), MU * (1 - stretch**-3)
    np.testing.assert_allclose(
        found.second_piola, np.broadcast_to((S, 0), found.strains.shape), atol=1e-7
    )
    force = solver.reactions(lambda x: x[0] > 100.0 - 1e-6).total[0]
    assert force == pytest.approx(S * stretch * 100.0, rel=1e-8)
    across = (1 / stretch - 1) / 2
    np.testing.assert_allclose(found.strains[:, 1], across, atol=1e-8)


@pytest.mark.parametrize("psi", [rubber, fung])
def test_biaxial_patch(comm: MPI.Intracomm, psi: Any) -> None:
    """Where the boundary moves as by one gradient the membrane does, too."""
    F = np.array([[1.2, 0.05, 0], [0.0, 1.1, 0], [0, 0, 1.0]])
    F = F if psi is rubber else np.diag([1.15, 1.15, 1.0])
    scene = stretched(comm, psi, F, "all").scene
    X = scene.V.tabulate_dof_coordinates()
    np.testing.assert_allclose(scene.positions(), X @ F.T, atol=1e-6)
    if psi is rubber:
        C = F[:2, :2].T @ F[:2, :2]
        energy = MU / 2 * (np.trace(C) + 1 / np.linalg.det(C) - 3) * 100.0**2
        assert scene.energy == pytest.approx(energy, rel=1e-10)


@pytest.mark.ranks
def test_bad_densities_are_refused(comm: MPI.Intracomm) -> None:
    scene = square(comm, STIFF)

    def refused(psi: Any, *words: str) -> None:
        with pytest.raises(InputError) as caught:
            UflMembrane(psi)
        assert all(word in str(caught.value) for word in ("UflMembrane", *words)), caught.value

    refused(3.0, "not a function")
    refused(lambda E: E, "scalar", "(2, 2)")
    refused(lambda E: np.exp(E[0, 0]), "ufl")
    refused(lambda E: -isotropic(E), "not convex", "eigenvalues")
    refused(lambda E: E[0, 0] ** 2, "not convex")
    refused(lambda E: 0.0, "not convex")
    refused(lambda E: isotropic(E) - 100 * isotropic(E) ** 2 / 0.001, "not convex", "tangent")
    refused(lambda E: isotropic(E) + 1.0, "zero strain", "subtract")
    refused(lambda E: ufl.sqrt(ufl.inner(E, E)), "smooth")
    refused(lambda E: isotropic(E) * scene.u[0], "without functions")
    refused(lambda E: E[5, 5], "fails")
    with pytest.raises(InputError, match="warp"):
        UflMembrane(isotropic, warp=(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r'strain="step".*the membrane has a UflMembrane'):
        square(comm, UflMembrane(isotropic), strain="step")


def halves(comm: MPI.Intracomm) -> Any:
    """A square of two parts."""
    line = np.linspace(0.0, 100.0, 9)
    points, cells = grid(line, line)
    left = np.flatnonzero(points[cells, 0].mean(axis=1) < 50.0)
    right = np.setdiff1d(np.arange(len(cells)), left)
    return from_arrays(comm, points, cells, parts={"left": left, "right": right})


@pytest.mark.ranks
def test_parts_and_cables(comm: MPI.Intracomm) -> None:
    mesh, fabric = halves(comm), UflMembrane(isotropic)
    with pytest.raises(InputError, match="part 'right' has a UflMembrane"):
        Scene(mesh, {"left": STIFF, "right": fabric}, strain="step")
    scene = clamped(mesh, {"left": STIFF, "right": fabric})
    with pytest.raises(PathError, match=r"'across': part 'right' has a UflMembrane.*other parts"):
        scene.lay_cable(Cable(1000.0), [(3.0, 0.0), (97.0, 100.0)], name="across")
    assert scene.cables == ()
    solver = advanced(Solver(scene), pressure=0.01)
    cable = scene.lay_cable(Cable(32000.0), [(20.0, 0.0), (23.0, 100.0)], tension=1.0)
    step = solver.advance(L0={cable: 0.99 * cable.L0})
    assert step.verification is not None and step.verification.passed
    twin = clamped(mesh, {"left": STIFF, "right": STIFF})
    other = advanced(Solver(twin), pressure=0.01)
    rope = twin.lay_cable(Cable(32000.0), [(20.0, 0.0), (23.0, 100.0)], tension=1.0)
    other.advance(L0={rope: 0.99 * rope.L0})
    assert cable.tension == pytest.approx(rope.tension, rel=1e-5)


def test_a_cable_that_slides_into_such_a_part(comm: MPI.Intracomm) -> None:
    mesh, fabric = halves(comm), UflMembrane(isotropic)
    scene = clamped(mesh, {"left": STIFF, "right": fabric})
    solver = advanced(Solver(scene), pressure=0.01)
    cable = scene.lay_cable(Cable(32000.0), [(30.0, 0.0), (30.0, 100.0)], tension=1.0)
    before = scene.u.x.array.copy()
    with pytest.raises(PathError, match="slid too far: part 'right'"):
        solver.advance(move={cable: (40.0, 0.0, 0.0)}, steps=1)
    np.testing.assert_array_equal(scene.u.x.array, before)


def test_checkpoints_know_the_density(comm: MPI.Intracomm, folder: Path) -> None:
    folder = folder / "kept"

    def made(psi: Any) -> Solver:
        scene = square(comm, UflMembrane(psi))
        scene.fix("boundary")
        return Solver(scene)

    solver = made(isotropic)
    solver.advance(pressure=0.01)
    solver.save(folder)
    made(isotropic).load(folder)
    with pytest.raises(InputError, match="materials"):
        made(lambda E: isotropic(E) + E[0, 0] ** 4).load(folder)


@pytest.mark.parametrize("pressure", [1e-3, 1e-6, 1e-9])
def test_rubber_under_small_loads_is_linear_elastic(comm, pressure: float) -> None:
    """Terms of the density of order 1 cancel in the energy, whose size is that of the strain^2; the
    sheet has the height of one with E t = 3 mu and nu = 1/2, which is as small as p^(1/3)."""
    heights = []
    for material in (
        UflMembrane(rubber),
        IsotropicMembrane(E=3 * MU, nu=0.4999, thickness=1.0, wrinkling=False),
    ):
        scene = square(comm, material)
        scene.fix("boundary")
        Solver(scene, max_halvings=0).advance(pressure=pressure * MU / 100)
        heights.append(float(scene.positions()[:, 2].max()))
    assert heights[0] == pytest.approx(heights[1], rel=2e-4 + pressure ** (2 / 3))


def test_energy_and_forces_do_not_jump_where_they_are_integrated() -> None:
    """They are, up to the strain `SMALL`, from the second derivatives."""
    own = UflMembrane(rubber)
    found = []
    for part in (1 - 1e-9, 1 + 1e-9):
        E = part * SMALL * ufl.as_matrix([[0.6, 0.3], [0.3, np.sqrt(1 - 0.54)]])
        terms = own.law_terms(E, [ufl.as_ufl(v) for v in own.stiffness.ravel()])
        energy, stress = _values(ufl.as_vector([terms.energy] * 2), 1), _values(terms.stress, 2)
        found.append([*energy, *stress.ravel()])
    np.testing.assert_allclose(*found, rtol=1e-8)
