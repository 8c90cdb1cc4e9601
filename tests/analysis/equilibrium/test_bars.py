"""Bars against closed forms: snap-through, a guyed mast, tents on masts; bad input; runs go on."""

import warnings
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped

from crms_fenicsx import (
    Bar,
    Cable,
    InputError,
    InstabilityWarning,
    IsotropicMembrane,
    PathError,
    Rotation,
    Scene,
    SnapThroughWarning,
    Solver,
    meshes,
)
from crms_fenicsx.analysis.verification.verifier import Verifier
from crms_fenicsx.model.bar import IMPERFECTIONS
from crms_fenicsx.results.output import draw
from crms_fenicsx.results.view_data import bar_lines

FOIL = IsotropicMembrane(E=3000.0, nu=0.3, thickness=0.1, prestress=1.0)
A, H, EA = 4.0, 1.0, 1000.0


def sheet(comm, size=2.0):
    """A clamped square beside which bars stand."""
    return clamped(meshes.rectangle(comm, 4.0, 4.0, size, structured=True), FOIL)


def test_strength_and_buckling_of_bars(comm):
    """A strut in compression by its buckling curve only, in tension by its strength."""
    scene = sheet(comm)
    strut = Bar(EA=1e3, EI=2.0, strength=8.0)
    bar = scene.add_bar(strut, (9.0, 0.0, 0.0), (11.0, 0.0, 0.0), L0=2.002)
    assert bar.buckling == pytest.approx(np.pi**2 * 2.0 / 2.0**2)
    assert bar.force < 0.0 and bar.utilisation is None
    own = Bar(EA=1e3, strength=8.0, curve=0.25)
    bar = scene.add_bar(own, (9.0, 3.0, 0.0), (11.0, 3.0, 0.0), L0=2.002)
    assert bar.utilisation == pytest.approx(-bar.force / 2.0)
    tie = scene.add_bar(strut, (9.0, 1.0, 0.0), (11.0, 1.0, 0.0), L0=1.99)
    assert tie.utilisation == pytest.approx(tie.force / 8.0)
    plain = scene.add_bar(Bar(EA=1e3), (9.0, 2.0, 0.0), (11.0, 2.0, 0.0), L0=2.01)
    assert plain.buckling is None and plain.utilisation is None
    for name in ("EI", "strength"):
        with pytest.raises(InputError, match=f"Bar: {name} = -1.0"):
            Bar(EA=1.0, **{name: -1.0})


@pytest.mark.parametrize("units", [(1.0, 1.0), (1000.0, 1e-3)], ids=["m, kN", "mm, MN"])
@pytest.mark.parametrize("curve", IMPERFECTIONS)
def test_buckling_curves(curve, units):
    """The Perry-Robertson condition, N / R + eta N / R / (1 - N / N_cr) = 1, at full utilisation:
    between its bounds, the strength of stocky bars and Euler's load of slender ones."""
    (length, force), shares = units, []
    R, EI = 947.0 * force, 2724.0 * force * length**2
    bar = Bar(EA=846e3 * force, EI=EI, strength=R, curve=curve)
    for slenderness in (0.1, 0.2, 0.5, 1.0, 2.0, 10.0):
        chi = bar.reduction(slenderness * np.pi * np.sqrt(EI / R))
        eta = max(IMPERFECTIONS[curve] * (slenderness - 0.2), 0.0)
        assert chi * (1 + eta / (1 - chi * slenderness**2)) == pytest.approx(1.0, rel=1e-9)
        shares.append(chi * max(1.0, slenderness**2))
    assert shares[:2] == [1.0, 1.0]
    assert shares[-1] > 0.9 and max(shares[2:]) < 1.0


def test_buckling_curves_are_ordered():
    """The more imperfect, the weaker; table 6.1 by the factors at a slenderness of 1."""
    bars = [Bar(EA=1.0, EI=1.0, strength=np.pi**2, curve=curve) for curve in IMPERFECTIONS]
    found = [bar.reduction(1.0) for bar in bars]
    np.testing.assert_allclose(found, [0.7253, 0.6656, 0.5970, 0.5399, 0.4671], atol=1e-4)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"curve": "e", "EI": 1.0, "strength": 1.0}, "no buckling curve 'e'; there are 'a0'"),
        ({"curve": "a", "EI": 1.0}, "curve = 'a' needs strength"),
        ({"curve": "a"}, "needs strength and EI"),
        ({"curve": 1.2, "strength": 1.0}, "curve = 1.2 is not a reduction factor"),
        ({"curve": 0.0, "strength": 1.0}, "curve = 0.0"),
        ({"curve": 0.5}, "needs strength"),
    ],
)
def test_bad_buckling_curves(given, words):
    with pytest.raises(InputError, match=words):
        Bar(EA=1.0, **given)


