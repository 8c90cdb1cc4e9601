"""Cable points that can only be displaced along a line: layout, gradient, stiffness, minimiser."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from mpi4py import MPI
from taylor import OnMesh, dense, gradient_order, is_semidefinite, noise, stiffness_error
from term_scene import ISOTROPIC, irregular_square

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.initial_hessian import SHIFT, InitialHessian
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.terms.cable_tension import CableTension
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array

POINTS = 4
"""Cable points of each rank: a tied point, two edge sliders and a free one; the first edge slider
is a ghost on all other ranks."""


def place(rank: int, k: int) -> Array:
    """Where point k of a rank is first, the same on all ranks."""
    return np.random.default_rng((rank, k)).uniform((0, 0, 5), (100, 100, 20))


def direction(rank: int, k: int) -> Array:
    """Unit vector of an edge slider, the same on all ranks."""
    d = np.random.default_rng((rank, k, 1)).normal(size=3)
    return np.asarray(d / np.linalg.norm(d))


def cables(comm: MPI.Intracomm, *, edge_sliders: bool = True) -> OnMesh:
    """Cables through tied points, edge sliders, free points and vertices, and between edge sliders.

    Without edge sliders the same points are free.
    """
    scene = Scene(irregular_square(comm), ISOTROPIC)
    others = [rank for rank in range(comm.size) if rank != comm.rank]
    unknowns = Unknowns(scene.V, POINTS, [(rank, 1) for rank in others])
    vertices, foreign = unknowns.vertex_blocks(), unknowns.ghost_point_blocks()
    own = unknowns.owned_point_blocks()
    unknowns.X[own] = [place(comm.rank, k) for k in range(POINTS)]
    for block, rank in zip(foreign, others, strict=True):
        unknowns.X[block] = place(rank, 1)
    tied_point, first, second, free = own
    unknowns.set_tied_points(own[:1], vertices[None, :3], np.array([[0.2, 0.3, 0.5]]))
    if edge_sliders:
        d = np.array([direction(comm.rank, k) for k in (1, 2)] + [direction(r, 1) for r in others])
        unknowns.set_sliders(np.concatenate([own[1:3], foreign]), d[:, :, None] * d[:, None, :])
    links = [(tied_point, first), (first, second), (second, free), (free, vertices[4])]
    links += [(first, vertices[5]), *((block, second) for block in foreign)]
    n = len(links)
    number = np.array([0, 0, 1, 1, 0, *[1] * len(foreign)], dtype=np.int32)
    EA, lengths = np.array([3000.0, 2000.0]), np.zeros(2)
    term = CableTension(np.array(links, dtype=np.int32), np.full(n, 1e-3), number, EA, np.ones(2))
    f = OnMesh(unknowns, scene.u, [term])
    term.sums(f.potential.x, lengths)
    term.L0 = 0.9 * comm.allreduce(lengths, op=MPI.SUM)
    return f


def shaken(f: OnMesh, seed: int, size: float = 1.0) -> Array:
    """Displacements of the points that this rank owns."""
    return size * noise(f.unknowns.X[: f.unknowns.n_owned], seed)


def projection(f: OnMesh) -> Array:
    """P of all points of all ranks, (3 n, 3 n), from the edge sliders alone."""
    unknowns = f.unknowns
    P = np.eye(3 * unknowns.n_global)
    own = [
        (unknowns.start + int(block), P)
        for block, P in zip(unknowns.sliders, unknowns.projectors, strict=True)
        if block < unknowns.n_owned
    ]
    for number, own_P in (pair for pairs in unknowns.comm.allgather(own) for pair in pairs):
        P[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] = own_P
    return P


def everywhere(f: OnMesh, values: Array) -> Array:
    """Owned values (n, 3) of all ranks, (3 n,)."""
    return np.concatenate(f.unknowns.comm.allgather(values)).ravel()


@pytest.mark.ranks
def test_edge_sliders_stay_on_their_lines(comm) -> None:
    """Ghosts too, wherever the minimiser wants them."""
    f = cables(comm)
    x = shaken(f, 1)
    f.value(x)
    unknowns, placed = f.unknowns, f.potential.x
    ghosts = [(rank, 1) for rank in range(comm.size) if rank != comm.rank]
    edge_sliders = [(comm.rank, 1), (comm.rank, 2), *ghosts]
    for block, (rank, k) in zip(unknowns.sliders, edge_sliders, strict=True):
        d = direction(rank, k)
        np.testing.assert_allclose(placed[block], d * (d @ placed[block]), atol=1e-14)
        if block < unknowns.n_owned:
            assert d @ placed[block] == pytest.approx(d @ x[block], rel=1e-12)
            assert abs(d @ x[block]) > 1e-3
    free = np.setdiff1d(np.arange(unknowns.n_owned), [*unknowns.sliders, *unknowns.tied_points])
    np.testing.assert_array_equal(placed[free], x[free])
    vector, array = unknowns.vector()
    array[: unknowns.n_owned] = placed[: unknowns.n_owned]
    unknowns.update_ghosts(vector)
    np.testing.assert_array_equal(array, placed)
    vector.destroy()


def test_an_edge_slider_is_not_held(comm) -> None:
    f = cables(comm)
    assert not f.unknowns.held[f.unknowns.sliders].any()
    assert f.unknowns.held[f.unknowns.tied_points].all()


def test_gradient_is_that_along_the_lines(comm) -> None:
    f = cables(comm)
    x, d = shaken(f, 1), shaken(f, 2, 5.0)
    assert gradient_order(f, x, d) == pytest.approx(2, abs=0.02)
    along = np.zeros_like(d)
    edge_sliders = f.unknowns.sliders[f.unknowns.sliders < f.unknowns.n_owned]
    along[edge_sliders] = d[edge_sliders]
    assert gradient_order(f, x, along) == pytest.approx(2, abs=0.02)
    _, g = f.value(x)
    _, free = (twin := cables(comm, edge_sliders=False)).value(f.potential.x[: len(x)])
    np.testing.assert_allclose(everywhere(f, g), projection(f) @ everywhere(twin, free), atol=1e-11)
    assert np.abs(free[edge_sliders] - g[edge_sliders]).max() > 1.0


def test_stiffness_is_projected(comm) -> None:
    """P K P entry by entry, K that of the same points without edge sliders."""
    f, twin = cables(comm), cables(comm, edge_sliders=False)
    f.value(shaken(f, 1))
    x = f.potential.x[: f.unknowns.n_owned].copy()
    P, K = projection(f), twin.matrix(x)
    np.testing.assert_allclose(f.matrix(x), P @ K @ P, atol=1e-12 * np.abs(K).max())
    assert np.abs(P @ K @ P - K).max() > 1e-2 * np.abs(K).max()
    assert is_semidefinite(f.matrix(x))


@pytest.mark.ranks
def test_stiffness_and_dyads_are_the_second_derivative(comm) -> None:
    f = cables(comm)
    f.value(shaken(f, 1))
    x, d = f.potential.x[: f.unknowns.n_owned].copy(), shaken(f, 2)
    geometric = f.times

    def times(x: Array, d: Array) -> Array:
        product = geometric(x, d)
        f.value(x)
        for term, k, value in f.potential.dyads():
            f.potential.dyad_column(term, k)
            column = f.potential.g[: len(x)].copy()
            product += value * f.dot(column, d) * column
        return product

    f.times = times  # type: ignore[method-assign]
    assert stiffness_error(f, x, d) < 1e-7


@pytest.mark.ranks
def test_minimiser_gets_forces_along_the_lines(comm) -> None:
    """Those across them count as the scene's own force, to which it compares."""
    f, twin = cables(comm), cables(comm, edge_sliders=False)
    f.unknowns.held[f.unknowns.vertex_blocks()] = True
    _, g = f.value(shaken(f, 1))
    held = f.unknowns.held[: len(g)]
    free = np.where(held, 0.0, g)
    whole = np.where(held, 0.0, twin.value(f.potential.x[: len(g)])[1])
    energy, scale = f.potential.evaluate_terms()
    assert scale == pytest.approx(np.sqrt(f.dot(whole, whole)), rel=1e-12)
    np.testing.assert_allclose(f.potential.g[: len(g)], g, rtol=1e-12, atol=1e-12)
    G = f.potential.g_vector.duplicate()
    X = f.potential.x_vector.copy()
    assert f.potential.objective_gradient(None, X, G) == pytest.approx(energy, rel=1e-14)
    np.testing.assert_allclose(G.array.reshape(-1, 3), free, rtol=1e-12, atol=1e-12)
    G.destroy()
    X.destroy()


