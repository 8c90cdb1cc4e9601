"""Corridors: which vertices a path visits and which edges it crosses, without where.

A corridor is the tuple of the supports of a path's points: a vertex (a,), an edge (a, b), or,
at its ends, a cell (a, b, c). It is pure combinatorics, so two paths through the same corridor
have the same taut string.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise

from crms_fenicsx.cables.intrinsic import Edge
from crms_fenicsx.cables.path import SurfacePoint

Support = tuple[int, ...]
Corridor = tuple[Support, ...]


def corridor(points: Sequence[SurfacePoint]) -> Corridor:
    """Return the combinatorial identity of a path: the supports of its points."""
    return tuple(point.support for point in points)


def cell_between(a: Support, b: Support) -> Support:
    """Return the vertices of the cell through which a path goes from a to b, ascending.

    Two vertices where it follows an edge.
    """
    return tuple(sorted({*a, *b}))


def without_detours(supports: Sequence[Support]) -> Corridor:
    """Return a corridor without its detours; both ends stay.

    What goes: an edge that is crossed to and fro, a visit from which the path turns straight
    back, and an edge crossed next to a visit to one of its vertices.
    """
    kept: list[Support] = []
    for i, new in enumerate(supports):
        _append(kept, new, last=i == len(supports) - 1)
    return tuple(kept)


def _append(kept: list[Support], new: Support, *, last: bool) -> None:
    """Append a support to a corridor without detours, and keep it so."""
    while kept:
        top, only = kept[-1], len(kept) == 1
        if top == new:
            if only and last:
                break
            if not only and len(top) == 2 and not last:
                kept.pop()  # crossed to and fro: both go
                return
            if not last:
                return
            kept.pop()
        elif len(top) == 1 and len(new) == 2 and top[0] in new and not last:
            return
        elif len(top) == 2 and len(new) == 1 and new[0] in top and not only:
            kept.pop()
        elif not only and cell_between(kept[-2], top) == cell_between(top, new):
            kept.pop()
        else:
            break
    kept.append(new)


def flaw(supports: Corridor, thirds: Callable[[Edge], tuple[int, ...]]) -> str | None:
    """Say why no cable can follow a corridor; None if one can.

    Parameters
    ----------
    supports
        A corridor in which consecutive supports share a cell.
    thirds
        Vertices opposite to an edge; see `Surface.thirds`.

    Returns
    -------
    What is wrong: points that share an edge without both being vertices; a vertex visited, an
    edge crossed or followed, or a cell entered twice; a cell with points on all three edges.
    Both ends may lie on one vertex or edge, as those of a hoop do.
    """
    if len(supports) < 2:
        return "nothing of it is left between its ends"
    links = [cell_between(a, b) for a, b in pairwise(supports)]
    for (a, b), link in zip(pairwise(supports), links, strict=True):
        if len(link) == 1 or (len(link) == 2 and len(a) + len(b) != 2):
            return f"it goes along one edge from {a} to {b}"
    hoop = supports[0] == supports[-1] and len(supports[0]) < 3
    visited = supports[1:] if hoop else supports
    passed = [s for s in visited if len(s) < 3] + links
    again = next((s for s, n in Counter(passed).items() if n > 1), None)
    if again is not None:
        return f"it uses {again} twice"
    # a cell that is entered once has at most two points on its edges, unless one is an end
    edges = {s for s in supports if len(s) == 2}
    for end in {s for s in (supports[0], supports[-1]) if len(s) == 2}:
        for third in thirds((end[0], end[1])):
            cell = (*end, third)
            sides = [tuple(sorted(set(cell) - {v})) for v in cell]
            if edges.issuperset(sides):
                return f"it has points on all edges of cell {tuple(sorted(cell))}"
    return None
