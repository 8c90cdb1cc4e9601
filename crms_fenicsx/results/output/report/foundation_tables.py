"""Tables of the forces on foundations, grouped by points where cables, bars and supports meet;
of clamps, anchors and cables to order."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import numpy as np

from crms_fenicsx.results.cable_and_bar_results import Force, triple
from crms_fenicsx.results.cable_order import Order
from crms_fenicsx.results.design_checks import governing_of
from crms_fenicsx.results.foundations import FoundationPoint
from crms_fenicsx.results.output.report.case import Case
from crms_fenicsx.results.output.report.page import Table, Units
from crms_fenicsx.results.output.report.results_tables import ResultTables, Row, clean, with_size

DIRECTION = "Horizontal{force}|Direction in plan [deg]|Inclination [deg]"
"""Headings of a force's horizontal component and angles."""
NOTHING = 1e-3
"""Components below this fraction of the largest are shown as zero."""
STATIONS = 40
"""Largest number of places along the rim in its table."""


@dataclass(frozen=True)
class FoundationTables:
    """Foundation forces of all load cases."""

    cases: Sequence[Case]
    units: Units
    # names of cable ends and joints, by foundation
    carried: Mapping[str, Sequence[str]]

    @cached_property
    def points(self) -> dict[str, dict[str, FoundationPoint]]:
        """Foundation points by foundation and case; those outside `carried` are F1, F2 ..."""
        of_case = {case.name: case.foundations.points for case in self.cases}
        every = [point for points in of_case.values() for point in points]
        first = {one.members: one.at for one in reversed(every)}
        # where a member is missing or not yet there, the place stays the same foundation
        largest = sorted(every, key=lambda one: -len(one.members))
        whole = {key: next(one for one in largest if {*key} <= {*one.members}) for key in first}
        rest = {
            one.members
            for one in whole.values() if not any(self._carries(x, one) for x in self.carried)
        }  # fmt: skip
        centre = np.mean([*first.values()], axis=0) if first else np.zeros(3)
        order = sorted(rest, key=lambda key: _angle(triple(np.subtract(first[key], centre))))
        numbers = (name for k in count(1) if (name := f"F{k}") not in self.carried)
        labels = dict(zip(order, numbers, strict=False))
        found: dict[str, dict[str, FoundationPoint]] = {}
        for name in (*self.carried, *labels.values()):
            for case, points in of_case.items():
                own = [
                    x for x in points
                    if labels.get(whole[x.members].members) == name
                    or self._carries(name, whole[x.members])
                ]  # fmt: skip
                if own:
                    found.setdefault(name, {})[case] = _summed(own)
        return found

    def _carries(self, name: str, point: FoundationPoint) -> bool:
        """Whether a named foundation carries the members at a point."""
        return bool({*self.carried.get(name, ())} & {*point.members, *point.joints})

    def places(self) -> Table:
        """Positions of the foundations, and the members that meet there."""
        rows: list[Row] = [
            (
                label, *map(self.units.exact, clean(one.at, max(map(abs, one.at)), 1e-4)),
                ", ".join(re.sub("^(start|end) of ", "", name) for name in one.members),
            )
            for label, found in self.points.items()
            for one in [max(found.values(), key=lambda one: len(one.members))]
        ]  # fmt: skip
        columns = self.units.headings("Foundation|x{length}|y{length}|z{length}|Attached")
        return Table("Foundation points", columns, rows, "foundation_points")

    def forces(self) -> Table:
        """Forces on the foundations, by combination; moments if one has several points."""
        every = self.points.items()
        turned = any(any(one.moment) for _, found in every for one in found.values())
        rows: list[Row] = [
            (
                label, case, *with_size(one.force, NOTHING), *_inclined(one.force),
                *(clean(one.moment, math.hypot(*one.moment), NOTHING) if turned else ()),
            )
            for label, found in every for case, one in found.items()
        ]  # fmt: skip
        columns = self.units.headings(
            "Foundation|Combination|Fx{force}|Fy{force}|Fz{force}|Size{force}|"
            + DIRECTION
            + ("|Mx{energy}|My{energy}|Mz{energy}" if turned else "")
        )
        caption = "Forces on the foundations"
        return Table(caption, columns, rows, "foundations", headings=2, even=True)

    def governing(self) -> Table:
        """Forces and moments in those combinations in which a foundation's are largest."""
        every = self.forces()
        of = dict[str, set[str]]()
        for label, found in self.points.items():
            up, down, *others = self._governing(found)
            lift = {up} if found[up].force[2] > 0.0 else set()
            of[label] = {*others, *lift, *({down} if found[down].force[2] < 0.0 else ())}
        rows = [row for row in every.rows if str(row[1]) in of[str(row[0])]]
        caption = "Forces on the foundations in their governing combinations"
        return replace(every, caption=caption, rows=rows, name="")

    @staticmethod
    def _governing(found: Mapping[str, FoundationPoint]) -> tuple[str, str, str, str]:
        """Combinations of the largest uplift, downward, horizontal and total force."""
        up, down, flat, most = (
            governing_of(found, lambda name, of=of: of(found[name].force))  # type: ignore[misc]
            for of in (
                lambda f: f[2], lambda f: -f[2], lambda f: math.hypot(f[0], f[1]),
                lambda f: math.dist(f, (0.0, 0.0, 0.0)),
            )
        )  # fmt: skip
        return up, down, flat, most

    def largest(self, cases: Collection[str] | None = None) -> list[tuple[str, str, float, str]]:
        """Kind of force, foundation, size (force) and combination of the largest of all or some
        cases by name."""
        kinds = {"uplift": 1, "downward": 3, "horizontal": 5}
        found, every = [], self.envelope(cases).rows
        for kind, k in kinds.items():
            rows = [(row[k], str(row[0]), str(row[k + 1])) for row in every]
            sizes = [(size, label, case) for size, label, case in rows if isinstance(size, float)]
            if sizes:
                size, label, case = governing_of(sizes, lambda one: one[0])
                found.append((kind, label, size, case))
        return found

    def rim(self) -> Table:
        """Forces per length along the held edges: the largest at each of up to `STATIONS` places,
        with the combination."""
        first, rows = self.cases[0].foundations, list[Row]()
        ends, caption = first.rim.reshape(-1, 3), "Forces per length on the held edges"
        if not len(ends):
            return Table(caption, (), [])
        near = 1e-9 * float(np.ptp(ends, axis=0).max())
        places, where = np.unique(np.round(ends / near), axis=0, return_index=True)
        turn = np.arctan2(*(places - places.mean(axis=0))[:, 1::-1].T)
        order = np.argsort(turn, kind="stable")
        chosen = where[order[:: math.ceil(len(order) / STATIONS)]]
        for k in map(int, chosen):
            own = {
                case.name: triple(case.foundations.per_length.reshape(-1, 3)[k])
                for case in self.cases if case.foundations.rim.shape == first.rim.shape
            }  # fmt: skip
            governs, most = governing_of(own.items(), lambda one: math.hypot(*one[1]))
            up, (_, _, lift) = governing_of(own.items(), lambda one: one[1][2])
            size = math.hypot(*most)
            rows.append((
                *map(self.units.exact, triple(ends[k])), *clean(most, size, NOTHING),
                size, governs, *((lift, up) if lift > NOTHING * size else (None, None)),
            ))  # fmt: skip
        columns = self.units.headings(
            "x{length}|y{length}|z{length}|fx{stress}|fy{stress}|fz{stress}|Size{stress}|Governs|"
            "Largest uplift{stress}|Governs uplift"
        )
        return Table(caption, columns, rows, "rim", even=True)

    def envelope(self, cases: Collection[str] | None = None) -> Table:
        """Governing combinations of each foundation, of all or some cases by name."""
        rows: list[Row] = []
        for label, points in self.points.items():
            found = {name: x for name, x in points.items() if cases is None or name in cases}
            if not found:
                continue
            up, down, flat, most = self._governing(found)
            lift, push = found[up].force[2], -found[down].force[2]
            noise = 1e-6 * math.hypot(*found[most].force)
            rows.append((
                label, *((lift, up) if lift > noise else (None, None)),
                *((push, down) if push > noise else (None, None)),
                math.hypot(*found[flat].force[:2]), flat, math.hypot(*found[most].force), most,
            ))  # fmt: skip
        columns = self.units.headings(
            "Foundation|Uplift{force}|Governs|Downward{force}|Governs|Horizontal{force}|Governs|"
            "Size{force}|Governs"
        )
        stages = any(case.stage for case in self.cases)
        caption = "Largest forces on the foundations"
        caption += " over all combinations and stages of erection" if stages else ""
        return Table(caption, columns, rows, "foundation_envelope", even=True)

    def lines(self) -> Table:
        """Forces on lines of held edges, without those on points."""
        rows: list[Row] = []
        names = [one.name for case in self.cases for one in case.foundations.lines]
        for name in dict.fromkeys(names):
            for case in self.cases:
                for one in (one for one in case.foundations.lines if one.name == name):
                    scale = max(*map(abs, one.force), one.mean * one.length)
                    along = (one.length, one.mean, one.largest) if one.length else (None,) * 3
                    rows.append((name, case.name, *clean(one.force, scale, NOTHING), *along))
        columns = self.units.headings(
            "Line|Combination|Fx{force}|Fy{force}|Fz{force}|Length{length}|"
            "Per length, mean{stress}|Per length, largest{stress}"
        )
        return Table(
            "Forces of the membrane on its held edges", columns, rows, "support_lines", headings=2,
            even=True,
        )  # fmt: skip

    def lines_by_case(self) -> Table:
        """Forces on lines of held edges in the cases in which the line's are largest."""
        every, kept = self.lines(), dict[str, set[str]]()
        for name in dict.fromkeys(row[0] for row in every.rows):
            own = [row for row in every.rows if row[0] == name]
            for k in (2, 3, 4, 6):  # sums, and the mean per length
                one = governing_of(own, lambda row, k=k: abs(row[k] or 0.0))  # type: ignore[misc]
                kept.setdefault(str(name), set()).add(str(one[1]))
        rows = [row for row in every.rows if str(row[1]) in kept[str(row[0])]]
        caption = f"{every.caption}, in their governing combinations"
        return replace(every, caption=caption, rows=rows, name="")

    def balance_by_case(self) -> Table:
        """Sums of all loads and of all foundation forces, a row for each case."""
        rows: list[Row] = []
        for case in self.cases:
            of = case.foundations
            loads = np.sum([(0.0, 0.0, 0.0), *of.loads.values()], axis=0).tolist()
            acting = [*of.loads.values(), *(one.force for one in of.points)]
            scale = max([abs(x) for one in acting for x in one], default=0.0)
            rows.append((
                case.name, *clean(loads, scale, NOTHING), *clean(of.total, scale, NOTHING),
                f"{max(of.unbalanced, 1e-8):.0e}",
            ))  # fmt: skip
        columns = self.units.headings(
            "Combination|Loads, Fx{force}|Fy{force}|Fz{force}|Foundations, Fx{force}|Fy{force}|"
            "Fz{force}|Balanced to"
        )
        return Table("Balance of loads and foundations", columns, rows, even=True)

    def balance(self) -> Table:
        """Sums of the loads and of all foundation forces."""
        rows: list[Row] = []
        for case in self.cases:
            of = case.foundations
            scale = max([abs(x) for one in of.loads.values() for x in one], default=0.0)
            for name, force in of.loads.items():
                rows.append((case.name, name, *clean(force, scale, NOTHING)))
            words = "to 1e-08" if of.unbalanced <= 1e-8 else f"to {of.unbalanced:.1e}"
            rows.append(
                (case.name, f"all foundations (balanced {words})", *clean(of.total, scale, NOTHING))
            )
        columns = self.units.headings("Combination|Sum of|Fx{force}|Fy{force}|Fz{force}")
        return Table("Balance of loads and foundations", columns, rows, "balance", headings=2)