def truss(comm):
    """Von Mises' truss: two flat struts."""
    scene = sheet(comm)
    top = scene.add_joint((0.0, 9.0, H), name="top", held="y")
    for x in (-A, A):
        scene.add_bar(Bar(EA), (x, 9.0, 0.0), top, name="left" if x < 0 else "right")
    scene.put_joint_load({top: (0.0, 0.0, -1.0)}, name="P")
    return scene, top


def load_of(w):
    """Exact load of the truss at a deflection."""
    L0, z = np.hypot(A, H), H - w
    length = np.hypot(A, z)
    return -2 * EA * (length - L0) / L0 * z / length


@contextmanager
def told(comm, expected):
    """Expect a warning of a snap-through, or none, and no other warning."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    kinds = [one.category for one in caught]
    assert kinds == [SnapThroughWarning] * (expected and comm.rank == 0)


def test_von_mises_truss_snaps_through(comm):
    """On the closed curve before and after its limit load, which lies between 99 and 101 %."""
    scene, top = truss(comm)
    solver = Solver(scene)
    w = np.linspace(0.0, H, 100001)
    limit = load_of(w).max()
    for part, below in ((0.4, True), (0.8, True), (0.99, True), (1.01, False), (2.0, False)):
        with told(comm, part == 1.01):
            step = solver.advance(load={"P": part * limit})
        assert step.verification.passed
        if step.warnings:
            low, high = step.warnings[0].loads["P"]
            assert low < 1.002 * limit
            assert high > 0.998 * limit
            assert high - low < 0.006 * limit
        found = H - top.position[2]
        assert load_of(found) == pytest.approx(part * limit, rel=1e-8)
        assert (found < H) == below
        assert abs(top.position[0]) < 1e-6
    left = scene.bar("left")
    assert left.force > 0, "in tension below the anchors"
    half = part * limit / 2
    np.testing.assert_allclose(left.start.reaction[2], half, rtol=1e-8)
    np.testing.assert_allclose(top.reaction, 0.0, atol=1e-12)
    # back: it stays below until the load pulls it up again by as much
    solver.advance(load={"P": 0.0}, steps=2)
    assert top.position[2] == pytest.approx(-H, rel=1e-8)
    with told(comm, True):
        solver.advance(load={"P": -1.01 * limit})
    assert top.position[2] > H


def mast(comm, slack=0.0):
    """A hinged mast between two guys in a plane."""
    scene = sheet(comm)
    top = scene.add_joint((0.0, 9.0, 6.0), name="top", held="y")
    scene.add_bar(Bar(1e9), (0.0, 9.0, 0.0), top, name="mast")
    guy, L0 = Bar(1e8, tension_only=True), np.hypot(8.0, 6.0) * (1 + slack)
    for x, name in ((-8.0, "west"), (8.0, "east")):
        scene.add_bar(guy, top, (x, 9.0, 0.0), name=name, L0=L0)
    scene.put_joint_load({top: (3.0, 0.0, -1.0)}, name="wind")
    return scene, top


def test_guyed_mast_by_moments(comm):
    """The guy to windward carries H h about the mast's foot, the other one hangs slack."""
    scene, top = mast(comm)
    Solver(scene).advance(load=2.0)
    west, east, pole = (scene.bar(name) for name in ("west", "east", "mast"))
    assert west.force == pytest.approx(6.0 * 10 / 8, rel=1e-6)
    assert east.slack and east.force == 0.0 and not west.slack
    assert pole.force == pytest.approx(-2.0 - 6.0 * 6 / 8, rel=1e-6)
    np.testing.assert_allclose(west.end.reaction, [-6.0, 0.0, -4.5], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(pole.start.reaction, [0.0, 0.0, 6.5], rtol=1e-6, atol=2e-6)
    # exactly, about the foot of the mast as it leans
    arm, x = np.cross(west.points[0] - pole.points[0], west.pull(top)), top.position
    moment = arm[1] + x[2] * 6.0 - x[0] * -2.0
    assert abs(moment) < 1e-7 * 36


def test_mast_leans_as_far_as_its_guys_are_slack(comm):
    """A slack guy does nothing until the mast has leant to where it is taut."""
    scene, top = mast(comm, slack=1e-3)
    Solver(scene).advance(load=1.0)
    west, pole = scene.bar("west"), scene.bar("mast")
    assert west.length == pytest.approx(west.L0, rel=1e-6)
    # circles of 6 (the mast) and of 10.01 (the guy, from -8) meet there
    x = (west.L0**2 - 64.0 - 36.0) / 16.0
    np.testing.assert_allclose(top.position, [x, 9.0, np.sqrt(36.0 - x * x)], atol=2e-6)
    assert pole.force < 0 and scene.bar("east").slack


def test_guys_are_tightened_and_anchors_moved(comm):
    """Lengths and places that load steps reach; anchors move on circles, too."""
    scene, top = mast(comm)
    solver = Solver(scene)
    west, east, pole = (scene.bar(name) for name in ("west", "east", "mast"))
    solver.advance(L0={west: 0.999 * west.L0, east: 0.999 * east.L0}, steps=2)
    assert west.L0 == pytest.approx(9.99)
    np.testing.assert_allclose(west.force, east.force, rtol=1e-6)
    assert pole.force == pytest.approx(-2 * 0.6 * west.force, rel=1e-3)
    turn = Rotation((8.0, 9.0, 1.0), (0.0, 1.0, 0.0), 0.01)
    solver.advance(move={east.end: turn, pole.start: (0.0, 0.0, -0.001)}, steps=2)
    foot = (8.0 - np.sin(0.01), 9.0, 1.0 - np.cos(0.01))
    np.testing.assert_allclose(east.end.position, foot, atol=1e-14)
    np.testing.assert_allclose(pole.start.position, [0.0, 9.0, -0.001], atol=1e-15)
    with pytest.raises(InputError, match=r"Joint\('top'\) is not held in x, "):
        solver.advance(move={top: (0.1, 0.0, 0.0)})
    scene.lay_cable(Cable(1e3), [pole.start, (3.0, 2.0, 0.0)])
    with solver.branch("without its mast"):
        scene.remove_bar(pole)
        assert scene.joint("start of mast") is pole.start, "a cable ends there"
    assert scene.bar("mast") is pole
    scene.remove(scene.cables[0])
    scene.remove_bar("east")
    assert [joint.name for joint in scene.joints] == ["top", "start of mast", "end of west"]
    solver.advance(load=1.0)
    assert west.force == pytest.approx(3.0 * 10 / 8, rel=1e-2)


@pytest.mark.ranks
def test_chains_without_stiffness_find_their_funicular(comm):
    """Straight, slack and held by nothing at first: it hangs with the moments of a beam."""
    for bar in (Bar(1e6), Bar(1e6, tension_only=True)):
        scene = sheet(comm)
        joints = [scene.add_joint((x, 9.0, 0.0)) for x in (1.0, 2.0, 3.0)]
        for start, end in pairwise([(0.0, 9.0, 0.0), *joints, (4.0, 9.0, 0.0)]):
            scene.add_bar(bar, start, end, L0=1.01)
        scene.put_joint_load({joint: (0.0, 0.0, -1.0) for joint in joints})
        Solver(scene).advance(load=1.0)
        pull = scene.joint("start of bar 1").reaction
        places = np.array([(0.0, 9.0, 0.0), *(j.position for j in joints)])
        np.testing.assert_allclose(pull[2], 1.5, rtol=1e-6)
        for k in (1, 2, 3):  # no moment at any hinge
            moment = pull[2] * places[k, 0] - sum(places[k, 0] - places[1:k, 0])
            assert moment + pull[0] * -places[k, 2] == pytest.approx(0.0, abs=1e-6)


def test_the_verification_finds_joints_out_of_balance(comm):
    """Or not where they are held."""
    scene, top = mast(comm)
    solver = advanced(Solver(scene), load=1.0)
    system, verifier = solver.system, Verifier(scene)

    def check():
        system.potential.place()
        system.potential.bring_up_to_date()
        return verifier.check(system, solver.steps[-1].outcome)

    verifier.begin()
    assert check().passed
    x = system.potential.x.copy()
    system.potential.x[system.bars.blocks.block("top"), 0] += 1e-6
    found = check()  # the potential's bars are not the scene's
    assert not found.passed and "forces of bars" in str(found)
    system.locate_cables()
    found = check()
    assert not found.passed and "unbalanced forces" in str(found)
    system.potential.x[:] = x
    system.potential.place()
    system.locate_cables()
    assert check().passed
    top.update(position=top.position + np.array([0.0, 1e-6, 0.0]))
    found = check()
    assert not found.passed and "supports off their place" in str(found)


def test_a_floor_is_none_for_joints(comm):
    scene, top = mast(comm)
    scene.floor(-1.0)
    low = scene.add_joint((0.0, 9.0, -3.0))
    scene.add_bar(Bar(1e3), top, low)
    scene.put_joint_load({low: (0.0, 0.0, -1.0)}, name="bucket")
    Solver(scene).advance(load={"bucket": 9.0})
    assert low.position[2] == pytest.approx(-3.0 - 9.0 * 9.0 / 1e3, abs=1e-5)


def tent(comm, folder=None, resume=None, ranks=None):
    """A sail between two held corners and two that stand on guyed masts; cables in its edges."""
    mesh = meshes.rectangle(comm, 4.0, 4.0, 1.0, structured=True, ranks=ranks)
    scene = Scene(mesh, FOIL)
    scene.fix(lambda x: np.abs(x[0] - x[1]) > 4.0 - 1e-9)
    solver = Solver(scene, results=folder, resume=resume)
    for k, out in ((0.0, -1.0), (4.0, 1.0)):
        corner = scene.vertex_at((k, k, 0.0))
        scene.add_bar(Bar(1e4), (k + 0.3 * out, k + 0.3 * out, -3.0), corner, name=f"mast {k:g}")
        for dx, dy in ((2.0, 0.5), (0.5, 2.0)):
            far = (k + dx * out, k + dy * out, -3.0)
            L0 = 0.998 * np.sqrt(dx * dx + dy * dy + 9.0)
            scene.add_bar(Bar(2e3, tension_only=True), corner, far, L0=L0)
    edges = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0)]
    for start, end in pairwise(edges):
        scene.lay_cable(Cable(2e3), [start, end], tension=3.0)
    scene.put_load((0.1, 0.0, -0.3), per="material", name="storm")
    return solver


