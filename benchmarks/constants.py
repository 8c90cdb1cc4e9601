"""Each number that decides which state is found, halved and doubled: what changes?

    ./run python benchmarks/constants.py [--names PULL DEPTH ...] [--to FILE]

The numbers are those of the class "answer" in `docs/theory/constants.md`. The scenes are random
ones of `fuzz.py` with cables that slide, have friction, cross and lift off, and take a second or
less. A state counts as another one if an energy differs by 1e-6, or a tension by 1e-4.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fuzzing.checks import ENERGY, FORCE, Result
from fuzzing.runs import run
from fuzzing.scenes import scene

import crms_fenicsx

REGISTER = Path(crms_fenicsx.__file__).parents[1] / "docs" / "theory" / "constants.md"
SCENES = (
    10, 24, 33, 42, 61, 79, 95, 130, 133, 135, 154, 162, 187, 193, 198,
    209, 217, 228, 234, 254, 276, 278, 303, 309, 318, 327, 337, 345, 351, 362,
)  # fmt: skip
FACTORS = (0.5, 2.0)


def answers() -> list[tuple[str, str]]:
    """Modules and names of the numbers that decide which state is found."""
    row = re.compile(r"^\| `([\w/]+)\.py` \| `(\w+)` \| answer ")
    rows = map(row.match, REGISTER.read_text(encoding="utf-8").splitlines())
    return [("crms_fenicsx." + m[1].replace("/", "."), m[2]) for m in rows if m]


@contextmanager
def multiplied(module: str, name: str, factor: float) -> Iterator[None]:
    """Multiply a module's number, also where other modules have imported it."""
    __import__(module)
    old = vars(sys.modules[module])[name]
    new = type(old)(old * factor) if isinstance(old, int) else old * factor
    users = [
        one for key, one in sys.modules.items()
        if key.startswith("crms_fenicsx") and vars(one).get(name) is old
    ]  # fmt: skip
    for one in users:
        setattr(one, name, new)
    try:
        yield
    finally:
        for one in users:
            setattr(one, name, old)


def results() -> list[Result]:
    """What comes of the scenes, without their twins."""
    return [run(dataclasses.replace(scene(number), twins=())) for number in SCENES]


def other_state(a: Result, b: Result) -> bool:
    """Whether two results of a scene end in different states."""
    if a.outcome != b.outcome:
        return True
    size = max(map(abs, a.energies), default=1.0)
    tensions = [t for step in a.tensions for t in step]
    others = [t for step in b.tensions for t in step]
    most = max(map(abs, tensions), default=1.0)
    return (
        any(abs(x - y) > ENERGY * size for x, y in zip(a.energies, b.energies, strict=True))
        or any(abs(x - y) > FORCE * most for x, y in zip(tensions, others, strict=True))
    )  # fmt: skip


def main() -> None:
    """Print a row for each number."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--names", nargs="+")
    parser.add_argument("--to", type=Path)
    given = parser.parse_args()
    results()  # so that everything is imported and compiled
    before = results()
    print(f"{'':50}{'halved':>28}{'doubled':>28}")
    print(f"{'number':50}" + f"{'refused':>8}{'other':>8}{'evaluations':>12}" * 2)
    own = sum(one.evaluations for one in before)
    for module, name in answers():
        if given.names and name not in given.names:
            continue
        line: dict[str, Any] = {"module": module, "name": name}
        shown = f"{module.removeprefix('crms_fenicsx.')}.{name:20}"
        text = f"{shown:50}"
        for factor in FACTORS:
            with multiplied(module, name, factor):
                after = results()
            refused = sum(one.outcome != "converged" for one in after)
            other = [o.number for o, n in zip(before, after, strict=True) if other_state(o, n)]
            spent = sum(one.evaluations for one in after) / own
            line[str(factor)] = {"refused": refused, "other": other, "evaluations": spent}
            text += f"{refused:8}{len(other):8}{spent:12.3f}"
        print(text, flush=True)
        if given.to:
            with given.to.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")


if __name__ == "__main__":
    main()
