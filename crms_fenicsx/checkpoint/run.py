"""What a solver knows of the load steps of a run, as plain numbers and texts, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

from crms_fenicsx.checkpoint.json_data import Plain, floats, integers, listed
from crms_fenicsx.energies.paper.step_history import StepHistory
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.steps.load_step import Step

if TYPE_CHECKING:
    from crms_fenicsx.contact.active_set import ContactKey
    from crms_fenicsx.paths.tried_paths import TriedPaths


@dataclass(frozen=True)
class Run:
    """What a solver knows of its load steps, besides the scene.

    Attributes
    ----------
    steps
        The accepted steps.
    rows
        Rows of the history.
    step_history
        What the step-wise laws know; None where there are none.
    tried
        Paths that cables have not taken; None before any were tried.
    """

    steps: list[Step]
    rows: list[Mapping[str, int | float | str]]
    step_history: StepHistory | None
    tried: TriedPaths | None

    def with_cells(self, cells: Array) -> Run:
        """The run with a state of the cells, (n, 6), in what its step-wise laws know."""
        assert self.step_history is not None
        return replace(self, step_history=replace(self.step_history, cells=cells))


def plain_run(run: Run) -> Plain:
    """A run as plain data, but for the fields of the step-wise laws."""
    history, tried = run.step_history, run.tried
    return {
        "steps": [asdict(replace(step, verification=None)) for step in run.steps],
        "history": [dict(row) for row in run.rows],
        "step history": None
        if history is None
        else {k: float(v) for k, v in vars(history).items() if k != "cells"},
        "tried": None
        if tried is None
        else {
            "refused": {name: sorted(paths) for name, paths in tried.refused.items()},
            "left": {name: sorted(runs) for name, runs in tried.left.items()},
            "at": {name: listed(places) for name, places in tried.at.items()},
            "L0": tried.L0,
            "released": sorted(tried.released, key=str),
            "settled": sorted(tried.settled, key=str),
        },
    }


def run_of(data: Plain) -> Run:
    """A run from plain data, without the fields of the step-wise laws.

    Raises
    ------
    KeyError, TypeError, ValueError
        The data are no run's.
    """
    history = data["step history"]
    return Run(
        [Step(**step | {"outcome": Outcome(**step["outcome"])}) for step in data["steps"]],
        [dict(row) for row in data["history"]],
        None if history is None else StepHistory(None, **history),
        None if data["tried"] is None else _tried(data["tried"]),
    )


def _tried(data: Plain) -> TriedPaths:
    from crms_fenicsx.paths.tried_paths import TriedPaths

    return TriedPaths(
        {
            name: {tuple(integers(support) for support in path) for path in paths}
            for name, paths in data["refused"].items()
        },
        {name: {integers(run) for run in runs} for name, runs in data["left"].items()},
        {name: floats(places, -1, 3) for name, places in data["at"].items()},
        {name: float(L0) for name, L0 in data["L0"].items()},
        *({_contact(key) for key in data[which]} for which in ("released", "settled")),
    )


def _contact(key: Plain) -> ContactKey:
    name, place = key
    return (str(name), place) if isinstance(place, str) else (str(name), integers(place))
