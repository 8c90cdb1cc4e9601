"""A mesh follows rows of its vertices within its surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from dolfinx import fem
from grids import grid, numbered, triangles
from mpi4py import MPI

from crms_fenicsx import meshes
from crms_fenicsx.foundation.dofs.layout import vertex_places
from crms_fenicsx.foundation.meshes.edge_table import edges_of
from crms_fenicsx.foundation.meshes.first_surface import FirstSurface
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids, gathered, rows_of
from crms_fenicsx.foundation.meshes.mesh_motion import ROOM, MeshMotion
from crms_fenicsx.foundation.meshes.triangles import closest_on_segments
from crms_fenicsx.foundation.runtime.arrays import Array, Integers

ranks = pytest.mark.ranks
Field = Callable[[Array], Array]
Coordinates = tuple[float, float, float]
LINES = {
    "A": np.array([(0.0, 0.31), (1.0, 0.47)]),
    "B": np.array([(0.29, 0.0), (0.32, 1.0)]),
    "C": np.array([(0.7, 0.0), (0.72, 1.0)]),
}
RISE = 0.15  # of the cap
RADIUS = (0.25 + RISE**2) / (2 * RISE)


class Sheet:
    """A mesh with rows and its motion."""

    def __init__(
        self, mesh: meshes.MembraneMesh, sliding: tuple[int, ...] = (), place: Field = lambda p: p
    ) -> None:
        V = fem.functionspace(mesh.mesh, ("Lagrange", 1, (3,)))
        names = [name for name in LINES if name in mesh.edges]
        self.rows = [np.array(row) for row in rows_of(mesh, "the test", names)]
        self.first = place(vertex_places(V))
        self.ids = np.zeros(len(self.first), dtype=np.int64)
        self.ids[V.dofmap.list] = cell_vertex_ids(mesh.mesh)
        self.fixed = np.zeros(len(self.first), dtype=bool)
        ends = np.array([self.rows[k // 2][-(k % 2)] for k in sliding], dtype=np.int64)
        surface = FirstSurface(V, self.ids, self.first)
        self.V, self.motion = V, MeshMotion(V, surface, self.rows, self.fixed, ends)
        self.comm, self.own, self.cells = mesh.comm, V.dofmap.index_map.size_local, V.dofmap.list

    def on(self, row: Integers) -> Integers:
        """Local vertices of a row."""
        return np.flatnonzero(np.isin(self.ids, row))

    def shifted(
        self, X: Array, x: Array, shift: Field, carry: Field = lambda p: p, row: int = 0
    ) -> tuple[Array, Array]:
        """Places after the vertices of a row have shifted from their first places, and those of
        both kinds after the mesh has followed."""
        k = self.on(self.rows[row])
        X, x = X.copy(), x.copy()
        X[k] = self.first[k] + shift(self.first[k])
        x[k] = carry(X[k])
        return self.motion.move(X, x)

    def whole(self, values: Array) -> Array:
        """Values of all vertices by number, on all ranks."""
        parts = self.comm.allgather((self.ids[: self.own], values[: self.own]))
        found = np.zeros((sum(len(part[0]) for part in parts), 3))
        for ids, some in parts:
            found[ids] = some
        return found


def square(comm: MPI.Intracomm, size: float = 0.07) -> meshes.MembraneMesh:
    return meshes.along(meshes.rectangle(comm, 1.0, 1.0, size), LINES)


def cap(comm: MPI.Intracomm, size: float = 0.07) -> meshes.MembraneMesh:
    """With the first two lines, moved from the square's middle to the cap's."""
    found = {}
    for name in ("A", "B"):
        a, b = LINES[name] - 0.5
        t = np.roots([(b - a) @ (b - a), 2 * a @ (b - a), a @ a - 0.249])
        found[name] = a + np.sort(t)[:, None] * (b - a)
    return meshes.along(meshes.spherical_cap(comm, 0.5, RISE, size), found)


def bow(height: float) -> Field:
    """A sideways shift of the first row that ends at the square's rim."""

    def shift(p: Array) -> Array:
        return np.column_stack([0 * p[:, 0], height * np.sin(np.pi * p[:, 0]), 0 * p[:, 2]])

    return shift


