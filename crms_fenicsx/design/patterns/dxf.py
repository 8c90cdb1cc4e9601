"""Cutting patterns as DXF files, for plotters and cutters."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from crms_fenicsx.design.patterns.nesting import Nesting, nest
from crms_fenicsx.design.patterns.pattern import Pattern
from crms_fenicsx.design.patterns.sheet import Drawing, Sheet
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, collective, raised_together
from crms_fenicsx.foundation.runtime.files import (
    DXF_UNITS,
    absolute,
    make_writable,
    new_drawing,
    replaced,
)

LAYERS = {"CUT": 1, "SEAM": 5, "OVERLAP": 8, "MARK": 3, "WARP": 6, "TEXT": 7, "ROLL": 9}
"""DXF layers and their colour numbers."""
TEXT = 0.04
"""Height of piece names relative to the roll's width; other texts are smaller."""


@collective
def write_dxf(pattern: Pattern, filename: str | Path, sheet: Sheet, *, unit: str = "m") -> None:
    """Write the layout on the roll to a DXF file. Collective.

    Layers: CUT, the cutting line with allowances; SEAM, seam lines; OVERLAP, the end of the other
    piece's allowance; MARK, numbered match marks; WARP, arrows; TEXT, names of pieces and edges;
    ROLL. Needs ezdxf.

    Parameters
    ----------
    pattern
        The pattern.
    filename
        File ending in .dxf; an existing one is replaced once the new one is complete.
    sheet
        Roll, allowances and marks.
    unit
        Unit of length of the pattern: "mm", "cm", "m", "in" or "ft".

    Raises
    ------
    InputError
        On all ranks, with nothing written: an invalid argument, pieces wider than the roll, or a
        file that cannot be written.
    ImportError
        On all ranks: ezdxf is not installed.
    """
    if not isinstance(pattern, Pattern):
        raise InputError(f"write_dxf: pattern = {pattern!r}; give what patterns.flatten returned.")
    comm = pattern.comm
    checks.same(comm, "write_dxf", filename=filename, sheet=sheet, unit=unit)
    checks.one_of("write_dxf: unit", unit, DXF_UNITS)
    path = absolute(checks.file("write_dxf: filename", filename), comm)
    if path.suffix.lower() != ".dxf":
        raise InputError(f"write_dxf: filename = {str(path)!r}; give one with .dxf.")
    nesting = nest(pattern, sheet)
    with raised_together(comm):
        if comm.rank == 0:
            document = _document(nesting, unit)
            make_writable(path.parent)
            with replaced(path) as partial:
                document.saveas(partial)


def _document(nesting: Nesting, unit: str) -> Any:
    """The drawing, an ezdxf document."""
    document = new_drawing("write_dxf", unit, "draw the sheets as SVG")
    for name, colour in LAYERS.items():
        document.layers.add(name, color=colour)
    space = document.modelspace()
    corners = [(0, 0), (nesting.length, 0), (nesting.length, nesting.roll), (0, nesting.roll)]
    _polyline(space, corners, "ROLL", closed=True)
    for one in nesting.drawings:
        _draw(space, one, TEXT * nesting.roll)
    return document


def _draw(space: Any, one: Drawing, height: float) -> None:
    """Add a piece to the drawing."""
    _polyline(space, one.cut_line, "CUT", closed=True)
    _polyline(space, one.seam_line, "SEAM", closed=True)
    for line in one.overlaps:
        _polyline(space, line, "OVERLAP")
    for mark in one.marks:
        space.add_line(*mark.line.tolist(), dxfattribs={"layer": "MARK"})
        tick = mark.line[1] - mark.line[0]
        inner = mark.line[0] - tick * (1.0 + 0.4 * height / np.hypot(*tick))  # beside the overlap
        _text(space, str(mark.number), inner, 0.0, 0.35 * height, "MARK")
    tail, tip = one.warp
    head = 0.04 * (tip - tail)
    across = head[::-1] * (-1.0, 1.0)
    space.add_line(tail.tolist(), tip.tolist(), dxfattribs={"layer": "WARP"})
    barbs = [tip - 2.0 * head + across, tip, tip - 2.0 * head - across]
    _polyline(space, [barb.tolist() for barb in barbs], "WARP")
    _text(space, one.name, (tail + tip) / 2 + across * 2.0, 0.0, height, "TEXT")
    for name, place, angle in one.names:
        _text(space, name, place, angle, 0.5 * height, "TEXT")


def _polyline(space: Any, points: Any, layer: str, closed: bool = False) -> None:
    space.add_lwpolyline(points, close=closed, dxfattribs={"layer": layer})


def _text(space: Any, text: str, place: Array, angle: float, height: float, layer: str) -> None:
    from ezdxf.enums import TextEntityAlignment

    given = {"layer": layer, "height": height, "rotation": angle}
    plain = "".join(c if c.isprintable() else " " for c in text)  # DXF has a line for each value
    entity = space.add_text(plain, dxfattribs=given)
    entity.set_placement(place.tolist(), align=TextEntityAlignment.MIDDLE_CENTER)
