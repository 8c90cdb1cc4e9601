"""Tables of results of bars, joints and ponds."""

from __future__ import annotations

import re
from collections.abc import Sequence

from crms_fenicsx.output.report.case import Case
from crms_fenicsx.output.report.page import Cell, Table
from crms_fenicsx.output.report.results_tables import Units, clean

FAMILY = 10
"""So many bars or more whose names differ in a number at their end share rows of a page."""


def bar_names(cases: Sequence[Case]) -> list[str]:
    """Names of the bars that there are in any case."""
    return list(dict.fromkeys(name for case in cases for name in case.summary.bars))


def families(names: Sequence[str]) -> dict[str, list[str]]:
    """Names by what a page calls them: their own, or "belt 1 ... belt 26" of many."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(re.sub(r"\d+$", "", name), []).append(name)
    shared: dict[str, list[str]] = {}
    for own in found.values():
        many = len(own) >= FAMILY
        shared |= {f"{own[0]} ... {own[-1]}": own} if many else {name: [name] for name in own}
    return shared


def _rows(cases: Sequence[Case], every: bool) -> dict[str, list[str]]:
    """Names of the bars of each row: one, or those of a family."""
    names = bar_names(cases)
    return {name: [name] for name in names} if every else families(names)


def bars(cases: Sequence[Case], units: Units, *, every: bool = True) -> Table:
    """Forces and lengths in all cases of all bars, or of each family's with the largest force."""
    rows: list[tuple[Cell, ...]] = []
    for label, own in _rows(cases, every).items():
        for case in cases:
            found = [case.summary.bars[name] for name in own if name in case.summary.bars]
            if found:
                one = max(found, key=lambda bar: abs(bar.force))
                state = "slack" if one.slack else "tension" if one.force > 0.0 else "compression"
                rows.append((label, case.name, one.force, state, one.length, one.L0))
    m = units["length"]
    columns = (
        "Bar", "Combination", f"Force{units['force']}", "State", f"Length{m}", f"Unstressed{m}",
    )  # fmt: skip
    return Table("Bars", columns, rows, "bars", headings=2)


def envelope(cases: Sequence[Case], units: Units, *, every: bool = True) -> Table:
    """Least and largest force of each bar, or family of bars, over all cases."""
    rows: list[tuple[Cell, ...]] = []
    for label, own in _rows(cases, every).items():
        force = [
            (case.summary.bars[name].force, case.name)
            for case in cases for name in own if name in case.summary.bars
        ]  # fmt: skip
        (low, least), (high, largest) = (take(force, key=lambda one: one[0]) for take in (min, max))
        rows.append((label, low, least, high, largest))
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
