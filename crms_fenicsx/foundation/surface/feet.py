"""Closest points of a surface to points in space, for many points at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.meshes.triangles import (
    balls,
    closest,
    double_areas,
    longest_sides,
    mix,
    norm,
)
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers

PAIRS = 1_000_000
"""Number of point-cell distances held in memory at a time."""


@dataclass(frozen=True)
class Foot:
    """Closest point of a surface to a point in space, and the size of its cell."""

    position: Array
    distance: float
    normal: Array
    size: float


def feet_of(
    points: Array, cells: Integers, targets: Array, comm: MPI.Intracomm | None = None
) -> list[Foot]:
    """Closest points of a surface to targets (k, 3), the same on all ranks of `comm`."""
    triangles = points[cells]
    centre, radius = balls(triangles)
    held, position, share, corners = _nearest(triangles, centre, radius, targets)
    if comm is not None:
        every = np.array(comm.allgather(held))
        mine = every.argmin(axis=0) == comm.rank
        held = every.min(axis=0)
        given = np.concatenate([position, share, corners.reshape(-1, 9)], axis=1)
        found = np.zeros_like(given)
        comm.Allreduce(np.where(mine[:, None], given, 0.0), found)
        position, share, corners = found[:, :3], found[:, 3:6], found[:, 6:].reshape(-1, 3, 3)
    size = longest_sides(corners)
    # normals are interpolated from the vertices, as facet normals differ by the angle between
    # facets; vertices are identified by position, as ranks share no other key here
    normals = np.zeros((len(targets), 3, 3))
    target, cell = pairs_within(centre, position, (size + radius.max(initial=0.0)) * (1.0 + 1e-9))
    area, around = double_areas(triangles[cell]), triangles[cell]
    for i in range(3):
        apart = norm(around - corners[target, i][:, None])
        fan = (apart <= 1e-9 * size[target, None]).any(axis=1)
        np.add.at(normals[:, i], target[fan], area[fan])
    if comm is not None:
        normals = comm.allreduce(normals, op=MPI.SUM)
    lengths = norm(normals)
    normals = normals / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    normal = mix(share, normals)
    normal /= np.maximum(norm(normal), 1e-300)[:, None]
    return [
        Foot(position[k], float(held[k]), normal[k], float(size[k])) for k in range(len(targets))
    ]


def _nearest(
    triangles: Array, centre: Array, radius: Array, targets: Array
) -> tuple[Array, Array, Array, Array]:
    """Distances (k,), closest points (k, 3), weights (k, 3) and cell corners (k, 3, 3)."""
    k = len(targets)
    held = np.full(k, np.inf)
    position, share, corners = np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3, 3))
    if len(triangles):
        target, cell = nearest_pairs(centre, radius, targets)
        weights, places, gaps = closest(triangles[cell], targets[target])
        order = np.lexsort((gaps, target))  # of equally close cells the first
        best = order[np.unique(target[order], return_index=True)[1]]
        held, position, share = gaps[best], places[best], weights[best]
        corners = triangles[cell[best]]
    return held, position, share, corners


def nearest_pairs(centre: Array, radius: Array, targets: Array) -> tuple[Integers, Integers]:
    """Pairs of targets (k, 3) and cells that may be the closest, in the form of `pairs_within`."""
    rows, columns = [], []
    widest = radius.max()
    for first, square, rounding in _squares(centre, targets):
        # to the nearest centre, which is a point of the surface as well
        reach = np.sqrt(np.maximum(square.min(axis=1), 0.0) + rounding) * (1.0 + 1e-9)
        row, column = marked(square <= ((reach + widest) ** 2 + rounding)[:, None])
        apart = norm(centre[column] - targets[row + first])
        near = apart - radius[column] <= reach[row]
        rows.append(row[near] + first)
        columns.append(column[near])
    return np.concatenate(rows), np.concatenate(columns)


def pairs_within(centre: Array, targets: Array, reach: Array) -> tuple[Integers, Integers]:
    """Indices (p,) of all pairs of targets (k, 3) and centres (m, 3) within `reach` (k,), up to
    rounding, sorted by targets and then centres."""
    rows, columns = [], []
    for first, square, rounding in _squares(centre, targets):
        row, column = marked(
            square <= (reach[first : first + len(square)] ** 2 + rounding)[:, None]
        )
        rows.append(row + first)
        columns.append(column)
    return np.concatenate(rows), np.concatenate(columns)


def marked(marks: Booleans) -> tuple[Integers, Integers]:
    """Rows and columns of the marked entries, ascending: a faster `np.nonzero`."""
    row, column = np.divmod(np.flatnonzero(marks), max(marks.shape[1], 1))
    return row, column


def nearest_within(centre: Array, targets: Array) -> Array:
    """Upper bound of the distance from each target to the nearest centre, (k,)."""
    return np.concatenate(
        [
            np.sqrt(np.maximum(square.min(axis=1, initial=np.inf), 0.0) + rounding) * (1.0 + 1e-9)
            for _, square, rounding in _squares(centre, targets)
        ]
    )


def _squares(centre: Array, targets: Array) -> Iterator[tuple[int, Array, float]]:
    """Squared distances in blocks: first target, squares (some, m), and their rounding error."""
    middle = targets.mean(axis=0)
    c, t = centre - middle, targets - middle
    own, other = (c * c).sum(axis=1), (t * t).sum(axis=1)
    rounding = 1e-14 * float(max(own.max(initial=0.0), other.max(initial=0.0)))
    step = max(1, PAIRS // max(len(c), 1))
    for k in range(0, len(t), step):
        yield k, other[k : k + step, None] - 2.0 * (t[k : k + step] @ c.T) + own, rounding