def tilted(height: float) -> Field:
    """The same on the cap, along the tangents in its middle."""

    def shift(p: Array) -> Array:
        # turned about an axis in the row's plane, so that it stays on the sphere
        angle = height / RADIUS * np.cos(np.pi * np.hypot(*p[:, :2].T))
        y, z = p[:, 1], p[:, 2] - RISE + RADIUS
        c, s = np.cos(angle), np.sin(angle)
        return np.column_stack([0 * y, c * y + s * z - y, c * z - s * y - z])

    return shift


@ranks
def test_the_way_does_not_matter(comm: MPI.Intracomm) -> None:
    """Rows that come back bring the mesh back, and steps lead to where one step leads."""
    for sheet, shift in ((Sheet(square(comm)), bow), (Sheet(cap(comm)), tilted)):
        X = x = sheet.first
        for height in (0.04, 0.09, 0.13):
            X, x = sheet.shifted(X, x, shift(height))
        assert comm.allreduce(np.abs(X - sheet.first).max(), MPI.MAX) > 0.1
        rows = sheet.on(np.concatenate(sheet.rows))
        once = sheet.first.copy()
        once[rows] = X[rows]
        once, _ = sheet.motion.move(once, once)
        np.testing.assert_allclose(X, once, atol=1e-13)
        X[rows] = sheet.first[rows]
        np.testing.assert_array_equal(sheet.motion.move(X, x)[0], sheet.first)


def test_what_does_not_move_keeps_its_digits(comm: MPI.Intracomm) -> None:
    sheet = Sheet(square(comm))
    x = sheet.first * [1.1, 1.0, 1.0]
    X, moved = sheet.motion.move(sheet.first, x)
    np.testing.assert_array_equal(X, sheet.first)
    np.testing.assert_array_equal(moved, x)
    X, _ = sheet.shifted(sheet.first, sheet.first, bow(0.05))
    assert (X[:, 1] != sheet.first[:, 1]).any()
    np.testing.assert_array_equal(X[:, 2], 0.0)


def test_rows_keep_their_proportions_and_crossings_their_places(comm: MPI.Intracomm) -> None:
    sheet = Sheet(square(comm))
    row, k = sheet.rows[0], sheet.on(sheet.rows[0])
    squeezed = sheet.first.copy()
    squeezed[k] += 0.3 * bow(0.1)(sheet.first[k])[:, [1, 0, 2]] + bow(0.05)(sheet.first[k])
    X = sheet.whole(sheet.motion.move(squeezed, squeezed)[0])
    first, given = sheet.whole(sheet.first), sheet.whole(squeezed)
    stops = [k for k in range(len(row)) if (np.concatenate(sheet.rows) == row[k]).sum() > 1]
    assert len(stops) == 2
    np.testing.assert_array_equal(X[row[stops]], given[row[stops]])
    for i, j in zip([0, *stops], [*stops, len(row) - 1], strict=True):
        before, after, far = (
            np.linalg.norm(np.diff(p[row[i : j + 1]], axis=0), axis=1) for p in (first, X, given)
        )
        ratios = after / before * before.sum() / after.sum()
        assert np.ptp(far / before) > 0.02 and np.ptp(ratios) < 1e-12


