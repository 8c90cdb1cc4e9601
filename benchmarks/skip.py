"""Overhead of unused features: against a bare DOLFINx script, and feature by feature.

The scene is a clamped square of 100 cm, E t = 24 kgf/cm, nu = 0.25, under a follower pressure of
0.01 kgf/cm2, without any other feature of the package. The bare script (`bare_square`) is what one
would write for this flat square alone: its energy in UFL, its derivative, two forms. Tables:

evaluation
    Time of one evaluation of energy and gradient, the package and the bare script in turns.
features
    The same with one feature absent or present, all scenes in turns, relative to the first one; the
    part spent outside the terms; and the time of a load step after the first.
start
    New processes: import of the package against that of DOLFINx; with empty caches, what is
    compiled (FFCx modules, numba functions) and how long that takes; again from another working
    directory, what is recompiled; memory.

    ./run python benchmarks/skip.py [evaluation] [features] [start] [--quick]

Times are CPU times, which other work on the machine hardly affects; those of first load steps in
`start`, which load files, are wall times. Modules are compiled to bytecode before imports are
timed, as in an installed package.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

PRESSURE = 0.01
FEATURES = {
    "membrane and pressure": {},
    "no pressure": {"pressure": 0.0},
    "no wrinkling model": {"wrinkling": False},
    "orthotropic": {"orthotropic": True},
    "slack cable": {"cable": {}, "L0": 110.0},
    "cable": {"cable": {}, "L0": 100.0},
    "cable with friction": {"cable": {"friction": 0.3}, "L0": 100.0},
    "files written": {"files": True},
    "and checkpoints": {"files": True, "resume": False},
}
"""Scenes by what differs from the first one."""


def bare_square(n: int) -> Callable[[], float]:
    """What evaluates energy and gradient of the flat square, in DOLFINx alone."""
    import basix.ufl
    import dolfinx
    import numpy as np
    import ufl
    from dolfinx import fem
    from dolfinx.fem import petsc
    from mpi4py import MPI
    from petsc4py import PETSc

    line = np.linspace(0.0, 100.0, n + 1)
    points = np.stack([*np.meshgrid(line, line), np.zeros((n + 1, n + 1))], axis=-1).reshape(-1, 3)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    lower = np.stack([first, first + 1, first + n + 2], axis=1)
    upper = np.stack([first, first + n + 2, first + n + 1], axis=1)
    element = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
    cells = np.concatenate([lower, upper]).astype(np.int64)
    mesh = dolfinx.mesh.create_mesh(MPI.COMM_WORLD, cells=cells, x=points, e=element)
    V = fem.functionspace(mesh, ("Lagrange", 1, (3,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    dx = ufl.dx(metadata={"quadrature_degree": 0})
    e1, e2 = ufl.as_vector([1.0, 0.0, 0.0]), ufl.as_vector([0.0, 1.0, 0.0])
    F1, F2 = (e + ufl.dot(ufl.grad(u), e) for e in (e1, e2))
    E11, E22, E12 = (ufl.dot(F1, F1) - 1) / 2, (ufl.dot(F2, F2) - 1) / 2, ufl.dot(F1, F2) / 2
    Et, nu = fem.Constant(mesh, 24.0), fem.Constant(mesh, 0.25)
    mean, radius = (E11 + E22) / 2, ufl.sqrt((E11 - E22) ** 2 / 4 + E12**2)
    larger, smaller = mean + radius, mean - radius
    taut = Et / 2 / (1 - nu**2) * (larger**2 + smaller**2 + 2 * nu * larger * smaller)
    wrinkled = ufl.conditional(ufl.gt(larger, 0), Et / 2 * larger**2, 0.0)
    membrane = ufl.conditional(ufl.ge(smaller + nu * larger, 0), taut, wrinkled)
    volume = ufl.dot(ufl.SpatialCoordinate(mesh) + u, ufl.cross(F1, F2)) / 3
    energy = (membrane - fem.Constant(mesh, PRESSURE) * volume) * dx
    W, G = fem.form(energy), fem.form(ufl.derivative(energy, u, v))
    mesh.topology.create_connectivity(1, 2)
    rim = dolfinx.mesh.exterior_facet_indices(mesh.topology)
    held = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 1, rim), V)
    x = V.tabulate_dof_coordinates() / 100.0
    dome = np.sin(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])
    u.x.array.reshape(-1, 3)[:, 2] = 10.0 * dome
    X, g = u.x.petsc_vec.copy(), u.x.petsc_vec.duplicate()

    def evaluate() -> float:
        X.copy(u.x.petsc_vec)
        u.x.scatter_forward()
        with g.localForm() as local:
            local.set(0.0)
        petsc.assemble_vector(g, G)
        g.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        petsc.set_bc(g, [held], alpha=0.0)
        return float(mesh.comm.allreduce(fem.assemble_scalar(W)))

    return evaluate


def square(n: int, feature: dict[str, Any], folder: str | None = None) -> Any:
    """The solver of the square, after its first load step."""
    from mpi4py import MPI

    from crms_fenicsx import Cable, IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes

    wrinkling = feature.get("wrinkling", True)
    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / n, structured=True)
    material = (
        OrthotropicMembrane(E1=300.0, E2=200.0, nu21=0.25, G12=100.0, thickness=0.08)
        if feature.get("orthotropic")
        else IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=wrinkling)
    )
    scene = Scene(mesh, material)
    scene.fix("boundary")
    if "cable" in feature:
        cable = Cable(EA=32000.0, **feature["cable"])
        scene.lay_cable(cable, [(0.0, 50.3), (100.0, 50.3)], L0=feature["L0"])
    results = folder if feature.get("files") else None
    solver = Solver(scene, results=results, resume=feature.get("resume"))
    if feature.get("pressure", PRESSURE):
        solver.advance(pressure=0.8 * PRESSURE)
    else:
        solver.advance(move={"boundary": (0.0, 0.0, 0.0)})
    return solver


def evaluation_of(solver: Any) -> Callable[[], float]:
    """One evaluation at the current state, as the minimiser has it."""
    potential = solver.system.potential
    X, G = potential.x_vector.copy(), potential.x_vector.duplicate()
    return lambda: float(potential.objective_gradient(None, X, G))


def in_turns(functions: Iterable[Callable[[], object]], rounds: int) -> list[float]:
    """Median seconds of the processor that each function takes, called in turns."""
    functions = list(functions)
    spent: list[list[float]] = [[] for _ in functions]
    for _ in range(rounds):
        for function, own in zip(functions, spent, strict=True):
            began = time.process_time()
            function()
            own.append(time.process_time() - began)
    return [statistics.median(own[rounds // 10 :]) for own in spent]


def evaluation(sizes: Iterable[int], rounds: int) -> None:
    """The package against the bare script."""
    print(f"\n{'cells a side':>12}{'bare, ns per cell':>20}{'package':>12}{'ratio':>8}")
    for n in sizes:
        with_package = evaluation_of(square(n, {}))
        bare, own = in_turns([bare_square(n), with_package], rounds)
        scale = 1e9 / (2 * n * n)
        print(f"{n:12}{bare * scale:20.0f}{own * scale:12.0f}{own / bare:8.2f}", flush=True)


def outside_of_terms(solver: Any, rounds: int) -> float:
    """Share of an evaluation that is spent outside of its terms."""
    potential = solver.system.potential
    x, g = potential.x, potential.g.copy()

    def all_terms() -> None:
        potential._pass.assemble()  # what the membrane's and the pressure's sums only read
        for term in potential.terms:
            sums = potential.sums_of(term)
            term.sums(x, sums)
            term.add_gradient(x, sums, g)

    whole, terms = in_turns([evaluation_of(solver), all_terms], rounds)
    return 1 - terms / whole


def features(n: int, rounds: int) -> None:
    """What is absent and present, in turns."""
    with tempfile.TemporaryDirectory() as folder:
        solvers = [square(n, own, f"{folder}/{name}") for name, own in FEATURES.items()]
        times = in_turns([evaluation_of(solver) for solver in solvers], rounds)
        print(f"\n{n} cells a side{'us':>26}{'ratio':>8}{'outside':>9}{'step, ms':>10}{'fact.':>7}"
              f"{'eval.':>7}{'ratio':>8}")  # fmt: skip
        steps = [again(solver, feature, rounds // 20)
                 for solver, feature in zip(solvers, FEATURES.values(), strict=True)]  # fmt: skip
        for name, solver, spent, (seconds, work) in zip(
            FEATURES, solvers, times, steps, strict=True
        ):
            outside = outside_of_terms(solver, rounds // 2)
            print(f"{name:27}{spent * 1e6:14.0f}{spent / times[0]:8.2f}{outside:9.1%}"
                  f"{seconds * 1e3:10.0f}{work.factorizations:7}{work.evaluations:7}"
                  f"{seconds / steps[0][0]:8.2f}", flush=True)  # fmt: skip


def again(solver: Any, feature: dict[str, Any], rounds: int) -> tuple[float, Any]:
    """Median seconds of load steps after the first, back and forth, and what one took.

    Each with a new H0: one kept from there and back again would be better than any other.
    """
    spent, work = [], None
    for k in range(max(rounds, 3)):
        solver.system.reset_h0()
        began = time.process_time()
        if feature.get("pressure", PRESSURE):
            work = solver.advance(pressure=PRESSURE * (1.0 if k % 2 == 0 else 0.8)).outcome
        else:
            work = solver.advance(move={"boundary": (0.0, 0.0, 0.0)}).outcome
        spent.append(time.process_time() - began)
    return statistics.median(spent), work


def fresh(arguments: list[str], caches: Path | None = None, folder: str | None = None) -> Any:
    """What a process of its own says; where it keeps what it compiles, and runs."""
    environment = dict(os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    if caches is not None:
        environment |= {"XDG_CACHE_HOME": str(caches), "NUMBA_CACHE_DIR": str(caches / "numba")}
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder)
    if done.returncode:
        sys.exit(done.stdout + done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def compiled(caches: Path) -> tuple[int, int]:
    """Modules of FFCx and functions of numba in the caches."""
    return len(list(caches.rglob("libffcx_*.so"))), len(list(caches.rglob("*.nbc")))


def start(n: int, runs: int, names: Iterable[str]) -> None:
    """Imports, compilations and memory of fresh processes."""
    imports = ["dolfinx", "dolfinx.fem.petsc", "crms_fenicsx"]
    spent: dict[str, list[float]] = {name: [] for name in imports}
    code = "import time, {}; print(time.process_time())"
    with tempfile.TemporaryDirectory() as bytecode:
        for run in range(runs + 1):
            for name in imports:
                where = ["-X", f"pycache_prefix={bytecode}", "-c"]
                spent[name] += [fresh([*where, code.format(name)])][run == 0 :]
    seconds = {name: statistics.median(own) for name, own in spent.items()}
    print()
    for name in imports:
        print(f"import {name:20}{seconds[name]:8.3f} s{seconds[name] / seconds['dolfinx']:8.2f}")
    print(f"\n{'first load step':27}{'FFCx':>6}{'numba':>7}{'cold, s':>9}{'warm':>7}{'again':>7}"
          f"{'memory, MiB':>13}")  # fmt: skip
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            caches, other = Path(folder) / "caches", Path(folder) / "elsewhere"
            other.mkdir()
            work = [str(Path(__file__).resolve()), "--work", name, str(n)]
            cold = fresh(work, caches)
            forms, kernels = compiled(caches)
            warm = [fresh(work, caches, str(other)) for _ in range(max(runs // 3, 1))]
            again = sum(compiled(caches)) - forms - kernels
        least = statistics.median(own["seconds"] for own in warm)
        memory = statistics.median(own["memory"] for own in warm)
        print(f"{name:27}{forms:6}{kernels:7}{cold['seconds']:9.2f}{least:7.2f}{again:7}"
              f"{memory:13.0f}", flush=True)  # fmt: skip


def most_memory() -> float:
    """The most memory that this process has had (MiB); that of `resource` is its parent's too."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return float(next(line.split()[1] for line in lines if line.startswith("VmHWM"))) / 1024


