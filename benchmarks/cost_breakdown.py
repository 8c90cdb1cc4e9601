"""Parts of a load step's time, compared with a lower bound.

A clamped square of 100 cm, E t = 24 kgf/cm, nu = 0.25, N cells a side, under a follower pressure of
0.008 kgf/cm2 is inflated to 0.01, 0.012, 0.014 and 0.016 and let down again, without and with a
cable (EA = 32000 kgf, 100 cm) over cells in its middle. Results are means of these four load steps.
Each starts with the previous H0, the first with a new one. Tables:

step
    Time of its parts, number of calls, and time per call; of an evaluation per cell and per fold
    element. The lower bound, measured in turns with the steps, has one assembly of H0, one
    factorisation, the step's triangular solves, and for each of its evaluations a compiled loop
    over the cells, written for this square (`fused`), which computes energy and gradient at once.
flips
    Cost of a cable sliding over mesh vertices: dragged sideways by 0.3 to 15 cm.

    ./run python benchmarks/cost_breakdown.py [step] [flips] [--cells 64] [--quick]

Times are CPU times, which other work on the machine hardly affects.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from parallel import Clock, watched
from skip import FEATURES, PRESSURE, square

from crms_fenicsx.foundation.runtime.arrays import Array

GEOMETRY = ("paths", "contacts", "paths and contacts", "tables of the cables", "state of the scene")
"""Parts of the clock that a cable's way over the mesh costs."""
UP = (1.0, 1.2, 1.4, 1.6)
"""Pressures of the load steps of a round."""
SCENES = {"no cable": FEATURES["membrane and pressure"], "cable": FEATURES["cable"]}


@numba.njit
def fused(X, x, cells, inverse, Et, nu, pressure, g):  # type: ignore[no-untyped-def]
    """Energy and gradient of the flat square: tension field and follower pressure.

    `inverse` (n, 2, 2) takes differences along two sides to slopes along x and y.
    """
    g[:] = 0.0
    energy = 0.0
    for c in range(cells.shape[0]):
        i, j, k = cells[c]
        B = inverse[c]
        area = 0.5 / abs(B[0, 0] * B[1, 1] - B[0, 1] * B[1, 0])
        f00, f01, f02, f10, f11, f12 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0
        a0, a1, a2 = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
        b0, b1, b2 = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
        f00 += B[0, 0] * a0 + B[0, 1] * b0
        f01 += B[0, 0] * a1 + B[0, 1] * b1
        f02 += B[0, 0] * a2 + B[0, 1] * b2
        f10 += B[1, 0] * a0 + B[1, 1] * b0
        f11 += B[1, 0] * a1 + B[1, 1] * b1
        f12 += B[1, 0] * a2 + B[1, 1] * b2
        e0 = 0.5 * (f00 * f00 + f01 * f01 + f02 * f02 - 1)
        e1 = 0.5 * (f10 * f10 + f11 * f11 + f12 * f12 - 1)
        e2 = 0.5 * (f00 * f10 + f01 * f11 + f02 * f12)
        mean, half = 0.5 * (e0 + e1), 0.5 * (e0 - e1)
        radius = np.sqrt(half * half + e2 * e2)
        larger, smaller = mean + radius, mean - radius
        s0 = s1 = s2 = 0.0
        if smaller + nu * larger >= 0.0:
            D = Et / (1 - nu * nu)
            s0, s1, s2 = D * (e0 + nu * e1), D * (e1 + nu * e0), D * (1 - nu) * e2
            energy += 0.5 * area * (s0 * e0 + s1 * e1 + 2 * s2 * e2)
        elif larger > 0.0:
            s = 0.5 * Et * larger
            s0, s1, s2 = s * (1 + half / radius), s * (1 - half / radius), s * e2 / radius
            energy += 0.5 * area * Et * larger * larger
        p00, p01, p02 = s0 * f00 + s2 * f10, s0 * f01 + s2 * f11, s0 * f02 + s2 * f12
        p10, p11, p12 = s2 * f00 + s1 * f10, s2 * f01 + s1 * f11, s2 * f02 + s1 * f12
        u0, u1, u2 = X[i, 0] + x[i, 0], X[i, 1] + x[i, 1], X[i, 2] + x[i, 2]
        v0, v1, v2 = X[j, 0] + x[j, 0], X[j, 1] + x[j, 1], X[j, 2] + x[j, 2]
        w0, w1, w2 = X[k, 0] + x[k, 0], X[k, 1] + x[k, 1], X[k, 2] + x[k, 2]
        n0, n1, n2 = v1 * w2 - v2 * w1, v2 * w0 - v0 * w2, v0 * w1 - v1 * w0
        q = pressure / 6
        energy -= q * (u0 * n0 + u1 * n1 + u2 * n2)
        j0 = area * (B[0, 0] * p00 + B[1, 0] * p10)
        j1 = area * (B[0, 0] * p01 + B[1, 0] * p11)
        j2 = area * (B[0, 0] * p02 + B[1, 0] * p12)
        k0 = area * (B[0, 1] * p00 + B[1, 1] * p10)
        k1 = area * (B[0, 1] * p01 + B[1, 1] * p11)
        k2 = area * (B[0, 1] * p02 + B[1, 1] * p12)
        g[i, 0] -= j0 + k0 + q * n0
        g[i, 1] -= j1 + k1 + q * n1
        g[i, 2] -= j2 + k2 + q * n2
        g[j, 0] += j0 - q * (w1 * u2 - w2 * u1)
        g[j, 1] += j1 - q * (w2 * u0 - w0 * u2)
        g[j, 2] += j2 - q * (w0 * u1 - w1 * u0)
        g[k, 0] += k0 - q * (u1 * v2 - u2 * v1)
        g[k, 1] += k1 - q * (u2 * v0 - u0 * v2)
        g[k, 2] += k2 - q * (u0 * v1 - u1 * v0)
    return energy


