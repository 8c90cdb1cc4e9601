"""Wrinkling sheets: accuracy against mesh size, work, and cost of the law.

square
    A clamped square of 100 cm of model 3's fabric, warp along x, narrowed by 3 % along x and
    inflated with 0.01 kgf/cm2. W is against the value extrapolated from its two finest meshes.
annulus
    A flat annulus whose inner rim is turned in its plane, isotropic and with radial warp. Energy W
    and torque T are against a one-dimensional computation.
cost
    Time per cell of energy and gradient of the plain cells, as ratios to the isotropic law.

    ./run python benchmarks/tension_field.py [square] [annulus] [cost]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.model.materials import MembraneMaterial

sys.path.append(str(Path(__file__).parents[1] / "tests" / "scenes"))  # their meshes and references
from cabled_square import square
from twisted_annulus import radial, reference, twisted

FABRIC = OrthotropicMembrane(1394.0, 140.0, 12.0, 0.065, 1.0)
ISOTROPIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
W_SQUARE = -298.920301
WORK = f"{'evaluations':>13}{'factorisations':>16}{'s':>8}"


def say(text: str) -> None:
    """Print on one rank."""
    if MPI.COMM_WORLD.rank == 0:
        print(text, flush=True)


def work(solver: Solver) -> str:
    """What the last step took."""
    step = solver.steps[-1]
    outcome = step.outcome
    return f"{outcome.evaluations:13}{outcome.factorizations:16}{step.seconds:8.2f}"


def narrowed_square() -> None:
    """Table of the square."""
    comm, sizes, errors = MPI.COMM_WORLD, (8, 16, 32, 64), []
    say(f"\nnarrowed square\n{'N':>4}{'W':>15}{'W error':>10}{'w':>11}{'wrinkled':>10}{WORK}")
    for n in sizes:
        scene = Scene(square(comm, n), FABRIC)
        scene.fix("boundary")
        held = scene.held.all(axis=1)
        X = scene.V.tabulate_dof_coordinates()
        scene.u.x.array.reshape(-1, 3)[held, 0] = -0.03 * (X[held, 0] - 50.0)
        solver = Solver(scene)
        solver.advance(pressure=0.01)
        state = solver.results().state
        share = comm.allreduce(int(np.sum(state == 1))) / comm.allreduce(len(state))
        w = comm.allreduce(float(scene.positions()[:, 2].max()), op=MPI.MAX)
        errors.append(scene.energy - W_SQUARE)
        values = f"{scene.energy:15.6f}{errors[-1]:10.4f}{w:11.6f}{share:10.1%}"
        say(f"{n:4}{values}{work(solver)}")
    say(f"order of W from the first three: {order(sizes[:3], errors[:3]):.2f}")


def order(sizes: tuple[int, ...], errors: list[float]) -> float:
    """Fitted order of convergence."""
    return float(-np.polyfit(np.log(sizes), np.log(errors), 1)[0])


def annulus() -> None:
    """Tables of the annulus."""
    polar = OrthotropicMembrane(300.0, 100.0, 20.0, 0.05, 1.0, warp=radial)
    for name, material, angle in (
        ("isotropic", ISOTROPIC, 0.01),
        ("isotropic", ISOTROPIC, 0.1),
        ("isotropic", ISOTROPIC, 0.3),
        ("radial warp", polar, 0.1),
    ):
        energy, torque = reference(material.stiffness, angle)
        say(f"\nannulus, {name}, turned by {angle} rad: W = {energy:.8g}, T = {torque:.8g}")
        say(f"{'n':>4}{'W error':>11}{'T error':>11}{WORK}")
        sizes, errors = (4, 8, 16, 32), []
        for n in sizes:
            scene, solver, _, found = twisted(MPI.COMM_WORLD, n, material, angle)
            errors.append((scene.energy / energy - 1, found / torque - 1))
            say(f"{n:4}{errors[-1][0]:11.4%}{errors[-1][1]:11.4%}{work(solver)}")
        first, second = (order(sizes, list(column)) for column in np.array(errors).T)
        say(f"order of W {first:.2f}, of T {second:.2f}")


def seconds_per_cell(material: MembraneMaterial, shift: tuple[float, float, float]) -> float:
    """An evaluation of energy and gradient, the best of several."""
    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 1.0, structured=True)
    scene = Scene(mesh, material)
    term = MembraneEnergy(scene.u, scene.materials, scene.membrane.cell_tags)
    potential = Potential(Unknowns(scene.V), scene.u, [term])
    X = scene.V.tabulate_dof_coordinates()
    noise = 1e-3 * np.random.default_rng(0).normal(size=X.shape)
    scene.u.x.array[:] = (X * shift + noise).ravel()
    best = np.inf
    for _ in range(20):
        start = time.perf_counter()
        potential.evaluate()
        best = min(best, time.perf_counter() - start)
    return best / mesh.mesh.topology.index_map(2).size_local


def cost() -> None:
    """Table of the cost per cell."""
    shifts = {"taut": (0.1, 0.1, 0.0), "wrinkled": (0.1, -0.3, 0.0), "slack": (-0.1, -0.1, 0.0)}
    linear = OrthotropicMembrane(1394.0, 140.0, 12.0, 0.065, 1.0, wrinkling=False)
    laws = {"isotropic": ISOTROPIC, "orthotropic, linear": linear, "orthotropic": FABRIC}
    say(f"\n{'energy and gradient':30}{'ns per cell':>12}{'ratio':>8}")
    for state, shift in shifts.items():
        first = None
        for name, material in laws.items():
            seconds = seconds_per_cell(material, shift)
            first = first or seconds
            label = f"{state}, {name}" if name != "orthotropic" else f"{state}, orth. wrinkling"
            say(f"{label:30}{1e9 * seconds:12.0f}{seconds / first:8.2f}")


TABLES = {"square": narrowed_square, "annulus": annulus, "cost": cost}


def main() -> None:
    """Print the tables that are asked for, all by default."""
    for name in sys.argv[1:] or TABLES:
        TABLES[name]()


if __name__ == "__main__":
    main()
