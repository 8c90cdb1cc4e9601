"""Tables and charts of results: of each case, and envelopes over all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape

from crms_fenicsx.model.materials import ALL
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.output.report.case import Case
from crms_fenicsx.output.report.page import Cell, Table, number, per_cent, place
from crms_fenicsx.results.quantities import QUANTITIES
from crms_fenicsx.results.summary import (
    ALL_SUPPORTS,
    SUMMED_UP,
    Extreme,
    PartSummary,
)

WIDTH, LEFT, RIGHT, ROW, TOP = 760, 190, 140, 24, 26
"""Sizes in units of the drawing: whole width, margins, height of a row, room above."""
MOST_BARS = 40
"""More bars than these say nothing at a glance."""


def bars(caption: str, rows: Sequence[tuple[str, float, float]], limit: float | None = None) -> str:
    """A figure with a bar for each row; "" for more than `MOST_BARS` or for nothing but zeros."""
    most = max([high for _, _, high in rows] + ([limit] if limit is not None else []), default=0.0)
    if not 0 < len(rows) <= MOST_BARS or most <= 0.0:
        return ""
    scale = (WIDTH - LEFT - RIGHT) / most
    height, ranges = TOP + ROW * len(rows) + 8, any(low > 0.0 for _, low, _ in rows)
    parts = [f'<line class="axis" x1="{LEFT}" y1="{TOP - 4}" x2="{LEFT}" y2="{height - 4}"/>']
    for k, (name, low, high) in enumerate(rows):
        y = TOP + ROW * k
        bad = ' class="over"' if limit is not None and high > limit else ""
        start, end = LEFT + scale * low, LEFT + scale * high
        text = f"{number(low)} to {number(high)}" if ranges else number(high)
        parts.append(
            f'<text x="{LEFT - 8}" y="{y + 13}" text-anchor="end">{escape(name)}</text>'
            f'<rect{bad} x="{start:.1f}" y="{y + 3}" width="{max(end - start, 1.5):.1f}" '
            f'height="{ROW - 10}"/><text x="{end + 6:.1f}" y="{y + 13}">{text}</text>'
        )
    if limit is not None:
        x = LEFT + scale * limit
        parts.append(
            f'<line class="limit" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 4}"/>'
            f'<text x="{x:.1f}" y="{TOP - 11}" text-anchor="middle">{number(limit)}</text>'
        )
    words = "; ".join(f"{name}: {number(low)} to {number(high)}" for name, low, high in rows)
    return (
        f'<figure class="chart"><svg viewBox="0 0 {WIDTH} {height}" role="img" '
        f'aria-label="{escape(f"{caption}. {words}")}">{"".join(parts)}</svg>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


WHOLE = "whole membrane"
BOTH = "supports, anchors and held joints"
TOTAL = "all that meets there"
NOISE = 1e-6
"""Components of a force below this part of the largest one are rounding."""


@dataclass(frozen=True)
class Units:
    """Names of units, as in headings."""

    length: str = ""  # length, force: such as "m" and "kN"; "" where not given
    force: str = ""

    def __getitem__(self, kind: str) -> str:
        """The unit of a kind in brackets after a blank; "" where not known."""
        m, kN = self.length, self.force
        known = {"length": m, "force": kN}
        if m:
            known |= {"area": f"{m}²", "volume": f"{m}³"}
        if m and kN:
            known |= {"stress": f"{kN}/{m}", "pressure": f"{kN}/{m}²", "energy": f"{kN} {m}"}
        return f" [{known[kind]}]" if known.get(kind) else ""


def label(name: str, units: Units) -> str:
    """A quantity with its unit."""
    one = QUANTITIES[name]
    return one.label[:1].upper() + one.label[1:] + (units[one.unit] if one.unit else "")


def part_name(part: str) -> str:
    """A part for people."""
    return WHOLE if part == ALL else part


def factors(cases: Sequence[Case], units: Units) -> Table:
    """What each case consists of."""
    loads = list(dict.fromkeys(load for case in cases for load in case.summary.factors))
    rows: list[tuple[Cell, ...]] = [
        (case.name, case.summary.pressure, *(case.summary.factors.get(load) for load in loads))
        for case in cases
    ]
    columns = (
        "Combination",
        f"Inner pressure{units['pressure']}",
        *(f"Factor of {x}" for x in loads),
    )
    return Table("Inner pressure and factors of the loads", columns, rows, "combinations")


def overview(cases: Sequence[Case], units: Units) -> Table:
    """Deformation and state of the membrane."""
    rows: list[tuple[Cell, ...]] = []
    for case in cases:
        one, membrane = case.summary, case.summary.membrane
        rows.append(
            (
                case.name, one.displacement.value, one.lowest.value, one.highest.value,
                per_cent(membrane.slack), per_cent(membrane.wrinkled), one.energy,
            )
        )  # fmt: skip
    m = units["length"]
    columns = (
        "Combination", f"Largest deflection{m}", f"Lowest in z{m}", f"Highest in z{m}",
        "Slack area", "Wrinkled area", f"Potential energy{units['energy']}",
    )  # fmt: skip
    return Table("Deflections from the stress-free shape, and state", columns, rows, "overview")


def of_case(case: Case, units: Units, size: float) -> Table:
    """Section forces of a case, by parts of the membrane."""
    rows: list[tuple[Cell, ...]] = []
    for part, found in case.summary.parts.items():
        for name in [name for name in SUMMED_UP if name in found.largest]:
            low, high = found.least[name], found.largest[name]
            rows.append(
                (part_name(part), label(name, units), *_tidy(low, high), place(low.at, size),
                 high.value, place(high.at, size))
            )  # fmt: skip
    at = f"at x; y; z{units['length']}"
    columns = ("Part", "Result", "Least", at, "Largest", at)
    return _without_one_part(Table(f"Membrane, {case.name}", columns, rows, headings=2))


def membrane(cases: Sequence[Case], units: Units) -> Table:
    """Section forces of all cases, for the CSV file."""
    rows: list[tuple[Cell, ...]] = []
    for case in cases:
        for part, found in case.summary.parts.items():
            for name in found.largest:
                low, high = found.least[name], found.largest[name]
                rows.append(
                    (case.name, part_name(part), label(name, units), low.value, *low.at,
                     high.value, *high.at)
                )  # fmt: skip
    m = units["length"]
    columns = (
        "Combination", "Part", "Result", "Least", *(f"least at {x}{m}" for x in "xyz"),
        "Largest", *(f"largest at {x}{m}" for x in "xyz"),
    )  # fmt: skip
    return Table("Membrane", columns, rows, "membrane", headings=3)


def envelope(cases: Sequence[Case], units: Units, size: float) -> Table:
    """Least and largest values over all cases, with the case that governs."""
    rows: list[tuple[Cell, ...]] = []
    for part in cases[0].summary.parts:
        found = {case.name: case.summary.parts[part] for case in cases}
        for name in [name for name in SUMMED_UP if name in next(iter(found.values())).largest]:
            low = _governing(found, lambda one, n=name: one.least[n], -1.0)  # type: ignore[misc]
            high = _governing(found, lambda one, n=name: one.largest[n], 1.0)  # type: ignore[misc]
            rows.append(
                (part_name(part), label(name, units), *_tidy(low[1], high[1]), low[0],
                 high[1].value, high[0], place(high[1].at, size))
            )  # fmt: skip
    columns = (
        "Part", "Result", "Least", "Governs least", "Largest", "Governs largest",
        f"at x; y; z{units['length']}",
    )  # fmt: skip
    return _without_one_part(
        Table("Envelope of the membrane", columns, rows, "envelope", headings=2)
    )


def _tidy(low: Extreme, high: Extreme) -> list[float]:
    """A least value, 0 where it is rounding beside the largest one."""
    return clean([low.value], abs(high.value))


def _without_one_part(table: Table) -> Table:
    """A table without its first column where all is of the whole membrane."""
    if {row[0] for row in table.rows} != {WHOLE}:
        return table
    rows = [row[1:] for row in table.rows]
    return replace(table, columns=table.columns[1:], rows=rows, headings=1)


def _governing(
    found: Mapping[str, PartSummary], value: Callable[[PartSummary], Extreme], sign: float
) -> tuple[str, Extreme]:
    """The case with the largest value, or with the sign -1 the least one, and that."""
    name = max(found, key=lambda one: sign * value(found[one]).value)
    return name, value(found[name])


def cables(cases: Sequence[Case], units: Units) -> Table:
    """Tensions and lengths of all cables in all cases."""
    rows = [
        (
            name, case.name, one.least, one.mean, one.largest, "slack" if one.slack else "taut",
            one.length, one.L0, one.free, one.contact_mean, one.contact_largest,
        )
        for name in cable_names(cases)
        for case in cases
        if (one := case.summary.cables.get(name)) is not None
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
    rows: list[tuple[Cell, ...]] = []
    for name in cable_names(cases):
        found = {c.name: c.summary.cables[name] for c in cases if name in c.summary.cables}
        low = min(found, key=lambda case: found[case].least)
        high = max(found, key=lambda case: found[case].largest)
        used = found[high].largest / strengths[name] if name in strengths else None
        rows.append((name, found[low].least, low, found[high].largest, high, used))
    kN = units["force"]
    columns = (
        "Cable", f"Least tension{kN}", "Governs least", f"Largest tension{kN}",
        "Governs largest", "Utilisation",
    )  # fmt: skip
    table = Table("Envelope of the cables' tensions", columns, rows, "cable_envelope")
    if strengths:
        return table
    return Table(table.caption, columns[:-1], [row[:-1] for row in rows], table.name)


def cable_names(cases: Sequence[Case]) -> list[str]:
    """Names of the cables that there are in any case."""
    return list(dict.fromkeys(name for case in cases for name in case.summary.cables))


def supports(cases: Sequence[Case], units: Units, *, every: bool = True) -> Table:
    """Reactions of the supports with all that meets there, and the sum of them all.

    Parts of it by name, if there are several: with `every` of all supports, else of points.
    """
    rows: list[tuple[Cell, ...]] = []
    names = list(dict.fromkeys(name for case in cases for name in case.summary.supports))
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


def anchors(cases: Sequence[Case], units: Units) -> Table:
    """Forces of the anchors on the cables' ends."""
    rows: list[tuple[Cell, ...]] = []
    for name in cable_names(cases):
        for which in ("start", "end"):
            for case in cases:
                one = case.summary.cables.get(name)
                force = None if one is None else getattr(one, which)
                if one is not None and force is not None:
                    size = sum(x * x for x in force) ** 0.5
                    rows.append((name, which, case.name, *clean(force, size), size))
    kN = units["force"]
    columns = ("Cable", "End", "Combination", *(f"R{x}{kN}" for x in "xyz"), f"Size{kN}")
    return Table("Anchors: forces on the cables' ends", columns, rows, "anchors", headings=3)


def clean(force: Sequence[float], scale: float, part: float = NOISE) -> list[float]:
    """A force without components that are rounding beside a scale: below this part of it."""
    return [x if abs(x) > part * scale else 0.0 for x in force]


def verification(cases: Sequence[Case]) -> Table:
    """Checks of all cases."""
    rows: list[tuple[Cell, ...]] = []
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
    rows: list[tuple[Cell, ...]] = []
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
    rows: list[tuple[Cell, ...]] = []
    for name in dict.fromkeys(check.name for _, check in known):
        case, check = max(
            ((case, check) for case, check in known if check.name == name),
            key=lambda one: (not one[1].passed, one[1].value / (one[1].limit or 1.0)),
        )
        rows.append((name, check.value, check.limit, case.name, check.where or None))
    columns = ("Check", "Value", "Limit", "Combination", "Cable")
    return Table("Checks, where they are nearest to their limits", columns, rows)
