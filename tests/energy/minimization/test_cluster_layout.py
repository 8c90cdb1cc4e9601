"""Clusters of blocks that elements join."""

import numpy as np
import pytest
from cluster_twins import connected

from crms_fenicsx.energy.minimization.cluster_matrix import ClusterLayout
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
