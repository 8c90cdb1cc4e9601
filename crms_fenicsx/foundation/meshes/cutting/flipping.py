"""Edges off the kept ones flipped until opposite angles are at most 180 degrees together."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.cut_mesh import CutMesh, around
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.triangles import cross, dot, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers


def flip(mesh: CutMesh, near: Booleans) -> None:
    """Flip edges of the cells of which all vertices are near (n,), by Lawson's criterion."""
    kept, active = mesh.features.keys(), near
    for _ in range(50):  # on curved surfaces they may not end
        rows = np.flatnonzero(around(mesh.cells, active))
        cells = mesh.cells[rows]
        own = np.where(near[cells].all(axis=1), mesh.features.label[mesh.parents[rows]], -1)
        flipped = _round(mesh.points, cells, own, kept, active)
        if not len(flipped):
            break
        mesh.cells[rows] = cells
        active = np.zeros_like(near)
        active[cells[flipped]] = True


def _round(x: Array, cells: Integers, own: Integers, kept: Integers, active: Booleans) -> Integers:
    """Flip edges between cells of one label that is not negative, without a common cell, in place;
    the cells that change. The cells around active vertices (n,) are all there, and one of a new
    edge's is active."""
    table = EdgeTable.of(cells)
    inner = (table.counts == 2) & ~np.isin(table.keys, kept)
    one, two = table.linked_sides(inner)
    flat, n = cells.ravel(), len(cells)

    def corner(side: Integers, k: int) -> Integers:
        return np.asarray(flat[3 * (side // 3) + (side + k) % 3])

    free = (own[one // 3] >= 0) & (own[one // 3] == own[two // 3])
    free &= active[corner(one, 2)] | active[corner(two, 2)]
    one, two = one[free], two[free]
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
    return np.concatenate([one[wins], two[wins]]) // 3


def _angle(at: Array, p: Array, q: Array) -> Array:
    """Angles at vertices towards two others."""
    u, v = p - at, q - at
    return np.asarray(np.arctan2(norm(cross(u, v)), dot(u, v)))
