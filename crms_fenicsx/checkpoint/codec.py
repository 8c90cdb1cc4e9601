"""Dataclasses of numbers, texts, arrays and each other as data for JSON, and back.

What is read must have the fields, types and array shapes that the type hints of its class say.
Numbers survive to the last digit; NaN in an array is None in JSON.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import repeat
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

Plain = dict[str, Any]
"""Data for JSON: dictionaries and lists of numbers, texts and None."""

Kind = TypeVar("Kind")


def encode(value: Any) -> Any:
    """Data for JSON from a dataclass, of which they have the fields that it is made from."""
    if is_dataclass(value):
        return {f.name: encode(getattr(value, f.name)) for f in fields(value) if f.init}
    if isinstance(value, np.ndarray):
        return _without_nan(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {key: encode(one) for key, one in value.items()}
    if isinstance(value, set):
        return sorted(map(encode, value), key=str)
    if isinstance(value, list | tuple):
        return [encode(one) for one in value]
    return value if isinstance(value, int | str | None) else float(value)


def _without_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def decode(kind: type[Kind], data: object) -> Kind:
    """A dataclass from what `encode` has made of it."""
    hints = _hints(kind)  # type: ignore[arg-type]
    if not isinstance(data, dict) or data.keys() != hints.keys():
        found = sorted(data) if isinstance(data, dict) else data
        raise ValueError(f"{found!r} where {kind.__name__} has {sorted(hints)}")
    sizes: dict[str, int] = {}
    return kind(**{name: _decode(hint, data[name], sizes) for name, hint in hints.items()})


@cache
def _hints(kind: type) -> dict[str, Any]:
    """The type hints of the fields that a dataclass is made from."""
    hints = get_type_hints(kind, include_extras=True)
    return {f.name: hints[f.name] for f in fields(kind) if f.init}


def _decode(hint: Any, data: Any, sizes: dict[str, int]) -> Any:
    origin, args = get_origin(hint), get_args(hint)
    if hasattr(origin, "__value__"):  # NumPy's NDArray is an alias by name since 2.5
        return _decode(origin.__value__[args], data, sizes)
    if is_dataclass(hint):
        return decode(hint, data)  # type: ignore[arg-type]
    if origin is Annotated:
        return _shaped(_decode(args[0], data, sizes), args[1:], sizes)
    if origin in (Union, UnionType):
        return _one_of(args, data, sizes)
    if origin is np.ndarray:
        return _array(data, np.dtype(get_args(args[1])[0]))
    if origin is tuple and isinstance(data, list):
        hints = repeat(args[0], len(data)) if args[-1] is Ellipsis else args
        return tuple(_decode(of, one, sizes) for of, one in zip(hints, data, strict=True))
    if origin in (list, set) and isinstance(data, list):
        return origin(_decode(args[0], one, sizes) for one in data)
    if origin in (dict, Mapping) and isinstance(data, dict):
        return {key: _decode(args[1], one, sizes) for key, one in data.items()}
    if hint is float and type(data) in (int, float):
        return float(data)
    if hint is Any or type(data) is hint or (origin is Literal and data in args):
        return data
    raise ValueError(f"{data!r} where {getattr(hint, '__name__', hint)} is due")


def _one_of(hints: Iterable[Any], data: Any, sizes: dict[str, int]) -> Any:
    """The data as the first type that they fit."""
    error: Exception | None = None
    for hint in hints:
        if (hint is NoneType) == (data is None):
            try:
                return _decode(hint, data, sizes)
            except (ArithmeticError, LookupError, TypeError, ValueError) as one:
                error = one
    raise ValueError(f"{data!r}: {error or 'a value is due'}")


def _array(data: Any, dtype: np.dtype[Any]) -> np.ndarray[Any, Any]:
    array = np.array(data, dtype=dtype if dtype.kind == "f" else None)
    if not isinstance(data, list) or (array.size and array.dtype.kind != dtype.kind):
        raise ValueError(f"{data!r} where an array of {dtype} is due")
    return array.astype(dtype)


def _shaped(value: Any, shape: tuple[int | str, ...], sizes: dict[str, int]) -> Any:
    """An array or a tuple, if it has a shape; names in this stand for the sizes found before."""
    if isinstance(value, np.ndarray) and value.shape == (0,) and len(shape) > 1:
        value = value.reshape(0, *shape[1:])
    found = value.shape if isinstance(value, np.ndarray) else (len(value),)
    due = tuple(
        sizes.setdefault(n, size) if isinstance(n, str) else n
        for n, size in zip(shape, found, strict=True)
    )
    if found != due:
        raise ValueError(f"numbers of shape {found} where {due} are due")
    return value
