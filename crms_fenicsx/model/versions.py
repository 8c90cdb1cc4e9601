"""Which model a scene has and which state it is in, and whether that state is an equilibrium."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import Any, TypeVar, cast

from crms_fenicsx.runtime.arrays import Array

UNBALANCED = "not in equilibrium"
"""What is said of a scene that has been changed since its last load step."""

Method = TypeVar("Method", bound=Callable[..., Any])


@dataclass(frozen=True)
class Equilibrium:
    """What the last load step has left: versions, digest of displacements, and its checks."""

    model_version: int  # model_version, state_version: those of then
    state_version: int
    digest: bytes  # of this rank's displacements, which users may write
    verification: Any  # what the checks said; None if there were none in this run


@dataclass(frozen=True)
class Version:
    """A model and a state by their numbers, with the equilibrium that was found last."""

    # which materials, cables, bars, loads, supports ... there are; the solver is set up for one.
    model_version: int = 0
    # which state load steps, checkpoints or snapshots have brought the scene to
    state_version: int = 0
    equilibrium: Equilibrium | None = None  # the last one found; None before the first


class Versions:
    """Numbers the models and states of a scene; a number is given once, and restored with them.

    Attributes: `current`: those of now.
    """

    def __init__(self) -> None:
        self.current = Version()
        self._models = self._states = 0

    @property
    def model_version(self) -> int:
        """The number of the model."""
        return self.current.model_version

    @property
    def state_version(self) -> int:
        """The number of the state, which does not see displacements that users write."""
        return self.current.state_version

    def change_model(self, acts: bool = True) -> None:
        """Number another model, in which what has changed acts, or keeps the equilibrium."""
        was, self._models = self.current, self._models + 1
        found = was.equilibrium
        if not acts and found is not None and found.model_version == was.model_version:
            found = replace(found, model_version=self._models)
        self.current = replace(was, model_version=self._models, equilibrium=found)

    def change_state(self, above: int = 0) -> None:
        """Number another state, by more than the numbers of states that a checkpoint has."""
        self._states = max(self._states, above) + 1
        self.current = replace(self.current, state_version=self._states)

    def settle(self, u: Array, verification: object) -> None:
        """Take down that displacements are an equilibrium of the present model and state."""
        found = Equilibrium(self.model_version, self.state_version, _digest(u), verification)
        self.current = replace(self.current, equilibrium=found)

    def unsettle(self) -> None:
        """Take down that the present state, as one that was read from a file, is none."""
        self.current = replace(self.current, equilibrium=Equilibrium(-1, -1, b"", None))

    @property
    def trouble(self) -> str:
        """Why the present state, which is not settled, is not."""
        if self.current.equilibrium is None:
            return "no load step has found an equilibrium yet"
        return f"the scene has been changed since its last load step, and is {UNBALANCED}"

    def are_settled(self, u: Array) -> bool:
        """Whether nothing has changed since the last equilibrium, as far as this rank can see."""
        now, found = self.current, self.current.equilibrium
        return (
            found is not None
            and found.model_version == now.model_version
            and found.state_version == now.state_version
            and found.digest == _digest(u)
        )


def _digest(u: Array) -> bytes:
    return blake2b(u.tobytes(), digest_size=16).digest()


def changes_model(method: Method) -> Method:
    """Let a method of a scene, unless it raises an error, give the scene's model another number."""

    @functools.wraps(method)
    def changing(scene: Any, *args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        result = method(scene, *args, **kwargs)
        scene.versions.change_model()
        return result

    return cast(Method, changing)
