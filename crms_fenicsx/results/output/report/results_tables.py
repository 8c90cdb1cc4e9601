"""Tables of results: by case, and envelopes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from crms_fenicsx.model.strengths import ALL
from crms_fenicsx.results.cable_and_bar_results import BarResults
from crms_fenicsx.results.design_checks import Extreme, governing_of
from crms_fenicsx.results.output.report.case import Case
from crms_fenicsx.results.output.report.page import (
    WHOLE,
    Cell,
    Measured,
    Table,
    Units,
    in_parts,
    per_cent,
    place,
)
from crms_fenicsx.results.output.report.verdict import listed
from crms_fenicsx.results.quantities import QUANTITIES, SUMMED_UP
from crms_fenicsx.results.summary import ALL_SUPPORTS

BOTH = "supports, anchors and held joints"
TOTAL = "everything attached"
Row = tuple[Cell, ...]
NOISE = 1e-6
"""Force components below this fraction of the largest are rounding errors."""
WIDE = 12
"""Largest number of items that share a table by case."""
FINE = 1e-3
"""Values below this fraction of the largest are shown as zero, as irrelevant to design."""


@dataclass(frozen=True)
class ResultTables:
    """Result tables of the load cases."""

    cases: Sequence[Case]
    units: Units
    size: float  # largest extent of the stress-free surface (length)

    @property
    def combined(self) -> ResultTables:
        """These tables of the combinations only, of which envelopes are; of stages, if there is
        nothing else."""
        return replace(self, cases=[x for x in self.cases if not x.stage] or self.cases)

    @property
    def over(self) -> str:
        """What envelopes are over, in their captions."""
        apart = any(case.stage for case in self.cases) and not all(x.stage for x in self.cases)
        return ", over all combinations without stages of erection" if apart else ""

    def names(self, kind: str) -> list[str]:
        """Names of the cables, bars ... of all cases; `kind` is a summary's attribute."""
        every = (name for case in self.cases for name in getattr(case.summary, kind))
        return list(dict.fromkeys(every))

    def by_name(self, kind: str) -> Iterator[tuple[str, list[tuple[str, Any]]]]:
        """Name of each item of a kind, and (case, result) pairs."""
        for name in self.names(kind):
            every = ((case.name, getattr(case.summary, kind)) for case in self.cases)
            yield name, [(case, known[name]) for case, known in every if name in known]

    def each(self, kind: str) -> Iterator[tuple[str, str, Any]]:
        """Name, case and result of each item of a kind."""
        return ((name, *one) for name, found in self.by_name(kind) for one in found)

    def _extremes(self, case: Case) -> Iterator[tuple[str, str, str, Extreme, Extreme]]:
        """Part, name and label of each quantity, with its minimum and maximum."""
        for part, found in case.summary.parts.items():
            for name in (name for name in SUMMED_UP if name in found.largest):
                one, scale = QUANTITIES[name], QUANTITIES[name].scale
                label = one.label[:1].upper() + one.label[1:]
                label += self.units[one.unit] if one.unit else " [%]"
                low, high = (replace(x[name], value=scale * x[name].value)
                             for x in (found.least, found.largest))  # fmt: skip
                yield part, name, label, low, high

    def overview(self) -> Table:
        """Deformation and state of the membrane."""
        rows: list[Row] = [
            (
                case.name,
                *map(self.units.exact, (case.deflection.value, one.displacement.value)),
                *map(self.units.exact, (one.lowest.value, one.highest.value)),
                *(Measured(100.0 * x, 1) for x in (one.membrane.slack, one.membrane.wrinkled)),
            )
            for case in self.cases for one in [case.summary]
        ]  # fmt: skip
        columns = self.units.headings(
            "Combination|Deflection from the base state{length}|Displacement from the stress-free "
            "shape{length}|Vertically, least{length}|Vertically, largest{length}|Slack area [%]|"
            "Wrinkled area [%]"
        )
        return Table("Largest deflections, and state of the membrane", columns, rows, "overview")

    def section_forces(self) -> Table:
        """Largest section forces, strain and utilisation of the whole membrane in each case."""
        known = {name: label for case in reversed(self.cases)
                 for part, name, label, *_ in self._extremes(case) if part == ALL}  # fmt: skip
        names, labels = [*known], [*known.values()]
        labels = [label.replace("Section force along", "Largest along") for label in labels]
        most = {
            name: max(abs(found[name].value) for case in self.cases
                      if name in (found := case.summary.membrane.largest))
            for name in names
        }  # fmt: skip
        rows: list[Row] = [
            (case.name, *(QUANTITIES[name].scale * clean([found[name].value], most[name], FINE)[0]
                          if name in found else None for name in names))
            for case in self.cases for found in [case.summary.membrane.largest]
        ]  # fmt: skip
        caption = "Largest section forces by combination"
        return Table(caption, ["Combination", *labels], rows, even=True)

    def patches(self) -> Table:
        """Reinforced corners, and what plain fabric would bear there, over all cases."""
        rows: list[Row] = []
        for name, found in self.by_name("patches"):
            governs, most = governing_of(found, lambda one: one[1].utilisation)
            patch = most.patch
            radius = "given" if patch.given else "a twentieth of the distance to the next"
            rows.append((
                name, patch.reason, place(patch.at, self.size), patch.radius, radius,
                per_cent(most.utilisation), governs,
            ))  # fmt: skip
        columns = self.units.headings(
            "Corner|For|stress-free at x; y; z{length}|Radius{length}|Radius is|"
            "Plain fabric there|Governs"
        )
        return Table("Reinforced corners of the membrane", columns, rows, "reinforcement")

    def membrane(self) -> Table:
        """Section forces of all cases, for the CSV file."""
        rows: list[Row] = [
            (case.name, part_name(part), label, low.value, *low.at, high.value, *high.at)
            for case in self.cases
            for part, _, label, low, high in self._extremes(case)
        ]
        columns = self.units.headings(
            "Combination|Part|Result|Least|least at x{length}|least at y{length}|least at z{length}"
            "|Largest|largest at x{length}|largest at y{length}|largest at z{length}"
        )
        return Table("Membrane", columns, rows, "membrane", headings=3)

    def envelope(self) -> Table:
        """Minima and maxima over all cases, with the governing case."""
        rows, cases = list[Row](), self.combined.cases
        every = {(part, name): label for case in cases
                 for part, name, label, _, _ in self._extremes(case)}  # fmt: skip
        for (part, name), label in every.items():
            parts = [
                (case.name, case.summary.parts[part])
                for case in cases if name in case.summary.parts[part].least
            ]  # fmt: skip
            least, low = governing_of(
                [(n, one.least[name]) for n, one in parts], lambda one: -one[1].value
            )
            largest, high = governing_of(
                [(n, one.largest[name]) for n, one in parts], lambda one: one[1].value
            )
            at, scale = place(high.at, self.size), QUANTITIES[name].scale
            small, most = clean([scale * low.value, scale * high.value], scale * high.value, FINE)
            governs = next(case for case in cases if case.name == largest)
            smooth, change = governs.recovered[part].get(name), governs.summary.parts[part].change
            nodal, peak = None if smooth is None else scale * smooth, ""
            if nodal is None and change is not None:
                peak = f"may change by {per_cent(change)}"
            elif nodal is not None and most > 1.25 * max(nodal, 0.0):
                peak = "single-cell peak"
            least, largest = (least, largest) if len(cases) > 1 else ("", "")
            lower = (None, "") if name == "utilisation" else (small, least)  # says nothing
            rows.append((part_name(part), label, *lower, most, largest, at, nodal, peak))
        columns = self.units.headings(
            "Part|Result|Least|Governs least|Largest|Governs largest|at x; y; z{length}"
            "|Largest, smoothed|Remark"
        )
        caption = f"Envelope of the membrane{self.over}"
        table = Table(caption, columns, rows, "envelope", headings=2, small=True)
        return _without_one_part(table)

    def cables(self) -> Table:
        """Tensions and lengths of all cables in all cases."""
        most = max((one.contact_largest for *_, one in self.each("cables")), default=0.0)
        rows: list[Row] = [
            (
                name, case, one.least, one.mean, one.largest, "slack" if one.slack else "taut",
                *map(self.units.exact, (one.length, one.L0, one.free)),
                *clean((one.contact_mean, one.contact_largest), most, FINE),
            )
            for name, case, one in self.each("cables")
        ]  # fmt: skip
        columns = self.units.headings(
            "Cable|Combination|Least tension{force}|Mean{force}|Largest{force}|State|"
            "Length{length}|Unstressed{length}|Off the membrane{length}|Contact, mean{stress}|"
            "Contact, largest{stress}"
        )
        return Table("Cables", columns, rows, "cables", headings=2)

    def cable_envelope(self) -> Table:
        """Smallest and largest tension of each cable over all cases, and where it is slack."""
        rows: list[Row] = []
        for name, found in self.combined.by_name("cables"):
            least, low = governing_of(found, lambda one: -one[1].least)
            largest, high = governing_of(found, lambda one: one[1].largest)
            loose = [case for case, one in found if one.slack]
            slack = "all" if len(loose) == len(found) > 1 else listed(loose) or None
            used = _most_used(found)
            rows.append((name, low.least, least, high.largest, largest, *used, slack))
        columns = self.units.headings(
            "Cable|Least tension{force}|Governs least|Largest tension{force}|Governs largest"
            "|Utilisation|Governs utilisation|Slack in"
        )
        caption = f"Envelope of the cables' tensions{self.over}"
        return Table(caption, columns, rows, "cable_envelope", even=True)

    def tensions(self) -> list[Table]:
        """Largest tension of each cable in each case, or that it is slack."""
        found = {name: {case: "slack" if one.slack else one.largest for case, one in known}
                 for name, known in self.by_name("cables")}  # fmt: skip
        return self._matrix("Largest tensions of the cables{force}", found)

    def bar_forces(self) -> list[Table]:
        """Force of each bar, or the largest of each family, in each case."""
        found = dict[str, dict[str, Cell]]()
        for label, known in self._bars(every=False):
            for case, one in sorted(known, key=lambda pair: abs(pair[1].force)):
                found.setdefault(label, {})[case] = "slack" if one.slack else one.force
        return self._matrix("Forces of the bars, compression negative{force}", found)

    def _matrix(self, caption: str, found: Mapping[str, Mapping[str, Cell]]) -> list[Table]:
        """Values by item and case, with a row for each case and up to `WIDE` items a table."""
        return [
            Table(
                caption.format_map(self.units), ["Combination", *part],
                [(case.name, *(found[name].get(case.name) for name in part))
                 for case in self.cases], small=len(part) > 8, even=True,
            )
            for part in in_parts(list(found), WIDE)
        ]  # fmt: skip

    def lengths(self) -> Table:
        """Lengths of the cables in the first case, and their contact with the membrane."""
        case, rows = self.cases[0], list[Row]()
        for name, found in self.by_name("cables"):
            governs, most = governing_of(found, lambda one: one[1].contact_largest)
            one = case.summary.cables.get(name)
            lengths = (None,) * 3 if one is None else map(
                self.units.exact, (one.length, one.L0, one.free)
            )  # fmt: skip
            contact = (most.contact_largest, governs) if most.contact_largest > 0.0 else (None,) * 2
            rows.append((name, *lengths, *contact))
        columns = self.units.headings(
            "Cable|Length{length}|Unstressed{length}|Off the membrane{length}|"
            "Largest contact force{stress}|Governs"
        )
        return Table(f"Lengths of the cables in {case.name}, and contact forces", columns, rows)

    def _bars(self, every: bool) -> Iterator[tuple[str, list[tuple[str, BarResults]]]]:
        """Each bar, or family of bars, with (case, result) pairs."""
        names = self.names("bars")
        rows = {name: [name] for name in names} if every else families(names)
        for label, own in rows.items():
            yield label, [
                (case.name, case.summary.bars[name])
                for case in self.cases for name in own if name in case.summary.bars
            ]  # fmt: skip

    def bars(self, *, every: bool = True) -> Table:
        """Forces and lengths in all cases, of each bar or of the most loaded bar of each family."""
        rows: list[Row] = []
        for label, found in self._bars(every):
            for case in dict.fromkeys(case for case, _ in found):
                own = (bar for name, bar in found if name == case)
                one = max(own, key=lambda bar: abs(bar.force))
                state = "slack" if one.slack else "tension" if one.force > 0.0 else "compression"
                used = None if one.utilisation is None else per_cent(one.utilisation)
                lengths = map(self.units.exact, (one.length, one.L0))
                rows.append((label, case, one.force, state, *lengths, one.buckling, used))
        columns = "Bar|Combination|Force{force}|State|Length{length}|Unstressed{length}"
        columns += "|Buckling load{force}|Utilisation"
        return Table("Bars", self.units.headings(columns), rows, "bars", headings=2)

    def bar_envelope(self, *, every: bool = True) -> Table:
        """Smallest and largest force of each bar, or family of bars, over all cases."""
        rows: list[Row] = []
        for label, found in self.combined._bars(every):
            least, low = governing_of(found, lambda one: -one[1].force)
            largest, high = governing_of(found, lambda one: one[1].force)
            rows.append((label, low.force, least, high.force, largest, *_most_used(found)))
        columns = self.units.headings(
            "Bar|Least force{force}|Governs least|Largest force{force}|Governs largest"
            "|Utilisation|Governs utilisation"
        )
        caption = f"Envelope of the bars' forces{self.over}"
        return Table(caption, columns, rows, "bar_envelope", even=True)

    def hollows(self) -> Table:
        """Ponding: the deepest hollow of each case."""
        rows: list[Row] = [
            (
                case.name, len(found), self.units.exact(one.depth), place(one.at, self.size),
                one.volume, one.area,
            )
            for case in self.cases for found in [case.summary.hollows] for one in found[:1]
        ]  # fmt: skip
        columns = self.units.headings(
            "Combination|Number|Depth{length}|at x; y; z{length}|Volume{volume}|Area{area}"
        )
        return Table("Ponding: places without drainage", columns, rows, "drainage")

    def ponds(self) -> Table:
        """Levels, volumes and factored weights of ponds."""
        rows: list[Row] = [
            (name, case, x.factor, x.level, x.volume, x.factor * x.weight * x.volume)
            for name, case, x in self.each("ponds")
        ]
        columns = self.units.headings(
            "Pond|Combination|Factor|Level z{length}|Volume{volume}|Weight with the factor{force}"
        )
        return Table("Ponds", columns, rows, "ponds", headings=2)

    def supports(self, *, every: bool = True) -> Table:
        """Support reactions and their sum; `every` also splits those of lines into parts."""
        rows: list[Row] = []
        names = self.names("supports")
        lists = [case.summary.supports for case in self.cases]
        if len(names) == 2 and all(  # a single group equals the sum
            set(one[names[0]].parts) == set(one[ALL_SUPPORTS].parts) for one in lists
        ):
            names = names[:1]
        for name, case, one in self.each("supports"):
            if name not in names:
                continue
            whole = name == ALL_SUPPORTS
            label = BOTH if whole and one.parts else name
            # relative to the summands of the total
            scale = max(*map(abs, (*one.total, *one.membrane)), one.mean * one.length)
            along = (one.mean, one.largest) if one.length > 0.0 else (None, None)
            rows.append((label, case, TOTAL, *clean(one.total, scale), *along))
            if one.parts and not whole and (every or one.length == 0.0):
                for part, force in {"membrane": one.membrane, **one.parts}.items():
                    size = max(map(abs, (*one.total, *force)))
                    rows.append((label, case, part, *clean(force, size), None, None))
        columns = self.units.headings(
            "Support|Combination|On|Rx{force}|Ry{force}|Rz{force}|Per length, mean{stress}|"
            "Per length, largest{stress}"
        )
        return Table("Reactions: forces of the supports", columns, rows, "supports", headings=3)

    def joints(self) -> Table:
        """Support forces on joints, including anchors of bars."""
        rows: list[Row] = [
            (name, case, *with_size(force)) for name, case, force in self.each("joints")
        ]
        columns = "Joint|Combination|Rx{force}|Ry{force}|Rz{force}|Size{force}"
        headings = self.units.headings(columns)
        return Table("Held joints: forces on them", headings, rows, "joints", headings=2)


