"""Random invalid input to every public call, on all ranks or on one only.

    ./run mpirun -n 3 python benchmarks/bad_input.py [CALLS [SEED]]

Every call must raise the same error of the package on all ranks, compute nothing and change
nothing. Prints the calls that do not, and then fails. If a call hangs, all ranks end after a while
and report their position.
"""

from __future__ import annotations

import faulthandler
import re
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "scenes"))

from bad_calls import ACROSS, FOIL, Call, data, generators, scenes, snapshot
from bad_feature_calls import features

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.foundation.runtime import errors

COMM = MPI.COMM_WORLD
HANG = 60.0
"""Seconds after which a call hangs."""


def solve(*arguments: object) -> None:
    """Stands for all that computes: nothing may."""
    raise AssertionError("a solve was begun")


def ended(call: Call, arguments: dict[str, Any]) -> str:
    """What a call ended with on this rank."""
    try:
        call.function(**arguments)
    except Exception as error:
        text = f"{type(error).__name__}: {re.sub(' at 0x[0-9a-f]+', '', str(error))}"
        known = isinstance(error, InputError) or "unexpected keyword" in text  # Python's own
        return text if known else f"bad, {text}"
    return "bad, no error"


def main(count: int = 200, seed: int = 0) -> int:
    """Make that many calls; returns how many ended badly."""
    warnings.simplefilter("ignore")  # of values that are worth a warning and wrong otherwise
    errors.PATIENCE = HANG / 3
    EquilibriumSearch.find = solve  # type: ignore[assignment]
    mesh = meshes.rectangle(COMM, 100.0, 100.0, 25.0, structured=True)
    scene, other = (Scene(mesh, IsotropicMembrane(**FOIL)) for _ in range(2))  # type: ignore[arg-type]
    scene.fix("boundary")
    other.fix("boundary")
    cable = scene.lay_cable(Cable(32000.0), ACROSS)
    solver = Solver(scene)
    table = data() + generators(COMM) + scenes(scene, other, solver, cable)
    table += features(scene, other, solver)
    rng, wrong = np.random.default_rng(seed), 0
    before = [snapshot(each) for each in (scene, other)]
    for number in range(count):
        call = table[rng.integers(len(table))]
        name = list(call.bad)[rng.integers(len(call.bad))]
        value = call.bad[name][rng.integers(len(call.bad[name]))]
        rank = int(rng.integers(COMM.size)) if call.together and rng.random() < 0.5 else None
        if name == "unknown":  # Python refuses it before the ranks can compare
            rank = None
        arguments = dict(call.good)
        if rank in (None, COMM.rank):
            arguments[name] = value
        faulthandler.dump_traceback_later(HANG, exit=True)
        found = COMM.allgather(ended(call, arguments))
        changed = [snapshot(each) for each in (scene, other)] != before
        faulthandler.cancel_dump_traceback_later()
        bad = len(set(found)) > 1 or found[0].startswith("bad") or COMM.allreduce(changed)
        wrong += bool(bad)
        if bad and COMM.rank == 0:
            on = "all ranks" if rank is None else f"rank {rank}"
            print(f"{number}: {call.name}, {name} = {value!r} on {on}", "and changed" * changed)
            for text in sorted(set(found)):
                print(f"   {text[:200]}")
    if COMM.rank == 0:
        print(f"{count} bad calls on {COMM.size} ranks, {wrong} of them ended badly")
    return wrong


if __name__ == "__main__":
    raise SystemExit(main(*map(int, sys.argv[1:])) > 0)
