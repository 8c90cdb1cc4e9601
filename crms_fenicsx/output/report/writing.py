"""The steps to a report: results of each combination, pictures in one scale, the files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Protocol

from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.output.figures.scene import HasSystem
from crms_fenicsx.output.report.arguments import Plan
from crms_fenicsx.output.report.case import SHARPEST, Case, case_of, draw_png, with_pictures
from crms_fenicsx.output.report.contents import Model, Report
from crms_fenicsx.output.report.files import write
from crms_fenicsx.output.report.model_data import ModelData, merged, model_data
from crms_fenicsx.runtime.errors import raised_together
from crms_fenicsx.runtime.readonly import ReadOnly
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.load_cases import Combination
from crms_fenicsx.steps.snapshot import Snapshot

MOST_NAMES = 12
"""Up to so many cables and bars have their names in the picture of the model."""
NOW = "Current state"
"""Name of the case of a report without combinations."""


class Reported(HasSystem, Protocol):
    """A `Solver`, which lies above this module."""

    scene: ReadOnly[Scene]
    base: Snapshot | None

    def snapshot(self) -> Snapshot:
        """The current state."""

    def restore(self, snapshot: Snapshot) -> None:
        """Bring the scene back to a state."""


def results_of(solver: Reported, states: Mapping[str, Combination]) -> list[Case]:
    """Results of combinations, or of the current state if there are none. Collective."""
    if not states:
        return [case_of(solver, NOW)]
    cases = []
    with back_to_now(solver):
        for name, one in states.items():
            solver.restore(one.snapshot)
            cases.append(case_of(solver, name))
    return cases


def drawn(
    solver: Reported, plan: Plan, states: Mapping[str, Combination], cases: Sequence[Case],
    every: Sequence[Case],
) -> list[Case]:  # fmt: skip
    """The cases with pictures in the scale of `every` case. Collective."""
    if not states:
        return [with_pictures(solver, case, every, plan.colours, plan.look) for case in cases]
    pictured = []
    with back_to_now(solver):
        for case in cases:
            solver.restore(states[case.name].snapshot)
            pictured.append(with_pictures(solver, case, every, plan.colours, plan.look))
    return pictured


def model_of(solver: Reported, plan: Plan, states: Mapping[str, Combination]) -> Model:
    """The model that combinations were brought on with, or the present one. Collective."""
    base, now = solver.base, solver.scene.versions.current
    if not states:
        data = model_data(solver.scene)
        if base is None or base.version.model_version != now.model_version:
            return _pictured(solver, plan, data, "The model in its current state")
        with back_to_now(solver):
            solver.restore(base)
            return _pictured(solver, plan, data, "The model in its base state, before its loads")
    names = dict[int, list[str]]()
    for name, one in states.items():
        names.setdefault(one.base.version.model_version, []).append(name)
    first = next(iter(states.values())).base
    alike = [name for name, one in states.items() if one.base.version == first.version]
    caption = "The model in its base state"
    if len(alike) < len(states):
        caption = f"The model in the base state of {', '.join(alike)}"
    with back_to_now(solver):
        models = {}
        for own in names.values():
            solver.restore(states[own[0]].base)
            models[", ".join(own)] = model_data(solver.scene)
        data = merged(models)
        solver.restore(first)
        return _pictured(solver, plan, data, caption)


def _pictured(solver: Reported, plan: Plan, data: ModelData, caption: str) -> Model:
    """A model with a picture of the scene's present state. Collective."""
    scene = solver.scene
    if not scene.in_equilibrium():
        caption += f" ({UNBALANCED})"
    names = len(scene.cables) + len(scene.bars) <= MOST_NAMES
    return Model(data, draw_png(solver, dpi=SHARPEST, show_names=names, **plan.look), caption)


def write_report(solver: Reported, plan: Plan, model: Model, cases: Sequence[Case]) -> None:
    """Write the report of all cases. Collective."""
    with raised_together(solver.comm):
        if solver.comm.rank == 0:
            report = Report(plan.title, plan.about, plan.units, model, cases, plan.cable_strengths)
            write(plan.path, report)


@contextmanager
def back_to_now(solver: Reported) -> Iterator[None]:
    """Bring the scene back to its state after the block, also after an error. Collective."""
    now = solver.snapshot()
    try:
        yield
    finally:
        solver.restore(now)
