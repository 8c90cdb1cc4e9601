"""Sections of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from crms_fenicsx.results.cable_order import Order
from crms_fenicsx.results.output.report.case import Case, verdict_on
from crms_fenicsx.results.output.report.foundation_tables import (
    FoundationTables,
    anchors,
    cables_to_order,
    clamps,
)
from crms_fenicsx.results.output.report.model_tables import Model, in_families, versions
from crms_fenicsx.results.output.report.page import (
    LARGEST,
    BarChart,
    Figure,
    Figures,
    KeyFigures,
    Link,
    Notes,
    PagePart,
    PageSection,
    Paragraph,
    Table,
    Units,
    number,
    page,
    per_cent,
)
from crms_fenicsx.results.output.report.results_tables import ResultTables

FORCES_ON = (
    "Forces are those on the foundations: upward is uplift. Directions in plan are counted from "
    "the x axis towards y; the inclination is positive upward. Ends of cables, bars and held "
    "points that meet at one place are added up; forces of a foundation with several such places "
    "act at their centre, together with the moments Mx, My and Mz about it. Lines of held edges "
    "carry the membrane's other forces; a vertex of two groups counts with the larger one. The "
    "plans show horizontal forces as arrows, forces per length beside the rim, and vertical forces "
    "as numbers, all to one scale. Orange is uplift, blue is downward."
)
HOLLOWS = (
    "Rain cannot drain from these places over an edge of the roof. Depth, volume and area are "
    "those of the hollow filled to overflowing, in the shape of the combination; under the "
    "weight of the water the roof sinks further."
)
PATCHES = (
    "At these corners forces enter the membrane at a point, and its forces grow without limit as "
    "triangles become smaller. Within the radius the plain fabric is not judged by its strength: "
    "reinforce it with further layers, belts or a plate for the forces of the supports, cables and "
    "bars there. The utilisation of plain fabric there depends on the mesh."
)
NOTES = (
    "Section forces are true (Cauchy) forces per current length, positive in tension. The larger "
    "and smaller ones are principal values; warp and weft are along the current warp and normal to "
    "it, and shear refers to these two. Each triangle has one value, so that the largest values at "
    "corners, anchors and cables grow as the mesh becomes finer. Smoothed values are means over "
    "neighbouring triangles; a single-cell peak exceeds the largest of these by a quarter.",
    "Utilisation is the larger ratio of the section forces along warp and weft to the strengths "
    "given for them; in isotropic material, of the larger principal force to the strength. It is "
    "judged at vertices, from means over the triangles around them of the same material and "
    "strengths, outside of the reinforced corners, where forces grow without limit as triangles "
    "become smaller. The change by finer cells is how much the triangles around the largest value "
    "differ from the means at their corners. Strengths must contain all partial factors; where "
    "factors of loads are given, they are divided by the largest one that acts. Shear is not "
    "included. For bars in compression the strength is reduced by the factor of their buckling "
    "curve (EN 1993-1-1, 6.3.1, between hinges) or the one given; otherwise it is left out.",
    "Slack and wrinkled shares are parts of the stress-free area: a wrinkled triangle is in "
    "tension in one direction only, a slack one in none.",
    "Deflections are displacements from the stress-free shape. Forces on the rim per length are "
    "those of each vertex over the length of held edges that belongs to it; they include the "
    "forces of cables that pass over the rim.",
    "Loads of fixed direction, such as weight and snow, keep their forces as the shape changes; "
    "wind and inner pressure stay normal to the surface.",
    "Contact forces of cables are those along the membrane's normal, per length of cable, smoothed "
    "over a few triangles.",
    "Each equilibrium is checked independently of the solver: virtual work by differences of the "
    "energy, balance of supports and loads, tensions and places of cables. A doubtful check "
    "means that the mesh is coarse there, or that forces of one part are too small beside the "
    "others to be accurate, not that the state is not in equilibrium.",
)
"""Notes on reading the results."""


def with_codes(cases: Sequence[Case], factors: Table) -> list[Case]:
    """The cases; if a name is long, renamed to their codes LC0, LC1 ... and in that order."""
    codes = {str(row[1]): str(row[0]) for row in factors.rows}
    if max(len(case.name) for case in cases) < 28:
        return list(cases)
    order = list(codes)
    return [
        replace(case, name=codes[case.name], pictures=tuple(
            replace(one, caption=one.caption.replace(case.name, codes[case.name], 1))
            for one in case.pictures
        ))
        for case in sorted(cases, key=lambda case: order.index(case.name))
    ]  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """Contents of a report: the options of `Solver.report`."""

    path: Path  # of the page
    title: str = "Membrane structure"  # title, about: heading, and entries below it
    about: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    force: str = ""
    cable_strengths: Mapping[str, float] = field(default_factory=dict)  # by name (force)
    pictures: Sequence[str] | None = None  # colours of the membrane
    view: tuple[float, float] = (-60.0, 30.0)
    sections: Sequence[PageSection] = ()  # additional ones
    order: Order | None = None  # lengths of the cables to be made
    # joints, or cables with "start" or "end", by foundation
    foundations: Mapping[str, Sequence[str]] = field(default_factory=dict)
    strain_limit: float = 0.1  # limit of the larger principal strain
    template: str | Path | None = None  # jinja2 template of the page
    pdf: bool = False  # whether to print the page to PDF, too
    interactive: bool = False  # whether to write interactive pages

    @property
    def units(self) -> Units:
        """Units of length and force."""
        return Units(self.unit, self.force)

    @property
    def look(self) -> dict[str, Any]:
        """Options of `draw` common to all pictures."""
        return {"unit": self.unit, "force": self.force, "view": self.view}


@dataclass(frozen=True)
class Report:
    """Contents of a report."""

    plan: Plan
    model: Model  # with its pictures
    cases: Sequence[Case]  # one or more
    factors: Table  # load factors, with the cases' codes and names
    plans: Sequence[Figure] = ()  # of the foundation forces
    left_out: int = 0  # number of pictures omitted for lack of room

    @property
    def results(self) -> ResultTables:
        """Tables of the cases."""
        plan = self.plan
        return ResultTables(self.cases, plan.units, self.model.size, plan.cable_strengths)

    @property
    def held(self) -> FoundationTables:
        """Tables of the forces on foundations."""
        return FoundationTables(self.cases, self.plan.units, self.plan.foundations)

    @property
    def views(self) -> dict[str, str]:
        """Interactive pages by file name."""
        named = zip(self._files, self.cases, strict=True)
        return {file: case.view for file, case in named if case.view}

    @property
    def _files(self) -> list[str]:
        return [f"{self.plan.path.stem}_view_{k}.html" for k in range(1, len(self.cases) + 1)]

    def html(self) -> str:
        """The HTML page, with as many pictures as fit."""
        bare = replace(self, cases=[replace(case, pictures=()) for case in self.cases])
        room, left_out, cases = LARGEST - len(bare._page().encode()), 0, []
        for case in self.cases:
            need = np.cumsum([1000 + len(one.png) * 4 // 3 for one in case.pictures])
            fitting = case.pictures[: int(np.count_nonzero(need <= room))]
            room -= int(need[len(fitting) - 1]) if fitting else 0
            left_out += len(case.pictures) - len(fitting)
            cases.append(replace(case, pictures=fitting))
        return replace(self, cases=cases, left_out=left_out)._page()

    def _page(self) -> str:
        results, plan = self.results, self.plan
        about = [*plan.about.items()]
        if plan.unit or plan.force:
            about.append(("Units", ", ".join(x for x in (plan.unit, plan.force) if x)))
        about += versions(self.model.ranks)
        verdict = verdict_on(self.cases, self.model.size, plan.strain_limit, plan.cable_strengths)
        every = {case.name: case.summary.membrane.largest for case in self.cases}
        used = [(name, 0.0, largest["utilisation"].value) for name, largest in every.items()
                if "utilisation" in largest]  # fmt: skip
        chart = BarChart("Largest utilisation of the membrane", used, limit=1.0)
        sections = [
            PageSection("Summary", [verdict, KeyFigures(self._cards()), chart]),
            *self._model(),
            *self._results(),
            *self._forces(),
            *plan.sections,
            PageSection("Verification", [results.verdicts(), *results.nearest_to_limits()]),
            PageSection("Notes", [Notes(NOTES)]),
        ]
        return page(plan.title, about, sections, Path(plan.template) if plan.template else None)

    def tables(self) -> list[Table]:
        """The tables for CSV files."""
        of = self.results
        found = [
            self.factors,
            of.overview(),
            of.membrane(),
            of.envelope(),
            of.hollows(),
            of.supports(),
        ]
        found += [self.held.lines(), self.held.balance()]
        found.append(of.verification())
        if of.names("cables"):
            found += [of.cables(), of.cable_envelope(), anchors(of)]
        if of.names("bars"):
            found += [of.bars(), of.bar_envelope()]
        more = [clamps(of), of.joints(), of.ponds(), of.patches()]
        more += [self.held.places(), self.held.forces(), self.held.envelope()]
        if self.plan.order is not None:
            more.append(cables_to_order(self.plan.order, of.units))
        more += [part for one in self.plan.sections for part in one.body if isinstance(part, Table)]
        return found + [table for table in more if table.rows]

    def _cards(self) -> list[tuple[str, str, str]]:
        """Key figures: title, value, and the governing case or cable."""
        units, summaries = self.plan.units, {case.name: case.summary for case in self.cases}
        membranes = {name: one.membrane for name, one in summaries.items()}
        cards = []

        def card(what: str, unit: str | None, found: Mapping[str, float]) -> None:
            name = max(found, key=lambda one: found[one], default="")
            if name and found[name] != 0.0:
                text = f"{number(found[name])} {unit}".rstrip()
                cards.append((what, per_cent(found[name]) if unit is None else text, name))

        used = {name: one.largest.get("utilisation") for name, one in membranes.items()}
        shares = {name: one.value for name, one in used.items() if one is not None}
        card("Largest utilisation of the membrane", None, shares)
        forces = {name: one.largest["true force 1"].value for name, one in membranes.items()}
        card("Largest principal section force", units["stress"].strip(" []"), forces)
        tensions = {
            f"{cable}, {name}": one.largest
            for name, summary in summaries.items()
            for cable, one in summary.cables.items()
        }
        card("Largest tension of a cable", units.force, tensions)
        moved = {name: one.displacement.value for name, one in summaries.items()}
        card("Largest deflection", units.length, moved)
        wrinkled = {name: one.wrinkled for name, one in membranes.items()}
        card("Largest wrinkled area", None, wrinkled)
        card("Largest slack area", None, {name: one.slack for name, one in membranes.items()})
        return cards

    def _tensions(self) -> BarChart:
        """Chart of the cables' tensions over all combinations."""
        found = [
            (name, min(x.least for _, x in cases), max(x.largest for _, x in cases))
            for name, cases in self.results.by_name("cables")
        ]
        where = " over all combinations" if len(self.cases) > 1 else ""
        return BarChart(f"Least to largest tension{where}{self.plan.units['force']}", found)

    def _model(self) -> list[PageSection]:
        model = self.model
        tables = {name: one for name, one in model.tables.items() if one.rows}
        if "bars" in tables:
            tables["bars"] = in_families(tables["bars"])
        made, held = ("materials", "strengths"), ("supports", "cables", "bars", "joints")
        below = [tables[x] for x in held if x in tables]
        text = "Inner pressure and load factors."
        return [
            PageSection("Model", [*model.pictures, tables["mesh"]]),
            PageSection("Materials", [tables[x] for x in made if x in tables], 3),
            PageSection("Supports, cables and bars", below, 3),
            PageSection("Loads", [*([tables["loads"]] if "loads" in tables else []),
                                  Figures(model.loads), Paragraph(text), self.factors]),
        ]  # fmt: skip

    def _results(self) -> list[PageSection]:
        found, same, several = [], "", len(self.cases) > 1
        if several:
            text = "Least and largest values over all combinations, with the governing combination."
            body: list[PagePart] = [Paragraph(text), self.results.envelope()]
            body.append(self.results.overview())
            found.append(PageSection("Envelope of the membrane", body))
            same = "Colours have the same scale in all combinations."
        patches = self.results.patches()
        if patches.rows:
            found.append(PageSection("Reinforced corners", [Paragraph(PATCHES), patches]))
        hollows = self.results.hollows()
        dry = Paragraph("No ponding in any combination.")
        found += [PageSection("Rain", [Paragraph(HOLLOWS), hollows] if hollows.rows else [dry])]
        if self.left_out:
            same += f" {self.left_out} pictures are left out, as the page would be too large."
        body = [
            *([Paragraph(same)] if same else []),
            *([] if several else [self.results.overview()]),
        ]
        found.append(PageSection("Membrane by combination", body))
        titles = {name: f"{code}: {name}" for code, name, *_ in self.factors.rows}
        titles |= {code: f"{code}: {name}" for code, name, *_ in self.factors.rows}
        for case, file in zip(self.cases, self._files, strict=True):
            body = [Figures(case.pictures), self.results.of_case(case)]
            if case.view:
                body.insert(0, Link("Interactive 3D view", file))
            found.append(PageSection(titles[case.name], body, 3))
        return found

    def _forces(self) -> list[PageSection]:
        of, several, found = self.results, len(self.cases) > 1, []
        if of.names("cables"):
            envelopes = [of.cable_envelope()] if several or of.strengths else []
            tables = [*envelopes, of.cables(), clamps(of)]
            used = [table for table in tables if table.rows]
            found.append(PageSection("Cables", [self._tensions(), *used]))
        if of.names("bars"):
            envelopes = [of.bar_envelope(every=False)] if several else []
            found.append(PageSection("Bars", [*envelopes, of.bars(every=False)]))
        if of.names("ponds"):
            found.append(PageSection("Ponds", [of.ponds()]))
        held = self.held
        tables = [held.forces(), held.lines(), held.places(), held.balance()]
        body: list[PagePart] = [Paragraph(FORCES_ON)]
        body += [table for table in [held.envelope()] if table.rows]
        body += [Figures(self.plans), *(table for table in tables if table.rows)]
        found.append(PageSection("Foundations and anchors", body))
        order = self.plan.order
        if order is not None:
            found.append(PageSection("Cables to order", [cables_to_order(order, of.units)]))
        return found
