"""The route that a cable is laid along: what it must be, and which cells are near it."""

from __future__ import annotations

from contextlib import suppress
from itertools import pairwise

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.meshes.triangles import balls, flattened, longest_sides, norm, vectors
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.runtime.errors import PathError, as_text
from crms_fenicsx.surface.closest_point import RIM
from crms_fenicsx.surface.feet import feet_of, nearest_within, pairs_within
from crms_fenicsx.surface.plane_cuts import Plane, strips

# The direct way is shorter than one around the back by more than this: two ways around a tube that
# are about as long are as good as each other.
DETOUR = 0.95


def checked_route(route: ArrayLike, snap: float) -> Array:
    """Return a route as an array, (k, 2) or (k, 3); raise PathError if it is none."""
    if not 0.0 < snap <= 0.1:
        raise PathError(f"snap {snap} of a route: give a part of the mesh size, 0 < snap <= 0.1")
    try:
        course = np.asarray(route, dtype=np.float64)
    except (TypeError, ValueError):
        raise PathError(f"route {route!r}: give points (x, y) or (x, y, z), all alike") from None
    if course.ndim != 2 or course.shape[1] not in (2, 3) or len(course) < 2:
        raise PathError(
            f"a route of shape {course.shape}: give two or more points (x, y) or (x, y, z)"
        )
    for i, point in enumerate(vectors(course)):
        if not np.isfinite(point).all():
            raise PathError(f"route point {i} is {as_text(point)}; give finite coordinates")
        if i and np.array_equal(point, course[i - 1]):
            raise PathError(f"route points {i - 1} and {i} are both {as_text(point)}; drop one")
    return course


def near_section(
    points: ArrayLike,
    cells: ArrayLike,
    route: ArrayLike,
    *,
    snap: float = 1e-3,
    comm: MPI.Intracomm | None = None,
    along_legs: bool = False,
) -> Booleans:
    """Mark the cells that `trace` needs: it finds the same path on them as on the whole mesh.

    Shapes and units: points (n, 3) (length), cells (m, 3). Returns (m,) mask. A strip along every
    leg's plane, across the whole mesh or along the leg, and the cells nearest to each route point.
    From what may be an anchor it is always the whole mesh.
    """
    course = checked_route(route, snap)
    x = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    rows = np.asarray(cells, dtype=np.int64).reshape(-1, 3)
    size = float(np.max(longest_sides(x[rows]), initial=0.0))
    if comm is not None:
        size = comm.allreduce(size, op=MPI.MAX)
    mask = np.zeros(len(rows), dtype=np.bool_)
    if course.shape[1] == 2:
        ends = np.column_stack([course, np.zeros(len(course))])
        up, margin = np.array([0.0, 0.0, 1.0]), 3.0 * size if along_legs else np.inf
        # trace may move ends to the rim, and the plane along
        planes = [Plane.of(a, b, up, up) for a, b in pairwise(vectors(ends))]
        mask[strips(planes, x, rows, (RIM + snap) * size, margin)[1]] = True
        flat = flattened(x[rows])
        centre, radius = balls(flat)
        least = nearest_within(centre, ends)
        if comm is not None:
            comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
        # what trace names when the route leaves the membrane
        mask[_in_reach(centre, radius, ends, least)] = True
        return mask
    feet = feet_of(x, rows, course, comm)
    centre, radius = balls(x[rows])
    # all around the vertices of the nearest cell, which make the normal
    places = np.array([foot.position for foot in feet])
    sizes = np.array([foot.size for foot in feet])
    mask[_in_reach(centre, radius, places, sizes * (1.0 + 1e-9) + snap * size)] = True
    planes, straight = [], []
    for i in range(len(course) - 1):
        # whether an end is an anchor depends on the boundary, which one rank may not see
        starts = [places[i]] + ([course[i]] if i == 0 else [])
        stops = [places[i + 1]] + ([course[i + 1]] if i == len(course) - 2 else [])
        if along_legs and all(np.array_equal(own[0], own[-1]) for own in (starts, stops)):
            straight.append(i)
            continue
        for a in starts:
            for b in stops:
                if norm(b - a) == 0.0:
                    continue
                with suppress(PathError):  # if this is the leg, trace says so
                    planes.append(Plane.of(a, b, feet[i].normal, feet[i + 1].normal))
    mask[strips(planes, x, rows, snap * size, np.inf)[1]] = True
    if straight:  # no point of a way is farther from the leg's middle than half the way's length
        a, b = places[straight], places[np.array(straight) + 1]
        reach = 0.5 * norm(b - a) / DETOUR + 2.0 * size
        mask[_in_reach(centre, radius, 0.5 * (a + b), reach)] = True
    return mask


def _in_reach(centre: Array, radius: Array, targets: Array, reach: Array) -> Integers:
    """Return the cells, given by balls around them, that may come within reach of some target."""
    target, cell = pairs_within(centre, targets, reach + radius.max(initial=0.0))
    near = norm(centre[cell] - targets[target]) - radius[cell] <= reach[target]
    return cell[near]
