"""Assembly of nets from routes: paths on the membrane, their lengths, names and crossings."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from string import ascii_uppercase

import numpy as np

from crms_fenicsx.cabling.paths.routes import shortened, traced, traced_over_holes
from crms_fenicsx.design.nets.whole_surface import WholeSurface
from crms_fenicsx.foundation.meshes.smooth_surface import arc_lengths_on
from crms_fenicsx.foundation.meshes.triangles import cross, dot, norm
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.model.cable import Net, NetCrossing, NetLine
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_POINT

APART = 0.01
"""Least distance of a line's points, relative to the cell size."""


@dataclass(frozen=True)
class _TracedLine:
    """A line of the net on the cells."""

    name: str
    path: Path
    points: Array  # (k, 3), including anchors (length)
    steps: Array  # (k - 1,) lengths of its segments


def assembled(
    call: str,
    surface: WholeSurface,
    families: Sequence[Sequence[Array]],
    *,
    taut: bool = False,
    nodes: Array | None = None,
) -> Net:
    """The net of families of routes (k, 2) or (k, 3), pulled taut if `taut`. Collective."""
    lines: list[NetLine] = []
    ways: list[_TracedLine] = []
    for letter, routes in zip(ascii_uppercase, families, strict=False):
        for number, route in enumerate(routes, start=1):
            name = f"{letter}{number}"
            try:
                path = traced(surface.membrane, route, {})
                if taut:
                    path = shortened(surface.membrane, path)
            except PathError as error:
                text = f"{call}: line {name}: {error}"
                if _crosses_hole(surface.membrane, route):
                    text += (
                        " It crosses a hole, which a line of a net cannot; lay cables one by one "
                        'with Scene.lay_cable, which span it if "outside" or in a sleeve.'
                    )
                raise PathError(text) from None
            points, lengths = _measured(surface, path)
            ways.append(_TracedLine(name, path, points, lengths))
            kept = [points[0]]  # laying may merge points closer to the previous or the last one
            for point in points[1:-1]:
                if np.all(norm(point - np.array([kept[-1], points[-1]])) > APART * surface.size):
                    kept.append(point)
            lines.append(NetLine(name, np.array([*kept, points[-1]]), float(lengths.sum())))
    return Net(tuple(lines), _crossings(surface, ways), nodes)


def _crosses_hole(membrane: Membrane, route: Array) -> bool:
    """Whether a single cable could follow a route, over holes. Collective."""
    try:
        return len(traced_over_holes(membrane, route, {}, slides=True)[1]) > 0
    except PathError:
        return False


def _measured(surface: WholeSurface, path: Path) -> tuple[Array, Array]:
    """Points (k, 3) of a path, including anchors, and lengths of its k - 1 segments."""
    ids = surface.strip.vertices
    rows = [np.searchsorted(ids, [*point.support, 0, 0][:3]) for point in path.points]
    weights = np.array([[*point.weights, 0.0, 0.0][:3] for point in path.points])
    offsets, normals = surface.smooth.raised(np.array(rows), weights)
    points = path.positions(ids, surface.points)
    lengths = arc_lengths_on(points + offsets, normals, np.zeros(len(points) - 1, dtype=bool))
    if path.start_anchor is not None:
        lengths = np.insert(lengths, 0, norm(points[0] - path.start_anchor))
        points = np.insert(points, 0, path.start_anchor, axis=0)
    if path.end_anchor is not None:
        lengths = np.append(lengths, norm(points[-1] - path.end_anchor))
        points = np.append(points, [path.end_anchor], axis=0)
    return points, lengths


def _crossings(surface: WholeSurface, ways: Sequence[_TracedLine]) -> tuple[NetCrossing, ...]:
    """Crossings of lines of different families; those on edges and at vertices count once."""
    cells, strip = surface.strip.vertices[surface.cells], surface.strip
    in_cell: dict[int, list[tuple[int, int]]] = defaultdict(list)
    for n, way in enumerate(ways):
        first = int(way.path.start_anchor is not None)
        for k, support in enumerate(way.path.links(cells), start=first):
            for row in strip.outer_rows(support):
                in_cell[row].append((n, k))
    found: dict[tuple[int, int], list[NetCrossing]] = defaultdict(list)
    for row in sorted(in_cell):
        for (n, i), (m, j) in combinations(sorted(in_cell[row]), 2):
            one, other = ways[n], ways[m]
            if one.name[0] == other.name[0]:
                continue
            a, b = one.points[i : i + 2], other.points[j : j + 2]
            parameters = _meeting(a, b)
            if parameters is None:
                continue
            s, t = parameters
            place = (a[0] + s * (a[1] - a[0]) + b[0] + t * (b[1] - b[0])) / 2
            known = found[n, m]
            if all(norm(place - old.place) > SAME_POINT * surface.size for old in known):
                at = (
                    float(one.steps[:i].sum() + s * one.steps[i]),
                    float(other.steps[:j].sum() + t * other.steps[j]),
                )
                known.append(NetCrossing((one.name, other.name), place, at))
    return tuple(
        one for pair in sorted(found) for one in sorted(found[pair], key=lambda one: one.at)
    )


def _meeting(a: Array, b: Array) -> tuple[float, float] | None:
    """Parameters of the crossing of two coplanar segments (2, 3); None if they do not cross."""
    u, v, w = a[1] - a[0], b[1] - b[0], b[0] - a[0]
    normal = cross(u, v)
    square = float(dot(normal, normal))
    if square <= 1e-18 * float(dot(u, u) * dot(v, v)):
        return None
    s, t = float(dot(cross(w, v), normal)) / square, float(dot(cross(w, u), normal)) / square
    low, high = -SAME_POINT, 1 + SAME_POINT
    return (s, t) if low <= s <= high and low <= t <= high else None
