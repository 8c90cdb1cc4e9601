"""Cost of load combinations: compared with new runs, and distributed to two groups.

    ./run python benchmarks/load_combinations.py [SIZE] [new] [groups]

The hall is that of `demos/air_hall.py`: 36 x 36 m, a net of 12 sliding cables, cells of SIZE (3 m
by default). Tables:

new
        Combinations from the base state by `Solver.combine`, in turns with runs that find the form,
        lay and tighten the net, and take one load step to the same loads: CPU seconds, evaluations
        and factorisations.
    groups
        20 combinations on one process by `Solver.combine`, and on two by `combine_in_groups`: CPU
        seconds of the busiest process, for its combinations alone and with the base state; and wall
        time.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from typing import Any

import numpy as np
from mpi4py import MPI
from roofs import suction

from crms_fenicsx import Cable, OrthotropicMembrane, Solver, meshes
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.design.study import combine_in_groups
from crms_fenicsx.foundation.meshes import MembraneMesh

FACTORS = [(snow, wind) for snow in (0.0, 0.25, 0.5, 0.75) for wind in (0.3, 0.6, 0.9, 1.2, 1.5)]
COMBINATIONS: dict[str, dict[str, Any]] = {
    f"snow {s:g} wind {w:g}": {"snow": s, "wind": w, "pressure": 0.4 + 0.2 * s} for s, w in FACTORS
}


def plan(comm: MPI.Intracomm, size: float) -> MembraneMesh:
    """The mesh that the hall's form is found from."""
    return meshes.rectangle(comm, 36.0, 36.0, size, corner=(-18.0, -18.0))


def hall(mesh: MembraneMesh) -> Solver:
    """The hall in operation, with its loads."""
    form = find_form(mesh, stress=3.78, fixed=["boundary"], pressure=0.3)
    scene = form.scene(OrthotropicMembrane(E1=900.0, E2=600.0, G12=30.0, nu21=0.2, thickness=1.0))
    solver = Solver(scene)
    for side in (1.0, -1.0):
        for c in (-15.0, -9.0, -3.0, 3.0, 9.0, 15.0):
            ends = (max(-18.0, -18.0 - c), min(18.0, 18.0 - c))
            scene.lay_cable(Cable(EA=20e3), [(side * x, x + c) for x in ends], shortest=True)
    scene.put_load((0.0, 0.0, -0.0105), name="weight", per="material")
    net = {cable: 0.99 * cable.L0 for cable in scene.cables}
    solver.advance(pressure=0.3, load={"weight": 1.0}, L0=net)
    scene.put_load((0.0, 0.0, -0.36), name="snow", per="plan")
    scene.put_wind(0.5, lambda points, normals: suction(normals[0]))
    return solver


def new_runs(size: float) -> None:
    """Combinations from one base state, and new runs to the same loads, in turns."""
    solver, ratios, wholes = hall(plan(MPI.COMM_SELF, size)), [], []
    print(f"{'':22}{'combination':>24}{'load step of a new run':>28}{'its all':>9}{'ratio':>7}")
    for name in list(COMBINATIONS)[::3]:
        began = time.process_time()
        step = solver.combine({name: COMBINATIONS[name]})[name].step
        spent = time.process_time() - began
        began = time.process_time()
        run = hall(plan(MPI.COMM_SELF, size))
        base = time.process_time()
        loads = {key: value for key, value in COMBINATIONS[name].items() if key != "pressure"}
        other = run.advance(load=loads, pressure=COMBINATIONS[name]["pressure"])
        now = time.process_time()
        ratios.append(spent / (now - base))
        wholes.append(spent / (now - began))
        print(
            f"{name:22}{spent:8.2f} s{step.outcome.evaluations:6}{step.outcome.factorizations:6}  "
            f"{now - base:10.2f} s{other.outcome.evaluations:6}{other.outcome.factorizations:6}"
            f"  {now - began:8.2f}{ratios[-1]:7.2f}",
            flush=True,
        )
    print(f"median: {statistics.median(ratios):.2f} of a load step, "
          f"{statistics.median(wholes):.2f} of a new run")  # fmt: skip


def shared(size: float) -> None:
    """All combinations on the processes that there are; says how long it took."""
    comm, base, spent = MPI.COMM_WORLD, 0.0, 0.0

    def build(mesh: MembraneMesh) -> Solver:
        nonlocal base
        solver = hall(mesh)
        combine = solver.combine

        def timed(*given: Any, **options: Any) -> Any:
            nonlocal spent
            began = time.process_time()
            found = combine(*given, **options)
            spent = time.process_time() - began
            return found

        solver.combine = timed  # type: ignore[method-assign]
        base = time.process_time() - start
        return solver

    began, start = time.perf_counter(), time.process_time()
    found = combine_in_groups(build, plan(comm, size), COMBINATIONS, groups=comm.size)
    clock = time.perf_counter() - began
    times = comm.gather((spent, base + spent))
    if times is not None:
        most = np.max(times, axis=0)
        tension = max(cable.largest for c in found.values() for cable in c.summary.cables.values())
        print(json.dumps([*most, clock, tension]))


def groups(size: float) -> None:
    """One process and two."""
    print(f"{'processes':>9}{'combinations, s':>17}{'with the base':>15}{'clock':>8}{'T max':>9}")
    for processes in (1, 2):
        command = ["mpirun", "-n", str(processes), sys.executable, __file__, "--work", str(size)]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        done = subprocess.run(command, capture_output=True, text=True, env=environment)
        if done.returncode:
            sys.exit(done.stdout + done.stderr)
        own, whole, clock, tension = json.loads(done.stdout.splitlines()[-1])
        print(f"{processes:9}{own:17.1f}{whole:15.1f}{clock:8.1f}{tension:9.3f}", flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    sizes = [float(word) for word in words if word.replace(".", "").isdigit()]
    chosen = sizes[0] if sizes else 3.0
    if "--work" in words:
        shared(chosen)
    else:
        for table in (new_runs, groups):
            name = table.__name__.split("_")[0]
            if name in words or not set(words) & {"new", "groups"}:
                table(chosen)