@pytest.mark.ranks
def test_initial_hessian_is_its_dense_twin(comm) -> None:
    """P K P, and the size of K across the lines and where points are held."""
    f = cables(comm)
    f.unknowns.held[f.unknowns.vertex_blocks()] = True
    potential = f.potential
    f.value(shaken(f, 1))
    x = f.potential.x[: f.unknowns.n_owned].copy()
    h0 = InitialHessian(potential, "crms_test_h0_")
    h0.rebuild()
    P, free = projection(f), ~everywhere(f, f.unknowns.held[: len(x)])
    K = P @ cables(comm, edge_sliders=False).matrix(x) @ P
    K[~free], K[:, ~free] = 0.0, 0.0
    traces = np.diag(K).reshape(-1, 3).sum(axis=1)
    largest = traces.max()
    shift = np.repeat(SHIFT * (traces + np.exp(np.mean(np.log(traces[traces > 0])))), 3)
    K += np.diag(np.where(free, shift, largest)) + largest * (np.eye(len(P)) - P)
    found = dense(h0.matrix)
    np.testing.assert_allclose(found, K, atol=1e-12 * largest)
    assert np.linalg.eigvalsh(found).min() > 0.5 * shift.min()
    for term, k, value in list(potential.dyads()):
        potential.dyad_column(term, k)
        column = np.where(free, everywhere(f, potential.g[: len(x)]), 0.0)
        K += value * np.outer(column, column)
    b, y = potential.x_vector.duplicate(), potential.x_vector.duplicate()
    b.array[:] = (P @ everywhere(f, shaken(f, 3)))[3 * f.unknowns.start :][: len(b.array)]
    h0.solve(b, y)
    solution = everywhere(f, y.array.reshape(-1, 3))
    scale = np.abs(solution).max()
    right = everywhere(f, b.array.reshape(-1, 3))
    np.testing.assert_allclose(K @ solution, right, atol=1e-12 * largest)
    np.testing.assert_allclose(P @ solution, solution, atol=1e-12 * scale)
    for thing in (h0, b, y):
        thing.destroy()


