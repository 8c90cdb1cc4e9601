"""Sheets: drawings of pieces with seam and cut lines, match marks and names, laid on the roll."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from crms_fenicsx.design.patterns.pattern import FlatPiece, Pattern
from crms_fenicsx.design.patterns.pieces import PieceEdge
from crms_fenicsx.design.patterns.strip_layout import usable_width
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Finite, NonNegative, Positive, checked
from crms_fenicsx.foundation.runtime.arrays import Array, floats, ints
from crms_fenicsx.foundation.runtime.errors import InputError

SHARP = 3.0
"""Mitre limit relative to the larger allowance; sharper corners of the cut line are bevelled."""


@checked
@dataclass(frozen=True)
class Sheet:
    """Options for cutting pieces from the roll.

    Parameters
    ----------
    roll
        Width of the roll (length).
    allowance
        Allowance on each side of a seam (length), half the width of the weld.
    rim
        Allowance at all other edges (length).
    edges
        Other allowances by names of seams and edge groups (length).
    marks
        Spacing of match marks along seams, from the seam's start on the form (length).
    gap
        Gap between pieces on the roll (length).

    Raises
    ------
    InputError
        A roll narrower than twice the allowance, or an invalid length.

    Examples
    --------
    >>> sheet = patterns.Sheet(roll=3.0, allowance=0.02, rim=0.05, edges={"front": 0.1})
    """

    roll: Positive
    allowance: Finite = 0.0
    rim: NonNegative = 0.0
    edges: Mapping[str, float] = field(default_factory=dict)
    marks: Positive = 1.0
    gap: NonNegative = 0.0

    def __post_init__(self) -> None:
        usable_width("Sheet", self.roll, self.allowance)
        for name, allowance in self.edges.items():
            checks.non_negative(f"Sheet: edges: {name}", allowance)

    def of(self, edge: PieceEdge) -> float:
        """Allowance at an edge (length)."""
        return float(self.edges.get(edge.name, self.allowance if edge.sewn else self.rim))


@dataclass(frozen=True)
class Drawing:
    """The lines of a flat piece (length), x along the warp."""

    name: str
    seam_line: Array  # (n, 2) closed: the stress-free shape
    cut_line: Array  # (k, 2) closed, with allowances
    overlaps: tuple[Array, ...]  # ends of the adjacent pieces' allowances
    # match marks: number along the seam, from 1, and a line (2, 2) from the seam to the cut line
    marks: tuple[tuple[int, Array], ...]
    warp: Array  # (2, 2) from tail to tip
    names: tuple[tuple[str, Array, float], ...]  # of edges: position (2,) and angle (degrees)

    def moved(self, by: Array) -> Drawing:
        """The drawing moved by a vector (2,)."""
        return Drawing(
            self.name, self.seam_line + by, self.cut_line + by,
            tuple(line + by for line in self.overlaps),
            tuple((number, line + by) for number, line in self.marks), self.warp + by,
            tuple((name, at + by, angle) for name, at, angle in self.names),
        )  # fmt: skip

    @property
    def extent(self) -> Array:
        """Length and width (2,) required of the roll."""
        return np.asarray(np.ptp(self.cut_line, axis=0))


def drawings(pattern: Pattern, sheet: Sheet) -> list[Drawing]:
    """Drawings of all pieces, each with its lower left corner at the origin."""
    known = {edge.name for one in pattern.flat for edge in one.piece.edges}
    for name in sheet.edges:
        checks.named("edge of a piece", dict.fromkeys(known), name)
    stations = _stations(pattern)
    found = [_drawing(one, sheet, stations) for one in pattern.flat]
    return [one.moved(-one.cut_line.min(axis=0)) for one in found]


def _stations(pattern: Pattern) -> dict[tuple[int, int], tuple[float, float]]:
    """Arc lengths along the seam at both ends of each segment, by its vertices in either order."""
    points, found = pattern.pieces.surface.points, dict[tuple[int, int], tuple[float, float]]()
    for line in pattern.pieces.lines.values():
        along = floats(arc_lengths(points[line]))
        ends = zip(pairwise(ints(line)), pairwise(along), strict=True)
        for (a, b), (s, t) in ends:
            found[a, b], found[b, a] = (s, t), (t, s)
    return found


def _drawing(
    one: FlatPiece, sheet: Sheet, stations: Mapping[tuple[int, int], tuple[float, float]]
) -> Drawing:
    shape, edges = one.shape, one.piece.edges
    outline = shape[one.piece.outline]
    distances = np.concatenate([np.full(len(e.vertices) - 1, sheet.of(e)) for e in edges])
    overlaps, marks, names = [], [], []
    for edge in edges:
        run, width = shape[edge.vertices], sheet.of(edge)
        normals = _normals(run)
        quarter = len(normals) // (4 if edge.sewn else 2)  # beside the piece's own name
        side = run[quarter + 1] - run[quarter]
        middle = (run[quarter] + run[quarter + 1]) / 2
        angle = float(np.degrees(np.arctan2(side[1], side[0])))
        angle = (angle + 90.0) % 180.0 - 90.0  # not upside down
        inward = middle - normals[quarter] * (width + 0.12 * one.width)
        names.append((edge.name, inward, angle))
        if not edge.sewn:
            continue
        if width > 0.0:
            overlaps.append(offset(run, np.full(len(normals), -width), closed=False))
        tick = max(width, 0.01 * one.width)
        ids = ints(one.piece.vertices[edge.vertices])
        for k, (a, b) in enumerate(pairwise(ids)):
            s, t = stations[a, b]
            first = int(np.ceil(min(s, t) / sheet.marks - 1e-9))
            while (at := first * sheet.marks) < max(s, t) * (1 - 1e-12):
                if first > 0 and at >= min(s, t):
                    place = run[k] + (at - s) / (t - s) * (run[k + 1] - run[k])
                    marks.append((first, np.stack([place, place + tick * normals[k]])))
                first += 1
    middle = outline.mean(axis=0)
    arrow = np.array([0.15 * one.length, 0.0])
    return Drawing(
        one.name, outline, offset(outline, distances, closed=True), tuple(overlaps), tuple(marks),
        np.stack([middle - arrow, middle + arrow]), tuple(names),
    )  # fmt: skip


def _normals(run: Array) -> Array:
    """Unit normals (n - 1, 2) to the right of a polyline (n, 2), outward around a piece."""
    side = np.diff(run, axis=0)
    side /= np.hypot(side[:, 0], side[:, 1])[:, None]
    return np.stack([side[:, 1], -side[:, 0]], axis=1)


def offset(line: Array, distances: Array, closed: bool) -> Array:
    """A polyline (n, 2) offset to its right, each segment by its own distance."""
    ring = np.concatenate([line, line[:1]]) if closed else line
    normals = _normals(ring)
    found: list[Array] = [] if closed else [line[0] + distances[0] * normals[0]]
    for k in range(0 if closed else 1, len(normals)):
        d, n = distances[[k - 1, k]], normals[[k - 1, k]]
        beside = [ring[k] + d[i] * n[i] for i in (0, 1)]
        sine = n[0, 0] * n[1, 1] - n[0, 1] * n[1, 0]
        if abs(sine) > 1e-9:
            corner = np.linalg.solve(n, d)
            if np.hypot(*corner) <= SHARP * np.abs(d).max():
                beside = [ring[k] + corner]
        elif d[0] == d[1]:
            beside = beside[:1]
        found += beside
    if not closed:
        found.append(line[-1] + distances[-1] * normals[-1])
    return np.array(found)


@dataclass(frozen=True)
class Nesting:
    """Layout of pieces on the roll, x along it.

    Attributes
    ----------
    roll
        Width of the roll (length).
    length
        Used length of the roll (length).
    waste
        Share of the used roll outside of pieces and their allowances.
    drawings
        Drawings of the pieces in place.
    rows
        Starts, along the roll, of the rows of pieces across it.
    """

    roll: float
    length: float
    waste: float
    drawings: tuple[Drawing, ...] = field(repr=False)
    rows: tuple[float, ...] = field(repr=False)


@checked
def nest(pattern: Pattern, sheet: Sheet) -> Nesting:
    """Lay pieces on the roll, warp along it, the longest first.

    Pieces lie side by side as far as the roll is wide; the next row starts beyond the longest.

    Parameters
    ----------
    pattern
        The pattern.
    sheet
        Roll and allowances.

    Returns
    -------
    Nesting
        The layout and its waste.

    Raises
    ------
    InputError
        A piece wider than the roll, or allowances of unknown edges.

    Examples
    --------
    >>> layout = patterns.nest(pattern, sheet)
    >>> round(layout.length, 1), round(layout.waste, 2)
    (12.2, 0.14)
    """
    pieces = drawings(pattern, sheet)
    wide = [one for one in pieces if one.extent[1] > sheet.roll * (1.0 + 1e-9)]
    if wide:
        told = ", ".join(f"{one.name} ({one.extent[1]:.5g})" for one in wide)
        raise InputError(
            f"nest: wider than the roll of {sheet.roll:.5g} with their allowances: {told}; lay "
            "narrower strips, or use a wider roll."
        )
    placed: dict[str, Drawing] = {}
    rows: list[list[float]] = []  # start, and width used
    length = 0.0
    for one in sorted(pieces, key=lambda one: -one.extent[0]):
        along, across = map(float, one.extent)
        row = next((row for row in rows if row[1] + across <= sheet.roll * (1.0 + 1e-9)), None)
        if row is None:
            row = [length + sheet.gap * bool(rows), 0.0]
            rows.append(row)
            length = row[0] + along
        placed[one.name] = one.moved(np.array(row))
        row[1] += across + sheet.gap
    outlines = [one.cut_line.T for one in pieces]
    used = sum(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2 for x, y in outlines)
    waste = 1.0 - used / (sheet.roll * length)
    ordered = tuple(placed[one.name] for one in pieces)
    return Nesting(sheet.roll, length, waste, ordered, tuple(row[0] for row in rows))
