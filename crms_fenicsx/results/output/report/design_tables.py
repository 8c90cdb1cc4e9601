"""Tables of load factors and of design values of fabric, cables and bars, with all factors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.strengths import ALL, LIMIT_STATES, SERVICE, CableDesign, Limits
from crms_fenicsx.results.output.report.case import BASE, Case
from crms_fenicsx.results.output.report.page import WHOLE, Cell, Table, Units, number, shown
from crms_fenicsx.results.output.report.results_tables import Row

CABLES = (
    "Design values of the cables: F_Rd = min(F_uk / (1.5 gamma_R), F_k / gamma_R) by EN 1993-1-11, "
    "(6.2), or as given",
    "Cable|F_min{force}|k_e|F_uk = k_e F_min{force}|F_k{force}|gamma_R|F_Rd{force}|"
    "In service{force}",
)
"""Caption and headings of cables' design values."""

MAKE = (
    "Cable|Construction|Diameter{length}|Metallic area{area}|Modulus{pressure}|EA{force}|"
    "F_min{force}"
)
"""Headings of the make of cables."""

BARS = (
    "Design values of the bars, at their lengths in the base state",
    "Bar|Section|EI{bending}|gamma_M|N_t,Rd{force}|Curve|L_cr{length}|N_cr{force}|Slenderness|chi|"
    "N_b,Rd{force}",
)
"""Caption and headings of bars' design values."""


def _ropes(scene: Scene) -> dict[str, tuple[float, float | CableDesign | None]]:
    """EA and design value of the cables, and of guys that are judged as cables, by name."""
    known = scene.design.cables
    found = {cable.name: cable.cable.EA for cable in scene.cables}
    found |= {bar.name: bar.bar.EA for bar in scene.bars if scene.design.is_rope(bar)}
    return {name: (EA, known.get(name, known.get(ALL))) for name, EA in found.items()}


def cable_make(scene: Scene, units: Units) -> list[Row]:
    """Make of cables and guys; none where nothing but the breaking force is given."""
    rows: list[Row] = [
        (name, one.construction or None, one.diameter and units.exact(one.diameter), one.area,
         one.modulus, EA, one.breaking)
        for name, (EA, one) in _ropes(scene).items() if isinstance(one, CableDesign)
    ]  # fmt: skip
    return rows if any(any(x is not None for x in row[1:5]) for row in rows) else []


def cable_values(scene: Scene) -> list[Row]:
    """Design values of cables and guys by EN 1993-1-11, or as given; none of cables without."""
    rows = list[Row]()
    for name, (_, one) in _ropes(scene).items():
        if isinstance(one, CableDesign):
            broken = one.breaking * one.ending
            rows.append((
                name, one.breaking, one.ending, broken, one.proof, one.gamma_R,
                one.of(LIMIT_STATES[0]), one.of(SERVICE[0]),
            ))  # fmt: skip
        else:
            rows.append((name, *(None,) * 5, one, None))
    return rows if any(row[6] is not None for row in rows) else []


def bar_values(bars: Iterable[PlacedBar], units: Units) -> list[Row]:
    """Design values of the bars, in compression by EN 1993-1-1, 6.3.1, at their present lengths."""
    return [_bar(bar, units) for bar in bars]


def _bar(bar: PlacedBar, units: Units) -> Row:
    of = bar.bar
    first: Row = bar.name, of.section, of.EI, of.gamma_M if of.strength else None, of.strength
    chi = None if of.tension_only else of.reduction(bar.length)
    if chi is None or of.strength is None:
        return *first, *(None,) * 6
    length, euler = of.buckling_length or bar.length, bar.buckling
    slender = None if euler is None else math.sqrt(of.strength * of.gamma_M / euler)
    curve = of.curve if isinstance(of.curve, str) else "given"
    return *first, curve, units.exact(length), euler, slender, chi, chi * of.strength


def alike(table: Table) -> Table:
    """The table with a row for members in turn whose values are shown alike."""
    rows = list[Sequence[Cell]]()
    for _, group in groupby(table.rows, key=lambda row: [shown(cell) for cell in row[1:]]):
        own = list(group)
        names = [str(row[0]) for row in own]
        label = f"{names[0]} ... {names[-1]}" if len(names) > 2 else ", ".join(names)
        rows.append((label, *own[0][1:]))
    return replace(table, rows=rows)


