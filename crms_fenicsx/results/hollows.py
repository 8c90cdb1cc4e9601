"""Hollows of the current surface, in which rainwater would stand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, cast

import numpy as np

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.meshes.surface import BOUNDARY
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.results.cable_and_bar_results import Force
from crms_fenicsx.results.view_data import surface_piece, whole_surface

if TYPE_CHECKING:
    from scipy.sparse import coo_array


@dataclass(frozen=True, repr=False)
class Hollow:
    """A part of the surface without drainage.

    Attributes
    ----------
    at
        Lowest point (length).
    depth
        Water depth there when the hollow is full (length).
    level
        Overflow level z (length).
    volume, area
        Water volume when full (length cubed), and area of the water surface (length squared).
    """

    at: Force
    depth: float
    level: float
    volume: float
    area: float

    def __repr__(self) -> str:
        place = ", ".join(f"{x:.4g}" for x in self.at)
        return f"{self.depth:.3g} deep at ({place}), volume {self.volume:.3g}"


@dataclass(frozen=True)
class Hollows:
    """Hollows of a surface, the deepest first, and the hollow of each point."""

    hollows: tuple[Hollow, ...]
    of_points: Integers  # hollow of each of this rank's points, -1 for none
    plan: float  # plan area of the surface (length squared)
    # least mean slope (degrees) of the ways of water from vertices off the membrane, and where;
    # None if not asked for, or without such a way
    least: tuple[float, Force] | None = None


def find_hollows(net: CableNet, drainage: bool = False) -> Hollows:
    """Find the hollows of the current surface where it faces up; water drains over its edges and
    where it overhangs. With the least slope of its drainage if that is asked for. Collective."""
    membrane, comm = net.membrane, net.membrane.comm
    # shallower ones do not count
    shallow = 1e-5 * membrane.size  # collective
    piece = surface_piece(membrane, current_surface(net), {})
    rim = np.zeros(len(np.asarray(piece.points)))
    rim[membrane.vertices(BOUNDARY)] = 1.0
    piece = replace(piece, point_data={"rim": rim})
    whole, found = whole_surface(comm, piece), None
    if whole is not None:
        points, triangles = np.asarray(whole.points), np.asarray(whole.triangles)
        on_rim = np.asarray(whole.point_data["rim"]) > 0.0
        found = _hollows_of(points, triangles, on_rim, shallow, drainage)
    found = cast(Hollows, comm.bcast(found))
    homes = np.asarray(piece.homes)
    counts = comm.allgather(int(np.count_nonzero(homes[:, 0] == comm.rank)))
    starts = np.cumsum([0, *counts[:-1]])
    return replace(found, of_points=found.of_points[starts[homes[:, 0]] + homes[:, 1]])


def _hollows_of(
    points: Array, triangles: Integers, rim: Booleans, shallow: float, drainage: bool = False
) -> Hollows:
    """Hollows of points (n, 3) and triangles (m, 3); `rim`: which points lie on the surface's edge.
    Units: shallow (length)."""
    from scipy.sparse import csgraph

    vectors = double_areas(points[triangles]) / 2
    # triangles of a smaller plan hold no water
    steep = 1e-6 * norm(vectors)
    side = 1 if np.any(vectors[:, 2] > steep) else -1
    up = np.asarray(triangles[side * vectors[:, 2] > steep], dtype=np.int64)
    plan = float(np.abs(vectors[side * vectors[:, 2] > steep, 2]).sum())
    z, of_points = points[:, 2], np.full(len(points), -1)
    if not len(up):
        return Hollows((), of_points, plan)
    table, whole = EdgeTable.of(up), EdgeTable.of(triangles)
    pairs = table.vertices
    # where cables fold one of two cells, their common edge belongs to a single triangle, too
    overhang = np.isin(table.keys, whole.keys[whole.counts > 1]) & (table.counts == 1)
    leads_out = rim.copy()
    leads_out[pairs[overhang]] = True
    leads_out &= np.bincount(up.ravel(), minlength=len(z)) > 0
    fill = _filled(z, pairs, np.flatnonzero(leads_out))
    wet: Booleans = fill > z + shallow * 1e-3
    joined = pairs[wet[pairs].all(axis=1)]
    label = csgraph.connected_components(_graph(len(z), joined), directed=False)[1]
    found = []
    for one in np.unique(label[wet]):
        inside = np.flatnonzero(wet & (label == one))
        lowest = int(inside[np.lexsort((*points[inside].T[:2], z[inside]))[0]])
        level = float(fill[lowest])
        if level - z[lowest] <= shallow:
            continue
        own = up[np.isin(up, inside).any(axis=1)]
        volume, area = _water(points[own], level)
        x, y, bottom = points[lowest].tolist()
        hollow = Hollow((x, y, bottom), level - bottom, level, volume, area)
        found.append((hollow, inside))
    found.sort(key=lambda one: (-one[0].depth, one[0].at))
    for k, (_, inside) in enumerate(found):
        of_points[inside] = k
    least = None
    if drainage:  # points where cables pass over the rim lie on it, too
        single = whole.vertices[whole.counts == 1]
        beside = np.concatenate([single[leads_out[single[:, k]], 1 - k] for k in (0, 1)])
        leads_out |= np.bincount(beside, minlength=len(z)) > 1
        least = _drainage(points, pairs, leads_out)
    return Hollows(tuple(hollow for hollow, _ in found), of_points, plan, least)


def _drainage(points: Array, pairs: Integers, outlets: Booleans) -> tuple[float, Force] | None:
    """Least mean slope (degrees) of the ways of water from points (n, 3), each along the steepest
    edges down to an outlet, and its place; 0 where it ends in a hollow."""
    z = points[:, 2]
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    run = np.linalg.norm(np.diff(points[ends][:, :, :2], axis=1)[:, 0], axis=1)
    run = np.maximum(run, 1e-300)  # along walls
    down = (z[ends[:, 0]] - z[ends[:, 1]]) / run
    order = np.lexsort((ends[:, 1], -down, ends[:, 0]))
    first = order[np.unique(ends[order, 0], return_index=True)[1]]  # the steepest of each point
    away, low, drains = np.zeros(len(z)), z.copy(), outlets.copy()
    places = first[np.argsort(z[ends[first, 0]], kind="stable")]
    for (point, after), slope, length in zip(
        ends[places].tolist(), down[places].tolist(), run[places].tolist(), strict=True
    ):
        if slope > 0.0 and not outlets[point]:
            away[point], low[point] = away[after] + length, low[after]
            drains[point] = drains[after]
    inner = ends[places, 0][~outlets[ends[places, 0]]]
    if not len(inner):
        return None
    steep = (z[inner] - low[inner]) / np.maximum(away[inner], 1e-300)
    slopes = np.degrees(np.arctan(np.where(drains[inner], steep, 0.0)))
    k = int(np.argmin(slopes))
    x, y, height = points[inner[k]].tolist()
    return float(slopes[k]), (x, y, height)


def _water(corners: Array, level: float) -> tuple[float, float]:
    """Volume of water below a level over triangles with corners (n, 3, 3), and the area of its
    surface; a single wet or dry corner makes a smaller triangle."""
    plan = np.abs(double_areas(corners)[:, 2]) / 2
    h = np.sort(level - corners[:, :, 2], axis=1)
    wet, volume, area = (h > 0.0).sum(axis=1), np.zeros(len(h)), np.zeros(len(h))
    for alone, others, sign in ((2, (0, 1), wet == 1), (0, (1, 2), wet == 2)):
        a, b, c = h[sign, alone], h[sign, others[0]], h[sign, others[1]]
        part = a * a / ((a - b) * (a - c))
        area[sign], volume[sign] = part, part * a / 3
    area[wet == 2], volume[wet == 2] = 1 - area[wet == 2], (h.sum(axis=1) / 3 - volume)[wet == 2]
    area[wet == 3], volume[wet == 3] = 1.0, h[wet == 3].sum(axis=1) / 3
    return float(plan @ volume), float(plan @ area)


def _graph(n: int, pairs: Integers, weights: Array | None = None) -> coo_array:
    from scipy.sparse import coo_array

    values = np.ones(len(pairs)) if weights is None else weights
    return coo_array((values, tuple(pairs.T.astype(np.int32))), shape=(n, n))


def _filled(z: Array, pairs: Integers, outlets: Integers) -> Array:
    """Least level at which water at each point (n,) drains: the highest point of the lowest path to
    an outlet, which always runs along triangle edges. Points without a path or an edge stay dry.
    Units: z (length)."""
    # The lowest paths to all outlets form the minimum spanning tree of the edges' heights, with an
    # extra point to which all outlets lead.
    from scipy.sparse import csgraph

    n = len(z)
    out = np.column_stack([outlets, np.full(len(outlets), n)])
    heights = np.concatenate([z[pairs].max(axis=1), z[outlets]])
    weights = heights - heights.min() + 1.0 + np.ptp(heights)  # a weight of 0 would be no edge
    tree = csgraph.minimum_spanning_tree(_graph(n + 1, np.concatenate([pairs, out]), weights))
    order, before = csgraph.breadth_first_order(tree, n, directed=False)
    fill = np.append(z, -np.inf)
    for point, last in zip(order[1:].tolist(), before[order[1:]].tolist(), strict=True):
        fill[point] = max(fill[point], fill[last])
    return np.asarray(fill[:n])
