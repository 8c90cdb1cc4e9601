"""The places of a surface nearest to points in space, of many points at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.meshes.triangles import balls, closest, double_areas, longest_sides, mix, norm
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers

PAIRS = 1_000_000
"""How many distances between points and cells are held at a time."""


@dataclass(frozen=True)
class Foot:
    """The place of a surface nearest to a point in space, in a cell of a certain size."""

    position: Array
    distance: float
    normal: Array
    size: float


def feet_of(
    points: Array, cells: Integers, targets: Array, comm: MPI.Intracomm | None = None
) -> list[Foot]:
    """The places of a surface nearest to targets (k, 3), the same on all ranks of `comm`."""
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
    # interpolated from the vertices: the facets' own normals are off by the angle between them;
    # vertices are known by their place, as ranks share no other name for them here
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
    """Return distances (k,), places (k, 3), weights (k, 3) and corners (k, 3, 3) of feet."""
    k = len(targets)
    held = np.full(k, np.inf)
    position, share, corners = np.zeros((k, 3)), np.zeros((k, 3)), np.zeros((k, 3, 3))
    if len(triangles):
        target, cell = nearest_pairs(centre, radius, targets)
        weights, places, gaps = closest(triangles[cell], targets[target])
        order = np.lexsort((gaps, target))  # the first of cells that are equally near
        best = order[np.unique(target[order], return_index=True)[1]]
        held, position, share = gaps[best], places[best], weights[best]
        corners = triangles[cell[best]]
    return held, position, share, corners


def nearest_pairs(centre: Array, radius: Array, targets: Array) -> tuple[Integers, Integers]:
    """Pairs of targets (k, 3) and cells that may be the nearest ones, as `pairs_within`."""
    rows, columns = [], []
    widest = radius.max()
    for first, square, rounding in _squares(centre, targets):
        # to the nearest centre, which is a place of the surface as well
        reach = np.sqrt(np.maximum(square.min(axis=1), 0.0) + rounding) * (1.0 + 1e-9)
        row, column = marked(square <= ((reach + widest) ** 2 + rounding)[:, None])
        apart = norm(centre[column] - targets[row + first])
        near = apart - radius[column] <= reach[row]
        rows.append(row[near] + first)
        columns.append(column[near])
    return np.concatenate(rows), np.concatenate(columns)


def pairs_within(centre: Array, targets: Array, reach: Array) -> tuple[Integers, Integers]:
    """Rows (p,) of all pairs of targets (k, 3) and centres (m, 3) nearer than `reach` (k,), or
    nearly so, ascending by targets and then by centres."""
    rows, columns = [], []
    for first, square, rounding in _squares(centre, targets):
        row, column = marked(
            square <= (reach[first : first + len(square)] ** 2 + rounding)[:, None]
        )
        rows.append(row + first)
        columns.append(column)
    return np.concatenate(rows), np.concatenate(columns)


def marked(marks: Booleans) -> tuple[Integers, Integers]:
    """Return the rows and columns of what is marked, ascending: `np.nonzero`, but faster."""
    row, column = np.divmod(np.flatnonzero(marks), max(marks.shape[1], 1))
    return row, column


def nearest_within(centre: Array, targets: Array) -> Array:
    """Return how far the nearest centre is from each target, (k,), or slightly more."""
    return np.concatenate(
        [
            np.sqrt(np.maximum(square.min(axis=1, initial=np.inf), 0.0) + rounding) * (1.0 + 1e-9)
            for _, square, rounding in _squares(centre, targets)
        ]
    )


def _squares(centre: Array, targets: Array) -> Iterator[tuple[int, Array, float]]:
    """Squared distances in blocks: the first target, (some, m) squares, and their error."""
    middle = targets.mean(axis=0)
    c, t = centre - middle, targets - middle
    own, other = (c * c).sum(axis=1), (t * t).sum(axis=1)
    rounding = 1e-14 * float(max(own.max(initial=0.0), other.max(initial=0.0)))
    step = max(1, PAIRS // max(len(c), 1))
    for k in range(0, len(t), step):
        yield k, other[k : k + step, None] - 2.0 * (t[k : k + step] @ c.T) + own, rounding