@pytest.mark.ranks
def test_a_tent_on_masts_is_in_balance(comm):
    """Anchors, held corners and the ends of cables there carry the load, its area known."""
    solver = tent(comm)
    scene = solver.scene
    solver.advance()
    step = solver.advance(load=1.0, steps=2)
    assert step.verification.passed
    carried = solver.reactions(lambda x: np.abs(x[0] - x[1]) > 4.0 - 1e-9).membrane
    carried = carried + sum(joint.reaction for joint in scene.joints)
    for cable in scene.cables:
        for end, kind in zip((cable.start, cable.end), cable.ends, strict=True):
            carried = carried + (end.reaction if kind == "held" else 0.0)
    np.testing.assert_allclose(carried, [-1.6, 0.0, 4.8], atol=1e-7)
    assert scene.bar("mast 0").force < -1.0


@pytest.mark.ranks
def test_bars_do_not_depend_on_who_has_the_vertices(comm):
    """Also where the first rank, which computes them, has no cell."""

    def last_ranks(midpoints):
        others = max(comm.size - 1, 1)
        return min(1, comm.size - 1) + (midpoints[:, 0] + midpoints[:, 1] > 4.0) % others

    forces = []
    for ranks in (None, last_ranks):
        solver = tent(comm, ranks=ranks)
        solver.advance(load=1.0)
        assert solver.steps[-1].verification.passed
        forces.append([bar.force for bar in solver.scene.bars])
    np.testing.assert_allclose(*forces, rtol=1e-7)


