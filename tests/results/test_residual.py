"""Residual and tangent of a scene: zero in equilibrium, differences of each other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from cabled_square import FOIL, advanced, clamped, sheet
from mpi4py import MPI
from petsc4py import PETSc
from taylor import noise

from crms_fenicsx import Bar, Cable, EnergyTerm, Friction, OrthotropicMembrane, Solver, meshes
from crms_fenicsx.results.reactions import Tangent

CLOTH = OrthotropicMembrane(E1=300.0, E2=200.0, G12=20.0, nu21=0.2, thickness=0.08)


def inflated(comm: MPI.Intracomm) -> Solver:
    """An inflated sheet with a dead load."""
    solver = Solver(clamped(meshes.rectangle(comm, 100.0, 100.0, 25.0)))
    solver.scene.put_load((0.0, 0.0, -2e-3), name="snow", per="plan")
    solver.advance(pressure=0.01, load={"snow": 1.0})
    return solver


def braced(comm: MPI.Intracomm) -> Solver:
    """The same of cloth with cables that cross and a mast whose head is a joint under guys."""
    scene = sheet(comm, 4, "unstructured", CLOTH)
    solver = advanced(Solver(scene), pressure=0.01)
    scene.lay_cable(Cable(32000.0), [(0.0, 47.0), (100.0, 52.0)], tension=20.0)
    scene.lay_cable(Cable(9000.0), [(44.0, 0.0), (53.0, 100.0)], tension=5.0)
    head = scene.add_joint((20.0, 20.0, 40.0), name="head")
    scene.add_bar(Bar(EA=1e3), (20.0, 20.0, 0.0), head)
    for foot in ((0.0, 0.0, 0.0), (60.0, 10.0, 0.0), (10.0, 60.0, 0.0)):
        scene.add_bar(Bar(EA=1e2, tension_only=True), foot, head)
    scene.put_joint_load({head: (0.3, 0.1, -1.0)}, name="lamp")
    solver.advance(load={"lamp": 1.0})
    return solver


def sealed(comm: MPI.Intracomm) -> Solver:
    solver = inflated(comm)
    solver.scene.seal(volume=2e5, atmosphere=1.0)
    solver.advance(load={"snow": 2.0})
    return solver


SCENES = [inflated, braced, sealed]


@pytest.mark.ranks
@pytest.mark.parametrize("build", SCENES)
def test_zero_in_equilibrium_away_from_supports(
    comm: MPI.Intracomm, build: Callable[[MPI.Intracomm], Solver]
) -> None:
    solver = build(comm)
    scene, found = solver.scene, solver.residual()
    held, n = scene.held, 3 * scene.V.dofmap.index_map.size_local
    forces = found.membrane.x.array.reshape(-1, 3)
    largest = comm.allreduce(float(np.abs(forces).max(initial=0.0)), op=MPI.MAX)
    assert largest > 1.0  # at the supports
    assert np.abs(forces[~held]).max(initial=0.0) < 1e-8 * largest
    assert found.vector.norm() < 1e-8 * largest
    total = comm.allreduce(forces[: n // 3][held[: n // 3].any(axis=1)].sum(axis=0))
    at_vertices = comm.allreduce(solver.reactions("boundary").forces.sum(axis=0))
    np.testing.assert_allclose(total, at_vertices, atol=1e-8 * largest)
    assert list(found.joints) == [joint.name for joint in scene.joints]
    for joint in scene.joints:
        np.testing.assert_allclose(found.joints[joint.name], joint.reaction, atol=1e-8 * largest)
    found.destroy()


def test_out_of_balance_by_what_is_added(comm: MPI.Intracomm) -> None:
    """Of more pressure by its forces, the same in the function and in the vector."""
    solver = inflated(comm)
    scene = solver.scene
    scene.air.update(pressure=0.02)
    found, free = solver.residual(), ~scene.held.ravel()
    n = 3 * scene.V.dofmap.index_map.size_local
    forces = found.membrane.x.array
    assert comm.allreduce(float(forces[:n] @ forces[:n])) > 1.0
    np.testing.assert_allclose(
        found.vector.array[free[:n]], forces[:n][free[:n]], rtol=1e-9, atol=1e-12
    )
    up = comm.allreduce(float(forces[:n].reshape(-1, 3)[:, 2] @ free[:n].reshape(-1, 3)[:, 2]))
    assert up < -50.0  # the pressure's slope is minus its force
    found.destroy()


def differences(solver: Solver, d: np.ndarray, h: float) -> np.ndarray:
    """Differences of the residual along owned displacements of all unknowns, (n, 3)."""
    potential = solver.system.potential
    n, x, slopes = len(d), potential.x.copy(), []
    for sign in (1.0, -1.0):
        potential.x[:] = x
        potential.x[:n] += sign * h * d
        potential.place()
        potential.evaluate()
        slopes.append(np.where(potential.unknowns.held[:n], 0.0, potential.g[:n]))
    potential.x[:] = x
    potential.place()
    return (slopes[0] - slopes[1]) / (2 * h)


def times(tangent: Tangent, d: np.ndarray) -> np.ndarray:
    x, y = tangent.matrix.createVecs()
    x.array[:] = d.ravel()
    tangent.matrix.mult(x, y)
    product = y.array.reshape(-1, 3).copy()
    x.destroy()
    y.destroy()
    return product


@pytest.mark.ranks
@pytest.mark.parametrize("build", SCENES)
def test_tangent_is_the_residuals_difference(
    comm: MPI.Intracomm, build: Callable[[MPI.Intracomm], Solver]
) -> None:
    solver = build(comm)
    tangent = solver.tangent()
    unknowns = solver.system.unknowns
    d = noise(unknowns.X[: unknowns.n_owned] / 25.0, 5)
    own = unknowns.sliders[unknowns.sliders < unknowns.n_owned]
    d[own] = 0.0
    d[unknowns.held[: unknowns.n_owned]] = 0.0
    product, twin = times(tangent, d), differences(solver, d, 1e-5)
    error, size = (comm.allreduce(float(np.vdot(v, v))) ** 0.5 for v in (product - twin, twin))
    assert error < 1e-6 * size
    assert tangent.inexact == ()
    assert tangent.sparse.getType().endswith("aij")
    assert (tangent.matrix.getType() == "lrc") == (build is not inflated)
    tangent.destroy()


def test_newtons_method_by_the_tangent(comm: MPI.Intracomm) -> None:
    """From an equilibrium at another load it comes to that of the solver, in steps of its own."""
    solver, twin = inflated(comm), inflated(comm)
    twin.advance(pressure=0.0102)
    scene, n = solver.scene, 3 * solver.scene.V.dofmap.index_map.size_local
    scene.air.update(pressure=0.0102)
    for _ in range(5):
        residual, tangent = solver.residual(), solver.tangent()
        ksp = PETSc.KSP().create(comm)
        ksp.setOperators(tangent.matrix, tangent.sparse)
        ksp.setTolerances(rtol=1e-12)
        step = residual.vector.duplicate()
        ksp.solve(residual.vector, step)
        scene.u.x.array[:n] -= step.array
        scene.u.x.scatter_forward()
        for one in (residual, tangent, ksp, step):
            one.destroy()
    np.testing.assert_allclose(scene.u.x.array, twin.scene.u.x.array, atol=1e-6)


class Springs(EnergyTerm):
    name = "springs"

    def sums(self, x: np.ndarray, out: np.ndarray) -> None:
        own = x[: self.unknowns.n_vertices]
        out[0] = 0.5e-3 * np.vdot(own, own)

    def add_gradient(self, x: np.ndarray, sums: np.ndarray, g: np.ndarray) -> None:
        g[: self.unknowns.n_vertices] += 1e-3 * x[: self.unknowns.n_vertices]


def test_says_of_what_it_is_not_exact(comm: MPI.Intracomm) -> None:
    """Terms of one's own, wind that blows, friction and the paper's laws."""
    solver = inflated(comm)
    scene = solver.scene
    scene.add_term(Springs())
    scene.put_wind(1e-3, -1.0, name="gust")
    assert said(solver) == ("springs",)
    solver.advance(load={"gust": 1.0})
    assert said(solver) == ("springs", "gust")
    scene.lay_cable(Cable(9e3, friction=Friction(0.3, along=0.2)), [(0.0, 47.0), (100.0, 52.0)])
    solver.advance()
    assert set(said(solver)) == {"springs", "gust", "cables", "friction"}
    paper = clamped(scene.mesh, IRON, strain="step", pressure="step")
    other = advanced(Solver(paper), pressure=0.01)
    assert said(other) == ("membrane", "pressure")


def said(solver: Solver) -> tuple[str, ...]:
    tangent = solver.tangent()
    tangent.destroy()
    return tangent.inexact


IRON = type(FOIL)(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
