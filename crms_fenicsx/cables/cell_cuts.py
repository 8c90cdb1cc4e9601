"""How the cables in tension cut this rank's cells: along chords, into polygons."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence

from crms_fenicsx.cables.numbering import CableNumbering, Corner
from crms_fenicsx.model.crossing import NodeId
from crms_fenicsx.surface.points import Edge
from crms_fenicsx.surface.polygons import split_polygon


def pieces(
    numbering: CableNumbering, number: Callable[[Corner], int]
) -> list[tuple[int, list[int]]]:
    """Polygons into which the cables in tension cut this rank's folded cells.

    Parameters
    ----------
    numbering
        The cables.
    number
        Gives the number of a corner in the caller's arrays.

    Returns
    -------
    list of (cell, polygon)
        Local cell number, and corners in the membrane's orientation, by number. Points on
        sides that no chord leaves are corners too.
    """
    chords = chords_by_row(numbering)

    def line(edge: Edge) -> list[int]:
        inner = (number((c, k)) for _, c, k in numbering.on_edge.get(edge, []))
        return [number(edge[0]), *inner, number(edge[1])]

    pieces = []
    for row in folded_rows(numbering):
        own = [[number(numbering.corner(*k)) for k in chord] for chord in chords.get(row, [])]
        cell = int(numbering.strip.local[row])
        pieces += [(cell, polygon) for polygon in cut(numbering, row, line, own)]
    return pieces


def chords_by_row(numbering: CableNumbering) -> dict[int, list[list[NodeId]]]:
    """Chords through the inside of this rank's cells, by row: nodes from rim to rim.

    Between its two ends a chord has the crossings on it.
    """
    chords: dict[int, list[list[NodeId]]] = defaultdict(list)
    for c, k, m, on in numbering.links:
        if numbering.cables[c].taut and on is not None and len(on) == 3:
            row = numbering.strip.rows(on)[0]
            if numbering.strip.owners[row] == numbering.rank:
                if chords[row] and chords[row][-1][-1] == (c, k):
                    chords[row][-1].append((c, m))
                else:
                    chords[row].append([(c, k), (c, m)])
    return chords


def folded_rows(numbering: CableNumbering) -> list[int]:
    """Rows of this rank's cells with points on a side."""
    strip = numbering.strip
    rows = {row for edge in numbering.on_edge for row in strip.rows(edge)}
    return sorted(row for row in rows if strip.owners[row] == numbering.rank)


def cut(
    numbering: CableNumbering,
    row: int,
    line: Callable[[Edge], list[int]],
    chords: Sequence[Sequence[int]],
) -> list[list[int]]:
    """Polygons of one cell; `line` gives the corners along an edge."""
    around: list[int] = []
    for edge, forward in numbering.strip.sides[row]:
        around += line(edge)[:-1] if forward else line(edge)[:0:-1]
    return split_polygon(around, chords)
