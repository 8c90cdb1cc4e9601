"""What foundations bear: the membrane with all cable ends and bars that meet there, each part once,
in balance with the loads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from numpy.testing import assert_allclose
from report_page import read_csv

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.foundations import Foundations, foundations, partition

pytestmark = pytest.mark.ranks

SIDE, SNOW, LAMP = 8.0, 0.2, 0.7


def cloth(comm: MPI.Intracomm) -> Scene:
    """A square with named corners and edges, held nowhere."""
    mesh = meshes.polygon(
        comm, [(0.0, 0.0), (SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE)], size=2.0,
        names=["south", "east", "north", "west"],
    )  # fmt: skip
    return Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=2.0))


def sail(comm: MPI.Intracomm) -> Solver:
    """A sail: three corners held, with edge cables, the fourth on a mast and guys, under snow.

    A guy ends at the first corner, too, and a hanger with a lamp at the mast's foot.
    """
    scene = cloth(comm)
    for corner in ("corner 1", "corner 2", "corner 3"):
        scene.fix(corner)
    ends = {1: (0.0, 0.0, 0.0), 2: (SIDE, 0.0, 0.0), 3: (SIDE, SIDE, 0.0), 4: (0.0, SIDE, 0.0)}
    for name, a, b in (("south", 1, 2), ("east", 2, 3), ("north", 3, 4), ("west", 4, 1)):
        scene.lay_cable(Cable(EA=2e3), [ends[a], ends[b]], hold="sleeve", tension=10.0, name=name)
    foot, top = (-0.5, SIDE + 0.5, -5.0), "corner 4"
    scene.add_bar(Bar(EA=1e5), foot, top, name="mast")
    for k, place in enumerate([(-7.0, SIDE, -5.0), (0.0, SIDE + 7.0, -5.0)], 1):
        scene.add_bar(Bar(EA=2e4, tension_only=True), top, place, name=f"guy {k}")
    scene.add_bar(
        Bar(EA=2e3, tension_only=True), "corner 1", (-1.0, -1.0, -3.0), L0=3.2, name="tie"
    )
    held = scene.add_joint(ends[2], held="xyz", name="bracket")
    lamp = scene.add_joint((SIDE, 0.0, -1.0), name="lamp")
    scene.add_bar(Bar(EA=1e3), held, lamp, name="rod")
    scene.add_bar(Bar(EA=1e3, tension_only=True), lamp, foot, L0=9.0, name="stay")
    scene.put_joint_load({lamp: (0.0, 0.0, -LAMP)}, name="lamp")
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    return advanced(Solver(scene), load={"lamp": 1.0, "snow": 1.0})


PLACES = {
    "corner 1": (0.0, 0.0, 0.0),
    "bracket": (SIDE, 0.0, 0.0),
    "corner 3": (SIDE, SIDE, 0.0),
    "start of mast": (-0.5, SIDE + 0.5, -5.0),
    "end of guy 1": (-7.0, SIDE, -5.0),
    "end of guy 2": (0.0, SIDE + 7.0, -5.0),
    "end of tie": (-1.0, -1.0, -3.0),
}
PARTS = {
    "corner 1": {"south start", "west end", "tie"},
    "bracket": {"south end", "east start", "rod"},
    "corner 3": {"east end", "north start"},
    "start of mast": {"mast", "stay"},
    "end of guy 1": {"guy 1"},
    "end of guy 2": {"guy 2"},
    "end of tie": {"tie"},
}


def test_all_that_meets_at_a_place_balances_the_loads(comm: MPI.Intracomm) -> None:
    """Forces, and their moments about the origin, so that each part is at its place."""
    solver = sail(comm)
    scene = solver.scene
    found = {place: solver.reactions(place) for place in PLACES}
    assert {place: set(one.parts) for place, one in found.items()} == PARTS
    forces = np.array([one.total for one in found.values()])
    assert_allclose(forces.sum(axis=0), (0.0, 0.0, SNOW * SIDE**2 + LAMP), rtol=0, atol=1e-8)
    lamp = scene.joint("lamp").position
    snow, x = scene.load("snow").forces, scene.positions()
    loads = comm.allreduce(np.cross(x, snow).sum(axis=0)) + np.cross(lamp, (0.0, 0.0, -LAMP))
    moments = np.cross(list(PLACES.values()), forces).sum(axis=0) + loads
    assert_allclose(moments, 0.0, atol=1e-7)
    for one in found.values():
        parts = np.sum([one.membrane, *one.parts.values()], axis=0)
        assert_allclose(parts, one.total, atol=1e-12)
    # each part is what its cable or bar pulls with, at a vertex or at a joint
    corner = found["corner 1"]
    assert scene.bar("tie").force > 1.0
    assert np.linalg.norm(corner.parts["tie"]) == pytest.approx(scene.bar("tie").force)
    assert_allclose(found["end of tie"].total, -corner.parts["tie"], atol=1e-12)
    south = scene.cable("south").start.reaction
    assert_allclose(corner.parts["south start"], south, atol=1e-12)
    fabric = comm.allreduce(corner.forces.sum(axis=0)) - corner.parts["tie"]
    assert_allclose(corner.membrane, fabric, atol=1e-12)
    same = solver.reactions("corner 2").total  # the bracket is there
    assert_allclose(same, found["bracket"].total, atol=1e-12)
    free = solver.reactions("corner 4")
    assert_allclose(free.total, 0.0, atol=1e-12)
    assert comm.allreduce(len(corner.forces)) == 1
    with pytest.raises(InputError, match=r"held joint 'lamp'; there are .*bracket"):
        solver.reactions("lamp")


def test_summary_and_report_have_them(comm: MPI.Intracomm, folder: Path) -> None:
    solver = sail(comm)
    supports = solver.summary().supports
    for corner in ("corner 1", "corner 2", "corner 3"):
        one, due = supports[corner], solver.reactions(corner)
        assert_allclose(one.total, due.total, atol=1e-12)
        assert_allclose(one.membrane, due.membrane, atol=1e-12)
        assert set(one.parts) == set(due.parts)
    assert solver.summary().reaction == supports["all supports"].total
    assert_allclose(solver.summary().reaction, (0.0, 0.0, SNOW * SIDE**2 + LAMP), rtol=0, atol=1e-8)
    solver.report(folder / "sail.html", pictures=[])
    comm.barrier()
    rows = {(row["Support"], row["On"]): row for row in read_csv(folder / "sail_supports.csv")}
    total = [float(rows["corner 1", "everything attached"][f"R{x}"]) for x in "xyz"]
    assert_allclose(total, supports["corner 1"].total, rtol=1e-9)
    south = [float(rows["corner 1", "south start"][f"R{x}"]) for x in "xyz"]
    assert_allclose(south, supports["corner 1"].parts["south start"], rtol=1e-9)
    sums = rows["supports, anchors and held joints", "everything attached"]
    assert float(sums["Rz"]) == pytest.approx(SNOW * SIDE**2 + LAMP, abs=1e-8)


def found_in(solver: Solver) -> Foundations:
    return foundations(solver.system)


def pneu(comm: MPI.Intracomm) -> Solver:
    """A cushion held along its rim, under air, snow and wind, with two cables from one anchor."""
    mesh = meshes.rectangle(comm, SIDE, SIDE, 1.0, structured=True)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    scene.put_wind(0.2, lambda x, n: np.where(x[0] < 3.0, 0.5, -0.9))
    solver = advanced(Solver(scene), pressure=0.6)
    for name, end in (("A", (SIDE, 2.5, 0.0)), ("B", (SIDE, 5.5, 0.0))):
        scene.lay_cable(Cable(EA=2e3), [(0.0, 4.2, 0.0), end], tension=6.0, name=name)
    solver.advance(load={"snow": 1.0, "wind": 1.0})
    return solver


def test_a_rim_with_cables(comm: MPI.Intracomm) -> None:
    """Wind on cells that cables fold has a resultant, too."""
    solver = pneu(comm)
    found = found_in(solver)
    assert found.unbalanced < 1e-8
    assert set(found.loads) == {"snow", "wind", "pressure"}
    plan = SIDE**2
    assert_allclose(found.loads["pressure"], (0.0, 0.0, 0.6 * plan), atol=1e-9)
    assert found.loads["snow"][2] == pytest.approx(-SNOW * plan)
    assert [one.name for one in found.lines] == ["boundary"]  # and not its four sides again
    ends = {one.members: one for one in found.points}
    assert set(ends) == {("A start", "B start"), ("A end",), ("B end",)}
    cables = solver.cable_forces()
    both = np.add(cables["A"].start, cables["B"].start)  # type: ignore[arg-type]
    assert_allclose(ends["A start", "B start"].force, -both, atol=1e-12)
    assert_allclose(found.total, -np.array(solver.summary().reaction), atol=1e-9)
    # the diagram along the rim has the line's force: half of each edge by each of its ends
    lengths = np.linalg.norm(np.diff(found.rim, axis=1)[:, 0], axis=1)
    along = (lengths[:, None, None] / 2 * found.per_length).sum(axis=(0, 1))
    assert_allclose(along, found.lines[0].force, atol=1e-9)
    assert found.lines[0].length == pytest.approx(4 * SIDE)
    assert len(found.rim) == 4 * SIDE


def test_corners_with_bars_and_guys(comm: MPI.Intracomm) -> None:
    """At a held corner the membrane, a guy and an anchor meet; a mast stands elsewhere."""
    scene = cloth(comm)
    for k in (1, 2, 3):
        scene.fix(f"corner {k}")
    scene.lay_cable(
        Cable(EA=2e3), [(0.0, 0.0, 0.0), (SIDE, 0.0, 0.0)], hold="sleeve", tension=9.0, name="south"
    )
    scene.add_bar(Bar(EA=1e5), (-0.5, SIDE + 0.5, -5.0), "corner 4", name="mast")
    scene.add_bar(Bar(EA=2e4), "corner 4", (-6.0, SIDE + 6.0, -5.0), name="guy")
    scene.add_bar(Bar(EA=2e3), "corner 1", (-1.0, -1.0, -3.0), L0=3.2, name="tie")
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    solver = advanced(Solver(scene, stability="ignore"), load={"snow": 1.0})
    found = found_in(solver)
    assert found.unbalanced < 1e-8
    assert found.lines == ()
    assert {frozenset(one.members) for one in found.points} == {
        frozenset(x) for x in (
            ("corner 1", "south start", "tie"), ("corner 2", "south end"), ("corner 3",),
            ("mast",), ("guy",), ("tie",),
        )
    }  # fmt: skip
    for one in found.points:
        for name in {"corner 1", "corner 2", "corner 3"} & set(one.members):
            assert_allclose(one.force, -solver.reactions(name).total, atol=1e-12)
    assert next(one.joints for one in found.points if one.members == ("mast",)) == (
        "start of mast",
    )


def test_a_floor_bears_its_part(comm: MPI.Intracomm) -> None:
    mesh = meshes.rectangle(comm, SIDE, SIDE, 1.0, structured=True)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=1.0))
    scene.floor(-0.2)
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    solver = advanced(Solver(scene), load={"snow": 1.0})
    found = found_in(solver)
    assert found.loads["floor"][2] > 0.1 * SNOW * SIDE**2
    assert found.total[2] == pytest.approx(-SNOW * SIDE**2 + found.loads["floor"][2])


def test_each_held_vertex_is_in_one_group(comm: MPI.Intracomm) -> None:
    mesh = meshes.rectangle(comm, SIDE, SIDE, 2.0, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    for name in ("left", "front"):
        scene.fix(name)
    scene.fix(lambda x: np.linalg.norm(x - np.array([[4.0], [4.0], [0.0]]), axis=0) < 1e-9)
    counts = {name: comm.allreduce(len(own)) for name, own in partition(scene).items()}
    assert counts == {"front": 5, "left": 4, "other supports": 1}
