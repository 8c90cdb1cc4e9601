"""Clamps: one tension from clamp to clamp, points that stay together, on or off the membrane."""

from __future__ import annotations

import csv
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet
from grids import grid
from taylor import OnMesh, gradient_order, noise
from term_scene import displaced
from vtu_file import read_vtu

from crms_fenicsx import (
    Bar,
    Cable,
    Friction,
    InputError,
    IsotropicMembrane,
    NetWarning,
    Scene,
    Solver,
    meshes,
    nets,
)
from crms_fenicsx.model.bar import PlacedBar

FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0)
EA = 1e3


def square(comm, size=1.3, structured=False) -> Scene:
    return clamped(meshes.rectangle(comm, 10.0, 10.0, size, structured=structured), FABRIC)


def crossed(comm, friction=0.0, rtol=1e-11, **options) -> tuple[Scene, Solver]:
    """A square with two cables that cross in its middle, and a load on its left half."""
    scene = square(comm, **options)
    for name, path in (("a", [(0.0, 5.0), (10.0, 5.0)]), ("b", [(5.0, 0.0), (5.0, 10.0)])):
        scene.lay_cable(Cable(EA, friction=friction), path, tension=5.0, name=name)
    scene.put_load(on_half, name="half")
    return scene, Solver(scene, rtol=rtol)


def on_half(x, n):
    return np.stack([0 * x[0], 0 * x[0], -1.0 * (x[0] < 5.0)])


def state_of(scene: Scene) -> list[float]:
    return [scene.energy, *(cable.tension for cable in scene.cables)]


@pytest.mark.parametrize(("n", "rtol"), [(8, 1e-9), (7, 5e-9)])
def test_clamped_or_not_is_the_same_under_symmetric_load(comm, n, rtol) -> None:
    """On a mesh that is its own image under half a turn: about a vertex where both cables cross, or
    the middle of an edge, beside which the crossing is in one of two cells."""
    found = {}
    for joined in (False, True):
        scene, solver = crossed(comm, size=10 / n, structured=True)
        if joined:
            (clamp,) = scene.clamp("a", "b")
            assert clamp.at == pytest.approx((0.5, 0.5), abs=1e-12)
        solver.advance(pressure=2.0)
        found[joined] = [scene.energy, scene.cable("a").tension, scene.cable("b").tension]
    np.testing.assert_allclose(found[True], found[False], rtol=rtol)


@pytest.mark.ranks
def test_tensions_balance_at_a_clamp(comm) -> None:
    """Under load on one half; unclamped and unloaded it is the sliding net again."""
    scene, solver = crossed(comm)
    solver.advance(pressure=2.0)
    solver.advance(load={"half": 1.0})
    slid = state_of(scene)
    solver.advance(load={"half": 0.0})
    before = state_of(scene)
    (clamp,) = scene.clamp("a", "b")
    solver.advance(load={"half": 1.0})
    assert solver.steps[-1].verification.passed
    assert scene.energy > slid[0] + 1e-3  # it holds what would slide
    a, b = scene.cables
    force = solver.clamp_forces()["a x b"]
    assert len(set(np.round(a.tensions, 9))) == 2 and len(set(np.round(b.tensions, 9))) == 2
    assert force.before == (a.tensions[0], b.tensions[0])
    assert solver.history["clamp a x b"][-1] == force.size
    assert force.after == (a.tensions[-1], b.tensions[-1])
    assert abs(force.differences[0]) > 0.2
    # what the one hands on the other takes, but for the pressure on the facets around
    assert force.size == pytest.approx(float(np.hypot(*force.differences)), rel=0.05)
    assert a.tension == pytest.approx(
        a.tensions[0] * clamp.at[0] + a.tensions[-1] * (1 - clamp.at[0]), rel=1e-12
    )
    held = [scene.energy, a.tensions[0], a.tensions[-1], b.tensions[0], b.tensions[-1]]
    np.testing.assert_allclose(
        held, [-46.222487, 23.4434, 23.899002, 22.764657, 22.742118], rtol=1e-6
    )  # the same on any number of processes
    scene.unclamp("a", "b")
    solver.advance(load={"half": 0.0})
    after = state_of(scene)
    # to rounding, from the state that a cycle of this load leaves: before it a cable lay on the
    # other side of a vertex, at an energy 5e-7 higher
    np.testing.assert_allclose(after, before, rtol=1e-9)
    assert not scene.clamps and a.state.law.parts is None