def fabric_values(cases: Sequence[Case], units: Units) -> Table:
    """Design strengths of the membrane with their factors, and the combinations that have them."""
    designs = [
        (case.name, part, one) for case in cases for part, one in case.summary.design.items()
    ]
    divided = [one for *_, one in designs if one.divisor != 1.0]  # others are as given
    factors = list(dict.fromkeys(name for one in divided for name in one.factors))
    found = dict[tuple[Cell, ...], list[str]]()
    for name, part, one in designs:
        given = one.strength if divided else (None, None)
        own = [one.factors.get(x) if one in divided else None for x in factors]
        found.setdefault((part or WHOLE, *given, *own, *one.design), []).append(name)
    columns = units.headings("Part|f_k warp{stress}|f_k weft{stress}") + factors
    columns += units.headings("f_d warp{stress}|f_d weft{stress}|Combinations")
    every = sum(bool(case.summary.design) for case in cases)
    rows: list[Row] = [
        (*key, "all" if len(names) == every else ", ".join(names)) for key, names in found.items()
    ]
    return Table("Design strengths of the membrane", columns, rows, small=bool(divided))


def limits_in_service(limits: Limits, units: Units) -> list[Row]:
    """The limits in service, in words."""
    given = [
        *(("Largest deflection", part, f"{number(x)}{units.plain('length')}")
          for part, x in limits.deflection.items()),
        *(("Least prestress, quasi-permanent", part, f"{number(x)}{units.plain('stress')}")
          for part, x in limits.prestress.items()),
    ]  # fmt: skip
    rows: list[Row] = [
        (f"{name}{f' of {part}' if part else ''}", text) for name, part, text in given
    ]
    if limits.slope is not None:
        rows.append(("Least slope for drainage, quasi-permanent", f"{number(limits.slope)}°"))
    if limits.water is not None:
        rows.append(("Deepest standing water", f"{number(limits.water)}{units.plain('length')}"))
    return rows


def load_factors(
    cases: Sequence[Case], units: Units, pressure: float, factors: Mapping[str, float]
) -> Table:
    """Pressure and load factors of the cases and the base state, which has these."""
    acting = [(case.name, case.summary.pressure, case.summary.factors) for case in cases]
    every = [one for one, case in zip(acting, cases, strict=True) if not case.stage]
    divided = {
        case.name: max(one.divisor for one in case.summary.design.values())
        for case in cases
        if case.summary.design
    }
    reduced = any(x != 1.0 for x in divided.values())
    of = {case.name: case for case in cases}
    unchanged = pressure, factors, 1.0, ()
    base = [one for one in every if of[one[0]].acting == unchanged]
    if every and not base:
        base = [("base state", pressure, factors)]
    every = base + [one for one in every if one not in base]
    first = 1 if len(every) == 1 and base[0][0] != "base state" else 0
    codes = [f"LC{k}" for k in range(first, len(every) + first)]
    codes += [f"S{case.stage}" for case in cases if case.stage]
    every += [one for one, case in zip(acting, cases, strict=True) if case.stage]
    loads = list(dict.fromkeys(load for _, _, known in every for load in known))
    pressed = any(p for _, p, _ in every)
    tight = any(case.prestress != 1.0 for case in cases)
    rows: list[Row] = [
        (
            code,
            "base state" if name == BASE else name,
            (of[name].state or None) if name in of else None,
            of[name].prestress if name in of and tight else None,
            (", ".join(of[name].without) or None) if name in of else None,
            p if pressed else None,
            *(known.get(load) or None for load in loads),
            divided.get(name) if reduced else None,
        )
        for code, (name, p, known) in zip(codes, every, strict=True)
    ]
    columns = units.headings(
        "Case|Combination|Limit state|Prestress|Without|Inner pressure{pressure}"
    )
    columns += [*loads, "Strengths divided by"]
    caption = f"{'Inner pressure and factors' if pressed else 'Factors'} of the loads"
    return Table(caption, columns, rows, "combinations", small=len(loads) > 4)
