"""Cables over holes of the membrane, which they span as they span hollows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from grids import grid
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, PathError, Scene, Solver, meshes, nets
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh

EA = 1000.0
MEMBRANE = IsotropicMembrane(E=1e4, nu=0.3, thickness=1.0)


def sheet(
    comm: MPI.Intracomm,
    n: int,
    hole: tuple[float, float, float, float, float],
    *,
    ridge: float = 0.0,
    unit: float = 1.0,
    seed: int | None = None,
) -> MembraneMesh:
    """A square of 10 m, n x n cells of two triangles, but those whose middle has x + lean y from a
    to b and y from c to d; `hole` is (a, b, c, d, lean). With a ridge along x = 5 m of that height.
    Renumbered at random with a seed."""
    a, b, c, d, lean = hole
    line = np.linspace(0.0, 10.0, n + 1)
    points, cells = grid(
        line, line, lambda x, y: ridge * (1.0 - np.abs(x - 5.0) / 5.0), by_rows=True
    )
    y = np.tile(10 * (np.arange(n) + 0.5) / n, n)
    x = np.repeat(10 * (np.arange(n) + 0.5) / n, n) + lean * y
    there = ~((a < x) & (x < b) & (c < y) & (y < d))
    used, cells = np.unique(cells[np.repeat(there, 2)], return_inverse=True)
    cells = cells.reshape(-1, 3)
    points = unit * points[used]
    if seed is not None:
        rng = np.random.default_rng(seed)
        order = rng.permutation(len(points))
        points, cells = points[order], np.argsort(order)[cells][rng.permutation(len(cells))]
    sides = np.sort(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    at = points / unit
    outer = {
        name: sides[(np.abs(at[sides][:, :, k] - value) < 1e-9).all(axis=1)]
        for name, k, value in (
            ("left", 0, 0.0), ("right", 0, 10.0), ("front", 1, 0.0), ("back", 1, 10.0),
        )
    }  # fmt: skip
    groups = {name: np.unique(own, axis=0) for name, own in outer.items()}
    return meshes.from_arrays(
        comm, points, cells, edges={"all": np.unique(sides, axis=0), **groups}
    )


@pytest.mark.ranks
@pytest.mark.parametrize(("n", "unit", "seed"), [(6, 1.0, None), (10, 1000.0, 1), (10, 1.0, 2)])
def test_a_span_over_a_ridge_ends_where_the_whole_cable_is_shortest(
    comm: MPI.Intracomm, n: int, unit: float, seed: int | None
) -> None:
    """A rigid ridge roof with its ridge cut out: a straight line in the development, in which both
    ends of the span, on the hole's edges, have slid to."""
    mesh = sheet(comm, n, (3.5, 6.5, 2.0, 9.0, 0.0), ridge=3.0, unit=unit, seed=seed)
    scene = Scene(mesh, MEMBRANE)
    scene.fix("all")
    half = (5.0 / 3.0) if n == 6 else 1.0  # of the hole's width
    length = unit * np.hypot(2 * half + 2 * (5.0 - half) * np.hypot(1.0, 0.6), 3.5)
    route = unit * np.array([(0.0, 4.0), (10.0, 7.5)])
    cable = scene.lay_cable(Cable(EA=EA), route, L0=0.98 * length)
    Solver(scene).advance()
    assert cable.tension == pytest.approx(EA * 0.02 / 0.98, rel=1e-9)
    assert cable.length == pytest.approx(length, rel=1e-9)