@ranks
def test_affine_deformations_of_a_flat_sheet(comm: MPI.Intracomm) -> None:
    """No vertex leaves the deformed sheet, to rounding: in any units, at any origin."""
    gradient = np.array([(1.3, 0.2, 0.0), (-0.1, 0.9, 0.0), (0.4, 0.3, 1.0)])
    mesh = square(comm)
    plain = Sheet(mesh)
    for unit, origin in ((1.0, 0.0), (1e3, 0.0), (1.0, 1e4)):

        def place(p: Array, unit: float = unit, origin: float = origin) -> Array:
            return np.asarray(unit * p + origin * np.array([1.0, -1.0, 0.0]))

        def carry(p: Array) -> Array:
            return np.asarray(p @ gradient.T + [0.0, 0.0, 0.5])

        sheet = Sheet(mesh, place=place)

        def shift(p: Array, unit: float = unit, origin: float = origin) -> Array:
            return unit * bow(0.1)((p - origin * np.array([1.0, -1.0, 0.0])) / unit)

        X, x = sheet.shifted(sheet.first, carry(sheet.first), shift, carry)
        size = unit + origin
        assert comm.allreduce(np.abs(X - sheet.first).max(), MPI.MAX) > 0.09 * unit
        np.testing.assert_allclose(x, carry(X), atol=1e-14 * size)
        np.testing.assert_allclose(
            X, place(plain.shifted(plain.first, plain.first, bow(0.1))[0]), atol=1e-13 * size
        )


def test_a_rigid_cap_stays_rigid(comm: MPI.Intracomm) -> None:
    """The mesh moves on the sphere, off it by a fiftieth of the rise of its longest edges."""
    sheet = Sheet(cap(comm))
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])[:, [1, 2, 0]]

    def carry(p: Array) -> Array:
        return np.asarray(p @ turn.T + [1.0, 2.0, 3.0])

    X, x = sheet.shifted(sheet.first, carry(sheet.first), tilted(0.15), carry)
    # the last motion of the rows, onto the surface, is along the mean normals of the facets
    np.testing.assert_allclose(x, carry(X), atol=1e-13)

    def off(p: Array) -> float:
        return float(np.abs(np.linalg.norm(p - [0.0, 0.0, RISE - RADIUS], axis=1) - RADIUS).max())

    longest = sheet.motion.size.max()
    assert off(sheet.first) < 1e-14 and off(X) < longest**2 / (8 * RADIUS) / 50


@pytest.mark.parametrize(("unit", "away"), [(1e3, 0.0), (1.0, 1e4), (1.0, 1e6)])
def test_units_and_origins(comm: MPI.Intracomm, unit: float, away: float) -> None:
    origin, mesh = away * np.array([1.0, -1.0, 0.5]), cap(comm)

    def place(p: Array) -> Array:
        return np.asarray(unit * p + origin)

    def shift(p: Array) -> Array:
        return unit * tilted(0.1)((p - origin) / unit)

    plain, other = Sheet(mesh), Sheet(mesh, place=place)
    X, _ = plain.shifted(plain.first, plain.first, tilted(0.1))
    Y, y = other.shifted(other.first, other.first, shift)
    assert np.abs(X - plain.first).max() > 0.09
    np.testing.assert_allclose(Y, place(X), atol=1e-14 * (unit + 1e2 * away))
    np.testing.assert_allclose(y, Y, atol=1e-14 * (unit + 1e2 * away))
    again, _ = other.motion.move(Y, y)
    np.testing.assert_allclose(again, Y, atol=1e-14 * (unit + 1e2 * away))


def test_error_of_a_smooth_deformation(comm: MPI.Intracomm) -> None:
    """A shift of a share of a cell errs by the second power of the size of the cells."""

    def carry(p: Array) -> Array:
        x, y = p[:, 0], p[:, 1]
        up = 0.3 * np.sin(np.pi * x) * np.sin(np.pi * y)
        return np.column_stack([x + 0.1 * np.sin(2 * x + y), y + 0.1 * x * y, up])

    errors, sizes = [], [0.12, 0.06, 0.03]
    for size in sizes:
        sheet = Sheet(square(comm, size))
        X, x = sheet.shifted(sheet.first, carry(sheet.first), bow(0.7 * size), carry)
        errors.append(np.linalg.norm(x - carry(X)) / np.sqrt(len(x)))
    rate = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate > 1.9 and errors[0] < 0.01, errors


