"""Cables that slide sideways, lift off and cross: accuracy, independence of the start, cost.

All on the inflated square: 100 cm wide, clamped, E t = 24 kgf/cm, nu = 0.25, 0.01 kgf/cm2, and
cables of EA = 32000 kgf. Tables:

accuracy
    A cable with its ends at (0, 30) and (100, 30), L0 = 100 cm, against the continuum: a mesh
    that follows the cable's unknown material curve, extrapolated.
lines
    The same for cables laid along mesh lines, against meshes without a line there; and the
    differences between the ways to lay them.
starts
    The same equilibrium from cables laid with detours to either side.
cost
    Load steps in which a cable is dragged sideways over cells, with and without sliding.
anchors
    Random anchors off the membrane: cables touch it in part, or not at all.
nets
    Random nets of crossing cables.

    ./run python benchmarks/sliding.py [accuracy] [lines] [starts] [cost] [anchors] [nets]

`--anchors` and `--nets` set the number of random scenes; `--sizes` the meshes.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from crms_fenicsx import ConvergenceError, PathWarning, Solver

sys.path.append(str(Path(__file__).parents[1] / "tests" / "scenes"))  # their meshes and checks
from cabled_square import CABLE, KINDS, PRESSURE, sheet
from contact_checks import deepest, strongest_pull
from model_3 import say

COMM = MPI.COMM_WORLD
T_EXACT, W_EXACT, Y_EXACT, Z_EXACT = 103.0532, -298.76483, 29.60632, 3.51323

CASES = {
    "ends (0,30), (100,30)": ([(0, 30), (100, 30)], 1.0),
    "oblique (0,20), (100,55)": ([(0, 20), (100, 55)], 1.0),
    "near the edge (0,12), (100,12)": ([(0, 12), (100, 12)], 1.0),
    "longer, 1.004 of the chord": ([(0, 30), (100, 30)], 1.004),
}
STARTS = (0.0, 15.0, -12.0, 30.0)
WAYS = ("laid before", "laid after", "in 5 steps")


def accuracy(sizes: Sequence[int]) -> None:
    """Errors of tension, energy and position in the middle."""
    say(f"\n{'cells a side':22}{'T, %':>10}{'W, %':>10}{'y / h':>10}{'z, cm':>10}{'solves':>8}"
        f"{'flips':>7}{'fact.':>7}{'eval.':>7}{'s':>7}")  # fmt: skip
    for kind in KINDS:
        errors = []
        for n in sizes:
            scene = sheet(COMM, n, kind)
            cable = scene.lay_cable(CABLE, [(0, 30), (100, 30)], L0=100.0)
            began = time.perf_counter()
            done = Solver(scene).advance(pressure=PRESSURE).outcome
            seconds = time.perf_counter() - began
            y, z = (float(np.interp(50.0, cable.line[:, 0], cable.line[:, i]))
                    for i in (1, 2))  # fmt: skip
            dT, dW = 100 * (cable.tension / T_EXACT - 1), 100 * (1 - scene.energy / W_EXACT)
            errors.append((abs(dT), abs(dW)))
            say(f"{kind:14}{n:8}{dT:10.4f}{dW:10.4f}{(y - Y_EXACT) * n / 100:10.4f}"
                f"{z - Z_EXACT:10.5f}{done.solves:8}{done.flips:7}{done.factorizations:7}"
                f"{done.evaluations:7}{seconds:7.2f}")  # fmt: skip
        if len(sizes) > 1:
            slopes = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
            say(f"{kind:14}{'order':>8}{slopes[0]:10.2f}{slopes[1]:10.2f}")


def on_line(n: int, y: float, L0: float, way: str = "straight") -> tuple[float, float, float]:
    """Tension, energy and place in the middle of a cable laid from (0, y) to (100, y)."""
    scene = sheet(COMM, n, "structured")
    solver = Solver(scene)
    if way == "laid after":
        solver.advance(pressure=PRESSURE)
    ends = [(0.0, y), (100.0, y)]
    cable = scene.lay_cable(CABLE, detour(ends, 300.0 / n if way == "detour" else 0.0), L0=L0)
    solver.advance(pressure=PRESSURE)
    middle = np.interp(50.0, cable.line[:, 0], cable.line[:, 1])
    return cable.tension, scene.energy, float(middle)


def lines(sizes: Sequence[int] = (10, 20, 40, 50, 80)) -> None:
    """Cables along lines of the mesh, y = 20, 30 and 40, of two lengths."""
    say(f"\n{'along y, L0':16}{'n':>5}{'T, %':>10}{'W, %':>10}{'y / h':>10}   apart by way: W, T")
    for y, L0 in itertools.product((20.0, 30.0, 40.0), (100.0, 100.5)):
        coarse, fine = (np.array(on_line(n, y, L0)) for n in (43, 87))  # no line at y
        exact = fine + (fine - coarse) / ((87 / 43) ** 2 - 1)
        errors = []
        for n in sizes:
            found = np.array([on_line(n, y, L0, w) for w in ("straight", "detour", "laid after")])
            T, W, middle = found[0]
            errors.append((abs(T / exact[0] - 1), abs(W / exact[1] - 1)))
            apart = np.ptp(found, axis=0) / np.abs(found[0])
            say(f"{y:4g}, {L0:7g}    {n:5}{100 * errors[-1][0]:10.4f}{100 * errors[-1][1]:10.4f}"
                f"{(middle - exact[2]) * n / 100:10.4f}   {apart[1]:.0e} {apart[0]:.0e}"
                )  # fmt: skip
        slopes = -np.polyfit(np.log(sizes), np.log(errors), 1)[0]
        say(f"{'order':>21}{slopes[0]:10.2f}{slopes[1]:10.2f}")


def detour(ends: Sequence[tuple[float, float]], aside: float) -> list[tuple[float, float]]:
    """A path from end to end, `aside` of the straight one in its middle, on the membrane."""
    (a, b), (c, d) = ends
    if aside == 0.0:
        return [(a, b), (c, d)]
    return [(a, b), ((a + c) / 2, max((b + d) / 2 + aside, 1.0)), (c, d)]


def starts(sizes: Sequence[int]) -> None:
    """Whether the equilibrium depends on where a cable is laid, when, and on the steps."""
    runs, equal, far, failed = 0, 0, 0, 0
    say(f"\nenergy above the lowest (relative) / tension off by (%), detours {STARTS} cm aside, "
        "cable laid before or after inflation")  # fmt: skip
    for (name, (ends, share)), kind, n in itertools.product(CASES.items(), KINDS, sizes):
        chord = float(np.hypot(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]))
        found: list[tuple[float, float]] = []
        for way, aside in itertools.product(WAYS, STARTS):
            scene = sheet(COMM, n, kind)
            solver = Solver(scene)
            if way == "laid after":
                solver.advance(pressure=PRESSURE)
            cable = scene.lay_cable(CABLE, detour(ends, aside), L0=share * chord)
            try:
                solver.advance(pressure=PRESSURE, steps=5 if way == "in 5 steps" else 1)
                found.append((scene.energy, cable.tension))
            except ConvergenceError as error:
                say(f"  {name}, {kind}, n = {n}, detour {aside:g}, {way}: {error}")
                found.append((np.nan, np.nan))
        W, T = np.array(found).T
        best = int(np.nanargmin(W))
        above, off = (W - W[best]) / abs(W[best]), T / T[best] - 1
        runs += len(W)
        equal += int(np.sum(above < 1e-5))
        far += int(np.sum(np.abs(off) > 0.05))
        failed += int(np.isnan(W).sum())
        for k, way in enumerate(WAYS):
            rows = slice(k * len(STARTS), (k + 1) * len(STARTS))
            label = f"{name:32}{kind:14}{n:4}  {way:12}"
            pairs = zip(above[rows], off[rows], strict=True)
            say(label + "".join(f"{a:10.1e} /{100 * o:7.3f}" for a, o in pairs))
    say(f"{runs} runs: {equal} ({equal / runs:.0%}) within 1e-5 of the lowest energy, "
        f"{far} with T off by more than 5 %, {failed} failed")  # fmt: skip


def cost(n: int = 33) -> None:
    """What a load step takes that drags a cable over cells."""
    say(f"\n{'dragged by':>12}{'cells':>7}{'slide':>7}{'T':>11}{'W':>12}{'solves':>8}{'flips':>7}"
        f"{'fact.':>7}{'eval.':>7}{'s':>7}")  # fmt: skip
    for kind in KINDS:
        for way in (0.3, 15.0, 30.0):
            for slide in (True, False):
                scene = sheet(COMM, n, kind)
                cable = scene.lay_cable(CABLE, [(-5, 35, 8), (105, 35, 8)], L0=109.5)
                solver = Solver(scene, slide=slide)
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore", PathWarning)  # slide=False is blocked
                        solver.advance(pressure=PRESSURE, steps=3)
                        began = time.perf_counter()
                        step = solver.advance(move={cable: (0.0, way, 0.0)})
                    seconds = time.perf_counter() - began
                except ConvergenceError as error:
                    say(f"{kind} {way:g} slide={slide}: {error}")
                    continue
                done = step.outcome
                halved = f", {step.halvings} halvings" if step.halvings else ""
                say(f"{way:12g}{way * n / 100:7.1f}{slide!s:>7}{cable.tension:11.4f}"
                    f"{scene.energy:12.4f}{done.solves:8}{done.flips:7}{done.factorizations:7}"
                    f"{done.evaluations:7}{seconds:7.2f}  {kind}{halved}")  # fmt: skip


def anchored(rng: np.random.Generator) -> tuple[int, str, list[tuple[float, ...]], float]:
    """A mesh, two anchors beyond opposite edges, and a length that is short or long for them."""
    n, kind = int(rng.integers(7, 18)), str(rng.choice(KINDS))
    a = (-rng.uniform(1, 10), rng.uniform(8, 92), rng.uniform(0, 13))
    b = (100 + rng.uniform(1, 10), rng.uniform(8, 92), rng.uniform(0, 13))
    return n, kind, [a, b], float(np.linalg.norm(np.subtract(a, b)) * rng.uniform(0.99, 1.01))


def anchors(count: int) -> None:
    """Random anchors: the contact laws, checked from the outside."""
    rng = np.random.default_rng(1)
    outcomes: Counter[str] = Counter()
    pulls, depths, work, began = [0.0], [0.0], [], time.perf_counter()
    for number in range(count):
        n, kind, path, L0 = anchored(rng)
        scene = sheet(COMM, n, kind)
        cable = scene.lay_cable(CABLE, path, L0=L0)
        try:
            step = Solver(scene).advance(pressure=PRESSURE)
        except ConvergenceError as error:
            outcomes["failed"] += 1
            say(f"  anchors {number}: n = {n}, {kind}, {path}, L0 = {L0}: {error}")
            continue
        outcomes["halved"] += step.halvings > 0
        touching = [k for k in cable.contacts() if cable.state.nodes[k].kind in ("fold", "vertex")]
        outcomes["slack" if not cable.taut else "touching" if touching else "free"] += 1
        work.append((step.outcome.solves, step.outcome.factorizations, step.outcome.evaluations))
        if cable.taut:
            pulls.append(strongest_pull(scene, cable))
            depths.append(deepest(scene, cable))
            if pulls[-1] > 1e-3 or depths[-1] > 1e-3:
                say(f"  anchors {number}: n = {n}, {kind}, {path}, L0 = {L0}: outward pull "
                    f"{pulls[-1]:.2g} T, {depths[-1]:.2g} h deep")  # fmt: skip
    say(
        f"\n{count} random anchors: {dict(outcomes)}; largest outward pull {max(pulls):.2g} T, "
        f"deepest below the membrane {max(depths):.2g} h; mean solves, factorisations, "
        f"evaluations: {np.mean(work, axis=0).round(1)}; {time.perf_counter() - began:.0f} s"
    )
    # fmt: on


def net(rng: np.random.Generator, most: int) -> Iterator[tuple[list[tuple[float, float]], int]]:
    """Ends on opposite edges, and levels."""
    for _ in range(int(rng.integers(2, most + 1))):
        u, v = rng.uniform(8, 92, 2)
        along = rng.random() < 0.5
        yield ([(0.0, u), (100.0, v)] if along else [(u, 0.0), (v, 100.0)]), int(rng.integers(3))


def nets(count: int, most: int, n: int = 17) -> None:
    """Random nets of 2 or more cables."""
    rng = np.random.default_rng(2)
    outcomes: Counter[str] = Counter()
    work, began = [], time.perf_counter()
    for number in range(count):
        kind = str(rng.choice(KINDS))
        scene = sheet(COMM, n, kind)
        for path, layer in net(rng, most):
            chord = float(np.linalg.norm(np.subtract(*path)))
            scene.lay_cable(CABLE, path, L0=chord * rng.uniform(1.0, 1.01), layer=layer)
        try:
            step = Solver(scene).advance(pressure=PRESSURE)
        except ConvergenceError as error:
            outcomes["failed"] += 1
            say(f"  net {number}: {kind}, {len(scene.cables)} cables: {error}")
            continue
        outcomes["converged"] += 1
        outcomes["cables"] += len(scene.cables)
        outcomes["halved"] += step.halvings > 0
        outcomes["crossings"] += len(scene.net.crossings)
        outcomes["apart"] += sum(crossing.separated for crossing in scene.net.crossings)
        work.append((step.outcome.solves, step.outcome.factorizations, step.outcome.evaluations))
    say(f"\n{count} random nets: {dict(outcomes)}; mean solves, factorisations, evaluations: "
        f"{np.mean(work, axis=0).round(1)}; {time.perf_counter() - began:.0f} s")  # fmt: skip


def main() -> None:
    """Print the tables asked for."""
    tables = ("accuracy", "lines", "starts", "cost", "anchors", "nets")
    parser = argparse.ArgumentParser(description="Sliding cables: see the head of this file.")
    parser.add_argument("tables", nargs="*", help=f"which, of {', '.join(tables)}; default all")
    parser.add_argument("--sizes", type=int, nargs="+", default=[9, 17, 33, 65])
    parser.add_argument("--anchors", type=int, default=100, help="how many random anchors")
    parser.add_argument("--nets", type=int, default=20, help="how many random nets")
    parser.add_argument("--cables", type=int, default=8, help="most cables of a net")
    given = parser.parse_args()
    wanted = given.tables or tables
    if set(wanted) - set(tables):
        parser.error(f"there are no such tables: {', '.join(set(wanted) - set(tables))}")
    if "accuracy" in wanted:
        accuracy(given.sizes)
    if "lines" in wanted:
        lines()
    if "starts" in wanted:
        starts([n for n in given.sizes if n in (17, 33)])
    if "cost" in wanted:
        cost()
    if "anchors" in wanted:
        anchors(given.anchors)
    if "nets" in wanted:
        nets(given.nets, given.cables)


if __name__ == "__main__":
    main()
