"""Tables of results of bars, joints and ponds."""

from __future__ import annotations

from collections.abc import Sequence

from crms_fenicsx.output.report.case import Case
from crms_fenicsx.output.report.results_tables import Units, clean
from crms_fenicsx.output.report.tables import Cell, Table


def bar_names(cases: Sequence[Case]) -> list[str]:
    """Names of the bars that there are in any case."""
    return list(dict.fromkeys(name for case in cases for name in case.summary.bars))


def bars(cases: Sequence[Case], units: Units) -> Table:
    """Forces and lengths of all bars in all cases."""
    rows: list[tuple[Cell, ...]] = []
    for name in bar_names(cases):
        for case in cases:
            one = case.summary.bars.get(name)
            if one is not None:
                state = "slack" if one.slack else "tension" if one.force > 0.0 else "compression"
                rows.append((name, case.name, one.force, state, one.length, one.L0))
    m = units["length"]
    columns = (
        "Bar", "Combination", f"Force{units['force']}", "State", f"Length{m}", f"Unstressed{m}",
    )  # fmt: skip
    return Table("Bars", columns, rows, "bars", headings=2)


def envelope(cases: Sequence[Case], units: Units) -> Table:
    """Least and largest force of each bar over all cases."""
    rows: list[tuple[Cell, ...]] = []
    for name in bar_names(cases):
        force = {c.name: c.summary.bars[name].force for c in cases if name in c.summary.bars}
        low, high = min(force, key=lambda one: force[one]), max(force, key=lambda one: force[one])
        rows.append((name, force[low], low, force[high], high))
    kN = units["force"]
    columns = (
        "Bar", f"Least force{kN}", "Governs least", f"Largest force{kN}", "Governs largest",
    )  # fmt: skip
    return Table("Envelope of the bars' forces", columns, rows, "bar_envelope")


def joints(cases: Sequence[Case], units: Units) -> Table:
    """Forces of what holds joints, anchors of bars among them."""
    rows: list[tuple[Cell, ...]] = []
    for name in dict.fromkeys(name for case in cases for name in case.summary.joints):
        for case in cases:
            force = case.summary.joints.get(name)
            if force is not None:
                size = sum(x * x for x in force) ** 0.5
                rows.append((name, case.name, *clean(force, size), size))
    kN = units["force"]
    columns = ("Joint", "Combination", *(f"R{x}{kN}" for x in "xyz"), f"Size{kN}")
    return Table("Held joints: forces on them", columns, rows, "joints", headings=2)


def ponds(cases: Sequence[Case], units: Units) -> Table:
    """Levels and volumes of ponds; their weights with the factors."""
    rows: list[tuple[Cell, ...]] = []
    for name in dict.fromkeys(name for case in cases for name in case.summary.ponds):
        for case in cases:
            one = case.summary.ponds.get(name)
            if one is not None:
                weight = one.factor * one.weight * one.volume
                rows.append((name, case.name, one.factor, one.level, one.volume, weight))
    columns = (
        "Pond", "Combination", "Factor", f"Level z{units['length']}", f"Volume{units['volume']}",
        f"Weight with the factor{units['force']}",
    )  # fmt: skip
    return Table("Ponds", columns, rows, "ponds", headings=2)
