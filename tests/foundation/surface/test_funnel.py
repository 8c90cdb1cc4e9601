"""The taut string of a strip against a search among all ways from vertex to vertex."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from crms_fenicsx.foundation.surface.corridor import corner_angle, pull_taut
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint, VertexPoint

ROUNDING = 1e-12  # relative; strips of 30 cells lose some 1e-15 for each


def random_strip(rng, n):
    """A winding strip in the plane: places of its vertices, its edges, its ends."""
    count = n + 4  # a vertex before the first edge, two on it, one for each cell
    turn = np.cumsum(rng.uniform(-0.5, 0.5, count))
    spine = np.cumsum(np.column_stack([np.cos(turn), np.sin(turn)]), axis=0)
    normal = np.column_stack([-np.sin(turn), np.cos(turn)])
    side = rng.choice([-1.0, 1.0], count)
    side[1:3] = (1.0, -1.0)
    points = spine + (side * rng.uniform(0.1, 1.0, count))[:, None] * normal
    points = points[:, 0] + 1j * points[:, 1]
    left, right = 1, 2
    edges = [(1, 2)]
    for new in range(3, n + 2):
        left, right = (new, right) if side[new] > 0 else (left, new)
        edges.append((min(left, right), max(left, right)))
    return points, edges, (0, n + 2)


def all_lengths(points):
    pairs = itertools.combinations(range(len(points)), 2)
    return {(a, b): abs(points[b] - points[a]) for a, b in pairs}


def cross(a, b):
    return (a.conjugate() * b).imag


def upright(points, edges, ends):
    """Say whether the cells follow one another without overlap of neighbours."""
    chain = [{ends[0], *edges[0]}, *(set(a) | set(b) for a, b in itertools.pairwise(edges))]
    chain.append({*edges[-1], ends[1]})
    for edge, before, after in zip(edges, chain, chain[1:], strict=False):
        a, b = (points[v] for v in edge)
        (c,), (d,) = before - set(edge), after - set(edge)
        if cross(b - a, points[c] - a) * cross(b - a, points[d] - a) > -1e-3:
            return False
    return True


def searched(points, edges, p, q):
    """Length of the shortest polyline from p to q over vertices of the edges, in their order."""

    def open_way(a, b, between):
        for edge in between:
            u, v = (points[w] for w in edge)
            if min(abs(a - u), abs(a - v), abs(b - u), abs(b - v)) == 0:
                continue  # it starts or ends on this edge
            if (
                cross(b - a, u - a) * cross(b - a, v - a) > 0
                or cross(v - u, a - u) * cross(v - u, b - u) > 0
            ):
                return False
        return True

    nodes = [(p, -1, -1)]
    for vertex in sorted({v for edge in edges for v in edge}):
        at = [k for k, edge in enumerate(edges) if vertex in edge]
        nodes.append((points[vertex], at[0], at[-1]))
    nodes.append((q, len(edges), len(edges)))
    best = {0: 0.0}
    for j in range(1, len(nodes)):
        ways = [
            best[i] + abs(nodes[j][0] - nodes[i][0])
            for i in best
            if nodes[i][1] <= nodes[j][2]
            and open_way(nodes[i][0], nodes[j][0], edges[nodes[i][2] + 1 : nodes[j][1]])
        ]
        if ways:
            best[j] = min(ways)
    return best[len(nodes) - 1]


def place(point, points):
    if isinstance(point, VertexPoint):
        return points[point.vertex]
    if isinstance(point, EdgePoint):
        a, b = point.edge
        return (1 - point.fraction) * points[a] + point.fraction * points[b]
    return sum(w * points[v] for w, v in zip(point.weights, point.cell, strict=True))


def random_end(rng, vertex, edge):
    kind = rng.integers(3)
    if kind == 0:
        return VertexPoint(vertex)
    if kind == 1:
        a, b = sorted((vertex, edge[rng.integers(2)]))
        return EdgePoint((a, b), rng.uniform(0.05, 0.95))
    return CellPoint((vertex, *edge), tuple(rng.dirichlet([1, 1, 1])))


def strips(seed, count):
    rng = np.random.default_rng(seed)
    while count:
        points, edges, ends = random_strip(rng, int(rng.integers(1, 28)))
        if upright(points, edges, ends):
            count -= 1
            yield (
                points, edges,
                random_end(rng, ends[0], edges[0]), random_end(rng, ends[1], edges[-1]),
            )  # fmt: skip


def test_random_strips_against_a_search():
    bent = 0
    for points, edges, start, end in strips(1, 150):
        string = pull_taut(start, edges, end, all_lengths(points))
        p, q = place(start, points), place(end, points)
        assert string.length == pytest.approx(searched(points, edges, p, q), rel=ROUNDING)
        crossings = [points[a] + t * (points[b] - points[a])
                     for (a, b), t in zip(edges, string.fractions, strict=True)]  # fmt: skip
        way = np.array([p, *crossings, q])
        assert np.abs(np.diff(way)).sum() == pytest.approx(string.length, rel=1e-10)
        bent += len(string.bends)
        for bend in string.bends:
            assert bend.angle >= math.pi - 1e-9
            for k in range(len(edges)):
                assert (bend.vertex in edges[k]) == (bend.first <= k <= bend.last)
    assert bent > 100


def test_mirrored_strips_give_the_same_string():
    """Ids in the opposite order put left to right."""
    for points, edges, start, end in strips(2, 50):
        last = len(points) - 1

        def other(point, last=last):
            if isinstance(point, VertexPoint):
                return VertexPoint(last - point.vertex)
            if isinstance(point, EdgePoint):
                a, b = point.edge
                return EdgePoint((last - b, last - a), 1 - point.fraction)
            return CellPoint(tuple(last - v for v in point.cell), point.weights)

        string = pull_taut(start, edges, end, all_lengths(points))
        mirrored = pull_taut(
            other(start),
            [(last - b, last - a) for a, b in edges],
            other(end),
            all_lengths(points[::-1].conjugate()),
        )
        assert mirrored.length == pytest.approx(string.length, rel=1e-15)
        np.testing.assert_allclose(1 - np.array(mirrored.fractions), string.fractions, atol=1e-14)
        assert [last - b.vertex for b in mirrored.bends] == [b.vertex for b in string.bends]


def test_a_string_along_an_edge_crosses_it_in_its_middle():
    # 0 -> 1 and 4, bends at 2 (below) and 3 (above), which an edge joins
    points = np.array([-2 + 1j, 0 + 2j, 0 + 0j, 1 + 1j, 3 - 0.5j, 3 + 0j])
    points[2], points[3] = 0.5 + 1.2j, 1.5 - 0.2j
    points[1], points[4] = 0.4 + 3j, 1.6 - 3j
    points[0], points[5] = -2 - 1j, 4 + 2j
    string = pull_taut(
        VertexPoint(0), [(1, 2), (2, 3), (3, 4)], VertexPoint(5), all_lengths(points)
    )
    assert [b.vertex for b in string.bends] == [2, 3]
    assert string.fractions == (1.0, 0.5, 0.0)
    way = points[[0, 2, 3, 5]]
    assert string.length == pytest.approx(np.abs(np.diff(way)).sum(), rel=ROUNDING)
    for bend, (a, b, c) in zip(string.bends, ((0, 2, 3), (2, 3, 5)), strict=True):
        turn = np.angle((points[c] - points[b]) / (points[b] - points[a]))
        assert bend.angle == pytest.approx(math.pi + abs(turn), abs=1e-12)


def test_ends_on_the_first_and_last_edge():
    """Places in cells may lie on an edge that the string crosses, or on a vertex."""
    points = np.array([0, 1 + 1j, 1 - 1j, 2 + 0j, 3 + 1j])
    edges, lengths = [(1, 2), (1, 3)], all_lengths(points)
    on_edge = CellPoint((0, 1, 2), (0.0, 0.25, 0.75))
    on_vertex = CellPoint((0, 1, 2), (0.0, 1.0, 0.0))
    for start, expected in ((on_edge, 0.75), (on_vertex, 0.0)):
        string = pull_taut(start, edges, VertexPoint(4), lengths)
        assert string.length == pytest.approx(abs(points[4] - place(start, points)), rel=ROUNDING)
        assert string.fractions[0] == pytest.approx(expected, abs=1e-12)


def test_a_string_along_an_edge_from_an_end_on_it_crosses_it_there():
    points = np.array([0, 1 + 1j, 1 - 1j, 2 + 0j])
    for weight in (1.0, 0.75, 0.5):
        start = CellPoint((0, 1, 2), (0.0, weight, 1.0 - weight))
        end = CellPoint((1, 2, 3), (0.25, 0.75, 0.0))
        string = pull_taut(start, [(1, 2)], end, all_lengths(points))
        assert string.fractions[0] == pytest.approx(1.0 - weight, abs=1e-12)
        assert string.length == pytest.approx(2 * (weight - 0.25), rel=ROUNDING)


def test_an_end_however_near_to_a_vertex_has_its_edges_direction():
    points = np.array([0, 2 + 0j, 1 - 1j, 0 - 1j])  # around vertex 0: edges to 1, 2 and 3
    for near in (0.3, 1e-6, 1e-12, 1e-300):
        start = EdgePoint((0, 1), near)
        string = pull_taut(start, [(0, 2), (0, 3)], VertexPoint(4), all_lengths([*points, -1 + 0j]))
        (bend,) = string.bends
        assert bend.vertex == 0
        assert bend.angle == pytest.approx(math.pi, abs=1e-12)


def test_corner_angles():
    rng = np.random.default_rng(3)
    for a, b, c in rng.normal(size=(20, 3, 2)) @ [1, 1j]:
        lengths = all_lengths([a, b, c])
        assert corner_angle(0, 1, 2, lengths) == pytest.approx(
            abs(np.angle((c - a) / (b - a))), abs=1e-13
        )
    thin = {(0, 1): 1.0, (0, 2): 1.0, (1, 2): 1e-9}
    assert corner_angle(0, 1, 2, thin) == pytest.approx(1e-9, rel=1e-9)
    no_triangle = {(0, 1): 1.0, (0, 2): 1.0, (1, 2): 2.1}
    assert corner_angle(0, 1, 2, no_triangle) == math.pi
