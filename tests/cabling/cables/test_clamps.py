"""Clamps: one tension from clamp to clamp, points that stay together, on or off the membrane."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced
from grids import alternating, grid, numbered
from lined.strings import clamped
from mpi4py import MPI
from scipy.optimize import fsolve, minimize
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
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.cable import Hold

pytestmark = pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")

FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0)
EA = 1e3
LINES = {
    "a": [(0.0, 4.0), (10.0, 6.0)],
    "b": [(4.0, 0.0), (6.0, 10.0)],
    "c": [(0.0, 0.0), (10.0, 10.0)],
    "low": [(0.0, 2.4), (10.0, 2.9)],
    "high": [(0.0, 7.6), (10.0, 8.1)],
}


def lined_square(
    comm: MPI.Intracomm, names: Sequence[str] = "ab", size: float = 1.3, scale: float = 1.0
) -> MembraneMesh:
    """A square with lines, of which those of one letter meet in its middle."""
    lines = {name: [(scale * x, scale * y) for x, y in LINES[name]] for name in names}
    return meshes.rectangle(comm, 10.0 * scale, 10.0 * scale, size * scale, lines=lines)


def on_half(x: Array, n: Array) -> Array:
    return np.stack([0 * x[0], 0 * x[0], -1.0 * (x[0] < 5.0)])


def crossed(
    comm: MPI.Intracomm, friction: float | Friction = 0.0, names: Sequence[str] = "ab",
    rtol: float = 1e-11, hold: Hold = "outside",
) -> tuple[Scene, Solver]:  # fmt: skip
    """The square with cables along its lines, and a load on its left half."""
    scene = Scene(lined_square(comm, names), FABRIC)
    scene.fix("boundary")
    for name in names:
        scene.lay_cable(Cable(EA, friction=friction), along=name, tension=5.0, hold=hold)
    scene.put_load(on_half, name="half")
    return scene, Solver(scene, rtol=rtol)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("seed", "families"), [(34, (3, 3)), (35, (3, 3)), (15, (1, 3)), (8, (2, 2))]
)
def test_clamped_nets_on_a_rigid_sheet_are_strings(seed: int, families: tuple[int, int]) -> None:
    """Clamped as laid or later, with slack parts and without."""
    net = clamped(seed, *families)
    assert net.error < 1e-6 and not net.told
    assert net.way > 1e-3


RADIUS, WIDTH, MU, PULL = 3.0, 6.0, 0.15, 0.3


def half_cylinder(comm: MPI.Intracomm, size: float) -> MembraneMesh:
    """A half cylinder with lines around it and along its crown."""
    n, m = 2 * round(np.pi * RADIUS / size / 2), 2 * round(WIDTH / size / 2)
    angles, along = np.linspace(0.0, np.pi, n + 1), np.linspace(0.0, WIDTH, m + 1)
    flat, cells = grid(angles, along, lambda x, y: 0 * x, alternating(n, m))
    points = np.column_stack(
        [-RADIUS * np.cos(flat[:, 0]), flat[:, 1], RADIUS * np.sin(flat[:, 0])]
    )
    numbers = numbered(n + 1, m + 1)
    rows = {"hoop": numbers[:, m // 2], "crown": numbers[n // 2]}
    lines = {name: np.stack([row[:-1], row[1:]], axis=1) for name, row in rows.items()}
    return meshes.from_arrays(comm, points, cells, edges=lines, outside=(0.0, 0.0, 1.0))


def test_a_clamp_on_a_cable_with_friction_along(comm: MPI.Intracomm) -> None:
    """Over a rigid half cylinder, drawn at one end: the law of capstans on both sides of the clamp,
    and balance with the kinked cable along the crown."""
    EA_hoop, EA_crown = 1000.0, 3000.0
    scene = Scene(half_cylinder(comm, 0.4), IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0))
    scene.fix(lambda x: np.full(x.shape[1], True))
    crown = scene.lay_cable(Cable(EA_crown), along="crown", L0=0.98 * WIDTH)
    ends = [(-RADIUS, WIDTH / 2, -1.0), (RADIUS, WIDTH / 2, -1.0)]
    rope = Cable(EA_hoop, friction=Friction(0.0, along=MU))
    hoop = scene.lay_cable(rope, ends, along="hoop")
    solver = Solver(scene)
    solver.advance(L0={hoop: 0.999 * hoop.L0})
    (clamp,) = scene.clamp("hoop", "crown")
    L0 = hoop.L0 * np.array([clamp.at[0], 1 - clamp.at[0]])
    solver.advance(move={hoop.end: (0.0, 0.0, -PULL)}, steps=2)
    nodes, weights = np.polynomial.legendre.leggauss(20)

    def arc(tension: float, angle: float) -> float:
        """Unstressed length of a cable drawn around an angle."""
        strains = tension * np.exp(MU * angle * (nodes + 1) / 2) / EA_hoop
        return float(RADIUS * angle * (weights / 2 / (1 + strains)).sum())

    def balance(unknowns: Array) -> Array:
        way, start, after = unknowns
        first, second = np.pi / 2 + way / RADIUS, np.pi / 2 - way / RADIUS
        part = np.hypot(WIDTH / 2, way)
        last = 1 + after * np.exp(MU * second) / EA_hoop
        return np.array([
            1 / (1 + start / EA_hoop) + arc(start, first) - L0[0],
            arc(after, second) + (1 + PULL) / last - L0[1],
            after - start * np.exp(MU * first)
            - 2 * EA_crown * (2 * part / crown.L0 - 1) * way / part,
        ])  # fmt: skip

    way, start, after = fsolve(balance, [0.05, 5.0, 10.0], xtol=1e-12)
    place = scene.clamps[0].place
    found = [RADIUS * np.arctan2(place[0], place[2]), *hoop.tensions[[0, -1]]]
    right = [way, start, after * np.exp(MU * (np.pi / 2 - way / RADIUS))]
    np.testing.assert_allclose(found, right, rtol=0.04)  # the cylinder is a polygon of 24 sides
    assert np.abs(scene.u.x.array).max() < 1e-12


def state_of(scene: Scene) -> list[float]:
    return [scene.energy, *(cable.tension for cable in scene.cables)]


@pytest.mark.ranks
def test_tensions_balance_at_a_clamp(comm: MPI.Intracomm) -> None:
    """Under load on one half; opened and unloaded it is the sliding net again, up to where the mesh
    around the rows was last renewed."""
    scene, solver = crossed(comm)
    solver.advance(pressure=2.0)
    solver.advance(load={"half": 1.0})
    slid = state_of(scene)
    solver.advance(load={"half": 0.0})
    before = state_of(scene)
    scene.clamp("a", "b")
    solver.advance(load={"half": 1.0})
    assert solver.steps[-1].verification.passed
    assert scene.energy > slid[0]  # it holds what would slide
    a, b = scene.cables
    force = solver.clamp_forces()["a x b"]
    assert len(set(np.round(a.tensions, 9))) == 2 and len(set(np.round(b.tensions, 9))) == 2
    assert force.before == (a.tensions[0], b.tensions[0])
    assert force.after == (a.tensions[-1], b.tensions[-1])
    assert abs(force.differences[0]) > 0.2
    # what the one hands on the other takes, but for the pressure on the facets around
    assert force.size == pytest.approx(float(np.hypot(*force.differences)), rel=0.2)
    held = [scene.energy, a.tensions[0], a.tensions[-1], b.tensions[0], b.tensions[-1]]
    np.testing.assert_allclose(
        held, [-48.365289, 23.133151, 23.665963, 23.167525, 22.910229], rtol=5e-5
    )  # the same on any number of processes
    scene.unclamp("a", "b")
    solver.advance(load={"half": 0.0})
    np.testing.assert_allclose(state_of(scene), before, rtol=1e-3)
    assert not scene.clamps and a.state.law.parts is None


def test_clamping_changes_nothing_in_an_equilibrium(comm: MPI.Intracomm) -> None:
    scene, solver = crossed(comm, names="abc")
    solver.advance(pressure=2.0, load={"half": 1.0})
    before = state_of(scene)
    assert len(scene.clamp(*scene.cables)) == 3
    solver.advance()
    np.testing.assert_allclose(state_of(scene), before, rtol=1e-8)
    for cable in scene.cables:
        np.testing.assert_allclose(cable.tensions, cable.tension, rtol=1e-8)


@pytest.mark.ranks
def test_clamps_of_limited_grip(comm: MPI.Intracomm) -> None:
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
            (clamp,) = scene.clamps
            assert clamp.at[0] * a.L0 == pytest.approx(a.part_lengths[0], abs=2e-5)
            heat["there"] = scene.dissipated
            solver.advance(load={"half": 0.0})
            heat["back"] = scene.dissipated
    assert heat["there"] > 1e-3 and heat["back"] >= heat["there"]
    # up to where the mesh around the rows was last renewed
    np.testing.assert_allclose(found[1e3], found[None], rtol=1e-3)
    np.testing.assert_allclose(found[1e-4], found[0.0], rtol=1e-3)
    differences = [after - before for _, before, after in found.values()]
    assert differences[0] == pytest.approx(differences[1], rel=0.02)
    assert differences[0] > 1.5 * differences[2] > 0.4 and abs(differences[3]) < 2e-4


@pytest.mark.ranks
def test_clamped_cables_in_the_air_share_one_point(comm: MPI.Intracomm) -> None:
    """Three cables lift off together: six straight parts with the energy least at their place. Let
    down again they lie as before."""
    scene = Scene(lined_square(comm, "abc"), FABRIC)
    scene.fix("boundary")
    anchors = {
        name: 1.1 * np.array(LINES[name]) - 0.1 * np.array(LINES[name][::-1]) for name in "abc"
    }
    cables = [scene.lay_cable(Cable(1e6), np.pad(ends, ((0, 0), (0, 1))), along=name, tension=9e3)
              for name, ends in anchors.items()]  # fmt: skip
    assert len(scene.clamp(*cables)) == 3
    at = {
        name: share for one in scene.clamps for name, share in zip(one.cables, one.at, strict=True)
    }
    solver, move = Solver(scene), {}
    for k, cable in enumerate(cables):
        move |= {cable.start: (-0.1, 0.0, 1.0 + 0.2 * k), cable.end: (0.05 * k, 0.1, 1.5 - 0.1 * k)}
    solver.advance(move=move)
    assert solver.steps[-1].verification.passed
    assert all(len(cable.line) == 3 and cable.free_spans.all() for cable in cables)
    parts = [(cable.line[end], cable.L0 * share) for cable in cables
             for end, share in ((0, at[cable.name]), (-1, 1 - at[cable.name]))]  # fmt: skip

    def strains(x: Array) -> Array:
        return np.array([np.linalg.norm(x - end) / L - 1 for end, L in parts])

    lengths = np.array([L for _, L in parts])
    least = minimize(
        lambda x: strains(x) ** 2 @ lengths,
        scene.clamps[0].place,
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-16},
    )
    np.testing.assert_allclose(scene.clamps[0].place, least.x, atol=1e-5)
    tensions = np.concatenate([cable.tensions for cable in cables])
    np.testing.assert_allclose(tensions, 1e6 * strains(scene.clamps[2].place), rtol=1e-6)
    solver.advance(move={end: -np.array(way) for end, way in move.items()})
    tensions = np.concatenate([cable.tensions for cable in cables])
    np.testing.assert_allclose(tensions, 9e3, rtol=1e-9)


def test_slipped_clamps_in_checkpoints(comm: MPI.Intracomm, folder: Path) -> None:
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
        runs.append(
            [scene.energy, scene.dissipated, *scene.clamps[0].at, *scene.cables[0].tensions]
        )
    np.testing.assert_allclose(*runs, rtol=1e-8)


@pytest.mark.parametrize("clamp_first", [True, False])
def test_the_order_of_loads_does_not_matter(comm: MPI.Intracomm, clamp_first: bool) -> None:
    """There is no dissipation, and so one state: at once, one after the other, by way of more."""
    found = []
    for loads in ([(1, 1)], [(1, 0), (1, 1)], [(0, 1), (1, 1)], [(2, 2), (1, 1)]):
        scene, solver = crossed(comm, names="abc")
        scene.put_load((0.3, 0.0, 0.0), name="wind")
        if clamp_first:
            scene.clamp(*scene.cables)
        solver.advance(pressure=2.0)
        if not clamp_first:
            scene.clamp(*scene.cables)
        for half, wind in loads:
            solver.advance(load={"half": half, "wind": wind})
        found.append([scene.energy, *np.concatenate([cable.tensions for cable in scene.cables])])
    np.testing.assert_allclose(found[1:], [found[0]] * 3, rtol=5e-4)


def test_units_do_not_matter(comm: MPI.Intracomm) -> None:
    """Lengths in thousandths, forces times 1000."""
    found = []
    for length, force in ((1.0, 1.0), (1e3, 1e3), (1e-3, 1e-3)):
        stress = force / length
        scene = Scene(
            lined_square(comm, "abc", scale=length),
            IsotropicMembrane(E=300.0 * stress, nu=0.25, thickness=1.0, prestress=stress),
        )
        scene.fix("boundary")
        for name in "abc":
            scene.lay_cable(Cable(EA * force), along=name, tension=5.0 * force)
        scene.clamp(*scene.cables, slip=0.1 * force)
        solver = Solver(scene, rtol=1e-10)
        solver.advance(pressure=2.0 * stress / length)
        solver.advance(L0={scene.cables[0]: 0.99 * scene.cables[0].L0})
        parts = np.concatenate([cable.tensions for cable in scene.cables]) / force
        found.append([scene.energy / (force * length), *parts, scene.dissipated / (force * length)])
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-5)


@pytest.mark.ranks
def test_clamps_survive_checkpoints_branches_and_lengths(comm: MPI.Intracomm, folder: Path) -> None:
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


def test_clamps_near_places_and_of_removed_cables(comm: MPI.Intracomm) -> None:
    scene, solver = crossed(comm, names=("a", "b", "low"))
    (clamp,) = scene.clamp("a", "b", "low", near=[(5.0, 2.0, 0.0)])
    assert clamp.name == "b x low"
    (more,) = scene.clamp(*scene.cables)
    assert more.name == "a x b" and scene.clamp(*scene.cables) == ()
    solver.advance(pressure=1.0)
    assert [len(scene.cable(name).tensions) > 2 for name in "ab"]
    assert [len(scene.cable(name).part_lengths) for name in "ab"] == [2, 3]
    assert "clamp" in repr(solver.summary())
    assert set(solver.summary().clamps) == {"b x low", "a x b"}
    scene.unclamp("b", "low", near=[(5.0, 2.2, 0.0)])
    scene.remove("a")
    assert scene.clamps == ()
    solver.advance()
    assert scene.cable("b").state.law.parts is None


def middle_lines(comm: MPI.Intracomm, n: int, rows: Sequence[int], side: float) -> MembraneMesh:
    """A square of n by n squares, cut by one diagonal, with lines along some of its rows: both
    families look the same."""
    line = np.linspace(0.0, side, n + 1)
    points, cells = grid(line, line)
    numbers = numbered(n + 1, n + 1)
    ways = {
        f"{family}{k}": own[k] for k in rows for family, own in (("A", numbers.T), ("B", numbers))
    }
    edges = {name: np.stack([way[:-1], way[1:]], axis=1) for name, way in ways.items()}
    return meshes.from_arrays(comm, points, cells, edges=edges)


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_clamped_cables_are_tightened_one_after_the_other(
    comm: MPI.Intracomm, order: tuple[int, int]
) -> None:
    """The square is the same along both, and so are the forces of the parts."""
    mesh = middle_lines(comm, 10, [5], 14.0)
    scene = Scene(mesh, IsotropicMembrane(E=400.0, nu=0.25, thickness=1.0))
    scene.fix("boundary")
    cables = [scene.lay_cable(Cable(EA=5e3), along=name) for name in ("A5", "B5")]
    solver = advanced(Solver(scene), pressure=0.3)
    scene.clamp(*cables)
    for k in order:
        step = solver.advance(L0={cables[k]: 0.995 * cables[k].L0})
        assert step.verification.passed
    tensions = np.concatenate([cable.tensions for cable in cables])
    np.testing.assert_allclose(tensions, tensions.mean(), rtol=1e-3)


@pytest.mark.ranks
@pytest.mark.parametrize(("cables", "rtol"), [(7, 1e-9), (3, 0.01)])
def test_a_clamped_net_in_pockets_against_bars_between_shared_nodes(
    comm: MPI.Intracomm, cables: int, rtol: float
) -> None:
    """Clamped at each vertex it is the net that is bonded there; with fewer clamps its cables slide
    in their pockets between them."""
    n, step = 8, 10 / 8
    rows = [n * k // (cables + 1) for k in range(1, cables + 1)]
    net, barred = (Scene(middle_lines(comm, n, rows, 10.0), FABRIC) for _ in range(2))
    for scene in (net, barred):
        scene.fix("boundary")
    for k in rows:
        for family in "AB":
            net.lay_cable(Cable(EA), along=f"{family}{k}", tension=2.0, measured_on="facets",
                          hold="pocket")  # fmt: skip
    net.clamp(*net.cables)
    bars = {}
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


def test_a_clamp_slides_over_cells(comm: MPI.Intracomm) -> None:
    """One cable is laid askew, so that its clamp pulls it back as soon as the other tightens: to
    the place at which energy and tensions are those of cables that cross cells, on cells of 3."""
    routes = {"across": [(0, 67), (100, 67)], "along": [(34, 0), (31, 40), (34, 100)]}
    mesh = meshes.rectangle(comm, 100.0, 100.0, 5.0, lines=routes)
    scene = Scene(mesh, IsotropicMembrane(E=3500.0, nu=0.3, thickness=0.08, prestress=0.05))
    scene.fix("boundary")
    cables = [scene.lay_cable(Cable(14e3), along=name, L0=100.0) for name in routes]
    scene.clamp(*cables)
    solver = Solver(scene)
    for pressure, W, T in (
        (0.001, -5.4151, (7.258, 14.379)),
        (0.002, -14.8974, (12.055, 19.042)),
    ):
        step = solver.advance(pressure=pressure)
        assert step.verification is not None and not step.verification.doubtful
        assert scene.energy == pytest.approx(W, rel=4e-3)
        assert [cable.tension for cable in cables] == pytest.approx(T, rel=3e-3)


def test_taylor_of_cables_that_slip_through_clamps(comm: MPI.Intracomm) -> None:
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


@pytest.mark.ranks
@pytest.mark.parametrize(("hold", "rtol"), [("pocket", 3e-5), ("outside", 1e-3)])
def test_friction_along_cables_between_clamps(comm: MPI.Intracomm, hold: Hold, rtol: float) -> None:
    """With little of it the net is the one without; with more the tension goes on changing from
    the clamp, at which it jumps, to the anchors."""
    found = {}
    for along in (0.0, 1e-4, 0.05):
        rough = Friction(0.0, along=along) if along else 0.0
        scene, solver = crossed(comm, rough, rtol=1e-10, hold=hold)
        (clamp,) = scene.clamp("a", "b")
        solver.advance(pressure=2.0)
        solver.advance(load={"half": 1.0})
        assert solver.steps[-1].verification.passed
        a = scene.cable("a")
        found[along] = [scene.energy, *a.tensions[[0, -1]]]
        force = solver.clamp_forces()["a x b"]
        if along == 0.05:
            steps = np.abs(np.diff(a.tensions))
            assert np.count_nonzero(steps > 1e-4) > 5
            assert steps.max() == pytest.approx(abs(force.differences[0]), rel=1e-6)
            arcs = a.state.law.axial.arcs
            rest = arcs[np.argmin(np.abs(arcs - clamp.at[0] * a.L0))]
            assert rest == pytest.approx(clamp.at[0] * a.L0, abs=1e-6 * a.L0)
            solver.advance(L0={a: 0.999 * a.L0})
            assert solver.steps[-1].verification.passed
    np.testing.assert_allclose(found[1e-4], found[0.0], rtol=rtol)
    assert abs(found[0.05][0] / found[0.0][0] - 1) > 1e-6


@pytest.mark.ranks
def test_slipping_clamps_on_cables_with_friction_along(comm: MPI.Intracomm) -> None:
    """The grip bounds the difference of tensions as without friction; with much it holds as
    without a limit, with hardly any the cables slide as if unclamped. Clamping changes nothing."""
    found = {}
    for slip in (None, 1e3, 0.1, 1e-4, 0.0):
        scene, solver = crossed(comm, Friction(0.0, along=0.05), rtol=1e-10, hold="pocket")
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
        if slip == 0.1:
            force = 0.1 / (1 + a.tension / EA)
            differences = np.abs(solver.clamp_forces()["a x b"].differences)
            assert differences[0] == pytest.approx(force, rel=1e-3)
            assert scene.dissipated > 1e-3
            solver.advance()
            again = [scene.energy, *a.tensions[[0, -1]]]
            np.testing.assert_allclose(again, found[slip], rtol=1e-7)
    np.testing.assert_allclose(found[1e3], found[None], rtol=2e-5)
    # its grip is all that holds a cable at the clamp's vertex
    np.testing.assert_allclose(found[1e-4], found[0.0], rtol=2e-3)
    assert found[None][0] > found[0.1][0] > found[1e-4][0]


def test_energies_of_all_friction_are_added(comm: MPI.Intracomm, folder: Path) -> None:
    """The energy of slipping clamps, of friction sideways and of friction along, each on cables of
    its own, is what is minimised without the heat of the step; so it is after a checkpoint."""
    found = []
    rubbing = {"low": Friction(0.05), "high": Friction(0.0, along=0.1)}
    for saved in (True, False):
        scene = Scene(lined_square(comm, ("a", "b", *rubbing), 1.6), FABRIC)
        scene.fix("boundary")
        for name in ("a", "b", *rubbing):
            rope = Cable(EA, friction=rubbing.get(name, 0.0))
            scene.lay_cable(rope, along=name, tension=5.0)
        scene.clamp("a", "b", slip=0.3)
        scene.put_load(on_half, name="half")
        scene.put_load((0.0, 0.5, 0.0), name="drag")
        solver = Solver(scene, rtol=1e-11)
        if saved:
            solver.advance(pressure=2.0, load={"half": 1.0, "drag": 1.0})
            solver.save(folder / "state")
            last = scene.energies
        else:
            solver.load(folder / "state")
            assert scene.energies == last
        spent = scene.dissipated
        solver.advance(load={"half": 0.5, "drag": 2.0})
        grips = [scene.cable(name).state.law for name in ("a", "low", "high")]
        assert grips[0].parts is not None and grips[0].parts.dissipated > 1e-4
        assert grips[1].lateral is not None and grips[1].lateral.dissipated > 1e-4
        assert grips[2].axial is not None and grips[2].axial.dissipated > 1e-4
        heat = scene.dissipated - spent
        # slips sideways count as linear in a minimisation; all shares are larger by far
        assert scene.energy == pytest.approx(solver.system.objective - heat, abs=1e-8)
        found.append(list(scene.energies.values()))
    np.testing.assert_allclose(*found, rtol=1e-3)  # as friction forces settle


def test_clamps_with_friction_in_a_cone(comm: MPI.Intracomm) -> None:
    """Below the net whose friction is a box."""
    energies = {}
    for cone in (True, False):
        scene, solver = crossed(comm, Friction(0.2, along=0.2, cone=cone), rtol=1e-10)
        scene.clamp("a", "b")
        solver.advance(pressure=2.0)
        solver.advance(load={"half": 1.0})
        assert solver.steps[-1].verification.passed
        energies[cone] = scene.energy
    assert energies[True] < energies[False]


@pytest.mark.ranks
def test_clamps_and_bonds_in_all_that_is_written(comm: MPI.Intracomm, folder: Path) -> None:
    """History, series for ParaView, combinations and report, of a net whose clamp slips."""
    scene = Scene(lined_square(comm, ("a", "b", "high")), FABRIC)
    scene.fix("boundary")
    for name in "ab":
        scene.lay_cable(Cable(EA), along=name, tension=5.0)
    scene.lay_cable(Cable(EA), along="high", hold="bonded", name="c")
    scene.put_load(on_half, name="half")
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
        assert float(calm["Force"]) < 0.02 * force.size
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


@pytest.mark.ranks
def test_lengths_to_order(comm: MPI.Intracomm, folder: Path) -> None:
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
    assert "measured at 20 K below the model" in text and "Foundations" in text and "a x b" in text
    sums = (folder / "net_foundations.csv").read_text().splitlines()
    pull = -a.start.reaction
    found = [float(x) for x in sums[1].split(",")[2:]]
    flat = np.hypot(*pull[:2])
    np.testing.assert_allclose(found[:3], pull, atol=1e-9)
    np.testing.assert_allclose(found[3:5], [np.linalg.norm(pull), flat])
    assert found[6] == pytest.approx(np.degrees(np.arctan2(pull[2], flat)))
    both = [float(x) for x in sums[2].split(",")[2:5]]
    np.testing.assert_allclose(both, pull - a.end.reaction, atol=1e-5)
    assert "a x b" in (folder / "net_clamps.csv").read_text()
    for options, message in (
        ({"order": 3}, "order = 3; pass what nets.lengths_to_order"),
        ({"foundations": {"F": ["z end"]}}, "foundation 'F' carries .'z end'."),
        ({"foundations": ["a start"]}, "write names of cables"),
    ):
        with pytest.raises(InputError, match=message):
            solver.report(folder / "other.html", **options)
    with pytest.raises(InputError, match="the scene has no cables"):
        nets.lengths_to_order(Scene(lined_square(comm), FABRIC))
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
def test_refused_clamps(comm: MPI.Intracomm) -> None:
    scene = Scene(lined_square(comm, tuple(LINES)), FABRIC)
    scene.fix("boundary")
    for name in LINES:
        law = "step" if name == "high" else "total"
        # "b" passes above the membrane, from anchor to anchor
        above = [(3.8, -1.0, 3.0), (6.2, 11.0, 3.0)] if name == "b" else None
        scene.lay_cable(Cable(EA, law=law), above, along=name, tension=5.0, name=name)
    bad = [
        (lambda: scene.clamp("a", "a"), "the cables are a, a; pass two or more different ones"),
        (lambda: scene.clamp("a"), "two or more different"),
        (lambda: scene.clamp("a", "x"), "no cable 'x'"),
        (lambda: scene.clamp("a", 3), "3 is not a cable of this scene"),
        (lambda: scene.clamp("a", "low"), "'a' and 'low' do not cross between their ends; lay one"),
        (lambda: scene.clamp("c", "high"), """'high' has law="step", with which its tension"""),
        (lambda: scene.clamp("a", "c", slip=-1.0), "clamp: slip"),
        (lambda: scene.clamp("a", "b"), r"'a' and 'b' lie 3 apart where they cross"),
        (lambda: scene.clamp("a", "c", near="here"), "near = 'here'"),
        (lambda: scene.unclamp("a", "c"), "there is no such clamp; the scene has none"),
    ]
    for call, message in bad:
        with pytest.raises(InputError, match=message):
            call()
        assert scene.clamps == ()
    warned = pytest.warns(NetWarning, match="3 crossings left open: 'a' and 'b'")
    with warned if comm.rank == 0 else nullcontext():
        assert len(scene.clamp("a", "b", "c", "low")) == 2
    scene.unclamp("a", "c")
    scene.clamp("a", "c", slip=0.3)
    scene.remove("b")
    with pytest.raises(InputError, match="'c x low' would hold the fabric too"):
        Solver(scene, slide=False).advance(pressure=1.0)


def test_cables_have_one_grip_where_three_meet(comm: MPI.Intracomm) -> None:
    scene, solver = crossed(comm, names="abc")
    scene.clamp("a", "b", slip=0.3)
    with pytest.raises(InputError, match=r"'a x b' and 'a x c' have slip = 0\.3 and None"):
        scene.clamp("a", "c")
    assert len(scene.clamps) == 1
    solver.advance(pressure=1.0)


@pytest.mark.ranks
def test_clamps_of_cables_across_the_cells_are_refused(comm: MPI.Intracomm) -> None:
    """By name, with the call that makes lines, and before any cable of a net is laid."""
    scene, _ = crossed(comm)
    for name, y in (("free", 8.0), ("other", 1.0)):
        scene.lay_cable(Cable(EA), [(0.0, y), (10.0, 9.0)], name=name)
    remedy = r"meshes\.along\(.* lay_net\(net, \.\.\.\) or lay_cable\(cable, along=\.\.\.\)"
    for cables, who in (
        (("a", "free"), "'free' lies across"),
        (("free", "other"), "'free' and 1 other lie across"),
    ):
        with pytest.raises(InputError, match=f"clamp: {who} the cells of the mesh; .*{remedy}"):
            scene.clamp(*cables)
    bare = Scene(meshes.rectangle(comm, 10.0, 10.0, 2.0), FABRIC)
    net = nets.sections(bare, angles=(0.0, np.pi / 2), offsets=[-3.0, 3.0], center=(5.0, 5.0))
    with pytest.raises(InputError, match=f"clamp: 'A1' and 3 others lie across .*{remedy}"):
        bare.lay_net(net, Cable(EA), clamped=True)
    assert scene.clamps == () and bare.cables == () and bare.net.laid == 0
