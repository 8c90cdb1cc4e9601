"""Corridors: the vertices a path visits and the edges it crosses, without positions.

A corridor is the tuple of the supports of a path's points: a vertex (a,), an edge (a, b), or, at
its ends, a cell (a, b, c). It is purely combinatorial: two paths through the same corridor have the
same taut string.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from itertools import pairwise

from crms_fenicsx.foundation.surface.points import Edge, Support, SurfacePoint

Corridor = tuple[Support, ...]


def corridor(points: Sequence[SurfacePoint]) -> Corridor:
    """Supports of a path's points."""
    return tuple(point.support for point in points)


def cell_between(a: Support, b: Support) -> Support:
    """Sorted vertices of the cell or edge through which a path goes from a to b."""
    return tuple(sorted({*a, *b}))


def without_detours(supports: Sequence[Support]) -> Corridor:
    """Simplify a corridor between its ends: remove edges crossed back and forth, vertices where the
    path turns straight back, and edges crossed next to a visit of one of their vertices."""
    kept: list[Support] = []
    for i, new in enumerate(supports):
        _append(kept, new, last=i == len(supports) - 1)
    return tuple(kept)


def _append(kept: list[Support], new: Support, *, last: bool) -> None:
    """Append a support to a simplified corridor, and simplify it again."""
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
        elif not only and _turns_back(kept[-2], top, new):
            kept.pop()
        else:
            break
    kept.append(new)


def _turns_back(a: Support, b: Support, c: Support) -> bool:
    """Whether a path from a to b continues to c through the cell or edge it came from."""
    there, back = cell_between(a, b), cell_between(b, c)
    if _along_edge(a, b):
        return set(there) <= set(back)
    return set(back) <= set(there) if _along_edge(c, b) else there == back


def _along_edge(end: Support, vertex: Support) -> bool:
    """Whether the link between two supports runs along an edge."""
    return len(end) == 2 and len(vertex) == 1 and vertex[0] in end


def snap_ends(supports: Corridor, opposite_vertices: Callable[[Edge], tuple[int, ...]]) -> Corridor:
    """Move each end on an edge that the corridor follows into a cell beside it, if possible not the
    one through which the path continues."""
    result = list(supports)
    for i, step in ((0, 1), (-1, -1)):
        if _along_edge(supports[i], supports[i + step]):
            a, b = supports[i]
            cells = sorted(tuple(sorted((a, b, c))) for c in opposite_vertices((a, b)))
            if len(supports) > 2:
                onward = cell_between(supports[i + step], supports[i + 2 * step])
                cells.sort(key=onward.__eq__)
            result[i] = cells[0]
    return tuple(result)


def why_invalid(
    supports: Corridor, opposite_vertices: Callable[[Edge], tuple[int, ...]]
) -> str | None:
    """Why no cable can follow a corridor; None if one can."""
    if len(supports) < 2:
        return "nothing of it is left between its ends"
    links = [cell_between(a, b) for a, b in pairwise(supports)]
    if len(links) == 1 and supports[0] == supports[1] and len(links[0]) < 3:
        return f"both of its ends lie on {links[0]}"
    # the two ends of a hoop, a closed loop, may lie on the same vertex or edge
    hoop = supports[0] == supports[-1] and len(supports[0]) < 3
    visited = supports[1:] if hoop else supports
    partly = {s for s in (supports[0], supports[-1]) if len(s) == 2}
    passed = [s for s in visited if len(s) < 3] + [link for link in links if link not in partly]
    again = next((s for s, n in Counter(passed).items() if n > 1), None)
    if again is not None:
        return f"it uses {again} twice"
    # a cell entered once has at most two points on its edges, unless one is an end
    edges = {s for s in supports if len(s) == 2}
    for end in partly:
        for third in opposite_vertices((end[0], end[1])):
            cell = (*end, third)
            sides = [tuple(sorted(set(cell) - {v})) for v in cell]
            if edges.issuperset(sides):
                return f"it has points on all edges of cell {tuple(sorted(cell))}"
    return None
