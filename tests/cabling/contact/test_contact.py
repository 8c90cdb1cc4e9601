"""Lift-off and touch-down of a cable, and of one on another, on roofs that are easy to compute.

The roofs are folded strips of triangles, y = 0 ... 1, x = 0, 1, 2 ...; a cable runs along y = 1/2
over the folds and over the diagonals midway between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cabled_square import put
from strip_roof import along, cable_on, roof

from crms_fenicsx.cabling.cables.points_on_edges import NodeTable
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.active_set import joining, parting
from crms_fenicsx.cabling.contact.free_spans import Gap, under
from crms_fenicsx.cabling.contact.lift_off import (
    Polylines,
    captured,
    drape,
    is_foot,
    may_lift,
    released,
    size_at,
    sunk,
    touch,
)
from crms_fenicsx.foundation.meshes.triangles import cross
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint, VertexPoint
from crms_fenicsx.model.cable_state import CableNode, Crossing
from crms_fenicsx.model.laid_cable import LaidCable, polyline_length
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL

UP = np.array([0.0, 0.0, 1.0])


def set_lifted(cable: LaidCable, nodes: Sequence[int]) -> None:
    put(cable, "lifted", slice(None), False)
    put(cable, "lifted", list(nodes), True)


# ---- the pull on the membrane ------------------------------------------------------------------


def pull_at(cable: LaidCable, k: int, normal: Array, reach: float) -> float:
    lines = Polylines.of([cable])
    return float(lines.pulls(np.array([k]), normal[None], np.array([reach]))[0])


def slow_pull(cable: LaidCable, k: int, normal: Array, reach: float) -> float:
    """The same, walking along the polyline from one node."""
    total = np.zeros(3)
    for step in (-1, 1):
        here, way, m = cable.state.positions[k], 0.0, k
        while way < reach and 0 <= m + step < len(cable.state.nodes):
            m += step
            if cable.state.lifted[m]:
                continue
            part = float(np.linalg.norm(cable.state.positions[m] - here))
            share = min(1.0, (reach - way) / part)
            here, way = here + share * (cable.state.positions[m] - here), way + share * part
            if cable.state.nodes[m].kind == "crossing":
                break
        offset = here - cable.state.positions[k]
        if way <= SAME_PLACE * polyline_length(cable.state.positions[cable.contacts()]):
            return -1.0
        total += offset / np.linalg.norm(offset)
    return float(total @ normal)


def test_pulls_are_those_of_a_walk_from_each_node() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        n = int(rng.integers(3, 15))
        cable, _ = along(roof([0.0] * n))
        m = len(cable.state.nodes)
        cable.update(positions=rng.random((m, 3)))
        put(cable, "positions", 1, cable.state.positions[0] + 1e-12)  # on its anchor
        put(cable, "lifted", slice(2, -1), rng.random(m - 3) < 0.3)
        nodes = list(cable.state.nodes)
        for k in 2 + np.flatnonzero(rng.random(m - 3) < 0.3):
            nodes[k] = CableNode("crossing", CellPoint((0, 1, n), (0.2, 0.3, 0.5)))
        cable.update(nodes=tuple(nodes))
        inner = cable.contacts()[1:-1]
        normals, reaches = rng.standard_normal((len(inner), 3)), 2 * rng.random(len(inner))
        expected = [slow_pull(cable, *entry) for entry in zip(inner, normals, reaches, strict=True)]
        found = Polylines.of([cable]).pulls(np.array(inner), normals, reaches)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        assert found[0] == -1.0


@pytest.mark.parametrize("h", [0.3, -0.3, 0.0])
def test_pull_at_a_fold(h: float) -> None:
    """Two unit forces towards both sides, which go down (or up) as the roof does."""
    shape = roof([0.0, h, 0.0])
    cable, at = along(shape)
    pull = pull_at(cable, at[1.0], shape.normal((1, 4)), 0.4)
    assert pull == pytest.approx(-2 * h / np.hypot(1.0, h), abs=1e-15)
    assert pull_at(cable, at[0.5], shape.normal((1, 3)), 0.4) == pytest.approx(0.0, abs=1e-15)


def test_points_close_together_share_a_contact() -> None:
    """What counts is the turn between a distance before and after them."""
    cable, _ = along(roof([0.0, 0.0, 0.0]))
    places = [(-2, 0, 0), (-0.1, 0, 0), (0, 0, -0.02), (0.1, 0, 0), (2, 0, 0)]
    cable.update(positions=np.array(places))
    near = 2 * 0.02 / np.hypot(0.1, 0.02)
    assert pull_at(cable, 2, UP, 0.05) == pytest.approx(near)
    # a distance of 1 along the cable ends this far along the x axis
    x = 0.1 + 1.0 - np.hypot(0.1, 0.02)
    assert pull_at(cable, 2, UP, 1.0) == pytest.approx(2 * 0.02 / np.hypot(x, 0.02))
    put(cable, "lifted", [1, 3], True)  # it passes them straight
    assert pull_at(cable, 2, UP, 1.0) == pytest.approx(2 * 0.02 / np.hypot(2.0, 0.02), rel=1e-3)


def test_pull_is_not_looked_for_beyond_a_crossing() -> None:
    cable, _ = along(roof([0.0, 0.0, 0.0]))
    places = [(-2, 0, -3), (-0.5, 0, 0), (0, 0, 0), (0.5, 0, 0), (2, 0, -3)]
    cable.update(positions=np.array(places))
    assert pull_at(cable, 2, UP, 1.0) < -0.1
    nodes = list(cable.state.nodes)
    nodes[1] = nodes[3] = CableNode("crossing", CellPoint((0, 1, 3), (0.2, 0.3, 0.5)))
    cable.update(nodes=tuple(nodes))
    assert pull_at(cable, 2, UP, 1.0) == pytest.approx(0.0, abs=1e-15)


def test_a_cable_on_its_anchor_does_not_pull() -> None:
    shape = roof([0.0, 0.5, 0.0])
    cable, _ = along(shape, (0.0, 0.5, 0.0), (4.0, 0.5, 3.0))
    assert pull_at(cable, 1, UP, 0.5) == -1.0
    assert pull_at(cable, len(cable.state.nodes) - 2, UP, 0.5) > 0.1


def test_size_of_the_cells_around() -> None:
    shape = roof([0.0, 0.75, 0.0])  # twice the area of each is 5/4
    for support in ((1,), (1, 4), (1, 3), (0, 1, 3)):
        assert size_at(shape, support) == pytest.approx(np.sqrt(1.25))


# ---- what may leave the membrane ---------------------------------------------------------------


def test_ends_and_crossings_do_not_lift() -> None:
    shape = roof([0.0, -0.3, 0.0])
    cable, _ = along(shape)
    assert list(may_lift(cable)) == [1, 2, 3]
    assert released(cable, shape) == [1, 2, 3]  # all within the cells' size of the valley
    nodes = list(cable.state.nodes)
    nodes[2] = CableNode("crossing", CellPoint((0, 1, 3), (0.2, 0.3, 0.5)))
    cable.update(nodes=tuple(nodes))
    assert list(may_lift(cable)) == [1, 3]
    assert released(cable, shape) == []


def test_a_sleeve_holds_it() -> None:
    shape = roof([0.0, -0.3, 0.0])
    cable, _ = along(shape)
    cable.update(hold="sleeve")
    assert released(cable, shape) == []


def test_a_cable_on_top_holds_it_at_a_shared_vertex() -> None:
    shape = roof([0.0, -0.3, 0.0])
    nodes = [
        CableNode("tied", EdgePoint((0, 3), 0.5)),
        CableNode("vertex", VertexPoint(1)),
        CableNode("tied", EdgePoint((2, 5), 0.5)),
    ]
    cable = cable_on(shape, nodes)
    assert released(cable, shape) == [1]
    for others, expected in (([1], []), ([0, 2], [1])):
        may = ~np.isin(np.arange(3), others)
        assert Polylines.of([cable]).released(shape, may).tolist() == expected


def test_a_foot_only_marks_the_place_under_an_anchor() -> None:
    shape = roof([0.0, 0.3, 0.0])
    foot = CableNode("tied", CellPoint((0, 1, 3), (0.4, 0.3, 0.3)))
    fold, tied = (CableNode(kind, EdgePoint((1, 4), 0.5)) for kind in ("fold", "tied"))
    cable = cable_on(shape, [foot, fold, tied], [(0.3, 0.3, 2.0), (5.0, 0.5, -2.0)])
    assert [is_foot(cable, k) for k in range(1, 4)] == [True, False, False]
    assert 1 in released(cable, shape)
    set_lifted(cable, [1])
    put(cable, "positions", 0, (0.3, 0.3, -2.0))  # even with the anchor below
    assert captured(cable, shape) == {}


# ---- spans and what lies under them ------------------------------------------------------------


def test_under_an_edge() -> None:
    shape = roof([0.0, 0.5, 0.0])
    node = CableNode("fold", EdgePoint((1, 4), 0.5))
    span = np.array([(0.0, 0.2, 1.0)]), np.array([(2.0, 0.6, 2.0)])
    found = under(node.support, (span[0][0], span[1][0]), shape)
    assert found.gap == pytest.approx(1.0) and found.fraction == pytest.approx(0.4)
    np.testing.assert_allclose(found.place, [1.0, 0.4, 0.5])
    np.testing.assert_allclose(found.above, [1.0, 0.4, 1.5])
    assert found.inside


@pytest.mark.parametrize(
    ("start", "end", "fraction", "place", "above", "gap"),
    [
        # beyond the edge's end
        ((0, 1.2, 1), (2, 1.4, 1), 1.0, (1, 1, 0.5), (1, 1.3, 1), 0.5),
        ((0, -1, 1), (2, -1, 1), 0.0, (1, 0, 0.5), (1, -1, 1), 0.5),
        # before the span, which ends above the one side of the roof
        ((0, 0.2, 0), (0.8, 0.2, 0.1), 0.2, (1, 0.2, 0.5), (0.8, 0.2, 0.1), -0.4),
        # along the edge
        ((1, 0.2, 1), (1, 0.8, 1), 0.5, (1, 0.5, 0.5), (1, 0.5, 1), 0.5),
    ],
)
def test_under_an_edge_that_is_not_passed(start, end, fraction, place, above, gap) -> None:
    shape = roof([0.0, 0.5, 0.0])
    node = CableNode("fold", EdgePoint((1, 4), 0.5))
    found = under(node.support, (np.array(start, dtype=float), np.array(end, dtype=float)), shape)
    assert found.fraction == pytest.approx(fraction)
    np.testing.assert_allclose(found.place, place, atol=1e-15)
    np.testing.assert_allclose(found.above, above, atol=1e-15)
    assert found.gap == pytest.approx(gap)
    assert found.inside == (start[0] == end[0])


@pytest.mark.parametrize("y", [0.5, 1.1, 1.6])
def test_a_span_far_beyond_the_edges_of_its_path_is_sunk(y: float) -> None:
    """It runs below all of the membrane; where it passes an edge, that stops it."""
    shape = roof([0.0, 0.5, 0.0])
    cable = cable_on(
        shape, [CableNode("fold", EdgePoint((1, 4), 0.9))], [(0.0, y, -0.5), (2.0, y, -0.5)]
    )
    cable.update(taut=True)
    set_lifted(cable, [1])
    assert sunk([cable], NodeTable.of([cable]), shape) == (set() if y < 1 else {0})
    put(cable, "positions", ([0, -1], 2), 0.6)
    assert sunk([cable], NodeTable.of([cable]), shape) == set()


def slow_under(
    node: CableNode,
    span: tuple[Array, Array],
    shape: StripShape,
    bends: Sequence[Array] = (),
    reach: float = TOL.reach,
) -> Gap:
    """The place of the membrane on a node's edge or vertex that a free span passes."""
    assert node.point is not None
    support = node.point.support
    normal = shape.normal(support)
    start, end = span
    line = [shape.at(support[0]), *bends, shape.at(support[-1])]
    if len(support) == 1:
        t = float((line[0] - start) @ (end - start) / ((end - start) @ (end - start)))
        above = start + min(max(t, 0.0), 1.0) * (end - start)
        gap = float((above - line[0]) @ normal)
        return Gap(gap, np.nan, line[0], above, 0.0 < t < 1.0)
    sizes = [float(np.linalg.norm(b - a)) for a, b in pairwise(line)]
    found: Gap | None = None
    before, best = 0.0, (True, np.inf)
    for (a, b), size in zip(pairwise(line), sizes, strict=True):
        s, t = slow_crossing(a, b, start, end, normal)
        first, last = before == 0.0, before + size >= sum(sizes) * (1 - 1e-12)
        inside = (s > -TOL.inside or not first) and (s < 1 + TOL.inside or not last)
        inside = inside and 0.0 < t < 1.0
        other = (s < 0.0 and not first) or (s > 1.0 and not last)  # it passes another part
        past = -1
        if 0.0 < t < 1.0 and not inside:
            past = support[0] if first and -reach < s < 0.0 else past
            past = support[1] if last and 1.0 < s < 1 + reach else past
        s, t = min(max(s, 0.0), 1.0), min(max(t, 0.0), 1.0)
        place, above = a + s * (b - a), start + t * (end - start)
        fraction = (before + s * size) / sum(sizes)
        gap = float((above - place) @ normal)
        if found is None or (other, gap) < best:
            best = other, gap
            found = Gap(gap, fraction, place, above, inside, past)
        before += size
    assert found is not None
    return found


