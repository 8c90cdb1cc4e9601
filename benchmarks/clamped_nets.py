"""Random nets of 2 x 2 clamped cables on a square, each on three meshes: one equilibrium.

The cables are laid askew by up to 5 % of their length, so that they and their clamps slide over
some cells when the membrane is inflated. The unstressed lengths between clamps are those as laid.

    ./run python benchmarks/clamped_nets.py [FIRST END]

For each scene: cells a side on the coarsest mesh, and after each of two load steps the energies on
cells of 1, 0.8 and 0.64 times their size (* where the state is doubtful), and their range.
"""

from __future__ import annotations

import sys

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, ConvergenceError, IsotropicMembrane, Scene, Solver, meshes

FINER = (1.0, 0.8, 0.64)
WITHIN = 0.02
"""Range of the energies on the three meshes, relative to the largest, that counts as the same."""


def energies(number: int, finer: float) -> tuple[int, list[tuple[float, bool]]]:
    """Cells a side, and the energy and the doubt after each load step."""
    random = np.random.default_rng(5000 + number)
    cells = int(random.integers(10, 24))
    stiffness, prestress = 10 ** random.uniform(2.3, 3.7), random.choice([0.05, 0.5])
    EA, pressure = 10 ** random.uniform(2, 4.3), 10 ** random.uniform(-2.5, -1.3)
    mesh = meshes.rectangle(MPI.COMM_WORLD, 100.0, 100.0, 100.0 / cells * finer)
    fabric = IsotropicMembrane(E=stiffness, nu=0.3, thickness=0.08, prestress=prestress)
    scene = Scene(mesh, fabric)
    scene.fix("boundary")
    for layer, axes in enumerate(([0, 1], [1, 0])):
        for place in (33.0, 67.0):
            at = place + random.uniform(-4, 4)
            path = [(0.0, at), (45.0, at + random.choice([0, 2, 5, -5])), (100.0, at)]
            scene.lay_cable(Cable(EA), np.array(path)[:, axes], L0=100.2, layer=layer)
    scene.clamp(*scene.cables)
    solver = Solver(scene)
    found = []
    for share in (0.5, 1.0):
        solver.advance(pressure=share * pressure)
        verification = solver.steps[-1].verification
        assert verification is not None
        found.append((scene.energy, bool(verification.doubtful)))
    return cells, found


def main(first: int, end: int) -> None:
    same = doubtful = apart = refused = 0
    for number in range(first, end):
        try:
            runs = [energies(number, finer) for finer in FINER]
        except ConvergenceError as error:
            print(f"{number:4d}  refused: {error}", flush=True)
            refused += 1
            continue
        row = f"{number:4d}{runs[0][0]:4d}"
        for states in zip(*(found for _, found in runs), strict=True):
            W = np.array([energy for energy, _ in states])
            spread = float(np.ptp(W) / np.abs(W).max())
            row += " |" + "".join(f"{w:11.3f}{'*' if doubt else ' '}" for w, doubt in states)
            row += f"{spread:8.1e}"
            sound = not any(doubt for _, doubt in states)
            same += spread <= WITHIN
            doubtful += spread > WITHIN and not sound
            apart += spread > WITHIN and sound
        print(row, flush=True)
    print(
        f"states within {WITHIN:g} on all meshes: {same}; others, doubtful: {doubtful}, "
        f"not doubtful: {apart}; nets refused: {refused}"
    )


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3] or (0, 12)))
