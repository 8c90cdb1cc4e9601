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
from unittest.mock import patch

from fuzzing.runs import SAME_ENERGY, SAME_TENSION, Result, run
from fuzzing.scenes import scene

from crms_fenicsx.model.tolerances import TOL, Discretisation

SCENES = [
    *(10, 24, 33, 42, 61, 79, 95, 130, 133, 135, 154, 162, 187, 193, 198),
    *(209, 217, 228, 234, 254, 276, 278, 303, 309, 318, 327, 337, 345, 351, 362),
]
FACTORS = (0.5, 2.0)

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
    return run(dataclasses.replace(scene(number), twin=""))


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
        any(abs(x - y) > SAME_ENERGY * size for x, y in zip(a.energies, b.energies, strict=True))
        or any(abs(x - y) > SAME_TENSION * most for x, y in zip(tensions, others, strict=True))
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


def main() -> None:
    """Print a row for each number."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="+", type=int, default=SCENES)
    parser.add_argument("--to", type=Path, help="file for a line of JSON for each change")
    given = parser.parse_args()
    numbers = [field.name for field in dataclasses.fields(Discretisation)]
    result(given.scenes[0])  # so that everything is imported and compiled
    reading = dict.fromkeys(numbers, 0)
    rows = {name: {factor: [0, 0, 0] for factor in FACTORS} for name in numbers}
    evaluations = 0
    for number in given.scenes:
        with recorded() as read:
            before = result(number)
        names = [name for name in numbers if name in read]
        evaluations += before.evaluations
        for name in names:
            reading[name] += 1
        for factor in FACTORS:
            for name, after in changes(number, names, factor, before).items():
                other = is_other_state(before, after)
                row = rows[name][factor]
                row[0] += after.outcome != before.outcome
                row[1] += other
                row[2] += after.evaluations - before.evaluations
                line = {"number": name, "factor": factor, "scene": number, "other": other}
                if given.to:
                    with given.to.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(line | dataclasses.asdict(after)) + "\n")
    print(f"{'':24}{'read':>6}" + "".join(f"{f'times {factor}':>30}" for factor in FACTORS))
    print(f"{'number':24}{'':>6}" + f"{'refused':>10}{'other':>8}{'evaluations':>12}" * 2)
    for name in numbers:
        text = f"{name:24}{reading[name]:6}"
        for refused, others, more in rows[name].values():
            text += f"{refused:10}{others:8}{1 + more / evaluations:12.3f}"
        print(text)


if __name__ == "__main__":
    main()