@pytest.mark.ranks
def test_a_cable_ends_at_a_joint_that_its_balance_moves(comm):
    scene = sheet(comm, 1.0)
    tops = []
    for x, out in ((-1.0, -1.0), (5.0, 1.0)):
        top = scene.add_joint((x, 2.1, 0.1))
        scene.add_bar(Bar(1e4), (x, 2.1, -3.0), top)
        for y in (0.1, 4.1):
            scene.add_bar(Bar(1e4, tension_only=True), top, (x + 2 * out, y, -3.0))
        tops.append(top)
    solver = advanced(Solver(scene), pressure=0.5)
    cable = scene.lay_cable(Cable(3e3), tops, tension=5.0, name="ridge")
    solver.advance()
    step = solver.advance(L0={cable: 0.99 * cable.L0}, pressure=0.7)
    assert step.verification.passed
    for top, end, place in zip(tops, (cable.start, cable.end), cable.line[[0, -1]], strict=True):
        np.testing.assert_allclose(place, top.position, atol=1e-12)
        assert np.linalg.norm(top.position - top.first) > 1e-4
        pulls = sum(bar.pull(top) for bar in scene.bars if top in (bar.start, bar.end))
        np.testing.assert_allclose(pulls, end.reaction, atol=1e-7)
    assert cable.tension > 5.0
    with pytest.raises(InputError, match="the start of 'ridge' is fixed to the joint 'joint 1'"):
        solver.advance(move={cable: (0.0, 0.0, 1.0)})
    with pytest.raises(InputError, match="only its first and last point may be joints"):
        scene.lay_cable(Cable(1.0), [(0.0, 1.0, 0.0), tops[0], (4.0, 1.0, 0.0)])
    flat = scene.add_joint((0.0, 1.5, 0.0))
    with pytest.raises(PathError, match="which lies on the membrane"):
        scene.lay_cable(Cable(1.0), [flat, (4.0, 1.5, 0.0)])