def fused_loop(scene: Any) -> tuple[Callable[[], float], Array]:
    """What evaluates the square's energy and gradient, and where it leaves the gradient."""
    cells, X = np.asarray(scene.V.dofmap.list), scene.V.tabulate_dof_coordinates()
    sides = X[cells[:, 1:], :2] - X[cells[:, :1], :2]
    inverse, x = np.linalg.inv(sides), scene.u.x.array.reshape(-1, 3)
    origin, g = X - scene.membrane.centre, np.zeros_like(X)
    return lambda: float(fused(origin, x, cells, inverse, 24.0, 0.25, scene.pressure, g)), g


def check_fused(solver: Any) -> None:
    """The loop computes what the package does."""
    evaluate, g = fused_loop(solver.scene)
    potential = solver.system.potential
    energy = potential.evaluate()
    assert abs(evaluate() / energy - 1) < 1e-10
    assert np.abs(g - potential.g).max() < 1e-10 * np.abs(potential.g).max()


def timed(function: Callable[[], object]) -> float:
    """Seconds of the processor that it takes."""
    began = time.process_time()
    function()
    return time.process_time() - began


def step(n: int, clock: Clock, rounds: int) -> None:
    """The parts of a load step, and the floor."""
    columns = {name: measured(square(n, feature), clock, rounds)
               for name, feature in SCENES.items()}  # fmt: skip
    heads = (f"{f'{name}, ms':>18}{'calls':>7}{'each':>9}" for name in columns)
    print(f"\n{f'{n} cells a side, a load step':<34}" + "".join(heads))
    for part in next(reversed(columns.values()))["parts"]:
        text = f"  {part:<32}"
        for column in columns.values():
            ms, calls = column["parts"].get(part, (0.0, 0))
            text += f"{ms:18.2f}{calls:7.0f}{ms / max(calls, 1):9.3f}"
        print(text)
    rows = ("load step, ms", "of it verification, ms", "floor, ms", "load step / floor",
            "evaluations", "factorisations",
            "solves with K", "evaluation, ns per cell", "of it cables, ns per fold element",
            "fused loop, ns per cell", "H0 assembly, ns per cell")  # fmt: skip
    for row in rows:
        print(f"{row:<36}" + "".join(f"{column[row]:16.2f}{'':18}" for column in columns.values()))
    steps = [column["load step, ms"] for column in columns.values()]
    print(f"the cable costs {steps[1] / steps[0] - 1:.0%} on top")


