"""Arguments of calls: checked by their annotations, and compared between the ranks."""

from __future__ import annotations

import functools
import inspect
import sys
import traceback
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

from mpi4py import MPI

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import all_failed, end_all

Function = TypeVar("Function", bound=Callable[..., Any])
Anything = TypeVar("Anything")

Finite = Annotated[float, checks.finite]
Positive = Annotated[float, checks.positive]
NonNegative = Annotated[float, checks.non_negative]
Whole = Annotated[int, partial(checks.whole, least=0)]
Count = Annotated[int, partial(checks.whole, least=1)]
Name = Annotated[str, checks.text]
Prefix = Annotated[str, checks.options_prefix]
File = Annotated[str | Path, checks.file]
Vector = Annotated[Sequence[float] | Array, checks.vector]
Axis = Annotated[Sequence[float] | Array, checks.direction]
PlanVector = Annotated[Sequence[float] | Array, partial(checks.vector, sizes=(2, 3))]
PlanDirection = Annotated[Sequence[float] | Array, checks.plan_direction]

OWN = "of this rank"
PerRank = Annotated[Anything, OWN]
"""An argument that may differ between the ranks, such as an array of a rank's own cells; only
whether it is None must not."""

Check = Callable[[str, Any], Any]


def checked(call: Function) -> Function:
    """Decorate a function or a class: arguments that do not fit their annotations are refused, by
    an `InputError` that begins with the call's name. A function gets what the checks return, such
    as numbers for `Finite`; a class gets what is given."""
    kind: Any = call if inspect.isclass(call) else None
    begins = call if kind is None else kind.__init__
    its = Arguments(begins, call.__name__)

    @functools.wraps(begins)
    def calling(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True
        found = its.checked(args, kwargs)
        args, kwargs = found if kind is None else (args, kwargs)
        return begins(*args, **kwargs)

    calling.arguments = its  # type: ignore[attr-defined]
    if kind is None:
        return cast(Function, calling)
    kind.__init__ = calling
    return call


def collective(call: Function) -> Function:
    """Decorate a call that all ranks make together: one of its arguments is their communicator or
    has it as `comm`. Arguments must be the same on all ranks, but for `PerRank` ones and those that
    have a `comm`, and are `checked`.

    An error on one rank cannot leave the others waiting forever: this package raises its errors
    on all ranks, but a bug, a lack of memory or an interrupt may hit one rank alone while the
    others are in a reduction. A rank with an error waits `PATIENCE` seconds for the others to fail
    too; otherwise it prints its traceback and aborts all ranks."""
    begins = call.__name__ == "__init__"
    its = Arguments(call, call.__qualname__.split(".")[-2] if begins else call.__name__)

    @functools.wraps(call)
    def guarded(*args: Any, **kwargs: Any) -> Any:
        __tracebackhide__ = True  # IPython and pytest leave this call out of tracebacks
        try:
            its.compare(args, kwargs)
            args, kwargs = its.checked(args, kwargs)
            return call(*args, **kwargs)
        except BaseException as error:
            # An inner collective call has already asked the other ranks. Without a communicator,
            # one of the arguments is wrong, and refused on all ranks.
            comm = its.comm(args, kwargs)
            if not getattr(error, "on_all_ranks", comm is None):
                if not all_failed(comm):
                    end_all(comm, traceback.format_exc(), call.__qualname__)
                error.on_all_ranks = True  # type: ignore[attr-defined]
            raise

    guarded.arguments = its  # type: ignore[attr-defined]
    return cast(Function, guarded)


class Arguments:
    """The parameters of a call, from its signature."""

    def __init__(self, call: Callable[..., Any], name: str) -> None:
        self.call, self.name = call, name

    @cached_property
    def _parameters(self) -> dict[str, inspect.Parameter]:
        return dict(inspect.signature(self.call).parameters)

    @cached_property
    def annotations(self) -> dict[str, Any]:
        """The annotations, evaluated at the first call: they may name what comes later."""
        names = vars(sys.modules[self.call.__module__])
        given = {name: one.annotation for name, one in self._parameters.items()}
        return {k: eval(one, names) if isinstance(one, str) else one for k, one in given.items()}

    @cached_property
    def _by_place(self) -> list[str]:
        kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
        return [name for name, one in self._parameters.items() if one.kind in kinds]

    @cached_property
    def _checks(self) -> dict[str, Check]:
        found = {name: _check_of(one) for name, one in self.annotations.items()}
        return {name: check for name, check in found.items() if check is not None}

    def checked(
        self, args: tuple[Any, ...], kwargs: dict[str, Any]
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Return the arguments as their checks return them."""
        if not self._checks:
            return args, kwargs
        named = [self._one(*pair) for pair in zip(self._by_place, args, strict=False)]
        rest = args[len(named) :]
        return (*named, *rest), {name: self._one(name, value) for name, value in kwargs.items()}

    def _one(self, name: str, value: Any) -> Any:
        check = self._checks.get(name)
        return value if check is None else check(f"{self.name}: {name}", value)

    def comm(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """The first communicator of the arguments; none if these are wrong."""
        begin = int(self.call.__name__ == "__init__")  # of an object without communicator yet
        for value in (*args[begin:], *kwargs.values()):
            comm = value if isinstance(value, MPI.Comm) else getattr(value, "comm", None)
            if comm is not None:
                return comm
        return None

    def compare(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> None:
        """Refuse arguments that differ between the ranks. Collective."""
        comm = self.comm(args, kwargs)
        if comm is None or comm.size == 1:
            return
        given = {name: one.default for name, one in self._parameters.items()}
        given |= dict(zip(self._by_place, args, strict=False)) | kwargs
        given.pop("self", None)
        for name, one in self._parameters.items():
            if one.kind is inspect.Parameter.VAR_POSITIONAL:
                given[name] = args[len(self._by_place) :]
        for name, value in given.items():
            if _is_per_rank(self.annotations.get(name)) or self.comm((), {name: value}):
                given[name] = None if value is None else "given"
        checks.same(comm, self.name, **given)


def _check_of(annotation: Any) -> Check | None:
    """The check that an annotation stands for: that of `Annotated`, one of the values of `Literal`,
    an object of a class of this package, or one of these or None."""
    kind, inner = get_origin(annotation), get_args(annotation)
    if kind is Annotated:
        return next(filter(callable, annotation.__metadata__), None)
    if kind in (Union, UnionType):
        some = [one for one in inner if one is not NoneType]
        check = _check_of(some[0]) if len(some) == 1 else None
        return check and (lambda what, value: None if value is None else check(what, value))
    if kind is Literal:
        return partial(checks.one_of, known=inner)
    if not inspect.isclass(annotation) or getattr(annotation, "_is_protocol", False):
        return None
    of_package = annotation.__module__.startswith("crms_fenicsx.")
    return partial(checks.of_type, kind=annotation) if of_package else None


def _is_per_rank(annotation: Any) -> bool:
    """Whether it is `PerRank`."""
    return OWN in getattr(annotation, "__metadata__", ())
