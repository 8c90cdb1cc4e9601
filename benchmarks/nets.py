"""Nets of sliding cables on a roof: cost of a load step, and its results.

    ./run python benchmarks/nets.py [--held] [--cables N] [UNKNOWNS ...]

The roof of `demos/air_dome.py` with N cables (14 by default) in each of its two families is
inflated from its plan shape to 0.3 kPa and then to 0.5 kPa, with 1500, 10 000 and 30 000 unknowns
of the membrane by default. With --held the cables slide along the edges that they cross, but not to
other cells. Seconds are CPU time of this process; the numbers of evaluations, factorisations of H0
and separate Newton steps of patches do not depend on the machine.

Energies that differ by less than the mesh error decide on which side cables pass vertices. Where
two versions decide differently, tensions differ by some .2 % (rms).
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import parallel

PRESSURES = (0.3, 0.5)


def main() -> None:
    """Run the roofs, and print a line for each load step."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("unknowns", nargs="*", type=float, default=[1500, 10_000, 30_000])
    options.add_argument("--cables", type=int, default=14)
    options.add_argument("--held", action="store_true")
    chosen = options.parse_args()
    head = "unknowns    kPa   s CPU solves iterations evaluations factorisations local steps"
    for number, unknowns in enumerate(chosen.unknowns):
        start = time.process_time()
        scene, solver = parallel.roof(unknowns, chosen.cables, not chosen.held)
        laid, first = time.process_time() - start, scene.comm.rank == 0
        if first and number == 0:
            print(f"{head}             W   T min     mean      max")
        for pressure in PRESSURES:
            start = time.process_time()
            outcome = solver.advance(pressure=pressure).outcome
            seconds = time.process_time() - start
            T = np.array([cable.tension for cable in scene.cables])
            if first:
                counts = outcome.iterations, outcome.evaluations, outcome.factorizations
                print(
                    f"{3 * solver.system.unknowns.n_global:8d}   {pressure:.2f} {seconds:7.2f} "
                    f"{outcome.solves:6d} {counts[0]:10d} {counts[1]:11d} {counts[2]:14d} "
                    f"{outcome.local_steps:11d} {scene.energy:13.6f} {T.min():7.2f} "
                    f"{T.mean():8.3f} {T.max():8.2f}",
                    flush=True,
                )
        if first:
            print(f"{'':11}laying: {laid:.2f} s")


if __name__ == "__main__":
    main()
