"""Seams: meshes whose edges have three cells, their distribution, cables over them, pressure."""

import functools

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from taylor import OnMesh, gradient_order, noise
from walled_roof import edge_counts, group_edges, ids, roof_mesh, walled_roof

from crms_fenicsx import Cable, InputError, IsotropicMembrane, PathError, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.cabling.cables.strip import StripShape, cells_near
from crms_fenicsx.cabling.contact.lift_off import size_at
from crms_fenicsx.cabling.contact.span_projection import project_span
from crms_fenicsx.cabling.friction.slip import material_curve, node_slips
from crms_fenicsx.cabling.paths.boundary_ends import _edge_at
from crms_fenicsx.cabling.paths.creased_surface import NO_FOLDS, CreasedSurface
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.runtime.errors import MeshError

KINDS = [
    {"n": 4},
    {"n": 5, "walls": (0.4, 0.6), "rise": 30.0},
    {"n": 6, "walls": (0.5,), "levels": 1},
    {"n": 8, "walls": (0.25, 0.5, 0.75), "levels": 3},
]


@pytest.mark.ranks
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_distribution_tears_nothing(comm, kind, seed):
    rng = np.random.default_rng(seed)
    points, cells, _ = walled_roof(**kind, seed=seed)
    for ranks in (None, rng.integers(0, comm.size, len(cells))):
        membrane = roof_mesh(comm, ranks, **kind, seed=seed)
        topology = membrane.mesh.topology
        counts = edge_counts(cells)
        sizes = [topology.index_map(dim).size_global for dim in range(3)]
        assert sizes == [len(points), len(counts), len(cells)]
        own = edge_counts(ids(membrane))
        parts = comm.allgather(own)
        assert sum(parts, start=edge_counts(np.empty((0, 3), dtype=int))) == counts
        for edge, count in counts.items():
            if count > 2:  # all its cells on one rank
                assert [part[edge] for part in parts if edge in part] == [count]
        boundary = {edge for edge, count in counts.items() if count == 1}
        assert group_edges(membrane, "boundary") == boundary

        # the wall, and nothing else, is behind
        assert np.array_equal(membrane.hidden, membrane.parts["wall"])


# --- orientation -------------------------------------------------------------------------------


def test_a_wall_needs_a_side_of_its_own(comm):
    points, cells, parts = walled_roof()
    with pytest.raises(MeshError, match=r"apart.* its own side \(\{'wall': "):
        meshes.from_arrays(comm, points, cells, parts=parts)
    for sign in (1.0, -1.0):
        membrane = meshes.from_arrays(
            comm, points, cells, parts=parts, outside={"wall": (sign, 0.0, 0.0)}
        )
        x = membrane.mesh.geometry.x[geometry_dofmap(membrane.mesh)[membrane.parts["wall"]]]
        assert np.all(sign * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])[:, 0] > 0.0)


@pytest.mark.parametrize(
    ("outside", "message"),
    [
        ({"Wall": (1, 0, 0)}, "'Wall', but there are the parts roof, wall"),
        ({"wall": (0, 0, 0)}, "non-zero"),
        ({"wall": meshes.AwayFrom((1, 0))}, "three finite numbers"),
        ({"wall": (1, 0, 0), "front": (1, 0, 0)}, "twice for 6 cells of the part 'front'"),
    ],
)
def test_bad_sides_of_parts(comm, outside, message):
    points, cells, parts = walled_roof(n=6)
    if "front" in outside:
        parts["front"] = parts["wall"][:6]
    with pytest.raises(MeshError, match=message):
        meshes.from_arrays(comm, points, cells, parts=parts, outside=outside)


# --- cables and pressure -----------------------------------------------------------------------

ROOF = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
SOFT, STIFF = 1e-7, 3000.0
CABLE = Cable(EA=32000.0)


