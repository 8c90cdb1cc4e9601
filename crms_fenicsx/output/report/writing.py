"""The steps to a report: results of each combination, pictures in one scale, the files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from crms_fenicsx.output.figures.scene import HasSystem
from crms_fenicsx.output.report.arguments import Plan
from crms_fenicsx.output.report.case import SHARPEST, Case, case_of, draw_png, with_pictures
from crms_fenicsx.output.report.contents import Report
from crms_fenicsx.output.report.files import write
from crms_fenicsx.output.report.model_data import model_data
from crms_fenicsx.runtime.errors import raised_together
from crms_fenicsx.steps.load_cases import Combination
from crms_fenicsx.steps.load_step import Step
from crms_fenicsx.steps.snapshot import Snapshot
from crms_fenicsx.verification.report import Verification

MOST_NAMES = 12
"""Up to so many cables and bars have their names in the picture of the model."""
NOW = "Current state"
"""Name of the case of a report without combinations."""


class Reported(HasSystem, Protocol):
    """A `Solver`, which lies above this module."""

    steps: list[Step]

    def snapshot(self) -> Snapshot:
        """The current state."""

    def restore(self, snapshot: Snapshot) -> None:
        """Bring the scene back to a state."""


def results_of(solver: Reported, states: Mapping[str, Combination]) -> list[Case]:
    """Results of combinations, or of the current state if there are none. Collective."""
    if not states:
        return [case_of(solver, NOW, _last_verification(solver))]
    base, cases = solver.snapshot(), []
    try:
        for name, one in states.items():
            solver.restore(one.snapshot)
            cases.append(case_of(solver, name, one.step.verification))
    finally:
        solver.restore(base)
    return cases


def drawn(
    solver: Reported, plan: Plan, states: Mapping[str, Combination], cases: Sequence[Case],
    every: Sequence[Case],
) -> list[Case]:  # fmt: skip
    """The cases with pictures in the scale of `every` case. Collective."""
    if not states:
        return [with_pictures(solver, case, every, plan.colours, plan.look) for case in cases]
    base, pictured = solver.snapshot(), []
    try:
        for case in cases:
            solver.restore(states[case.name].snapshot)
            pictured.append(with_pictures(solver, case, every, plan.colours, plan.look))
    finally:
        solver.restore(base)
    return pictured


def write_report(solver: Reported, plan: Plan, cases: Sequence[Case]) -> None:
    """Write the report of all cases, with the model as it is now. Collective."""
    scene = solver.system.scene
    model, names = model_data(scene), len(scene.cables) + len(scene.bars) <= MOST_NAMES
    picture = draw_png(solver, dpi=SHARPEST, show_names=names, **plan.look)
    with raised_together(solver.comm):
        if solver.comm.rank == 0:
            write(
                plan.path,
                Report(
                    plan.title, plan.about, plan.units, model, cases, picture, plan.cable_strengths
                ),
            )


def _last_verification(solver: Reported) -> Verification | None:
    """What checks of the load step say that has led to the current state."""
    for step in reversed(solver.steps):
        if step.energies == solver.system.scene.energies:
            return step.verification
    return None