def test_clamping_changes_nothing_in_an_equilibrium(comm) -> None:
    scene, solver = crossed(comm)
    solver.advance(pressure=2.0, load={"half": 1.0})
    before = state_of(scene)
    scene.clamp("a", "b")
    solver.advance()
    after = state_of(scene)
    np.testing.assert_allclose(after, before, rtol=1e-9)
    for cable in scene.cables:
        np.testing.assert_allclose(cable.tensions, cable.tension, rtol=1e-8)


@pytest.mark.parametrize("options", [{}, {"size": 1.0, "structured": True}], ids=["cell", "vertex"])
def test_clamped_cables_off_the_membrane_are_four_that_share_a_joint(comm, options) -> None:
    """Lifted off together they are straight from the clamp to their anchors; also from a vertex."""
    scene = square(comm, **options)
    a = scene.lay_cable(Cable(1e6), [(-1.0, 5.0, 0.0), (11.0, 5.0, 0.0)], tension=9e3, name="a")
    b = scene.lay_cable(Cable(2e6), [(4.0, -1.0, 0.0), (4.0, 11.0, 0.0)], tension=5e3, name="b")
    (clamp,) = scene.clamp(a, b)
    solver = Solver(scene)
    moves = {a.start: (-0.1, 0.0, 1.0), a.end: (0.05, 0.3, 1.5), b.start: (0.2, 0.0, 1.3)}
    solver.advance(move={**moves, b.end: (0.0, 0.0, 1.2)})
    assert solver.steps[-1].verification.passed
    assert len(a.line) == len(b.line) == 3 and a.free_spans.all() and b.free_spans.all()

    other = square(comm)
    joint = other.add_joint((4.0, 5.0, 1.2))
    bars = []
    for cable, at in zip((a, b), clamp.at, strict=True):
        for end, share in ((cable.line[0], at), (cable.line[-1], 1 - at)):
            one = Bar(cable.cable.EA, tension_only=True)
            bars.append(other.add_bar(one, tuple(end), joint, L0=share * cable.L0))
    Solver(other).advance()
    np.testing.assert_allclose(scene.clamps[0].place, joint.position, atol=1e-8)
    forces = [*a.tensions, *b.tensions]
    np.testing.assert_allclose(forces, [bar.force for bar in bars], rtol=1e-8)
    assert np.ptp(forces[:2]) > 100.0


@pytest.mark.ranks
def test_clamps_survive_checkpoints_branches_and_lengths(comm, folder) -> None:
    scene, solver = crossed(comm)
    scene.clamp("a", "b")
    solver.advance(pressure=2.0)
    cases = solver.combine({"half": {"half": 1.0}, "short": {"half": 0.5}})
    assert set(cases["half"].snapshot.net.clamps[0].cables) == {"a", "b"}
    solver.restore(cases["half"].snapshot)
    loaded = solver.clamp_forces()["a x b"]
    solver.save(folder / "state")
    a = scene.cable("a")
    part = a.part_lengths
    solver.advance(L0={a: 0.99 * a.L0})
    np.testing.assert_allclose(a.part_lengths, 0.99 * part, rtol=1e-12)
    again, solver = crossed(comm)
    again.clamp("a", "b")
    solver.load(folder / "state")
    assert again.clamps[0].at == scene.clamps[0].at
    found = solver.clamp_forces()["a x b"]
    np.testing.assert_allclose(
        [*found.before, *found.after, *found.force],
        [*loaded.before, *loaded.after, *loaded.force],
        rtol=1e-12,
    )
    solver.advance()
    np.testing.assert_allclose(solver.clamp_forces()["a x b"].before, loaded.before, rtol=1e-7)