@pytest.mark.parametrize(("make", "shift"), [(square, bow), (cap, tilted)])
def test_slides_of_three_cells(
    comm: MPI.Intracomm,
    make: Callable[[MPI.Intracomm], meshes.MembraneMesh],
    shift: Callable[[float], Field],
) -> None:
    """All cells keep two fifths of their area; a slide that turns some over is told."""
    sheet = Sheet(make(comm))
    (ratio, *_), (before, *_) = sheet.motion.quality(sheet.first)
    assert ratio == pytest.approx(1.0)
    X, _ = sheet.shifted(sheet.first, sheet.first, shift(0.21))
    (ratio, *_), (angle, *_) = sheet.motion.quality(X)
    assert 0.4 < ratio < 1.0 and 15.0 < angle < before
    X, _ = sheet.shifted(X, X, shift(0.49))
    (ratio, place, rows), (angle, other, _) = sheet.motion.quality(X)
    assert ratio < 0.0 and angle < 0.0 and 0 in rows
    assert sheet.motion.quality(np.nan * X)[0][0] == -np.inf
    row = sheet.whole(X)[sheet.rows[0]]
    for one in (place, other):  # the cell is beside the row
        assert np.linalg.norm(row - one, axis=1).min() < 0.1


def shared(mesh: meshes.MembraneMesh, comm: MPI.Intracomm, kind: str) -> meshes.MembraneMesh:
    """A mesh of one process with each cell on any rank, or all on the last ones."""
    surface, _ = gathered(mesh)
    m = len(surface.cells)
    wanted = np.random.default_rng(3).integers(0, comm.size, m)
    if kind == "last":
        wanted = np.maximum(wanted, min(1, comm.size - 1))
    edges = {name: edges_of(keys) for name, keys in surface.edges.items() if name in LINES}
    return meshes.from_arrays(comm, surface.points, surface.cells, edges=edges, ranks=wanted)


@ranks
@pytest.mark.parametrize("kind", ["scattered", "last"])
def test_ranks_do_not_matter(comm: MPI.Intracomm, kind: str) -> None:
    for make, shift, sliding in ((square, bow, (1,)), (cap, tilted, ())):
        found = []
        alone = make(MPI.COMM_SELF)
        for mesh in (shared(alone, comm, kind), alone):
            sheet = Sheet(mesh, sliding)
            end = [(0.0, 0.11, 0.0) if sliding else (0.0, 0.0, 0.0)]

            def both(
                p: Array, shift: Callable[[float], Field] = shift, end: list[Coordinates] = end
            ) -> Array:
                return shift(0.1)(p) + (p[:, :1] > 0.999) * np.array(end)

            X, x = sheet.shifted(sheet.first, sheet.first * [1.0, 1.1, 0.9], both)
            row = sheet.rows[1]
            at, now = sheet.whole(X)[row], sheet.whole(x)[row]
            under = sheet.motion.under(X, x, [(1, row[1:-1], now[0], now[-1] + [0.02, 0.03, 0.0])])
            found.append((*map(sheet.whole, (X, x, *under)), at, sheet.motion.quality(X)))
        for ours, others in zip(found[0][:5], found[1][:5], strict=True):
            np.testing.assert_allclose(ours, others, atol=1e-12)
        assert np.abs(found[0][0] - found[0][2]).max() > 1e-3
        for (value, place, rows), (same, there, near) in zip(*(f[5] for f in found), strict=True):
            assert value == pytest.approx(same, rel=1e-10) and rows == near
            np.testing.assert_allclose(place, there, atol=1e-12)


