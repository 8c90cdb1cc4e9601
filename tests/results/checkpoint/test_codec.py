"""Data for JSON from dataclasses, and back by their type hints."""

from __future__ import annotations

import dataclasses
import json
import typing
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
import pytest

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint, SurfacePoint, VertexPoint
from crms_fenicsx.results.checkpoint.codec import decode, encode


@dataclass(frozen=True)
class Inner:
    kind: Literal["round", "square"]
    point: SurfacePoint | None = None


@dataclass(frozen=True)
class Outer:
    inner: Annotated[tuple[Inner, ...], "n"]
    places: Annotated[Array, "n", 3]
    on: Annotated[Booleans, "n"]
    ids: Integers
    number: float
    count: int
    is_new: bool
    pair: tuple[int, str] | tuple[str, str]
    names: dict[str, set[tuple[int, ...]]]
    friction: float | Inner
    extra: Annotated[Array, 2] | None = None
    rest: dict[str, Any] | None = None


POINTS = (VertexPoint(3), EdgePoint((1, 2), 0.1), CellPoint((1, 2, 3), (0.2, 0.3, 0.5)), None)
WHOLE = Outer(
    tuple(Inner("round", point) for point in POINTS),
    np.array([[np.nan, 0.1, 1 / 3]] * 4), np.array([True, False, True, True]),
    np.array([2**62, -1]), np.float64(1e-308), np.int32(7), np.bool_(True), ("a", "b"),
    {"c": {(1, 2), (0,)}, "d": set()}, 9000, np.array([1.0, 2.0]), {"what": [1, "x", None]},
)  # fmt: skip
EMPTY = Outer(
    (), np.zeros((0, 3)), np.zeros(0, dtype=bool), np.zeros(0, dtype=np.int64), 0.0, 0, False,
    (1, "b"), {}, Inner("square"),
)  # fmt: skip


def through_json(value: object) -> Any:
    return json.loads(json.dumps(encode(value), allow_nan=False))


@pytest.mark.parametrize("value", [WHOLE, EMPTY], ids=["whole", "empty"])
def test_there_and_back(value: Outer) -> None:
    """To the last digit, the same types: what is read is written alike."""
    data = through_json(value)
    found = decode(Outer, data)
    assert through_json(found) == data
    for name in ("places", "on", "ids"):
        array, expected = getattr(found, name), getattr(value, name)
        np.testing.assert_array_equal(array, expected)
        assert array.dtype == expected.dtype
    for name in ("inner", "number", "count", "is_new", "pair", "names", "friction", "rest"):
        assert getattr(found, name) == getattr(value, name)
    assert [type(x) for x in (found.number, found.count, found.is_new)] == [float, int, bool]


def spoilt(**changes: object) -> Any:
    return through_json(WHOLE) | changes


WRONG: dict[str, Any] = {
    "no object": [1],
    "a field more": spoilt(more=1),
    "a field less": {k: v for k, v in through_json(WHOLE).items() if k != "on"},
    "text": spoilt(number="1.0"),
    "no text": spoilt(pair=[1, 2]),
    "no boolean": spoilt(is_new=1),
    "a boolean": spoilt(count=True),
    "no integer": spoilt(ids=[1.5]),
    "too large": spoilt(ids=[2**70]),
    "too large a number": spoilt(number=10**400),
    "no booleans": spoilt(on=[1, 0, 1, 1]),
    "ragged": spoilt(places=[[1.0], [1.0, 2.0, 3.0]]),
    "no array": spoilt(places=1.0),
    "none": spoilt(number=None),
    "another word": spoilt(friction={"kind": "oval", "point": None}),
    "another point": spoilt(friction={"kind": "round", "point": {"vertex": -1}}),
    "a tuple too long": spoilt(pair=["a", "b", "c"]),
    "no list": spoilt(inner={}),
    "no mapping": spoilt(names=[]),
}


@pytest.mark.parametrize("data", WRONG.values(), ids=WRONG)
def test_what_does_not_fit_is_refused(data: Any) -> None:
    with pytest.raises((ArithmeticError, LookupError, TypeError, ValueError)):
        decode(Outer, data)


def test_what_is_no_number_is_not_written() -> None:
    with pytest.raises((TypeError, ValueError)):
        through_json(replace(WHOLE, number=np.nan))
    with pytest.raises((TypeError, ValueError)):
        through_json(replace(WHOLE, rest={"what": object()}))


@pytest.mark.skipif(not hasattr(typing, "TypeAliasType"), reason="aliases by name need Python 3.12")
def test_arrays_by_a_named_alias() -> None:
    """As NumPy's NDArray is one since 2.5."""
    scalar = typing.TypeVar("scalar", bound=np.generic)
    alias = typing.TypeAliasType(  # type: ignore[attr-defined,unused-ignore]
        "NDArray", np.ndarray[Any, np.dtype[scalar]], type_params=(scalar,)
    )
    made = dataclasses.make_dataclass("Made", [("places", Annotated[alias[np.float64], "n", 2])])
    found = decode(made, {"places": [[1.0, 2.0], [3.0, None]]})
    assert np.array_equal(found.places, [[1.0, 2.0], [3.0, np.nan]], equal_nan=True)