def test_clamps_near_places_and_of_removed_cables(comm) -> None:
    scene, solver = crossed(comm)
    scene.lay_cable(Cable(EA), [(0.0, 2.0), (10.0, 2.5)], tension=5.0, name="c")
    (clamp,) = scene.clamp("a", "b", "c", near=[(5.0, 2.0, 0.0)])
    assert clamp.name == "b x c"
    (more,) = scene.clamp(*scene.cables)
    assert more.name == "a x b" and scene.clamp(*scene.cables) == ()
    solver.advance(pressure=1.0)
    assert (
        len(scene.cable("b").state.law.parts.at) == 2
        and len(scene.cable("a").state.law.parts.at) == 1
    )
    assert "clamp" in repr(solver.summary()) and set(solver.summary().clamps) == {"b x c", "a x b"}
    scene.unclamp("b", "c", near=[(5.0, 2.2, 0.0)])
    scene.remove("a")
    assert scene.clamps == ()
    solver.advance()
    assert scene.cable("b").state.law.parts is None


@pytest.mark.ranks
def test_lengths_to_order(comm, folder) -> None:
    """At a tension and a temperature, with the clamps' spacings and allowances; also in reports."""
    scene, solver = crossed(comm)
    scene.clamp("a", "b")
    solver.advance(pressure=1.0)
    order = nets.lengths_to_order(
        scene, tension={"a": 4.0}, temperature=-20.0, allowance=(0.3, 0.2)
    )
    a, b = scene.cables
    warm = 1 - 20 * 1.2e-5
    assert order.cables["a"].length == pytest.approx(a.L0 * (1 + 4.0 / EA) * warm, rel=1e-14)
    assert order.cables["b"].length == pytest.approx(b.L0 * warm, rel=1e-14)
    assert order.cables["a"].cut == pytest.approx(order.cables["a"].length + 0.5)
    assert sum(order.cables["a"].spacings) == pytest.approx(order.cables["a"].length)
    assert order.cables["a"].spacings[0] / order.cables["a"].length == pytest.approx(
        scene.clamps[0].at[0]
    )
    solver.report(
        folder / "net.html",
        order=order,
        foundations={"west": ["a start"], "all": ["a start", "a end"]},
    )
    order.write(folder / "cables.csv")
    comm.barrier()
    rows = (folder / "cables.csv").read_text().splitlines()
    assert len(rows) == 5 and rows[1].split(",")[5:7] == ["start", "a x b"]
    text = (folder / "net.html").read_text()
    assert "Cables to order" in text and "Foundations" in text and "a x b" in text
    sums = (folder / "net_foundations.csv").read_text().splitlines()
    pull = -a.start.reaction
    found = [float(x) for x in sums[1].split(",")[2:]]
    flat = np.hypot(*pull[:2])
    np.testing.assert_allclose(found[:3], pull, atol=1e-9)
    np.testing.assert_allclose(found[3:5], [np.linalg.norm(pull), flat])
    assert found[6] == pytest.approx(np.degrees(np.arctan2(pull[2], flat)))
    both = [float(x) for x in sums[2].split(",")[2:5]]
    np.testing.assert_allclose(both, pull - a.end.reaction, atol=1e-9)
    assert "a x b" in (folder / "net_clamps.csv").read_text()
    for options, message in (
        ({"order": 3}, "order = 3; pass what nets.lengths_to_order"),
        ({"foundations": {"F": ["z end"]}}, "foundation 'F' carries .'z end'."),
        ({"foundations": ["a start"]}, "write names of cables"),
    ):
        with pytest.raises(InputError, match=message):
            solver.report(folder / "other.html", **options)
    with pytest.raises(InputError, match="the scene has no cables"):
        nets.lengths_to_order(square(comm))
    with pytest.raises(InputError, match="tension of 'a' = 'much'"):
        nets.lengths_to_order(scene, tension={"a": "much"})
    for given, message in (
        ({"tension": -0.1}, "tension of 'a' = -0.1, a strain of"),
        ({"tension": {"b": 0.2 * EA}}, "tension of 'b' = .* strain of 0.2 .* from 0 to 0.1 EA"),
        ({"temperature": 293.0}, "temperature = 293.0; pass the difference"),
        ({"expansion": 12.0}, "expansion = 12.0; use a number per kelvin"),
    ):
        with pytest.raises(InputError, match=message):
            nets.lengths_to_order(scene, **given)


