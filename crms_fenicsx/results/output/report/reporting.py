"""Write a report of states or load combinations, by one call on all ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.steps.load_cases import (
    Combination,
    back_to_now,
    checked_states,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import absolute, make_writable, replaced
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.results.cable_order import Order
from crms_fenicsx.results.output.figures.axes3d import check_view
from crms_fenicsx.results.output.figures.draw_scene import COLOURS
from crms_fenicsx.results.output.report.case import (
    BASE,
    Case,
    Shape,
    case_of,
    in_order,
    shape_of,
    with_codes,
)
from crms_fenicsx.results.output.report.combination_tables import tables_of
from crms_fenicsx.results.output.report.design_tables import load_factors
from crms_fenicsx.results.output.report.model_tables import Model, merged, model_of_scene
from crms_fenicsx.results.output.report.page import (
    MACROS,
    PageSection,
    check_printing,
    check_template,
    print_page,
)
from crms_fenicsx.results.output.report.pictures import (
    TENSION,
    check_interactive,
    force_figures,
    load_figures,
    model_figures,
    outline_in_plan,
    pictured,
    with_pictures,
    with_view,
)
from crms_fenicsx.results.output.report.sections import Plan, Report
from crms_fenicsx.results.quantities import QUANTITY_OF, Solved, names_of

NOW = "Current state"
"""Case name in a report without combinations."""


def checked_plan(comm: MPI.Intracomm, scene: Scene, filename: str | Path, **options: Any) -> Plan:
    """Checked options of a report. Collective on `comm`."""
    for name in options:
        checks.one_of("report: option", name, [one.name for one in fields(Plan)][1:])
    plan = Plan(Path(), **options)
    plan = replace(plan, about=plan.about or {}, basis=plan.basis or {})
    for name in ("title", "unit", "force"):
        checks.of_type(f"report: {name}", getattr(plan, name), str)
    for name, given, example in (
        ("about", plan.about, '{"Project": "Tent"}'), ("basis", plan.basis, '{"Codes": "EN 1990"}'),
    ):  # fmt: skip
        checks.collection(f"report: {name}", given, Mapping, example)
        for text in (text for pair in given.items() for text in pair):
            checks.of_type(f"report: {text!r} in {name}", text, str)
    further = plan.sections
    if not isinstance(further, Sequence) or not all(isinstance(x, PageSection) for x in further):
        raise InputError(
            f"report: sections = {plan.sections!r}; pass what patterns.report_sections returned."
        )
    if plan.order is not None and not isinstance(plan.order, Order):
        raise InputError(
            f"report: order = {plan.order!r}; pass what nets.lengths_to_order(...) returned."
        )
    foundations = _checked_foundations(scene, plan.foundations)
    pictures = _checked_pictures(scene, plan.pictures)
    check_view(plan.view)
    checks.positive("report: strain_limit", plan.strain_limit)
    checks.of_type("report: pdf", plan.pdf, bool)
    checks.of_type("report: interactive", plan.interactive, bool)
    path = absolute(Path(filename), comm)
    with raised_together(comm):  # last, as it creates the folder
        if comm.rank == 0:
            if path.suffix.lower() not in (".html", ".htm"):
                raise InputError(
                    f"report: filename = {str(path)!r} is not a page; pass a name with .html."
                )
            if path.is_dir():
                raise InputError(f"report: {path} is a folder; pass the name of a file in it.")
            make_writable(path.parent)
            if plan.pdf:
                check_printing()
            if plan.interactive:
                check_interactive()
            if plan.template is not None and not Path(plan.template).is_file():
                raise InputError(
                    f"report: there is no template {str(plan.template)!r}; pass a file of jinja2, "
                    'which may begin with {% extends "report.html" %}.'
                )
            if path.name == MACROS or (plan.template and path == Path(plan.template).absolute()):
                raise InputError(
                    f"report: filename = {str(path)!r} is a template's name; use another name."
                )
            if plan.template is not None:
                check_template(Path(plan.template).absolute())
    return replace(
        plan, path=path, pictures=pictures, foundations=foundations,
        template=None if plan.template is None else Path(plan.template).absolute(),
    )  # fmt: skip


def _checked_foundations(
    scene: Scene, foundations: Mapping[str, Sequence[str]] | None
) -> dict[str, Sequence[str]]:
    """Members carried by each foundation."""
    known = {f"{cable.name} {end}" for cable in scene.cables for end in ("start", "end")}
    known |= {joint.name for joint in scene.joints}
    foundations = {} if foundations is None else foundations
    if not isinstance(foundations, Mapping):
        raise InputError(
            f"report: foundations = {foundations!r}; write names of cables' ends and of joints by "
            'foundation, {"F1": ["A1 start", "B1 end"]}.'
        )
    for name, members in foundations.items():
        unknown = [one for one in members if one not in known]
        if unknown or isinstance(members, str):
            raise InputError(
                f"report: the foundation {name!r} carries {unknown or members!r}; pass a list of "
                'ends of cables, such as "A1 start", and of names of joints.'
            )
    return {str(name): tuple(members) for name, members in foundations.items()}


def _checked_pictures(scene: Scene, pictures: Sequence[str] | None) -> tuple[str, ...]:
    """Checked colours of the pictures; by default those that apply to the scene."""
    known = names_of(scene.membrane)
    if pictures is None:
        forces = ("warp", "weft") if "warp" in known else ("stress",)
        lines = (TENSION,) if scene.cables or scene.bars else ()
        return (*lines, "displacement", *forces, *({"utilisation"} & {*known}))
    checks.collection("report: pictures", pictures, Sequence, 'pictures=["stress"]')
    for colour in pictures:
        checks.one_of("report: one of pictures", colour, (TENSION, *COLOURS))
        if QUANTITY_OF.get(colour, known[0]) not in known:
            raise InputError(
                "report: pictures has 'utilisation', but there are no strengths; call "
                "scene.set_strengths(...) first."
                if colour == "utilisation"
                else f"report: pictures has {colour!r}, but the membrane is isotropic and has no "
                'warp; use "stress" and "stress 2".'
            )
    return tuple(pictures)


def results_of(solver: Solved, states: Mapping[str, Combination]) -> list[Case]:
    """Results of the combinations, or of the current state if there are none. Collective."""
    cases = list[Case]()
    if not states:
        with back_to_now(solver):
            if solver.base is not None:
                solver.restore(solver.base)
            before = shape_of(solver.scene)
        return [case_of(solver, NOW, before)]
    shapes, bases = dict[int, Shape](), dict[int, tuple[float, Mapping[str, float]]]()
    with back_to_now(solver):
        for name, one in _stages_last(states).items():
            if id(one.base) not in shapes:
                solver.restore(one.base)
                shapes[id(one.base)] = shape_of(solver.scene)
                bases[id(one.base)] = solver.scene.pressure, solver.scene.factors
                if not cases and not one.stage and BASE not in states:
                    # of no limit state, also where it is a stage of erection
                    cases.append(replace(case_of(solver, BASE, shapes[id(one.base)]), state=""))
            solver.restore(one.snapshot)
            case = case_of(solver, name, shapes[id(one.base)])
            own, first = bases[id(one.base)], next(iter(bases.values()))
            other = None if one.stage or own == first else own
            cases.append(replace(case, stage=one.stage, base=other))
    combined = [one for one in cases if not one.stage or one is cases[0]]
    base, acting = cases[0], [one.acting for one in combined]
    known = base.name == BASE and acting[0] not in acting[1:] and base.summary.in_equilibrium
    return cases if known or base.name != BASE else cases[1:]


def drawn(
    solver: Solved, plan: Plan, states: Mapping[str, Combination], cases: Sequence[Case],
    every: Sequence[Case],
) -> list[Case]:  # fmt: skip
    """The cases with pictures in the colour scales of `every` case. Collective."""
    found, colours = [], plan.pictures or ()
    own = pictured([case for case in every if not case.stage], colours)
    own |= {case.name: list(colours[:1]) for case in every if case.stage}
    with back_to_now(solver):
        for case in cases:
            if states:
                one = states.get(case.name)
                first = next(iter(_stages_last(states).values()))
                solver.restore(first.base if one is None else one.snapshot)
            alike = [one for one in every if bool(one.stage) == bool(case.stage)]
            shown = with_pictures(solver, case, alike, own.get(case.name, ()), plan.look)
            if plan.interactive:
                shown = with_view(solver, shown, every, colours, plan.units)
            found.append(shown)
    return found


def model_of(solver: Solved, plan: Plan, states: Mapping[str, Combination]) -> Model:
    """The model in the combinations' base states and after the stages of erection, or the current
    one. Collective."""
    base, now = solver.base, solver.scene.versions.current
    if not states:
        model = model_of_scene(solver.scene, plan.units)
        if base is None or base.version.model_version != now.model_version:
            return _pictured(solver, plan, model, "The model in its current state")
        with back_to_now(solver):
            solver.restore(base)
            return _pictured(solver, plan, model, "The model in its base state, before its loads")
    names = dict[int, list[str]]()
    combined = {name: one for name, one in states.items() if not one.stage}
    for name, one in combined.items():
        names.setdefault(one.base.version.model_version, []).append(name)
    first, caption = next(iter(combined.values()), None), "The model in its base state"
    stages = sorted(states.keys() - combined.keys(), key=lambda name: -states[name].stage)
    if first is None:
        shown, caption = states[stages[0]].snapshot, f"The model after {stages[0]}"
    else:
        shown = first.base
        alike = [name for name, one in combined.items() if one.base.version == shown.version]
        if len(alike) < len(combined):
            caption = f"The model in the base state of {', '.join(alike)}"
    with back_to_now(solver):
        models = {}
        for own in [*names.values(), *([name] for name in stages)]:
            one = states[own[0]]
            solver.restore(one.snapshot if one.stage else one.base)
            models[", ".join(own)] = model_of_scene(solver.scene, plan.units)
        model = replace(merged(models, stages), combined=tables_of(states))
        solver.restore(shown)
        return _pictured(solver, plan, model, caption)


def _stages_last(states: Mapping[str, Combination]) -> dict[str, Combination]:
    """Combinations, then stages of erection, both in their order."""
    return dict(sorted(states.items(), key=lambda one: one[1].stage))


def _pictured(solver: Solved, plan: Plan, model: Model, caption: str) -> Model:
    """A model with pictures of the scene's current state. Collective."""
    scene = solver.scene
    if not scene.in_equilibrium():
        caption += f" ({UNBALANCED})"
    figures = model_figures(solver, caption, plan.unit, plan.look)
    loads = load_figures(solver, plan.units, plan.look)
    return replace(model, pictures=figures, loads=loads, outline=outline_in_plan(scene))


