"""What a foundation bears: the membrane with all cable ends and bars that meet there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from report_page import read_csv

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, Scene, Solver, meshes

pytestmark = pytest.mark.ranks

SIDE, SNOW, LAMP = 8.0, 0.2, 0.7


def sail(comm: MPI.Intracomm) -> Solver:
    """A sail: three corners held, with edge cables, the fourth on a mast and guys, under snow.

    A guy ends at the first corner, too, and a hanger with a lamp at the mast's foot.
    """
    mesh = meshes.polygon(
        comm, [(0.0, 0.0), (SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE)], size=2.0,
        names=["south", "east", "north", "west"],
    )  # fmt: skip
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=2.0))
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
    solver = Solver(scene)
    solver.advance(load={"lamp": 1.0, "snow": 1.0})
    return solver


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
    np.testing.assert_allclose(
        forces.sum(axis=0), (0.0, 0.0, SNOW * SIDE**2 + LAMP), rtol=0, atol=1e-8
    )
    lamp = scene.joint("lamp").position
    snow, x = scene.load("snow").forces, scene.positions()
    loads = comm.allreduce(np.cross(x, snow).sum(axis=0)) + np.cross(lamp, (0.0, 0.0, -LAMP))
    moments = np.cross(list(PLACES.values()), forces).sum(axis=0) + loads
    np.testing.assert_allclose(moments, 0.0, atol=1e-7)
    for one in found.values():
        parts = np.sum([one.membrane, *one.parts.values()], axis=0)
        np.testing.assert_allclose(parts, one.total, atol=1e-12)
    # each part is what its cable or bar pulls with, at a vertex or at a joint
    corner = found["corner 1"]
    assert scene.bar("tie").force > 1.0
    assert np.linalg.norm(corner.parts["tie"]) == pytest.approx(scene.bar("tie").force)
    np.testing.assert_allclose(found["end of tie"].total, -corner.parts["tie"], atol=1e-12)
    south = scene.cable("south").start.reaction
    np.testing.assert_allclose(corner.parts["south start"], south, atol=1e-12)
    fabric = comm.allreduce(corner.forces.sum(axis=0)) - corner.parts["tie"]
    np.testing.assert_allclose(corner.membrane, fabric, atol=1e-12)
    same = solver.reactions("corner 2").total  # the bracket is there
    np.testing.assert_allclose(same, found["bracket"].total, atol=1e-12)
    free = solver.reactions("corner 4")
    np.testing.assert_allclose(free.total, 0.0, atol=1e-12)
    assert comm.allreduce(len(corner.forces)) == 1
    with pytest.raises(InputError, match=r"held joint 'lamp'; there are .*bracket"):
        solver.reactions("lamp")


def test_summary_and_report_have_them(comm: MPI.Intracomm, tmp_path: Path) -> None:
    folder = Path(comm.bcast(str(tmp_path)))
    solver = sail(comm)
    supports = solver.summary().supports
    for corner in ("corner 1", "corner 2", "corner 3"):
        one, due = supports[corner], solver.reactions(corner)
        np.testing.assert_allclose(one.total, due.total, atol=1e-12)
        np.testing.assert_allclose(one.membrane, due.membrane, atol=1e-12)
        assert set(one.parts) == set(due.parts)
    assert solver.summary().reaction == supports["all supports"].total
    np.testing.assert_allclose(
        solver.summary().reaction, (0.0, 0.0, SNOW * SIDE**2 + LAMP), rtol=0, atol=1e-8
    )
    solver.report(folder / "sail.html", pictures=[])
    comm.barrier()
    rows = {(row["Support"], row["On"]): row for row in read_csv(folder / "sail_supports.csv")}
    total = [float(rows["corner 1", "all that meets there"][f"R{x}"]) for x in "xyz"]
    np.testing.assert_allclose(total, supports["corner 1"].total, rtol=1e-9)
    south = [float(rows["corner 1", "south start"][f"R{x}"]) for x in "xyz"]
    np.testing.assert_allclose(south, supports["corner 1"].parts["south start"], rtol=1e-9)
    sums = rows["supports, anchors and held joints", "all that meets there"]
    assert float(sums["Rz"]) == pytest.approx(SNOW * SIDE**2 + LAMP, abs=1e-8)
