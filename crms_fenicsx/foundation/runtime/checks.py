"""Checks of user input; errors name the argument, its value and the remedy."""

from __future__ import annotations

import math
import operator
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from hashlib import blake2b
from itertools import count, zip_longest
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together

LONGEST = 200
"""Number of characters of a value quoted in a message."""


Named = TypeVar("Named")
Found = TypeVar("Found")


def named(kind: str, ones: Mapping[str, Named], name: str) -> Named:
    """Return the entry of `ones` with the given name."""
    if not isinstance(name, str) or name not in ones:
        names = ", ".join(map(repr, ones)) or "none"
        raise InputError(f"{kind}: there is no {kind} {name!r}; there are {names}.")
    return ones[name]


def finite(what: str, value: object) -> float:
    """Return `value` as a finite float; `what` names it in the error."""
    try:
        if isinstance(value, str | bytes) or np.ndim(value) != 0:  # type: ignore[arg-type]
            raise TypeError
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise InputError(f"{what} = {value!r} is not a number; pass a finite one.") from None
    except OverflowError:  # an integer of more than about 300 digits
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{what} = {value!r} is not finite; pass a finite number.")
    # `codes.peak_pressure` tells what it follows from
    return value if isinstance(value, float) and hasattr(value, "basis") else number


def positive(what: str, value: object) -> float:
    """Return a positive, finite float; `what` and errors as for `finite`."""
    number = finite(what, value)
    if number <= 0:
        raise InputError(f"{what} = {value!r} is not positive; pass a positive number.")
    return number


def non_negative(what: str, value: object) -> float:
    """Return a finite float that is not negative; `what` and errors as for `finite`."""
    number = finite(what, value)
    if number < 0:
        raise InputError(f"{what} = {value!r} is negative; pass 0 or more.")
    return number


def within(what: str, value: object, low: float, high: float, unit: str = "") -> float:
    """Return a float in [low, high], up to rounding; `what` and errors as for `finite`."""
    number = finite(what, value)
    if not low - 8 * EPSILON <= number <= high + 8 * EPSILON:
        unit = unit and f" {unit}"
        raise InputError(f"{what} = {number:g} is outside the range of {low:g} to {high:g}{unit}.")
    return number


def whole(what: str, value: object, least: int) -> int:
    """Return an integer not less than `least`; `what` and errors as for `finite`."""
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = least - 1
    if isinstance(value, bool) or number < least:
        raise InputError(f"{what} = {value!r} must be a whole number, {least} or more.")
    return number


def vector(what: str, value: object, sizes: Sequence[int] = (3,)) -> Array:
    """Return a vector (n,) of finite numbers, n of `sizes`; `what` and errors as for `finite`."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if numbers.ndim != 1 or len(numbers) not in sizes or not np.all(np.isfinite(numbers)):
        words = {2: "two finite numbers (x, y)", 3: "three finite numbers (x, y, z)"}
        raise InputError(f"{what} = {value!r} must be {' or '.join(words[n] for n in sizes)}.")
    return numbers


def direction(what: str, value: object, sizes: Sequence[int] = (3,)) -> Array:
    """Return a `vector` that is not zero."""
    numbers = vector(what, value, sizes)
    if not numbers.any():
        raise InputError(f"{what} = {value!r} is zero, expected a direction.")
    return numbers


def plan_direction(what: str, value: object) -> Array:
    """Return the `direction` (2,) in plan of a vector (2,) or (3,)."""
    numbers = vector(what, value, (2, 3))[:2]
    if not numbers.any():
        raise InputError(f"{what} = {value!r} is zero in plan, expected a direction.")
    return numbers


def pair(what: str, value: Any) -> tuple[float, float]:
    """Return one number, or two along warp and weft, as two finite floats; errors as `finite`."""
    values = list(value) if np.iterable(value) and not isinstance(value, str) else [value, value]
    if len(values) != 2:
        raise InputError(f"{what} = {value!r} must be one number or two (warp, weft).")
    return finite(what, values[0]), finite(what, values[1])


def text(what: str, value: object) -> str:
    """Return a non-empty string; `what` and errors as for `finite`."""
    if not isinstance(value, str) or not value:
        raise InputError(f"{what} = {value!r} is not a non-empty string.")
    return value


def new_name(call: str, kind: str, name: object, taken: Iterable[str], first: int = 1) -> str:
    """Return the checked name of a new part, by default "cable 1", "cable 2" ... from the number
    `first` on; raise an `InputError` that names the `call`."""
    known = set(taken)
    if name is None:
        return next(free for n in count(first) if (free := f"{kind} {n}") not in known)
    if not isinstance(name, str) or not name or name != name.strip():
        raise InputError(f"{call}: name = {name!r} must be text without blanks around it.")
    if name in known:
        raise InputError(f"{call}: there is a {kind} {name!r} already; use another name.")
    return name


def own(call: str, kind: str, one: object, ones: Iterable[object]) -> None:
    """Raise an `InputError` if a part of a `kind` is not one of a scene's."""
    if not any(one is other for other in ones):
        raise InputError(f"{call}: {one!r} is not a {kind} of this scene.")


def directions(call: str, given: object) -> None:
    """Raise an `InputError` if directions are no letters of x, y and z."""
    if not isinstance(given, str) or not given or set(given) - set("xyz"):
        raise InputError(f"{call}: directions = {given!r} must be made of the letters x, y and z.")


