"""Edges off the kept ones flipped until opposite angles are at most 180 degrees together."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.cut_mesh import CutMesh
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.triangles import cross, dot, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers


def flip(mesh: CutMesh, near: Booleans) -> None:
    """Flip edges of the cells of which all vertices are near (n,), by Lawson's criterion."""
    inside = np.asarray(near[mesh.cells].all(axis=1))
    rows = np.flatnonzero(near[mesh.cells].any(axis=1))
    cells, own = mesh.cells[rows], inside[rows]
    label, kept = mesh.label[mesh.parents[rows]], mesh.strands.keys()
    for _ in range(50):  # on curved surfaces they may not end
        if not _round(mesh.points, cells, own, label, kept):
            break
    mesh.cells[rows] = cells


def _round(x: Array, cells: Integers, own: Booleans, label: Integers, kept: Integers) -> int:
    """Flip edges without a common cell in place; their number."""
    table = EdgeTable.of(cells)
    inner = (table.counts == 2) & ~np.isin(table.keys, kept)
    one, two = table.linked_sides(inner)
    free = own[one // 3] & own[two // 3] & (label[one // 3] == label[two // 3])
    one, two = one[free], two[free]
    flat, n = cells.ravel(), len(cells)

    def corner(side: Integers, k: int) -> Integers:
        return np.asarray(flat[3 * (side // 3) + (side + k) % 3])

    p, q, a, b = corner(one, 0), corner(one, 1), corner(one, 2), corner(two, 2)
    u, v = _angle(x[a], x[p], x[q]), _angle(x[b], x[p], x[q])
    excess = u + v - np.pi
    bad = np.flatnonzero(excess > 1e-6)
    p, q, a, b, one, two = p[bad], q[bad], a[bad], b[bad], one[bad], two[bad]
    old = cross(x[q] - x[p], x[a] - x[p])
    first, second = cross(x[p] - x[a], x[b] - x[a]), cross(x[q] - x[b], x[a] - x[b])
    fits = (dot(first, second) > 0.5 * norm(first) * norm(second)) & (dot(first, old) > 0.0)
    new = edge_keys(np.stack([a, b], axis=1))
    fits &= ~np.isin(new, table.keys)
    order = np.lexsort((table.keys[np.flatnonzero(inner)[free][bad]], -excess[bad].round(6)))
    order = order[fits[order]]
    first_at = np.full(n, len(order))
    for side in (one, two):
        np.minimum.at(first_at, side[order] // 3, np.arange(len(order)))
    rank = np.arange(len(order))
    wins = order[(first_at[one[order] // 3] == rank) & (first_at[two[order] // 3] == rank)]
    wins = wins[np.unique(new[wins], return_index=True)[1]]
    cells[one[wins] // 3] = np.stack([a, p, b], axis=1)[wins]
    cells[two[wins] // 3] = np.stack([b, q, a], axis=1)[wins]
    return len(wins)


def _angle(at: Array, p: Array, q: Array) -> Array:
    """Angles at vertices towards two others."""
    u, v = p - at, q - at
    return np.asarray(np.arctan2(norm(cross(u, v)), dot(u, v)))
