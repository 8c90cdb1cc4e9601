"""The chapter "Erection": forces, lengths and shape, stage by stage, with pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from crms_fenicsx.model.tolerances import SAME_VALUE
from crms_fenicsx.results.output.report.case import Case
from crms_fenicsx.results.output.report.foundation_tables import FoundationTables
from crms_fenicsx.results.output.report.page import (
    Figure,
    Figures,
    Measured,
    PageSection,
    Paragraph,
    Table,
    in_parts,
    per_cent,
)
from crms_fenicsx.results.output.report.results_tables import (
    FINE,
    ResultTables,
    Row,
    clean,
    families,
)
from crms_fenicsx.results.output.report.verdict import MOST, NAMES, judged
from crms_fenicsx.results.quantities import QUANTITIES, SUMMED_UP

STAGES = (
    "Each stage starts from the one before it, and is in equilibrium. Displacements are those "
    "within the stage. Unstressed lengths are those of the cables and bars whose length changes. A "
    "dash stands for what is not there. While the work of a stage is done, forces may be larger "
    "than at its end."
)


def erection(
    of: ResultTables, held: FoundationTables, strain: float, factors: Table
) -> list[PageSection]:
    """The chapter on the stages of erection; none without stages."""
    stages, heads, figures = _stages(of.cases), _heads(factors), list[Figure]()
    if not stages:
        return []
    for case in stages:
        name = heads.get(case.name, case.name)
        figures += [
            replace(one, caption=one.caption.replace(case.name, name, 1)) for one in case.pictures
        ]
    tables = by_stage(of, held, strain, factors, most=MOST)
    return [PageSection("Erection", [Paragraph(STAGES), *tables, Figures(figures)])]


def by_stage(
    of: ResultTables, held: FoundationTables, strain: float, factors: Table, most: int = 0
) -> list[Table]:
    """Results by stage, a column for each, up to `most` in a table; empty without stages."""
    stages = _stages(of.cases)
    if not stages:
        return []
    heads, found = _heads(factors), list[Table]()
    rows = [row for row in _rows(replace(of, cases=stages), held, strain)
            if any(value is not None for value in row[2:])]  # fmt: skip
    for part in in_parts([*range(len(stages))], most or len(stages)):
        names = [heads.get(stages[k].name, stages[k].name) for k in part]
        own = [(*row[:2], *(row[2 + k] for k in part)) for row in rows]
        found.append(Table("Stages of erection", ("Result", "Of", *names), own, "erection",
                           headings=2, small=len(part) > MOST // 2))  # fmt: skip
    return found


def _stages(cases: Sequence[Case]) -> list[Case]:
    return sorted((case for case in cases if case.stage), key=lambda case: case.stage)


def _heads(factors: Table) -> dict[str, str]:
    """Codes and names of the stages that the page calls by their codes."""
    return {str(row[0]): f"{row[0]} {row[1]}" for row in factors.rows}


def _rows(of: ResultTables, held: FoundationTables, strain: float) -> Iterator[Row]:
    """Kind, member and values in all cases, which are the stages."""
    cases, units = of.cases, of.units
    if any(case.summary.pressure for case in cases):
        yield ("Acting", f"inner pressure{units['pressure']}",
               *(case.summary.pressure for case in cases))  # fmt: skip
    for load in dict.fromkeys(load for case in cases for load in case.summary.factors):
        yield "Acting", load, *(case.summary.factors.get(load) or None for case in cases)
    kind = f"Cable tension{units['force']}"
    for name, cables in of.by_name("cables"):
        tensions = {case: one.largest for case, one in cables}
        yield kind, name, *(tensions.get(case.name) for case in cases)
    turned = dict[str, dict[str, Measured]]()
    for name, members in [*of.by_name("cables"), *of.by_name("bars")]:
        lengths = {case: units.exact(one.L0) for case, one in members}
        if max(lengths.values()) - min(lengths.values()) > SAME_VALUE * max(lengths.values()):
            turned[name] = lengths
    kind = f"Bar force{units['force']}"
    for label, own in families(of.names("bars")).items():
        # what is tightened is listed by itself
        for names in [[name] for name in own] if turned.keys() & {*own} else [own]:
            forces = [[case.summary.bars[x].force for x in names if x in case.summary.bars]
                      for case in cases]  # fmt: skip
            yield (kind, names[0] if len(names) == 1 else label,
                   *(max(one, key=abs) if one else None for one in forces))  # fmt: skip
    for name, lengths in turned.items():
        yield (f"Unstressed length{units['length']}", name,
               *(lengths.get(case.name) for case in cases))  # fmt: skip
    yield from _membrane(of)
    yield (f"Shape{units['length']}", "displacement in the stage",
           *(units.exact(case.deflection.value) for case in cases))  # fmt: skip
    yield (f"Shape{units['length']}", "highest point, z",
           *(units.exact(case.high[2]) for case in cases))  # fmt: skip
    most = [{one[0]: one[2] for one in held.largest({case.name})} for case in cases]
    for name in dict.fromkeys(name for sizes in most for name in sizes):
        yield (f"Foundations{units['force']}", f"largest {name} force",
               *(sizes.get(name) for sizes in most))  # fmt: skip
    shares = list[dict[str, float]]()
    for case in cases:
        shares.append({})
        for one in judged([case], strain):
            name = _judged(one.what)
            shares[-1][name] = max(one.share, shares[-1].get(name, 0.0))
    for name in dict.fromkeys(_judged(what) for what in NAMES):
        if not any(name in one for one in shares):
            continue
        yield ("Utilisation", name,
               *(per_cent(one[name]) if name in one else None for one in shares))  # fmt: skip


def _judged(what: str) -> str:
    """Name of what is judged; warp and weft of the membrane share one."""
    return "Membrane" if what.startswith("fabric") else NAMES[what][0]


def _membrane(of: ResultTables) -> Iterator[Row]:
    """Rows of the membrane's section forces and state."""
    membranes = [one.summary.membrane for one in of.cases]
    kind = f"Membrane, largest{of.units['stress']}"
    for name in (name for name in SUMMED_UP if QUANTITIES[name].unit):
        every = [one.largest.get(name) for one in membranes]
        most = max((abs(x.value) for x in every if x is not None), default=0.0)
        label = QUANTITIES[name].label.replace("section force along", "along")
        values = (None if x is None else clean([x.value], most, FINE)[0] for x in every)
        yield kind, label.replace("section force", "force"), *values
    for label in ("slack", "wrinkled"):
        yield "Membrane", f"{label} area", *(per_cent(getattr(one, label)) for one in membranes)
