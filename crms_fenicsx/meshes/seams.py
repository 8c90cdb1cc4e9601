"""Seams: edges at which three or more cells meet, and what lies behind them.

Around a seam the cells bound sectors of space. Cables lie on the outer side of the membrane, so
they pass a seam in the sectors that are outside of both cells which bound them: over the roof, not
down on the wall that hangs below it.
"""

from __future__ import annotations

import numpy as np

from crms_fenicsx.meshes.edge_table import EdgeTable
from crms_fenicsx.runtime.arrays import Array, Integers


def hidden_cells(points: Array, cells: Integers, piece: Integers) -> Integers:
    """Find the cells of pieces that no cable can reach over a seam.

    Shapes: points (n, 3), cells (m, 3), piece (m,). Returns indices of the cells, sorted, shape
    (k,): those of each piece that at some seam bounds no sector which is outside of both cells
    around it.
    """
    table = EdgeTable.of(cells)
    on_seam = np.repeat(table.counts > 2, table.counts)
    sides = table.order[on_seam]
    if not len(sides):
        return np.zeros(0, dtype=np.int64)
    edge = np.repeat(np.arange(len(table.counts)), table.counts)[on_seam]
    first = np.searchsorted(edge, edge)  # the first side of each side's edge
    low, high = points[table.vertices[edge]].transpose(1, 0, 2)
    axis = (high - low) / np.linalg.norm(high - low, axis=1)[:, None]
    ray = points[cells[sides // 3, (sides + 2) % 3]] - low
    ray -= np.sum(ray * axis, axis=1)[:, None] * axis
    across = np.cross(axis, ray[first])
    angle = np.arctan2(np.sum(ray * across, axis=1), np.sum(ray * ray[first], axis=1))
    # A cell that runs along the axis has its outer side towards growing angles.
    order = np.lexsort((angle, edge))
    sides, along = sides[order], table.ascending[sides[order]]
    count = table.counts[edge]
    place = np.arange(len(edge)) - first
    after = first + (place + 1) % count
    before = first + (place - 1) % count
    passed = np.where(along, ~along[after], along[before])
    behind = np.unique(piece[sides[~passed] // 3])
    return np.flatnonzero(np.isin(piece, behind))
