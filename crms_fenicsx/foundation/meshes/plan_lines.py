"""Lines that a generated mesh follows: their ends, their crossings, and rows of vertices.

Generators mesh a plan, which is then lifted or lies below the surface. The vertices of a line are
laid out in the plan before it is meshed, and gmsh embeds the edges between them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.orientation import connected_labels
from crms_fenicsx.foundation.meshes.surface import BOUNDARY
from crms_fenicsx.foundation.meshes.triangles import (
    closest_on_segments,
    cross_in_plane,
    norm,
    side_turns,
    vertex_normals,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, MeshError, as_text

MEETS, APART = 0.2, 0.02
"""Distance up to which ends are moved, and within which lines run side by side (cell sizes)."""

SAMPLES = 8
"""Points of a line within a cell size, between which it is taken for straight."""

TURN = float(np.radians(0.5))
"""Angle by which a line turns sideways that is told, or counts as a bend."""

logger = logging.getLogger("crms_fenicsx")

Lines = Mapping[str, ArrayLike]


class Outline(NamedTuple):
    """The rim of a plan, as a polygon, some corners of which are vertices of every mesh."""

    corners: Array  # (n, 2)
    fixed: Integers  # the corners that are vertices
    exact: Callable[[Array], Array] | None = None  # moves points (k, 2) near the polygon to the rim

    def nearest(self, points: Array) -> tuple[Array, Array]:
        """Points (k, 2) on the rim, and their places (k,) along it: whole numbers are corners."""
        start, way = self.corners, np.roll(self.corners, -1, axis=0) - self.corners
        share, found, gap = closest_on_segments(start, way, points[:, None])
        all_points, side = np.arange(len(points)), gap.argmin(axis=1)
        share, found = share[all_points, side], found[all_points, side]
        if self.exact is not None:
            near = gap[all_points, side] < np.linalg.norm(way[side], axis=1)
            found = self.exact(np.where(near[:, None], points, found))
        return found, (side + share) % len(start)

    def inside(self, points: Array) -> Booleans:
        """Whether points (k, 2) lie in the polygon, (k,)."""
        (x, y), a, b = points.T[..., None], self.corners, np.roll(self.corners, -1, axis=0)
        spans = (a[:, 1] > y) != (b[:, 1] > y)
        rise = np.where(spans, b[:, 1] - a[:, 1], 1.0)
        beyond = x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
        inside: Booleans = (spans & beyond).sum(axis=1) % 2 == 1
        return inside


class PlanRows(NamedTuple):
    """The vertices of lines in the plan; lines that meet share one."""

    points: Array  # (n, 3), as lifted
    places: dict[int, float]  # of those on the rim, as by `Outline.nearest`
    rows: dict[str, Integers]  # those of each line, in order


def flat(points: Array) -> Array:
    """Points (n, 2) with z = 0."""
    return np.column_stack([points, np.zeros(len(points))])


class PlanShape(NamedTuple):
    """What is meshed in the plan of a generator."""

    call: str  # its name in errors
    outline: Outline
    size: Callable[[Array], float]  # edge length at a point (3,) of the surface
    lift: Callable[[Array], Array] = flat  # points (n, 3) of the surface above points (n, 2)
    taken: Collection[str] = ()  # names of its groups of edges

    def sizes(self, points: Array) -> Array:
        """Edge lengths above points (n, 2)."""
        return np.array([self.size(point) for point in self.lift(points)])


def _given(plan: PlanShape, lines: Lines | None) -> dict[str, Array]:
    """The lines' points, (k, 2) or (k, 3), checked but for where they lie."""
    if lines is None:
        return {}
    checks.collection(f"{plan.call}: lines", lines, Mapping, '{"A1": [(0.0, 1.0), (4.0, 1.0)]}')
    found = {}
    for name, given in lines.items():
        if not isinstance(name, str) or not name.strip():
            raise InputError(f"{plan.call}: a line has the name {name!r}; pass a non-empty string.")
        what = f"{plan.call}: lines[{name!r}]"
        if name == BOUNDARY or name in plan.taken:
            raise InputError(f"{what}: edges of the mesh are named {name!r} already; rename it.")
        try:
            points = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            points = np.zeros(0)
        if points.ndim != 2 or len(points) < 2 or points.shape[1] not in (2, 3):
            raise InputError(f"{what} is not a line; pass two or more points (x, y) or (x, y, z).")
        if not np.isfinite(points).all():
            bad = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
            raise InputError(f"{what} has the point {points[bad]}; pass finite coordinates.")
        ways = np.diff(points, axis=0)
        points = points[np.append(True, (ways != 0.0).any(axis=1))]
        if len(points) < 2:
            raise InputError(f"{what} has no length; pass two points that differ.")
        found[name] = points
    return found


