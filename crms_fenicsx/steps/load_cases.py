"""Combinations of loads from one base state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.runtime.handle import ReadOnly
from crms_fenicsx.scene import Scene
from crms_fenicsx.scene.loads import AIR
from crms_fenicsx.scene.state import SceneState
from crms_fenicsx.steps.load_step import Step
from crms_fenicsx.steps.loading import checked_target


@dataclass(frozen=True)
class Combination:
    """What came of a combination of loads.

    Attributes
    ----------
    name
        Its name.
    step
        Its last load step.
    snapshot
        The state that it led to; `Solver.restore` goes there, to draw it or for its results.
    base
        The state that it was brought on from.
    """

    name: str
    step: Step
    snapshot: SceneState
    base: SceneState


class HasStates(Protocol):
    """A `Solver`, which lies above this module."""

    scene: ReadOnly[Scene]

    def snapshot(self) -> SceneState:
        """The current state."""

    def restore(self, snapshot: SceneState) -> None:
        """Bring the scene back to a state."""


@contextmanager
def back_to_now(solver: HasStates) -> Iterator[None]:
    """Bring the scene back to its state after the block, also after an error. Collective."""
    now = solver.snapshot()
    try:
        yield
    finally:
        solver.restore(now)


def checked_states(
    call: str, scene: Scene, combinations: Mapping[str, Combination] | None
) -> dict[str, Combination]:
    """Combinations of a scene, in one order; none for its current state. Collective."""
    if combinations is not None:
        checks.collection(f"{call}: combinations", combinations, Mapping, "solver.combine(...)", 1)
    listed = None if combinations is None else dict.fromkeys(combinations)
    checks.same(scene.comm, call, combinations=listed)
    for name, one in (combinations or {}).items():
        if not isinstance(one, Combination):
            raise InputError(
                f"{call}: combination {name!r} is {one!r}; give what solver.combine(...) returned."
            )
        if one.snapshot.scene is not scene:
            raise InputError(
                f"{call}: combination {name!r} is of another scene; give those of the solver that "
                "made it."
            )
    found = {str(name): one for name, one in (combinations or {}).items()}
    return checks.in_one_order(scene.comm, found)


def check_combinations(scene: Scene, combinations: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse combinations that cannot be brought on; see `Solver.combine`."""
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
    """The air's of a combination, and factors of its loads; None where it names none."""
    factors = {load: factor for load, factor in given.items() if load not in AIR}
    return {name: given[name] for name in AIR if name in given}, factors or None
