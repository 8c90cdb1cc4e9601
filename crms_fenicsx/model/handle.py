"""Things whose changing data are one frozen value, so that a reference to it is a copy."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Generic, TypeVar

from crms_fenicsx.runtime.readonly import ReadOnly

StateT = TypeVar("StateT")


class Stateful(Generic[StateT]):
    """Something that owns a `state`, a frozen dataclass, and alone replaces it."""

    state: StateT

    def update(self, **changes: Any) -> None:
        """Replace fields of the state, by name; for the package alone."""
        self.state = replace(self.state, **changes)  # type: ignore[type-var]


class Handle(Stateful[StateT]):
    """A named part of a scene that users hold, such as a cable: files know it by its name."""

    name: ReadOnly[str] = ReadOnly("_name", "give the name when it is made")

    def __init__(self, name: str, state: StateT) -> None:
        self._name, self.state = name, state
