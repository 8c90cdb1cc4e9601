"""Random scenes of many features at once, and twins that must have the same answer.

    ./run python benchmarks/fuzz_features.py --scenes 0 500 --to results/features.jsonl
    ./run python benchmarks/fuzz_features.py --scene 123            one again, with details
    ./run mpirun -n 3 python -m mpi4py benchmarks/fuzz_features.py --scenes 0 50 --against FILE

A scene follows from its number (`fuzzing.feature_scenes`); `fuzzing.feature_runs` checks it.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import logging
import sys
from collections import Counter
from pathlib import Path

import numpy as np
from mpi4py import MPI


def main() -> None:
    """Do what is asked for."""
    from fuzzing.feature_runs import TWINS, Found, compare, run
    from fuzzing.feature_scenes import feature_scene

    parser = argparse.ArgumentParser(description="Random scenes: see the head of this file.")
    parser.add_argument("--scenes", nargs=2, type=int, metavar=("FIRST", "END"))
    parser.add_argument("--scene", type=int, help="one scene, in detail")
    parser.add_argument("--to", type=Path, help="file to which a line is added for each scene")
    parser.add_argument("--against", type=Path, help="results to compare with, without twins")
    parser.add_argument("--twins", nargs="*", default=None, help="which; two of them by default")
    parser.add_argument("--empty", action="store_true", help="leave the first rank without cells")
    given = parser.parse_args()
    comm = MPI.COMM_WORLD
    numbers = range(*given.scenes) if given.scenes else [given.scene]
    if given.scene is not None:
        logging.basicConfig(level=logging.DEBUG, stream=sys.stdout)
        data = feature_scene(given.scene)
        print(dataclasses.replace(data, points=data.points[:1], cells=data.cells[:1]))
    earlier = {}
    if given.against:
        lines = given.against.read_text(encoding="utf-8").splitlines()
        earlier = {line["number"]: Found(**line) for line in map(json.loads, lines)}
    found = []
    for number in numbers:
        rng = np.random.default_rng(number)
        twins = tuple(rng.choice(TWINS, 2, replace=False)) if given.twins is None else given.twins
        ranks = (lambda x: np.full(len(x), comm.size - 1)) if given.empty else None
        data = feature_scene(number)
        result = run(data, comm, () if given.against else tuple(twins), ranks)
        if number in earlier:
            was = earlier[number]
            if (was.text == "") != (result.text == ""):
                result.problems.append(f"processes: {was.text!r} and {result.text!r}")
            elif not was.text:
                compare("processes", was, result, result)
        found.append(result)
        if comm.rank == 0:
            if given.to is not None:
                given.to.parent.mkdir(parents=True, exist_ok=True)
                with given.to.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(dataclasses.asdict(result)) + "\n")
            if result.problems or given.scene is not None:
                print(number, result.kind, list(map(str, twins)), result.names, flush=True)
                for text in (*result.problems, *result.notes, result.text):
                    print("    ", text, flush=True)
    if comm.rank == 0:
        print(Counter(r.outcome for r in found), f"{sum(r.seconds for r in found):.0f} s")
        for kind in ("text", "notes", "problems"):
            texts = [getattr(r, kind) for r in found]
            every = [t for t in texts if t] if kind == "text" else [t for ts in texts for t in ts]
            for text, n in Counter(t.split(" by ")[0][:110] for t in every).most_common():
                print(f"{n:5} {kind}: {text}")


if __name__ == "__main__":
    main()
