"""Scaling of a load step over processes: time and its parts, memory, and communication.

    ./run python benchmarks/parallel.py [--held] [UNKNOWNS] [CABLES] [PROCESSES ...]

The roof of `demos/air_dome.py` with CABLES cables in each of its two families (0 to 14) is inflated
to 0.3 kPa and then to 0.5 kPa; the second load step is measured. For each number of processes (1
and 2 by default) it runs itself under mpirun. PETSc's log counts the communication, in separate
stages. It misses the one sum over all ranks in an evaluation (`Potential.sum_up`), which is counted
with its bytes beside the log's figures. With --held the cables slide along the edges that they
cross, but not to other cells: the number of tried paths depends on rounding.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

STEP, EVALUATION, SOLVE = "the load step", "an evaluation", "a solve with H0"
STAGES = {STEP: 1, EVALUATION: 20, SOLVE: 20}
"""What is counted, and how many times it is done."""


class Clock:
    """Time spent in functions, without that in other watched functions that they call."""

    def __init__(self, now: Callable[[], float]) -> None:
        self.now = now
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._inner = [0.0]

    def watch(self, owner: type, method: str, part: str) -> None:
        """Count the calls of a method as a part."""
        function = getattr(owner, method)

        @functools.wraps(function)
        def timed(*args, **kwargs):
            self._inner.append(0.0)
            begin = self.now()
            try:
                return function(*args, **kwargs)
            finally:
                spent = self.now() - begin
                self.seconds[part] += spent - self._inner.pop()
                self.calls[part] += 1
                self._inner[-1] += spent

        setattr(owner, method, timed)


def watched(now: Callable[[], float] = time.perf_counter) -> Clock:
    """A clock on the parts of a load step, which reads the time from `now`."""
    from crms_fenicsx.analysis.equilibrium import contact_loop, path_loop, search, system
    from crms_fenicsx.energy.minimization import initial_hessian as hessian
    from crms_fenicsx.energy.minimization import minimizer, potential
    from crms_fenicsx.energy.terms import cable_tension as tension
    from crms_fenicsx.energy.terms import fold_penalty as penalty
    from crms_fenicsx.energy.terms import folded_membrane as fold
    from crms_fenicsx.energy.terms import folded_pressure as volume
    from crms_fenicsx.energy.terms import integral, membrane_energy, nodal_forces
    from crms_fenicsx.energy.terms import pressure as loads
    from crms_fenicsx.foundation.dofs import layout as unknowns

    clock = Clock(now)
    plain = [membrane_energy.MembraneEnergy, loads.FollowerPressure, nodal_forces.NodalForces]
    cables = [fold.FoldedMembraneEnergy, penalty.FoldPenalty, tension.CableTension]
    cables += [volume.FoldedFollowerPressure]
    for part, terms in (("membrane", plain), ("cables", cables)):
        for term in terms:
            for method in ("sums", "add_gradient"):
                clock.watch(term, method, f"{part}, energy and forces")
    clock.watch(integral.FusedAssembly, "assemble", "membrane, energy and forces")
    clock.watch(potential.Potential, "sum_up", "sum over the ranks")
    clock.watch(unknowns.Unknowns, "update_ghosts", "ghosts")
    clock.watch(unknowns.Unknowns, "add_ghosts", "ghosts")
    clock.watch(hessian.InitialHessian, "assemble", "H0: assembly")
    clock.watch(hessian.InitialHessian, "rebuild", "H0: factorisation or multigrid")
    clock.watch(hessian.InitialHessian, "_add_dyads", "H0: dyads of the cables")
    clock.watch(hessian.InitialHessian, "solve", "H0: solves")
    clock.watch(minimizer.Minimizer, "solve", "rest of the minimiser")
    clock.watch(system.System, "rebuild", "tables of the cables")
    clock.watch(system.System, "write_scene", "state of the scene")
    clock.watch(system.System, "read_scene", "state of the scene")
    clock.watch(contact_loop.ContactLoop, "_changes", "contacts")
    clock.watch(path_loop.PathLoop, "_change_paths", "paths")
    clock.watch(search.EquilibriumSearch, "find", "paths and contacts")
    return clock


def roof(unknowns: float, cables: int, slide: bool):
    """The inflated roof and its solver."""
    from roofs import cap, covered, great_circles

    from crms_fenicsx import Cable, Solver

    scene = covered(cap(unknowns))
    for path in great_circles(cables).values():
        # as long as on the facets, so that tensions compare with those of earlier versions
        scene.lay_cable(Cable(EA=600e3), path=path, measured_on="facets")
    return scene, Solver(scene, slide=slide)


def repeat_in_stages(solver) -> None:
    """Evaluate and solve with H0 some times, each in a stage of PETSc's log."""
    potential, minimizer = solver.system.potential, solver.system.minimizer
    X, G = potential.x_vector.copy(), potential.x_vector.duplicate()
    potential.objective_gradient(None, X, G)
    minimizer.h0.rebuild()
    minimizer.h0.solve(G, X)
    potential.x_vector.copy(X)
    with stage(EVALUATION):
        for _ in range(STAGES[EVALUATION]):
            potential.objective_gradient(None, X, G)
    with stage(SOLVE):
        for _ in range(STAGES[SOLVE]):
            minimizer.h0.solve(G, X)