def tent(comm, wall, **options):
    """A square roof over a wall at x = 4 / 7 with a modulus of its own; None: without it."""
    walls = () if wall is None else (4 / 7,)
    mesh = roof_mesh(comm, n=7, walls=walls, seed=5, **options)
    if wall is None:
        scene = Scene(mesh, ROOF)
    else:
        material = IsotropicMembrane(E=wall, nu=0.25, thickness=0.08)
        scene = Scene(mesh, {"roof": ROOF, "wall": material}, pressure_on=["roof"])
    scene.fix("boundary")
    return scene


def tightened(comm, wall):
    """An inflated tent with a cable across the seam that has slid over some of its vertices."""
    scene = tent(comm, wall)
    solver = advanced(Solver(scene, rtol=1e-10), pressure=0.01)
    cable = scene.lay_cable(CABLE, [(0.0, 30.0), (57.0, 65.0), (100.0, 38.0)])
    solver.advance(L0={cable: 101.0})
    return scene, cable


@functools.cache
def alone(wall):
    """W, T, the volume, the cable's way and the least height of the seam, from one process."""
    scene, cable = tightened(MPI.COMM_SELF, wall)
    way = [node.point.support for node in cable.state.nodes if node.point is not None]
    seam = np.isclose(scene.V.tabulate_dof_coordinates()[:, 0], 400 / 7)
    seam &= scene.V.tabulate_dof_coordinates()[:, 2] == 0.0
    return scene.energy, cable.tension, scene.volume, way, scene.positions()[seam, 2].max()


@pytest.mark.ranks
@pytest.mark.parametrize("wall", [SOFT, STIFF])
def test_any_number_of_ranks_finds_the_same(comm, wall):
    scene, cable = tightened(comm, wall)
    W, T, V, way, _ = alone(wall)
    assert (scene.energy, cable.tension) == pytest.approx((W, T), rel=1e-9)
    assert scene.volume == pytest.approx(V, rel=1e-9)
    assert [node.point.support for node in cable.state.nodes if node.point is not None] == way


def test_a_wall_without_stiffness_changes_nothing():
    W, T, V, _, height = alone(SOFT)
    assert (W, T, V, height) == pytest.approx([alone(None)[k] for k in (0, 1, 2, 4)], rel=1e-6)
    assert T > 10.0


def test_a_stiff_wall_holds_the_roof():
    assert alone(STIFF)[4] < 0.05 * alone(None)[4]
    assert alone(STIFF)[2] < 0.8 * alone(None)[2]
    assert alone(STIFF)[1] < 0.8 * alone(None)[1]


def test_cables_stay_on_the_roof():
    """It has crossed the seam, and slid over vertices of it, without a look at the wall."""
    points, cells, parts = walled_roof(n=7, walls=(4 / 7,), seed=5)
    on_roof = set(cells[parts["roof"]].ravel().tolist())
    for wall in (SOFT, STIFF):
        way = alone(wall)[3]
        crossed = [edge for edge in way if np.allclose(points[list(edge), 0], 400 / 7)]
        assert len(crossed) == 1
        assert {vertex for support in way for vertex in support} <= on_roof
        assert np.all(points[list(crossed[0]), 1] < 60.0)  # laid at y = 65


