"""Cutting patterns as pictures (the nested pieces, and one page per piece) and as DXF files."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from crms_fenicsx.design.patterns.pattern import FlatPiece, Pattern
from crms_fenicsx.design.patterns.sewn import Comparison
from crms_fenicsx.design.patterns.sheet import Drawing, Nesting, Sheet, nest
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import File, collective
from crms_fenicsx.foundation.runtime.arrays import Array, floats
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import (
    DXF_UNITS,
    absolute,
    make_writable,
    new_drawing,
    replaced,
)
from crms_fenicsx.results.output.figures.picture import checked_picture, finished, new_figure
from crms_fenicsx.results.output.report.page import Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLOURS = {"cut": "#b3261e", "seam": "#1f5a8c", "overlap": "#9aa5b1", "mark": "#2d7d46"}
WIDTH, HIGHEST, ROW = 11.0, 7.5, 0.4
"""Width and largest height of a figure, and height of a row of the roll (inches)."""
LAYERS = {"CUT": 1, "SEAM": 5, "OVERLAP": 8, "MARK": 3, "WARP": 6, "TEXT": 7, "ROLL": 9}
"""DXF layers and their colour numbers."""
TEXT = 0.04
"""Height of piece names relative to the roll's width; other texts are smaller."""


@collective
def draw_sheets(
    pattern: Pattern, filename: File | None, sheet: Sheet, *, unit: str = ""
) -> Figure | None:
    """Draw the layout on the roll. Collective.

    Cutting lines with allowances are red, seam lines blue, ends of the other piece's allowance
    grey, match marks green. A PDF has a further page for each piece, with its sizes.

    Parameters
    ----------
    pattern
        The pattern.
    filename
        Picture in a format of matplotlib, such as .svg, .pdf or .png; None returns the figure of
        the roll on the first rank.
    sheet
        Roll, allowances and marks.
    unit
        Name of the unit of length.

    Returns
    -------
    matplotlib.figure.Figure or None
        The figure, without `filename`.

    Raises
    ------
    InputError
        On all ranks, with nothing written: an invalid argument, pieces wider than the roll, or a
        file that cannot be written.

    Examples
    --------
    >>> patterns.draw_sheets(pattern, "cutting.svg", sheet, unit="m")
    """
    comm = pattern.comm
    if filename is not None:
        filename = absolute(filename, comm)
    nesting = nest(pattern, sheet)
    with raised_together(comm):
        if comm.rank > 0:
            return None
        path = checked_picture(filename)
        units = Units(unit)
        whole = roll_figure(nesting, units)
        if path is None or path.suffix.lower() != ".pdf":
            return finished(whole, path, 150)
        from matplotlib.backends.backend_pdf import PdfPages

        with replaced(path) as partial, PdfPages(partial) as file:
            file.savefig(whole, bbox_inches="tight")
            for one, flat in zip(nesting.drawings, pattern.flat, strict=True):
                file.savefig(_page(one, flat, units), bbox_inches="tight")
    return None


def _axes(figure: Figure, length: float, width: float, along: str, across: str = "") -> Any:
    """Axes of equal scale for a drawing of a size, with names."""
    axes = figure.add_subplot()
    axes.set_xlabel(along, fontsize=8)
    axes.set_ylabel(across, fontsize=8)
    axes.set_aspect("equal")
    axes.set_xlim(-0.02 * length, 1.02 * length)
    axes.set_ylim(-0.05 * width, 1.05 * width)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return axes


