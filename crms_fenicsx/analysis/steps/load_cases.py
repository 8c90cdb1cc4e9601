"""Load combinations that start from one base state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.loads import AIR
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.loading import checked_target
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.runtime.handle import ReadOnly


@dataclass(frozen=True)
class Combination:
    """Result of a load combination.

    Attributes
    ----------
    name
        Name of the combination.
    step
        Its last load step.
    snapshot
        Final state; pass it to `Solver.restore` to draw it or evaluate results.
    base
        State that the combination started from.
    """

    name: str
    step: Step
    snapshot: SceneState
    base: SceneState


class HasStates(Protocol):
    """Interface of `Solver`, which this module must not import."""

    scene: ReadOnly[Scene]

    def snapshot(self) -> SceneState:
        """The current state."""

    def restore(self, snapshot: SceneState) -> None:
        """Restore a state of the scene."""


@contextmanager
def back_to_now(solver: HasStates) -> Iterator[None]:
    """Restore the scene's present state after the block, also after an error. Collective."""
    now = solver.snapshot()
    try:
        yield
    finally:
        solver.restore(now)


def checked_states(
    call: str, scene: Scene, combinations: Mapping[str, Combination] | None
) -> dict[str, Combination]:
    """Check combinations and return them in one order on all ranks; empty for None. Collective."""
    if combinations is not None:
        checks.collection(f"{call}: combinations", combinations, Mapping, "solver.combine(...)", 1)
    listed = None if combinations is None else dict.fromkeys(combinations)
    checks.same(scene.comm, call, combinations=listed)
    for name, one in (combinations or {}).items():
        checks.of_type(f"{call}: combination {name!r}", one, Combination)
        if one.snapshot.scene is not scene:
            raise InputError(
                f"{call}: combination {name!r} is of another scene; pass those of the solver that "
                "made it."
            )
    found = {str(name): one for name, one in (combinations or {}).items()}
    return checks.in_one_order(scene.comm, found)


def check_combinations(scene: Scene, combinations: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse combinations that cannot be applied; see `Solver.combine`."""
    example = '{"weight": 1.35, "snow": 1.5}'
    checks.collection("combine: combinations", combinations, Mapping, f'{{"snow": {example}}}', 1)
    for name, given in combinations.items():
        checks.text("combine: a name", name)
        checks.collection(f"combine: {name!r}", given, Mapping, example)
        air, factors = split(given)
        try:
            checked_target(scene, load=factors, **air)
        except InputError as error:
            raise InputError(f"combine: {name!r}: {error}") from None


def split(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, float] | None]:
    """Air settings of a combination, and its load factors (None if it has none)."""
    factors = {load: factor for load, factor in given.items() if load not in AIR}
    return {name: given[name] for name in AIR if name in given}, factors or None