def options_prefix(what: str, value: object) -> str:
    """Return a PETSc options prefix; `what` and errors as for `finite`."""
    if not isinstance(value, str) or value.startswith("-"):
        raise InputError(
            f"{what} = {value!r} is not an options prefix; pass a string without the leading '-'."
        )
    return value


def one_of(what: str, value: Any, known: Iterable[object]) -> Any:
    """Return a value if it is one of the known ones."""
    if value not in (known := list(known)):
        *others, last = map(repr, known)
        raise InputError(f"{what} = {value!r} is not known; use {', '.join(others)} or {last}.")
    return value


def of_type(what: str, value: Any, kind: type) -> Any:
    """Return a value if it is of a type."""
    if not isinstance(value, kind):
        is_class, article = isinstance(value, type), "an" if kind.__name__[0] in "AEIOU" else "a"
        found = f"the class {value.__name__}" if is_class else f"of type {type(value).__name__}"
        raise InputError(f"{what} is {found}; pass {article} {kind.__name__}.")
    return value


def collection(what: str, value: Any, kind: Any, example: str, least: int = 0) -> None:
    """Refuse a value that is not a `Mapping` or `Sequence`, or has fewer than `least` members."""
    if isinstance(value, str) or not isinstance(value, kind) or len(value) < least:
        name = "list" if kind is Sequence else "mapping"
        raise InputError(f"{what} = {value!r} is not a valid {name}; write {example}.")


def returned(function: str, values: object, places: Array, shape: tuple[int, ...]) -> Array:
    """Check what a user's function returned at `places` (3, n): finite numbers of a given shape."""
    found = np.asarray(values)
    if found.shape != shape or found.dtype.kind not in "fiu":
        raise InputError(
            f"{function} returned an array of shape {found.shape} and type {found.dtype}; it must "
            f"return real numbers of shape {shape}."
        )
    bad = ~np.isfinite(np.atleast_2d(found)).all(axis=0)
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"{function} returned {found[..., first]} at {places[:, first]}; it must return finite "
            "numbers."
        )
    return np.asarray(found, dtype=np.float64)


def file(what: str, value: object) -> Path:
    """Return the path of a file or folder; `what` and errors as for `finite`."""
    if not isinstance(value, str | os.PathLike):
        raise InputError(f"{what} = {value!r} is not a path; pass a string or a pathlib.Path.")
    return Path(value)


def same(comm: MPI.Intracomm, call: str, /, **arguments: object) -> None:
    """Refuse arguments that differ between the ranks. Collective."""
    if comm.size == 1 or not arguments:
        return
    own = {name: _text(value) for name, value in arguments.items()}
    encoded = repr(sorted(own.items())).encode()
    digest = int.from_bytes(blake2b(encoded, digest_size=7).digest(), "big")
    extremes = np.array([digest, -digest])
    comm.Allreduce(MPI.IN_PLACE, extremes, op=MPI.MAX)
    if extremes[0] == -extremes[1]:
        return
    first = comm.bcast(own)
    names = {**first, **own}  # a rank may omit an argument that others give
    differing = next((name for name in names if own.get(name) != first.get(name)), None)
    rank = comm.allreduce(comm.size if differing is None else comm.rank, op=MPI.MIN)
    if rank == comm.size:
        return
    name, text = comm.bcast((differing, own.get(differing or "", "nothing")), root=rank)
    other = first.get(name, "nothing")
    pairs = enumerate(zip_longest(other, text))
    begin = max(next(k for k, (a, b) in pairs if a != b) - LONGEST // 2, 0)
    other, text = (("..." if begin else "") + one[begin:][:LONGEST] for one in (other, text))
    raise InputError(
        f"{call}: {name} = {other} on rank 0, but {text} on rank {rank}; "
        "pass the same on all ranks, for example by comm.bcast."
    )


def from_first(comm: MPI.Intracomm, function: Callable[[], Found]) -> Found:
    """Call a function on rank 0 and return its result, or raise its error, on all. Collective."""
    found = None
    with raised_together(comm):
        if comm.rank == 0:
            found = function()
    return cast(Found, comm.bcast(found))


def in_one_order(comm: MPI.Intracomm, given: Mapping[str, Named]) -> dict[str, Named]:
    """Return a mapping in rank 0's order of names, for collective loops over it: `same` accepts
    any order. Collective."""
    return {name: given[name] for name in comm.bcast(list(given))}


def _text(value: object) -> str:
    """Full-precision text of a value, without addresses and independent of the order of keys."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(sorted(f'{_text(k)}: {_text(v)}' for k, v in value.items()))}}}"
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(value))


def span(values: Sequence[float] | Array) -> str:
    """Range of the values as text; NaN are ignored.

    >>> span([3.0, 1.0])
    '1 to 3'
    """
    known = np.asarray(values, dtype=np.float64).ravel()
    known = known[np.isfinite(known)]
    if len(known) == 0:
        return "none"
    low, high = f"{known.min():.4g}", f"{known.max():.4g}"
    return low if low == high else f"{low} to {high}"


def counted(n: int, what: str) -> str:
    """A number with its noun, in the plural unless it is 1.

    >>> counted(2, "cell")
    '2 cells'
    """
    return f"{n} {what}{'' if n == 1 else 's'}"


def as_counted(name: str) -> list[tuple[str, int]]:
    """Key that sorts names as people count: "1", "2", "10"."""
    return [(text, int(digits or -1)) for text, digits in re.findall(r"(\D*)(\d*)", name)]
