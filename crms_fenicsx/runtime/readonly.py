"""Attributes that users read and only the package writes."""

from __future__ import annotations

from operator import attrgetter
from typing import Any, Generic, NoReturn, TypeVar, overload

Value = TypeVar("Value")


class ReadOnly(Generic[Value]):
    """Shows a private attribute under a public name.

    An assignment to the public name would be on one rank only, unchecked and unknown to the solver.
    It raises an `AttributeError` that tells what to do instead.
    """

    def __init__(self, source: str, remedy: str) -> None:
        self._get, self._remedy = attrgetter(source), remedy

    def __set_name__(self, owner: type, name: str) -> None:
        self._owner, self._name = owner.__name__, name

    @overload
    def __get__(self, instance: None, owner: type) -> ReadOnly[Value]: ...

    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...

    def __get__(self, instance: object | None, owner: type) -> Any:
        return self if instance is None else self._get(instance)

    def __set__(self, instance: object, value: NoReturn) -> None:
        raise AttributeError(
            f"{self._owner}.{self._name} = {value!r}: it cannot be assigned; {self._remedy}."
        )
