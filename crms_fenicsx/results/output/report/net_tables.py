"""Tables of clamps, anchors and cables to order."""

from __future__ import annotations

from crms_fenicsx.results.cable_order import Order
from crms_fenicsx.results.output.report.foundation_tables import DIRECTION, inclined
from crms_fenicsx.results.output.report.page import Measured, Table
from crms_fenicsx.results.output.report.results_tables import ResultTables, Row, with_size
from crms_fenicsx.results.output.report.units import Units

DECIMALS = {"mm": 0, "cm": 1, "in": 2}
"""Decimals of lengths to order, to the millimetre, by unit; 3 of metres, feet and unknown ones."""


def clamps(results: ResultTables) -> Table:
    """Tensions on both sides of each clamp, and its force, in all cases."""
    rows: list[Row] = [
        (name, case, one.before[0], one.after[0], one.before[1], one.after[1], one.size)
        for name, case, one in results.each("clamps")
    ]
    columns = results.units.headings(
        "Clamp|Combination|Cable 1, before{force}|Cable 1, after{force}|Cable 2, before{force}|"
        "Cable 2, after{force}|Force{force}"
    )
    return Table("Clamps", columns, rows, "clamps", headings=2)


def anchors(results: ResultTables) -> Table:
    """Anchor forces on the cables' ends."""
    cases = results.cases
    rows: list[Row] = [
        (name, which, case.name, *with_size(force), *inclined(force))
        for name in results.names("cables") for which in ("start", "end") for case in cases
        if (force := getattr(case.summary.cables.get(name), which, None)) is not None
    ]  # fmt: skip
    columns = results.units.headings(
        "Cable|End|Combination|Rx{force}|Ry{force}|Rz{force}|Size{force}|" + DIRECTION
    )
    return Table("Anchors: forces on the cables' ends", columns, rows, "anchors", headings=3)


def order(cables: Order, units: Units) -> Table:
    """Manufacturing lengths and marks of cables."""
    kinds = ["", "force", "length", "force", "length", "", "", "length", "length", "length"]
    columns = [name + units[kind] for name, kind in zip(cables.COLUMNS, kinds, strict=True)]
    decimals = DECIMALS.get(units.length, 3)
    rows = [
        [
            Measured(cell, decimals) if kind == "length" and isinstance(cell, float) else cell
            for cell, kind in zip(row, kinds, strict=True)
        ]
        for row in cables.rows()
    ]
    start, end = cables.allowance
    caption = (
        f"Cables to order, measured at {cables.temperature:g} K above the model's temperature; cut "
        f"with allowances of {start:g} and {end:g}"
    )
    return Table(caption, columns, rows, "order")