def test_projection_allocates_nothing(comm) -> None:
    n = 2000
    unknowns = Unknowns(Scene(irregular_square(comm), ISOTROPIC).V, n)
    values = np.ones((unknowns.n_local, 3))
    unknowns.project(values)
    assert (values == 1.0).all()  # without edge sliders
    d = np.array([0.6, 0.0, 0.8])
    unknowns.set_sliders(unknowns.owned_point_blocks(), np.tile(np.outer(d, d), (n, 1, 1)))
    tracemalloc.start()
    unknowns.project(values)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(values[unknowns.sliders], np.tile([0.84, 0.0, 1.12], (n, 1)))
    assert peak < 8 * n  # less than one component of the edge sliders


def between(comm: MPI.Intracomm, anchors: Array, lines: list[tuple[Array, Array]]) -> OnMesh:
    """A cable between two anchors over edge sliders (place, direction).

    The first rank has the anchors and computes all, the last one the edge sliders.
    """
    scene = Scene(irregular_square(comm), ISOTROPIC)
    last, n = comm.size - 1, len(lines)
    ghosts = [(last, k + 2 * (last == 0)) for k in range(n)] if comm.rank == 0 < last else []
    count = 2 * (comm.rank == 0) + n * (comm.rank == last)
    unknowns = Unknowns(scene.V, count, ghosts)
    points = np.concatenate([unknowns.owned_point_blocks(), unknowns.ghost_point_blocks()])
    edge_sliders = points[2 * (comm.rank == 0) :]
    segments = np.zeros((0, 2), dtype=np.int32)
    if comm.rank == 0:
        unknowns.X[points[:2]] = anchors
        unknowns.held[points[:2]] = True
        chain = np.array([points[0], *edge_sliders, points[1]], dtype=np.int32)
        segments = np.stack([chain[:-1], chain[1:]], axis=1)
    unknowns.held[unknowns.vertex_blocks()] = True
    if len(edge_sliders):
        unknowns.X[edge_sliders] = [start for start, _ in lines]
        unknowns.set_sliders(edge_sliders, np.array([np.outer(d, d) for _, d in lines]))
    m = len(segments)
    cable = np.zeros(m, dtype=np.int32)
    term = CableTension(segments, np.full(m, 1e-3), cable, np.array([3000.0]), np.array([50.0]))
    return OnMesh(unknowns, scene.u, [term])


