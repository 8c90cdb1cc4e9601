"""Error of a cable over the inflated square against the mesh size: on lines, across, refined.

The cable (EA = 32000 kgf, 100 cm long) lies across the middle of a clamped square of 100 cm at a
pressure of 0.01 kgf/cm2. Errors are relative to the continuum, T = 112.60349 kgf, W = -273.55493
kgf cm, extrapolated from meshes whose lines carry the cable. Halving the mesh size along the cable
does not pay: folded elements represent the crease exactly, so their cells have the usual error,
and a larger one for the same time.

With `lengths`: the error of the tension on the unstructured mesh, for cables from tight to nearly
slack, against tensions extrapolated from meshes with lines under each cable.

    ./run python benchmarks/cable_accuracy.py [lengths]
"""

from __future__ import annotations

import sys
import time

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh

T_EXACT, W_EXACT = 112.60349, -273.55493
EVEN, ODD = (8, 16, 32, 64), (9, 17, 33, 65)
PATH = [(0.0, 50.0), (100.0, 50.0)]
LENGTHS = (100.0, 100.5, 101.0, 101.5, 102.0)


def structured(size: float) -> MembraneMesh:
    """Triangles of a grid."""
    return meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, size, structured=True)


def unstructured(size: float) -> MembraneMesh:
    """Triangles of one size."""
    return meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, size)


def refined(size: float) -> MembraneMesh:
    """Triangles of half the size along the cable."""
    finer = meshes.Refinement(PATH, size / 2, 20.0)
    return meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, size, refinements=[finer])


MESHES = {
    "cable on mesh lines": (EVEN, structured),
    "cable in mid-row": (ODD, structured),
    "unstructured mesh": (ODD, unstructured),
    "refined along the cable": (ODD, refined),
}


def tension(mesh: MembraneMesh, length: float) -> float:
    """Tension of a cable of some length over a mesh (kgf)."""
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    cable = scene.lay_cable(Cable(EA=32000.0), PATH, L0=length)
    Solver(scene).advance(pressure=0.01)
    return cable.tension


def lengths() -> None:
    """Print the table of cables from tight to nearly slack."""
    sizes = (17, 25, 33, 65)
    for length in LENGTHS:
        coarse, fine = (tension(structured(100.0 / n), length) for n in (64, 128))
        exact = fine + (fine - coarse) / 3
        errors = (tension(unstructured(100.0 / n), length) / exact - 1 for n in sizes)
        text = "".join(f"{n:6}:{error:9.3%}" for n, error in zip(sizes, errors, strict=True))
        if MPI.COMM_WORLD.rank == 0:
            print(f"L0 {length}  T {exact:10.4f} {text}", flush=True)


def main() -> None:
    """Print the table of meshes."""
    rank = MPI.COMM_WORLD.rank
    for name, (sizes, made) in MESHES.items():
        if rank == 0:
            print(f"\n{name}")
            print(f"{'cells a side':>12}{'cells':>8}{'T error':>12}{'W error':>12}"
                  f"{'evaluations':>13}{'s':>8}")  # fmt: skip
        errors, counts = [], []
        for n in sizes:
            mesh = made(100.0 / n)
            counts.append(mesh.mesh.topology.index_map(2).size_global)
            scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
            scene.fix("boundary")
            cable = scene.lay_cable(Cable(EA=32000.0), PATH, L0=100.0)
            start = time.perf_counter()
            step = Solver(scene).advance(pressure=0.01)
            seconds = time.perf_counter() - start
            errors.append((abs(cable.tension / T_EXACT - 1), abs(scene.energy / W_EXACT - 1)))
            if rank == 0:
                dT, dW = errors[-1]
                count = step.outcome.evaluations
                print(f"{n:12}{counts[-1]:8}{dT:12.5%}{dW:12.5%}{count:13}{seconds:8.2f}",
                      flush=True)  # fmt: skip
        slopes = 2 * np.polyfit(np.log(counts), np.log(errors), 1)[0]  # of the size of a cell
        if rank == 0:
            print(f"{'order':>12}{-slopes[0]:20.2f}{-slopes[1]:12.2f}")


if __name__ == "__main__":
    lengths() if "lengths" in sys.argv[1:] else main()
