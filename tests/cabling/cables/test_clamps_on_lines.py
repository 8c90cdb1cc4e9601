"""Clamps of cables along lines of the mesh, at the vertices that they share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from grids import alternating, grid, numbered
from lined.strings import clamped
from mpi4py import MPI
from scipy.optimize import fsolve, minimize

from crms_fenicsx import Cable, Friction, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array

pytestmark = pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")

FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0)
EA = 1e3
LINES = {
    "a": [(0.0, 4.0), (10.0, 6.0)],
    "b": [(4.0, 0.0), (6.0, 10.0)],
    "c": [(0.0, 0.0), (10.0, 10.0)],
}


def lined_square(
    comm: MPI.Intracomm, names: str = "ab", size: float = 1.3, scale: float = 1.0
) -> MembraneMesh:
    """A square with lines that meet in its middle."""
    lines = {name: [(scale * x, scale * y) for x, y in LINES[name]] for name in names}
    return meshes.rectangle(comm, 10.0 * scale, 10.0 * scale, size * scale, lines=lines)


def on_half(x: Array, n: Array) -> Array:
    return np.stack([0 * x[0], 0 * x[0], -1.0 * (x[0] < 5.0)])


def crossed(
    comm: MPI.Intracomm, friction: float | Friction = 0.0, names: str = "ab", rtol: float = 1e-11
) -> tuple[Scene, Solver]:
    """The square with cables along its lines, and a load on its left half."""
    scene = Scene(lined_square(comm, names), FABRIC)
    scene.fix("boundary")
    for name in names:
        scene.lay_cable(Cable(EA, friction=friction), along=name, tension=5.0)
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
        held, [-48.379695, 23.080449, 23.718826, 23.199372, 22.902571], rtol=5e-5
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
            heat["there"] = scene.dissipated
            solver.advance(load={"half": 0.0})
            heat["back"] = scene.dissipated
    assert heat["there"] > 1e-3 and heat["back"] >= heat["there"]
    # up to where the mesh around the rows was last renewed
    np.testing.assert_allclose(found[1e3], found[None], rtol=1e-3)
    np.testing.assert_allclose(found[1e-4], found[0.0], rtol=1e-3)
    differences = [after - before for _, before, after in found.values()]
    assert differences[0] == pytest.approx(differences[1], rel=0.02)
    assert differences[0] > 2 * differences[2] > 0.5 and abs(differences[3]) < 2e-4


@pytest.mark.ranks
def test_clamped_cables_in_the_air_share_one_point(comm: MPI.Intracomm) -> None:
    """Three cables lift off together: six straight parts with the energy least at their place. Let
    down again they lie as before."""
    scene = Scene(lined_square(comm, "abc"), FABRIC)
    scene.fix("boundary")
    anchors = {
        name: (1.1 * np.array([p, q]) - 0.1 * np.array([q, p])) for name, (p, q) in LINES.items()
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


def test_refused_clamps(comm: MPI.Intracomm) -> None:
    scene, solver = crossed(comm, names="abc")
    free = scene.lay_cable(Cable(EA), [(0.0, 8.0), (10.0, 9.0)], name="free")
    with pytest.raises(InputError, match="'a' lies along a line of the mesh, 'free' does not"):
        scene.clamp("a", free)
    scene.remove(free)
    scene.clamp("a", "b", slip=0.3)
    with pytest.raises(InputError, match=r"'a x b' and 'a x c' have slip = 0\.3 and None"):
        scene.clamp("a", "c")
    assert len(scene.clamps) == 1
    with pytest.raises(InputError, match="'a x b' would hold the fabric too"):
        Solver(scene, slide=False).advance(pressure=1.0)
    solver.advance(pressure=1.0)
