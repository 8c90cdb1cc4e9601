"""The initial Hessian: sparse part, dyads of the cables, and its solver, also with the tensions of
cables as unknowns."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from cabled_square import clamped, put, sheet
from mpi4py import MPI
from petsc4py import PETSc
from ridged_square import OBLIQUE, preconditioners, ridged
from taylor import noise
from term_scene import cable_square, displaced

from crms_fenicsx import Cable, IsotropicMembrane, Solver, meshes
from crms_fenicsx.analysis.equilibrium import system as equilibrium
from crms_fenicsx.cabling.cables.node_positions import NodePositions
from crms_fenicsx.energy.minimization.augmented_stiffness import AugmentedStiffness
from crms_fenicsx.energy.minimization.initial_hessian import (
    SHIFT,
    WORKSPACE,
    InitialHessian,
    direct_solver,
)
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.strategy import STRATEGY
from crms_fenicsx.model.laid_cable import polyline_length


def at_some_state(comm):
    """The square's potential, and its H0."""
    h0 = h0_of(comm)
    h0.rebuild()
    return h0.potential, h0


def dense(potential, h0):
    """H0 = K + sum of value x column x column^T, entry by entry, from the terms themselves."""
    K = h0.matrix[:, :].copy()
    n = potential.unknowns.n_owned
    free = ~potential.unknowns.held[:n]
    for term, k, value in list(potential.dyads()):
        potential.dyad_column(term, k)
        column = (potential.g[:n] * free).ravel()
        K += value * np.outer(column, column)
    return K


@pytest.mark.ranks
def test_its_memory_is_there_beforehand_and_not_much_too_much(comm) -> None:
    """PETSc would raise an error for a row that has more entries than counted."""
    _, h0 = at_some_state(comm)
    info = h0.matrix.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)
    assert info["mallocs"] == 0
    if comm.size == 1:  # its values are those that terms have added up
        assert info["nz_allocated"] == 0
    else:  # rows that ranks share are counted on both
        assert info["nz_used"] <= info["nz_allocated"] < 2 * info["nz_used"]


def test_its_memory_is_exact_without_cables() -> None:
    mesh = meshes.rectangle(MPI.COMM_SELF, 3.0, 2.0, 0.5)
    scene = clamped(mesh, IsotropicMembrane(E=1.0, nu=0.3, thickness=1.0))
    allocated = len(Solver(scene).system.minimizer.h0.matrix.getValuesCSR()[2])
    edges, vertices = (mesh.mesh.topology.index_map(dim).size_global for dim in (1, 0))
    assert allocated == 9 * (vertices + 2 * edges)


def test_solver_inverts_stiffness_and_dyads() -> None:
    potential, h0 = at_some_state(MPI.COMM_SELF)
    assert len(list(potential.dyads())) >= 2
    b, y = potential.x_vector.duplicate(), potential.x_vector.duplicate()
    b.array[:] = noise(potential.unknowns.X, 4).ravel()
    h0.solve(b, y)
    np.testing.assert_allclose(dense(potential, h0) @ y.array, b.array, atol=1e-8)


def test_it_is_symmetric_positive_definite() -> None:
    potential, h0 = at_some_state(MPI.COMM_SELF)
    H = dense(potential, h0)
    np.testing.assert_allclose(H, H.T, atol=1e-12 * np.abs(H).max())
    assert np.linalg.eigvalsh(H).min() > 0.5 * SHIFT


@pytest.mark.ranks
def test_dyad_columns_are_gradients_of_the_lengths(comm) -> None:
    system = cable_square(comm)
    potential, n = system.potential, system.unknowns.n_owned
    x, d = displaced(system.unknowns, 0.5), noise(system.unknowns.X[: system.unknowns.n_owned], 7)
    lengths, step = [], 1e-5
    for sign in (1, -1):
        potential.x[:n] = x + sign * step * d
        potential.place()
        NodePositions(system.cables.numbering, system.unknowns).gather(potential.x)
        cables = system.scene.cables
        lengths.append(
            [polyline_length(cable.state.positions[cable.contacts()]) for cable in cables]
        )
    potential.x[:n] = x
    potential.place()
    potential.sum_up()
    # tied points go with their vertices, whatever d says of them
    for k, (term, number, _) in enumerate(list(potential.dyads())):
        potential.dyad_column(term, number)
        slope = comm.allreduce(float(np.vdot(potential.g[:n], d)))
        assert slope == pytest.approx((lengths[0][k] - lengths[1][k]) / (2 * step), rel=1e-6)


@pytest.mark.ranks
def test_a_scene_without_tension_has_no_dyads(comm) -> None:
    assert list(cable_square(comm, taut=False).potential.dyads()) == []