def work(name: str, n: int) -> None:
    """One fresh process: seconds without the imports, and memory."""
    importlib.import_module("dolfinx.fem.petsc" if name == "bare script" else "crms_fenicsx")
    began = time.perf_counter()
    if name == "bare script":
        bare_square(n)()
    else:
        with tempfile.TemporaryDirectory() as folder:
            square(n, FEATURES[name], folder)
    print(json.dumps({"seconds": time.perf_counter() - began, "memory": most_memory()}))


def main() -> None:
    """Print the tables asked for."""
    tables = ("evaluation", "features", "start")
    parser = argparse.ArgumentParser(description="Unused features: see the head of this file.")
    parser.add_argument("tables", nargs="*", help=f"which, of {', '.join(tables)}; default all")
    parser.add_argument("--quick", action="store_true", help="about a minute, with more noise")
    given = parser.parse_args()
    wanted = given.tables or tables
    if set(wanted) - set(tables):
        parser.error(f"there are no such tables: {', '.join(set(wanted) - set(tables))}")
    quick = given.quick
    if "evaluation" in wanted:
        evaluation((64,) if quick else (32, 64, 128), 60 if quick else 300)
    if "features" in wanted:
        features(32 if quick else 64, 60 if quick else 200)
    if "start" in wanted:
        names = ["bare script", *FEATURES]
        start(16, 3 if quick else 9, names[:2] + names[6:7] if quick else names)


if __name__ == "__main__":
    if "--work" in sys.argv:
        work(sys.argv[2], int(sys.argv[3]))
    else:
        main()