@pytest.mark.ranks
def test_bad_clamps_are_refused(comm) -> None:
    scene, _ = crossed(comm)
    scene.lay_cable(Cable(EA), [(0.0, 2.0), (10.0, 2.5)], tension=5.0, name="c")
    stepwise = Cable(EA, law="step")
    scene.lay_cable(stepwise, [(0.0, 9.0), (10.0, 9.0)], tension=5.0, name="f")
    scene.lay_cable(Cable(EA), [(3.0, 0.0, 0.0), (3.0, 5.0, 2.0)], tension=5.0, name="e")
    scene.lay_cable(Cable(EA), [(0.0, 7.0), (10.0, 7.3)], tension=5.0, name="g")
    bad = [
        (lambda: scene.clamp("a", "a"), "the cables are a, a; pass two or more different ones"),
        (lambda: scene.clamp("a"), "two or more different"),
        (lambda: scene.clamp("a", "x"), "no cable 'x'"),
        (lambda: scene.clamp("a", 3), "3 is not a cable of this scene"),
        (lambda: scene.clamp("a", "c"), "'a' and 'c' do not cross between their ends; lay one"),
        (lambda: scene.clamp("a", "c", "g"), "'a', 'c' and 'g' do not cross"),
        (lambda: scene.clamp("b", "f"), """'f' has law="step", with which its tension"""),
        (lambda: scene.clamp("a", "b", slip=-1.0), "clamp: slip"),
        (lambda: scene.clamp("c", "e"), "'c' and 'e' lie 0.798 apart where they cross"),
        (lambda: scene.clamp("a", "b", near="here"), "near = 'here'"),
        (lambda: scene.unclamp("a", "b"), "there is no such clamp; the scene has none"),
    ]
    first = comm.rank == 0
    with (
        pytest.warns(NetWarning, match="3 crossings left open: 'a' and 'e'")
        if first
        else (nullcontext())
    ):
        assert len(scene.clamp("a", "b", "c", "e")) == 2
    scene.unclamp("a", "b", "c")
    before = scene.net.state
    for call, message in bad:
        with pytest.raises(InputError, match=message):
            call()
        assert scene.clamps == () and scene.net.state.clamps == before.clamps


@pytest.mark.ranks
def test_cables_apart_where_both_bend_are_told_from_others_that_do_not_cross(comm) -> None:
    """One lies in a line of the mesh, the other hangs over it, between bends of both."""
    scene = sheet(
        comm,
        11,
        material=IsotropicMembrane(E=260.0, nu=0.3, thickness=1.0, prestress=0.8),
        side=7.3,
    )
    y = 7.3 * 4 / 11
    for name, path in (("a", [(0.0, y), (7.3, y)]), ("b", [(2.117, 0.0), (2.14, 7.3)])):
        scene.lay_cable(Cable(900.0), path, tension=4.0, name=name)
    scene.put_load((0.0, 0.0, -0.7), per="plan", name="snow")
    Solver(scene).advance(pressure=2.0, load={"snow": 1.0})
    with pytest.raises(InputError, match=r"'a' and 'b' lie 0.0\d+ apart where they cross"):
        scene.clamp("a", "b")


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_clamped_cables_along_lines_of_the_mesh_are_tightened(comm, order) -> None:
    """One after the other: the one that hangs on to its line has the clamp on an edge beside a
    vertex. The square is the same along both, and so are the forces of the parts."""
    scene = sheet(comm, 10, material=IsotropicMembrane(E=400.0, nu=0.25, thickness=1.0), side=14.0)
    paths = ([(0.0, 7.0), (14.0, 7.0)], [(7.0, 0.0), (7.0, 14.0)])
    cables = [scene.lay_cable(Cable(EA=5e3), path) for path in paths]
    solver = advanced(Solver(scene), pressure=0.3)
    scene.clamp(*cables)
    for k in order:
        step = solver.advance(L0={cables[k]: 0.995 * cables[k].L0})
        assert step.verification.passed
    tensions = np.concatenate([cable.tensions for cable in cables])
    np.testing.assert_allclose(tensions, tensions.mean(), rtol=0.02)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("n", "cables", "rtol"),
    [(8, 7, 1e-9), (8, 3, 0.01), pytest.param(16, 7, 1e-3, marks=pytest.mark.slow)],
)
def test_a_clamped_net_against_bars_between_shared_nodes(comm, n, cables, rtol) -> None:
    """On a mesh whose lines carry both families: clamped at each vertex it is the same net, which
    is bonded there; with fewer clamps its cables slide between them."""
    at, step = [10 * k / (cables + 1) for k in range(1, cables + 1)], 10 / n
    net, barred = square(comm, step, structured=True), square(comm, step, structured=True)
    for y in at:
        for name, path in (("A", [(0.0, y), (10.0, y)]), ("B", [(y, 0.0), (y, 10.0)])):
            net.lay_cable(Cable(EA), path, tension=2.0, measured_on="facets", name=f"{name}{y}")
    net.clamp(*net.cables)
    bars: dict[str, list[PlacedBar]] = {}
    for cable in net.cables:
        places = [barred.vertex_at(step * k * (cable.line[-1] - cable.line[0]) / 10 + cable.line[0])
                  for k in range(n + 1)]  # fmt: skip
        bars[cable.name] = [
            barred.add_bar(Bar(EA, tension_only=True), *ends, L0=step / (1 + 2.0 / EA))
            for ends in pairwise(places)
        ]
    for scene in (net, barred):
        scene.put_load(on_half, name="half")
        solver = advanced(Solver(scene, rtol=1e-11), pressure=2.0)
        solver.advance(load={"half": 1.0})
    assert net.energy == pytest.approx(barred.energy, rel=rtol)
    for cable in net.cables:
        mean = np.mean([bar.force for bar in bars[cable.name]])
        assert cable.tension == pytest.approx(mean, rel=rtol)


