"""What holds a cable on the membrane: pockets keep their line, bonded cables each point."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cabled_square import FOIL, advanced, clamped, sheet
from form_meshes import SIDES
from mpi4py import MPI
from taylor import gradient_order, stiffness_error
from term_scene import displaced

from crms_fenicsx import (
    Bar,
    Cable,
    Friction,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.design.form_finding import FormCable, FoundForm, find_form
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads
from crms_fenicsx.energy.terms.cable_tension import CableTension
from crms_fenicsx.energy.terms.held_line import HeldLine
from crms_fenicsx.model.cable import Hold
from crms_fenicsx.model.laid_cable import LaidCable

ACROSS = [(0.0, 37.0), (100.0, 62.0)]
CORNERS = ["front left", "front right", "back right", "back left"]


def square(
    comm: MPI.Intracomm, n: int = 8, structured: bool = False, material: IsotropicMembrane = FOIL
) -> Scene:
    """A sheet, by default a stress-free foil, held all around."""
    return sheet(comm, n, "structured" if structured else "unstructured", material)


def inflated(scene: Scene, pressure: float = 0.01) -> Solver:
    """The same under pressure."""
    return advanced(Solver(scene, rtol=1e-10), pressure=pressure, steps=2)


def places(cable: LaidCable) -> np.ndarray:
    """Where its points are on their edges; NaN on vertices."""
    return np.array(cable.state.fractions)


@pytest.mark.ranks
@pytest.mark.parametrize("hold", ["pocket", "bonded"])
def test_it_stays_on_its_line(comm: MPI.Intracomm, hold: str) -> None:
    """On the edges and at the places where it was laid; a free one slides."""
    moved = {}
    for one in ("outside", hold):
        scene = square(comm)
        cable = scene.lay_cable(Cable(3000.0), [(0.0, 30.0), (100.0, 30.0)], hold=one, tension=1.0)
        before = {
            node.point and node.support: place
            for node, place in zip(cable.state.nodes, places(cable), strict=True)
        }
        inflated(scene)
        after = {
            node.point and node.support: place
            for node, place in zip(cable.state.nodes, places(cable), strict=True)
        }
        same = [key for key in before if key in after]
        moved[one] = np.nanmax([abs(after[key] - before[key]) for key in same])
        assert one == "outside" or len(same) == len(before)
    assert moved[hold] < 1e-3 < 0.01 < moved["outside"]


@pytest.mark.ranks
def test_a_bonded_cable_on_mesh_lines_is_a_row_of_bars(comm: MPI.Intracomm) -> None:
    """From vertex to vertex; to rounding, forces and all."""
    line = [(12.5 * k, 37.5, 0.0) for k in range(9)]
    bonded, barred = square(comm, structured=True), square(comm, structured=True)
    cable = bonded.lay_cable(Cable(3000.0), line, hold="bonded", tension=2.0)
    inflated(bonded)
    ends = [barred.vertex_at(place) for place in line]
    bars = [
        barred.add_bar(Bar(3000.0, tension_only=True), a, b, L0=12.5 / (1 + 2.0 / 3000.0))
        for a, b in pairwise(ends)
    ]
    inflated(barred)
    assert bonded.energy == pytest.approx(barred.energy, rel=1e-9)
    assert cable.tensions == pytest.approx([bar.force for bar in bars], rel=1e-7)
    assert np.ptp(cable.tensions) > 0.05 * cable.tension


def test_a_bonded_cable_anywhere_tends_to_the_one_on_mesh_lines(comm: MPI.Intracomm) -> None:
    """Along the middle of meshes that have a line there, and of others that do not."""
    energies = {}
    for structured in (True, False):
        for n in (8, 16, 32):
            scene = square(comm, n, structured)
            scene.lay_cable(Cable(3000.0), [(0.0, 50.0), (100.0, 50.0)], hold="bonded", tension=2.0)
            inflated(scene)
            energies[structured, n] = scene.energy
    off = [energies[True, n] / energies[False, n] - 1 for n in (8, 16, 32)]
    assert abs(off[2]) < 1.5e-3 and abs(off[2]) < 0.4 * abs(off[1]) < 0.4 * abs(off[0])


@pytest.mark.ranks
@pytest.mark.parametrize("n", [8, 16])
@pytest.mark.parametrize("structured", [True, False], ids=["on lines", "across cells"])
def test_newton_steps_converge_where_a_bonded_cable_turns_slack(
    comm: MPI.Intracomm, structured: bool, n: int
) -> None:
    """Its strain then is within 1e-3 below that of a taut one. The energy is the sheet's alone."""
    stressed = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0)
    energies = []
    for bonded in (True, False):
        scene = square(comm, n, structured, stressed)
        if bonded:
            cable = scene.lay_cable(Cable(30000.0), [(0, 50), (100, 50)], hold="bonded", L0=100.1)
        solver = advanced(Solver(scene), pressure=0.008)
        if bonded:
            assert cable.tension > 20.0
        outcome = solver.advance(pressure=0.002).outcome
        energies.append(scene.energy)
        if bonded:
            assert cable.tension == 0.0
            assert outcome.factorizations < (18 if structured and n == 16 else 8)
    assert energies[0] == pytest.approx(energies[1], rel=1e-8)