def test_vertices_of_the_rim_make_way_for_an_end(comm: MPI.Intracomm) -> None:
    """Those between corners and other ends; the rim keeps its shape, and displacements theirs."""
    sheet = Sheet(square(comm), sliding=(1,))

    def shift(p: Array) -> Array:
        return p[:, :1] * np.array([[0.0, 0.2, 0.0]])

    def carry(p: Array) -> Array:
        return p + np.column_stack([0 * p[:, 0], 0 * p[:, 0], 0.3 * p[:, 1]])

    X, x = sheet.shifted(sheet.first, carry(sheet.first), shift, carry)
    right = np.isclose(sheet.first[:, 0], 1.0)
    rim = right | np.isclose(sheet.first[:, :2], 0.0).any(axis=1)
    rim |= np.isclose(sheet.first[:, 1], 1.0)
    np.testing.assert_allclose(X[rim & ~right], sheet.first[rim & ~right], atol=1e-15)
    old, new = sheet.first[right, 1], X[right, 1]
    np.testing.assert_allclose(X[right, 0], 1.0, atol=1e-15)
    end = sheet.first[sheet.on(sheet.rows[0][-1:]), 1][0]
    wanted = np.interp(old, [0.0, end, 1.0], [0.0, end + 0.2, 1.0])
    np.testing.assert_allclose(new, wanted, atol=1e-13)
    np.testing.assert_allclose(x[right], carry(X[right]), atol=1e-13)
    assert sheet.motion.quality(X)[0][0] > 0.3


@pytest.mark.parametrize("sliding", [(1,), (0, 1, 2, 3)])
def test_ends_slide_around_a_cap(comm: MPI.Intracomm, sliding: tuple[int, ...]) -> None:
    """Its rim has no corners; what does not slide stays, or the vertices in between."""
    sheet = Sheet(cap(comm), sliding)
    ends = sheet.motion.sliding
    assert len(ends) == len(sliding)
    whole = sheet.whole(sheet.first)
    X, angle = sheet.first.copy(), 0.1
    k = np.isin(sheet.ids, ends)
    c, s = np.cos(angle), np.sin(angle)
    X[k] = X[k] @ np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)]).T
    X, x = sheet.motion.move(X, X)
    np.testing.assert_allclose(x, X, atol=1e-13)
    radii = np.linalg.norm(sheet.whole(X), axis=1)
    rim = np.isclose(whole[:, 2], 0.0, atol=1e-12)
    assert 0.5 * np.cos(0.07 / 0.5) < radii[rim].min() and radii[rim].max() < 0.5 + 1e-14
    turns = np.arctan2(*sheet.whole(X)[rim, 1::-1].T) - np.arctan2(*whole[rim, 1::-1].T)
    turns = (turns + np.pi) % (2 * np.pi) - np.pi
    assert turns.min() > -1e-9 and turns.max() == pytest.approx(angle, abs=1e-3)
    assert (np.abs(turns) < 1e-9).sum() >= 1
    assert sheet.motion.quality(X)[0][0] > 0.3


def test_ends_at_corners_do_not_slide(comm: MPI.Intracomm) -> None:
    """Nor those inside."""
    mesh = meshes.rectangle(comm, 1.0, 1.0, 0.25, structured=True)
    mesh = meshes.along(mesh, {"A": [(0.0, 0.0), (1.0, 1.0)], "B": [(0.5, 0.5), (1.0, 0.5)]})
    sheet = Sheet(mesh, sliding=(0, 1, 2, 3))
    ends = sheet.whole(sheet.first)[sheet.motion.sliding]
    np.testing.assert_allclose(ends, [(1.0, 0.5, 0.0)], atol=1e-15)


def test_rows_with_corners_stay_as_well(comm: MPI.Intracomm) -> None:
    """A sharp one beside a crossing is no sign that this has moved."""
    line = np.linspace(0.0, 1.0, 8)
    points, cells = grid(line, line)
    there = [(k, k + 8) for k in (3, 11, 19, 27)]
    back = [(35, 26), (26, 17), (17, 8)]  # along diagonals
    mesh = meshes.from_arrays(
        comm, points, cells, edges={"A": [*there, *back], "B": [(k, k + 1) for k in range(24, 31)]}
    )
    sheet = Sheet(mesh)
    X, _ = sheet.motion.move(sheet.first, sheet.first)
    np.testing.assert_array_equal(X, sheet.first)