def write_files(solver: Solved, plan: Plan, model: Model, cases: Sequence[Case]) -> None:
    """Write the page and its tables, replacing old files once all are complete. Collective."""
    with raised_together(solver.comm):
        if solver.comm.rank == 0:
            factors = load_factors(cases, plan.units, model.pressure, model.factors)
            cases = in_order(cases, factors)
            report = Report(plan, model, cases, factors)
            path, tables = plan.path, report.tables()
            report = replace(report, cases=with_codes(cases, factors))
            report = replace(report, plans=force_figures(report.held, model.outline))
            texts = {path: report.html()}
            texts |= {path.with_name(name): page for name, page in report.views.items()}
            for table in tables:
                texts[path.with_name(f"{path.stem}_{table.name}.csv")] = table.csv()
            with ExitStack() as files:
                for file, text in texts.items():
                    files.enter_context(replaced(file)).write_text(text, encoding="utf-8")
                if plan.pdf:
                    pdf = files.enter_context(replaced(path.with_suffix(".pdf")))
                    print_page(texts[path], pdf)


def write_report(
    solver: Solved, filename: str | Path, combinations: Mapping[str, Combination] | None = None,
    **options: Any,
) -> None:  # fmt: skip
    """Write a report of combinations or the current state; options as `Plan`. Collective."""
    states = checked_states("report", solver.scene, combinations)
    plan = checked_plan(solver.comm, solver.scene, filename, **options)
    model, cases = model_of(solver, plan, states), results_of(solver, states)
    write_files(solver, plan, model, drawn(solver, plan, states, cases, cases))
