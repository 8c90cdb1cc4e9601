"""Friction of cables that take lines of the mesh along, against sideways sliding.

On rigid surfaces the cable's curve is known by a formula, see `rigid_surfaces`; a square under
pressure, whose cable is tightened and let go, shows what is lost and kept.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from rigid_rows import rigid_row
from rigid_surfaces import SURFACES, Curve, curve, sphere
from scipy.integrate import simpson

from crms_fenicsx import (
    Cable,
    Friction,
    InputError,
    IsotropicMembrane,
    LaidCable,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.steps.step_record import Step
from crms_fenicsx.analysis.verification.cable_forces import forces
from crms_fenicsx.cabling.contact.contact_force import contact_forces, held_nodes, wrap_angles
from crms_fenicsx.cabling.friction.slip import NodeSlips, node_slips

H = 0.1
pytestmark = pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
MESHES: list[dict[str, Any]] = [
    {},
    {"seed": 1},
    {"diagonals": "one way"},
    {"seed": 2, "diagonals": "one way", "width": 3.0},
]
"""Even and uneven rows; on cells that are all alike the mean of their normals would be off the
surface to the same side everywhere, by enough to be some percent of the sideways pull."""


def way_on(name: str) -> Curve:
    """A curve of constant ratio of geodesic to normal curvature."""
    if name == "sphere":
        return curve(sphere(np.radians(20.0)), float(np.tan(np.radians(20.0))), 0.8)
    return curve(SURFACES["cylinder"], 0.5, 0.8)


def tightened(
    comm: MPI.Intracomm, way: Curve, friction: float | Friction, L: float | None = None,
    strain: float = 0.01, h: float = H, **choices: Any,
) -> tuple[Scene, LaidCable, Step]:  # fmt: skip
    """A cable on a line along a curve, tightened in one step by a strain of its length, or of L."""
    scene, cable = rigid_row(comm, way, friction, h, **choices)
    length = cable.length if L is None else L
    step = Solver(scene).advance(L0={cable: length * (1 - strain)})
    return scene, cable, step


def slips_of(scene: Scene, cable: LaidCable) -> NodeSlips:
    """Remaining elastic slips after a load step."""
    assert cable.state.law.lateral is not None
    return node_slips(cable, cable.state.law.lateral.curve, scene.net.strip_shape())


def mobilised(scene: Scene, cable: LaidCable) -> float:
    """Share of the vertices where friction is fully mobilised after a load step."""
    friction, slips = cable.cable.sideways, slips_of(scene, cable)
    assert friction is not None
    eps = friction.tolerance * slips.size
    return float(np.mean(np.abs(slips.slip) >= eps * (1 - 1e-9)))


@pytest.mark.ranks
@pytest.mark.parametrize("name", ["sphere", "cylinder"])
@pytest.mark.parametrize("choices", MESHES)
def test_a_row_slides_as_far_as_friction_lets_it(
    comm: MPI.Intracomm, name: str, choices: dict[str, Any]
) -> None:
    """In one step onto the curve of ratio mu between the same ends, half a cell away."""
    way = way_on(name)
    mu = 0.85 * way.ratio
    scene, cable, step = tightened(comm, way, mu, L=way.slid(mu).length, **choices)
    assert way.coefficient_of(cable.state.positions) == pytest.approx(mu, rel=0.006)
    assert np.abs(way.sideways(cable.state.positions)).max() > 0.15 * H
    assert step.halvings == 0 and step.outcome.passes <= 8
    assert scene.dissipated > 0.0


@pytest.mark.parametrize("name", ["sphere", "cylinder"])
@pytest.mark.parametrize("diagonals", ["alternating", "one way"])
def test_threshold(comm: MPI.Intracomm, name: str, diagonals: str) -> None:
    """A row slides at a coefficient 1/500 below the curve's ratio, and no vertex as much above."""
    way = way_on(name)
    for share in (0.998, 1.002):
        friction = Friction(share * way.ratio, tolerance=1e-3)
        scene, cable, _ = tightened(comm, way, friction, h=H / 2, diagonals=diagonals)
        assert mobilised(scene, cable) > 0.7 if share < 1.0 else mobilised(scene, cable) == 0.0