@pytest.mark.ranks
def test_what_cables_see_of_a_seam(comm):
    """Neighbours, normals, sizes, slips and projections of spans are those of the roof alone."""
    scene = tent(comm, SOFT)
    h, cosine = 100.0 / 7.0, 100.0 / np.hypot(100.0, 30.0)
    route = [(0.0, 31.0), (100.0, 61.0)]
    cable = scene.lay_cable(CABLE, route)
    on_seam = next(
        k
        for k, n in enumerate(cable.state.nodes)
        if n.point and len(scene.net.strip.rows(n.point.support)) == 3
    )
    edge = cable.state.nodes[on_seam].point.support
    scene.net.grow_strip(edge, rings=3)
    shape = scene.net.strip_shape()
    surface = CreasedSurface(shape, NO_FOLDS)
    assert len(surface.opposite_vertices(edge)) == 2
    assert not surface.is_boundary(edge)
    for support in (edge, edge[:1], edge[1:]):
        np.testing.assert_allclose(shape.normal(support), (0.0, 0.0, 1.0), atol=1e-12)
        assert size_at(shape, support) == pytest.approx(h)
        assert shape.stress_free_size(support) == pytest.approx(h)
    assert all(surface.ring(vertex).closed for vertex in edge)

    near = cells_near(scene.membrane, np.array(route), along_legs=False)
    assert not near.hidden
    np.testing.assert_allclose(StripShape.of(scene.membrane, near).current[:, 2], 0.0, atol=1e-9)

    slips = node_slips(cable, material_curve(cable, shape), shape)
    slope = slips.slope[slips.supports.index(edge)]
    assert abs(slope) == pytest.approx(h * cosine)

    a, b = on_seam - 1, on_seam + 1
    below = project_span(
        shape,
        cable.state.nodes[a],
        cable.state.positions[a],
        cable.state.nodes[b],
        cable.state.positions[b],
    )
    assert [point.support for point in below] == [edge]

    held = _edge_at(scene.membrane, np.array((0.0, 50.0, 0.0)), 1e-6)
    assert held is not None
    assert (
        _edge_at(scene.membrane, np.array((400 / 7, 0.0, -5.0)), 1e-6) is None
    )  # the wall's own rim


@pytest.mark.ranks
def test_gradient_with_folded_seams(comm):
    scene = tent(comm, STIFF, rise=20.0)
    scene.lay_cable(CABLE, [(0.0, 31.0), (100.0, 44.0)], tension=30.0)
    scene.air.update(pressure=0.01)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    places = [node.point.support for node in scene.cables[0].state.nodes if node.kind == "fold"]
    assert [len(scene.net.strip.rows(edge)) for edge in places].count(3) == 1
    unknowns = system.unknowns
    f = OnMesh(unknowns, scene.u, system.potential.terms)
    n = unknowns.n_owned
    free = ~unknowns.held[:n]
    x = system.potential.x[:n] + free * noise(unknowns.X[:n], 1)
    d = free * noise(unknowns.X[:n], 2)
    assert gradient_order(f, x, d) == pytest.approx(2.0, abs=0.02)


def test_routes_that_go_down_on_the_wall(comm):
    scene = tent(comm, STIFF)
    for route, number in (
        ([(0.0, 30.0, 0.0), (400 / 7, 30.0, -10.0)], 1),
        ([(0.0, 30.0, 0.0), (400 / 7, 30.0, -10.0), (100.0, 30.0, 0.0)], 1),
        ([(400 / 7, 10.0, -8.0), (400 / 7, 90.0, -9.0)], 0),
    ):
        with pytest.raises(PathError, match=f"point {number} of .*behind a seam.* outer side"):
            scene.lay_cable(CABLE, route)
    assert not scene.cables
    along = scene.lay_cable(CABLE, [(400 / 7, 0.0), (400 / 7, 100.0)])  # on the roof, over the wall
    assert along.length == pytest.approx(100.0)


def test_roofs_upside_down(comm):
    """Outside is between the wall and one half of the roof then, and behind the other half."""
    points, cells, parts = walled_roof()
    membrane = meshes.from_arrays(
        comm, points, cells, parts=parts, outside={"wall": (1, 0, 0), "roof": (0, 0, -1)}
    )
    with pytest.raises(PathError, match=r"point 0 of .*behind a seam.*`outside`"):
        Scene(membrane, ROOF).lay_cable(CABLE, [(0.0, 30.0), (100.0, 30.0)])


