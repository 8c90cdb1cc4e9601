"""Covers: triangles without material that close the holes of a surface, for routes across them.

A cable spans a hole as it spans a hollow. Its path needs cells below it everywhere, so a hole that
a route crosses is closed by triangles between the vertices of its rim. They have no energy, and no
cable touches them. A concave part of the outer boundary is closed up to its convex hull.
"""

from __future__ import annotations

import heapq
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull

from crms_fenicsx.foundation.meshes.triangles import cross, cross_in_plane, lists, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, ints
from crms_fenicsx.foundation.surface.plane_section import FACING

FLAT = 1e-9
"""Twice a triangle's area, relative to the square of its longest side, that counts as zero."""

SHALLOW = 1e-6
"""Depth of a concave part of the boundary, relative to its width, that counts as straight."""


def covers(
    sides: Integers, opposite: Integers, vertices: Integers, points: Array
) -> list[Integers]:
    """Triangles (m, 3) over each hole of a surface and each concave part of its outer boundary.

    Given are its boundary sides (k, 2), directed as their cells, with the cells' third vertices
    (k,), and the ids (n,), ascending, and positions (n, 3) of all these vertices. The triangles are
    oriented as the cells. Holes that cannot be closed, as they are not simple in their mean plane
    or hold other parts of the membrane, are left out.
    """
    third = {(a, b): c for (a, b), c in zip(lists(sides), ints(opposite), strict=True)}
    found = []
    for loop in _loops(sides):
        x = points[np.searchsorted(vertices, loop)]
        middle = x.mean(axis=0)
        area = 0.5 * cross(x - middle, np.roll(x, -1, axis=0) - middle).sum(axis=0)
        size = float(norm(area))
        if size <= FLAT * float(np.ptp(x, axis=0).max()) ** 2:
            continue
        others = np.setdiff1d(sides, loop)
        # The sides of a hole turn clockwise as seen on the cells' outside.
        ways = zip(ints(loop), ints(np.roll(loop, -1)), strict=True)
        beyond = points[np.searchsorted(vertices, [third[way] for way in ways])]
        normal = area / size
        frame = _frame(normal)
        flat, side = x @ frame.T, np.roll(x, -1, axis=0) - x
        to_left = cross_in_plane((beyond - x) @ frame.T, side @ frame.T) / norm(side)
        reach = norm(cross(beyond - x, side)) / norm(side)
        inward = -float(to_left.sum() / max(reach.sum(), 1e-300))  # 1: the cells lie inside
        if inward <= -FACING:
            chains = [np.arange(len(loop))[::-1]]
            frame = _frame(-normal)
            flat = x @ frame.T
        elif inward >= FACING:
            chains = _pockets(flat)
        else:
            continue
        away = points[np.searchsorted(vertices, others)]
        near = np.abs((away - middle) @ normal) < np.sqrt(size)
        for chain in chains:
            triangles = _triangulated(flat[chain], away[near] @ frame.T)
            if triangles is not None:
                found.append(loop[chain[triangles]])
    return found


def _frame(normal: Array) -> Array:
    """Two unit vectors (2, 3) that make a right-handed frame with a unit normal."""
    axis = np.zeros(3)
    axis[int(np.argmin(np.abs(normal)))] = 1.0
    first = cross(normal, axis)
    first /= float(norm(first))
    return np.stack([first, cross(normal, first)])


def _loops(sides: Integers) -> list[Integers]:
    """Closed chains of directed sides; none through a vertex where several loops meet."""
    starts, counts = np.unique(sides[:, 0], return_counts=True)
    forks = {int(vertex) for vertex in starts[counts > 1]}
    after = {int(a): int(b) for a, b in sides}
    loops = []
    left = set(after)
    while left:
        first = min(left)
        loop, at = [first], after[first]
        left.discard(first)
        while at in left:
            left.discard(at)
            loop.append(at)
            at = after[at]
        if at == first and len(loop) > 2 and forks.isdisjoint(loop):
            loops.append(np.array(loop, dtype=np.int64))
    return loops


def _pockets(flat: Array) -> list[Integers]:
    """Concave parts of a counterclockwise polygon (n, 2), as rows from end to end, reversed."""
    corners = np.sort(ConvexHull(flat).vertices)
    pockets = []
    for a, b in zip(corners, np.roll(corners, -1), strict=True):
        chain = np.arange(a, b + 1 if b > a else b + 1 + len(flat)) % len(flat)
        chord = flat[b] - flat[a]
        depth = cross_in_plane(chord, flat[chain] - flat[a]) / float(chord @ chord)
        straight = np.flatnonzero(depth <= SHALLOW)
        pockets += [chain[i : j + 1][::-1] for i, j in pairwise(straight) if j > i + 1]
    return pockets


def _triangulated(x: Array, others: Array) -> Integers | None:
    """Triangles (m, 3) of a counterclockwise polygon (n, 2), the best ears first; None if it is not
    simple or contains `others` (k, 2)."""
    n = len(x)
    before, after = np.roll(np.arange(n), 1), np.roll(np.arange(n), -1)
    alive = np.ones(n, dtype=bool)

    def quality(i: int) -> float:
        """Twice the area of an ear by the square of its longest side; negative if it is not one."""
        ear = [int(before[i]), i, int(after[i])]
        a = x[ear]
        ways = np.roll(a, -1, axis=0) - a
        shape = float(cross_in_plane(ways[0], ways[1])) / float((ways**2).sum(axis=1).max())
        if shape <= FLAT:
            return -1.0
        rest = alive.copy()
        rest[ear] = False
        targets = np.concatenate([x[rest], others])
        to = cross_in_plane(ways[:, None], targets - a[:, None]) / (ways**2).sum(axis=1)[:, None]
        return -1.0 if (to >= -FLAT).all(axis=0).any() else shape

    triangles: list[tuple[int, int, int]] = []
    best = [quality(i) for i in range(n)]
    queue = [(-best[i], i) for i in range(n) if best[i] > 0.0]
    heapq.heapify(queue)
    while len(triangles) < n - 3:
        while queue and not (alive[queue[0][1]] and -queue[0][0] == best[queue[0][1]]):
            heapq.heappop(queue)
        if not queue:
            best = [quality(i) if alive[i] else -1.0 for i in range(n)]
            queue = [(-best[i], i) for i in range(n) if best[i] > 0.0]
            heapq.heapify(queue)
            if not queue:
                return None
        _, i = heapq.heappop(queue)
        a, b = int(before[i]), int(after[i])
        triangles.append((a, i, b))
        alive[i], after[a], before[b] = False, b, a
        for k in (a, b):
            best[k] = quality(k)
            if best[k] > 0.0:
                heapq.heappush(queue, (-best[k], k))
    last = int(np.flatnonzero(alive)[0])
    if quality(last) <= 0.0:
        return None
    triangles.append((int(before[last]), last, int(after[last])))
    return np.array(triangles, dtype=np.int64)
