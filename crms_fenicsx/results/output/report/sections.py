"""Sections of a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from crms_fenicsx.model.strengths import LIMIT_STATES
from crms_fenicsx.results.cable_order import Order
from crms_fenicsx.results.design_checks import governing_of
from crms_fenicsx.results.output.report.case import BASE, Case
from crms_fenicsx.results.output.report.combination_tables import combination_sections
from crms_fenicsx.results.output.report.design_tables import alike, fabric_values
from crms_fenicsx.results.output.report.erection import by_stage, erection
from crms_fenicsx.results.output.report.foundation_tables import (
    FoundationTables,
    anchors,
    cables_to_order,
    clamps,
)
from crms_fenicsx.results.output.report.model_tables import PRESSED, Model, in_families, versions
from crms_fenicsx.results.output.report.page import (
    LARGEST,
    WHOLE,
    BarChart,
    Figure,
    Figures,
    Link,
    Notes,
    PagePart,
    PageSection,
    Paragraph,
    Signatures,
    Table,
    Units,
    number,
    page,
    per_cent,
)
from crms_fenicsx.results.output.report.results_tables import ResultTables, Row
from crms_fenicsx.results.output.report.verdict import (
    NAMES,
    OF_MEMBRANE,
    governing,
    judged,
    listed,
    verdict_on,
    with_unit,
)
from crms_fenicsx.results.output.report.verification_tables import (
    CHECKED,
    nearest_to_limits,
    verdicts,
    verification,
)

FORCES_ON = (
    "Forces act on the foundations: upward is uplift. Directions in plan are counted from the x "
    "axis towards y; the inclination is positive upward. Ends of cables, bars and held points that "
    "meet at one place are added up; forces of a foundation with several such places act at their "
    "centre, with the moments Mx, My and Mz about it. Held edges carry the membrane's other "
    "forces; a vertex of two groups counts with the larger one. The plans show horizontal forces "
    "as arrows, forces per length beside the rim, to one scale, and vertical forces as numbers "
    "where there are up to 30 foundations. Orange is uplift, blue is downward. The CSV files have "
    "all combinations."
)
PONDING = (
    "Rain cannot drain from these places over an edge of the roof. Depth, volume and area are "
    "those of the pond filled to overflowing, in the shape of the combination; under the weight of "
    "the water the roof sinks further."
)
PATCHES = (
    "At these corners forces enter the membrane at a point, and its section forces grow without "
    "limit as triangles become smaller. Within the radius the plain fabric is not judged by its "
    "strength: reinforce it with further layers, belts or a plate for the forces of the supports, "
    "cables and bars there. The utilisation of plain fabric there depends on the mesh."
)
NOTES = (
    "Section forces are true (Cauchy) forces per current length, positive in tension. The major "
    "and minor ones are principal values; warp and weft are along the current warp and normal to "
    "it, and shear refers to these two. Each triangle has one value, so that the largest values at "
    "corners, anchors and cables grow as the mesh becomes finer. Smoothed values are means over "
    "neighbouring triangles; a single-cell peak exceeds the largest of these by a quarter.",
    "Utilisation of the membrane is the larger ratio of the section forces along warp and weft to "
    "the design strengths for them; in isotropic material, of the major principal section force "
    "to the strength. It is judged at vertices, from means over the triangles around them of the "
    "same material and strengths, outside of the reinforced corners. The change by finer cells is "
    "how much the triangles around the largest value differ from the means at their corners. "
    "Design strengths f_d are the given ones f_k divided by all factors of their table. Shear is "
    "not included. For bars in compression the "
    "resistance is reduced by the factor of their buckling curve (EN 1993-1-1, 6.3.1, between "
    "hinges) or the one given; otherwise it is left out. Serviceability states are not judged by "
    "strengths.",
    "Slack and wrinkled shares are parts of the stress-free area: a wrinkled triangle is in "
    "tension in one direction only, a slack one in none.",
    "Deflections are displacements from the base state, LC0 unless another one is named, of stages "
    "from the one before, or from the stress-free shape where named so. Forces on the rim per "
    "length are those of each vertex over the length of held edges that belongs to it, with those "
    "of cables that pass over it.",
    "Loads of fixed direction, such as weight and snow, keep their forces as the shape changes; "
    "wind and inner pressure stay normal to the surface. Cables and bars have no weight but that "
    "of named loads.",
    "Contact forces of cables are those along the membrane's normal, per length of cable, smoothed "
    "over a few triangles.",
)
"""Notes on reading the results."""

STRAIN = "The limit of the strain, {}, is the report's, not a code's."


@dataclass(frozen=True)
class Plan:
    """Contents of a report: the options of `Solver.report`."""

    path: Path  # of the page
    title: str = "Membrane structure"  # title, about: heading, and entries below it
    about: Mapping[str, str] = field(default_factory=dict)
    basis: Mapping[str, str] = field(default_factory=dict)  # of design: codes, sites, factors
    unit: str = ""
    force: str = ""
    pictures: Sequence[str] | None = None  # colours of the membrane
    view: tuple[float, float] = (-60.0, 30.0)
    sections: Sequence[PageSection] = ()  # additional ones
    order: Order | None = None  # lengths of the cables to be made
    # joints, or cables with "start" or "end", by foundation
    foundations: Mapping[str, Sequence[str]] = field(default_factory=dict)
    strain_limit: float = 0.1  # limit of the major principal strain
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
        return ResultTables(self.cases, self.plan.units, self.model.size)

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
        """The page: each section of one subject."""
        plan, strain = self.plan, STRAIN.format(per_cent(self.plan.strain_limit))
        sections = [
            self._summary(),
            *self._basis(),
            *self._model(),
            *self._membrane(),
            *self._members(),
            *self._foundations(),
            *erection(self.results, self.held, plan.strain_limit, self.factors),
            *plan.sections,
            PageSection("Verification", self._verification()),
            PageSection("Notes", [Notes([*NOTES[:-1], f"{NOTES[-1]} {strain}"])]),
        ]  # fmt: skip
        return page(
            plan.title, self._about(), sections, Path(plan.template) if plan.template else None
        )

    def _verification(self) -> list[PagePart]:
        """The checks of equilibrium, where there were any."""
        checks = nearest_to_limits(self.cases)
        return [*([Paragraph(CHECKED)] if checks.rows else []), verdicts(self.cases),
                *([checks] if checks.rows else [])]  # fmt: skip

    def _about(self) -> list[tuple[str, str]]:
        """Entries below the title: the user's, units, date and program."""
        plan, found = self.plan, dict(self.plan.about)
        date, *program = versions(self.model.ranks)
        if plan.unit or plan.force:
            found["Units"] = ", ".join(x for x in (plan.unit, plan.force) if x)
        return [*(found | dict([date]) | found | dict(program)).items()]

    def _summary(self) -> PageSection:
        """The verdict, what governs, and lines for signatures."""
        plan, about = self.plan, self.plan.about
        verdict = verdict_on(self.cases, self.model.size, plan.strain_limit, plan.units)
        roles = {"Prepared by": "Author", "Checked by": "Checker"}
        signed = [(role, about.get(key, ""), "") for role, key in roles.items()]
        return PageSection("Summary", [verdict, self._governing(), Signatures(signed)])

    def _governing(self) -> Table:
        """The largest utilisation of each limit state and kind of check; deflections and forces on
        foundations, which have no limit here."""
        plan, rows = self.plan, list[Row]()
        units = plan.units
        every = judged(self.cases, plan.strain_limit)
        limited = {one.state for one in every if one.what == "deflection"}
        for one in governing(every):
            effect, limit = (with_unit(one.what, x, units) for x in (one.effect, one.limit))
            member = one.member or (WHOLE if one.what in OF_MEMBRANE else "")
            rows.append((one.state, NAMES[one.what][0], member, effect, limit,
                         per_cent(one.share), one.case))  # fmt: skip
        for state in dict.fromkeys(case.state for case in self.cases):
            own = [case for case in self.cases if case.state == state]
            most = governing_of(own, lambda case: case.deflection.value)
            if state not in limited and most.deflection.value > 0.0:
                size = f"{number(most.deflection.value)}{units.plain('length')}"
                rows.append((state, "Deflection", WHOLE, size, None, None, most.name))
            rows += [
                (state, f"Foundation, {kind}", label, f"{number(size)}{units.plain('force')}",
                 None, None, case)
                for kind, label, size, case in self.held.largest({case.name for case in own})
            ]  # fmt: skip
        states = list(dict.fromkeys(str(row[0]) for row in rows))
        rows.sort(key=lambda row: [*LIMIT_STATES, ""].index(str(row[0])))
        columns = ("Limit state", "Verification", "Governing member", "Effect", "Limit",
                   "Utilisation", "Combination")  # fmt: skip
        caption = "Governing verifications"
        if states == [""]:
            return Table(caption, columns[1:], [row[1:] for row in rows], "governing")
        # the base state belongs to no limit state
        rows = [(row[0] or "not named", *row[1:]) for row in rows if row[0] or row[-1] != BASE]
        return Table(caption, columns, rows, "governing", headings=2)

    def _basis(self) -> list[PageSection]:
        """What the user and the loads say of codes, sites and factors."""
        rows = [*self.plan.basis.items(), *self.model.basis.items()]
        below = combination_sections(self.model.combined)
        given = [Table("Codes, site and loads", ("Item", "Data"), rows)] if rows else []
        return [PageSection("Basis of design", given), *below] if rows or below else []

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
        found += [self._governing(), self.held.lines(), self.held.balance()]
        found.append(verification(self.cases))
        found += by_stage(of, self.held, self.plan.strain_limit, self.factors)
        if of.names("cables"):
            found += [of.cables(), of.cable_envelope(), anchors(of)]
        if of.names("bars"):
            found += [of.bars(), of.bar_envelope()]
        more = [clamps(of), of.joints(), of.ponds(), of.patches()]
        more += [self.held.places(), self.held.forces(), self.held.envelope(), self.held.rim()]
        if self.plan.order is not None:
            more.append(cables_to_order(self.plan.order, of.units))
        own = [*combination_sections(self.model.combined), *self.plan.sections]
        more += [part for one in own for part in one.body if isinstance(part, Table) and part.name]
        return found + [table for table in more if table.rows]

    def _tensions(self) -> BarChart:
        """Chart of the cables' tensions over all combinations."""
        found = [
            (name, min(x.least for _, x in cases), max(x.largest for _, x in cases))
            for name, cases in self.results.combined.by_name("cables")
        ]
        where = self.results.over or (", over all combinations" if len(self.cases) > 1 else "")
        return BarChart(f"Least to largest tension{where}{self.plan.units['force']}", found)

    def _model(self) -> list[PageSection]:
        model = self.model
        tables = {name: one for name, one in model.tables.items() if one.rows}
        if "bars" in tables:
            tables["bars"] = in_families(tables["bars"])
        if not any(case.summary.pressure for case in self.cases):
            kept = [row for row in tables["mesh"].rows if row[0] != PRESSED]
            tables["mesh"] = replace(tables["mesh"], rows=kept)
        below = [tables[x] for x in ("supports", "cables", "bars", "joints") if x in tables]
        design = [fabric_values(self.cases, self.plan.units)]
        design += [alike(tables[x]) for x in ("cable make", "cable values", "bar values")
                   if x in tables]  # fmt: skip
        design += [tables[x] for x in ["limits"] if x in tables]
        design = [one for one in design if one.rows]
        return [
            PageSection("Materials and design values", [tables["materials"], *design]),
            PageSection("Model", [*model.pictures, tables["mesh"], *below]),
            PageSection("Loads", [*([tables["loads"]] if "loads" in tables else []),
                                  Figures(model.loads)]),
            PageSection("Combinations", [self.factors, *self._other_bases()]),
        ]  # fmt: skip

    def _other_bases(self) -> list[PagePart]:
        """Base states of combinations that do not start from LC0."""
        units, found = self.plan.units, dict[str, list[str]]()
        for case in (one for one in self.cases if one.base is not None):
            pressure, factors = case.base  # type: ignore[misc]
            acting = [f"{name} {number(x)}" for name, x in factors.items() if x]
            if pressure:
                acting.insert(0, f"inner pressure {number(pressure)}{units.plain('pressure')}")
            found.setdefault(", ".join(acting) or "no load", []).append(case.name)
        return [
            Paragraph(f"Base state of {listed(names)} instead of LC0: {text}.")
            for text, names in found.items()
        ]

    def _membrane(self) -> list[PageSection]:
        of, several = self.results, len(self.cases) > 1
        over = of.over.removeprefix(",") or " over all combinations"
        text = f"Least and largest values{over}, with the governing combination."
        intro = [Paragraph(text)] if several else []
        every = {case.name: case.summary.membrane.largest for case in self.cases}
        used = [(name, 0.0, 100.0 * largest["utilisation"].value) for name, largest in every.items()
                if "utilisation" in largest]  # fmt: skip
        chart = BarChart("Largest utilisation of the membrane [%]", used, limit=100.0)
        tables = [of.envelope(), of.overview(), of.section_forces()]
        found = [PageSection("Membrane", [*intro, *tables, chart])]
        patches, ponds = of.patches(), of.hollows()
        if patches.rows:
            found.append(PageSection("Reinforced corners", [Paragraph(PATCHES), patches], 3))
        dry = Paragraph("No place without drainage in any combination.")
        found.append(
            PageSection("Drainage", [Paragraph(PONDING), ponds] if ponds.rows else [dry], 3)
        )
        figures = [one for case in self.cases if not case.stage for one in case.pictures]
        same = "Colours have the same scale in all combinations." if several else ""
        if not all(case.stage or case.pictures for case in self.cases):
            same += " Pictures are of the base state and of governing combinations."
        if self.left_out:
            same += f" {self.left_out} pictures are left out, as the page would be too large."
        links = [Link(f"{case.name}, interactive view", file)
                 for case, file in zip(self.cases, self._files, strict=True)
                 if case.view]  # fmt: skip
        if figures or links or self.left_out:
            told = [Paragraph(same.strip())] if same else []
            body: list[PagePart] = [*told, *links, Figures(figures)]
            found.append(PageSection("Pictures", body, 3))
        return found

    def _members(self) -> list[PageSection]:
        of, several, found = self.results, len(self.cases) > 1, []
        if of.names("cables"):
            tables = [of.cable_envelope(), *of.tensions(), of.lengths(), clamps(of)]
            used = [table for table in tables if table.rows]
            found.append(PageSection("Cables", [self._tensions(), *used]))
        if of.names("bars"):
            body = [of.bar_envelope(every=False), *of.bar_forces()] if several else [
                of.bars(every=False)
            ]  # fmt: skip
            found.append(PageSection("Bars", body))
        if of.names("ponds"):
            found.append(PageSection("Ponds", [of.ponds()]))
        return found

    def _foundations(self) -> list[PageSection]:
        held, order = self.held, self.plan.order
        tables = [held.places(), held.envelope(), held.governing(), held.lines_by_case(),
                  held.rim(), held.balance_by_case()]  # fmt: skip
        body: list[PagePart] = [Paragraph(FORCES_ON), Figures(self.plans)]
        body += [table for table in tables if table.rows]
        found = [PageSection("Foundations and anchors", body)]
        if order is not None:
            table = cables_to_order(order, self.plan.units)
            found.append(PageSection("Fabrication lengths of the cables", [table]))
        return found