def test_star_of_walls_has_no_outer_side(comm):
    """Three walls at one upright seam, each with its outside towards the back of the next."""
    turns = np.exp(2j * np.pi * np.arange(3) / 3)
    foot = np.column_stack([turns.real, turns.imag, np.zeros(3)])
    up = np.array([0.0, 0.0, 1.0])
    points = np.concatenate([[0 * up, up], foot, foot + up])
    cells = [cell for k in (2, 3, 4) for cell in ((0, k, 1), (k, k + 3, 1))]
    parts = {f"wall {k}": [2 * k, 2 * k + 1] for k in range(3)}
    outside = {f"wall {k}": (-turns[k].imag, turns[k].real, 0.0) for k in range(3)}
    membrane = meshes.from_arrays(comm, points, cells, parts=parts, outside=outside)
    with pytest.raises(PathError, match=r"finds no outer side.*`outside`"):
        Scene(membrane, ROOF).lay_cable(CABLE, [(1.0, 0.0, 0.5), (0.0, 0.0, 0.5)])
    outside["wall 0"] = (turns[0].imag, -turns[0].real, 0.0)
    membrane = meshes.from_arrays(comm, points, cells, parts=parts, outside=outside)
    hidden = membrane.mesh.topology.original_cell_index[membrane.hidden]
    assert set().union(*comm.allgather(set(hidden.tolist()))) == {2, 3}


def test_seams_with_two_ways_on(comm):
    """Two air cushions side by side share a seam of four cells, all of them outer ones."""
    points, cells, _ = walled_roof(n=4, walls=())
    low = points - (0.0, 0.0, 10.0)
    middle = np.isclose(points[:, 0], 50.0)
    low[middle, 2] = 0.0
    below = np.where(middle, np.arange(25), 25 + np.cumsum(~middle) - 1)[cells]
    membrane = meshes.from_arrays(
        comm,
        np.concatenate([points, low[~middle]]),
        np.concatenate([cells, below]),
        parts={"top": np.arange(32), "bottom": np.arange(32, 64)},
        outside={"bottom": (0, 0, -1)},
    )
    assert comm.allreduce(len(membrane.hidden)) == 0
    with pytest.raises(PathError, match=r"seam of 4 outer cells at \(50, 30"):
        Scene(membrane, ROOF).lay_cable(CABLE, [(0.0, 30.0), (100.0, 30.0)])


def test_pressure_on_both_sides_of_a_seam_needs_it_held(comm):
    mesh = roof_mesh(comm)
    everywhere = clamped(mesh, ROOF)
    with pytest.raises(InputError, match=r"in a seam, at \(50, .*pressure_on=\[\"roof\"\]"):
        Solver(everywhere).advance(pressure=0.01)
    everywhere.fix(lambda x: np.isclose(x[0], 50.0) & np.isclose(x[2], 0.0))
    Solver(everywhere).advance(pressure=0.01)
    with pytest.raises(InputError, match="there are 'roof', 'wall'"):
        Scene(mesh, ROOF, pressure_on=["Roof"])
    with pytest.raises(InputError, match="not a valid list; write pressure_on="):
        Scene(mesh, ROOF, pressure_on="roof")


@pytest.mark.ranks
def test_pressure_on_a_part_of_a_flat_sheet(comm):
    """Where it ends the sheet must be held, and then the other part stays as it is."""
    points, cells, _ = walled_roof(n=4, walls=())
    left = np.flatnonzero(points[cells][:, :, 0].max(axis=1) < 51.0)
    mesh = meshes.from_arrays(comm, points, cells, parts={"left": left})
    scene = clamped(mesh, ROOF, pressure_on=["left"])
    solver = Solver(scene)
    with pytest.raises(InputError, match=r"end, or meet in a seam, at \(50"):
        solver.advance(pressure=0.01)
    scene.fix(lambda x: np.isclose(x[0], 50.0))
    solver.advance(pressure=0.01)
    rises = scene.u.x.array.reshape(-1, 3)[:, 2]
    right = scene.V.tabulate_dof_coordinates()[:, 0] > 50.0
    assert not np.any(rises[right])
    assert comm.allreduce(float(rises.sum())) > 1.0
    # a third of the pressure's nodal forces on the held edges, and all of them in equilibrium
    total = solver.reactions(lambda x: np.full(x.shape[1], True)).total
    assert total[2] == pytest.approx(-0.01 * 50.0 * 100.0, rel=1e-6)
