"""Tables and charts of results: of each case, and envelopes over all."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from crms_fenicsx.model.materials import ALL
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.output.figures.plots import units_of_results
from crms_fenicsx.output.report.case import Case
from crms_fenicsx.output.report.page import Cell, Table, per_cent, place
from crms_fenicsx.results.cable_and_bar_results import BarResults
from crms_fenicsx.results.quantities import QUANTITIES
from crms_fenicsx.results.summary import (
    ALL_SUPPORTS,
    SUMMED_UP,
    Extreme,
)

WHOLE = "whole membrane"
BOTH = "supports, anchors and held joints"
TOTAL = "all that meets there"
Row = tuple[Cell, ...]
NOISE = 1e-6
"""Components of a force below this part of the largest one are rounding."""


@dataclass(frozen=True)
class Units:
    """Names of units, as in headings."""

    length: str = ""  # length, force: such as "m" and "kN"; "" where not given
    force: str = ""

    def __getitem__(self, kind: str) -> str:
        """The unit of a kind in brackets after a blank; "" where not known."""
        unit = units_of_results(self.length, self.force).get(kind)
        return f" [{unit}]" if unit else ""


def label(name: str, units: Units) -> str:
    """A quantity with its unit."""
    one = QUANTITIES[name]
    return one.label[:1].upper() + one.label[1:] + (units[one.unit] if one.unit else "")


def part_name(part: str) -> str:
    """A part for people."""
    return WHOLE if part == ALL else part


def names_of(cases: Sequence[Case], kind: str) -> list[str]:
    """Names of the cables, bars ... that there are in any case; kind: attribute of a summary."""
    return list(dict.fromkeys(name for case in cases for name in getattr(case.summary, kind)))


def each(cases: Sequence[Case], kind: str) -> Iterator[tuple[str, str, Any]]:
    """Name, case and results of all of a kind, where a case has them."""
    for name in names_of(cases, kind):
        for case in cases:
            if name in getattr(case.summary, kind):
                yield name, case.name, getattr(case.summary, kind)[name]


def _extremes(case: Case) -> Iterator[tuple[str, str, Extreme, Extreme]]:
    """Part, quantity, least and largest value of a case."""
    for part, found in case.summary.parts.items():
        for name in [name for name in SUMMED_UP if name in found.largest]:
            yield part, name, found.least[name], found.largest[name]


def factors(cases: Sequence[Case], units: Units) -> Table:
    """What each case consists of."""
    loads = names_of(cases, "factors")
    rows: list[Row] = [
        (case.name, case.summary.pressure, *(case.summary.factors.get(load) for load in loads))
        for case in cases
    ]
    pressure = f"Inner pressure{units['pressure']}"
    columns = ("Combination", pressure, *(f"Factor of {x}" for x in loads))
    return Table("Inner pressure and factors of the loads", columns, rows, "combinations")


def overview(cases: Sequence[Case], units: Units) -> Table:
    """Deformation and state of the membrane."""
    rows: list[Row] = [
        (
            case.name, one.displacement.value, one.lowest.value, one.highest.value,
            per_cent(one.membrane.slack), per_cent(one.membrane.wrinkled), one.energy,
        )
        for case in cases for one in [case.summary]
    ]  # fmt: skip
    m = units["length"]
    columns = (
        "Combination", f"Largest deflection{m}", f"Lowest in z{m}", f"Highest in z{m}",
        "Slack area", "Wrinkled area", f"Potential energy{units['energy']}",
    )  # fmt: skip
    return Table("Deflections from the stress-free shape, and state", columns, rows, "overview")


def of_case(case: Case, units: Units, size: float) -> Table:
    """Membrane forces of a case, by parts of the membrane."""
    rows: list[Row] = [
        (part_name(part), label(name, units), *_tidy(low, high), place(low.at, size),
         high.value, place(high.at, size))
        for part, name, low, high in _extremes(case)
    ]  # fmt: skip
    at = f"at x; y; z{units['length']}"
    columns = ("Part", "Result", "Least", at, "Largest", at)
    return _without_one_part(Table(f"Membrane, {case.name}", columns, rows, headings=2))


def membrane(cases: Sequence[Case], units: Units) -> Table:
    """Membrane forces of all cases, for the CSV file."""
    rows: list[Row] = [
        (case.name, part_name(part), label(name, units), low.value, *low.at, high.value, *high.at)
        for case in cases
        for part, name, low, high in _extremes(case)
    ]
    m = units["length"]
    columns = (
        "Combination", "Part", "Result", "Least", *(f"least at {x}{m}" for x in "xyz"),
        "Largest", *(f"largest at {x}{m}" for x in "xyz"),
    )  # fmt: skip
    return Table("Membrane", columns, rows, "membrane", headings=3)


def envelope(cases: Sequence[Case], units: Units, size: float) -> Table:
    """Least and largest values over all cases, with the case that governs."""
    rows: list[Row] = []
    for part, name, _, _ in _extremes(cases[0]):
        parts = [(case.name, case.summary.parts[part]) for case in cases]
        least, low = min(((n, one.least[name]) for n, one in parts), key=_value)
        largest, high = max(((n, one.largest[name]) for n, one in parts), key=_value)
        rows.append(
            (part_name(part), label(name, units), *_tidy(low, high), least, high.value, largest,
             place(high.at, size))
        )  # fmt: skip
    columns = (
        "Part", "Result", "Least", "Governs least", "Largest", "Governs largest",
        f"at x; y; z{units['length']}",
    )  # fmt: skip
    return _without_one_part(
        Table("Envelope of the membrane", columns, rows, "envelope", headings=2)
    )


def _value(one: tuple[str, Extreme]) -> float:
    return one[1].value


def _tidy(low: Extreme, high: Extreme) -> list[float]:
    """A least value, 0 where it is rounding beside the largest one."""
    return clean([low.value], abs(high.value))


def _without_one_part(table: Table) -> Table:
    """A table without its first column where all is of the whole membrane."""
    if {row[0] for row in table.rows} != {WHOLE}:
        return table
    rows = [row[1:] for row in table.rows]
    return replace(table, columns=table.columns[1:], rows=rows, headings=1)


def cables(cases: Sequence[Case], units: Units) -> Table:
    """Tensions and lengths of all cables in all cases."""
    rows: list[Row] = [
        (
            name, case, one.least, one.mean, one.largest, "slack" if one.slack else "taut",
            one.length, one.L0, one.free, one.contact_mean, one.contact_largest,
        )
        for name, case, one in each(cases, "cables")
    ]  # fmt: skip
    kN, m, line = units["force"], units["length"], units["stress"]
    columns = (
        "Cable", "Combination", f"Least tension{kN}", f"Mean{kN}", f"Largest{kN}", "State",
        f"Length{m}", f"Unstressed{m}", f"Off the membrane{m}", f"Contact, mean{line}",
        f"Contact, largest{line}",
    )  # fmt: skip
    return Table("Cables", columns, rows, "cables", headings=2)


def cable_envelope(cases: Sequence[Case], units: Units, strengths: Mapping[str, float]) -> Table:
    """Least and largest tension of each cable over all cases."""
    rows: list[Row] = []
    for name in names_of(cases, "cables"):
        found = {c.name: c.summary.cables[name] for c in cases if name in c.summary.cables}
        low = min(found, key=lambda case: found[case].least)
        high = max(found, key=lambda case: found[case].largest)
        most = found[high].largest
        used = [most / strengths[name] if name in strengths else None] if strengths else []
        rows.append((name, found[low].least, low, most, high, *used))
    kN, last = units["force"], ["Utilisation"] if strengths else []
    columns = (
        "Cable", f"Least tension{kN}", "Governs least", f"Largest tension{kN}",
        "Governs largest", *last,
    )  # fmt: skip
    return Table("Envelope of the cables' tensions", columns, rows, "cable_envelope")


FAMILY = 10
"""So many bars or more whose names differ in a number at their end share rows of a page."""


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


def _bars(cases: Sequence[Case], every: bool) -> Iterator[tuple[str, list[tuple[str, BarResults]]]]:
    """Each bar, or else each family of bars, with cases and results of its bars."""
    names = names_of(cases, "bars")
    for label, own in ({name: [name] for name in names} if every else families(names)).items():
        yield label, [
            (case.name, case.summary.bars[name])
            for case in cases for name in own if name in case.summary.bars
        ]  # fmt: skip


def forces_of_bars(cases: Sequence[Case], units: Units, *, every: bool = True) -> Table:
    """Forces and lengths in all cases of all bars, or of each family's with the largest force."""
    rows: list[Row] = []
    for label, found in _bars(cases, every):
        for case in dict.fromkeys(case for case, _ in found):
            one = max((bar for name, bar in found if name == case), key=lambda bar: abs(bar.force))
            state = "slack" if one.slack else "tension" if one.force > 0.0 else "compression"
            rows.append((label, case, one.force, state, one.length, one.L0))
    m = units["length"]
    columns = (
        "Bar", "Combination", f"Force{units['force']}", "State", f"Length{m}", f"Unstressed{m}",
    )  # fmt: skip
    return Table("Bars", columns, rows, "bars", headings=2)