@pytest.mark.ranks
def test_clamps_of_limited_grip(comm) -> None:
    """With much grip they hold as those without a limit; with none the net slides; between them
    the tensions differ by the grip, the work is heat, and the way counts."""
    found, heat = {}, {}
    for slip in (None, 1e3, 0.3, 1e-4, 0.0):
        scene, solver = crossed(comm)
        solver.advance(pressure=2.0)
        if slip != 0.0:
            scene.clamp("a", "b", slip=slip)
        solver.advance(load={"half": 1.0})
        a = scene.cable("a")
        found[slip] = [scene.energy, *a.tensions[[0, -1]]]
        assert solver.steps[-1].verification.passed
        if slip == 0.3:
            force = 0.3 / (1 + a.tension / EA)  # the grip acts on the unstressed cable
            assert solver.clamp_forces()["a x b"].differences[0] == pytest.approx(force, rel=1e-3)
            heat["there"] = scene.dissipated
            (clamp,) = scene.clamps
            assert clamp.at[0] * a.L0 == pytest.approx(a.part_lengths[0], abs=2e-5)
            slid = (0.49991796 - clamp.at[0]) * a.L0
            assert heat["there"] == pytest.approx(0.3 * slid, rel=1e-3)
            solver.advance(load={"half": 0.0})
            heat["back"] = scene.dissipated
            assert solver.history["dissipated"][-1] == scene.dissipated
    assert heat["there"] > 1e-3 and heat["back"] >= heat["there"]
    np.testing.assert_allclose(found[1e3], found[None], rtol=1e-6)
    np.testing.assert_allclose(found[1e-4], found[0.0], rtol=1e-5)
    assert found[None][0] > found[0.3][0] > found[0.0][0]


def test_taylor_of_cables_that_slip_through_clamps(comm) -> None:
    """The slips are eliminated: the slope of the energy is that with the slips held."""
    scene, solver = crossed(comm)
    solver.advance(pressure=2.0)
    scene.clamp("a", "b", slip=0.3)
    solver.advance(load={"half": 1.0})
    system = solver.system
    assert system.cables is not None and system.cables.clutches is not None
    term = system.cables.clutches
    term.renew(replace(term.grips, eps=0 * term.grips.eps + 0.1, elastic=0 * term.grips.eps + 0.1))
    f = OnMesh(system.unknowns, scene.u, [term])
    x = displaced(f.unknowns, 0.05, stretch=1.05)
    d = noise(x, 1)
    assert gradient_order(f, x, d) > 1.9


