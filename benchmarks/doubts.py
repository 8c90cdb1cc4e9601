"""Whether the range told of a doubtful tension contains that on fine cells.

    ./run python benchmarks/doubts.py 60

Weak cables lie at random places over squares and spherical caps of 5 to 12 cells, with random
stiffness, pressure, prestress and friction, and lengths near that of their way over the membrane.
Doubtful cases are computed again on 56 cells, with the same unstressed length.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, DoubtWarning, IsotropicMembrane, PathError, Scene, Solver, meshes
from crms_fenicsx.analysis.verification.doubts import HELD_SIDEWAYS, tension_range

FINE = 56
"""Cells across the fine mesh."""


def solved(
    kind: str, cells: int, ends: list[tuple[float, float]], p: float, prestress: float,
    cable: Cable, L0: float | None,
) -> tuple[Solver, tuple[float, float]]:  # fmt: skip
    """A cable on an inflated membrane, and the range of its tension."""
    comm, size = MPI.COMM_WORLD, 100.0 / cells
    if kind == "cap":
        mesh = meshes.spherical_cap(comm, 50.0, 20.0, size=size)
    else:
        mesh = meshes.rectangle(comm, 100.0, 100.0, size, structured=kind == "structured")
    material = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=prestress)
    scene = Scene(mesh, material)
    scene.fix("boundary")
    solver = Solver(scene)
    solver.advance(pressure=p)
    laid = scene.lay_cable(cable, ends, L0=L0)
    solver.advance()
    if not laid.taut:
        return solver, (0.0, 0.0)
    return solver, tension_range(laid, scene.net.strip_shape())


def case(random: np.random.Generator) -> bool | None:
    """Compare a random case; None if it is not doubtful."""
    kind = str(random.choice(["structured", "unstructured", "cap"]))
    a, b = random.uniform(15.0, 85.0, 2)
    ends = [(0.0, a), (100.0, b)]
    if kind == "cap":
        first = random.uniform(0.0, 2 * np.pi)
        last = first + np.pi + random.uniform(-0.8, 0.8)
        ends = [(49.99 * np.cos(x), 49.99 * np.sin(x)) for x in (first, last)]
    cells, EA = int(random.integers(5, 13)), float(10 ** random.uniform(-2, 3))
    p, prestress = float(10 ** random.uniform(-2.5, -1)), float(random.choice([0.0, 0.0, 0.1]))
    friction, longer = float(random.choice([0.0, 0.0, 0.2])), float(10 ** random.uniform(-4, -2))
    # The length of a cable without tension on fine cells, less a small part of it.
    idle, (low, _) = solved(kind, 24, ends, p, prestress, Cable(1e-3), None)
    L0 = idle.scene.cables[0].L0 * (1 + low / 1e-3) * (1 - longer)
    cable = Cable(EA, friction=friction)
    coarse, (low, high) = solved(kind, cells, ends, p, prestress, cable, L0)
    checked = coarse.steps[-1].verification
    if checked is None or not HELD_SIDEWAYS & {check.name for check in checked.doubtful}:
        return None
    _, fine = solved(kind, FINE, ends, p, prestress, cable, L0)
    inside = low <= 1.001 * fine[0] and fine[1] <= 1.001 * high
    print(f"{kind:13}{cells:3} cells, EA {EA:7.3g}, p {p:.3g}, mu {friction}: told {low:.3g} to "
          f"{high:.3g}, on fine cells {fine[0]:.3g} to {fine[1]:.3g}"
          f"{'' if inside else ': outside'}", flush=True)  # fmt: skip
    return inside


def main() -> None:
    """Compare as many cases as are asked for."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("cases", type=int)
    random, found = np.random.default_rng(2026), list[bool | None]()
    warnings.simplefilter("ignore", DoubtWarning)
    for _ in range(parser.parse_args().cases):
        try:
            found.append(case(random))
        except PathError as error:
            print(f"refused: {error}")
    print(f"{found.count(True)} of {found.count(True) + found.count(False)} ranges contain that on "
          f"fine cells; {found.count(None)} cases are not doubtful")  # fmt: skip


if __name__ == "__main__":
    main()