def measured(solver: Any, clock: Clock, rounds: int) -> dict[str, Any]:
    """The figures of one scene: means over the load steps of a round, and the floor's parts."""
    scene = solver.scene
    if not scene.cables:
        check_fused(solver)
    evaluate, _ = fused_loop(scene)
    evaluate()
    steps: list[float] = []
    shares: list[float] = []
    outcomes: list[Any] = []
    parts: dict[str, list[tuple[float, int]]] = defaultdict(list)
    floor: dict[str, list[float]] = defaultdict(list)
    for _ in range(rounds):
        for target in UP:
            clock.seconds.clear()
            clock.calls.clear()
            steps.append(timed(lambda target=target: solver.advance(pressure=target * PRESSURE)))
            last = solver.steps[-1]
            outcomes.append(last.outcome)
            shares.append(1e3 * last.verification.seconds)
            for part in clock.seconds:
                parts[part].append((clock.seconds[part], clock.calls[part]))
        h0 = solver.system.minimizer.h0
        b, y = h0.matrix.createVecs()
        b.set(1.0)
        floor["assembly"].append(timed(lambda: h0.assemble(False)))  # noqa: B023
        floor["factorisation"].append(timed(h0.pc.setUp))
        floor["solve"].append(timed(lambda: h0.pc.apply(b, y)))  # noqa: B023
        floor["fused"].append(timed(evaluate))
        solver.advance(pressure=0.8 * PRESSURE)
        solver.system.reset_h0()
    ms = {name: 1e3 * statistics.median(values) for name, values in floor.items()}
    middle = {part: tuple(np.sum(values, axis=0) / len(steps) * (1e3, 1))
              for part, values in parts.items()}  # fmt: skip
    counts = [(o.evaluations, o.factorizations, o.iterations) for o in outcomes]
    evaluations, factorizations, iterations = np.mean(counts, axis=0)
    solves = iterations + len(scene.cables) * factorizations
    spent = 1e3 * statistics.median(np.reshape(steps, (rounds, -1)).mean(axis=1))
    lowest = ms["assembly"] + ms["factorisation"] + solves * ms["solve"]
    lowest += evaluations * ms["fused"]
    cells = len(scene.V.dofmap.list)
    membrane = middle["membrane, energy and forces"][0]
    cables = middle.get("cables, energy and forces", (0.0, 0))[0]
    folded = 0 if not scene.cables else len(solver.system.cables.tables.folded.cells)
    return {
        "parts": middle,
        "load step, ms": spent,
        "of it verification, ms": statistics.median(shares),
        "floor, ms": lowest,
        "load step / floor": spent / lowest,
        "evaluations": evaluations,
        "factorisations": factorizations,
        "solves with K": solves,
        "evaluation, ns per cell": 1e6 * (membrane + cables) / cells / evaluations,
        "of it cables, ns per fold element": 1e6 * cables / max(folded, 1) / evaluations,
        "fused loop, ns per cell": 1e6 * ms["fused"] / cells,
        "H0 assembly, ns per cell": 1e6 * ms["assembly"] / cells,
    }


def flips(n: int, clock: Clock) -> None:
    """The cable dragged sideways, over vertices and not."""
    from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

    head = f"{n} cells a side, dragged by"
    print(f"\n{head:28}{'ms':>9}{'vertices':>10}{'solves':>8}{'fact.':>7}{'eval.':>7}"
          f"{'paths, contacts and tables, ms':>32}{'a vertex':>10}")  # fmt: skip
    for way in (0.3, 5.0, 15.0):
        mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / n, structured=True)
        scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
        scene.fix("boundary")
        cable = scene.lay_cable(Cable(EA=32000.0), [(-5, 35, 8), (105, 35, 8)], L0=109.5)
        solver = Solver(scene)
        solver.advance(pressure=PRESSURE, steps=3)
        before = beyond(scene, cable)
        clock.seconds.clear()
        spent = timed(lambda: solver.advance(move={cable: (0.0, way, 0.0)}))  # noqa: B023
        passed = int(np.sum(before != beyond(scene, cable)))
        done, own = solver.steps[-1].outcome, 1e3 * sum(clock.seconds[part] for part in GEOMETRY)
        print(f"{way:25g} cm{1e3 * spent:9.0f}{passed:10}{done.solves:8}{done.factorizations:7}"
              f"{done.evaluations:7}{own:32.0f}{own / max(passed, 1):10.2f}")  # fmt: skip


def beyond(scene: Any, cable: Any) -> npt.NDArray[np.bool_]:
    """Which vertices lie beyond the cable in plan."""
    X, line = scene.positions(), cable.line
    return np.asarray(X[:, 1] > np.interp(X[:, 0], line[:, 0], line[:, 1]))


def main() -> None:
    """Print the tables asked for."""
    tables = ("step", "flips")
    parser = argparse.ArgumentParser(description="Cost of a load step: see the head of this file.")
    parser.add_argument("tables", nargs="*", help=f"which, of {', '.join(tables)}; default both")
    parser.add_argument("--cells", type=int, default=64, help="cells a side of the square")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions")
    given = parser.parse_args()
    wanted = given.tables or tables
    if set(wanted) - set(tables):
        parser.error(f"there are no such tables: {', '.join(set(wanted) - set(tables))}")
    clock = watched(time.process_time)
    if "step" in wanted:
        step(given.cells, clock, 5 if given.quick else 15)
    if "flips" in wanted:
        flips(given.cells // 2 + 1, clock)


if __name__ == "__main__":
    main()