def roll_figure(nesting: Nesting, units: Units) -> Figure:
    """Figure of the nested pieces, row by row from the top, with a legend at the right."""
    from matplotlib.lines import Line2D

    starts = np.array([*nesting.rows, nesting.length])
    x, y = float(np.diff(starts).max()), nesting.roll
    step, last = 1.1 * y, len(nesting.rows) - 1
    high = last * step + y
    highest = max(HIGHEST, ROW * len(nesting.rows) + 1.2)
    figure = new_figure(WIDTH, float(np.clip(WIDTH * high / x + 1.2, 2.0, highest)))
    axes = _axes(figure, x, high, f"along the roll{units['length']}")
    for k, (start, end) in enumerate(pairwise(floats(starts))):
        base = (last - k) * step
        axes.plot([0, end - start, end - start, 0, 0], [base, base, base + y, base + y, base],
                  color="#5b6876", linewidth=0.6, linestyle="--")  # fmt: skip
    for one in nesting.drawings:
        row = int(np.searchsorted(starts, one.cut_line[:, 0].min() + 1e-9 * x, side="right")) - 1
        _draw(axes, one.moved(np.array([-starts[row], (last - row) * step])), names=False)
    axes.set_yticks([])
    texts = ("cut", "seam", "end of the overlap", "match mark")
    lines = [Line2D([], [], color=one, label=text)
             for one, text in zip(COLOURS.values(), texts, strict=True)]  # fmt: skip
    lines.append(Line2D([], [], color="#5b6876", linewidth=0.6, linestyle="--", label="roll"))
    axes.legend(handles=lines, loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8,
                frameon=False)  # fmt: skip
    m = units.plain("length")
    axes.set_title(
        f"{len(nesting.drawings)} pieces on {nesting.length:.4g}{m} of a roll {y:.4g}{m} wide, "
        f"{nesting.waste:.0%} waste",
        loc="left",
        fontsize=10,
    )
    return figure


def sewn_figure(pattern: Pattern, comparison: Comparison, units: Units) -> Figure:
    """Figure of the sewn roof's results on the flat pieces."""
    from matplotlib.collections import PolyCollection

    names = [f"{side}: section force{units['stress']}" for side in ("Warp", "Weft")]
    names += [f"Off the form{units['length']}", "Wrinkled or slack"]
    panels = [(name, comparison.cells[:, k]) for k, name in enumerate(names)]
    panels = panels[: 4 if panels[3][1].any() else 3]
    gap = 0.15 * max(one.width for one in pattern.flat)
    bases = np.cumsum([0.0, *(one.width + gap for one in pattern.flat)])
    length, width = max(one.length for one in pattern.flat), float(bases[-1])
    corners = [(one.shape + np.array([0.0, base]))[one.piece.triangles]
               for one, base in zip(pattern.flat, bases, strict=False)]  # fmt: skip
    cells = np.concatenate([one.piece.cells for one in pattern.flat])
    share = WIDTH / len(panels)
    figure = new_figure(WIDTH, float(np.clip(share * width / length + 1.0, 2.5, HIGHEST)))
    for k, (name, values) in enumerate(panels, 1):
        axes = figure.add_subplot(1, len(panels), k, aspect="equal")
        shapes = PolyCollection(np.concatenate(corners), array=values[cells], cmap="viridis",
                                edgecolor="face", linewidth=0.1, rasterized=True)  # fmt: skip
        axes.add_collection(shapes)
        axes.set(xlim=(-0.02 * length, 1.02 * length), ylim=(-gap, width), xticks=[], yticks=[])
        axes.set_frame_on(False)
        axes.set_title(name, fontsize=8)
        for one, base in zip(pattern.flat, bases, strict=False):
            axes.text(-0.01 * length, base + one.width / 2, one.name, fontsize=5, ha="right",
                      va="center")  # fmt: skip
        figure.colorbar(shapes, ax=axes, orientation="horizontal", pad=0.02).ax.tick_params(
            labelsize=7
        )
    return figure


