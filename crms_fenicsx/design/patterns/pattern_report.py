"""Report sections on a cutting pattern: tables, nested pieces, and the sewn roof."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial
from typing import Any

from mpi4py import MPI

from crms_fenicsx.design.patterns.pattern import Pattern
from crms_fenicsx.design.patterns.sewn import Comparison
from crms_fenicsx.design.patterns.sheet import Nesting, Sheet, nest
from crms_fenicsx.design.patterns.sheet_files import roll_figure, sewn_figure
from crms_fenicsx.foundation.runtime.arguments import PerRank, collective
from crms_fenicsx.results.output.report.page import (
    Cell,
    Figure,
    Figures,
    PagePart,
    PageSection,
    Paragraph,
    Table,
    Units,
)

TEXT = (
    "Each piece is cut to the flat shape that takes the form with the wanted strain and the least "
    "additional strain energy; the distortion is the largest additional strain. Sizes are those of "
    "the seam lines, without allowances; widths on the roll include them."
)


@collective
def report_sections(
    pattern: Pattern,
    sheet: Sheet,
    comparison: PerRank[Comparison | None] = None,
    *,
    unit: str = "",
    force: str = "",
) -> list[PageSection]:
    """Make the report's sections on a cutting pattern. Collective.

    Parameters
    ----------
    pattern, sheet
        As for `draw_sheets`.
    comparison
        Comparison of the sewn roof by `compare`, for a section of its own.
    unit, force
        Names of the units of length and force.

    Returns
    -------
    list
        Sections for ``sections=`` of `Solver.report`, which also writes their tables as CSV files.

    Raises
    ------
    InputError
        On all ranks: invalid arguments, or pieces wider than the roll.

    Examples
    --------
    >>> solver.report("report.html", sections=patterns.report_sections(pattern, sheet))
    """
    nesting, units = nest(pattern, sheet), Units(unit, force)
    m = units.plain("length")
    waste = f"{nesting.length:.4g}{m} of the roll, {nesting.roll:.4g}{m} wide, "
    waste += f"{nesting.waste:.1%} of it waste."
    body: list[PagePart] = [
        Paragraph(TEXT), _piece_table(pattern, nesting, units), _seam_table(pattern, units),
        Paragraph(waste),
        _figure(pattern.comm, partial(roll_figure, nesting, units), "The pieces on the roll"),
    ]  # fmt: skip
    found = [PageSection("Cutting pattern", body)]
    if comparison is not None:
        text = "Section forces per current length with the pieces sewn together, and how far the "
        text += "roof is from its wanted form."
        table = _comparison_table(pattern, comparison, units)
        drawn = partial(sewn_figure, pattern, comparison, units)
        picture = _figure(pattern.comm, drawn, "The pieces as sewn, on their flat shapes")
        found.append(PageSection("Sewn from its pieces", [Paragraph(text), table, picture], 3))
    return found


def _figure(comm: MPI.Intracomm, draw: Callable[[], Any], caption: str) -> Figures:
    """A figure drawn on the first rank and shared with all."""
    buffer = io.BytesIO()
    if comm.rank == 0:
        draw().savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    return Figures([Figure(comm.bcast(buffer.getvalue()), caption)])


def _piece_table(pattern: Pattern, nesting: Nesting, units: Units) -> Table:
    """Table of sizes, compensation and distortion of all pieces."""
    rows: list[tuple[Cell, ...]] = [
        (one.name, one.area,
         *map(units.exact, (one.length, one.width, float(drawing.extent[1]))),
         float(100 * one.shrink[0]), float(100 * one.shrink[1]), float(100 * one.distortion))
        for one, drawing in zip(pattern.flat, nesting.drawings, strict=True)
    ]  # fmt: skip
    heads = "Piece|Area{area}|Length{length}|Width{length}|Width on the roll{length}|"
    heads += "Compensation, warp [%]|weft [%]|Distortion [%]"
    return Table("Pieces", units.headings(heads), rows, "pieces")


def _seam_table(pattern: Pattern, units: Units) -> Table:
    """Table of the lengths of both sides of each seam."""
    sums = {seam: lengths.sum(axis=0).tolist() for seam, lengths in pattern.seam_lengths().items()}
    rows: list[tuple[Cell, ...]] = [
        (seam, *map(units.exact, (one, other, abs(one - other))))
        for seam, (one, other) in sorted(sums.items(), key=lambda one: (len(one[0]), one[0]))
    ]
    heads = "Seam|One side{length}|Other side{length}|Difference{length}"
    return Table("Seams", units.headings(heads), rows, "seams")


def _comparison_table(pattern: Pattern, comparison: Comparison, units: Units) -> Table:
    """Table of section forces, deviation, wrinkles and width without compression."""
    rows = list[tuple[str | float, ...]]()
    for k, one in enumerate((*comparison.pieces, comparison.whole)):
        forces = [float(value[k]) for k in (0, 1) for value in (one.mean, one.spread, one.least)]
        rows.append((one.name, *forces, one.deviation, 100 * one.wrinkled))
        if comparison.wanted is not None and comparison.wanted[0] > 0.0:
            each = pattern.flat[k : k + 1] or pattern.flat
            rows[-1] += (min(flat.largest_width(float(comparison.wanted[0])) for flat in each),)
    caption = "Section forces of the sewn roof"
    if comparison.wanted is not None:
        warp, weft = comparison.wanted
        caption += f"; wanted {warp:.4g} along warp and {weft:.4g} along weft"
    heads = "Piece|Warp, mean{stress}|scatter{stress}|least{stress}|Weft, mean{stress}|"
    heads += "scatter{stress}|least{stress}|Off the form{length}|Wrinkled [%]"
    heads += "|Width without compression{length}" if len(rows[0]) > 9 else ""
    return Table(caption, units.headings(heads), rows, "sewn", small=True)
