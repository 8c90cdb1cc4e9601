"""Lateral friction of cables: accuracy and cost. Sections:

rigid
    A cable on a circle of latitude of a rigid sphere, and on curves of other rigid surfaces with a
    constant ratio of geodesic to normal curvature. It should slide if the ratio exceeds mu, and
    stop where it equals mu. Means over meshes, whose lattices are turned and shifted
    against the cable.
ways
    A cable on a rigid cylinder that is tightened by 1 % at smaller coefficients: its way over the
    exact one, least and largest of some meshes, in one load step and in six; in brackets the
    coefficient told from it, over mu (only for coefficients of three quarters of .2 and more).
rows
    Cables along a line of the mesh of a rigid sphere and cylinder: the coefficient at which half of
    the vertices have used up their elastic slip, over the one that holds an exact cable; and ways
    as above. Of some meshes with uneven rows, least and largest.
drum
    A cable over a drum that is dragged obliquely, in the shape of Coulomb's cone, with the cone and
    with independent friction sideways and along: ratio of tensions, force sideways.

    ./run python benchmarks/friction.py [rigid] [ways] [rows] [drum] [--meshes 8] [--sizes 20 40]
                                        [--half 1.0]

From a slid cable follows the coefficient with which an exact cable would have slid as far,
averaged over its length. The threshold is a slide of 0.02 cells, some elastic slips, over the
coefficient at which an exact cable slides as far: a short or flat arc slides only a little, and
would seem to stick. Both are relative to mu.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from crms_fenicsx import ConvergenceError, Solver
from crms_fenicsx.cabling.contact.contact_force import contact_forces
from crms_fenicsx.cabling.friction.slip import node_slips
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.laid_cable import LaidCable

sys.path.append(str(Path(__file__).parents[1] / "tests" / "scenes"))  # their surfaces
sys.path.append(str(Path(__file__).parents[1] / "tests" / "cabling" / "friction"))  # and the drum
from model_3 import say
from rigid_rows import rigid_row
from rigid_surfaces import SURFACES, Curve, Mesh, band, curve, rigid, sphere
from test_cone import dragged, steady

COMM = MPI.COMM_WORLD
LATITUDES = (10.0, 20.0, 30.0, 45.0)
SLID = 0.02
"""Mean way, in cells, from which on a cable counts as slid."""
STRAIN = 0.01


def tightened(way: Curve, mesh: Mesh, mu: float) -> tuple[LaidCable, Outcome] | None:
    """The cable after it was tightened by 1 % more than where it is to slide to; None: failed."""
    cable = rigid(COMM, way, mesh, Friction(mu))
    try:
        end = way.slid(mu).length if mu < way.ratio else way.length
        step = Solver(cable[0]).advance(L0={cable[1]: end * (1 - STRAIN)})
    except ConvergenceError as error:
        say(f"  mu = {mu:.4g}: {error}")
        return None
    return cable[1], step.outcome


def threshold(way: Curve, mesh: Mesh, h: float) -> float:
    """Where the cable begins to slide, over where it should; to a quarter of a per cent."""
    shares = np.array([0.9, 0.95, 0.98, 1.0])
    exact = [way.sideways(way.slid(s * way.ratio).points).mean() / h for s in shares]
    low, high = 0.92, 1.08
    while high - low > 0.005:
        middle = (low + high) / 2
        found = tightened(way, mesh, middle * way.ratio)
        slid = found is not None and way.sideways(found[0].state.positions).mean() > SLID * h
        low, high = (middle, high) if slid else (low, middle)
    return (low + high) / 2 / float(np.interp(-SLID, -np.array(exact), shares))


def row(label: str, way: Curve, h: float, meshes: int, kind: str, bisect: bool) -> None:
    """One line: coefficient and threshold over mu, mean and scatter, and the work."""
    mu, coefficients, thresholds, work = 0.95 * way.ratio, [], [], []
    began, failed = time.perf_counter(), 0
    for seed in range(meshes):
        mesh = band(way, h, seed, kind)
        found = tightened(way, mesh, mu)
        if found is None:
            failed += 1
            continue
        cable, done = found
        coefficients.append(way.coefficient_of(cable.state.positions) / mu)
        work.append((done.passes, done.solves, done.flips, done.evaluations))
        if bisect:
            thresholds.append(threshold(way, mesh, h))
    c, t = np.array(coefficients), np.array(thresholds or [np.nan])
    say(f"{label:22}{round(1 / h):5}{c.mean():10.4f}{c.std():8.4f}{t.mean():11.4f}{t.std():8.4f}"
        + "".join(f"{w:8.1f}" for w in np.mean(work, axis=0))
        + f"{failed:8}{time.perf_counter() - began:8.0f}")  # fmt: skip


def rigid_surfaces(sizes: Sequence[int], meshes: int, half: float) -> None:
    """Spheres with thresholds; other surfaces and kinds of meshes with coefficients."""
    say(f"\ncables over {2 * half:g} radii, {meshes} meshes each; over mu:\n"
        f"{'':22}{'1/h':>5}{'coeff.':>10}{'+-':>8}{'threshold':>11}{'+-':>8}{'passes':>8}"
        f"{'solves':>8}{'flips':>8}{'eval.':>8}{'failed':>8}{'s':>8}")  # fmt: skip
    for n in sizes:
        for degrees in LATITUDES:
            way = curve(sphere(np.radians(degrees)), float(np.tan(np.radians(degrees))), half)
            row(f"sphere, {degrees:g} degrees", way, 1 / n, meshes, "jittered", True)
    for n in sizes:
        for name, surface in SURFACES.items():
            for kind in ("structured", "delaunay", "lattice"):
                way = curve(surface, 0.5, 0.8)
                row(f"{name}, {kind}", way, 1 / n, min(meshes, 3), kind, False)


def ways(sizes: Sequence[int], meshes: int) -> None:
    """Of a cable along a limit curve of a rigid cylinder, at smaller coefficients."""
    way = curve(SURFACES["cylinder"], 0.2, 1.0)
    coefficients = (0.1, 0.13, 0.16, 0.19)
    exact = [way.sideways(way.slid(mu).points).mean() for mu in coefficients]
    say(f"\nway over the exact one (coefficient over mu), {meshes} meshes; mu:", *coefficients)
    say("exact way / R", *(f"{-one:.4f}" for one in exact))
    for n in sizes:
        for steps in (1, 6):
            text = f"R/{n}, {steps} steps"
            for mu, aim in zip(coefficients, exact, strict=True):
                found, told = [], []
                for seed in range(meshes):
                    scene, cable = rigid(COMM, way, band(way, 1 / n, seed), mu, EA=0.1)
                    solver, L = Solver(scene), cable.length
                    for k in range(steps):
                        solver.advance(L0={cable: L * (1 - STRAIN * (k + 1) / steps)})
                    found.append(way.sideways(cable.state.positions).mean() / aim)
                    told.append(way.coefficient_of(cable.state.positions) / mu)
                text += f"{min(found):9.3f}-{max(found):.3f} ({min(told):.3f}-{max(told):.3f})"
            say(text)


def held_row(way: Curve, h: float, seed: int) -> float:
    """Where half of a row's vertices begin to slide, over where they should; to 2.5e-4."""
    low, high = 0.97, 1.03
    while high - low > 5e-4:
        friction = Friction((low + high) / 2 * way.ratio, tolerance=1e-3)
        scene, cable = rigid_row(COMM, way, friction, h, seed=seed)
        Solver(scene).advance(L0={cable: cable.length * (1 - STRAIN)})
        lateral, aside = cable.state.law.lateral, cable.cable.sideways
        assert lateral is not None and aside is not None
        slips = node_slips(cable, lateral.curve, scene.net.strip_shape())
        used = np.abs(slips.slip) >= aside.tolerance * slips.size * (1 - 1e-9)
        low, high = ((low + high) / 2, high) if used.mean() >= 0.5 else (low, (low + high) / 2)
    return (low + high) / 2


