"""Report sections on a cutting pattern: tables, nested pieces, and the sewn roof."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial
from typing import Any

from mpi4py import MPI

from crms_fenicsx.design.patterns.nesting import Nesting, nest
from crms_fenicsx.design.patterns.pattern import Pattern
from crms_fenicsx.design.patterns.sewn import Comparison
from crms_fenicsx.design.patterns.sheet import Sheet
from crms_fenicsx.design.patterns.sheet_pictures import roll_figure, sewn_figure
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, collective
from crms_fenicsx.results.output.report.page import (
    Figure,
    Figures,
    PagePart,
    PageSection,
    Paragraph,
    Table,
    Units,
)

TEXT = (
    "Each piece is cut as the flat shape from which it takes the form with the wanted strain and "
    "the least strain energy beside it; the distortion is the largest strain beside the wanted "
    "one. Sizes are those of the seam lines, without allowances; widths on the roll are with them."
)


@collective
def report_sections(
    pattern: Pattern,
    sheet: Sheet,
    comparison: Comparison | None = None,
    *,
    unit: str = "",
    force: str = "",
) -> list[PageSection]:
    """Make the report's sections on a cutting pattern. Collective.

    Parameters
    ----------
    pattern
        The pattern.
    sheet
        Roll, allowances and marks.
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
    if not isinstance(pattern, Pattern):
        raise InputError(f"report_sections: pattern = {pattern!r}; give one of patterns.flatten.")
    checks.same(pattern.comm, "report_sections", sheet=sheet, unit=unit, force=force)
    nesting, units = nest(pattern, sheet), Units(unit, force)
    waste = (
        f"{nesting.length:.4g}{_plain(unit)} of the roll, {nesting.roll:.4g}{_plain(unit)} wide, "
        f"{nesting.waste:.1%} of it waste."
    )
    body: list[PagePart] = [
        Paragraph(TEXT), piece_table(pattern, nesting, units), seam_table(pattern, units),
        Paragraph(waste),
        _figure(pattern.comm, partial(roll_figure, nesting, unit), "The pieces on the roll"),
    ]  # fmt: skip
    found = [PageSection("Cutting pattern", body)]
    if comparison is not None:
        text = "Section forces per current length with the pieces sewn together, and how far the "
        text += "roof is from its wanted form."
        table = comparison_table(pattern, comparison, units)
        drawn = partial(sewn_figure, pattern, comparison, unit, units["stress"])
        picture = _figure(pattern.comm, drawn, "What the pieces have got, on their flat shapes")
        found.append(PageSection("Sewn of its pieces", [Paragraph(text), table, picture], 3))
    return found


def _figure(comm: MPI.Intracomm, draw: Callable[[], Any], caption: str) -> Figures:
    """A figure drawn on the first rank and shared with all."""
    buffer = io.BytesIO()
    if comm.rank == 0:
        draw().savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    return Figures([Figure(comm.bcast(buffer.getvalue()), caption)])


def _plain(unit: str) -> str:
    return f" {unit}" if unit else ""


def piece_table(pattern: Pattern, nesting: Nesting, units: Units) -> Table:
    """Table of sizes, compensation and distortion of all pieces."""
    m = units["length"]
    rows = [
        (one.name, one.area, one.length, one.width, float(drawing.extent[1]),
         float(100 * one.shrink[0]), float(100 * one.shrink[1]), float(100 * one.distortion))
        for one, drawing in zip(pattern.flat, nesting.drawings, strict=True)
    ]  # fmt: skip
    return Table(
        "Pieces",
        ("Piece", f"Area{units['area']}", f"Length{m}", f"Width{m}", f"Width on the roll{m}",
         "Compensation, warp [%]", "weft [%]", "Distortion [%]"),
        rows, "pieces",
    )  # fmt: skip


def seam_table(pattern: Pattern, units: Units) -> Table:
    """Table of the lengths of both sides of each seam."""
    m, rows = units["length"], list[tuple[str | float, ...]]()
    for seam, lengths in pattern.seam_lengths().items():
        one, other = lengths.sum(axis=0).tolist()
        rows.append((seam, one, other, abs(one - other)))
    return Table(
        "Seams", ("Seam", f"One side{m}", f"Other side{m}", f"Difference{m}"), rows, "seams"
    )


def comparison_table(pattern: Pattern, comparison: Comparison, units: Units) -> Table:
    """Table of section forces, deviation, wrinkles and width without compression."""
    s, m, rows = units["stress"], units["length"], list[tuple[str | float, ...]]()
    for k, one in enumerate((*comparison.pieces, comparison.whole)):
        forces = [float(value[k]) for k in (0, 1) for value in (one.mean, one.spread, one.least)]
        rows.append((one.name, *forces, one.deviation, 100 * one.wrinkled))
        if comparison.wanted is not None and comparison.wanted[0] > 0.0:
            each = pattern.flat[k : k + 1] or pattern.flat
            rows[-1] += (min(flat.largest_width(float(comparison.wanted[0])) for flat in each),)
    further = ("Width without compression" + m,) if len(rows[0]) > 9 else ()
    wanted = "" if comparison.wanted is None else (
        f"; wanted {comparison.wanted[0]:.4g} along warp and {comparison.wanted[1]:.4g} along weft"
    )  # fmt: skip
    return Table(
        f"Section forces of the sewn roof{wanted}",
        ("Piece", f"Warp, mean{s}", f"scatter{s}", f"least{s}", f"Weft, mean{s}", f"scatter{s}",
         f"least{s}", f"Off the form{m}", "Wrinkled [%]", *further),
        rows, "sewn",
    )  # fmt: skip