@pytest.mark.ranks
@pytest.mark.parametrize(("unit", "seed"), [(1.0, None), (100.0, 3)])
def test_a_cable_over_an_oblique_hole_of_a_stretched_sheet_stays_straight(
    comm: MPI.Intracomm, unit: float, seed: int | None
) -> None:
    """Nothing presses, so the sheet leaves the cable alone, however the hole's edges move."""
    mesh = sheet(comm, 10, (5.4, 8.4, 2.0, 7.0, 0.5), unit=unit, seed=seed)
    scene = Scene(mesh, MEMBRANE)
    for side in ("left", "right"):
        scene.fix(side)
    scene.fix("all", "z")
    route = unit * np.array([(0.0, 3.2), (10.0, 6.1)])
    cable = scene.lay_cable(Cable(EA=EA), route, L0=10.3 * unit)
    way = (0.3 * unit, 0.1 * unit, 0.0)
    Solver(scene).advance(move={"right": way, cable.end: way})
    length = np.hypot(10.3, 3.0)
    assert cable.tension == pytest.approx(EA * (length - 10.3) / 10.3, rel=1e-6)
    assert np.abs(scene.u.x.array).max() > 0.3 * unit if comm.size == 1 else True


@pytest.mark.ranks
def test_a_crooked_route_is_pulled_straight_over_the_hole(comm: MPI.Intracomm) -> None:
    mesh = sheet(comm, 9, (3.0, 7.0, 3.0, 7.0, 0.0))
    scene = Scene(mesh, MEMBRANE)
    scene.fix("all")
    length = float(np.hypot(10.0, 7.0))
    path = [(0.0, 1.0), (5.0, 2.0), (7.4, 6.0), (10.0, 8.0)]
    cable = scene.lay_cable(Cable(EA=EA), path, L0=0.99 * length)
    Solver(scene).advance()
    # within the smoothing of lengths at kinks, as the straight line passes close to vertices
    assert cable.tension == pytest.approx(EA * 0.01 / 0.99, rel=1e-3)
    assert (~cable.state.lifted).sum() < len(cable.state.nodes)


@pytest.mark.ranks
def test_an_inner_corner_of_the_plan_is_spanned_as_a_hole(comm: MPI.Intracomm) -> None:
    scene = Scene(sheet(comm, 8, (5.0, 10.0, 5.0, 10.0, 0.0)), MEMBRANE)
    scene.fix("all")
    length = float(np.hypot(5.7, 7.3))
    cable = scene.lay_cable(Cable(EA=EA), [(4.3, 10.0), (10.0, 2.7)], L0=0.99 * length)
    Solver(scene).advance()
    assert cable.tension == pytest.approx(EA * 0.01 / 0.99, rel=1e-6)


