"""Load cases and combinations of them, all from one base state."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from crms_fenicsx.loaded_membrane import AIR
from crms_fenicsx.model.sealed_air import FanControl
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import (
    ConvergenceError,
    InputError,
    collective,
    raised_together,
)
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.increment_solver import IncrementSolver
from crms_fenicsx.steps.load_step import Step
from crms_fenicsx.steps.loading import checked_target
from crms_fenicsx.steps.snapshot import Snapshot


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
    snapshot: Snapshot
    base: Snapshot


class LoadCases:
    """The part of a solver that goes from one base state to several loads."""

    _scene: Scene
    _increments: IncrementSolver
    case = ""
    """Name of the branch that load steps belong to, in the history's column "case"; "" in none."""
    base: Snapshot | None = None
    """Internal: the state from which loads were first brought on; None before."""

    @abstractmethod
    def advance(
        self,
        *,
        pressure: float | FanControl | None = None,
        load: float | Mapping[str, float] | None = None,
        temperature: float | None = None,
        atmosphere: float | None = None,
        steps: int = 1,
    ) -> Step:
        """Go to new loads."""

    @collective
    def snapshot(self) -> Snapshot:
        """The current state of the scene and of this solver, to go back to by `restore`.

        Collective. It stays in memory; `save` writes one to a folder.
        """
        return Snapshot.of(self._scene, self._increments.tried)

    @collective
    def restore(self, snapshot: Snapshot) -> None:
        """Bring the scene back to a state. Collective.

        Displacements, loads, supports, cables and added terms are those of then; load steps,
        history and files stay, and go on.

        Parameters
        ----------
        snapshot
            A state of the same scene.

        Raises
        ------
        InputError
            On all ranks: it is no snapshot, or one of another scene.
        """
        with raised_together(self._scene.comm):
            if not isinstance(snapshot, Snapshot):
                raise InputError(
                    f"restore: {snapshot!r} is no snapshot; give what solver.snapshot() returned."
                )
            if snapshot.scene is not self._scene:
                raise InputError(
                    "restore: the snapshot is of another scene; give one of this scene."
                )
        self._increments.go_back_to(snapshot)

    @contextmanager
    def branch(self, name: str) -> Iterator[Snapshot]:
        """Let load steps be a branch, after which the scene is as before. Collective.

        Parameters
        ----------
        name
            Name of the branch in the history's column "case".

        Yields
        ------
        Snapshot
            The state that the branch begins in, and to which it comes back, also after an error.

        Raises
        ------
        InputError
            On all ranks: a name that is no text, or a branch within another one.

        Examples
        --------
        >>> with solver.branch("snow + wind"):
        ...     solver.advance(load={"snow": 1.5, "wind": 0.9})
        ...     tensions = [cable.tension for cable in scene.cables]
        """
        checks.same(self._scene.comm, "branch", name=name)
        if not isinstance(name, str) or not name:
            raise InputError(f"branch: name = {name!r} is no text; give one, as in 'snow'.")
        if self.case:
            raise InputError(
                f"branch: {name!r} is within the branch {self.case!r}; let that one end first."
            )
        base, self.case = self.snapshot(), name
        try:
            yield base
        finally:
            self.case = ""
            self.restore(base)

    def combine(
        self, combinations: Mapping[str, Mapping[str, Any]], *, steps: int = 1
    ) -> dict[str, Combination]:
        """Bring on combinations of loads, each from the current state. Collective.

        Afterwards the scene is as before.

        Parameters
        ----------
        combinations
            By its name the factors of each combination's loads, by theirs, and what else of
            "pressure", "temperature" and "atmosphere" is another one, as in `Solver.advance`. What
            is not named stays: a combination that names nothing is the base state.
        steps
            Number of increments of each.

        Returns
        -------
        dict
            What came of each combination, by its name, in the order that rank 0 gives.

        Raises
        ------
        InputError
            On all ranks and before anything is computed: a load that does not exist, a factor that
            is not finite, or steps that are no number of such.
        ConvergenceError
            A combination has no equilibrium; it says which.

        Examples
        --------
        >>> found = solver.combine({
        ...     "snow": {"weight": 1.35, "snow": 1.5},
        ...     "storm": {"weight": 1.0, "wind along x": 1.5, "pressure": 0.6},
        ... })
        >>> max(found, key=lambda name: found[name].snapshot.tensions["ridge"])
        """
        checks.same(self._scene.comm, "combine", combinations=combinations, steps=steps)
        self.check_combinations(combinations)
        checks.whole("combine: steps", steps, 1)
        found = dict[str, Combination]()
        for name, given in checks.in_one_order(self._scene.comm, combinations).items():
            air, factors = _loads(given)
            with self.branch(name) as start:
                base = next((one.base for one in found.values()), start)  # alike, and kept once
                try:
                    step = self.advance(load=factors, steps=steps, **air)
                except ConvergenceError as error:
                    raise ConvergenceError(f"combination {name!r}: {error}") from None
                found[name] = Combination(name, step, self.snapshot(), base)
        return found

    def check_combinations(self, combinations: Mapping[str, Mapping[str, Any]]) -> None:
        """Refuse combinations that cannot be brought on.

        Raises
        ------
        InputError
            As `combine`.
        """
        if not isinstance(combinations, Mapping) or not combinations:
            raise InputError(
                f"combine: combinations = {combinations!r}; write them as "
                '{"snow": {"weight": 1.35, "snow": 1.5}, ...}.'
            )
        for name, given in combinations.items():
            if not isinstance(name, str) or not name:
                raise InputError(f"combine: the name {name!r} is no text; give one, as in 'snow'.")
            if not isinstance(given, Mapping):
                raise InputError(
                    f"combine: {name!r} is {given!r}; write factors by the loads' names, as in "
                    '{"weight": 1.35, "snow": 1.5}.'
                )
            air, factors = _loads(given)
            try:
                checked_target(self._scene, load=factors, **air)
            except InputError as error:
                raise InputError(f"combine: {name!r}: {error}") from None


def _loads(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, float] | None]:
    """The air's of a combination, and factors of its loads; None where it names none."""
    factors = {load: factor for load, factor in given.items() if load not in AIR}
    return {name: given[name] for name in AIR if name in given}, factors or None
