"""Gain of adaptive refinement by the error estimate.

The same scenes on meshes of `meshes.refine`, with all cells quartered or with the cells of
`study.marked_cells` bisected, from the same first mesh. Errors are in per cent; seconds are this
process's from the first mesh on, previous levels included; evaluations are those of the level's
last solve. The last columns give the unknowns and seconds that uniform meshes need for the same
error of the energy, relative to the adapted mesh, interpolated between levels. Run it on one
process.

    ./run python benchmarks/adapted_meshes.py [CASE ...]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from accuracy.cases import CASES, Laws
from accuracy.references import reference
from mpi4py import MPI
from scipy.spatial import ConvexHull

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes, nets
from crms_fenicsx.design.study import adapt, marked_cells
from crms_fenicsx.design.study.values import Build
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

RIM, HEIGHT, PRESSURE = 20.0, 10.0, 0.4
RTOL = 1e-8


def cap(size: float) -> MembraneMesh:
    """The mesh of the dome of `demos/cable_net.py`."""
    return meshes.spherical_cap(MPI.COMM_SELF, RIM, HEIGHT, size)


def dome(mesh: MembraneMesh, angles: tuple[float, ...], offsets: tuple[float, ...]) -> Solver:
    """The dome with cables that are laid just taut, in the calm."""
    scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    scene.fix("boundary")
    for angle in np.radians(angles):
        for offset in offsets:
            scene.lay_cable(Cable(EA=30e3), nets.great_circle(RIM, HEIGHT, angle, offset))
    solver = Solver(scene, rtol=RTOL)
    solver.advance(pressure=PRESSURE)
    return solver


def of_accuracy(name: str) -> Build:
    """A case with independent references."""
    return lambda mesh: CASES[name].run(mesh, Laws(rtol=RTOL))[0]


def without_quarter(n: int) -> MembraneMesh:
    """The square of `square` without a quarter: a re-entrant corner."""
    lines = np.linspace(0.0, 100.0, n + 1)
    x = np.stack(np.meshgrid(lines, lines), axis=-1).reshape(-1, 2)
    grid = np.arange(len(x)).reshape(n + 1, n + 1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    cells = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
    kept = cells[(x[cells].mean(axis=1) < 50.0).any(axis=1)]
    used, numbers = np.unique(kept, return_inverse=True)
    return meshes.from_arrays(MPI.COMM_SELF, x[used], numbers.reshape(-1, 3))


def corner(mesh: MembraneMesh) -> Solver:
    """An inflated sheet with a re-entrant corner."""
    scene = Scene(mesh, IsotropicMembrane(300.0, 0.25, 0.08))
    scene.fix("boundary")
    solver = Solver(scene, rtol=RTOL)
    solver.advance(pressure=0.01)
    return solver


@dataclass(frozen=True)
class Study:
    """A scene, how often its mesh is refined and adapted, and what it comes to.

    Attributes
    ----------
    mesh
        Makes the first mesh.
    build
        Solves on a mesh.
    refined, adapted
        Numbers of levels after it.
    W, T
        The energy and the mean tension in the continuum; None for those of the last two refined
        meshes, extrapolated with order 2. NaN for the energy of the last adapted mesh less its
        estimated error, where order 2 is not to be had.
    share
        Of the error, that the marked cells have.
    """

    mesh: Callable[[], MembraneMesh]
    build: Build
    refined: int
    adapted: int
    W: float | None = None
    T: float | None = None
    share: float = 0.5


def one_cable(mesh: MembraneMesh) -> Solver:
    """The dome with one cable along a great circle."""
    return dome(mesh, (0.0,), (0.0,))


def known(name: str, quantity: str) -> float:
    """A reference."""
    return reference(name, quantity).value


STUDIES = {
    "one cable": Study(lambda: cap(4.0), one_cable, 4, 7, T=13.743),
    "one cable, share 0.8": Study(lambda: cap(4.0), one_cable, 4, 4, T=13.743, share=0.8),
    "net": Study(
        lambda: cap(2.0), lambda mesh: dome(mesh, (30.0, -30.0), tuple(4.5 * np.arange(-3, 4))),
        2, 4, T=10.47,
    ),
    "cable on a plane": Study(
        lambda: CASES["cable anywhere"].mesh(9), of_accuracy("cable anywhere"), 2, 4,
        known("centre cable", "W"), known("centre cable", "T"),
    ),
    "square": Study(
        lambda: CASES["square"].mesh(8), of_accuracy("square"), 4, 8, known("square", "W")
    ),
    "corner": Study(lambda: without_quarter(8), corner, 4, 9, np.nan),
}  # fmt: skip


@dataclass(frozen=True)
class Level:
    """Results on one mesh."""

    cells: int
    unknowns: int
    seconds: float
    evaluations: int
    W: float
    T: float
    estimate: float


def level(solver: Solver, seconds: float) -> Level:
    """The results of a solver."""
    scene = solver.scene
    topology = scene.mesh.mesh.topology
    return Level(
        topology.index_map(2).size_global,
        3 * topology.index_map(0).size_global,
        seconds,
        solver.steps[-1].outcome.evaluations,
        scene.energy,
        float(np.mean([cable.tension for cable in scene.cables] or [np.nan])),
        solver.estimate_error().total,
    )


def levels(study: Study, kind: str) -> list[Level]:
    """The first mesh and those made of it."""
    mesh, seconds, found, marked = study.mesh(), 0.0, list[Level](), None
    for k in range((study.refined if kind == "refined" else study.adapted) + 1):
        began = time.process_time()
        if k:
            mesh = meshes.refine(mesh, marked)
        solver = study.build(mesh)
        marked = None if kind == "refined" else marked_cells(solver, study.share)
        seconds += time.process_time() - began
        found.append(level(solver, seconds))
    return found


def needed(refined: list[Level], truth: float, error: float, what: str) -> float:
    """What refined meshes need for an error of the energy, interpolated in logarithms."""
    errors = np.log([abs(one.W - truth) for one in refined])
    amounts = np.log([getattr(one, what) for one in refined])
    if not errors[-1] <= np.log(error) <= errors[0]:
        return np.nan
    return float(np.exp(np.interp(-np.log(error), -errors, amounts)))


def show(name: str, study: Study) -> None:
    """Print the tables of a case."""
    study.build(study.mesh())  # compiles what will be needed
    refined, adapted = levels(study, "refined"), levels(study, "adapted")
    (last, end) = refined[-2:]
    W = end.W + (end.W - last.W) / 3 if study.W is None else study.W
    W = adapted[-1].W - adapted[-1].estimate if np.isnan(W) else W
    T = end.T + (end.T - last.T) / 3 if study.T is None else study.T
    print(f"\n{name}: W = {W:.8g}, T = {T:.6g}")
    print(f"{'':10}{'cells':>8}{'unknowns':>10}{'seconds':>9}{'evals':>7}{'W %':>10}{'T %':>9}"
          f"{'est. %':>9}{'unknowns':>10}{'seconds':>9}")  # fmt: skip
    for kind, ones in (("refined", refined), ("adapted", adapted)):
        for one in ones:
            off = abs(one.W - W)
            saved = [
                needed(refined, W, off, what) / getattr(one, what)
                for what in ("unknowns", "seconds")
            ]
            print(f"{kind:10}{one.cells:8}{one.unknowns:10}{one.seconds:9.1f}{one.evaluations:7}"
                  f"{100 * (one.W - W) / abs(W):10.4f}{100 * (one.T - T) / T:9.3f}"
                  f"{100 * one.estimate / abs(W):9.4f}"
                  + ("".join(f"{x:9.1f}x" for x in saved) if kind == "adapted" else ""),
                  flush=True)  # fmt: skip


def concave(mesh: MembraneMesh) -> float:
    """Share of a dome's edges between two cells that are concave, in per cent."""
    topology, x = mesh.mesh.topology, mesh.mesh.geometry.x[geometry_dofmap(mesh.mesh)]
    normals, middles = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), x.mean(axis=1)
    cells = topology.connectivity(1, 2)
    pairs = [cells.links(edge) for edge in range(topology.index_map(1).size_local)]
    a, b = np.array([pair for pair in pairs if len(pair) == 2]).T
    return 100 * float(np.mean(((middles[b] - middles[a]) * normals[a]).sum(axis=1) > 1e-9))