def test_held_anchors_do_not_set_its_size(comm) -> None:
    """An anchor within rounding of its held place has a stiff link to it, which must not count."""
    scene = sheet(comm, 4)
    cable = scene.lay_cable(Cable(32000.0), [(0.0, 51.0), (100.0, 31.0)], tension=10.0)
    solver = Solver(scene)
    put(cable, "positions", 0, cable.state.positions[0] + 1e-15)
    potential = solver.system.potential
    solver.system.read_scene()
    potential.evaluate()
    h0 = InitialHessian(potential, "crms_test_h0_")
    h0.rebuild()
    assert h0.matrix.getDiagonal().max()[1] < 1e4


@pytest.mark.parametrize("own", [None, 55])
def test_workspace_of_mumps_is_ample_unless_an_option_says_otherwise(own: int | None) -> None:
    """With MUMPS's own estimate some distributions of a mesh ended in "line search failed"."""
    options = {"pc_factor_mat_solver_type": "mumps"}
    if own is not None:
        options["mat_mumps_icntl_14"] = str(own)
    database = PETSc.Options("crms_test_h0_")
    for name, value in options.items():
        database[name] = value
    try:
        _, h0 = at_some_state(MPI.COMM_SELF)
        with_tensions = h0._augmented.factor.getFactorMatrix()
        assert with_tensions.getMumpsIcntl(14) == (own or WORKSPACE)
        h0.potential.dyads = lambda exact: iter(())
        h0.rebuild()
        assert h0.pc.getFactorMatrix().getMumpsIcntl(14) == (own or WORKSPACE)
    finally:
        for name in options:
            database.delValue(name)


@pytest.fixture
def multigrid():
    """Multigrid by an option."""
    database = PETSc.Options("crms_h0_")
    database["pc_type"] = "gamg"
    yield "gamg"
    database.delValue("pc_type")


def use(monkeypatch, **numbers) -> None:
    """Have solvers minimise with other numbers."""
    minimizer = partial(Minimizer, strategy=replace(STRATEGY, **numbers))
    monkeypatch.setattr(equilibrium, "Minimizer", minimizer)


def test_multigrid_is_for_many_unknowns(comm, monkeypatch) -> None:
    """But not under cables."""
    use(monkeypatch, direct=0)
    assert preconditioners(comm) == ["gamg", "cholesky"]


@pytest.mark.ranks
def test_multigrid_solves_too_and_leaves_alone_what_is_held(comm, monkeypatch, multigrid) -> None:
    """Held components and those across edge sliders are no business of its coarse levels."""
    use(monkeypatch, cg_accuracy=1e-11)
    solver, _ = cabled(comm)
    solver.advance(pressure=0.01)
    h0, potential = solver.system.minimizer.h0, solver.system.potential
    potential.evaluate()
    h0.rebuild()
    assert h0.pc.getType() == multigrid and len(list(potential.dyads())) == 2
    unknowns = potential.unknowns
    assert comm.allreduce(unknowns.n_sliders) > 0
    b, y, back = (potential.x_vector.duplicate() for _ in range(3))
    n = unknowns.n_owned
    values = noise(unknowns.X, 4)
    values[unknowns.held] = 0.0
    unknowns.project(values)
    b.array[:] = values[:n].ravel()
    h0.solve(b, y)
    assert np.all(y.array.reshape(-1, 3)[unknowns.held[:n]] == 0.0)
    h0.multiply(y, back)
    back.axpy(-1.0, b)
    assert back.norm() < 2e-9 * b.norm()


@pytest.mark.ranks
def test_multigrid_leads_to_the_same_equilibrium(comm, multigrid, monkeypatch) -> None:
    """By the same H0: the second derivatives, which may be indefinite, are for factorisations."""
    use(monkeypatch, exact=0.0)
    database = PETSc.Options("crms_h0_")
    database["pc_type"] = "cholesky"
    solver, cables = cabled(comm)
    direct = solver.advance(pressure=0.01)
    tensions = [cable.tension for cable in cables]
    database["pc_type"] = multigrid
    solver, cables = cabled(comm)
    step = solver.advance(pressure=0.01)
    assert step.energy == pytest.approx(direct.energy, rel=1e-9)
    assert [cable.tension for cable in cables] == pytest.approx(tensions, rel=1e-7)
    assert step.outcome.evaluations <= 1.2 * direct.outcome.evaluations


def cabled(comm):
    """A square held around and along a line, with a cable over all that and one beside it."""
    scene = ridged(comm)
    cables = [
        scene.lay_cable(Cable(EA=3200.0), path=path)
        for path in (OBLIQUE, [(20.0, 0.0), (31.0, 100.0)])
    ]
    return Solver(scene), cables


