"""Multigrid under cables: points eliminated exactly, then the membrane as if without cables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from mpi4py import MPI
from parallel import roof
from petsc4py import PETSc
from ridged_square import OBLIQUE, preconditioners, ridged
from taylor import noise
from term_scene import FABRIC, cable_square, displaced, irregular_square

from crms_fenicsx import Cable, EnergyTerm, Scene, Solver
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.minimization.initial_hessian import InitialHessian
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.dofs.block_patterns import SegmentPattern
from crms_fenicsx.foundation.runtime.arrays import Array

SPLIT = {"pc_type": "fieldsplit"}
PREFIX = "crms_test_h0_"


@contextmanager
def options(values: dict[str, str], prefix: str = PREFIX) -> Iterator[None]:
    """Options of PETSc's database while a preconditioner is made."""
    database = PETSc.Options(prefix)
    for name, value in values.items():
        database[name] = value
    try:
        yield
    finally:
        for name in values:
            database.delValue(name)


def rebuilt(potential: Potential, values: dict[str, str]) -> InitialHessian:
    """H0 at the potential's state, with a preconditioner by options."""
    with options(values):
        potential.evaluate()
        h0 = InitialHessian(potential, PREFIX)
        h0.rebuild()
    return h0


def at_some_state(system: System) -> Potential:
    """A system's potential at a displaced state."""
    potential, n = system.potential, system.unknowns.n_owned
    potential.x[:n] = displaced(system.unknowns, 0.5) * ~system.unknowns.held[:n]
    potential.place()
    potential.evaluate()
    return potential


def free_vector(potential: Potential, seed: int = 4) -> PETSc.Vec:
    """A right-hand side as a gradient has: nothing where held or across edge sliders."""
    unknowns, b = potential.unknowns, potential.x_vector.duplicate()
    values = noise(unknowns.X, seed)
    values[unknowns.held] = 0.0
    unknowns.project(values)
    b.array[:] = values[: unknowns.n_owned].ravel()
    return b


class Bars(EnergyTerm):
    """Bars from each of this rank's vertices to the next one, which need not share an edge."""

    name = "anchor bars"

    def attach(self, unknowns) -> None:
        super().attach(unknowns)
        ends = np.arange(unknowns.n_vertices, dtype=np.int32)
        self.pattern = SegmentPattern(np.stack([ends[:-1], ends[1:]], axis=1))
        self.patterns = (self.pattern,)

    def sums(self, x, out) -> None:
        out[0] = 0.0

    def add_gradient(self, x, sums, g) -> None:
        pass

    def add_stiffness(self, x, sums, A) -> None:
        self.pattern.values[:] = 3.0 * np.eye(3)
        self.pattern.add(A)


@pytest.mark.parametrize("material", ["isotropic", "orthotropic"])
def test_stiffness_without_cables_is_that_of_a_scene_without_any(comm, material: str) -> None:
    """Also what a user's term adds, and where tied points and other ranks' vertices come in."""
    choice = {} if material == "isotropic" else {"material": FABRIC}
    system = cable_square(comm, **choice)
    bare = Scene(irregular_square(comm), system.scene.membrane.materials[0])
    bare.fix("boundary")
    for scene in (system.scene, bare):
        scene.add_term(Bars())
    system.rebuild()
    system.read_scene()
    potential = at_some_state(system)
    M = rebuilt(potential, SPLIT)._membrane.matrix
    twin = System(bare, "crms_test_", 1e-8)
    n = twin.unknowns.n_owned
    twin.potential.x[:n] = potential.x[:n]
    twin.potential.place()
    K = rebuilt(twin.potential, {}).matrix
    assert M.getSizes() == K.getSizes()
    d, product, expected = K.createVecLeft(), K.createVecLeft(), K.createVecLeft()
    d.array[:] = (noise(twin.unknowns.X[:n], 3) * ~twin.unknowns.held[:n]).ravel()
    M.mult(d, product)
    K.mult(d, expected)
    product.axpy(-1.0, expected)
    assert product.norm() < 1e-12 * expected.norm()
    info = M.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)
    assert info["mallocs"] == 0


def test_points_are_eliminated_exactly() -> None:
    """With M factorised the inverse of the preconditioner is K with M for the Schur complement."""
    potential = at_some_state(cable_square(MPI.COMM_SELF))
    h0 = rebuilt(potential, SPLIT | {"fieldsplit_vertices_pc_type": "cholesky"})
    K, M = h0.matrix[:, :], h0._membrane.matrix[:, :]
    n = len(M)
    assert 3 < len(K) - n
    Kvp, Kpp = K[:n, n:], K[n:, n:]
    expected = K.copy()
    expected[:n, :n] = M + Kvp @ np.linalg.solve(Kpp, Kvp.T)
    found = np.linalg.inv(preconditioner(h0, h0.pc.apply, np.eye(len(K))))
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(K).max())


def preconditioner(
    h0: InitialHessian, apply: Callable[[PETSc.Vec, PETSc.Vec], None], basis: Array
) -> Array:
    """What a preconditioner makes of each column of a basis."""
    b, y = h0.matrix.createVecs()
    columns = []
    for column in basis.T:
        b.array[:] = column
        apply(b, y)
        columns.append(y.array.copy())
    return np.stack(columns, axis=1)