def test_slipped_clamps_in_checkpoints(comm, folder) -> None:
    runs = []
    for saved in (True, False):
        scene, solver = crossed(comm)
        scene.clamp("a", "b", slip=0.3)
        if saved:
            solver.advance(pressure=2.0)
            solver.advance(load={"half": 1.0})
            solver.save(folder / "state")
        else:
            solver.load(folder / "state")
        solver.advance(load={"half": 0.2})
        runs.append([scene.energy, scene.dissipated, *scene.clamps[0].at])
    np.testing.assert_allclose(*runs, rtol=1e-10)


@pytest.mark.ranks
def test_friction_along_cables_between_clamps(comm) -> None:
    """With little of it the net is the one without; with more the tension goes on changing from
    the clamp, at which it jumps, to the anchors."""
    found = {}
    for along in (0.0, 1e-4, 0.05):
        scene, solver = crossed(comm, Friction(0.0, along=along) if along else 0.0, 1e-10)
        solver.advance(pressure=2.0)
        (clamp,) = scene.clamp("a", "b")
        solver.advance(load={"half": 1.0})
        assert solver.steps[-1].verification.passed
        a = scene.cable("a")
        found[along] = [scene.energy, *a.tensions[[0, -1]]]
        force = solver.clamp_forces()["a x b"]
        if along == 0.05:
            steps = np.abs(np.diff(a.tensions))
            assert np.count_nonzero(steps > 1e-4) > 5
            assert steps.max() == pytest.approx(abs(force.differences[0]), rel=1e-6)
            rest = a.state.law.axial.arcs[
                np.argmin(np.abs(a.state.law.axial.arcs - clamp.at[0] * a.L0))
            ]
            assert rest == pytest.approx(clamp.at[0] * a.L0, abs=1e-6 * a.L0)
            solver.advance(L0={a: 0.999 * a.L0})
            assert solver.steps[-1].verification.passed
    np.testing.assert_allclose(found[1e-4], found[0.0], rtol=3e-5)
    assert abs(found[0.05][0] / found[0.0][0] - 1) > 3e-6


@pytest.mark.ranks
def test_slipping_clamps_on_cables_with_friction_along(comm) -> None:
    """The grip bounds the difference of tensions as without friction; with much it holds as
    without a limit, with hardly any the cables slide as if unclamped. Clamping changes nothing."""
    found = {}
    for slip in (None, 1e3, 0.3, 1e-4, 0.0):
        scene, solver = crossed(comm, Friction(0.0, along=0.05), 1e-10)
        solver.advance(pressure=2.0)
        before = [scene.energy, *scene.cable("a").tensions]
        if slip != 0.0:
            scene.clamp("a", "b", slip=slip)
            solver.advance()
            now = [scene.energy, *scene.cable("a").tensions[[0, -1]]]
            np.testing.assert_allclose(now, [before[i] for i in (0, 1, -1)], rtol=1e-7)
        solver.advance(load={"half": 1.0})
        assert solver.steps[-1].verification.passed
        a = scene.cable("a")
        found[slip] = [scene.energy, *a.tensions[[0, -1]]]
        if slip == 0.3:
            (clamp,) = scene.clamps
            force = 0.3 / (1 + a.tension / EA)
            assert solver.clamp_forces()["a x b"].differences[0] == pytest.approx(force, rel=1e-3)
            assert clamp.at[0] < 0.4985 and scene.dissipated > 0.0158
            solver.advance()
            again = [scene.energy, *a.tensions[[0, -1]]]
            np.testing.assert_allclose(again, found[slip], rtol=1e-7)
    np.testing.assert_allclose(found[1e3], found[None], rtol=1e-6)
    np.testing.assert_allclose(found[1e-4], found[0.0], rtol=1e-5)
    assert found[None][0] > found[0.3][0] > found[0.0][0]


