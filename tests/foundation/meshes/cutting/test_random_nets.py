"""Random nets of lines cut into random meshes: valid meshes with all groups, rows on their routes,
the same area; in any unit and place, and on any number of processes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from grids import Floats, grid
from mpi4py import MPI
from walled_roof import roof_mesh

from crms_fenicsx import meshes
from crms_fenicsx.foundation.meshes.cutting.along import cut, improve
from crms_fenicsx.foundation.meshes.cutting.traced_lines import Tracer
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edges_of, whole_line
from crms_fenicsx.foundation.meshes.membrane_mesh import gathered
from crms_fenicsx.foundation.meshes.surface import CheckedSurface, check_shapes
from crms_fenicsx.foundation.meshes.triangles import double_areas, lists, norm

pytestmark = pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")  # coarse meshes

KINDS = ("gmsh", "hole", "ridge", "saddle", "cap", "walls")


def random_mesh(comm: MPI.Intracomm, kind: str, rng: np.random.Generator) -> meshes.MembraneMesh:
    """A roof over a rectangle of 4 x 3, or a cap of radius 4."""
    n = int(rng.integers(8, 13))
    if kind == "gmsh":
        return meshes.rectangle(comm, 4.0, 3.0, size=3.0 / n)
    if kind == "cap":
        return meshes.spherical_cap(comm, radius=4.0, height=1.5, size=8.0 / n)
    if kind == "walls":
        return roof_mesh(comm, n=n, walls=(0.5,), rise=30.0)
    heights = {
        "hole": lambda x, y: 0.0 * x,
        "ridge": lambda x, y: np.maximum(2.0 - x, 0.5 * (x - 2.0)),
        "saddle": lambda x, y: 0.2 * (x - 2.0) ** 2 - 0.3 * (y - 1.5) ** 2,
    }
    x = np.linspace(0.0, 4.0, 2 * (n // 2) + 1)  # with a line of vertices along the ridge
    points, cells = grid(x, np.linspace(0.0, 3.0, n), heights[kind])
    if kind == "hole":
        square = np.arange(len(cells)) // 2
        middles = points[cells].reshape(-1, 6, 3).mean(axis=1)[square]
        hole = np.abs(middles[:, :2] - (1.65, 1.5)) < (0.4, 0.35)
        cells = cells[~hole.all(axis=1)]
        used, cells = np.unique(cells, return_inverse=True)
        points, cells = points[used], cells.reshape(-1, 3)
    west = np.flatnonzero(points[cells].mean(axis=1)[:, 0] < 2.0)
    front = np.flatnonzero(points[:, 1] == 0.0)
    front = front[np.argsort(points[front, 0])]
    edges = {"front": np.stack([front[:-1], front[1:]], axis=1)}
    middle = int(np.argmin(np.hypot(points[:, 0] - 2.6, points[:, 1] - 1.4)))
    return meshes.from_arrays(
        comm, points, cells, parts={"west": west}, edges=edges, point_groups={"top": [middle]}
    )


def random_routes(
    surface: CheckedSurface, kind: str, rng: np.random.Generator
) -> dict[str, Floats]:
    """Lines in plan from rim to rim."""
    if kind == "cap":
        turns = rng.uniform(0.0, 2.0 * np.pi) + np.array([0.0, 0.5, 1.1, 1.6, 3.3, 3.9, 4.4, 4.8])
        ends = 4.0 * np.stack([np.cos(turns), np.sin(turns)], axis=1) * 0.9999
        return {f"line {k}": ends[[k, k + 4]] for k in range(4)}
    low, high = surface.points[:, :2].min(axis=0), surface.points[:, :2].max(axis=0)
    routes = {}
    spots = {0: [0.15, 0.85], 1: [0.2, 0.55, 0.8]}  # beside the hole
    for axis, starts in spots.items():
        for k, start in enumerate(starts):
            ends = np.array([[0.0, start], [1.0, start]]) + rng.uniform(0.0, 0.08, (2, 1)) * [0, 1]
            routes[f"line {axis}{k}"] = low + (ends if axis == 0 else ends[:, ::-1]) * (high - low)
    return routes


def off_the_route(places: Floats, route: Floats) -> float:
    """Largest distance in plan of places from a straight route."""
    side = (route[1] - route[0]) / np.linalg.norm(route[1] - route[0])
    away = places[:, :2] - route[0]
    return float(np.abs(away[:, 0] * side[1] - away[:, 1] * side[0]).max())


def area(surface: CheckedSurface, cells: Any = slice(None)) -> float:
    return float(norm(double_areas(surface.points[surface.cells[cells]])).sum() / 2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_random_nets(comm: MPI.Intracomm, kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = random_mesh(comm, kind, rng)
    given, _ = gathered(mesh)
    routes = comm.bcast(random_routes(given, kind, rng) if comm.rank == 0 else None)
    new, _ = gathered(meshes.along(mesh, routes))
    if comm.rank:
        return
    check_shapes(new.points, new.cells)
    table = EdgeTable.of(new.cells)
    assert table.counts.max() == EdgeTable.of(given.cells).counts.max()
    assert set(new.edges) == set(given.edges) | set(routes)
    assert set(new.parts) == set(given.parts)
    size = float(norm(given.points[given.cells[:, 1]] - given.points[given.cells[:, 0]]).max())
    corners = {name: given.points[ids] for name, ids in given.point_groups.items()}
    for name, places in corners.items():
        np.testing.assert_array_equal(new.points[new.point_groups[name]], places)
    for name, route in routes.items():
        edges = edges_of(new.edges[name])
        row = whole_line("test", name, edges)
        assert off_the_route(new.points[row], route) <= (1e-2 if kind == "cap" else 1e-3) * size
        assert np.isin(new.edges[name], table.keys).all()
    # flat facets and folds are kept to rounding, and curved surfaces to the second order
    within = {"saddle": 3e-3, "cap": 1e-2, "walls": 5e-3}.get(kind, 1e-6)
    np.testing.assert_allclose(area(new), area(given), rtol=within)
    for name, cells in given.parts.items():
        np.testing.assert_allclose(area(new, new.parts[name]), area(given, cells), rtol=within)
    for name, keys in given.edges.items():
        lengths = [
            norm(x.points[keys & 0xFFFFFFFF] - x.points[keys >> 32]).sum()
            for x, keys in ((new, new.edges[name]), (given, keys))
        ]
        np.testing.assert_allclose(*lengths, rtol=within)


@pytest.mark.parametrize("kind", KINDS[:5])
def test_units_places_and_sides_change_nothing(comm: MPI.Intracomm, kind: str) -> None:
    """The cells are the same; far away coordinates have fewer digits. Nor does the outside."""
    rng = np.random.default_rng(7)
    given, _ = gathered(random_mesh(comm, kind, rng))
    if comm.rank:
        return
    routes = random_routes(given, kind, rng)

    def result(scale: float, shift: Floats, *, turned: bool = False) -> CheckedSurface:
        cells = given.cells[:, [0, 2, 1]] if turned else given.cells
        moved = replace(given, points=scale * given.points + shift, cells=cells)
        tracer = Tracer(moved)
        own = {name: scale * route + shift[:2] for name, route in routes.items()}
        work = cut(tracer, tracer.lines(own.items()))
        improve(work)
        return work.finished()

    here = result(1.0, np.zeros(3))
    for scale, shift, within in ((1000.0, 0.0, 1e-10), (1e-3, 0.0, 1e-10), (1.0, 1e5, 1e-6)):
        away = np.array([1.0, -2.0, 0.5]) * shift
        there = result(scale, away)
        np.testing.assert_array_equal(there.cells, here.cells)
        np.testing.assert_allclose((there.points - away) / scale, here.points, atol=within)
    turned = result(1.0, np.zeros(3), turned=True)
    assert {*map(frozenset, lists(turned.cells))} == {*map(frozenset, lists(here.cells))}
    np.testing.assert_allclose(turned.points, here.points, atol=1e-10)


def test_the_order_of_lines_does_not_matter(comm: MPI.Intracomm) -> None:
    """For the validity of the mesh, and the rows."""
    rng = np.random.default_rng(3)
    mesh = random_mesh(comm, "ridge", rng)
    given, _ = gathered(mesh)
    routes = comm.bcast(random_routes(given, "ridge", rng) if comm.rank == 0 else None)
    backward = dict(reversed(routes.items()))
    for order in (routes, backward):
        new, _ = gathered(meshes.along(mesh, order))
        if comm.rank == 0:
            check_shapes(new.points, new.cells)
            for name in routes:
                row = whole_line("test", name, edges_of(new.edges[name]))
                assert off_the_route(new.points[row], routes[name]) <= 1e-9


@pytest.mark.ranks
def test_digits_do_not_depend_on_the_ranks(comm: MPI.Intracomm) -> None:
    mesh = random_mesh(comm, "walls", np.random.default_rng(5))
    given, _ = gathered(mesh)
    routes = comm.bcast(
        random_routes(given, "walls", np.random.default_rng(5)) if comm.rank == 0 else None
    )
    new, _ = gathered(meshes.along(mesh, routes))
    if comm.rank:
        return
    tracer = Tracer(given)
    work = cut(tracer, tracer.lines(routes.items()))
    improve(work)
    alone = work.finished()
    np.testing.assert_array_equal(new.points, alone.points)
    np.testing.assert_array_equal(new.cells, alone.cells)