@pytest.mark.ranks
def test_two_cables_cross_over_a_hole_of_an_inflated_sheet(
    comm: MPI.Intracomm, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The same for another numbering, after loading the state, and without the upper cable."""

    def inflated(seed: int | None) -> tuple[Scene, Solver]:
        mesh = sheet(comm, 8, (2.4, 6.8, 3.0, 7.0, 0.0), seed=seed)
        scene = Scene(mesh, MEMBRANE, pressure="lagged")
        for side in ("left", "right", "front", "back"):
            scene.fix(side)
        return scene, Solver(scene)

    found = []
    for seed in (None, 1):
        scene, solver = inflated(seed)
        scene.lay_cable(Cable(EA=2 * EA), [(0.0, 4.2), (10.0, 6.1)], L0=10.0, name="lower")
        scene.lay_cable(Cable(EA=2 * EA), [(3.3, 0.0), (5.7, 10.0)], L0=10.1, name="upper")
        solver.advance(pressure=10.0)
        found.append([cable.tension for cable in scene.cables])
        assert all(cable.state.lifted.any() for cable in scene.cables)
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    folder = Path(comm.bcast(tmp_path_factory.mktemp("hole") if comm.rank == 0 else None))
    solver.save(folder / "state")
    scene, solver = inflated(1)
    solver.load(folder / "state")
    assert [cable.tension for cable in scene.cables] == pytest.approx(found[1], rel=1e-12)
    scene.remove("upper")
    solver.advance(pressure=11.0)
    assert scene.cable("lower").state.lifted.any()


def test_who_cannot_span_a_hole_is_refused() -> None:
    scene = Scene(sheet(MPI.COMM_SELF, 5, (3.0, 7.0, 3.0, 7.0, 0.0)), MEMBRANE)
    scene.fix("left")
    for hold in ("pocket", "bonded"):
        with pytest.raises(PathError, match="leaves the membrane"):
            scene.lay_cable(Cable(EA=EA), [(0.0, 4.6), (10.0, 4.6)], hold=hold)
    for path in ([(0.0, 4.6), (5.0, 5.0)], [(0.0, 4.6), (5.0, 5.0), (10.0, 4.6)]):
        with pytest.raises(PathError, match="leaves the membrane"):
            scene.lay_cable(Cable(EA=EA), path)
    assert not scene.cables
    sleeve = scene.lay_cable(Cable(EA=EA), [(0.0, 4.6), (10.0, 4.6)], hold="sleeve")
    assert sleeve.state.lifted.any()


@pytest.mark.ranks
@pytest.mark.parametrize("seed", [None, 4])
def test_three_cables_that_cross_each_other_over_a_hole_of_a_rigid_sheet_stay_straight(
    comm: MPI.Intracomm, seed: int | None
) -> None:
    """Nothing presses them together, however close their three crossings are."""
    scene = Scene(sheet(comm, 7, (2.0, 8.0, 2.0, 8.0, 0.0), seed=seed), MEMBRANE)
    scene.fix("all")
    routes = [[(0.0, 4.8), (10.0, 5.6)], [(2.6, 0.0), (7.3, 10.0)], [(0.0, 7.9), (8.3, 0.0)]]
    strains = (0.01, 0.004, 0.02)
    for route, strain in zip(routes, strains, strict=True):
        length = float(np.hypot(*np.subtract(route[1], route[0])))
        scene.lay_cable(Cable(EA=EA), route, L0=length / (1 + strain))
    Solver(scene).advance()
    tensions = [cable.tension for cable in scene.cables]
    assert tensions == pytest.approx([EA * strain for strain in strains], rel=1e-6)
    assert all(cable.state.lifted.any() for cable in scene.cables)


@pytest.mark.ranks
def test_three_cables_cross_each_other_over_a_hole_of_an_inflated_sheet(
    comm: MPI.Intracomm,
) -> None:
    """The same for another numbering."""
    found = []
    for seed in (None, 5):
        mesh = sheet(comm, 9, (2.9, 7.1, 2.9, 7.1, 0.0), seed=seed)
        scene = Scene(mesh, MEMBRANE, pressure="lagged")
        for side in ("left", "right", "front", "back"):
            scene.fix(side)
        for route in ([(0, 4.6), (10, 5.2)], [(2.4, 0), (7.5, 10)], [(8.4, 0), (1.9, 10)]):
            length = float(np.hypot(*np.subtract(route[1], route[0])))
            scene.lay_cable(Cable(EA=2 * EA), route, L0=0.985 * length)
        Solver(scene).advance(pressure=4.0)
        found.append([cable.tension for cable in scene.cables])
        assert len(scene.net.crossings) == 3
    assert found[0] == pytest.approx(found[1], rel=1e-4)


@pytest.mark.ranks
def test_a_net_over_a_hole_is_refused_with_what_spans_it(comm: MPI.Intracomm) -> None:
    scene = Scene(sheet(comm, 6, (3.0, 7.0, 3.0, 7.0, 0.0)), MEMBRANE)
    routes = [np.array([(0.0, y), (10.0, y + 0.3)]) for y in (1.1, 4.4)]
    with pytest.raises(PathError, match=r"line A2: .* crosses a hole.* with Scene\.lay_cable"):
        nets.from_paths(scene, [routes])
    assert scene.lay_cable(Cable(EA=EA), routes[1]).state.lifted.any()
    with pytest.raises(PathError, match=r"line A1: .* leaves the membrane") as outside:
        nets.from_paths(scene, [[np.array([(1.0, 1.0), (6.0, 12.0), (9.0, 9.0)])]])
    assert "hole" not in str(outside.value)