@pytest.mark.ranks
@pytest.mark.parametrize("unit", [1.0, 1000.0])
@pytest.mark.parametrize("hold", ["bonded", "outside", "pocket"])
def test_cables_turn_slack_on_a_nearly_flat_sheet(
    comm: MPI.Intracomm, hold: Hold, unit: float
) -> None:
    """There the points of a slack cable hardly resist. The energy is the sheet's alone."""
    energies = []
    for with_cable in (True, False):
        mesh = meshes.rectangle(comm, 7.3 * unit, 5.1 * unit, 0.7 * unit)
        scene = clamped(mesh, IsotropicMembrane(300.0, 0.25, 1.0, prestress=1.0))
        if with_cable:
            ends = [(0.0, 2.3 * unit), (7.3 * unit, 2.9 * unit)]
            L0 = 1.0005 * unit * float(np.hypot(7.3, 0.6))
            cable = scene.lay_cable(Cable(3e4 * unit), ends, hold=hold, L0=L0)
        solver = Solver(scene)
        for taut, slack in ((0.05, 0.004), (0.1, 0.001)):
            solver.advance(pressure=taut / unit)
            assert not with_cable or cable.tension > 0.2 * unit
            outcome = solver.advance(pressure=slack / unit).outcome
            if with_cable:
                assert cable.tension == 0.0
                assert outcome.factorizations < 10
            energies.append(scene.energy)
    assert energies[:2] == pytest.approx(energies[2:], rel=1e-6)


@pytest.mark.ranks
@pytest.mark.parametrize("hold", ["bonded", "outside"])
def test_a_slack_cable_has_no_second_derivatives(comm: MPI.Intracomm, hold: Hold) -> None:
    """However near to taut; others have theirs."""
    scene = square(comm)
    for y in (30.0, 50.0, 70.0):
        scene.lay_cable(Cable(3000.0), [(0.0, y), (100.0, y)], hold=hold, tension=1.0)
    system = inflated(scene).system
    (term,) = [t for t in system.potential.terms if isinstance(t, CableTension)]
    f = TermsWithDyads(system.unknowns, scene.u, [term], exact=True)
    x = displaced(f.unknowns, 1.0)
    f.value(x)
    assert term.alone.any() == (hold == "bonded") and not term.alone.all()
    lengths = f.potential.sums_of(term)
    term.L0[:] = lengths * np.where(np.arange(len(lengths)) % 2, 0.99, 1 + 1e-3)
    d = np.random.default_rng(3).normal(size=x.shape)
    assert stiffness_error(f, x, d, h=1e-5) < 2e-6
    f.exact = False  # H0 counts them as taut
    assert stiffness_error(f, x, d, h=1e-5) > 0.1


def test_taylor(comm: MPI.Intracomm) -> None:
    """Gradient and second derivatives of what holds points on their edges."""
    scene = square(comm, 5)
    scene.lay_cable(Cable(3000.0), ACROSS, hold="pocket", tension=1.0)
    system = inflated(scene).system
    (term,) = [t for t in system.potential.terms if isinstance(t, HeldLine)]
    f = TermsWithDyads(system.unknowns, scene.u, [term], exact=True)
    x = displaced(f.unknowns, 1.0)
    d = np.random.default_rng(3).normal(size=x.shape)
    assert gradient_order(f, x, d) > 1.9
    assert stiffness_error(f, x, d, h=1e-5) < 2e-6