@pytest.mark.filterwarnings("ignore::crms_fenicsx.FrictionWarning")
@pytest.mark.parametrize("law", ["coulomb", "step"])
def test_energies_of_all_friction_are_added(comm, folder, law: str) -> None:
    """The energy of slipping clamps, of friction sideways and of friction along, each on cables of
    its own, is what is minimised without the heat of the step; so it is after a checkpoint."""
    found = []
    rubbing = {"c": (2.4, Friction(0.05, law=law)), "d": (7.6, Friction(0.0, along=0.1))}
    for saved in (True, False):
        scene, solver = crossed(comm, size=1.6)
        scene.clamp("a", "b", slip=0.3)
        for name, (y, friction) in rubbing.items():
            path = [(0.0, y), (10.0, y + 0.5)]
            scene.lay_cable(Cable(EA, friction=friction), path, tension=5.0, name=name)
        scene.put_load((0.0, 0.5, 0.0), name="drag")
        if saved:
            solver.advance(pressure=2.0, load={"half": 1.0, "drag": 1.0})
            solver.save(folder / "state")
            last = scene.energies
        else:
            solver.load(folder / "state")
            assert scene.energies == last
        spent = scene.dissipated
        solver.advance(load={"half": 0.5, "drag": 2.0})
        grips = [scene.cable(name).state.law for name in ("a", "c", "d")]
        assert grips[0].parts is not None and grips[0].parts.dissipated > 1e-4
        assert grips[1].lateral is not None and grips[1].lateral.dissipated > 1e-4
        assert grips[2].axial is not None and grips[2].axial.dissipated > 1e-4
        heat = scene.dissipated - spent
        # slips sideways count as linear in a minimisation; all shares are larger by far
        assert scene.energy == pytest.approx(solver.system.objective - heat, abs=1e-8)
        found.append(list(scene.energies.values()))
    np.testing.assert_allclose(*found, rtol=1e-8)


def test_clamps_with_friction_in_a_cone(comm) -> None:
    """Between those of the net that slides and of the one whose friction is a box."""
    energies = {}
    for cone, joined in ((True, False), (True, True), (False, True)):
        scene, solver = crossed(comm, Friction(0.2, along=0.2, cone=cone), 1e-10)
        solver.advance(pressure=2.0)
        if joined:
            scene.clamp("a", "b")
        solver.advance(load={"half": 1.0})
        assert solver.steps[-1].verification.passed
        energies[cone, joined] = scene.energy
    assert energies[True, False] < energies[True, True] < energies[False, True]


@pytest.mark.parametrize("n", [10, 20])
def test_a_clamp_comes_down_on_its_vertex(comm, n) -> None:
    """Lifted off together, and let down again: where the clamp was, with the tensions that it had,
    to what points of its cables that vertices hold beside it change."""
    scene = square(comm, 10.0 / n, structured=True)
    ends = []
    for name, path in (
        ("a", [(-1.0, 5.0, 0.0), (11.0, 5.0, 0.0)]),
        ("b", [(5.0, -1.0, 0.0), (5.0, 11.0, 0.0)]),
    ):
        cable = scene.lay_cable(Cable(EA), path, tension=5.0, name=name)
        ends += [cable.start, cable.end]
    solver = advanced(Solver(scene, rtol=1e-10), pressure=1.0)
    scene.clamp("a", "b")
    solver.advance()
    before = np.concatenate([cable.tensions for cable in scene.cables])
    solver.advance(move=dict.fromkeys(ends, (0.0, 0.0, 3.0)))
    assert all(cable.free_spans.all() for cable in scene.cables)
    np.testing.assert_allclose(scene.clamps[0].place, (5.0, 5.0, 3.0), atol=1e-9)
    solver.advance(move=dict.fromkeys(ends, (0.0, 0.0, -3.0)))
    assert solver.steps[-1].verification.passed
    after = np.concatenate([cable.tensions for cable in scene.cables])
    np.testing.assert_allclose([after.min(), after.max()], before.mean(), rtol=1e-3)


