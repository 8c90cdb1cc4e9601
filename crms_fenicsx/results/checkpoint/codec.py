"""Encode dataclasses of numbers, texts, arrays and other dataclasses as JSON data, and decode them.

Decoded data must have the fields and types of the class's type hints. Numbers keep
every digit; NaN in an array becomes None. `_Storage` writes arrays hinted as `Rows` of the mesh to
separate files, replaces handles by their names, and omits fields marked `UNSAVED`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from itertools import repeat
from types import NoneType, SimpleNamespace, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    Protocol,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Rows
from crms_fenicsx.foundation.runtime.handle import Handle

Plain = dict[str, Any]
"""JSON data: dictionaries and lists of numbers, texts and None."""

Kind = TypeVar("Kind")


class _Storage(Protocol):
    """Stores objects that are not plain data, by the path of fields that leads to them."""

    def write(self, path: str, rows: Rows, values: np.ndarray[Any, Any]) -> Plain:
        """Write a distributed array and return its description. Collective."""

    def read(
        self, path: str, rows: Rows, dtype: np.dtype[Any], shape: tuple[int, ...], data: Any
    ) -> np.ndarray[Any, Any]:
        """Read this rank's rows, (n, *shape). Collective."""

    def reduce(self, value: Any) -> Any:
        """Plain data for a special object, or the value itself."""

    def restore(self, kind: type, data: Any, path: str) -> Any:
        """Restore an object reduced by `reduce`; `NotImplemented` for other classes."""

    def unsaved(self, kind: type) -> Mapping[str, Any]:
        """Present values of a class's fields that are not saved."""


def encode(value: Any, storage: _Storage | None = None, path: str = "") -> Any:
    """JSON data of a dataclass: its constructor fields except unsaved ones."""
    if storage is not None:
        value = storage.reduce(value)
    if isinstance(value, Handle):
        return value.name
    if is_dataclass(value):
        found = {}
        for name, hint in _hints(type(value)).items():  # type: ignore[arg-type]
            one, rows, place = getattr(value, name), _rows(hint), _below(path, name)
            if rows is None or one is None or storage is None:
                found[name] = encode(one, storage, place)
            else:
                found[name] = storage.write(place, rows, one)
        return found
    if isinstance(value, np.ndarray):
        return _without_nan(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {
            key.name if isinstance(key, Handle) else key: encode(one, storage, _below(path, k))
            for k, (key, one) in enumerate(value.items())
        }
    if isinstance(value, set):
        return sorted(map(encode, value), key=str)
    if isinstance(value, list | tuple):
        return [encode(one, storage, _below(path, k)) for k, one in enumerate(value)]
    return value if isinstance(value, int | str | None) else float(value)


def _below(path: str, name: str | int) -> str:
    return f"{path}.{name}" if path else str(name)


def _rows(hint: Any) -> Rows | None:
    """Mesh entity of an array field's rows; None for other fields."""
    if get_origin(hint) in (Union, UnionType):
        return next((rows for one in get_args(hint) if (rows := _rows(one)) is not None), None)
    marks = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    return next((mark for mark in marks if isinstance(mark, Rows)), None)


def _without_nan(value: Any) -> Any:
    if isinstance(value, list):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and math.isnan(value) else value


def decode(kind: type[Kind], data: object, storage: _Storage | None = None, path: str = "") -> Kind:
    """Restore a dataclass from the data of `encode`."""
    hints = _hints(kind)  # type: ignore[arg-type]
    if not isinstance(data, dict) or data.keys() != hints.keys():
        found = sorted(data) if isinstance(data, dict) else data
        raise ValueError(f"expected {kind.__name__} with {sorted(hints)}, found {found!r}")
    read = {
        name: _decoded(hint, data[name], storage, _below(path, name))
        for name, hint in hints.items()
    }
    return kind(**read, **({} if storage is None else storage.unsaved(kind)))


@cache
def _hints(kind: type) -> dict[str, Any]:
    """Type hints of a dataclass's saved constructor fields."""
    saved = {f.name: f.type for f in fields(kind) if f.init and "UNSAVED" not in str(f.type)}
    names = vars(sys.modules[kind.__module__])
    return get_type_hints(SimpleNamespace(__annotations__=saved), names, include_extras=True)


def _decoded(hint: Any, data: Any, storage: _Storage | None, path: str) -> Any:
    """Decode the value of a type hint."""
    origin, args = get_origin(hint), get_args(hint)
    if hasattr(origin, "__value__"):  # since 2.5 NumPy's NDArray is a named alias
        return _decoded(origin.__value__[args], data, storage, path)
    if storage is not None and isinstance(hint, type):
        made = storage.restore(hint, data, path)
        if made is not NotImplemented:
            return made
    if is_dataclass(hint):
        return decode(hint, data, storage, path)  # type: ignore[arg-type]
    if origin is Annotated and isinstance(args[1], Rows) and storage is not None:
        dtype = np.dtype(get_args(get_args(args[0])[1])[0])
        return storage.read(path, args[1], dtype, args[2:], data)
    if origin is Annotated:
        value = _decoded(args[0], data, storage, path)
        none = isinstance(value, np.ndarray) and value.shape == (0,) and len(args) > 2
        return value.reshape(0, *args[2:]) if none else value
    if origin in (Union, UnionType):
        return _one_of(args, data, storage, path)
    if origin is np.ndarray:
        dtype = np.dtype(get_args(args[1])[0])
        array = np.array(data, dtype=dtype if dtype.kind == "f" else None)
        if not isinstance(data, list) or (array.size and array.dtype.kind != dtype.kind):
            raise ValueError(f"expected an array of {dtype}, found {data!r}")
        return array.astype(dtype)
    if origin is tuple and isinstance(data, list):
        hints = repeat(args[0], len(data)) if args[-1] is Ellipsis else args
        return tuple(
            _decoded(of, one, storage, _below(path, k))
            for k, (of, one) in enumerate(zip(hints, data, strict=True))
        )
    if origin in (list, set) and isinstance(data, list):
        return origin(_decoded(args[0], one, storage, path) for one in data)
    if origin in (dict, Mapping) and isinstance(data, dict):
        return {
            _decoded(args[0], key, storage, path): _decoded(args[1], one, storage, _below(path, k))
            for k, (key, one) in enumerate(data.items())
        }
    if hint is float and type(data) in (int, float):
        return float(data)
    if hint is Any or type(data) is hint or (origin is Literal and data in args):
        return data
    raise ValueError(f"expected {getattr(hint, '__name__', hint)}, found {data!r}")


def _one_of(hints: Iterable[Any], data: Any, storage: _Storage | None, path: str) -> Any:
    """Decode data as the first matching type."""
    error: Exception | None = None
    for hint in hints:
        if (hint is NoneType) == (data is None):
            try:
                return _decoded(hint, data, storage, path)
            except (ArithmeticError, LookupError, TypeError, ValueError) as one:
                error = one
    raise ValueError(f"{data!r}: {error or 'expected a value'}")