@pytest.mark.parametrize("mu", [0.8, 0.76])
def test_static_and_kinetic_friction(comm: MPI.Intracomm, mu: float) -> None:
    """It holds up to the static threshold; what slides ends where kinetic friction holds it."""
    way = way_on("cylinder")
    L = way.slid(0.76 * way.ratio).length
    for static, slides in ((1.02, False), (0.88, True)):
        friction = Friction(mu * way.ratio, static=static * way.ratio)
        _, cable, _ = tightened(comm, way, friction, L=L)
        found = way.coefficient_of(cable.state.positions) / way.ratio
        assert found == pytest.approx(mu if slides else 1.0, rel=0.01)


@pytest.mark.ranks
def test_friction_along_and_cone(comm: MPI.Intracomm) -> None:
    """A cable pulled at its last end while it slides sideways: tensions within the capstan law,
    with the cone both forces within an ellipse."""
    way = way_on("cylinder")
    for cone in (False, True):
        friction = Friction(0.8 * way.ratio, along=0.8 * way.ratio, cone=cone)
        scene, cable, _ = tightened(comm, way, friction, strain=0.02)
        shape = scene.net.strip_shape()
        nodes = [k for k in held_nodes(cable) if wrap_angles(cable, shape)[k] > 0.0]
        at = np.searchsorted(cable.contacts(), nodes)
        ratio = np.log(cable.part_tensions[at] / cable.part_tensions[at - 1])
        along = np.abs(ratio) / (0.8 * way.ratio * wrap_angles(cable, shape)[nodes])
        forces = contact_forces(cable, shape).at(nodes)
        aside = np.abs(forces.lateral) / (0.8 * way.ratio * forces.bearing)
        most = np.hypot(along, aside) if cone else np.maximum(along, aside)
        assert most.max() == pytest.approx(1.0, abs=0.02)
        assert aside.max() > 0.5 and along.max() > 0.1


def test_other_units(comm: MPI.Intracomm) -> None:
    """Millimetres instead of metres, kilonewtons instead of newtons."""
    way = way_on("cylinder")
    found = []
    for length, force in ((1.0, 1.0), (1e3, 1e-3)):
        scene, cable = rigid_row(comm, way, 0.85 * way.ratio, H, EA=force, units=(length, force))
        Solver(scene).advance(L0={cable: 0.98 * cable.length})
        found.append(cable.state.positions / length)
        found.append(np.array([cable.tension / force, scene.dissipated / (force * length)]))
    np.testing.assert_allclose(found[2], found[0], rtol=0, atol=1e-7)
    np.testing.assert_allclose(found[3], found[1], rtol=1e-5)


def square(comm: MPI.Intracomm, friction: float | Friction = 0.1, **choices: Any) -> Any:
    """A square under pressure with a cable along a line, not tight yet."""
    line = {"A1": [(0.0, 30.0), (100.0, 30.0)]}
    mesh = meshes.along(meshes.rectangle(comm, 100.0, 100.0, 10.0), line)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    given = {"hold": "outside", **choices}
    slide = given.pop("slide", True)
    cable = scene.lay_cable(Cable(EA=32000.0, friction=friction), along="A1", L0=102.0, **given)
    solver = Solver(scene, slide=slide)
    solver.advance(pressure=0.01)
    return scene, cable, solver


def aside(cable: LaidCable) -> float:
    """Distance of the stress-free row from the edge, in the middle (length)."""
    places = cable.reference_positions
    places = places[np.argsort(places[:, 0])]
    return float(np.interp(50.0, places[:, 0], places[:, 1]))


@pytest.mark.ranks
def test_what_friction_takes_is_missing_in_the_energy(comm: MPI.Intracomm) -> None:
    """Tightened in steps, the total energy grows by what shortening the cable puts in, T + T^2/(2
    EA) per length, less what friction dissipates. In each step this counts with the forces at its
    end, 3 % more than those in between."""
    scene, cable, solver = square(comm, Friction(0.1, tolerance=3e-4))
    solver.advance(L0={cable: 101.0})
    energy, before = scene.energy, scene.dissipated
    lengths, pulls = np.linspace(101.0, 98.5, 17), []
    for L0 in lengths:
        if L0 < 101.0:
            solver.advance(L0={cable: float(L0)})
        pulls.append(cable.tension + cable.tension**2 / 64000.0)
    spent, lost = simpson(pulls, x=-lengths), scene.dissipated - before
    assert spent - (scene.energy - energy) == pytest.approx(lost, rel=0.05)
    assert lost > 0.5