def rows_in(
    plan: PlanShape,
    lines: Lines | None,
    into_plan: Callable[[Array], Array] = lambda given: given[:, :2],
) -> PlanRows:
    """Rows of vertices on lines, points (k, 2) or (k, 3) of which `into_plan` puts in the plan."""
    found = {name: into_plan(one) for name, one in _given(plan, lines).items()}
    if not found:
        return PlanRows(np.zeros((0, 3)), {}, {})
    for name, line in found.items():
        _check_line(plan, name, line)
    names, ways = list(found), [_sampled(plan, line) for line in found.values()]
    ways, nodes = _with_ends(plan, names, ways)
    rows = _divided(plan, names, ways, nodes + _crossings(plan, names, ways))
    _check_apart(plan, rows)
    return rows._replace(points=plan.lift(rows.points))


def _check_line(plan: PlanShape, name: str, line: Array) -> None:
    """Refuse a line (k, 2) that leaves the plan far, is closed or runs back on itself."""
    what, corners = f"{plan.call}: line {name!r}", plan.outline.corners
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    far = ~(np.abs(line - middle) <= np.ptp(corners, axis=0)).all(axis=1)
    if far.any():
        place = tuple(line[np.argmax(far)].tolist())
        raise MeshError(f"{what} leaves the plan, to {place}; pass the part of it that is inside.")
    if np.linalg.norm(line[-1] - line[0]) <= MEETS * plan.sizes(line[:1])[0]:
        raise MeshError(
            f"{what} begins and ends at {as_text(line[0])}; pass a line with two ends, longer than "
            f"{MEETS:g} of the size."
        )
    steps = np.diff(line, axis=0)
    back = np.flatnonzero((steps[1:] * steps[:-1]).sum(axis=1) < 0.0)
    if len(back):
        raise MeshError(
            f"{what} runs back at {as_text(line[back[0] + 1])}; pass its points in order, and two "
            "lines where it has a corner."
        )


def _sampled(plan: PlanShape, points: Array) -> Array:
    """Points (n, 2) of a polyline, so dense that those of the surface above them are as well."""
    t = corners = np.arange(len(points), dtype=np.float64)
    while True:
        found = np.stack([np.interp(t, corners, x) for x in points.T], axis=1)
        chords = norm(np.diff(plan.lift(found), axis=0))
        halved = SAMPLES * chords > plan.sizes((found[1:] + found[:-1]) / 2)
        if not halved.any():
            return found
        t = np.sort(np.concatenate([t, (t[1:] + t[:-1])[halved] / 2]))


class Node(NamedTuple):
    """A place that is a vertex of a line, `at` its number of samples from the start."""

    line: int
    at: float
    point: Array
    place: float | None = None  # along the rim


def _with_ends(
    plan: PlanShape, names: list[str], ways: list[Array]
) -> tuple[list[Array], list[Node]]:
    """Lines whose ends have been moved to the rim or to other lines, and these ends."""
    outline, size = plan.outline, [plan.sizes(way[[0, -1]]) for way in ways]
    fixed = outline.corners[outline.fixed]
    taken = [(point, float(k)) for point, k in zip(fixed, outline.fixed, strict=True)]
    on_rim: dict[tuple[int, int], tuple[Array, float]] = {}
    ways = list(ways)
    for k, way in enumerate(ways):
        found, places = outline.nearest(way[[0, -1]])
        for end in (0, 1):
            reach, point, place = MEETS * size[k][end], found[end], float(places[end])
            if np.linalg.norm(point - way[-end]) <= reach:
                near = [one for one in taken if np.linalg.norm(one[0] - point) <= reach]
                point, place = min(
                    near or [(point, place)], key=lambda one: float(np.linalg.norm(one[0] - point))
                )
                taken.append((point, place))
                on_rim[k, end] = point, place
        ends = [on_rim[k, end][0] if (k, end) in on_rim else None for end in (0, 1)]
        ways[k] = _moved(plan, names[k], way, ends)
    nodes = [Node(k, end * (len(ways[k]) - 1), *one) for (k, end), one in on_rim.items()]
    loose = [(k, end) for k in range(len(ways)) for end in (0, 1) if (k, end) not in on_rim]
    return _on_others(plan, names, ways, loose, nodes)