@pytest.mark.ranks
def test_branches_and_checkpoints_have_the_bars(comm, folder):
    solver = tent(comm, folder / "run", False)
    scene = solver.scene
    solver.advance(load=0.5)
    before = [(bar.force, bar.L0, bar.points.copy()) for bar in scene.bars]
    with solver.branch("one guy gone"):
        guy = scene.bars[1]
        scene.remove_bar(guy)
        solver.advance(L0={scene.bars[1]: 1.001 * scene.bars[1].L0})
        assert abs(scene.bar("mast 0").force - before[0][0]) > 1e-3
    assert scene.bars[1] is guy
    for bar, (force, L0, points) in zip(scene.bars, before, strict=True):
        assert bar.force == force and bar.L0 == L0 and np.array_equal(bar.points, points)
    solver.save(folder / "point")
    solver.advance(load=1.0)
    forces = [bar.force for bar in scene.bars]
    del solver
    other = Solver(Scene(meshes.rectangle(comm, 4.0, 4.0, 1.0, structured=True), FOIL))
    other.load(folder / "point")
    assert [bar.name for bar in other.scene.bars] == [bar.name for bar in scene.bars]
    other.advance(load=1.0)
    np.testing.assert_allclose([bar.force for bar in other.scene.bars], forces, rtol=1e-6)
    again = tent(comm, folder / "run", True)
    again.advance(load=0.5)
    np.testing.assert_array_equal([bar.force for bar in again.scene.bars], [b[0] for b in before])
    del again
    third = tent(comm, folder / "run", True)
    third.scene.add_bar(Bar(1.0), (0, 0, -9.0), (1.0, 0, -9.0))
    with pytest.raises(InputError, match="at call 1 of advance the script is not the one"):
        third.advance(load=0.5)


def test_bars_of_a_checkpoint_replace_those_of_the_script(comm, tmp_path):
    """All of their data; handles of the same name stay good."""
    folder, (scene, _) = Path(comm.bcast(str(tmp_path))), mast(comm)
    solver = advanced(Solver(scene), load=1.0)
    solver.save(folder / "point")
    other, top = mast(comm, slack=1e-2)
    other.remove_bar("west")
    other.add_bar(Bar(3.0), top, (-1.0, 9.0, 0.0), name="west")
    other.add_bar(Bar(3.0), top, (-2.0, 9.0, 0.0), name="not in it")
    west, again = other.bar("west"), Solver(other)
    again.load(folder / "point")
    assert [bar.name for bar in other.bars] == [bar.name for bar in scene.bars]
    assert other.bar("west") is west and west.bar == scene.bar("west").bar
    again.advance(load=2.0)
    solver.advance(load=2.0)
    forces = [[bar.force for bar in one.bars] for one in (other, scene)]
    np.testing.assert_allclose(*forces, rtol=1e-7)