def slow_crossing(a: Array, b: Array, c: Array, d: Array, normal: Array) -> tuple[float, float]:
    """Where the lines ab and cd cross, seen along the normal: their parameters."""
    u, v = (x - (x @ normal) * normal for x in (b - a, d - c))
    w = (c - a) - ((c - a) @ normal) * normal
    area = float(cross(u, v) @ normal)
    if abs(area) <= 1e-12 * float(np.linalg.norm(u) * np.linalg.norm(v)):
        return 0.5, 0.5  # the span runs along the edge
    return float(cross(w, v) @ normal) / area, float(cross(w, u) @ normal) / area


@pytest.mark.parametrize("seed", range(40))
def test_places_under_spans_are_those_of_the_slow_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = roof([0.0, 0.5, 0.0])
    nodes = CableNode("fold", EdgePoint((1, 4), 0.5)), CableNode("vertex", VertexPoint(1))
    for node in nodes:
        start, end = rng.uniform(-0.5, 1.5, (2, 3))
        start[0], end[0] = start[0] - 0.5, end[0] + 1.0
        bends = [np.array([1.0, y, 0.5 + rng.uniform(-0.3, 0.3)]) for y in (0.4, 0.8)]
        given = (start, end), shape, bends[: seed % 3] if node is nodes[0] else []
        places = under(node.support, *given), slow_under(node, *given)
        for found, expected in zip(*places, strict=True):
            np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("z", [-0.5, 0.5])