def test_closed_parts_without_rows_stay(comm: MPI.Intracomm) -> None:
    line = np.linspace(0.0, 1.0, 8)
    points, cells = grid(line, line)
    numbers = np.pad(numbered(30, 24), ((0, 1), (0, 1)), mode="wrap")
    u, v = (a.ravel() for a in np.meshgrid(np.arange(30) / 30, np.arange(24) / 24, indexing="ij"))
    away = 1.0 + 0.5 * np.cos(2 * np.pi * v)
    around = 2 * np.pi * u
    ring = np.stack(
        [away * np.cos(around) + 4.0, away * np.sin(around), 0.5 * np.sin(2 * np.pi * v)], 1
    )
    mesh = meshes.from_arrays(
        comm, np.concatenate([points, ring]), np.concatenate([cells, triangles(numbers) + 64]),
        edges={"A": [(k, k + 8) for k in range(3, 59, 8)]},
        outside=meshes.AwayFrom((4.0, 0.0, -1.0)),
    )  # fmt: skip
    sheet = Sheet(mesh)
    X, x = sheet.shifted(sheet.first, sheet.first, bow(0.05))
    np.testing.assert_allclose(x, X, atol=1e-14)
    moved = (X != sheet.first).any(axis=1)
    assert comm.allreduce(moved[: sheet.own].sum()) == 36
    assert (sheet.first[moved, 0] < 1.0).all()


def test_fixed_vertices_stay(comm: MPI.Intracomm) -> None:
    """Those of rows as well: the row is spread on either side."""
    sheet = Sheet(square(comm))
    place = np.linalg.norm(sheet.first - [0.5, 0.8, 0.0], axis=1)
    on_row = sheet.on(sheet.rows[0])
    middle = on_row[np.abs(sheet.first[on_row, 0] - 0.55) < 0.05]
    fixed = place < 0.1
    fixed[middle] = True
    assert fixed.sum() > 3
    surface = FirstSurface(sheet.V, sheet.ids, sheet.first)
    motion = MeshMotion(sheet.V, surface, sheet.rows, fixed, np.zeros(0, dtype=np.int64))
    X = sheet.first + bow(0.1)(sheet.first) * np.isin(sheet.ids, sheet.rows[0])[:, None]
    X[middle] = sheet.first[middle]
    new, _ = motion.move(X, X)
    np.testing.assert_array_equal(new[fixed], sheet.first[fixed])
    assert (new != sheet.first).any(axis=1).sum() > 0.3 * len(new)


def test_a_row_goes_below_its_span(comm: MPI.Intracomm) -> None:
    """Within the deformed sheet; crossings along the other rows."""
    sheet = Sheet(square(comm))
    turn = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    row, k = sheet.rows[0], sheet.on(sheet.rows[0])
    bowed, _ = sheet.shifted(sheet.first, sheet.first, bow(0.02))
    whole = sheet.whole(bowed)
    start, end = (whole[row[j]] @ turn.T for j in (0, -1))
    spans = [(0, row[1:-1], start, end)]
    X, x = bowed, bowed @ turn.T
    for _ in range(4):
        X, x = sheet.motion.under(X, x, spans)
        np.testing.assert_allclose(x, X @ turn.T, atol=1e-13)
    for other in sheet.rows[1:]:
        for v in k[np.isin(sheet.ids[k], other)]:
            line = whole[other]
            _, _, gaps = closest_on_segments(line[:-1], np.diff(line, axis=0), X[v])
            assert 0.015 < np.linalg.norm(X[v] - bowed[v]) and gaps.min() < 2e-3
    inner = k[~np.isin(sheet.ids[k], row[[0, -1]])]
    off = np.cross((end - start) / np.linalg.norm(end - start), x[inner] - start)
    np.testing.assert_allclose(off, 0.0, atol=1e-13)
    others = np.setdiff1d(np.arange(len(X)), k)
    np.testing.assert_array_equal(X[others], bowed[others])