def _on_others(
    plan: PlanShape,
    names: list[str],
    ways: list[Array],
    loose: list[tuple[int, int]],
    nodes: list[Node],
) -> tuple[list[Array], list[Node]]:
    """Move the other ends, (line, 0 or 1), to other lines, and add them to the nodes."""
    ways, found = list(ways), nodes
    for _ in range(3 if loose else 0):  # lines that end on lines that move
        found = list(nodes)
        for k, end in loose:
            tip = ways[k][-end]
            others = [(*_closest(ways[j], tip), j) for j in range(len(ways)) if j != k]
            best = min(others, key=lambda one: one[0], default=None)
            if best is None or best[0] > MEETS * plan.sizes(tip[None])[0]:
                rim = plan.outline.nearest(tip[None])[0][0]
                where = "inside" if plan.outline.inside(tip[None])[0] else "outside"
                raise MeshError(
                    f"{plan.call}: line {names[k]!r} ends {where} the plan, at {as_text(tip)}, "
                    f"{np.linalg.norm(rim - tip):.3g} from the rim, more than {MEETS:g} of the "
                    "size; let it end on the rim or on another line."
                )
            _, at, point, other = best
            ways[k] = _moved(plan, names[k], ways[k], [None, point] if end else [point, None])
            found += [Node(k, end * (len(ways[k]) - 1), point), Node(other, at, point)]
    return ways, found


def _closest(way: Array, point: Array) -> tuple[float, float, Array]:
    """Distance to a polyline (n, 2), and where its nearest point is."""
    share, places, gap = closest_on_segments(way[:-1], np.diff(way, axis=0), point)
    k = int(gap.argmin())
    return float(gap[k]), k + float(share[k]), places[k]


def _moved(plan: PlanShape, name: str, way: Array, ends: list[Array | None]) -> Array:
    """A line (n, 2) that is turned and stretched so that its ends, if given, are others."""
    ahead = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1)))
    shares, moved = (1.0 - ahead / ahead[-1], ahead / ahead[-1]), way.copy()
    for k, (end, share) in enumerate(zip(ends, shares, strict=True)):
        if end is None:
            continue
        step = float(np.linalg.norm(end - way[-k]))
        if step > APART * plan.sizes(end[None])[0]:
            logger.info(
                "%s: line %r now ends at %s, %.3g away", plan.call, name, as_text(end), step
            )
        moved += share[:, None] * (end - way[-k])
        moved[-k] = end
    return moved


def _crossings(plan: PlanShape, names: list[str], ways: list[Array]) -> list[Node]:
    """The places where lines cross, a node of each."""
    starts = np.concatenate([way[:-1] for way in ways])
    steps = np.concatenate([np.diff(way, axis=0) for way in ways])
    owner = np.repeat(np.arange(len(ways)), [len(way) - 1 for way in ways])
    number = np.concatenate([np.arange(len(way) - 1) for way in ways])
    longest = float(np.linalg.norm(steps, axis=1).max())
    pairs = _tree(starts + steps / 2).query_pairs(longest * (1 + 1e-9), output_type="ndarray")
    i, j = pairs[(owner[pairs[:, 0]] != owner[pairs[:, 1]]) | (np.ptp(number[pairs], axis=1) > 1)].T
    area = cross_in_plane(steps[i], steps[j])
    level = np.linalg.norm(steps[i], axis=1) * np.linalg.norm(steps[j], axis=1)
    i, j, area = (a[np.abs(area) > 1e-12 * level] for a in (i, j, area))
    s = cross_in_plane(starts[j] - starts[i], steps[j]) / area
    t = cross_in_plane(starts[j] - starts[i], steps[i]) / area
    meet = (np.abs(s - 0.5) <= 0.5 + 1e-9) & (np.abs(t - 0.5) <= 0.5 + 1e-9)
    found = []
    for a, b, u, v in zip(i[meet], j[meet], s[meet], t[meet], strict=True):
        point = starts[a] + u * steps[a]
        if owner[a] == owner[b]:
            raise MeshError(
                f"{plan.call}: line {names[owner[a]]!r} crosses itself at {as_text(point)}; pass "
                "it as several lines."
            )
        found += [Node(owner[a], number[a] + u, point), Node(owner[b], number[b] + v, point)]
    return found


def _tree(points: Array) -> Any:
    """A tree of points (n, 2)."""
    from scipy.spatial import cKDTree  # takes longer to import than scripts without lines need

    return cKDTree(points)