def rows(sizes: Sequence[int], meshes: int) -> None:
    """Thresholds and ways of cables along lines."""
    curves = {"cylinder": curve(SURFACES["cylinder"], 0.5, 0.8)}
    for degrees in (10.0, 20.0):
        phi = np.radians(degrees)
        curves[f"sphere, {degrees:g} degrees"] = curve(sphere(phi), float(np.tan(phi)), 0.8)
    say(f"\nthreshold of rows over the exact one, least and largest of {meshes} meshes")
    for name, way in curves.items():
        for n in sizes:
            found = [held_row(way, 1 / n, seed) for seed in range(meshes)]
            say(f"{name:22} R/{n:<5}{min(found):9.4f}{max(found):9.4f}")
    way, coefficients = curve(SURFACES["cylinder"], 0.2, 1.0), (0.1, 0.13, 0.16, 0.19)
    say(f"way of rows over the exact one, {meshes} meshes; mu:", *coefficients)
    for n in sizes:
        text = f"R/{n}"
        for mu in coefficients:
            end, found = way.slid(mu), []
            for seed in range(meshes):
                scene, cable = rigid_row(COMM, way, mu, 1 / n, seed=seed)
                Solver(scene).advance(L0={cable: cable.length * (1 - STRAIN)})
                found.append(way.sideways(cable.state.positions).mean())
            found = np.array(found) / way.sideways(end.points).mean()
            text += f"{found.min():10.3f}-{found.max():.3f}"
        say(text)