def _page(one: Drawing, flat: FlatPiece, units: Units) -> Figure:
    """Page of a piece with its sizes."""
    one = one.moved(-one.cut_line.min(axis=0))
    length, width = one.extent
    figure = new_figure(WIDTH, float(np.clip(WIDTH * width / length + 1.6, 2.5, HIGHEST)))
    m = units["length"]
    axes = _axes(figure, length, width, f"along the warp{m}", f"along the weft{m}")
    _draw(axes, one, names=True)
    warp, weft = (f"{100 * part:.2f} %" for part in flat.shrink)
    axes.set_title(
        f"{one.name}: {flat.length:.4g} x {flat.width:.4g}{units.plain('length')} (fabric "
        f"{length:.4g} x {width:.4g}), area {flat.area:.4g}{units.plain('area')}; compensated "
        f"{warp} along warp, {weft} along weft",
        loc="left",
        fontsize=9,
    )
    return figure


def _draw(axes: Any, one: Drawing, names: bool) -> None:
    """Draw a piece into axes."""
    for line, kind in ((one.cut_line, "cut"), (one.seam_line, "seam")):
        axes.fill(*line.T, facecolor="#f3f6f9" if kind == "cut" else "none",
                  edgecolor=COLOURS[kind], linewidth=0.8)  # fmt: skip
    for line in one.overlaps:
        axes.plot(*line.T, color=COLOURS["overlap"], linewidth=0.5)
    for number, line in one.marks:
        axes.plot(*line.T, color=COLOURS["mark"], linewidth=1.2)
        if names:
            inner = 3.0 * line[0] - 2.0 * line[1]
            axes.text(*inner, number, color=COLOURS["mark"], fontsize=6, ha="center", va="center")
    tail, tip = one.warp
    arrow = {"arrowstyle": "-|>", "linewidth": 0.8, "color": "#1b2733"}
    axes.annotate("", tip, tail, arrowprops=arrow)
    axes.annotate(one.name, (tail + tip) / 2, xytext=(0, 2), textcoords="offset points",
                  fontsize=9 if names else 6, ha="center", va="bottom")  # fmt: skip
    if names:
        for name, place, angle in one.names:
            axes.text(*place, name, rotation=angle, rotation_mode="anchor", fontsize=7,
                      ha="center", va="center", color="#5b6876")  # fmt: skip


@collective
def write_dxf(pattern: Pattern, filename: File, sheet: Sheet, *, unit: str = "m") -> None:
    """Write the layout on the roll to a DXF file. Collective.

    Layers: CUT, the cutting line with allowances; SEAM, seam lines; OVERLAP, the end of the other
    piece's allowance; MARK, numbered match marks; WARP, arrows; TEXT, names of pieces and edges;
    ROLL. Needs ezdxf.

    Parameters
    ----------
    pattern, sheet
        As for `draw_sheets`.
    filename
        File ending in .dxf; an existing one is replaced once the new one is complete.
    unit
        Unit of length of the pattern: "mm", "cm", "m", "in" or "ft".

    Raises
    ------
    InputError
        On all ranks, with nothing written: an invalid argument, pieces wider than the roll, or a
        file that cannot be written.
    ImportError
        On all ranks: ezdxf is not installed.

    Examples
    --------
    >>> patterns.write_dxf(pattern, "cutting.dxf", sheet)
    """
    comm = pattern.comm
    checks.one_of("write_dxf: unit", unit, DXF_UNITS)
    path = absolute(filename, comm)
    if path.suffix.lower() != ".dxf":
        raise InputError(f"write_dxf: filename = {str(path)!r} does not end in .dxf.")
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
        _add_piece(space, one, TEXT * nesting.roll)
    return document


def _add_piece(space: Any, one: Drawing, height: float) -> None:
    """Add a piece to the drawing."""
    _polyline(space, one.cut_line, "CUT", closed=True)
    _polyline(space, one.seam_line, "SEAM", closed=True)
    for line in one.overlaps:
        _polyline(space, line, "OVERLAP")
    for number, line in one.marks:
        space.add_line(*line.tolist(), dxfattribs={"layer": "MARK"})
        tick = line[1] - line[0]
        inner = line[0] - tick * (1.0 + 0.4 * height / np.hypot(*tick))  # beside the overlap
        _text(space, str(number), inner, 0.0, 0.35 * height, "MARK")
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