@pytest.mark.parametrize("y", [0.25, 0.75])
def test_under_an_edge_that_another_cable_bends(y: float, z: float) -> None:
    """It is 0.5 deeper (in a sleeve: higher) in its middle; fractions are those of its length."""
    shape = roof([0.0, 0.0, 0.0])
    node = CableNode("fold", EdgePoint((1, 4), 0.9))
    span = np.array([0.0, y, 1.0]), np.array([2.0, y, 1.0])
    found = under(node.support, span, shape, [np.array([1.0, 0.5, z])])
    assert found.gap == pytest.approx(1.0 - z / 2) and found.inside
    np.testing.assert_allclose(found.place, [1.0, y, z / 2])
    assert found.fraction == pytest.approx(y)
    beyond = under(node.support, (span[0] + [0, 5, 0], span[1] + [0, 5, 0]), shape, [found.place])
    assert not beyond.inside and beyond.fraction == 1.0


def test_under_a_vertex() -> None:
    shape = roof([0.0, 0.5, 0.0])
    node = CableNode("vertex", VertexPoint(1))
    found = under(node.support, (np.array([0.0, 0.0, 1.0]), np.array([2.0, 0.0, 1.0])), shape)
    np.testing.assert_allclose(found.place, [1.0, 0.0, 0.5])
    np.testing.assert_allclose(found.above, [1.0, 0.0, 1.0])
    # the roof is symmetric, but only one cell at its left side touches the vertex
    assert np.isnan(found.fraction) and found.inside and 0.3 < found.gap <= 0.5
    outside = under(node.support, (np.array([1.5, 0.0, 1.0]), np.array([2.0, 0.0, 1.0])), shape)
    assert not outside.inside
    np.testing.assert_allclose(outside.above, [1.5, 0.0, 1.0])


