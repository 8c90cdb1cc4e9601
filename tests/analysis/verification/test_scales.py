"""Each check is relative to what it checks: it sees what is spoiled on a weak part of a scene."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import advanced, put
from grids import numbered, triangles
from mpi4py import MPI
from spoilt_states import (
    SCENES,
    alarms,
    cabled,
    checked,
    masts,
    middle_vertex,
    moved,
    names,
    own_block,
    pressing,
)

from crms_fenicsx import Cable, Friction, IsotropicMembrane, Scene, Solver, meshes

pytestmark = pytest.mark.usefixtures("comm")


@pytest.mark.ranks
@pytest.mark.parametrize("name", SCENES)
def test_sound_states_raise_no_alarm(comm: MPI.Intracomm, name: str) -> None:
    """Whichever part is weak beside the others, with and without friction."""
    for friction in (0.0, 0.3, Friction(0.3, along=0.3)):
        assert alarms(cabled(comm, name, friction)) == set()


SPOILT = {
    "tension": "tension against length",
    "length": "tension against length",
    "contact": "tension against length",
    "end": "ends of cables off their place",
    "place": "nodes off their edges",
    "slid": "unbalanced forces of cables",
    "lifted out": "unbalanced forces of cables",
    "vertex": "unbalanced forces of the membrane",
}


@pytest.mark.ranks
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
            put(cable, "positions", 0, cable.state.positions[0] + 1e-6 * cable.length)
        elif what == "place":
            put(cable, "positions", k, cable.state.positions[k] + 1e-4)
        elif what == "slid":  # by .01 of the cells, along the edge
            edge = cable.state.positions[k + 1] - cable.state.positions[k - 1]
            side = np.cross(edge, [0.0, 0.0, 1.0]) / np.linalg.norm(edge)
            moved(solver, own_block(solver, k), 0.15 * side)
        elif what == "lifted out":
            span = np.linalg.norm(cable.state.positions[k + 1] - cable.state.positions[k - 1])
            moved(solver, own_block(solver, k), np.array([0.0, 0.0, 1e-3 * span]))
        elif what == "vertex":
            z = scene.comm.allreduce(float(np.abs(scene.u.x.array).max(initial=0)), op=MPI.MAX)
            moved(solver, middle_vertex(solver), np.array([0.0, 0.0, 0.01 * z]))

    assert SPOILT[what] in names(checked(solver, spoil))


@pytest.mark.ranks
@pytest.mark.parametrize("E", [1.0, 100.0, 1e6])
@pytest.mark.parametrize(
    ("what", "name"),
    [
        ("end", "ends of bars off their place"),
        ("force", "forces of bars"),
        ("joint", "unbalanced forces of bars"),
    ],
)
def test_what_is_spoiled_on_a_weak_bar_is_found(
    comm: MPI.Intracomm, what: str, name: str, E: float
) -> None:
    """Beside bars with more than a million times its force."""
    solver = masts(comm, E)
    scene = solver.scene
    bar = next(bar for bar in scene.bars if bar.name == "hanger 5.0")
    strongest = max(abs(other.force) for other in scene.bars)
    assert 0.0 < abs(bar.force) < 1e-6 * strongest
    assert alarms(solver) == set()

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
    mesh = meshes.from_arrays(comm, points, triangles(numbered(*x.shape)))
    scene = Scene(mesh, IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0, wrinkling=False))
    scene.fix(lambda at: np.full(at.shape[1], True))
    t = np.linspace(0.0, 15.0, 60)
    route = np.stack([R * np.cos(t / R), R * np.sin(t / R), 2.1 + 0.25 * t], axis=-1)
    cable = scene.lay_cable(Cable(EA=1.0, friction=0.1), route)
    return advanced(Solver(scene), L0={cable: 0.99 * cable.length})


def test_a_cable_at_a_vertex_of_a_rigid_cylinder_is_found(comm: MPI.Intracomm) -> None:
    """It would slide off; the membrane's stiffness, 1e8 of its tension, makes it no smaller."""
    solver = rigid_cylinder(comm)
    scene = solver.scene
    cable = scene.cables[0]
    assert alarms(solver) == set()
    own = np.linalg.norm(cable.tension * np.diff(cable.state.positions, axis=0)[0])
    assert solver.steps[-1].outcome.residual < 1e-3 * own

    def spoil() -> None:
        k = pressing(cable)
        vertex = cable.state.nodes[k].support[int(cable.state.fractions[k] > 0.5)]
        shape = scene.net.strip_shape()
        for m in cable.path_nodes():
            support = cable.state.nodes[m].support
            if cable.state.nodes[m].kind == "fold" and vertex in support:
                ends = shape.current[np.searchsorted(shape.strip.vertices, support)]
                s = 0.003 if support[0] == vertex else 0.997
                put(cable, "fractions", m, s)
                put(cable, "positions", m, (1 - s) * ends[0] + s * ends[1])

    found = checked(solver, spoil)
    assert "friction beyond its bound" in names(found)
    assert found["held by vertices"].value > 0.005  # of all with which the cable presses