def ways(f: OnMesh, d: Array) -> Array:
    """How far the edge sliders have gone along their direction d, on all ranks."""
    unknowns = f.unknowns
    own = unknowns.sliders < unknowns.n_owned
    way = f.potential.x[unknowns.sliders[own]] @ d
    return np.concatenate(unknowns.comm.allgather(way))


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["across", "reflected"])
def test_a_cable_over_an_edge_slider_is_straight_when_unfolded(comm, side: float) -> None:
    """The edge slider divides the anchors' way along it as the anchors' distances from it."""
    d = np.array([2.0, -1.0, 2.0]) / 3
    normal = np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
    start = np.array([30.0, 20.0, 10.0])
    near = start - 5 * d + 12 * normal
    far = start + 40 * d - side * 30 * np.cross(d, normal) * 0.6 - side * 30 * normal * 0.8
    f = between(comm, np.array([near, far]), [(start, d)])
    minimizer = Minimizer(f.potential, "crms_test_", 1e-11)
    outcome = minimizer.solve()
    assert outcome.converged
    # 7 and 2 measured, 5 and 2 over four edge sliders below
    assert outcome.iterations <= 8 and outcome.factorizations <= 3
    expected = (-5.0 * 30 + 40.0 * 12) / (12 + 30)
    # the tension's force along the edge slider is 1e-11 of itself, its stiffness T/12 + T/30
    np.testing.assert_allclose(ways(f, d), [expected], rtol=0, atol=1e-8)
    minimizer.destroy()


def test_a_cable_over_many_edge_sliders_is_the_shortest(comm) -> None:
    """Parallel edge sliders over a hill: they divide the way along them as its lengths across."""
    d = np.array([0.6, 0.8, 0.0])
    across = np.array([0.8, -0.6, 0.0])
    run = np.array([0.0, 11.0, 30.0, 44.0, 60.0, 75.0])
    rise = np.array([0.0, 6.0, 15.0, 17.0, 9.0, -2.0])
    places = run[:, None] * across + rise[:, None] * np.array([0.0, 0.0, 1.0])
    anchors = np.array([places[0], places[-1] + 25.0 * d])
    f = between(comm, anchors, [(p, d) for p in places[1:-1]])
    minimizer = Minimizer(f.potential, "crms_test_", 1e-11)
    outcome = minimizer.solve()
    assert outcome.converged and outcome.iterations <= 12 and outcome.factorizations <= 4
    lengths = np.cumsum(np.hypot(np.diff(run), np.diff(rise)))
    np.testing.assert_allclose(ways(f, d), 25.0 * lengths[:-1] / lengths[-1], rtol=0, atol=1e-8)
    minimizer.destroy()
