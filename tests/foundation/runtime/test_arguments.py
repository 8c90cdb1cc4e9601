"""Arguments are checked by their annotations, and compared between the ranks."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from bad_values import bad_arguments, checked_calls
from mpi4py import MPI

from crms_fenicsx import Cable, InputError
from crms_fenicsx.foundation.runtime.arguments import (
    Axis,
    Count,
    PerRank,
    Positive,
    checked,
    collective,
)
from crms_fenicsx.foundation.runtime.arrays import Array


@checked
def measure(
    length: Positive,
    *,
    count: Count = 1,
    way: Axis = (1.0, 0.0, 0.0),
    kind: Literal["long", "short"] = "long",
    cable: Cable | None = None,
    limit: Positive | None = None,
) -> tuple[float, int, Any]:
    return length, count, way


class Group:
    """Ranks with a call of their own."""

    def __init__(self, comm: MPI.Intracomm) -> None:
        self.comm = comm

    @collective
    def total(
        self, value: Positive, *more: float, own: PerRank[Array | None] = None, **others: float
    ) -> float:
        return value + sum(more)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"length": -1.0}, "measure: length = -1.0 is not positive; pass a positive number."),
        ({"count": 0}, "measure: count = 0 must be a whole number, 1 or more."),
        ({"way": (0, 0, 0)}, "measure: way = (0, 0, 0) is zero, expected a direction."),
        ({"kind": "wide"}, "measure: kind = 'wide' is not known; use 'long' or 'short'."),
        ({"cable": 3.0}, "measure: cable is of type float; pass a Cable."),
        ({"limit": 0.0}, "measure: limit = 0.0 is not positive; pass a positive number."),
    ],
)
def test_messages(given: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as error:
        measure(**{"length": 1.0, **given})
    assert str(error.value) == message


def test_functions_get_checked_values() -> None:
    length, count, way = measure(np.int64(2), count=np.int32(3), way=[0, 0, 1])
    assert type(length) is float and type(count) is int and isinstance(way, np.ndarray)
    assert measure(1.0, cable=None, limit=None)[0] == 1.0


def test_every_annotation_of_the_package_refuses_bad_values() -> None:
    """Before the call begins, so that other arguments may be missing."""
    counted = 0
    for call, its in checked_calls():
        own = [object()] if "self" in its.annotations else []
        for name, values in bad_arguments(call).items():
            for value in values:
                with pytest.raises(InputError) as error:
                    call(*own, **{name: value})
                text = str(error.value)
                assert text.startswith(f"{its.name}: {name} "), text
                kind = f"is of type {type(value).__name__};"
                if isinstance(value, type):
                    kind = f"is the class {value.__name__};"
                assert repr(value) in text or kind in text, text
                counted += 1
    assert counted > 1000


@pytest.mark.ranks
def test_ranks_agree(comm: MPI.Intracomm) -> None:
    group, rank = Group(comm), comm.rank
    assert group.total(1.0, 2.0, own=np.arange(rank), others=1.0) == 3.0
    if comm.size == 1:
        return
    last = float(rank == comm.size - 1)
    calls = {
        "total: value = 1.0 on rank 0, but 2.0": lambda: group.total(1.0 + last),
        "total: more = (0.0,) on rank 0, but (1.0,)": lambda: group.total(1.0, last),
        "total: own = None on rank 0, but 'given'": lambda: group.total(
            1.0, own=np.zeros(1) if last else None
        ),
        "total: other = 0.0 on rank 0, but 1.0": lambda: group.total(1.0, other=last),
        "total: value = -1.0 is not positive": lambda: group.total(-1.0),
    }
    for words, call in calls.items():
        with pytest.raises(InputError, match=r"^total: ") as caught:
            call()
        assert words in str(caught.value)
        assert len(set(comm.allgather(str(caught.value)))) == 1
