"""Sums of blocks in the stiffness of all unknowns, against one addition after the other."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from term_scene import cable_square

from crms_fenicsx.foundation.dofs.block_patterns import (
    BlockPattern,
    SegmentPattern,
    StiffnessMatrix,
    distinct_pairs,
)


def one_by_one(unknowns, rows, cols, values):
    """Tied points hand their blocks to their vertices; sliders those in which they move."""
    interpolation = {b: [(b, 1.0)] for b in range(unknowns.n_local)}
    for tied_point, own, weights in zip(
        unknowns.tied_points, unknowns.interpolation, unknowns.weights, strict=True
    ):
        interpolation[int(tied_point)] = list(zip(own.tolist(), weights.tolist(), strict=True))
    along = dict.fromkeys(range(unknowns.n_local), np.eye(3))
    for slider, P in zip(unknowns.sliders, unknowns.projectors, strict=True):
        along[int(slider)] = P
    K = np.zeros((unknowns.n_local, 3, unknowns.n_local, 3))
    for row, col, value in zip(rows, cols, values, strict=True):
        for a, v in interpolation[int(row)]:
            for b, w in interpolation[int(col)]:
                K[a, :, b, :] += along[a] @ (v * w * value) @ along[b]
    return K.reshape(3 * unknowns.n_local, -1)


@pytest.mark.parametrize("sliders", [0, 4])
def test_blocks_of_equal_place_are_summed(sliders) -> None:
    unknowns = cable_square(MPI.COMM_SELF).unknowns
    assert unknowns.n_tied_points > 0
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(sliders, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    projectors = directions[:, :, None] * directions[:, None, :]
    projectors[::2] = np.eye(3) - projectors[::2]  # in planes, the others along lines
    unknowns.set_sliders(rng.permutation(unknowns.n_vertices)[:sliders], projectors)
    rows, cols = rng.integers(unknowns.n_owned, size=(2, 400)).astype(np.int32)
    rows[200:], cols[200:] = rows[:200], cols[:200]
    both = np.append(rows, cols), np.append(cols, rows)
    patterns = [BlockPattern(*both), BlockPattern(*both[::-1])]
    matrix = StiffnessMatrix(unknowns, patterns)
    for _ in range(2):
        matrix.clear()
        expected = np.zeros((3 * unknowns.n_local,) * 2)
        for pattern in patterns:
            values = rng.normal(size=(400, 3, 3))
            pattern.values[:400], pattern.values[400:] = values, np.moveaxis(values, 1, 2)
            pattern.add(matrix)
            expected += one_by_one(unknowns, pattern.rows, pattern.cols, pattern.values)
        matrix.assemble()
        np.testing.assert_allclose(matrix.petsc[:, :], expected, atol=1e-13)
    matrix.destroy()


def test_a_segment_pulls_its_ends_together() -> None:
    unknowns = cable_square(MPI.COMM_SELF).unknowns
    pattern = SegmentPattern(np.array([[2, 5]], dtype=np.int32))
    pattern.values[0] = value = np.diag([1.0, 2.0, 3.0])
    matrix = StiffnessMatrix(unknowns, [pattern])
    pattern.add(matrix)
    matrix.assemble()
    expected = one_by_one(unknowns, [2, 5, 2, 5], [2, 5, 5, 2], [value, value, -value, -value])
    np.testing.assert_array_equal(matrix.petsc[:, :], expected)
    matrix.destroy()


@pytest.mark.parametrize(("n", "size"), [(0, 4), (1, 1), (50, 200), (3000, 20)])
def test_different_pairs_are_sorted_and_found_again(n: int, size: int) -> None:
    given = np.random.default_rng(n).integers(size, size=(2, n)).astype(np.int32)
    first, rows, cols, place = distinct_pairs(*given, size)
    assert list(zip(rows, cols, strict=True)) == sorted(set(zip(*given, strict=True)))
    assert np.array_equal(np.stack([rows, cols])[:, place], given)
    assert np.array_equal(first, np.searchsorted(rows, np.arange(size + 1)))


def test_blocks_of_tied_points_go_where_the_layout_says() -> None:
    unknowns = cable_square(MPI.COMM_SELF).unknowns
    pattern = BlockPattern(*np.random.default_rng(4).integers(unknowns.n_owned, size=(2, 900)))
    matrix = StiffnessMatrix(unknowns, [pattern])
    places, *of_blocks = unknowns.spread(pattern.rows, pattern.cols)
    upper = places[0] <= places[1]
    for found, expected in zip(matrix._spread(pattern), (*places, *of_blocks), strict=True):
        np.testing.assert_array_equal(found, expected[upper])
    matrix.destroy()