def convex(mesh: MembraneMesh) -> MembraneMesh:
    """The dome with the same vertices whose edges are all convex."""
    x = mesh.mesh.geometry.x.copy()
    hull = ConvexHull(x)
    return meshes.from_arrays(MPI.COMM_SELF, x, hull.simplices[hull.equations[:, 2] > 1e-6])


def dents() -> None:
    """Print what concave edges of irregular meshes do to the dome's energy."""
    print(f"\n{'dome':28}{'cells':>8}{'unknowns':>10}{'concave %':>11}{'W':>11}{'T':>8}")

    def line(name: str, mesh: MembraneMesh, solver: Solver) -> None:
        one = level(solver, 0.0)
        print(f"{name:28}{one.cells:8}{one.unknowns:10}{concave(mesh):11.2f}{one.W:11.4f}{one.T:8.3f}",
              flush=True)  # fmt: skip

    regular = cap(2.0)
    random, rng = regular, np.random.default_rng(0)
    for k in range(4):
        line("no cable, refined", regular, dome(regular, (), ()))
        if k in (1, 2):
            count = random.mesh.topology.index_map(2).size_local
            marked = np.flatnonzero(rng.random(count) < 0.3).astype(np.int32)
            random = meshes.refine(random, marked)
            line("no cable, random", random, dome(random, (), ()))
        regular = meshes.refine(regular)
    solver = adapt(one_cable, cap(4.0), tolerance=1e-9, levels=4)
    mesh = solver.scene.mesh
    line("one cable, adapted", mesh, solver)
    line("one cable, edges flipped", convex(mesh), one_cable(convex(mesh)))


def main() -> None:
    """Print all tables, or those of the cases named."""
    for name in sys.argv[1:] or (*STUDIES, "dents"):
        if name == "dents":
            dents()
        else:
            show(name, STUDIES[name])


if __name__ == "__main__":
    main()
