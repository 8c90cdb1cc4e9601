"""Error of a cable over the inflated square against the mesh size, on lines and across them.

The cable (EA = 32000 kgf, 100 cm long) lies across the middle of a clamped square of 100 cm at a
pressure of 0.01 kgf/cm2. Errors are against the continuum: T = 112.60349 kgf, W = -273.55493
kgf cm, extrapolated from meshes whose lines carry the cable.

    ./run python benchmarks/cable_accuracy.py
"""

from __future__ import annotations

import time

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

T_EXACT, W_EXACT = 112.60349, -273.55493
MESHES = {
    "cable on mesh lines": ((8, 16, 32, 64), True),
    "cable in mid-row": ((9, 17, 33, 65), True),
    "unstructured mesh": ((9, 17, 33, 65), False),
}


def main() -> None:
    """Print the table."""
    rank = MPI.COMM_WORLD.rank
    for name, (sizes, structured) in MESHES.items():
        if rank == 0:
            print(f"\n{name}")
            print(f"{'cells a side':>12}{'T error':>12}{'W error':>12}{'evaluations':>13}{'s':>8}")
        errors = []
        for n in sizes:
            mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / n, structured=structured)
            scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
            scene.fix("boundary")
            cable = scene.lay_cable(Cable(EA=32000.0), [(0, 50), (100, 50)], L0=100.0)
            start = time.perf_counter()
            step = Solver(scene).advance(pressure=0.01)
            seconds = time.perf_counter() - start
            errors.append((abs(cable.tension / T_EXACT - 1), abs(scene.energy / W_EXACT - 1)))
            if rank == 0:
                dT, dW = errors[-1]
                count = step.outcome.evaluations
                print(f"{n:12}{dT:12.5%}{dW:12.5%}{count:13}{seconds:8.2f}", flush=True)
        slopes = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
        if rank == 0:
            print(f"{'order':>12}{-slopes[0]:12.2f}{-slopes[1]:12.2f}")


if __name__ == "__main__":
    main()
