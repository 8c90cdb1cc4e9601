"""Write a report of states or combinations of loads, by one call on all ranks."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from mpi4py import MPI

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.output.figures.draw_scene import HasSystem
from crms_fenicsx.output.report.arguments import Plan, write
from crms_fenicsx.output.report.case import SHARPEST, Case, case_of, draw_png, with_pictures
from crms_fenicsx.output.report.model_tables import ModelData, merged, model_data
from crms_fenicsx.output.report.sections import Model, Report
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import collective, raised_together
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


class Reporting:
    """The part of a solver that writes reports."""

    comm: MPI.Intracomm
    _scene: Scene
    scene: ReadOnly[Scene]
    base: Snapshot | None

    @property
    @abstractmethod
    def system(self) -> System:
        """The potential of the scene."""

    @abstractmethod
    def snapshot(self) -> Snapshot:
        """The current state."""

    @abstractmethod
    def restore(self, snapshot: Snapshot) -> None:
        """Bring the scene back to a state."""

    @collective
    def report(
        self,
        filename: str | Path,
        combinations: Mapping[str, Combination] | None = None,
        *,
        title: str = "Membrane structure",
        about: Mapping[str, str] | None = None,
        unit: str = "",
        force: str = "",
        cable_strengths: Mapping[str, float] | None = None,
        pictures: Sequence[str] | None = None,
        view: tuple[float, float] = (-60.0, 30.0),
    ) -> None:
        """Write a report to attach to a calculation: one page of HTML, and CSV tables. Collective.

        The page has the model, combinations, pictures, section forces, utilisation and envelopes,
        cables, bars, ponds, reactions and the verification's verdicts; it loads nothing from
        elsewhere, is smaller than 5 MB, and prints on A4. The tables lie beside it: ``tent.html``
        has ``tent_membrane.csv``, ``tent_cables.csv`` and so on, with all digits. Results are those
        of the states that the combinations led to, with the model and the base state that these
        were brought on with, whatever the scene is now; strengths are the present ones. The scene's
        own state is as before. Without combinations the page says in red if the scene has been
        changed since its last load step. Bars whose names differ in a number at their end, as those
        of a belt, share rows on the page if they are ten or more.

        Parameters
        ----------
        filename
            Of the page, ending in .html. Files that are there are replaced when all are complete.
        combinations
            What `combine` returned; by default the current state alone.
        title
            Heading.
        about
            Names and texts below it: ``{"Project": "...", "Author": "..."}``.
        unit, force
            Names of the units of length and force, for headings.
        cable_strengths
            Strengths of cables by their names, divided by the partial factors (force); those that
            are named get a utilisation. Those of the fabric are `Scene.set_strengths`'s.
        pictures
            What colours the membrane in a picture of each combination, as for `draw`, or "tension",
            that of cables and bars; by default these, displacement, section forces (of fabrics with
            a warp along warp and weft) and, with strengths, utilisation. Where the page would be
            too large, the last ones are left out.
        view
            Where the viewer stands, as for `draw`.

        Raises
        ------
        InputError
            On all ranks and before anything is written: an argument that cannot be used, a file
            that cannot be written, or combinations of models that differ; it says in what.

        Examples
        --------
        >>> found = solver.combine({"snow": {"snow": 1.5}, "storm": {"wind": 1.5}})
        >>> solver.report("results/tent/report.html", found, title="Tent", unit="m", force="kN")
        """
        from crms_fenicsx.output.report.arguments import checked_plan, checked_states

        listed: object = combinations
        if isinstance(combinations, Mapping):
            listed = dict.fromkeys(combinations)
        checks.same(self.comm, "report", combinations=listed)
        states = checks.in_one_order(self.comm, checked_states(self._scene, combinations))
        plan = checked_plan(
            self.comm, self._scene, filename, title=title, about=about, unit=unit, force=force,
            cable_strengths=cable_strengths, pictures=pictures, view=view,
        )  # fmt: skip
        model, cases = model_of(self, plan, states), results_of(self, states)
        write_report(self, plan, model, drawn(self, plan, states, cases, cases))