def bar_envelope(cases: Sequence[Case], units: Units, *, every: bool = True) -> Table:
    """Least and largest force of each bar, or family of bars, over all cases."""
    rows: list[Row] = []
    for label, found in _bars(cases, every):
        least, low = min(found, key=lambda one: one[1].force)
        largest, high = max(found, key=lambda one: one[1].force)
        rows.append((label, low.force, least, high.force, largest))
    kN = units["force"]
    columns = (
        "Bar", f"Least force{kN}", "Governs least", f"Largest force{kN}", "Governs largest",
    )  # fmt: skip
    return Table("Envelope of the bars' forces", columns, rows, "bar_envelope")


def ponds(cases: Sequence[Case], units: Units) -> Table:
    """Levels and volumes of ponds; their weights with the factors."""
    rows: list[Row] = [
        (name, case, x.factor, x.level, x.volume, x.factor * x.weight * x.volume)
        for name, case, x in each(cases, "ponds")
    ]
    columns = (
        "Pond", "Combination", "Factor", f"Level z{units['length']}", f"Volume{units['volume']}",
        f"Weight with the factor{units['force']}",
    )  # fmt: skip
    return Table("Ponds", columns, rows, "ponds", headings=2)


def supports(cases: Sequence[Case], units: Units, *, every: bool = True) -> Table:
    """Reactions of the supports with all that meets there, and the sum of them all.

    Parts of it by name, if there are several: with `every` of all supports, else of points.
    """
    rows: list[Row] = []
    names = names_of(cases, "supports")
    lists = [case.summary.supports for case in cases]
    if len(names) == 2 and all(  # of one group that is the sum as well
        set(one[names[0]].parts) == set(one[ALL_SUPPORTS].parts) for one in lists
    ):
        names = names[:1]
    for name in names:
        whole = name == ALL_SUPPORTS
        for case, one in ((case, case.summary.supports.get(name)) for case in cases):
            if one is None:
                continue
            label = BOTH if whole and one.parts else name
            # beside what the total is the sum of
            scale = max(*map(abs, (*one.total, *one.membrane)), one.mean * one.length)
            along = (one.mean, one.largest) if one.length > 0.0 else (None, None)
            rows.append((label, case.name, TOTAL, *clean(one.total, scale), *along))
            if one.parts and not whole and (every or one.length == 0.0):
                for part, force in {"membrane": one.membrane, **one.parts}.items():
                    size = max(map(abs, (*one.total, *force)))
                    rows.append((label, case.name, part, *clean(force, size), None, None))
    kN, line = units["force"], units["stress"]
    columns = (
        "Support", "Combination", "On", *(f"R{x}{kN}" for x in "xyz"), f"Per length, mean{line}",
        f"Per length, largest{line}",
    )  # fmt: skip
    return Table("Reactions: forces of the supports", columns, rows, "supports", headings=3)


