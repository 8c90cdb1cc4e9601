"""Clusters of blocks that elements join, and their stiffness in envelopes beside dense matrices."""

import numpy as np
import pytest
from polygon_twins import closed, connected, dense_cluster

from crms_fenicsx.energy.minimization.cluster_matrix import ClusterLayout, ClusterMatrix
from crms_fenicsx.energy.minimization.initial_hessian import EXACT_SHIFT, SHIFT
from crms_fenicsx.foundation.dofs.block_patterns import ColumnPattern, ElementPattern
from crms_fenicsx.foundation.dofs.layout import rows_of
from crms_fenicsx.foundation.dofs.local_blocks import LocalBlocks


@pytest.mark.parametrize("seed", range(5))
def test_clusters_are_what_elements_join(seed):
    rng, n = np.random.default_rng(seed), 80
    whole = LocalBlocks(rng.normal(size=(n, 3)))
    on = np.array([[3, 4, 5], [30, 40, 50]], dtype=np.int32)
    whole.set_tied_points(np.array([70, 71], dtype=np.int32), on, np.full((2, 3), 1 / 3))
    blocks = np.sort(rng.permutation(70)[:50]).astype(np.int32)
    tables = [rng.integers(0, n, (count, k)).astype(np.int32) for count, k in ((9, 2), (6, 4))]
    layout = ClusterLayout(whole, blocks, [rows_of(table) for table in tables])
    carried = {70: on[0], 71: on[1]}
    joined = [
        {int(b) for member in row for b in carried.get(int(member), [member]) if b in blocks}
        for table in tables
        for row in table
    ]
    own = np.split(layout.blocks, layout.starts[1:-1])
    assert {frozenset(map(int, some)) for some in own} == connected(joined, blocks.tolist())
    assert np.array_equal(layout.number[layout.blocks], np.arange(50))
    for table in tables:
        expected = [max(layout.groups[row]) for row in table]
        assert np.array_equal(layout.clusters_of(*rows_of(table)), expected)


def test_blocks_of_an_element_are_close_in_a_strip():
    """However they are numbered: two rows of blocks along a strip, whose width is two."""
    number = np.random.default_rng(1).permutation(200).astype(np.int32)
    squares = number[2 * np.arange(99)[:, None] + np.arange(4)]
    blocks = np.arange(200, dtype=np.int32)
    layout = ClusterLayout(LocalBlocks(np.zeros((200, 3))), blocks, [rows_of(squares)])
    assert layout.n_clusters == 1
    assert np.ptp(layout.number[squares], axis=1).max() <= 5


def test_no_blocks_are_no_cluster():
    none = np.zeros(0, dtype=np.int32)
    layout = ClusterLayout(LocalBlocks(np.zeros((3, 3))), none, [])
    assert layout.n_clusters == 0
    assert np.array_equal(layout.groups, [-1, -1, -1])


N = 60


def assembled(shift=0.0, held=(), sliders=(), tied=()):
    """The matrix of chains of triangles between N blocks at random, with three dyads, and its
    layout; `shift` is added to its blocks."""
    rng = np.random.default_rng(3)
    whole = LocalBlocks(rng.normal(size=(N, 3)))
    whole.held[list(held), 1] = True
    lines = rng.normal(size=(len(sliders), 3))
    lines /= np.linalg.norm(lines, axis=1)[:, None]
    projectors = lines[:, :, None] * lines[:, None, :]
    projectors[::2] = np.eye(3) - projectors[::2]  # in planes, the others along lines
    whole.set_sliders(np.array(sliders, dtype=np.int32), projectors)
    on = np.array([[10, 11, 12], [20, 21, 22]][: len(tied)], dtype=np.int32).reshape(-1, 3)
    weights = np.full(on.shape, 1 / 3)
    whole.set_tied_points(np.array(tied, dtype=np.int32), on, weights)
    number = rng.permutation(N).astype(np.int32)
    triangles = number[np.arange(N - 2)[:, None] + np.arange(3)]
    moves = np.setdiff1d(np.arange(N), [*number[[17, 18, 40, 41]], *tied]).astype(np.int32)
    elements = rows_of(triangles)
    layout = ClusterLayout(whole, moves, [elements])
    pattern = ElementPattern(*elements)
    roots = rng.normal(size=(len(triangles), 9, 9))
    blocks = roots @ roots.transpose(0, 2, 1) + shift * np.eye(9)
    pattern.values[:] = blocks.reshape(-1, 3, 3, 3, 3).transpose(0, 1, 3, 2, 4).reshape(-1, 3, 3)
    column, place = np.array([(0, 3), (1, 8), (1, 15), (0, 0), (2, 50), (2, 55), (1, 17)]).T
    owners = layout.groups[number[[3, 8, 50]]]  # columns are numbered in the clusters' order
    column = np.argsort(np.argsort(owners, kind="stable"))[column]
    dyads = ColumnPattern(column, number[place])
    dyads.values[:] = rng.normal(size=(len(place), 3))
    matrix = ClusterMatrix(layout, [pattern], dyads)
    matrix.clear()
    matrix.take(pattern)
    matrix.take_columns(dyads)
    return matrix, layout, pattern, dyads


