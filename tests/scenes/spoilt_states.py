"""Solved scenes of which one part is weak, and their verification once something is spoilt."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from cabled_square import advanced, clamped, sheet, square
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, Friction, IsotropicMembrane, LaidCable, Solver
from crms_fenicsx.analysis.verification.cable_forces import plain_vertices
from crms_fenicsx.analysis.verification.report import Verification
from crms_fenicsx.analysis.verification.verifier import Verifier

SCENES = {  # E t of the membrane, EA of the cable looked at and of those beside it, pressure
    "stiff membrane": (2.4e5, 0.3, None, 5e-4),
    "soft membrane": (0.1, 3e4, None, 1e-6),
    "prestressed, hardly loaded": (24.0, 3e4, None, 1e-9),
    "weak cable": (24.0, 1.0, 3e5, 3e-4),
    "tiny forces": (24e-9, 3e-5, None, 1e-11),
}


def cabled(
    comm: MPI.Intracomm,
    name: str,
    friction: float | Friction = 0.0,
    *,
    pressure: float | None = None,
    EA: float | None = None,
    crossed: bool = False,
    floor: float | None = None,
) -> Solver:
    """A sheet with a cable across it, in places beside stronger ones, solved.

    The cable looked at is the first. It may be crossed by one like it, and lie over a floor.
    """
    Et, usual_EA, beside, usual_pressure = SCENES[name]
    EA = usual_EA if EA is None else EA
    pressure = usual_pressure if pressure is None else pressure
    prestress = 2.0 if name.startswith("prestressed") else 0.0
    material = IsotropicMembrane(E=Et, nu=0.25, thickness=1.0, prestress=prestress)
    scene = clamped(square(comm, 7, "unstructured"), material)
    if floor is not None:
        scene.floor(floor)
    solver = advanced(Solver(scene), pressure=pressure)
    cable = scene.lay_cable(Cable(EA, friction=friction), [(-4, 47, -2), (104, 56, -2)])
    tight = {cable: 0.97 * cable.length}
    if crossed:
        other = scene.lay_cable(Cable(EA), [(47, -4, -2), (56, 104, -2)], layer=1)
        tight[other] = 0.97 * other.length
    if beside is not None:
        for y in (20, 80):
            strong = scene.lay_cable(Cable(beside), [(-4, y, -2), (104, y, -2)])
            tight[strong] = 0.97 * strong.length
    solver.advance(L0=tight)
    return solver


def masts(comm: MPI.Intracomm, E: float = 100.0) -> Solver:
    """A sheet that hangs from strong guys at two of its vertices, from weak ones at a third."""
    scene = sheet(
        comm, 8, material=IsotropicMembrane(E=E, nu=0.3, thickness=1.0, prestress=1.0), side=10.0
    )
    for x, EA in ((2.5, 1e5), (7.5, 1e5), (5.0, 1e-3)):
        top = scene.add_joint((x, 5.0, 2.0), name=f"top {x}")
        scene.add_bar(Bar(EA), top, scene.vertex_at((x, 5.0, 0.0)), L0=1.98, name=f"hanger {x}")
        for dx, dy in ((3.0, 0.0), (-1.5, 2.6), (-1.5, -2.6)):
            scene.add_bar(Bar(EA), top, (x + dx, 5.0 + dy, 2.0), L0=2.95)
    return advanced(Solver(scene), pressure=0.01)


def checked(solver: Solver, spoil: Callable[[], None] | None = None) -> Verification:
    """The verification of the state that a solver is in, once something has been spoiled."""
    verifier = Verifier(solver.scene)
    solver.system.potential.sum_up()
    verifier.begin()
    if spoil is not None:
        spoil()
    return verifier.check(solver.system, solver.steps[-1].outcome)


def names(verification: Verification | None) -> set[str]:
    """What is not as it must be."""
    assert verification is not None
    return {check.name for check in (*verification.failed, *verification.doubtful)}


def alarms(solver: Solver) -> set[str]:
    """What was not as it must be when the state was found."""
    return names(solver.steps[-1].verification)


def moved(solver: Solver, block: int, way: np.ndarray) -> None:
    """Move a block of this rank, -1 if another one has it, and let all else follow. Collective."""
    potential = solver.system.potential
    if block >= 0:
        potential.x[block] += way
    potential.place()
    potential.sum_up()
    solver.system.write_scene()


def pressing(cable: LaidCable) -> int:
    """A node with which a cable lies on an edge, in its middle."""
    k = len(cable.state.nodes) // 2
    return min(
        (
            n
            for n, node in enumerate(cable.state.nodes)
            if node.kind == "fold" and not cable.state.lifted[n]
        ),
        key=lambda n: (abs(n - k), n),
    )


def own_block(solver: Solver, k: int) -> int:
    """The block of a node of the first cable, on the rank that has it."""
    assert solver.system.cables is not None
    numbering = solver.system.cables.numbering
    return numbering.block(0, k) if numbering.is_mine(0, k) else -1


def middle_vertex(solver: Solver) -> int:
    """The block of the vertex in the middle at which no cable acts, on its rank."""
    scene, plain = solver.scene, plain_vertices(solver.system)
    away = np.linalg.norm(scene.membrane.stress_free[plain] - scene.membrane.centre, axis=1)
    nearest = float(away.min(initial=np.inf))
    least = scene.comm.allreduce(nearest, op=MPI.MIN)
    return int(plain[np.argmin(away)]) if nearest == least else -1