def _summed(points: Sequence[FoundationPoint]) -> FoundationPoint:
    """Points of one foundation, summed up, with their moment about the mean of their places."""
    places, forces = (np.array([getattr(one, x) for one in points]) for x in ("at", "force"))
    centre = places.mean(axis=0)
    return FoundationPoint(
        tuple(name for one in points for name in one.members),
        triple(centre),
        triple(forces.sum(axis=0)),
        tuple(name for one in points for name in one.joints),
        triple(np.cross(places - centre, forces).sum(axis=0)),
    )


def _inclined(force: Force) -> tuple[float | None, float | None, float]:
    """Horizontal component, direction in plan from the x axis and inclination (degrees)."""
    x, y, z = clean(force, math.hypot(*force), NOTHING)
    flat = math.hypot(x, y)
    return flat, (_angle((x, y)) if flat else None), math.degrees(math.atan2(z, flat))


def _angle(way: Sequence[float]) -> float:
    """Direction in plan from the x axis, 0 to 360 degrees."""
    return math.degrees(math.atan2(way[1], way[0])) % 360.0


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
        (name, which, case.name, *with_size(force), *_inclined(force))
        for name in results.names("cables") for which in ("start", "end") for case in cases
        if (force := getattr(case.summary.cables.get(name), which, None)) is not None
    ]  # fmt: skip
    columns = results.units.headings(
        "Cable|End|Combination|Rx{force}|Ry{force}|Rz{force}|Size{force}|" + DIRECTION
    )
    return Table("Anchors: forces on the cables' ends", columns, rows, "anchors", headings=3)


def cables_to_order(cables: Order, units: Units) -> Table:
    """Manufacturing lengths and marks of cables."""
    kinds = ["", "force", "length", "force", "length", "", "", "length", "length", "length"]
    columns = [name + units[kind] for name, kind in zip(cables.COLUMNS, kinds, strict=True)]
    rows = [
        [
            units.exact(cell) if kind == "length" and isinstance(cell, float) else cell
            for cell, kind in zip(row, kinds, strict=True)
        ]
        for row in cables.rows()
    ]
    start, end = cables.allowance
    kelvin = f"{abs(cables.temperature):g} K {'below' if cables.temperature < 0.0 else 'above'}"
    caption = (
        f"Fabrication lengths of the cables, measured at {kelvin} the "
        f"model's temperature; cut with allowances of {start:g} and {end:g}"
    )
    return Table(caption, columns, rows, "order")