def drum(n: int, meshes: int) -> None:
    """Dragged in three directions over a drum of n cells around."""
    say(f"\ndrum of {n} cells, {meshes} meshes; least and largest of ln of the ratio of tensions, "
        "sideways force over the press")  # fmt: skip
    for cone in (True, False):
        for degrees in (30.0, 45.0, 60.0):
            found, turn = [], np.radians(degrees)
            for seed in range(1, meshes + 1):
                friction = Friction(0.3, along=0.3, cone=cone)
                scene, cable, ln_T = dragged(COMM, friction, turn, n, seed)
                on = [k for k in cable.contacts() if cable.state.nodes[k].slides]
                press = contact_forces(cable, scene.net.strip_shape())
                aside = abs(press.lateral[on].sum()) / press.bearing[on].sum()
                found.append((np.log(cable.tensions[-1] / cable.tensions[0]), aside))
            _, around, alpha, _ = steady(0.3, 0.3, turn)
            mean = (alpha[-1] - alpha[0]) / np.trapezoid(np.cos(alpha), around)
            low, high = np.min(found, axis=0), np.max(found, axis=0)
            say(
                f"{'cone' if cone else 'box':5}{degrees:4g}  exact {ln_T[-1]:.3f}, {mean:.3f}; "
                + ", ".join(f"{a:.4g}-{b:.4g}" for a, b in zip(low, high, strict=True))
            )


def main() -> None:
    """Print the sections asked for."""
    sections = ("rigid", "ways", "rows", "drum")
    parser = argparse.ArgumentParser(description="Friction: see the head of this file.")
    parser.add_argument("sections", nargs="*", help=f"of {', '.join(sections)}; default all")
    parser.add_argument("--sizes", type=int, nargs="+", default=[20, 40], help="radii by cells")
    parser.add_argument("--meshes", type=int, default=8, help="of each size")
    parser.add_argument("--half", type=float, default=1.0, help="half of the cables' length")
    given = parser.parse_args()
    wanted = given.sections or sections
    if set(wanted) - set(sections):
        parser.error(f"there are no such sections: {', '.join(set(wanted) - set(sections))}")
    if "rigid" in wanted:
        rigid_surfaces(given.sizes, given.meshes, given.half)
    if "ways" in wanted:
        ways(given.sizes, given.meshes)
    if "rows" in wanted:
        rows(given.sizes, given.meshes)
    if "drum" in wanted:
        for n in given.sizes:
            drum(n, given.meshes)


if __name__ == "__main__":
    main()