# ---- touching down -----------------------------------------------------------------------------


def test_a_span_through_a_hill_touches_it() -> None:
    """Straight from end to end it is below the roof by the roof's height, along the normal."""
    heights = [0.0, 0.75, 1.0, 0.75, 0.0]
    shape = roof(heights)
    cable, at = along(shape)
    set_lifted(cable, range(1, 8))
    places = captured(cable, shape)
    assert sorted(places) == list(range(1, 8))
    assert places[at[2.0]].gap == pytest.approx(-1.0)
    # the diagonal's normal is that of its two cells, which are in one plane of slope 3/4
    assert places[at[0.5]].gap == pytest.approx(-0.375 * 1.25)
    np.testing.assert_allclose(cable.state.positions[:, 2], 0.0, atol=1e-15)  # on the span
    touch(cable, places)
    assert not cable.state.lifted.any()
    x = np.arange(0.0, 4.01, 0.5)
    expected = np.column_stack([x, np.full(9, 0.5), np.interp(x, range(5), heights)])
    np.testing.assert_allclose(cable.state.positions, expected, atol=1e-14)
    np.testing.assert_allclose(cable.state.fractions, 0.5)


def test_a_span_above_a_valley_does_not_touch_it() -> None:
    shape = roof([1.0, 0.8, 1.0])
    cable, _ = along(shape)
    set_lifted(cable, [1, 2, 3])
    assert captured(cable, shape) == {}
    np.testing.assert_allclose(cable.state.positions[:, 2], 1.0)
    # along the normal, 0.1 up is 0.02 inwards
    np.testing.assert_allclose(cable.state.positions[:, 0], [0.0, 0.52, 1.0, 1.48, 2.0])