def test_a_row_sticks_as_its_load_turns(comm: MPI.Intracomm) -> None:
    """A force on the fabric across it makes it slide; small changes leave it, and it slides back
    when the force has turned."""
    scene, cable, solver = square(comm, Friction(0.1, tolerance=1e-3))
    scene.put_load((0.0, 1.0, 0.0), name="push")
    eps = 0.001 * 14.0

    def pushed(force: float) -> float:
        solver.advance(L0={cable: 99.0}, load={"push": force})
        return aside(cable)

    start, far = pushed(0.0), pushed(0.01)
    lost = scene.dissipated
    assert far < start - 5 * eps
    places = [pushed(force) for force in [0.009, 0.01] * 3]
    assert np.abs(np.array(places) - far).max() < eps
    assert np.ptp(places[1::2]) < 1e-3 * eps
    assert scene.dissipated - lost < 1e-5 * lost
    assert pushed(-0.03) > far + 5 * eps
    assert scene.dissipated > 1.2 * lost


@pytest.mark.parametrize("choices", [{"hold": "pocket"}, {"slide": False}])
def test_rows_that_are_held_have_no_friction(comm: MPI.Intracomm, choices: dict[str, Any]) -> None:
    places = []
    for friction in (0.0, 0.1):
        scene, cable, solver = square(comm, friction, **choices)
        solver.advance(L0={cable: 100.0})
        assert scene.dissipated == 0.0 and cable.state.law.lateral is None
        places.append(cable.state.positions)
    np.testing.assert_array_equal(*places)
    assert aside(cable) == pytest.approx(30.0, abs=1e-9)


def test_the_papers_friction_is_refused_along_lines(comm: MPI.Intracomm) -> None:
    with pytest.raises(InputError, match='"coulomb", or lay it by its path'):
        square(comm, Friction(0.1, law="step"))
    square(comm, Friction(0.1, law="step"), hold="pocket")


def test_verification_finds_friction_beyond_its_bound(comm: MPI.Intracomm) -> None:
    """Of a row held by more than its law gives, as by an error in the bounds."""
    scene, cable, solver = square(comm)
    solver.advance(L0={cable: 99.0})
    shape, name = scene.net.strip_shape(), "friction beyond its bound"
    found = contact_forces(cable, shape).at(held_nodes(cable))
    some = found.bearing > 0.0
    share = np.abs(found.lateral[some]) / (0.1 * found.bearing[some])
    assert 0.95 < share.max() < 1.05
    assert forces(cable, shape, 0.0, None)[name] < 0.02
    cable.update(cable=Cable(EA=32000.0, friction=0.05))
    assert forces(cable, shape, 0.0, None)[name] > 0.1


@pytest.mark.ranks
def test_each_row_has_its_own_slip_where_two_cross(comm: MPI.Intracomm) -> None:
    """Energy as above, of two oblique cables whose common vertex shifts in both directions. Without
    friction it errs by a tenth of what is lost here, by the motion of the coarse mesh."""
    lines = {"A1": [(0.0, 25.0), (100.0, 40.0)], "B1": [(30.0, 0.0), (20.0, 100.0)]}
    mesh = meshes.along(meshes.rectangle(comm, 100.0, 100.0, 10.0), lines)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    rope = Cable(EA=32000.0, friction=Friction(0.1, tolerance=3e-4))
    cables = [scene.lay_cable(rope, along=name, tension=1.0) for name in lines]
    solver, first = Solver(scene), np.array([cable.L0 for cable in cables])
    solver.advance(pressure=0.01)
    energy, before, pulls = scene.energy, scene.dissipated, []
    for share in np.linspace(0.0, 0.04, 17):
        if share > 0.0:
            lengths = (1 - share) * first
            solver.advance(L0=dict(zip(cables, map(float, lengths), strict=True)))
        tensions = np.array([cable.tension for cable in cables])
        pulls.append(first @ (tensions + tensions**2 / 64000.0))
    spent, lost = simpson(pulls, dx=0.0025), scene.dissipated - before
    assert spent - (scene.energy - energy) == pytest.approx(lost, rel=0.16)
    assert min(cable.dissipated for cable in cables) > 0.15


@pytest.mark.ranks
def test_history_of_a_row_comes_back_with_its_state(comm: MPI.Intracomm) -> None:
    """Restored to a state and loaded again, it slides as it did."""
    scene, cable, solver = square(comm)
    solver.advance(L0={cable: 100.0})
    known = solver.snapshot()
    found = []
    for _ in range(2):
        solver.advance(L0={cable: 98.0})
        found.append((cable.reference_positions, cable.tension, scene.dissipated))
        solver.restore(known)
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=0, atol=1e-5)
    assert found[0][1:] == pytest.approx(found[1][1:], rel=1e-5)
