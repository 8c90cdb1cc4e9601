"""Pairs of numbers in order, against a sort."""

from __future__ import annotations

import numpy as np
import pytest

from crms_fenicsx.dofs.block_patterns import unique_pairs


@pytest.mark.parametrize(("n", "size"), [(0, 4), (1, 1), (50, 200), (3000, 20)])
def test_pairs_are_sorted_and_found_again(n: int, size: int) -> None:
    given = np.random.default_rng(n).integers(size, size=(2, n)).astype(np.int32)
    rows, cols, place = unique_pairs(*given, size)
    assert list(zip(rows, cols, strict=True)) == sorted(set(zip(*given, strict=True)))
    assert np.array_equal(np.stack([rows, cols])[:, place], given)
