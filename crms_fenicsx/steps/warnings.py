"""Warn of a load step whose result is crude, and say why one found no equilibrium."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

from crms_fenicsx.equilibrium.state import State
from crms_fenicsx.minimization.outcome import Outcome
from crms_fenicsx.model.pond import Pond
from crms_fenicsx.model.state_warning import StateWarning
from crms_fenicsx.runtime.errors import (
    ConvergenceError,
    FrictionWarning,
    InstabilityWarning,
    PathWarning,
    PondWarning,
    SnapThroughWarning,
)
from crms_fenicsx.scene import Scene

CALLER = 5
"""Level of the stack, from here, of who has called `Solver.advance`."""

CATEGORIES: dict[str, type[UserWarning]] = {
    "snap-through": SnapThroughWarning,
    "instability": InstabilityWarning,
    "pond": PondWarning,
    "cable end": PathWarning,
}


def warn_of_friction(number: int, scene: Scene, before: State, unsettled: float) -> None:
    """Warn of friction forces that have not settled, or that have done work on a cable.

    The paper's friction element pushes a cable back that should stick.
    """
    if scene.comm.rank > 0:
        return
    if unsettled > 0.0:
        warnings.warn(
            f"step {number}: friction forces went round in circles and are right to "
            f"{unsettled:.1%} of their sum only; make the mesh finer along the cables.",
            FrictionWarning,
            stacklevel=CALLER,
        )
    for cable, was in zip(scene.cables, before.cables, strict=True):
        gained = 0.0 if was.grip is None else was.grip.dissipated
        if cable.grip is None or cable.has_coulomb or cable.grip.dissipated >= gained:
            continue
        warnings.warn(
            f"step {number}: the friction elements of {cable.name!r} have pushed it back and given "
            f"{gained - cable.grip.dissipated:.3g} of work, as their force does not know of "
            'sticking; use Friction(law="coulomb") or more steps.',
            FrictionWarning,
            stacklevel=CALLER,
        )


def warn_of_blocked(number: int, scene: Scene) -> None:
    """Warn of cables that have run into vertices, which they may not pass."""
    for cable in scene.cables:
        if cable.blocked and scene.comm.rank == 0:
            place = cable.positions[cable.blocked[0]]
            warnings.warn(
                f"step {number}: {cable.name!r} has run into {len(cable.blocked)} mesh vertices, "
                f"the first at {place}; it cannot slide on into other cells, so that the result is "
                "that of a cable blocked there.",
                PathWarning,
                stacklevel=CALLER,
            )


def warn_of_state(number: int, scene: Scene, found: Sequence[StateWarning]) -> None:
    """Warn of what was found of a step's state."""
    for one in found:
        if scene.comm.rank == 0:
            text = f"step {number}: {one.text}"
            warnings.warn(text, CATEGORIES[one.kind], stacklevel=CALLER)


def _names(ponds: Sequence[Pond]) -> str:
    return ", ".join(repr(pond.name) for pond in ponds)


def no_equilibrium(
    number: int, outcome: Outcome, max_halvings: int, done: float, failed: Sequence[Pond],
    ponds: Sequence[Pond],
) -> ConvergenceError:  # fmt: skip
    """Make the error of a step whose last attempt has failed."""
    water = "" if not ponds else (
        f" There may be none under {_names(ponds)}, where water gathers without end: a membrane of "
        "more prestress or slope carries more, a given volume stays as it is. Water that ends at "
        "an edge that is free has none: hold that, or name all parts that are under water."
    )  # fmt: skip
    rising = [
        f"{pond.name!r} between {now.factor:.5g} and {pond.factor:.5g}"
        for pond, now in zip(failed, ponds, strict=True)
        if pond.factor > now.factor
    ]
    if rising:
        water = f" The limit of the factor is for {', '.join(rising)}.{water}"
    return ConvergenceError(
        f"step {number}: no equilibrium found, {outcome.reason}: unbalanced force "
        f"{outcome.residual:.3g}, tolerance {outcome.tolerance:.3g}, with the increment halved "
        f"{max_halvings} times; {done:.2%} of the loads are on and the scene is at that "
        "state. Try more steps, check that the cables can carry tension where they lie, and "
        f"look at the state reached.{water}"
    )
