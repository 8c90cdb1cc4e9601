"""Load combinations that start from one base state, and stages, each from the one before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import LoadCase, SceneState
from crms_fenicsx.analysis.steps.loading import checked_target
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import floats
from crms_fenicsx.foundation.runtime.errors import ConvergenceError, InputError
from crms_fenicsx.foundation.runtime.handle import ReadOnly
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.changed_materials import numbers, with_numbers
from crms_fenicsx.model.combination_table import CombinationTable
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.strengths import AIR, LIMIT_STATES, SERVICE, SETTINGS, acting_loads


@dataclass(frozen=True)
class Combination:
    """Result of a load combination or a stage of erection.

    Attributes
    ----------
    name
        Name of the combination or stage.
    step
        Its last load step.
    snapshot
        Final state; pass it to `Solver.restore` to draw it or evaluate results.
    base
        State that it started from: the structure in operation, or the stage before.
    stage
        Number of the stage, from 1; 0 for a combination.
    table
        The table of `codes.combinations` that it is of; None without.
    """

    name: str
    step: Step
    snapshot: SceneState
    base: SceneState
    stage: int = 0
    table: CombinationTable | None = field(default=None, repr=False)

    @property
    def state(self) -> str:
        """Limit state, such as "ULS" or "characteristic"."""
        return self.snapshot.case.state


class HasStates(Protocol):
    """Interface of `Solver`, which this module must not import."""

    scene: ReadOnly[Scene]

    def snapshot(self) -> SceneState:
        """The current state."""

    def restore(self, snapshot: SceneState) -> None:
        """Restore a state of the scene."""


class Combines(HasStates, Protocol):
    """Interface of `Solver` with load steps."""

    case: str
    steps: list[Step]
    stages: dict[str, Combination]

    def branch(self, name: str) -> AbstractContextManager[SceneState]:
        """Load steps after which the state is restored."""

    @property
    def advance(self) -> Callable[..., Step]:
        """Load steps."""


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


@dataclass(frozen=True)
class Given:
    """A combination as given: what its names say besides load factors."""

    air: dict[str, Any]  # pressure, temperature and atmosphere that change
    factors: dict[str, float] | None  # of the loads; None if it has none
    state: str  # limit state
    prestress: float  # its partial factor
    without: tuple[str, ...]  # names of cables and bars that are missing


def given_by(scene: Scene, name: str, combination: Mapping[str, Any]) -> Given:
    """Read a combination, and refuse what is not one."""
    state = combination.get("state", LIMIT_STATES[0])
    checks.one_of(f"combine: {name!r}: state", state, LIMIT_STATES)
    factor = combination.get("prestress", 1.0)
    prestress = checks.positive(f"combine: {name!r}: prestress", factor)
    without = combination.get("without", ())
    checks.collection(f"combine: {name!r}: without", without, Sequence, 'without=["A5"]')
    known = dict.fromkeys([*(x.name for x in scene.cables), *(x.name for x in scene.bars)])
    for one in without:
        checks.named("cable or bar", known, one)
    if prestress != 1.0:
        check_prestress(scene, f"combine: {name!r}")
    loads = {load: x for load, x in combination.items() if load not in SETTINGS}
    air = {one: combination[one] for one in AIR if one in combination}
    if prestress != 1.0 and scene.pressure != 0.0 and scene.air.sealed is None:
        air.setdefault("pressure", prestress * scene.pressure)
    return Given(air, loads or None, state, prestress, tuple(without))


def checked_combinations(
    scene: Scene, combinations: Mapping[str, Mapping[str, Any]]
) -> dict[str, Given]:
    """Read combinations, and refuse those that cannot be applied; see `Solver.combine`."""
    found = dict[str, Given]()
    example = '{"weight": 1.35, "snow": 1.5}'
    checks.collection("combine: combinations", combinations, Mapping, f'{{"snow": {example}}}', 1)
    for name, one in combinations.items():
        checks.text("combine: a name", name)
        checks.collection(f"combine: {name!r}", one, Mapping, example)
        given = found[name] = given_by(scene, name, one)
        try:
            checked_target(scene, load=given.factors, **given.air)
        except InputError as error:
            raise InputError(f"combine: {name!r}: {error}") from None
        _check_strengths(scene, f"combine: {name!r}", given.state, given.factors or {})
    return found


def _check_strengths(scene: Scene, call: str, state: str, factors: dict[str, float]) -> None:
    """Refuse a limit state, or loads with new factors, for which the fabric has no design value."""
    if state not in SERVICE:
        for fabric in scene.membrane.strengths.values():
            fabric.check_loads(call, state, acting_loads(scene.factors | factors))


def combined(
    solver: Combines, combinations: Mapping[str, Given], steps: int, table: CombinationTable | None
) -> dict[str, Combination]:
    """Apply checked combinations of a table, each from the current state; see `Solver.combine`.
    Collective."""
    found, scene = dict[str, Combination](), solver.scene
    for name, given in checks.in_one_order(scene.comm, combinations).items():
        with solver.branch(name) as start:
            base = next((one.base for one in found.values()), start)  # equal, so kept once
            last = start.case.stage
            case = LoadCase(given.state, base, given.prestress, given.without, last)
            scene.record(case=case)
            L0 = prepare(scene, given)
            try:
                step = solver.advance(load=given.factors, L0=L0, steps=steps, **given.air)
            except ConvergenceError as error:
                raise ConvergenceError(f"combination {name!r}: {error}") from None
            found[name] = Combination(name, step, solver.snapshot(), base, table=table)
    return found


@contextmanager
def branched(solver: Combines, name: str) -> Iterator[SceneState]:
    """Load steps after which the state is restored; see `Solver.branch`. Collective."""
    _check_outermost(solver, "branch", name)
    base, solver.case = solver.snapshot(), name
    try:
        yield base
    finally:
        solver.case = ""
        solver.restore(base)


@contextmanager
def staged(solver: Combines, name: str, state: str) -> Iterator[SceneState]:
    """Changes and load steps that lead to the next stage; see `Solver.stage`. Collective."""
    scene, call = solver.scene, f"stage: {name!r}"
    checks.one_of(f"{call}: state", state, LIMIT_STATES)
    if name in solver.stages:
        raise InputError(f"{call} is a stage already; use another name.")
    _check_outermost(solver, "stage", name)
    _check_newest(solver, call)
    _check_strengths(scene, call, state, {})
    before, first, solver.case = solver.snapshot(), len(solver.steps), name
    number = before.case.stage + 1
    case = LoadCase(state, before, stage=number)
    scene.record(case=case)
    try:
        yield before
        same = scene.versions.is_newest and scene.case is case  # the block restored no other state
        if len(solver.steps) == first or not (scene.in_equilibrium() and same):
            scene.record(case=case)
            solver.advance()
        _check_strengths(scene, call, state, {})
    except ConvergenceError as error:
        solver.restore(before)
        raise ConvergenceError(
            f"stage {name!r}: {error} The scene is back in the state before this stage; catch the "
            "error within the stage to inspect the last equilibrium."
        ) from None
    except BaseException:
        solver.restore(before)
        raise
    finally:
        solver.case = ""
    solver.stages[name] = Combination(name, solver.steps[-1], solver.snapshot(), before, number)
    scene.record(case=LoadCase(stage=number))  # what follows is judged as usual


def _check_newest(solver: Combines, call: str) -> None:
    """Refuse a stage that would follow on an earlier one than the last."""
    later = [x for x in solver.stages.values() if x.stage > solver.scene.case.stage]
    if later:
        names = ", ".join(repr(one.name) for one in later)
        raise InputError(
            f"{call} would begin in an earlier state than that after {later[-1].name!r}: go on "
            f"from there by solver.restore(solver.stages[{later[-1].name!r}].snapshot), or delete "
            f"the stages that it replaces ({names}) from solver.stages first."
        )


def _check_outermost(solver: Combines, call: str, name: str) -> None:
    """Refuse a branch or stage within another."""
    if solver.case:
        raise InputError(f"{call}: {name!r} is within {solver.case!r}; let that one end first.")


def check_prestress(scene: Scene, call: str) -> None:
    """Refuse a factor of a prestress that is not that of materials, cables and bars."""
    why = ""
    if scene.membrane.frames is not None:
        why = "the fabric's prestress follows from its cutting pattern"
    elif not all("prestress" in numbers(one) for one in scene.materials.values()):
        why = "the fabric's energy density is your own"
    elif "step" in (scene.strain_law, *(cable.cable.law for cable in scene.cables)):
        why = "step-wise laws have no unstressed lengths"
    if why:
        raise InputError(
            f"{call}: prestress cannot be scaled: {why}; make a scene for each prestress and "
            "combine in both."
        )


def prepare(scene: Scene, given: Given) -> dict[object, float]:
    """Remove what is missing and scale the fabric's prestress; return the unstressed lengths with
    which cables and bars have the scaled forces at their present lengths. Collective."""
    for name in given.without:
        if any(cable.name == name for cable in scene.cables):
            scene.remove(name)
        else:
            scene.remove_bar(name)
    factor, forces = given.prestress, dict[LaidCable | PlacedBar, float]()
    if factor == 1.0:
        return {}
    materials = scene.membrane.materials
    for number, one in materials.items():
        scaled = factor * np.broadcast_to(one.prestress, (2,))
        materials[number] = with_numbers(one, numbers(one) | {"prestress": floats(scaled)})
    terms = [
        ResidualStress(one.u, factor * one.section_forces)
        if isinstance(one, ResidualStress) and one.section_forces is not None
        else one
        for one in scene.terms
    ]
    scene.state = replace(scene.state, terms=tuple(terms))
    scene.versions.change_model()
    for cable in scene.cables:
        forces[cable] = cable.tension / cable.cable.EA
    for bar in scene.bars:
        forces[bar] = bar.force / bar.bar.EA
    return {
        one: one.L0 * (1.0 + strain) / (1.0 + factor * strain)
        for one, strain in forces.items() if strain
    }  # fmt: skip
