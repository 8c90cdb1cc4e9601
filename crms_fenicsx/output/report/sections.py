"""What a report says, section by section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from crms_fenicsx.output.figures.draw_scene import COLOURS
from crms_fenicsx.output.report import net_tables
from crms_fenicsx.output.report import results_tables as tabulate
from crms_fenicsx.output.report.case import TENSION, Case
from crms_fenicsx.output.report.model_tables import Model, in_families, versions
from crms_fenicsx.output.report.page import (
    LARGEST,
    PageSection,
    Table,
    bars,
    figure,
    figures,
    key_figures,
    number,
    page,
    paragraph,
    per_cent,
)
from crms_fenicsx.output.report.results_tables import Units
from crms_fenicsx.results.cable_order import Order

NOTES = (
    "Membrane forces are true (Cauchy) forces per current length, positive in tension. The larger "
    "and smaller ones are principal values; warp and weft are along the current warp and square to "
    "it, shear belongs to these two. Each triangle has one value, so that largest values at "
    "corners, anchors and cables grow as the mesh becomes finer.",
    "Utilisation is the larger ratio of the membrane forces along warp and weft to the strengths "
    "given for them, which must contain all partial factors. Shear is not part of it.",
    "Slack and wrinkled shares are parts of the stress-free area: a wrinkled triangle is in "
    "tension in one direction only, a slack one in none.",
    "Deflections are displacements from the stress-free shape. Reactions are forces that supports "
    "exert on all that meets there: on the membrane, and on ends of cables and bars. Per length "
    "they are forces on the membrane over the length of held edges that belongs to each vertex; "
    "they contain what cables hand on there that pass over. Groups may share vertices.",
    "Contact forces of cables are those along the membrane's normal, per length of cable, smoothed "
    "over a few triangles.",
    "Each equilibrium is checked independently of the solver: virtual work by differences of the "
    "energy, balance of supports and loads, tensions and places of cables. A check that is "
    "doubtful tells that the mesh is coarse there, or that forces of one part are too small beside "
    "the others to be known well, not that the state is no equilibrium.",
)
"""How to read the results."""
PER_PICTURE = 1000
"""Bytes of the page that a picture takes beside its own."""


def _shows(colour: str) -> str:
    """What a picture shows."""
    return "axial forces of cables and bars" if colour == TENSION else COLOURS[colour].label


@dataclass(frozen=True)
class Report:
    """All that a report is made of."""

    title: str  # title, about: heading, and names and texts below it
    about: Sequence[tuple[str, str]]
    units: Units  # names of the units
    model: Model  # what was computed, with its picture
    cases: Sequence[Case]  # what came of it, one or more
    # by the cables' names (force)
    cable_strengths: Mapping[str, float] = field(default_factory=dict)
    left_out: int = 0  # how many pictures there is no room for
    order: Order | None = None  # lengths of the cables to be made
    # ends of cables and joints that foundations carry, by the names of these
    foundations: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def html(self) -> str:
        """The page, with as many pictures as there is room for."""
        bare = replace(self, cases=[replace(case, pictures=()) for case in self.cases])
        room, cases = LARGEST - len(bare._page().encode()), []
        for case in self.cases:
            need = [PER_PICTURE + len(one.png) * 4 // 3 for one in case.pictures]
            fitting = [one for k, one in enumerate(case.pictures, 1) if sum(need[:k]) <= room]
            room -= sum(need[: len(fitting)])
            cases.append(replace(case, pictures=tuple(fitting)))
        left_out = sum(len(case.pictures) for case in self.cases)
        left_out -= sum(len(case.pictures) for case in cases)
        return replace(self, cases=cases, left_out=left_out)._page()

    def _page(self) -> str:
        units = self.units
        about = list(self.about)
        if units.length or units.force:
            about.append(("Units", ", ".join(x for x in (units.length, units.force) if x)))
        about += versions(self.model.ranks)
        sections = [
            PageSection(
                "Summary", [self._verdict(), key_figures(self._cards()), self._utilisation()]
            ),
            *self._model(),
            PageSection(
                "Combinations",
                [
                    paragraph("Pressure, and what each load at the factor 1 is multiplied by."),
                    tabulate.factors(self.cases, units),
                    tabulate.overview(self.cases, units),
                ],
            ),
            *self._results(),
            *self._forces(),
            PageSection(
                "Verification",
                [
                    self._verdict(),
                    tabulate.verdicts(self.cases),
                    tabulate.nearest_to_limits(self.cases),
                ],
            ),
            PageSection("Notes", [*map(paragraph, NOTES)]),
        ]
        return page(self.title, about, sections)

    def tables(self) -> list[Table]:
        """The tables that become CSV files."""
        cases, units = self.cases, self.units
        found = [
            tabulate.factors(cases, units),
            tabulate.overview(cases, units),
            tabulate.membrane(cases, units),
            tabulate.envelope(cases, units, self.model.size),
            tabulate.supports(cases, units),
            tabulate.verification(cases),
        ]
        if tabulate.names_of(cases, "cables"):
            found += [
                tabulate.cables(cases, units),
                tabulate.cable_envelope(cases, units, self.cable_strengths),
                net_tables.anchors(cases, units),
            ]
        if tabulate.names_of(cases, "bars"):
            found += [
                tabulate.forces_of_bars(cases, units),
                tabulate.bar_envelope(cases, units),
            ]
        more = [
            net_tables.clamps(cases, units),
            tabulate.joints(cases, units),
            tabulate.ponds(cases, units),
        ]
        if self.order is not None:
            more.append(net_tables.order(self.order, units))
        more.append(net_tables.foundations(cases, units, self.foundations))
        return found + [table for table in more if table.rows]

    def _verdict(self) -> str:
        known = {case.name: case.verification for case in self.cases}
        moved = [case.name for case in self.cases if not case.summary.in_equilibrium]
        failed = [name for name, one in known.items() if one is not None and not one.passed]
        missing = [name for name, one in known.items() if one is None]
        doubtful = [name for name, one in known.items() if one is not None and one.doubtful]
        count = f"{len(known)} combinations" if len(known) > 1 else "the state"
        if moved:
            why = "the scene has been changed since its last load step, or there was none"
            return paragraph(f"Not in equilibrium: {', '.join(moved)}; {why}.", "verdict failed")
        if failed:
            return paragraph(f"Not verified: {', '.join(failed)} failed a check.", "verdict failed")
        warned = {case.name: case.summary.warnings for case in self.cases}
        told = [f"{name}: {one}" for name, found in warned.items() for one in found]
        if told:
            return paragraph(f"Equilibrium, but {'; '.join(told)}", "verdict failed")
        if missing:
            text = f"Not verified in this run: {', '.join(missing)}."
            return paragraph(text, "verdict doubtful")
        if doubtful:
            text = (
                f"The equilibrium of {count} is verified; crude in places: {', '.join(doubtful)}."
            )
            return paragraph(text, "verdict doubtful")
        return paragraph(f"Verified: {count} passed all checks of equilibrium.", "verdict")

    def _cards(self) -> list[tuple[str, str, str]]:
        cases, units = self.cases, self.units
        cards = []

        def card(what: str, unit: str, found: Mapping[str, float], share: bool = False) -> None:
            name = max(found, key=lambda one: found[one])
            if found[name] == 0.0:
                return
            text = per_cent(found[name]) if share else f"{number(found[name])} {unit}".rstrip()
            cards.append((what, text, name))

        membranes = {case.name: case.summary.membrane for case in cases}
        if all("utilisation" in one.largest for one in membranes.values()):
            used = {name: one.largest["utilisation"].value for name, one in membranes.items()}
            card("Largest utilisation of the membrane", "", used, share=True)
        stress = units["stress"].strip(" []")
        forces = {name: one.largest["true force 1"].value for name, one in membranes.items()}
        card("Largest principal membrane force", stress, forces)
        if tabulate.names_of(cases, "cables"):
            tensions = {
                f"{cable}, {case.name}": one.largest
                for case in cases
                for cable, one in case.summary.cables.items()
            }
            card("Largest tension of a cable", units.force, tensions)
        card("Largest deflection", units.length,
             {case.name: case.summary.displacement.value for case in cases})  # fmt: skip
        card("Largest wrinkled area", "",
             {name: one.wrinkled for name, one in membranes.items()}, share=True)  # fmt: skip
        card("Largest slack area", "",
             {name: one.slack for name, one in membranes.items()}, share=True)  # fmt: skip
        return cards

    def _utilisation(self) -> str:
        """Chart of the membrane's utilisation by combination; "" without strengths."""
        every = {case.name: case.summary.membrane.largest for case in self.cases}
        used = [(name, 0.0, largest["utilisation"].value) for name, largest in every.items()
                if "utilisation" in largest]  # fmt: skip
        return bars("Largest utilisation of the membrane", used, limit=1.0)

    def _tensions(self) -> str:
        """Chart of the cables' tensions over all combinations."""
        found = []
        for name in tabulate.names_of(self.cases, "cables"):
            one = [case.summary.cables[name] for case in self.cases if name in case.summary.cables]
            found.append((name, min(x.least for x in one), max(x.largest for x in one)))
        where = " over all combinations" if len(self.cases) > 1 else ""
        return bars(f"Least to largest tension{where}{self.units['force']}", found)

    def _model(self) -> list[PageSection]:
        model, picture = self.model, []
        if model.picture:
            picture = [figure(model.picture, model.caption, "model")]
        tables = {name: one for name, one in model.tables.items() if one.rows}
        if "bars" in tables:
            tables["bars"] = in_families(tables["bars"])
        made, held = ("materials", "strengths"), ("supports", "cables", "bars", "joints", "loads")
        return [
            PageSection("Model", [*picture, tables["mesh"]]),
            PageSection("Materials", [tables[x] for x in made if x in tables], 3),
            PageSection(
                "Supports, cables, bars and loads", [tables[x] for x in held if x in tables], 3
            ),
        ]

    def _results(self) -> list[PageSection]:
        cases, units, size = self.cases, self.units, self.model.size
        found = []
        if len(cases) > 1:
            text = "Least and largest values over all combinations, and which of them governs."
            table = tabulate.envelope(cases, units, size)
            found.append(PageSection("Envelope of the membrane", [paragraph(text), table]))
        same = "Colours have the same scale in all combinations." if len(cases) > 1 else ""
        if self.left_out:
            same += f" {self.left_out} pictures are left out, as the page would be too large."
        found.append(PageSection("Membrane by combination", [paragraph(same)] if same else []))
        for case in cases:
            shown = [figure(one.png, f"{case.name}: {_shows(one.colour)}") for one in case.pictures]
            table = tabulate.of_case(case, units, size)
            found.append(PageSection(case.name, [figures(shown), table], 3))
        return found

    def _forces(self) -> list[PageSection]:
        cases, units = self.cases, self.units
        found = []
        if tabulate.names_of(cases, "cables"):
            tables: list[str | Table] = [tabulate.cables(cases, units)]
            if len(cases) > 1 or self.cable_strengths:
                tables.insert(0, tabulate.cable_envelope(cases, units, self.cable_strengths))
            clamps = net_tables.clamps(cases, units)
            tables += [clamps] if clamps.rows else []
            found.append(PageSection("Cables", [self._tensions(), *tables]))
        if tabulate.names_of(cases, "bars"):
            tables = [tabulate.bar_envelope(cases, units, every=False)] if len(cases) > 1 else []
            tables.append(tabulate.forces_of_bars(cases, units, every=False))
            found.append(PageSection("Bars", tables))
        ponds = tabulate.ponds(cases, units)
        if ponds.rows:
            found.append(PageSection("Ponds", [ponds]))
        more = [
            net_tables.anchors(cases, units),
            tabulate.joints(cases, units),
            net_tables.foundations(cases, units, self.foundations),
        ]
        held = [
            tabulate.supports(cases, units, every=False),
            *(table for table in more if table.rows),
        ]
        found.append(PageSection("Supports and anchors", held))
        if self.order is not None:
            found.append(PageSection("Cables to order", [net_tables.order(self.order, units)]))
        return found