@pytest.mark.parametrize(("depth", "touches"), [(0.5, False), (2.0, True)])
def test_rounding_does_not_touch(depth: float, touches: bool) -> None:
    shape = roof([0.0, depth * TOL.contact, 0.0])
    cable, at = along(shape)
    set_lifted(cable, [1, 2, 3])
    assert (at[1.0] in captured(cable, shape)) == touches


def test_it_touches_where_the_span_passes_but_off_the_vertices() -> None:
    """The span leads from y = 1/2 to y = 1, near the end of the last diagonal."""
    shape = roof([0.0, 1.0, 0.0])
    cable, at = along(shape)
    put(cable, "positions", -1, (2.0, 0.999, 0.0))
    set_lifted(cable, [1, 2, 3])
    places = captured(cable, shape)
    assert places[at[1.0]].fraction == pytest.approx(0.7495)
    touch(cable, places)
    np.testing.assert_allclose(cable.state.positions[at[1.0]], [1.0, 0.7495, 1.0])
    assert cable.state.fractions[at[1.0]] == pytest.approx(0.7495)
    put(cable, "positions", (0, 1), 0.001)
    put(cable, "positions", (-1, 1), 0.001)
    set_lifted(cable, [1, 2, 3])
    touch(cable, captured(cable, shape))
    assert cable.state.fractions[at[1.0]] == TOL.inside


# ---- draping -----------------------------------------------------------------------------------


def test_drape_over_two_ridges() -> None:
    shape = roof([0.0, 1.0, 0.0, 1.0, 0.0])
    cable, at = along(shape)
    drape(cable, shape)
    assert [x for x, k in at.items() if cable.state.lifted[k]] == [1.5, 2.0, 2.5]
    length = polyline_length(cable.state.positions[cable.contacts()])
    assert length == pytest.approx(2 * np.sqrt(2) + 2)
    np.testing.assert_allclose(cable.state.positions[at[2.0]], [2.0, 0.5, 1.0])


def test_drape_from_anchors_is_tangential() -> None:
    """From the ground one length off, the steep first part of the roof is passed."""
    shape = roof([0.0, 0.75, 1.0, 0.75, 0.0])
    cable, at = along(shape, (-1.0, 0.5, 0.0), (5.0, 0.5, 0.0))
    drape(cable, shape)
    assert [x for x, k in at.items() if cable.state.lifted[k]] == [0.0, 0.5, 3.5, 4.0]
    length = polyline_length(cable.state.positions[cable.contacts()])
    assert length == pytest.approx(2 * np.hypot(2.0, 0.75) + 2 * np.hypot(1.0, 0.25))


def test_drape_over_low_hills_between_high_ones() -> None:
    """The straight way between the high ridges passes over a low one, not over a middle one."""
    for middle, touches in ((0.9, False), (1.1, True)):
        shape = roof([0.0, 1.0, 0.0, middle, 0.0, 1.0, 0.0])
        cable, at = along(shape)
        drape(cable, shape)
        on = [x for x, k in at.items() if not cable.state.lifted[k]]
        assert on == [0.0, 0.5, 1.0, *([3.0] * touches), 5.0, 5.5, 6.0]
        length = polyline_length(cable.state.positions[cable.contacts()])
        top = 2 * np.hypot(2.0, 0.1) if touches else 4.0
        assert length == pytest.approx(2 * np.sqrt(2) + top)


