"""Seams: meshes whose edges have three cells, their distribution, cables over them, pressure."""

import numpy as np
import pytest
from walled_roof import edge_counts, group_edges, ids, roof_mesh, walled_roof

KINDS = [
    {"n": 4},
    {"n": 5, "walls": (0.4, 0.6), "rise": 30.0},
    {"n": 6, "walls": (0.5,), "levels": 1},
    {"n": 8, "walls": (0.25, 0.5, 0.75), "levels": 3},
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_distribution_tears_nothing(comm, kind, seed):
    rng = np.random.default_rng(seed)
    points, cells, _ = walled_roof(**kind, seed=seed)
    for ranks in (None, rng.integers(0, comm.size, len(cells))):
        membrane = roof_mesh(comm, ranks, **kind, seed=seed)
        topology = membrane.mesh.topology
        counts = edge_counts(cells)
        sizes = [topology.index_map(dim).size_global for dim in range(3)]
        assert sizes == [len(points), len(counts), len(cells)]
        own = edge_counts(ids(membrane))
        parts = comm.allgather(own)
        assert sum(parts, start=edge_counts(np.empty((0, 3), dtype=int))) == counts
        for edge, count in counts.items():
            if count > 2:  # all its cells on one rank
                assert [part[edge] for part in parts if edge in part] == [count]
        boundary = {edge for edge, count in counts.items() if count == 1}
        assert group_edges(membrane, "boundary") == boundary
