"""Values that annotations of arguments refuse."""

from __future__ import annotations

import inspect
import pkgutil
from collections.abc import Iterator, Sequence
from importlib import import_module
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np

import crms_fenicsx
from crms_fenicsx.foundation.runtime.arguments import (
    Arguments,
    Axis,
    Count,
    File,
    Finite,
    Name,
    NonNegative,
    PlanDirection,
    PlanVector,
    Positive,
    Prefix,
    Vector,
    Whole,
)

NAN, INF = float("nan"), float("inf")
UP = (0.0, 0.0, 1.0)

Values = Sequence[Any]

NO_NUMBERS: Values = (
    NAN, INF, -INF, "x", b"1", [1.0], (1.0, 2.0), {}, 1j, np.array([NAN]), object(), 10**400,
)  # fmt: skip
NEGATIVE: Values = (*NO_NUMBERS, -1.0, -1e300)
NOT_POSITIVE: Values = (*NEGATIVE, 0.0, -0.0)
NO_PLACES: Values = (
    (NAN, 0.0, 0.0), (0.0, INF, 0.0), (0.0,) * 4, "up", 3.0, (UP,), (), (1j, 0.0, 0.0),
    ("x", "y", "z"), {}, np.zeros((3, 3)), (0.0, None, 1.0), object(), (10**400, 0.0, 0.0),
)  # fmt: skip
NO_VECTORS: Values = (*NO_PLACES, (0.0, 0.0))
NO_COUNTS: Values = (-1, 1.5, "2", None, True, NAN, INF, [1], object())
NO_TEXTS: Values = ("unknown", "", 3, None, NAN, ["left", "right"], {}, b"left", object())
NO_OBJECTS: Values = (3, "x", NAN, [1.0], {}, object(), int)

REFUSED: dict[Any, Values] = {
    Finite: NO_NUMBERS,
    Positive: NOT_POSITIVE,
    NonNegative: NEGATIVE,
    Whole: NO_COUNTS,
    Count: (*NO_COUNTS, 0),
    Name: NO_TEXTS[1:-2],
    Prefix: ("-crms_", 3, NAN, ["a"]),
    File: (3, NAN, ["a"], {}),
    Vector: NO_VECTORS,
    Axis: (*NO_VECTORS, (0.0, 0.0, 0.0)),
    PlanVector: NO_PLACES,
    PlanDirection: (*NO_PLACES, (0.0, 0.0, 1.0)),
}


def refused(annotation: Any) -> Values:
    """What an annotation refuses, as far as it is checked before the call begins."""
    union = get_origin(annotation) in (Union, UnionType)
    some = [one for one in get_args(annotation) if one is not NoneType] if union else [annotation]
    one = some[0]
    if len(some) > 1 or getattr(one, "_is_protocol", False):
        return ()
    if get_origin(one) is Literal:
        found = NO_TEXTS
    elif inspect.isclass(one):
        found = NO_OBJECTS if one.__module__.startswith("crms_fenicsx") else ()
    else:
        numbers = get_origin(one) is Annotated and get_args(one)[0] is float
        found = REFUSED.get(one, NO_NUMBERS if numbers else ())
    optional = [] if one is annotation and found else [None]
    return tuple(value for value in found if value is not None) + (None,) * (not optional)


def bad_arguments(call: Any) -> dict[str, Values]:
    """By argument of a call, or of making an object of a class, what its annotation refuses."""
    its = arguments(call)
    every = {} if its is None else {n: refused(one) for n, one in its.annotations.items()}
    return {name: values for name, values in every.items() if values}


def arguments(call: Any) -> Arguments | None:
    """The checked arguments of a call, if they are checked."""
    found = getattr(call.__init__ if inspect.isclass(call) else call, "arguments", None)
    return found if isinstance(found, Arguments) else None


def checked_calls() -> Iterator[tuple[Any, Arguments]]:
    """All functions, methods and `__init__` of the package whose arguments are checked."""
    seen: dict[int, tuple[Any, Arguments]] = {}
    for module in pkgutil.walk_packages(crms_fenicsx.__path__, "crms_fenicsx."):
        for one in vars(import_module(module.name)).values():
            for call in (one, *(vars(one).values() if inspect.isclass(one) else ())):
                its = arguments(call) if inspect.isfunction(call) else None
                if its is not None and call.__wrapped__ is its.call:
                    seen.setdefault(id(its), (call, its))
    yield from seen.values()
