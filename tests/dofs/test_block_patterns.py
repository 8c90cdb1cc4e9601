"""Blocks of cable elements in the global stiffness, against one addition after the other."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc
from term_scene import cable_square

from crms_fenicsx.dofs.block_patterns import BlockPattern, SegmentPattern


def empty_matrix(unknowns) -> PETSc.Mat:
    matrix = PETSc.Mat().create(unknowns.comm)
    matrix.setSizes(((3 * unknowns.n_owned, 3 * unknowns.n_global),) * 2)
    matrix.setBlockSize(3)
    matrix.setType(PETSc.Mat.Type.AIJ)
    lgmap = unknowns.lgmap()
    matrix.setLGMap(lgmap, lgmap)
    lgmap.destroy()
    matrix.setUp()
    return matrix


def one_by_one(unknowns, rows, cols, values):
    """Tied points hand their blocks to their vertices; edge sliders those along their lines."""
    interpolation = {b: [(b, 1.0)] for b in range(unknowns.n_local)}
    for tied_point, own, weights in zip(
        unknowns.tied_points, unknowns.interpolation, unknowns.weights, strict=True
    ):
        interpolation[int(tied_point)] = list(zip(own.tolist(), weights.tolist(), strict=True))
    along = dict.fromkeys(range(unknowns.n_local), np.eye(3))
    for edge_slider, d in zip(unknowns.edge_sliders, unknowns.directions, strict=True):
        along[int(edge_slider)] = np.outer(d, d)
    K = np.zeros((unknowns.n_local, 3, unknowns.n_local, 3))
    for row, col, value in zip(rows, cols, values, strict=True):
        for a, v in interpolation[int(row)]:
            for b, w in interpolation[int(col)]:
                K[a, :, b, :] += along[a] @ (v * w * value) @ along[b]
    number = unknowns.matrix_numbers
    result = np.zeros_like(K)
    result[np.ix_(number, range(3), number, range(3))] = K
    return result.reshape(3 * unknowns.n_local, -1)


@pytest.mark.parametrize("edge_sliders", [0, 3])
def test_blocks_of_equal_place_are_summed(edge_sliders) -> None:
    unknowns = cable_square(MPI.COMM_SELF).unknowns
    assert unknowns.n_tied_points > 0
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(edge_sliders, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    unknowns.set_edge_sliders(rng.permutation(unknowns.n_vertices)[:edge_sliders], directions)
    rows, cols = rng.integers(unknowns.n_owned, size=(2, 400)).astype(np.int32)
    rows[200:], cols[200:] = rows[:200], cols[:200]
    pattern = BlockPattern(rows, cols)
    matrix = empty_matrix(unknowns)
    for _ in range(2):  # the places that the first time has found are used again
        pattern.values[:] = rng.normal(size=(400, 3, 3))
        matrix.zeroEntries()
        pattern.add(matrix, unknowns)
        matrix.assemble()
        expected = one_by_one(unknowns, rows, cols, pattern.values)
        np.testing.assert_allclose(matrix[:, :], expected, atol=1e-13)


def test_a_segment_pulls_its_ends_together() -> None:
    unknowns = cable_square(MPI.COMM_SELF).unknowns
    pattern = SegmentPattern(np.array([[2, 5]], dtype=np.int32))
    pattern.own_values[0] = value = np.diag([1.0, 2.0, 3.0])
    matrix = empty_matrix(unknowns)
    pattern.add(matrix, unknowns)
    matrix.assemble()
    expected = one_by_one(unknowns, [2, 5, 2, 5], [2, 5, 5, 2], [value, value, -value, -value])
    np.testing.assert_array_equal(matrix[:, :], expected)