@pytest.mark.ranks
def test_clamps_and_bonds_in_all_that_is_written(comm, folder) -> None:
    """History, series for ParaView, combinations and report, of a net whose clamp slips."""
    scene, _ = crossed(comm)
    scene.lay_cable(Cable(EA), [(0.0, 8.0), (10.0, 8.0)], hold="bonded", name="c")
    solver = advanced(Solver(scene, results=folder / "run"), pressure=2.0)
    scene.clamp("a", "b", slip=0.3)
    found = solver.combine({"calm": {}, "storm": {"half": 1.0}})
    solver.advance(load={"half": 1.0})
    force, a = solver.clamp_forces()["a x b"], scene.cable("a")
    assert force.differences[0] == pytest.approx(0.3 / (1 + a.tension / EA), rel=1e-3)
    assert solver.history["clamp a x b"][-1] == force.size
    solver.report(folder / "net.html", found)
    comm.barrier()
    if comm.rank == 0:
        assert "a x b" in (folder / "net.html").read_text()
        with (folder / "net_clamps.csv").open() as table:
            calm, storm = csv.DictReader(table)
        assert (calm["Combination"], storm["Combination"]) == ("calm", "storm")
        assert float(calm["Force"]) < 0.01 * force.size
        now = [*force.before, *force.after, force.size]
        told = [f"Cable {k}, {where}" for where in ("before", "after") for k in (1, 2)]
        np.testing.assert_allclose(
            [float(storm[name]) for name in (*told, "Force")], now, rtol=1e-6
        )
        lines = read_vtu(sorted((folder / "run" / "steps").glob("cables_*.vtu"))[-1])
        points = lines.points[lines.point_data["clamp"] > 0.0]
        np.testing.assert_allclose(points, np.broadcast_to(scene.clamps[0].place, (2, 3)))
        shown = lines.cell_data["tension"][lines.cell_data["line"] == 0]
        np.testing.assert_allclose([shown[0], shown[-1]], a.tensions[[0, -1]])
        assert np.ptp(lines.cell_data["tension"][lines.cell_data["line"] == 2]) > 1e-3  # bonded
    comm.barrier()


def shaken(comm, n: int, seed: int) -> meshes.MembraneMesh:
    """A square of n cells a side, inner vertices moved at random; the same with any gmsh."""
    x = np.linspace(0.0, 100.0, n + 1)
    points, cells = grid(x, x, by_rows=True)
    inner = np.all((points[:, :2] > 0.0) & (points[:, :2] < 100.0), axis=1)
    moved = np.random.default_rng(seed).uniform(-0.2, 0.2, (inner.sum(), 2))
    points[inner, :2] += moved * 100.0 / n
    return meshes.from_arrays(comm, points, cells)


@pytest.mark.ranks
@pytest.mark.parametrize("size", [5.0, 4.5, 4.0, 3.6, (18, 1), (20, 1), (24, 7), (26, 5)], ids=str)
def test_a_clamp_slides_from_cell_to_cell(comm, size: float | tuple[int, int]) -> None:
    """One cable is laid askew, so that its clamp pulls it back as soon as the other tightens, from
    cells that the cable alone has reached; on every mesh to the place that it has on gmsh's cells
    of 3."""
    if isinstance(size, float):
        mesh, within = meshes.rectangle(comm, 100.0, 100.0, size), (4e-3, 3e-3)
    else:
        mesh, within = shaken(comm, *size), (0.011, 5e-3)  # up to 1.4 times as coarse
    scene = clamped(mesh, IsotropicMembrane(E=3500.0, nu=0.3, thickness=0.08, prestress=0.05))
    paths = ((0, 67), (100, 67)), ((34, 0), (31, 40), (34, 100))
    cables = [
        scene.lay_cable(Cable(14e3), path, L0=100.0, layer=layer)
        for layer, path in enumerate(paths)
    ]
    scene.clamp(*cables)
    solver = Solver(scene)
    for pressure, W, T in (
        (0.001, -5.4151, (7.258, 14.379)),
        (0.002, -14.8974, (12.055, 19.042)),
    ):
        solver.advance(pressure=pressure)
        verification = solver.steps[-1].verification
        assert verification is not None and not verification.doubtful
        assert scene.energy == pytest.approx(W, rel=within[0])
        assert [cable.tension for cable in cables] == pytest.approx(T, rel=within[1])