def test_what_is_written_has_the_bars(comm, folder):
    scene, _ = mast(comm)
    solver = advanced(Solver(scene, results=folder), load=1.0)
    assert solver.history["force west"][-1] == scene.bar("west").force
    assert solver.history["bar L0 mast"][-1] == 6.0
    lines = bar_lines(scene.bars)
    assert [line.name for line in lines] == ["mast", "west", "east"]
    draw(solver, folder / "mast.png")
    comm.Barrier()
    assert (folder / "mast.png").exists()
    assert (folder / "cables.pvd").exists()


@pytest.mark.ranks
def test_joints_that_nothing_holds_are_refused(comm):
    scene = sheet(comm)
    solver = Solver(scene)
    lonely = scene.add_joint((0.0, 0.0, 5.0), name="lonely")
    with pytest.raises(InputError, match=r"nothing holds Joint\('lonely'\): no bar ends there"):
        solver.advance()
    other = scene.add_joint((1.0, 0.0, 5.0))
    scene.add_bar(Bar(1.0), lonely, other)
    with pytest.raises(InputError, match="no bars connect it to a support"):
        solver.advance()
    assert not solver.steps
    scene.add_bar(Bar(1.0), other, scene.vertex_at((2.0, 2.0, 0.0)))
    with warnings.catch_warnings(record=True) as caught:  # a chain that nothing loads
        warnings.simplefilter("always")
        step = solver.advance()
    assert [one.category for one in caught] == [InstabilityWarning] * (comm.rank == 0)
    assert "nothing holds '" in step.warnings[0].text


def test_bad_input(comm):
    scene, top = mast(comm)
    foreign = sheet(comm).add_joint((0.0, 0.0, 1.0))
    mesh = meshes.rectangle(comm, 4.0, 4.0, 1.0, structured=True)
    corner = Scene(mesh, FOIL).vertex_at((1.0, 0.0, 0.0))
    foot, changes = (9.0, 9.0, 0.0), scene.versions.model_version
    bad = {
        "no length": lambda: scene.add_bar(Bar(1.0), top, top),
        "are at .0, 9, 6., so": lambda: scene.add_bar(Bar(1.0), (0.0, 9.0, 6.0), top),
        "tension_only = 3 must": lambda: Bar(1.0, tension_only=3),
        "bar 1.: .* is not a joint of": lambda: scene.add_bar(Bar(1.0), foreign, foot),
        "mesh has no such vertex": lambda: scene.add_bar(Bar(1.0), top, corner),
        "there is no joint ..x": lambda: scene.joint(["x"]),
        "three finite numbers": lambda: scene.add_bar(Bar(1.0), top, (1.0, np.nan, 0.0)),
        "L0 of 'bar 1' = -1.0 is not": lambda: scene.add_bar(Bar(1.0), top, foot, L0=-1.0),
        "there is a bar 'west'": lambda: scene.add_bar(Bar(1.0), top, foot, name="west"),
        "without blanks around it": lambda: scene.add_bar(Bar(1.0), top, foot, name=" "),
        "has no group|no group of edges": lambda: scene.add_bar(Bar(1.0), top, "nowhere"),
        "has 3 vertices; name one": lambda: scene.add_bar(Bar(1.0), top, "left"),
        "the nearest is 1.41 away, at .[24], [24], 0.": lambda: scene.vertex_at((3.0, 3.0, 0.0)),
        "there is a joint 'top'": lambda: scene.add_joint(foot, name="top"),
        "made of the letters": lambda: scene.add_joint(foot, held="q"),
        "position = 3 must be three": lambda: scene.add_joint(3),
        "put_joint_load: .* is not a joint of this scene": lambda: scene.put_joint_load(
            {foreign: foot}, name="a"
        ),
        "write .joint:": lambda: scene.put_joint_load({}, name="a"),
        "load 'wind' already": lambda: scene.put_joint_load({top: foot}, name="wind"),
        "there is no bar 'x'": lambda: scene.remove_bar("x"),
        "expected a laid cable or a bar": lambda: Solver(scene).advance(L0={top: 1.0}),
        "not a joint of this scene": lambda: Solver(scene).advance(move={foreign: foot}),
        "L0 of 'west' = 0 is not": lambda: Solver(scene).advance(L0={scene.bar("west"): 0}),
    }
    for words, call in bad.items():
        with pytest.raises(InputError, match=words):
            call()
    assert scene.versions.model_version == changes
    assert len(scene.joints) == 4 and len(scene.bars) == 3
