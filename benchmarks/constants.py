"""Each number that decides which state is found, halved and doubled: what changes?

    ./run python benchmarks/constants.py [--scenes 10 24 ...] [--to FILE]

The numbers are the fields of `Discretisation`. The scenes are random ones of `fuzz.py` with cables
that slide, have friction, cross and lift off, and take a second or less. A state counts as another
one if an energy differs by 1e-6, or a tension by 1e-4. Most numbers leave most scenes as they are
to the last digit: several are changed at once, and told apart only where something changes.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

from fuzzing.checks import ENERGY, FORCE, Result
from fuzzing.runs import run
from fuzzing.scenes import scene

from crms_fenicsx.model.tolerances import TOL, Discretisation

SCENES = [
    *(10, 24, 33, 42, 61, 79, 95, 130, 133, 135, 154, 162, 187, 193, 198),
    *(209, 217, 228, 234, 254, 276, 278, 303, 309, 318, 327, 337, 345, 351, 362),
]
FACTORS = (0.5, 2.0)
NUMBERS = [field.name for field in dataclasses.fields(Discretisation)]

Changes = dict[str, Result]
"""Results that differ from those without changes, by the number that has been changed."""


@contextmanager
def recorded() -> Iterator[set[str]]:
    """Names of the numbers that are read."""
    names: set[str] = set()

    def read(self: Discretisation, name: str) -> object:
        names.add(name)
        return object.__getattribute__(self, name)

    with patch.object(Discretisation, "__getattribute__", read):
        yield names


def result(number: int) -> Result:
    """What comes of a scene, without its twin."""
    return run(dataclasses.replace(scene(number), twins=()))


def is_same(a: Result, b: Result) -> bool:
    """Whether two results agree to the last digit."""
    parts = ("outcome", "evaluations", "energies", "tensions")
    return all(getattr(a, part) == getattr(b, part) for part in parts)


def is_other_state(a: Result, b: Result) -> bool:
    """Whether two results of a scene end in different states."""
    if a.outcome != b.outcome or len(a.energies) != len(b.energies):
        return True
    size = max(map(abs, a.energies), default=1.0)
    tensions, others = ([t for step in one.tensions for t in step] for one in (a, b))
    most = max(map(abs, tensions), default=1.0)
    return (
        any(abs(x - y) > ENERGY * size for x, y in zip(a.energies, b.energies, strict=True))
        or any(abs(x - y) > FORCE * most for x, y in zip(tensions, others, strict=True))
    )  # fmt: skip


def changes(number: int, names: Sequence[str], factor: float, before: Result) -> Changes:
    """What each number alone changes in a scene."""
    if not names:
        return {}
    changed = {name: type(getattr(TOL, name))(factor * getattr(TOL, name)) for name in names}
    with patch.dict(vars(TOL), changed):
        after = result(number)
    if is_same(before, after):
        return {}
    if len(names) == 1:
        return {names[0]: after}
    half = len(names) // 2
    parts = (changes(number, part, factor, before) for part in (names[:half], names[half:]))
    return {name: one for part in parts for name, one in part.items()}


def compared(number: int) -> dict[str, Any]:
    """What is read in a scene, and what each number alone changes there."""
    with recorded() as read:
        before = result(number)
    names = [name for name in NUMBERS if name in read]
    changed = [
        {
            "number": name,
            "factor": factor,
            "refused": after.outcome != before.outcome,
            "other": is_other_state(before, after),
            "evaluations": after.evaluations,
        }
        for factor in FACTORS
        for name, after in changes(number, names, factor, before).items()
    ]
    return {"scene": number, "evaluations": before.evaluations, "read": names, "changed": changed}


def show(scenes: Sequence[dict[str, Any]]) -> None:
    """Print a row for each number."""
    print(f"{'':24}{'':>6}" + "".join(f"{f'times {factor}':>30}" for factor in FACTORS))
    print(f"{'number':24}{'read':>6}" + f"{'refused':>10}{'other':>8}{'evaluations':>12}" * 2)
    whole = sum(one["evaluations"] for one in scenes)
    for name in NUMBERS:
        text = f"{name:24}{sum(name in one['read'] for one in scenes):6}"
        for factor in FACTORS:
            own = [
                {**change, "more": change["evaluations"] - one["evaluations"]}
                for one in scenes
                for change in one["changed"]
                if (change["number"], change["factor"]) == (name, factor)
            ]
            refused, other, more = (
                sum(change[key] for change in own) for key in ("refused", "other", "more")
            )
            text += f"{refused:10}{other:8}{1 + more / whole:12.3f}"
        print(text)


def main() -> None:
    """Compare scene by scene, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", type=int, default=SCENES)
    parser.add_argument("--to", type=Path, help="file for a line of JSON for each scene")
    given = parser.parse_args()
    result(given.scenes[0])  # so that everything is imported and compiled
    scenes = []
    for number in given.scenes:
        scenes.append(compared(number))
        if given.to:
            with given.to.open("a", encoding="utf-8") as file:
                file.write(json.dumps(scenes[-1]) + "\n")
    show(scenes)


if __name__ == "__main__":
    main()