def dense_blocks(layout, pattern, dyads):
    """The same matrix of all blocks, (3 N, 3 N), one by one; tied points hand their part on."""
    K, columns = np.zeros((N, 3, N, 3)), np.zeros((3, N, 3))
    for i, j, block in zip(pattern.rows, pattern.cols, pattern.values, strict=True):
        K[i, :, j] += block
    for column, i, value in zip(dyads.columns, dyads.blocks, dyads.values, strict=True):
        columns[column, i] += value
    columns = columns.reshape(3, -1)
    P = np.eye(3 * N)
    whole = layout.whole
    for point, on, shares in zip(
        whole.tied_points, whole.interpolation, whole.weights, strict=True
    ):
        P[3 * point : 3 * point + 3] = 0.0
        for vertex, share in zip(on, shares, strict=True):
            P[3 * point : 3 * point + 3, 3 * vertex : 3 * vertex + 3] = share * np.eye(3)
    return P.T @ (K.reshape(3 * N, -1) + columns.T @ columns) @ P


def rows_of_cluster(layout, cluster):
    own = layout.blocks[layout.cluster == cluster]
    return (3 * own[:, None] + np.arange(3)).ravel()


@pytest.mark.parametrize("tied", [(), (4, 9)], ids=["free", "tied points"])
def test_entries_are_those_of_the_dense_matrix(tied):
    matrix, layout, pattern, dyads = assembled(tied=tied)
    K = dense_blocks(layout, pattern, dyads)
    assert layout.n_clusters == (1 if tied else 3)
    for c in range(layout.n_clusters):
        own = rows_of_cluster(layout, c)
        np.testing.assert_allclose(dense_cluster(matrix, c), K[np.ix_(own, own)], atol=1e-12)


@pytest.mark.parametrize("exact", [False, True], ids=["H0", "exact"])
def test_solutions_are_those_of_the_dense_matrix(exact):
    held, sliders = (1, 2, 30), (7, 33, 51)
    matrix, layout, pattern, dyads = assembled(held=held, sliders=sliders)
    K, b = dense_blocks(layout, pattern, dyads), np.random.default_rng(1).normal(size=(N, 3))
    b, y = b[: len(layout.blocks)], np.zeros((len(layout.blocks), 3))
    layout.project(b)
    matrix.close(exact)
    wanted = np.arange(layout.n_clusters) != 1
    assert np.array_equal(matrix.solve(wanted, b, y), wanted)
    for c in range(layout.n_clusters):
        own, at = rows_of_cluster(layout, c), layout.cluster == c
        sliders_of = {
            int(np.flatnonzero(layout.blocks[at] == slider)[0]): P
            for slider, P in zip(layout.whole.sliders, layout.whole.projectors, strict=True)
            if slider in layout.blocks[at]
        }
        part, own_held = EXACT_SHIFT if exact else SHIFT, layout.whole.held[layout.blocks[at]]
        expected = closed(K[np.ix_(own, own)], part, own_held, sliders_of)
        solution = np.linalg.solve(expected, b[at].ravel()) if wanted[c] else 0.0 * b[at].ravel()
        np.testing.assert_allclose(y[at].ravel(), solution, rtol=1e-7, atol=1e-9)


def test_definite_is_what_has_positive_eigenvalues_only():
    """Also where only its dyads make a stiffness definite."""
    found = set()
    for shift in np.linspace(-8.0, 0.0, 60):
        matrix, layout, pattern, dyads = assembled(shift)
        K = dense_blocks(layout, pattern, dyads)
        dyads.values[:] = 0.0
        bare = dense_blocks(layout, pattern, dyads)
        matrix.close(exact=True)
        b = np.zeros((len(layout.blocks), 3))
        definite = matrix.solve(np.ones(layout.n_clusters, dtype=bool), b, b.copy())
        for c in range(layout.n_clusters):
            own = rows_of_cluster(layout, c)
            k, held = np.ix_(own, own), np.zeros((len(own) // 3, 3), dtype=bool)
            if np.diag(K[k]).reshape(-1, 3).sum(axis=1).max() <= 0.0:
                continue
            expected = np.linalg.eigvalsh(closed(K[k], EXACT_SHIFT, held, {})).min() > 0.0
            assert definite[c] == expected
            found.add((bool(expected), bool(np.linalg.eigvalsh(bare[k]).min() > 0.0)))
    assert found == {(True, True), (True, False), (False, False)}