@contextlib.contextmanager
def stage(name: str):
    """A stage of PETSc's log."""
    from petsc4py import PETSc

    stage = PETSc.Log.Stage(name)
    stage.push()
    yield
    stage.pop()


def messages(log: str) -> dict[str, list[float]]:
    """Messages, bytes and reductions of each stage, from the log."""
    counts = {}
    for name, rounds in STAGES.items():
        line = next(line for line in log.splitlines() if f": {name}:" in " ".join(line.split()))
        values = [v for v in line.rpartition(name + ":")[2].split() if not v.endswith("%")]
        _, _, sent, length, reductions = map(float, values)
        counts[name] = [sent / rounds, sent * length / rounds, reductions / rounds]
    return counts


def work(unknowns: float, cables: int, slide: bool) -> None:
    """One run: prints its figures on rank 0."""
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    clock = watched()
    begin = time.perf_counter()
    scene, solver = roof(unknowns, cables, slide)
    made = time.perf_counter() - begin
    first = solver.advance(pressure=0.3)
    clock.seconds.clear()
    comm.Barrier()
    begin = time.perf_counter()
    with stage(STEP):
        step = solver.advance(pressure=0.5)
    spent = time.perf_counter() - begin
    parts = dict(clock.seconds)
    kilobytes = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    sums = len(solver.system.potential._sums)
    figures = {
        "unknowns": 3 * solver.system.unknowns.n_global, "processes": comm.size,
        "scene": made, "first step": first.seconds, "seconds": spent, "parts": parts,
        "memory": kilobytes * 1024, "energy": scene.energy,
        "tensions": [cable.tension for cable in scene.cables],
        "iterations": step.outcome.iterations, "evaluations": step.outcome.evaluations,
        "factorizations": step.outcome.factorizations, "solves": step.outcome.solves,
        "first": [first.outcome.iterations, first.outcome.evaluations, first.outcome.solves],
        "sum": 8 * sums,
    }  # fmt: skip
    repeat_in_stages(solver)
    if comm.rank == 0:
        print("FIGURES " + json.dumps(figures), flush=True)


def main() -> None:
    """Run for each number of processes, and print the tables."""
    held = ["--held"] if "--held" in sys.argv else []
    arguments = [argument for argument in sys.argv[1:] if argument not in held]
    unknowns = arguments[0] if arguments else "1e5"
    cables = arguments[1] if len(arguments) > 1 else "0"
    processes = [int(p) for p in arguments[2:]] or [1, 2]
    runs = []
    for count in processes:
        command = ["mpirun", "-n", str(count), sys.executable, __file__]
        command += ["--work", unknowns, cables, *held]
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "petsc.log"
            options = f"{os.environ.get('PETSC_OPTIONS', '')} -log_view :{log}"
            environment = os.environ | {"PETSC_OPTIONS": options}
            out = subprocess.run(command, capture_output=True, text=True, env=environment)
            lines = [line for line in out.stdout.splitlines() if line.startswith("FIGURES ")]
            if not lines:
                sys.exit(out.stdout + out.stderr)
            runs.append(json.loads(lines[0].removeprefix("FIGURES ")))
            runs[-1]["messages"] = messages(log.read_text())
    first = runs[0]
    how = ", paths held" if held else ""
    print(f"{first['unknowns']} unknowns, {2 * int(cables)} cables{how}; second load step")
    print("processes " + "".join(f"{run['processes']:>12}" for run in runs))
    for name in ("scene", "first step", "seconds"):
        print(f"{name:<34}" + "".join(f"{run[name]:12.2f}" for run in runs) + " s")
    for part in first["parts"]:
        own = [run["parts"].get(part, 0.0) for run in runs]
        print(f"  {part:<32}" + "".join(f"{seconds:12.3f}" for seconds in own) + " s")
    for name in ("iterations", "evaluations", "factorizations", "solves"):
        print(f"{name:<34}" + "".join(f"{run[name]:12}" for run in runs))
    memory = [run["memory"] for run in runs]
    print(f"{'memory':<34}" + "".join(f"{m / 2**30:12.2f}" for m in memory) + " GiB")
    each = [m / first["unknowns"] / 1e3 for m in memory]
    print(f"{'memory per unknown':<34}" + "".join(f"{m:12.2f}" for m in each) + " kB")
    for name in first["messages"]:
        for k, what in enumerate(("messages", "bytes", "reductions")):
            own = [run["messages"][name][k] for run in runs]
            print(f"{name + ', ' + what:<34}" + "".join(f"{value:12.4g}" for value in own))
    print(f"and for each evaluation a sum over the ranks of {first['sum']} bytes")
    for run in runs[1:]:
        print(f"{run['processes']} processes against {first['processes']}: energy differs by "
              f"{abs(run['energy'] / first['energy'] - 1):.1e}, speed-up "
              f"{first['seconds'] / run['seconds']:.2f}")  # fmt: skip


if __name__ == "__main__":
    if "--work" in sys.argv:
        work(float(sys.argv[2]), int(sys.argv[3]), slide="--held" not in sys.argv)
    else:
        main()
