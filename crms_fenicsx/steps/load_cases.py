"""Combinations of loads from one base state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError
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
