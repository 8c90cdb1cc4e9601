"""Typed points, the checks of a path, cancelled detours and crossing cables."""

from __future__ import annotations

import numpy as np
import pytest

from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.path import Path, without_backtracking
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint, VertexPoint

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
    assert path.links(CELLS) == ((0, 3, 4), (0, 1, 4), (1, 4, 5), (5, 8))
    assert path.links(CELLS[::-1]) == path.links(CELLS)


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


def test_positions():
    path = Path((CellPoint((0, 3, 4), (0.2, 0.5, 0.3)), edge(0, 4, 0.25), V(1)))
    order = np.random.default_rng(0).permutation(9)
    x = path.positions(order, POINTS[order])
    assert np.allclose(x, [[0.3, 0.8, 0], [0.25, 0.25, 0], [1, 0, 0]])
    with pytest.raises(PathError, match="vertex 4"):
        path.positions(np.arange(4), POINTS[:4])


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
