"""Typed points, the checks of a path, cancelled detours and crossing cables."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import Delaunay

from crms_fenicsx.cables.path import (
    AcrossCell,
    AlongEdge,
    CellPoint,
    EdgePoint,
    Meeting,
    Path,
    VertexPoint,
    chords_cross,
    without_backtracking,
)
from crms_fenicsx.cables.trace import trace
from crms_fenicsx.errors import PathError

# 6 - 7 - 8      squares cut from the lower left to the upper right
# 3 - 4 - 5
# 0 - 1 - 2
CELLS = np.array(
    [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [3, 4, 7], [3, 7, 6], [4, 5, 8], [4, 8, 7]]
)
POINTS = np.array([[i % 3, i // 3, 0.0] for i in range(9)])
V = VertexPoint


def edge(a, b, fraction=0.5):
    return EdgePoint((a, b), fraction)


def test_points_keep_one_form():
    assert CellPoint((7, 2, 4), (0.5, 0.2, 0.3)) == CellPoint((2, 4, 7), (0.2, 0.3, 0.5))
    assert edge(np.int64(1), np.int64(4)).support == (1, 4)
    assert V(3).support == (3,)
    assert hash(Path((V(0), V(1)), start_anchor=np.zeros(3))) is not None


@pytest.mark.parametrize(
    "make",
    [
        lambda: V(-1),
        lambda: edge(4, 1),
        lambda: edge(1, 1),
        lambda: edge(1, 4, 0.0),
        lambda: edge(1, 4, 1.0),
        lambda: edge(1, 4, float("nan")),
        lambda: CellPoint((1, 1, 4), (0.2, 0.3, 0.5)),
        lambda: CellPoint((0, 1, 4), (0.2, 0.3, 0.6)),
        lambda: CellPoint((0, 1, 4), (-0.2, 0.6, 0.6)),
        lambda: CellPoint((0, 1, 4), (float("nan"), 0.6, 0.4)),
        lambda: Path((V(0),)),
        lambda: Path((V(0), CellPoint((0, 1, 4), (0.2, 0.3, 0.5)), V(1))),
        lambda: Path((V(0), V(1)), start_anchor=(0.0, 1.0)),
        lambda: Path((V(0), V(1)), end_anchor=(0.0, 1.0, float("inf"))),
    ],
)
def test_bad_points_and_paths_are_refused(make):
    with pytest.raises(PathError):
        make()


def test_links_say_the_way():
    path = Path((CellPoint((0, 3, 4), (0.2, 0.5, 0.3)), edge(0, 4), edge(1, 4), V(5), V(8)))
    assert path.links(CELLS) == (
        AcrossCell(1),
        AcrossCell(0),
        AcrossCell(3),
        AlongEdge((5, 8)),
    )
    assert path.links(CELLS[::-1])[0] == AcrossCell(6)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ((V(0), V(8)), "no cell"),
        ((V(1), V(3)), "no cell"),
        ((edge(0, 1), edge(4, 5)), "no cell"),
        ((V(2), edge(0, 4)), "no cell"),
        ((V(0), edge(0, 1)), "one edge"),
        ((edge(0, 4, 0.2), edge(0, 4, 0.7)), "one edge"),
        ((V(0), V(0)), "same point"),
        ((V(0), V(1), V(0)), "turns back"),
        ((edge(0, 1), edge(1, 4), edge(0, 4)), "turns back"),
        ((edge(1, 4, 0.2), V(0), edge(1, 4, 0.7)), "turns back"),
    ],
)
def test_links_refuse_what_is_no_way(points, words):
    with pytest.raises(PathError, match=words):
        Path(points).links(CELLS)


def test_positions_and_anchors():
    path = Path((CellPoint((0, 3, 4), (0.2, 0.5, 0.3)), edge(0, 4, 0.25), V(1)))
    order = np.random.default_rng(0).permutation(9)
    x = path.positions(order, POINTS[order])
    assert np.allclose(x, [[0.3, 0.8, 0], [0.25, 0.25, 0], [1, 0, 0]])
    with pytest.raises(PathError, match="vertex 4"):
        path.positions(np.arange(4), POINTS[:4])
    anchored = path.with_anchors(start=np.array([0, 0, 2.0]))
    assert anchored.start_anchor == (0.0, 0.0, 2.0) and anchored.end_anchor is None
    assert anchored.with_anchors(end=(1, 1, 1)).start_anchor == (0.0, 0.0, 2.0)


@pytest.mark.parametrize(
    ("points", "kept"),
    [
        # in and out through one edge, twice over
        (
            [
                edge(0, 3),
                edge(0, 4, 0.4),
                edge(1, 4, 0.5),
                edge(1, 4, 0.7),
                edge(0, 4, 0.6),
                edge(3, 4),
            ],
            [edge(0, 3), edge(3, 4)],
        ),
        ([V(0), V(1), V(1), V(2)], [V(0), V(1), V(2)]),
        ([V(0), V(1), V(0), V(3)], [V(0), V(3)]),
        ([V(3), edge(0, 4), V(1), edge(0, 4, 0.7), V(3), V(6)], [V(3), V(6)]),
        ([edge(0, 1), edge(0, 4), edge(0, 4, 0.6), V(1), V(2)], [edge(0, 1), V(1), V(2)]),
        ([V(0), V(1), V(0)], [V(0)]),
        # along an edge to a point inside it, then on from there
        ([V(0), edge(0, 4), edge(3, 4)], [V(0), edge(3, 4)]),
    ],
)
def test_detours_cancel(points, kept):
    found = without_backtracking(points, CELLS)
    if kept == [edge(0, 1), V(1), V(2)]:  # its end runs along its own edge: tied in a cell there
        assert found == (CellPoint((0, 1, 4), (0.5, 0.5, 0.0)), V(1), V(2))
    else:
        assert found == tuple(kept)
    if len(found) > 1:
        Path(found).links(CELLS)


def test_an_end_inside_an_edge_that_the_path_follows():
    for points in (
        [V(4), edge(4, 8, 0.3)],
        [V(0), V(4), edge(4, 8, 0.3)],
        [edge(0, 4), V(4), edge(4, 8, 0.3)],
    ):
        found = Path(without_backtracking(points, CELLS))
        found.links(CELLS)
        straight = found.positions(np.arange(9), POINTS)
        assert np.allclose(straight[-1], [1.3, 1.3, 0])
        back = Path(without_backtracking(points[::-1], CELLS))
        assert np.allclose(back.positions(np.arange(9), POINTS), straight[::-1])
    both = without_backtracking([edge(0, 4, 0.25), edge(0, 4, 0.75)], CELLS)
    assert [p.support for p in both] == [(0, 1, 4)] * 2
    Path(both).links(CELLS)


def segments_cross(p, q, r, s):
    """Say, in rational arithmetic, whether two plane segments properly cross."""

    def side(a, b, c):
        return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])

    return side(p, q, r) * side(p, q, s) < 0 and side(r, s, p) * side(r, s, q) < 0


def test_crossings_agree_with_exact_geometry():
    rng = np.random.default_rng(4)
    counted = 0
    for _ in range(120):
        xy = np.vstack([rng.uniform(0, 10, (25, 2)), [[0, 0], [0, 10], [10, 0], [10, 10]]])
        points = np.column_stack([xy, np.zeros(len(xy))])
        cells = Delaunay(xy).simplices.astype(np.int64)
        ids = np.arange(len(xy))
        a, b = (trace(ids, points, cells, rng.uniform(0, 10, (3, 2))) for _ in range(2))
        found = chords_cross(a, b, cells)
        exact = [
            [tuple(Fraction(float(c)) for c in x) for x in path.positions(ids, points)[:, :2]]
            for path in (a, b)
        ]
        expected = sorted(
            link.cell
            for link, chord in zip(a.links(cells), pairwise(exact[0]), strict=True)
            for other, cut in zip(b.links(cells), pairwise(exact[1]), strict=True)
            if link == other and isinstance(link, AcrossCell) and segments_cross(*chord, *cut)
        )
        assert sorted(m.cell for m in found) == expected
        assert all(m.at is None for m in found)
        swapped = chords_cross(b, a, cells)
        assert sorted(m.cell for m in swapped) == expected
        counted += len(expected)
    assert counted > 40


def test_cables_that_touch_say_where():
    slant = Path((edge(0, 3), edge(0, 4), edge(1, 4), V(5)))
    assert chords_cross(slant, Path((V(3), edge(0, 4, 0.5), V(1))), CELLS) == [
        Meeting(None, edge(0, 4, 0.5))
    ]
    assert chords_cross(slant, Path((V(2), V(5), V(8))), CELLS) == [Meeting(None, V(5))]
    # one follows the edge that the other crosses
    assert chords_cross(slant, Path((V(1), V(4))), CELLS) == [Meeting(None, edge(1, 4))]
    assert chords_cross(Path((V(1), V(4))), slant, CELLS) == [Meeting(None, edge(1, 4))]
    # ends inside the cell: short of the other, across it, on it
    line = Path((V(0), edge(1, 4)))
    for weight, expected in ((0.1, [Meeting(0, None)]), (0.6, [])):
        end = CellPoint((0, 1, 4), (0.4, (1 - weight) * 0.6, weight * 0.6))
        assert chords_cross(Path((V(4), end)), line, CELLS) == expected
    end = CellPoint((0, 1, 4), (0.5, 0.25, 0.25))
    assert chords_cross(Path((V(4), end)), line, CELLS) == [Meeting(0, end)]
    # side by side, and nowhere near
    assert chords_cross(slant, Path((V(3), V(4), V(8))), CELLS) == []
    assert chords_cross(slant, Path((V(6), V(7))), CELLS) == []
