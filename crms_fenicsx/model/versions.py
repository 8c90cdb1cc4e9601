"""Versions of model and state, whether the state is in equilibrium, and warnings of it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any, Literal, TypeVar, cast

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class StateWarning:
    """One thing that a state's user has been warned of.

    Attributes
    ----------
    kind
        "snap-through": no stable equilibria connect it to the states before. "instability": bars
        make its equilibrium one that is not stable. "pond": water does. "cable end": one lies under
        the membrane.
    text
        What, where and from which load on.
    loads
        Of a snap-through: the factors of each load that changed between which it was, by its
        name, and as "pressure" the pressures (force per area).
    """

    kind: Literal["snap-through", "instability", "pond", "cable end"]
    text: str
    loads: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def is_unstable(self) -> bool:
        """Whether the state's equilibrium is not stable."""
        return self.kind in ("instability", "pond")

    @property
    def lasts(self) -> bool:
        """Whether the states of later load steps have it as well."""
        return self.kind == "snap-through"

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"


UNBALANCED = "not in equilibrium"
"""What is said of a scene that has been changed since its last load step."""

Method = TypeVar("Method", bound=Callable[..., Any])


@dataclass(frozen=True)
class Equilibrium:
    """The equilibrium that the last load step has found, and what its checks said."""

    model_version: int  # of then
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
    """Numbers the models and states of a scene; a number is given once, and restored with them."""

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
        """Record that displacements are an equilibrium of the present model and state."""
        found = Equilibrium(self.model_version, self.state_version, _digest(u), verification)
        self.current = replace(self.current, equilibrium=found)

    def unsettle(self) -> None:
        """Record that the present state, as one that was read from a file, is no equilibrium."""
        self.current = replace(self.current, equilibrium=Equilibrium(-1, -1, b"", None))

    @property
    def trouble(self) -> str:
        """Why the present state is no equilibrium."""
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