def _divided(plan: PlanShape, names: list[str], ways: list[Array], nodes: list[Node]) -> PlanRows:
    """Lay out vertices on the lines, between the nodes where they end or meet others."""
    spots = np.stack([node.point for node in nodes])
    near = _tree(spots).query_ball_point(spots, APART * plan.sizes(spots))
    pairs = np.array([(k, m) for k, others in enumerate(near) for m in others])
    vertex = [int(v) for v in connected_labels(len(nodes), *pairs.T)]
    points, places = np.zeros((max(vertex) + 1, 2)), dict[int, float]()
    for node, v in reversed(list(zip(nodes, vertex, strict=True))):
        points[v] = node.point  # that of its first node: ends on the rim come first
        if node.place is not None:
            places[v] = node.place
    rows, added = {}, [points]
    for k, (name, way) in enumerate(zip(names, ways, strict=True)):
        own = sorted((node.at, v) for node, v in zip(nodes, vertex, strict=True) if node.line == k)
        lengths = norm(np.diff(plan.lift(way), axis=0)) / plan.sizes((way[1:] + way[:-1]) / 2)
        ahead = np.append(0.0, np.cumsum(lengths))  # in cells
        start, row = 0.0, [own[0][1]]
        for at, v in own[1:]:
            if v == row[-1]:
                continue
            stop = float(np.interp(at, np.arange(len(way)), ahead))
            wanted = np.linspace(start, stop, max(round(stop - start), 1) + 1)[1:-1]
            first = sum(map(len, added))
            added.append(np.stack([np.interp(wanted, ahead, x) for x in way.T], axis=1))
            row += [*range(first, first + len(wanted)), v]
            start = stop
        if len(set(row)) < max(len(row), 2):
            raise MeshError(
                f"{plan.call}: line {name!r} meets itself within {APART:g} of a cell; pass it as "
                "several lines."
            )
        rows[name] = np.array(row)
    return PlanRows(np.concatenate(added), places, rows)


def _check_apart(plan: PlanShape, rows: PlanRows) -> None:
    """Refuse lines that run side by side, along the rim or outside of the plan."""
    pairs = np.concatenate([np.stack([row[:-1], row[1:]], axis=1) for row in rows.rows.values()])
    names = [name for name, row in rows.rows.items() for _ in row[1:]]
    ends = plan.lift(rows.points)[pairs]
    ways, middles = ends[:, 1] - ends[:, 0], ends.mean(axis=1)
    least = np.full(len(rows.points), np.inf)
    np.minimum.at(least, pairs, norm(ways)[:, None])
    owner = {int(v): name for name, row in rows.rows.items() for v in row}
    inner = np.setdiff1d(np.arange(len(rows.points)), list(rows.places))
    spots = np.concatenate([rows.points[inner], rows.points[pairs].mean(axis=1)])
    places = np.concatenate([plan.lift(rows.points[inner]), middles])
    apart = APART * np.append(least[inner], norm(ways))
    owners = [owner[int(v)] for v in inner] + names
    rim = plan.lift(plan.outline.nearest(spots)[0])
    bad = np.flatnonzero(~plan.outline.inside(spots) | (norm(rim - places) < apart))
    if len(bad):
        raise MeshError(
            f"{plan.call}: line {owners[bad[0]]!r} leaves the plan or runs along its rim at "
            f"{as_text(spots[bad[0]])}; keep it inside, from rim to rim or to other lines."
        )
    reach = norm(ways).max(initial=0.0) / 2 + apart
    for k, near in enumerate(_tree(middles).query_ball_point(places, reach)):
        vertex = inner[k] if k < len(inner) else -1
        others = [m for m in near if m != k - len(inner) and vertex not in pairs[m]]
        gaps = closest_on_segments(ends[others, 0], ways[others], places[k])[2]
        if (gaps < apart[k]).any():
            raise MeshError(
                f"{plan.call}: lines {owners[k]!r} and {names[others[gaps.argmin()]]!r} run side "
                f"by side at {as_text(spots[k])}, less than {APART:g} of a cell apart; leave one "
                "out, or move them apart."
            )


def tell_turns(call: str, points: Array, cells: Integers, rows: Mapping[str, list[int]]) -> None:
    """Tell where rows of vertices turn sideways on the surface of the cells (m, 3)."""
    near = np.isin(cells, [vertex for row in rows.values() for vertex in row]).any(axis=1)
    normals = vertex_normals(points, cells[near])
    for name, row in rows.items():
        turns = np.abs(side_turns(points[row], normals[row]))
        worst = int(np.argmax(turns))
        if turns[worst] > TURN:
            logger.info(
                "%s: line %r turns sideways by up to %.2g degrees at a vertex, at %s",
                call, name, np.degrees(turns[worst]), as_text(points[row[worst]]),
            )  # fmt: skip