def part_name(part: str) -> str:
    """Display name of a part."""
    return WHOLE if part == ALL else part


def families(names: Sequence[str]) -> dict[str, list[str]]:
    """Names by row label: the name itself, or "belt 1 ... belt 26" for a large family."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(re.sub(r"\d+$", "", name), []).append(name)
    shared: dict[str, list[str]] = {}
    for own in found.values():
        many = len(own) >= 10
        shared |= {f"{own[0]} ... {own[-1]}": own} if many else {name: [name] for name in own}
    return shared


def clean(force: Sequence[float], scale: float, part: float = NOISE) -> list[float]:
    """A force whose components below a fraction of a scale are set to zero."""
    return [x if abs(x) > part * scale else 0.0 for x in force]


def _most_used(found: Sequence[tuple[str, Any]]) -> tuple[str | None, str | None]:
    """The largest utilisation of a cable or bar, and its case; None without any."""
    judged = [(case, one.utilisation) for case, one in found if one.utilisation is not None]
    if not judged:
        return None, None
    case, used = governing_of(judged, lambda one: one[1])
    return per_cent(used), case


def with_size(force: Sequence[float], part: float = NOISE) -> list[float]:
    size = sum(x * x for x in force) ** 0.5
    return [*clean(force, size, part), size]


def _without_one_part(table: Table) -> Table:
    """A table without its first column if that only names the whole membrane."""
    if {row[0] for row in table.rows} != {WHOLE}:
        return table
    rows = [row[1:] for row in table.rows]
    return replace(table, columns=table.columns[1:], rows=rows, headings=1)