@pytest.mark.ranks
def test_friction_along_a_pocket_counts_the_turn_in_the_plane(comm: MPI.Intracomm) -> None:
    """Along an arc on a flat, rigid sheet: T2/T1 = exp(mu angle), on cells that ignore the arc."""
    mu, angle = 0.4, np.pi / 2
    scene = Scene(
        meshes.rectangle(comm, 100.0, 100.0, size=5.0),
        IsotropicMembrane(E=1e6, nu=0.0, thickness=1.0, wrinkling=False),
    )
    scene.fix(lambda x: np.full(x.shape[1], True))
    t = np.linspace(0.0, angle, 40)
    arc = np.column_stack([10 + 60 * np.sin(t), 90 - 60 * np.cos(t), 0 * t])
    path = np.vstack([(-10.0, 30.0, 0.0), (0.0, 30.0, 0.0), arc, (70.0, 100.0, 0.0),
                      (70.0, 110.0, 0.0)])  # fmt: skip
    cable = scene.lay_cable(
        Cable(1e4, friction=Friction(0.3, along=mu)), path, hold="pocket", tension=5.0
    )
    solver = advanced(Solver(scene))
    solver.advance(move={cable.end: (0.0, 3.0, 0.0)}, steps=2)
    assert cable.tensions[-1] / cable.tensions[0] == pytest.approx(np.exp(mu * angle), rel=1e-2)


def hypar(comm: MPI.Intracomm, size: float, **how: object) -> FoundForm:
    """Inputs of the round robin of P. D. Gosling et al., Engineering Structures 48, 2013."""
    return find_form(
        meshes.rectangle(comm, 6.0, 6.0, size), 3.0, fixed=CORNERS, warp=(1.0, 1.0, 0.0),
        lifted={"front left": (0.0, 0.0, 2.0), "back right": (0.0, 0.0, 2.0)},
        cables=[FormCable(side, tension=30.0, **how) for side in SIDES],
    )  # fmt: skip


def snowed(found: FoundForm, **given: object) -> Solver:
    """The same under snow, its cables of 12 mm."""
    fabric = OrthotropicMembrane(600.0, 600.0, 30.0, 0.4, thickness=1.0, warp=(1.0, 1.0, 0.0))
    scene = found.scene(fabric, Cable(EA=205.0 * 36 * np.pi), **given)
    solver = advanced(Solver(scene))
    scene.put_load((0.0, 0.0, -0.6), name="snow", per="plan")
    solver.advance(load={"snow": 1.0})
    return solver


@pytest.mark.ranks
def test_bonded_edges_of_a_hypar(comm: MPI.Intracomm) -> None:
    """Against an independent code with triangles and bars; the corners' stresses stay."""
    solver = snowed(hypar(comm, 0.25, hold="bonded"))
    summary, cables = solver.summary(), solver.scene.cables
    assert summary.lowest.value == pytest.approx(-0.0633, rel=0.01)
    forces = np.concatenate([cable.tensions for cable in cables])
    assert forces.min() == pytest.approx(26.46, rel=0.01)
    assert forces.max() == pytest.approx(36.22, rel=0.01)
    assert summary.parts[""].largest["warp"].value == pytest.approx(5.7, abs=0.1)


def test_belts_along_sliding_edge_cables(comm: MPI.Intracomm) -> None:
    """They carry along the edge what sliding cables cannot."""
    found = hypar(comm, 0.5)
    loose, belted = snowed(found), snowed(found, belts=Cable(EA=2000.0))
    largest = [s.summary().parts[""].largest["warp"].value for s in (loose, belted)]
    assert largest[1] < 0.5 * largest[0]
    assert [cable.hold for cable in belted.scene.cables] == 4 * ["pocket"] + 4 * ["bonded"]
    assert belted.scene.cable("belt front").tension > 0.0


def test_checkpoints_keep_what_holds_a_cable(comm: MPI.Intracomm, folder: Path) -> None:
    folder = folder / "state"

    def begun() -> Solver:
        scene = square(comm)
        scene.lay_cable(Cable(3000.0), ACROSS, hold="bonded", tension=1.0)
        return Solver(scene, rtol=1e-10)

    solver, other = begun(), begun()
    solver.advance(pressure=0.01, steps=2)
    solver.save(folder)
    other.load(folder)
    assert other.scene.cables[0].tensions == pytest.approx(solver.scene.cables[0].tensions)
    for one in (solver, other):
        one.advance(pressure=0.015)
    assert other.scene.energy == pytest.approx(solver.scene.energy, rel=1e-10)


def test_bad_holds(comm: MPI.Intracomm) -> None:
    scene = square(comm)
    with pytest.raises(InputError, match="lay_cable: hold = 'glued' is not known"):
        scene.lay_cable(Cable(3000.0), ACROSS, hold="glued")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="bonded, but its law"):
        scene.lay_cable(Cable(3000.0, law="step"), ACROSS, hold="bonded")
    assert not scene.cables
