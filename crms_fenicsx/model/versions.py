"""Version numbers of model and state, whether the state is in equilibrium, and its warnings."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any, Literal, TypeVar, cast

from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import DoubtWarning


@dataclass(frozen=True)
class StateWarning:
    """A warning about a state.

    Attributes
    ----------
    kind
        "snap-through": no path of stable equilibria leads to it. "instability": bars make its
        equilibrium unstable. "pond": water does. "cable end": an end lies under the membrane.
        "doubtful": an equilibrium of which some forces are known within a range only.
    text
        What, where and from which load on.
    loads
        Of a snap-through: the factors of each changed load before and after it, by name, and as
        "pressure" the pressures (force per area).
    """

    kind: Literal["snap-through", "instability", "pond", "cable end", "doubtful"]
    text: str
    loads: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def is_unstable(self) -> bool:
        """Whether the state's equilibrium is unstable."""
        return self.kind in ("instability", "pond")

    @property
    def lasts(self) -> bool:
        """Whether it also holds for the states of later load steps."""
        return self.kind == "snap-through"

    def __str__(self) -> str:
        return f"{self.kind}: {self.text}"


@contextmanager
def last_doubt(scene: Any) -> Iterator[None]:
    """Warn of doubtful states among the load steps of a block only if the last one is such."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DoubtWarning)
        yield
    for one in scene.warnings:
        if one.kind == "doubtful" and scene.comm.rank == 0:
            # The block is in a collective method, whose caller is told.
            warnings.warn(one.text, DoubtWarning, stacklevel=5)


UNBALANCED = "not in equilibrium"
"""Status of a scene changed since its last load step."""

Method = TypeVar("Method", bound=Callable[..., Any])


@dataclass(frozen=True)
class Equilibrium:
    """The last equilibrium found, and the result of its checks."""

    model_version: int  # at that time
    state_version: int
    digest: bytes  # of this rank's displacements, which users may change
    verification: Any  # result of the checks; None if there were none in this run


@dataclass(frozen=True)
class Version:
    """Version numbers of a model and a state, with the last equilibrium found."""

    # of materials, cables, bars, loads, supports ...; the solver is set up for one model
    model_version: int = 0
    # of the state reached by load steps, checkpoints or snapshots
    state_version: int = 0
    equilibrium: Equilibrium | None = None  # None before the first


class Versions:
    """Numbers the models and states of a scene; a number is used once, and restored with them."""

    def __init__(self) -> None:
        self.current = Version()
        self._models = self._states = 0

    @property
    def model_version(self) -> int:
        """Number of the current model."""
        return self.current.model_version

    @property
    def state_version(self) -> int:
        """Number of the current state; displacements written by users do not change it."""
        return self.current.state_version

    @property
    def is_newest(self) -> bool:
        """Whether the current state was reached last, and not restored since."""
        return self.state_version == self._states

    def change_model(self, acts: bool = True) -> None:
        """Number a new model; the equilibrium stays valid unless the change `acts`."""
        was, self._models = self.current, self._models + 1
        found = was.equilibrium
        if not acts and found is not None and found.model_version == was.model_version:
            found = replace(found, model_version=self._models)
        self.current = replace(was, model_version=self._models, equilibrium=found)

    def change_state(self, above: int = 0) -> None:
        """Number a new state, `above` the numbers in a checkpoint."""
        self._states = max(self._states, above) + 1
        self.current = replace(self.current, state_version=self._states)

    def settle(self, u: Array, verification: object) -> None:
        """Record that the displacements are an equilibrium of the current model and state."""
        found = Equilibrium(self.model_version, self.state_version, _digest(u), verification)
        self.current = replace(self.current, equilibrium=found)

    def unsettle(self) -> None:
        """Record that the current state, such as one read from a file, is not in equilibrium."""
        self.current = replace(self.current, equilibrium=Equilibrium(-1, -1, b"", None))

    @property
    def trouble(self) -> str:
        """Why the current state is not in equilibrium."""
        if self.current.equilibrium is None:
            return "no load step has found an equilibrium yet"
        return f"the scene has been changed since its last load step, and is {UNBALANCED}"

    def are_settled(self, u: Array) -> bool:
        """Whether this rank has seen no change since the last equilibrium."""
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
    """Decorate a method of a scene: unless it raises, the model gets a new version number."""

    @functools.wraps(method)
    def changing(scene: Any, *args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        result = method(scene, *args, **kwargs)
        scene.versions.change_model()
        return result

    return cast(Method, changing)
