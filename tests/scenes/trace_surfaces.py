"""Surfaces to trace routes over, and what paths over them have in common."""

from __future__ import annotations

import numpy as np
import pytest
from grids import grid
from mpi4py import MPI
from scipy.spatial import Delaunay

from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint
from crms_fenicsx.foundation.surface.trace import near_section, trace


def squares(n, m=None):
    """Return points (integers) and cells of n x m squares, all cut by the same diagonal."""
    return grid(np.arange(n + 1.0), np.arange((n if m is None else m) + 1.0))


def scattered(rng, n=40, size=60):
    """Return a Delaunay mesh of random integer points, the square's corners among them."""
    xy = np.unique(
        np.vstack([rng.integers(0, size + 1, (n, 2)), [[0, 0], [0, size], [size, 0], [size] * 2]]),
        axis=0,
    )
    cells = Delaunay(xy).simplices.astype(np.int64)
    a, b, c = (xy[cells[:, i]] for i in range(3))
    ab, ac = b - a, c - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    return np.column_stack([xy, np.zeros(len(xy))]).astype(float), cells[area != 0]


def numbered(rng, points):
    return rng.permutation(5 * len(points))[: len(points)].astype(np.int64)


def same_points(found, expected, tolerance=1e-9):
    assert [p.support for p in found] == [p.support for p in expected]
    for p, q in zip(found, expected, strict=True):
        if isinstance(p, EdgePoint):
            assert abs(p.fraction - q.fraction) < tolerance
        if isinstance(p, CellPoint):
            assert np.allclose(p.weights, q.weights, rtol=0, atol=tolerance)


def length_of(x):
    return float(np.linalg.norm(np.diff(x, axis=0), axis=1).sum())


def cap(angle, rings=9, radius=10.0):
    """Return a cap of a sphere up to a polar angle; its cells are oriented outward."""
    flat = [(0.0, 0.0)]
    for i in range(1, rings + 1):
        phi = 2 * np.pi * (np.arange(6 * i) + 0.3 * i) / (6 * i)
        flat += list(zip(i / rings * np.cos(phi), i / rings * np.sin(phi), strict=True))
    xy = np.array(flat)
    cells = Delaunay(xy).simplices.astype(np.int64)
    corners = xy[cells]
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    twice = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    cells = cells[np.abs(twice) > 1e-9]
    flip = twice[np.abs(twice) > 1e-9] < 0
    cells[flip] = cells[flip][:, ::-1]
    return radius * on_sphere(xy, angle), cells


def hall(half, n=(8, 24), radius=10.0, length=12.0):
    """Return a barrel along x, up to an angle on either side of its top; closed if that is pi."""
    points, cells = squares(*n)
    angle = half * (2.0 * points[:, 1] / n[1] - 1.0)
    across = radius * np.column_stack([np.sin(angle), np.cos(angle)])
    x = np.column_stack([points[:, 0] * length / n[0], across])
    if half < np.pi:
        return x, cells
    row = np.arange(len(x))
    row[points[:, 1] == n[1]] = row[points[:, 1] == 0]
    used, cells = np.unique(row[cells], return_inverse=True)
    return x[used], cells.reshape(-1, 3)


def on_sphere(xy, angle):
    r = np.hypot(*xy.T)
    theta, phi = r * angle, np.arctan2(xy[:, 1], xy[:, 0])
    return np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )


def rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def part(ids, points, cells, mask):
    """Return the marked part of a mesh, with nothing else in its arrays."""
    used = np.unique(cells[mask])
    row = np.zeros(len(points), dtype=np.int64)
    row[used] = np.arange(len(used))
    return ids[used], points[used], row[cells[mask]]


def assert_part_is_enough(ids, points, cells, mask, route):
    """On the marked cells alone a route has the same path as on all, or the same error."""
    try:
        whole = trace(ids, points, cells, route)
    except PathError as error:
        with pytest.raises(PathError) as caught:
            trace(*part(ids, points, cells, mask), route)
        assert str(caught.value) == str(error)
    else:
        assert trace(*part(ids, points, cells, mask), route) == whole


def assert_divided_mesh_is_enough(comm, points, cells, route):
    """The path on all cells, and which of them ranks find that have a part of the mesh each: these
    have the same path."""
    own, ids = np.arange(len(cells)) % comm.size == comm.rank, np.arange(len(points))
    mask = np.zeros(len(cells), dtype=bool)
    mask[own] = near_section(points, cells[own], route, comm=comm)
    comm.Allreduce(MPI.IN_PLACE, mask, op=MPI.LOR)
    whole = trace(ids, points, cells, route)
    assert trace(*part(ids, points, cells, mask), route) == whole
    return whole, mask
