"""Read-only attributes of the objects users hold, and owners of a replaceable state."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Generic, NoReturn, TypeVar, overload

Value = TypeVar("Value")


class ReadOnly(property, Generic[Value]):
    """Property that shows a private attribute under a public name. Assigning to it raises an
    `AttributeError` with a remedy, as the value would be unchecked and on one rank only."""

    def __init__(self, source: str, remedy: str) -> None:
        super().__init__(attrgetter(source), self._refuse, doc="")
        self._remedy = remedy

    def __set_name__(self, owner: type, name: str) -> None:
        self._owner, self._name = owner.__name__, name

    if TYPE_CHECKING:

        @overload
        def __get__(self, instance: None, owner: type) -> ReadOnly[Value]: ...

        @overload
        def __get__(self, instance: object, owner: type | None = None) -> Value: ...

        def __get__(self, instance: object | None, owner: type | None = None) -> Any: ...

    def _refuse(self, instance: object, value: object) -> NoReturn:
        raise AttributeError(
            f"{self._owner}.{self._name} = {value!r}: it cannot be assigned; {self._remedy}."
        )


StateT = TypeVar("StateT")


class Stateful(Generic[StateT]):
    """Owner of a `state`, a frozen dataclass that only it replaces."""

    state: StateT

    def update(self, **changes: Any) -> None:
        """Replace fields of the state, by name; internal to the package."""
        self.state = replace(self.state, **changes)  # type: ignore[type-var]


class Handle(Stateful[StateT]):
    """A named part of a scene held by users, such as a cable; files identify it by its name."""

    name: ReadOnly[str] = ReadOnly("_name", "name it when it is made")

    def __init__(self, name: str, state: StateT) -> None:
        self._name, self.state = name, state