def scene_with(comm, what: str) -> System:
    """Cables that bend over lines that are held, on edge sliders; a floor touches half of it."""
    scene = ridged(comm, size=20.0)
    paths = [OBLIQUE, [(20.0, 0.0), (31.0, 100.0)]]
    if what == "crossings":
        paths += [[(0.0, 40.0), (100.0, 55.0)], [(0.0, 61.0), (100.0, 30.0)]]
    for path in paths:
        scene.lay_cable(Cable(EA=3200.0), path=path)
    solver = Solver(scene)
    solver.advance(pressure=0.01)
    system = solver.system
    if what == "floor":  # where it is now, so that what the forces press down is held
        unknowns, potential = system.unknowns, system.potential
        potential.x[: unknowns.n_owned] += 0.1 * free_vector(potential).array.reshape(-1, 3)
        potential.place()
        lower = np.full_like(unknowns.X, -np.inf)
        lower[:, 2] = potential.x[:, 2]
        lower[unknowns.held] = lower[unknowns.edge_sliders] = -np.inf
        unknowns.bounds = lower, np.full_like(lower, np.inf)
    return system


@pytest.mark.ranks
@pytest.mark.parametrize("what", ["edge sliders", "crossings", "floor"])
def test_it_leads_to_the_step_of_a_factorisation(comm, what: str, monkeypatch) -> None:
    monkeypatch.setattr("crms_fenicsx.energy.minimization.initial_hessian.ACCURACY", 1e-11)
    potential = scene_with(comm, what).potential
    unknowns, n = potential.unknowns, potential.unknowns.n_owned
    direct, split = rebuilt(potential, {}), rebuilt(potential, SPLIT)
    assert split.pc.getType() == "fieldsplit" and direct.pc.getType() == "cholesky"
    assert comm.allreduce(unknowns.n_edge_sliders) > 0
    assert len(list(potential.dyads())) >= 2
    pressed = split._held & ~unknowns.held[:n]
    assert (comm.allreduce(int(pressed.sum())) > 0) == (what == "floor")
    b = free_vector(potential)
    b.array.reshape(-1, 3)[split._held] = 0.0
    y, expected = b.duplicate(), b.duplicate()
    direct.solve(b, expected)
    split.solve(b, y)
    assert np.all(y.array.reshape(-1, 3)[split._held] == 0.0)
    y.axpy(-1.0, expected)
    assert y.norm() < 1e-8 * expected.norm()
    assert expected.norm() > 0.0


def test_it_is_symmetric_positive_definite() -> None:
    """As conjugate gradients want it, on all that is free."""
    potential = scene_with(MPI.COMM_SELF, "crossings").potential
    h0 = rebuilt(potential, SPLIT)
    unknowns = potential.unknowns
    n = unknowns.n_owned
    P = np.diag(np.where(unknowns.held[:n], 0.0, 1.0).ravel())
    for edge_slider, d in zip(unknowns.edge_sliders, unknowns.directions, strict=True):
        rows = slice(3 * edge_slider, 3 * edge_slider + 3)
        P[rows, rows] = np.outer(d, d) * ~unknowns.held[edge_slider]
    w, V = np.linalg.eigh(P)
    free = V[:, w > 0.5]
    B = free.T @ preconditioner(h0, h0.precondition, free)
    np.testing.assert_allclose(B, B.T, atol=1e-10 * np.abs(B).max())
    assert np.linalg.eigvalsh(B).min() > 0.0


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_a_net_takes_few_iterations(comm, monkeypatch) -> None:
    """To 1e-2 19 and to 1e-8 57; multigrid on the whole of K takes 59 and more than 3000.

    If multigrid took its residuals with the Schur complement it would be 200 to 1e-8.
    """
    _, solver = roof(1500.0, 14, slide=False)
    solver.advance(pressure=0.3)
    potential, unknowns = solver.system.potential, solver.system.unknowns
    values, n = noise(unknowns.X, 4), unknowns.n_owned
    values[:n] *= np.random.default_rng(comm.rank).normal(size=(n, 3))
    values[unknowns.held] = 0.0
    x, b, y = (potential.x_vector.duplicate() for _ in range(3))
    x.array[:] = values[:n].ravel()
    for accuracy, most in ((1e-2, 30), (1e-8, 80)):
        monkeypatch.setattr("crms_fenicsx.energy.minimization.initial_hessian.ACCURACY", accuracy)
        h0 = rebuilt(potential, SPLIT)
        h0.multiply(x, b)
        h0.solve(b, y)
        assert 0 < h0._outer.getIterationNumber() <= most
        y.axpy(-1.0, x)
        assert y.norm() < 10 * accuracy * x.norm()


def test_without_points_it_is_multigrid_on_the_whole(comm) -> None:
    """An option for a whole run must do for its load steps before the first cable too."""
    with options(SPLIT, "crms_h0_"):
        assert preconditioners(comm)[1] == ["gamg", "fieldsplit"]
