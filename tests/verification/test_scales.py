"""Each check is relative to what it checks: it sees what is spoiled on a weak part of a scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from cable_edits import put
from cabled_square import clamped
from mpi4py import MPI
from reference_meshes import square

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.verification.plain_vertices import plain_vertices
from crms_fenicsx.verification.report import Verification
from crms_fenicsx.verification.verifier import Verifier

pytestmark = pytest.mark.usefixtures("comm")

SCENES = {  # E t of the membrane, EA of the cable looked at and of those beside it, pressure
    "stiff membrane": (2.4e5, 0.3, None, 0.01),
    "soft membrane": (0.1, 3e4, None, 1e-6),
    "prestressed, hardly loaded": (24.0, 3e4, None, 1e-9),
    "weak cable": (24.0, 0.03, 3e5, 0.01),
    "tiny forces": (24e-9, 3e-5, None, 1e-11),
}


HELD = {"stiff membrane": {"held by edges"}, "weak cable": {"held by edges"}}
"""Where folded edges are so much stiffer than the cable is tight that they hold it sideways."""


def cabled(comm: MPI.Intracomm, name: str) -> Solver:
    """A sheet with a cable across it, in places beside stronger ones, solved."""
    Et, EA, beside, pressure = SCENES[name]
    prestress = 2.0 if name.startswith("prestressed") else 0.0
    material = IsotropicMembrane(E=Et, nu=0.25, thickness=1.0, prestress=prestress)
    scene = clamped(square(comm, 7, "unstructured"), material)
    solver = Solver(scene)
    solver.advance(pressure=pressure)
    cable = scene.lay_cable(Cable(EA), [(-4, 47, -2), (104, 56, -2)])
    tight = {cable: 0.97 * cable.length}
    if beside is not None:
        for y in (20, 80):
            strong = scene.lay_cable(Cable(beside), [(-4, y, -2), (104, y, -2)])
            tight[strong] = 0.97 * strong.length
    solver.advance(L0=tight)
    return solver


def checked(solver: Solver, spoil: Callable[[], None] | None = None) -> Verification:
    """The verification of the state that a solver is in, once something has been spoiled."""
    verifier = Verifier(solver.scene)
    solver.system.potential.sum_up()
    verifier.begin()
    if spoil is not None:
        spoil()
    return verifier.check(solver.system, solver.steps[-1].outcome)


def names(verification: Verification) -> set[str]:
    """What is not as it must be."""
    return {check.name for check in (*verification.failed, *verification.doubtful)}


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
    k = len(cable.nodes) // 2
    return min(
        (n for n, node in enumerate(cable.nodes) if node.kind == "fold" and not cable.lifted[n]),
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


@pytest.mark.parametrize("name", SCENES)
def test_sound_states_raise_no_alarm(comm: MPI.Intracomm, name: str) -> None:
    """Whichever part is weak beside the others; a cable that zigzags is no sound state."""
    assert names(checked(cabled(comm, name))) == HELD.get(name, set())


SPOILT = {
    "tension": "tension against length",
    "length": "tension against length",
    "contact": "tension against length",
    "end": "ends of cable off their place",
    "place": "nodes off their edges",
    "slid": "unbalanced forces of cables",
    "lifted out": "unbalanced forces of cables",
    "vertex": "unbalanced forces of the membrane",
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("what", SPOILT)
def test_what_is_spoiled_on_one_part_is_found(comm: MPI.Intracomm, name: str, what: str) -> None:
    """By amounts that matter to this part, and to no other."""
    solver = cabled(comm, name)
    scene = solver.scene
    cable = scene.cables[0]
    k = pressing(cable)
    strain = cable.tension / cable.cable.EA

    def spoil() -> None:
        if what == "tension":
            cable.update(tension=1.001 * cable.tension)
        elif what == "length":
            cable.update(length=cable.length + 1e-3 * strain * cable.L0)
        elif what == "contact":
            put(cable, "lifted", k, True)
        elif what == "end":
            put(cable, "positions", 0, cable.positions[0] + 1e-6 * cable.length)
        elif what == "place":
            put(cable, "positions", k, cable.positions[k] + 1e-4)
        elif what == "slid":  # by .01 of the cells, along the edge
            edge = cable.positions[k + 1] - cable.positions[k - 1]
            side = np.cross(edge, [0.0, 0.0, 1.0]) / np.linalg.norm(edge)
            moved(solver, own_block(solver, k), 0.15 * side)
        elif what == "lifted out":
            span = np.linalg.norm(cable.positions[k + 1] - cable.positions[k - 1])
            moved(solver, own_block(solver, k), np.array([0.0, 0.0, 1e-3 * span]))
        elif what == "vertex":
            z = scene.comm.allreduce(float(np.abs(scene.u.x.array).max(initial=0)), op=MPI.MAX)
            moved(solver, middle_vertex(solver), np.array([0.0, 0.0, 0.01 * z]))

    assert SPOILT[what] in names(checked(solver, spoil))


def masts(comm: MPI.Intracomm) -> Solver:
    """A sheet that hangs from strong guys at two of its vertices, from weak ones at a third."""
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.25, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=100.0, nu=0.3, thickness=1.0, prestress=1.0))
    scene.fix("boundary")
    for x, EA in ((2.5, 1e5), (7.5, 1e5), (5.0, 1e-3)):
        top = scene.add_joint((x, 5.0, 2.0), name=f"top {x}")
        scene.add_bar(Bar(EA), top, scene.vertex_at((x, 5.0, 0.0)), L0=1.98, name=f"hanger {x}")
        for dx, dy in ((3.0, 0.0), (-1.5, 2.6), (-1.5, -2.6)):
            scene.add_bar(Bar(EA), top, (x + dx, 5.0 + dy, 2.0), L0=2.95)
    solver = Solver(scene)
    solver.advance(pressure=0.01)
    return solver


@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("end", "ends of bars off their place"),
        ("force", "forces of bars"),
        ("joint", "unbalanced forces of bars"),
    ],
)
def test_what_is_spoiled_on_a_weak_bar_is_found(comm: MPI.Intracomm, what: str, name: str) -> None:
    """Beside bars with more than a million times its force."""
    solver = masts(comm)
    scene = solver.scene
    bar = next(bar for bar in scene.bars if bar.name == "hanger 5.0")
    strongest = max(abs(other.force) for other in scene.bars)
    assert 0.0 < abs(bar.force) < 1e-6 * strongest
    assert names(checked(solver)) == set()

    def spoil() -> None:
        if what == "end":
            bar.update(points=bar.points + np.array([[0.0, 0.0, 1e-6], [0.0, 0.0, 0.0]]))
        elif what == "force":
            bar.update(L0=bar.length - 0.99 * (bar.length - bar.L0))
        else:
            assert solver.system.bars is not None
            blocks = solver.system.bars.blocks
            block = blocks.block("top 5.0") if comm.rank == 0 else -1
            moved(solver, block, np.array([0.0, 0.0, 1e-2 * (bar.length - bar.L0)]))

    found = checked(solver, spoil)
    assert name in names(found)
    assert "5.0" in found[name].where


def rigid_cylinder(comm: MPI.Intracomm) -> Solver:
    """A soft cable with friction along an oblique geodesic of a cylinder that nothing bends."""
    R, n = 10.0, 12
    x, z = np.meshgrid(np.linspace(0.0, 15.0, n + 1), np.linspace(0.0, 8.0, n + 1), indexing="ij")
    x += 0.3 * np.sin(7.0 * z) * (x > 0.0) * (x < 15.0)
    points = np.stack([R * np.cos(x / R), R * np.sin(x / R), z], axis=-1).reshape(-1, 3)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = np.concatenate(
        [np.stack([a, a + n + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + 1], 1)]
    )
    mesh = meshes.from_arrays(comm, points, cells)
    scene = Scene(mesh, IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0, wrinkling=False))
    scene.fix(lambda at: np.full(at.shape[1], True))
    t = np.linspace(0.0, 15.0, 60)
    route = np.stack([R * np.cos(t / R), R * np.sin(t / R), 2.1 + 0.25 * t], axis=-1)
    cable = scene.lay_cable(Cable(EA=1.0, friction=0.1), route)
    solver = Solver(scene)
    solver.advance(L0={cable: 0.99 * cable.length})
    return solver


def test_a_cable_at_a_vertex_of_a_rigid_cylinder_is_found(comm: MPI.Intracomm) -> None:
    """It would slide off; the membrane's stiffness, 1e8 of its tension, makes it no smaller."""
    solver = rigid_cylinder(comm)
    scene = solver.scene
    cable = scene.cables[0]
    assert names(checked(solver)) == set()
    own = np.linalg.norm(cable.tension * np.diff(cable.positions, axis=0)[0])
    assert solver.steps[-1].outcome.residual < 1e-3 * own

    def spoil() -> None:
        k = pressing(cable)
        vertex = cable.nodes[k].support[int(cable.fractions[k] > 0.5)]
        shape = scene.net.strip_shape()
        for m in cable.path_nodes():
            support = cable.nodes[m].support
            if cable.nodes[m].kind == "fold" and vertex in support:
                ends = shape.current[np.searchsorted(shape.strip.vertices, support)]
                s = 0.003 if support[0] == vertex else 0.997
                put(cable, "fractions", m, s)
                put(cable, "positions", m, (1 - s) * ends[0] + s * ends[1])

    found = checked(solver, spoil)
    assert "friction beyond its bound" in names(found)
    assert found["held by vertices"].value > 0.005  # of all with which the cable presses
