"""Edges off the kept ones flipped until opposite angles are at most 180 degrees together, and
halved opposite wide corners that one cell fills at rows."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.cut_mesh import LEAST, CutMesh, around
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.triangles import cross, dot, norm, shapes
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


def halve_corners(mesh: CutMesh) -> None:
    """Put a vertex into the side opposite each wide corner that one cell fills at a row.

    Such a cell has no vertex of its own. The tensions of cables that lift off above crossings
    would depend on how many of the four corners there have one.
    """
    near = np.flatnonzero(around(mesh.cells, mesh.band(0)))
    one, two = _sides_to_halve(mesh, mesh.cells[near])
    p, q, a, b = _quadrilaterals(mesh.cells[near], one, two)
    one, two = near[one // 3], near[two // 3]
    m = len(mesh.points) + np.arange(len(p))
    middles = 0.5 * (mesh.points[p] + mesh.points[q])
    given = np.sort(mesh.surface.cells[mesh.parents[one]], axis=1)
    gaps = norm(mesh.surface.points[given] - middles[:, None]) / mesh.size[p, None]
    nearest = np.argmin(gaps.round(6), axis=1)
    mesh.home = np.concatenate([mesh.home, given[np.arange(len(m)), nearest]])
    mesh.points = np.concatenate([mesh.points, middles])
    mesh.size = np.concatenate([mesh.size, 0.5 * (mesh.size[p] + mesh.size[q])])
    mesh.cells[one], mesh.cells[two] = np.stack([a, p, m], axis=1), np.stack([b, q, m], axis=1)
    others = np.stack([a, m, q], axis=1), np.stack([b, m, p], axis=1)
    mesh.cells = np.concatenate([mesh.cells, *others])
    mesh.parents = np.concatenate([mesh.parents, mesh.parents[one], mesh.parents[two]])


def _sides_to_halve(mesh: CutMesh, cells: Integers) -> tuple[Integers, Integers]:
    """Sides of two cells each, opposite wide corners; one of a cell, whose halves are not slim."""
    sides, table = edge_keys(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), EdgeTable.of(cells)
    kept = np.isin(sides, mesh.features.keys()).reshape(-1, 3)
    wide = sides[_opposite_wide(mesh, cells, kept).ravel()]
    one, two = table.linked_sides((table.counts == 2) & np.isin(table.keys, wide))
    p, q, a, b = (mesh.points[v] for v in _quadrilaterals(cells, one, two))
    m = 0.5 * (p + q)
    halves = [np.stack(x, axis=1) for x in ((a, p, m), (a, m, q), (b, q, m), (b, m, p))]
    sines = np.min([shapes(half)[1] for half in halves], axis=0)
    fits = np.flatnonzero(sines > np.sin(np.radians(LEAST[1])))
    first = np.full(len(cells), len(one))
    for side in (one, two):
        np.minimum.at(first, side[fits] // 3, fits)
    fits = fits[(first[one[fits] // 3] == fits) & (first[two[fits] // 3] == fits)]
    return one[fits], two[fits]


def _opposite_wide(mesh: CutMesh, cells: Integers, kept: Booleans) -> Booleans:
    """Whether each side (m, 3) is opposite a corner of over 75 degrees, between 60 of one cell and
    two of 45, at a row between `kept` sides (m, 3)."""
    on_row = np.zeros(len(mesh.points), dtype=bool)
    for row in mesh.rows.values():
        on_row[row.vertices] = True
    found = np.zeros_like(kept)
    for k in range(3):
        corner, start, end = cells[:, k - 1], cells[:, k], cells[:, k - 2]
        found[:, k] = ~kept[:, k] & kept[:, k - 1] & kept[:, k - 2] & on_row[corner]
        u, v = (mesh.points[w] - mesh.points[corner] for w in (start, end))
        found[:, k] &= dot(u, v) < np.cos(np.radians(75.0)) * norm(u) * norm(v)
    return found


def _quadrilaterals(cells: Integers, one: Integers, two: Integers) -> Integers:
    """Ends of sides (k,) of two cells, and the vertices opposite in these, (4, k)."""
    flat = cells.ravel()
    ends = [flat[3 * (one // 3) + (one + j) % 3] for j in range(3)]
    return np.stack([*ends, flat[3 * (two // 3) + (two + 2) % 3]])