@pytest.mark.parametrize(
    "packages, solver",
    [
        ({"cholmod", "mumps"}, "cholmod"),
        ({"suitesparse", "mumps"}, "cholmod"),
        ({"mumps"}, "mumps"),
        (set(), "petsc"),
    ],
)
def test_factorised_by_what_petsc_has(
    packages: set[str], solver: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As wheels of DOLFINx from PyPI have no CHOLMOD."""
    system = SimpleNamespace(hasExternalPackage=packages.__contains__)
    monkeypatch.setattr(PETSc, "Sys", system)
    assert direct_solver(MPI.COMM_SELF) == solver


def test_petscs_own_factorisation_leads_to_the_same_equilibrium(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    energies = []
    for solver in ("cholmod", "mumps", "petsc"):
        monkeypatch.setattr(
            "crms_fenicsx.energy.minimization.initial_hessian.direct_solver",
            lambda _, own=solver: own,
        )
        scene = sheet(MPI.COMM_SELF, 4, "unstructured")
        energies.append(Solver(scene).advance(pressure=0.01).energy)
    np.testing.assert_allclose(energies, energies[0], rtol=1e-10)


def h0_of(comm: MPI.Comm) -> InitialHessian:
    """H0 of a square with three cables in tension, displaced."""
    system = cable_square(comm)
    potential, n = system.potential, system.unknowns.n_owned
    potential.x[:n] = displaced(system.unknowns, 0.5) * ~system.unknowns.held[:n]
    potential.place()
    potential.evaluate()
    return InitialHessian(potential, "crms_test_h0_")


def assert_solved(h0: InitialHessian) -> None:
    """The residual of a solve, with K and the dyads multiplied one by one."""
    potential = h0.potential
    unknowns = potential.unknowns
    b, y, product = (potential.x_vector.duplicate() for _ in range(3))
    free = ~unknowns.held[: unknowns.n_owned]
    b.array[:] = (noise(unknowns.X, 4)[: unknowns.n_owned] * free).ravel()
    h0.solve(b, y)
    h0.matrix.mult(y, product)
    for term, k, value in list(potential.dyads()):
        potential.dyad_column(term, k)
        column = (potential.g[: unknowns.n_owned] * free).ravel()
        product.array[:] += value * column * potential.comm.allreduce(float(column @ y.array_r))
    product.axpy(-1.0, b)
    assert product.norm() < 1e-9 * b.norm()


@pytest.mark.ranks
def test_several_processes_solve_with_tensions_as_unknowns(comm: MPI.Comm) -> None:
    h0 = h0_of(comm)
    assert h0.rebuild()
    assert h0._is_augmented == (comm.size > 1)
    assert len(list(h0.potential.dyads())) >= 2
    assert_solved(h0)
    h0.destroy()


def test_one_process_does_where_the_sparse_part_is_not_definite(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    h0 = h0_of(MPI.COMM_SELF)
    monkeypatch.setattr(h0, "_set_up", lambda: False)
    assert h0.rebuild() and h0._is_augmented
    assert_solved(h0)
    monkeypatch.undo()
    assert h0.rebuild() and not h0._is_augmented
    assert_solved(h0)
    h0.destroy()


def of_diagonal(comm: MPI.Comm, diagonal: list[float]) -> tuple[PETSc.Mat, AugmentedStiffness]:
    """A diagonal matrix with the same entries on each rank."""
    n = len(diagonal)
    start = n * comm.rank
    csr = (range(n + 1), range(start, start + n), diagonal)
    K = PETSc.Mat().createAIJ(((n, n * comm.size),) * 2, csr=csr, comm=comm)
    return K, AugmentedStiffness(K, "crms_test_h0_")


@pytest.mark.ranks
@pytest.mark.parametrize("stiffness, definite", [(0.6, True), (0.4, False), (0.0, False)])
def test_a_dyad_makes_up_for_a_negative_eigenvalue(
    comm: MPI.Comm, stiffness: float, definite: bool
) -> None:
    """Of K + G C G^T, whose smallest eigenvalue is the stiffness less 0.5."""
    _, augmented = of_diagonal(comm, [1.0, -0.5 if comm.rank == comm.size - 1 else 1.0, 2.0])
    columns = np.zeros((3, 2))
    if comm.rank == comm.size - 1:
        columns[1, 0] = np.sqrt(stiffness)
    if comm.rank == 0:
        columns[2, 1] = 1.0
    assert augmented.factorize(columns) == definite
    augmented.destroy()


@pytest.mark.ranks
def test_dyads_come_and_go(comm: MPI.Comm) -> None:
    """Of cables that become taut, and of points that a cable reaches."""
    K, augmented = of_diagonal(comm, [1.0] * 6)
    b, y = K.createVecs()
    b.set(1.0)
    for columns in (np.eye(6)[:, :1], np.eye(6)[:, 3:5], np.ones((6, 2)) / 4, np.eye(6)[:, 3:5]):
        assert augmented.factorize(columns)
        augmented.solve(b, y)
        product = y.array_r + columns @ comm.allreduce(columns.T @ y.array_r)
        np.testing.assert_allclose(product, b.array_r, atol=1e-12)
    augmented.destroy()
