"""Nesting: pieces laid on the roll, in rows across it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from crms_fenicsx.design.patterns.pattern import Pattern
from crms_fenicsx.design.patterns.sheet import Drawing, Sheet, drawings
from crms_fenicsx.foundation.runtime.errors import InputError


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
    """
    if not isinstance(pattern, Pattern) or not isinstance(sheet, Sheet):
        raise InputError("nest: give a pattern of patterns.flatten and a Sheet(roll=...).")
    pieces = drawings(pattern, sheet)
    wide = [one for one in pieces if one.extent[1] > sheet.roll * (1.0 + 1e-9)]
    if wide:
        told = ", ".join(f"{one.name} ({one.extent[1]:.5g})" for one in wide)
        raise InputError(
            f"nest: wider than the roll of {sheet.roll:.5g} with their allowances: {told}; lay "
            "narrower strips, or take a wider roll."
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
    waste = 1.0 - sum(_area(one) for one in pieces) / (sheet.roll * length)
    ordered = tuple(placed[one.name] for one in pieces)
    return Nesting(sheet.roll, length, waste, ordered, tuple(row[0] for row in rows))


def _area(one: Drawing) -> float:
    """Area enclosed by the cut line (length squared)."""
    x, y = one.cut_line.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