def test_drape_depends_on_no_state() -> None:
    """Whatever touched before; a cable that is draped stays as it is."""
    shape = roof([0.0, 0.75, 1.0, 0.75, 0.0, 0.3, 0.0])
    anchors = (-1.0, 0.5, 0.0), (7.0, 0.5, 0.0)
    first, _ = along(shape, *anchors)
    drape(first, shape)
    assert 0 < first.state.lifted.sum() < len(first.state.nodes) - 2
    for seed in range(4):
        cable, _ = along(shape, *anchors)
        put(
            cable,
            "lifted",
            slice(1, -1),
            np.random.default_rng(seed).random(len(cable.state.nodes) - 2) < 0.5,
        )
        drape(cable, shape)
        found = [polyline_length(c.state.positions[c.contacts()]) for c in (cable, first)]
        assert found[0] == pytest.approx(found[1], rel=1e-6)  # TOL.contact
        before = cable.state.lifted.copy()
        drape(cable, shape)
        np.testing.assert_array_equal(cable.state.lifted, before)


# ---- one cable on another ----------------------------------------------------------------------


def crossed(z: float, apart: bool = False) -> tuple[Crossing, list[LaidCable], StripShape]:
    """Two cables that cross in a flat cell, anchored at z = 0 (lower) and at z (upper)."""
    shape = roof([0.0, 0.0])
    point = CellPoint((0, 1, 2), (0.25, 0.5, 0.25))
    place = np.array([0.5, 0.25, 0.0])
    crossing = Crossing(0, 1, (0, 1, 2), (0, 0), place, (), apart)
    cables = []
    for way in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        ends = [place - way, place + way]
        if len(cables) == 1:
            ends = [end + z * UP for end in ends]
        node = CableNode("crossing", point, 0)
        cable = cable_on(shape, [] if apart else [node], ends)
        if not apart:
            put(cable, "positions", 1, place)
        cables.append(cable)
    return crossing, cables, shape


@pytest.mark.parametrize(("z", "expected"), [(0.5, True), (-0.5, False), (0.0, False)])
def test_the_upper_cable_leaves_the_lower_one_that_it_would_pull_up(
    z: float, expected: bool
) -> None:
    crossing, cables, shape = crossed(z)
    lines = Polylines.of(cables)
    assert (parting([crossing], lines, shape) == {0}) is expected
    assert joining([crossing], lines, shape, np.zeros(2, dtype=bool)) == set()
    assert parting([replace(crossing, separated=True)], lines, shape) == set()


@pytest.mark.parametrize(("z", "expected"), [(0.5, False), (-0.5, True), (0.0, False)])
def test_the_upper_cable_does_not_run_through_the_lower_one(z: float, expected: bool) -> None:
    crossing, cables, shape = crossed(z, apart=True)
    lines = Polylines.of(cables)
    assert (joining([crossing], lines, shape, np.zeros(2, dtype=bool)) == {0}) is expected
    assert (
        joining([replace(crossing, separated=False)], lines, shape, np.zeros(2, dtype=bool))
        == set()
    )


def link_at(cable: LaidCable, k: int) -> Array:
    """The straight part of the second of two cables after its node k."""
    lines = Polylines.of(
        [cable_on(roof([0.0, 0.0]), [], [(0.0, 0.0, 0.0), (1.0, 1.0, 0.0)]), cable]
    )
    return lines.straight_parts(np.array([1]), np.array([k]))[0]


def test_links_count_no_crossings_and_pass_what_is_lifted() -> None:
    cable, _ = along(roof([0.0] * 4))
    x = cable.state.positions
    for k, (a, b) in ((2, (2, 3)), (0, (0, 1))):
        np.testing.assert_array_equal(link_at(cable, k), x[[a, b]])
    set_lifted(cable, [2, 3])
    np.testing.assert_array_equal(link_at(cable, 2), x[[1, 4]])
    nodes = list(cable.state.nodes)
    nodes.insert(2, CableNode("crossing", CellPoint((0, 1, 4), (0.2, 0.3, 0.5))))
    cable.set_nodes(
        nodes,
        np.insert(x, 2, 0.0, axis=0),
        np.insert(cable.state.fractions, 2, np.nan),
        np.zeros(8, bool),
    )
    # node 1 is at 1, the crossing at 2, and the second to follow at 3
    np.testing.assert_array_equal(link_at(cable, 1), cable.state.positions[[1, 3]])
    np.testing.assert_array_equal(link_at(cable, 2), cable.state.positions[[3, 4]])
