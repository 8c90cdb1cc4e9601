"""Forces on foundations: all that holds a scene, each part once, in balance with the loads."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.results.foundations import Foundations, foundations, partition

pytestmark = pytest.mark.ranks

SIDE, SNOW = 8.0, 0.2


def found_in(solver: Solver) -> Foundations:
    return foundations(solver.system)


def pneu(comm: MPI.Intracomm) -> Solver:
    """A cushion held along its rim, under air, snow and wind, with two cables from one anchor."""
    mesh = meshes.rectangle(comm, SIDE, SIDE, 1.0, structured=True)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    scene.put_wind(0.2, lambda x, n: np.where(x[0] < 3.0, 0.5, -0.9))
    solver = Solver(scene)
    solver.advance(pressure=0.6)
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
    np.testing.assert_allclose(found.loads["pressure"], (0.0, 0.0, 0.6 * plan), atol=1e-9)
    assert found.loads["snow"][2] == pytest.approx(-SNOW * plan)
    assert [one.name for one in found.lines] == ["boundary"]  # and not its four sides again
    ends = {one.members: one for one in found.points}
    assert set(ends) == {("A start", "B start"), ("A end",), ("B end",)}
    cables = solver.cable_forces()
    both = np.add(cables["A"].start, cables["B"].start)  # type: ignore[arg-type]
    np.testing.assert_allclose(ends["A start", "B start"].force, -both, atol=1e-12)
    np.testing.assert_allclose(found.total, -np.array(solver.summary().reaction), atol=1e-9)
    # the diagram along the rim has the line's force: half of each edge by each of its ends
    lengths = np.linalg.norm(np.diff(found.rim, axis=1)[:, 0], axis=1)
    along = (lengths[:, None, None] / 2 * found.per_length).sum(axis=(0, 1))
    np.testing.assert_allclose(along, found.lines[0].force, atol=1e-9)
    assert found.lines[0].length == pytest.approx(4 * SIDE)
    assert len(found.rim) == 4 * SIDE


def test_corners_with_bars_and_guys(comm: MPI.Intracomm) -> None:
    """At a held corner the membrane, a guy and an anchor meet; a mast stands elsewhere."""
    mesh = meshes.polygon(
        comm, [(0.0, 0.0), (SIDE, 0.0), (SIDE, SIDE), (0.0, SIDE)], size=2.0,
        names=["south", "east", "north", "west"],
    )  # fmt: skip
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=2.0))
    for k in (1, 2, 3):
        scene.fix(f"corner {k}")
    scene.lay_cable(
        Cable(EA=2e3), [(0.0, 0.0, 0.0), (SIDE, 0.0, 0.0)], hold="sleeve", tension=9.0, name="south"
    )
    scene.add_bar(Bar(EA=1e5), (-0.5, SIDE + 0.5, -5.0), "corner 4", name="mast")
    scene.add_bar(Bar(EA=2e4), "corner 4", (-6.0, SIDE + 6.0, -5.0), name="guy")
    scene.add_bar(Bar(EA=2e3), "corner 1", (-1.0, -1.0, -3.0), L0=3.2, name="tie")
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    solver = Solver(scene, stability="ignore")
    solver.advance(load={"snow": 1.0})
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
            np.testing.assert_allclose(one.force, -solver.reactions(name).total, atol=1e-12)
    assert next(one.joints for one in found.points if one.members == ("mast",)) == (
        "start of mast",
    )


def test_a_floor_bears_its_part(comm: MPI.Intracomm) -> None:
    mesh = meshes.rectangle(comm, SIDE, SIDE, 1.0, structured=True)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=1.0))
    scene.floor(-0.2)
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    solver = Solver(scene)
    solver.advance(load={"snow": 1.0})
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