def joints(cases: Sequence[Case], units: Units) -> Table:
    """Forces of what holds joints, anchors of bars among them."""
    rows: list[Row] = [
        (name, case, *with_size(force)) for name, case, force in each(cases, "joints")
    ]
    kN = units["force"]
    columns = ("Joint", "Combination", *(f"R{x}{kN}" for x in "xyz"), f"Size{kN}")
    return Table("Held joints: forces on them", columns, rows, "joints", headings=2)


def with_size(force: Sequence[float]) -> list[float]:
    size = sum(x * x for x in force) ** 0.5
    return [*clean(force, size), size]


def clean(force: Sequence[float], scale: float, part: float = NOISE) -> list[float]:
    """A force without components that are rounding beside a scale: below this part of it."""
    return [x if abs(x) > part * scale else 0.0 for x in force]


def verification(cases: Sequence[Case]) -> Table:
    """Checks of all cases."""
    rows: list[Row] = []
    for case in cases:
        if case.verification is None:
            rows.append((case.name, _unchecked(case), None, None, None, ""))
            continue
        for check in case.verification.checks:
            verdict = "passed" if check.passed else "failed" if check.binding else "doubtful"
            rows.append(
                (case.name, check.name, check.where or None, check.value, check.limit, verdict)
            )
    columns = ("Combination", "Check", "Cable", "Value", "Limit", "Verdict")
    return Table("Checks of the equilibria", columns, rows, "verification", headings=2)


def _unchecked(case: Case) -> str:
    """Why no checks are known of a case."""
    return "not verified in this run" if case.summary.in_equilibrium else UNBALANCED


def verdicts(cases: Sequence[Case]) -> Table:
    """What the checks say of each case."""
    rows: list[Row] = []
    for case in cases:
        found = case.verification
        if found is None:
            rows.append((case.name, None, _unchecked(case)))
            continue
        names = [check.name for check in found.failed or found.doubtful]
        verdict = "failed: " if found.failed else "verified; crude in: " if names else "verified"
        if case.summary.warnings and not found.failed:
            verdict, names = "equilibrium, but ", [str(one) for one in case.summary.warnings]
        rows.append((case.name, len(found.checks), verdict + ", ".join(names)))
    return Table("Verdicts", ("Combination", "Checks", "Verdict"), rows)


def nearest_to_limits(cases: Sequence[Case]) -> Table:
    """Each check where it is nearest to its limit."""
    known = [(case, check) for case in cases if case.verification is not None
             for check in case.verification.checks]  # fmt: skip
    rows: list[Row] = []
    for name in dict.fromkeys(check.name for _, check in known):
        case, check = max(
            ((case, check) for case, check in known if check.name == name),
            key=lambda one: (not one[1].passed, one[1].value / (one[1].limit or 1.0)),
        )
        rows.append((name, check.value, check.limit, case.name, check.where or None))
    columns = ("Check", "Value", "Limit", "Combination", "Cable")
    return Table("Checks, where they are nearest to their limits", columns, rows)