def test_shared_vertices_leave_cells_room_on_their_way_below_a_span(comm: MPI.Intracomm) -> None:
    """A span that passes three cells away takes no cell below a quarter of its first area."""
    sheet = Sheet(square(comm))
    row = sheet.rows[0]
    start, end = sheet.whole(sheet.first)[row[[0, -1]]] + [0.0, 0.3, 0.0]
    shared = row[np.isin(row, np.concatenate(sheet.rows[1:]))]
    X, ratios = sheet.first, []
    for _ in range(20):
        last = X
        X, _ = sheet.motion.under(X, X, [(0, shared, start, end)])
        assert np.linalg.norm(X - last, axis=1).max() < 0.06, "half a cell"
        ratios.append(sheet.motion.quality(X)[0][0])
    assert ratios[0] > 0.4 and min(ratios) > 0.9 * ROOM and min(ratios) < 0.5


def test_the_walk_ends_where_the_normal_meets_a_cell() -> None:
    """As found by trying all cells, with less thrift."""
    sheet = Sheet(cap(MPI.COMM_SELF))
    surface, draws = sheet.motion._surface, np.random.default_rng(4)
    inner = np.flatnonzero(np.hypot(*surface.smooth.points[:, :2].T) < 0.35)
    places = surface.smooth.points[inner] + draws.uniform(-0.08, 0.08, (len(inner), 3))
    new, normals = surface.onto(inner, places)
    x, n = surface.smooth.points[surface.cells], surface.smooth.normals[surface.cells]
    checked = 0
    for place, found, normal in zip(places, new, normals, strict=True):
        weights = np.full((len(x), 3), 1 / 3)
        for _ in range(50):
            inside = np.clip(weights, 0.0, 1.0)
            inside /= inside.sum(axis=1)[:, None]
            mean = np.einsum("mc,mci->mi", inside, n)
            mean[np.linalg.norm(mean, axis=1) == 0.0] = [0.0, 0.0, 1.0]
            matrix = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0], -mean], axis=2)
            s, t = np.linalg.solve(matrix, (place - x[:, 0])[..., None])[:, :2, 0].T
            weights = np.stack([1.0 - s - t, s, t], axis=1)
        hit = np.flatnonzero(weights.min(axis=1) > 1e-6)
        if len(hit) == 1:
            up = mean[hit[0]] / np.linalg.norm(mean[hit[0]])
            offset, _ = surface.smooth.raised(surface.cells[hit], weights[hit])
            np.testing.assert_allclose(found, weights[hit[0]] @ x[hit[0]] + offset[0], atol=1e-12)
            np.testing.assert_allclose(normal, up, atol=1e-12)
            checked += 1
    assert checked > 0.9 * len(places)


def test_mean_gradients_of_a_vertex() -> None:
    sheet = Sheet(cap(MPI.COMM_SELF))
    X = sheet.first
    x = X + 0.1 * np.sin(3.0 * X[:, [1, 2, 0]])
    gradients, normals, current = sheet.motion._mean_gradients(X, x)
    for vertex in (5, 40, 77):
        total, sums, area = np.zeros((3, 3)), np.zeros((2, 3)), 0.0
        for i, j, k in sheet.cells[(sheet.cells == vertex).any(axis=1)]:
            N, n = (np.cross(p[j] - p[i], p[k] - p[i]) for p in (X, x))
            old = np.stack([X[j] - X[i], X[k] - X[i], N / np.linalg.norm(N)], axis=1)
            new = np.stack([x[j] - x[i], x[k] - x[i], n / np.linalg.norm(n)], axis=1)
            total += np.linalg.norm(N) * new @ np.linalg.inv(old)
            area += np.linalg.norm(N)
            sums += [N, n]
        np.testing.assert_allclose(gradients[vertex], total / area, atol=1e-13)
        for found, some in zip((normals, current), sums, strict=True):
            np.testing.assert_allclose(found[vertex], some / np.linalg.norm(some), atol=1e-13)
