"""The cables' tables, meetings and points against loops over nodes, edges and cells, on any number
of ranks."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from cabled_square import clamped, put
from mpi4py import MPI
from polygon_twins import facets_of
from ridged_square import OBLIQUE, ridged
from table_twins import SlowTables, cells_around, meetings, points_by_edge, sides_of
from term_scene import ISOTROPIC, cable_square, displaced

from crms_fenicsx import Cable, meshes
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.crossings import Meetings
from crms_fenicsx.cabling.cables.element_tables import CableTables, damping
from crms_fenicsx.cabling.cables.node_positions import NodePositions
from crms_fenicsx.cabling.cables.points_on_edges import NodeTable, fractions_of
from crms_fenicsx.cabling.cables.strip import Simplices
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.surface.points import EdgePoint


def with_spans(comm: MPI.Intracomm) -> System:
    """Cables on the same edges, through vertices and along edges, one of them with a span."""
    system = cable_square(comm)
    put(system.scene.cables[0], "lifted", slice(3, 5), True)
    return system


def with_edge_sliders(comm: MPI.Intracomm) -> System:
    """Over edges that are held, and a slack cable."""
    scene = ridged(comm)
    scene.lay_cable(Cable(32000.0), OBLIQUE, tension=20.0)
    scene.lay_cable(Cable(20000.0), [(0.0, 71.0), (100.0, 32.0)], tension=20.0)
    scene.lay_cable(Cable(20000.0), [(3.0, 61.0), (95.0, 22.0)]).update(taut=False)
    return System(scene, "crms_test_", 1e-8)


def net(comm: MPI.Intracomm) -> System:
    """Two families of cables that cross, of which one ends inside the sheet."""
    scene = clamped(meshes.rectangle(comm, 100.0, 100.0, 15.0), ISOTROPIC)
    for at in (22.0, 31.0, 43.0, 48.0, 77.0):
        end = 52.0 if at == 43.0 else 100.0
        scene.lay_cable(Cable(32000.0), [(0.0, at), (end, at + 7.0)], tension=20.0)
        scene.lay_cable(Cable(32000.0), [(at, 0.0), (at - 7.0, 100.0)], tension=20.0)
    return System(scene, "crms_test_", 1e-8)


@pytest.fixture(
    scope="module", params=[with_spans, with_edge_sliders, net], ids=lambda f: f.__name__
)
def tables(request: pytest.FixtureRequest, comm: MPI.Intracomm) -> tuple[SlowTables, CableTables]:
    """The slow and the fast tables of a scene."""
    system = request.param(comm)
    system.rebuild()
    assert system.cables is not None and system.cables.tables is not None
    return SlowTables(system.cables.numbering), system.cables.tables


def test_the_scenes_have_everything(comm: MPI.Intracomm) -> None:
    seen, lifted = set(), 0
    for make in (with_spans, with_edge_sliders, net):
        cables = make(comm).scene.cables
        seen |= {(node.kind, cable.taut) for cable in cables for node in cable.state.nodes}
        lifted += sum(int(cable.state.lifted.sum()) for cable in cables if cable.taut)
    kinds = ("vertex", "fold", "edge slider", "tied", "anchor", "crossing")
    assert seen >= {(kind, True) for kind in kinds} | {("fold", False)} and lifted == 2


def test_points_are_on_their_edges_in_order(tables) -> None:
    slow, _ = tables
    found, nodes, strip = slow.numbering.points, slow.numbering.nodes, slow.strip
    ends = strip.vertices[strip.simplices.corners[found.edges, :2]]
    by_edge = {
        tuple(edge): nodes.ids(found.nodes[start : start + count])
        for edge, start, count in zip(
            ends.tolist(), found.starts[found.edges], found.counts[found.edges], strict=True
        )
    }
    members = {edge: [(c, k) for _, c, k in points] for edge, points in slow.on_edge.items()}
    assert by_edge == members


@pytest.mark.ranks
def test_segments_are_those_of_the_links(tables) -> None:
    slow, fast = tables
    numbering, own = slow.numbering, slow.own_links()
    ids = [numbering.nodes.ids(rows) for rows in fast.links.T]
    assert list(zip(*ids, strict=True)) == [((c, k), (c, m)) for c, k, m, _ in own]
    blocks = [[numbering.block(c, k), numbering.block(c, m)] for c, k, m, _ in own]
    assert fast.segments.tolist() == blocks
    taut = [c for c, cable in enumerate(slow.cables) if cable.taut]
    assert [taut[n] for n in fast.cable] == [c for c, *_ in own]


def test_smoothing_is_that_of_the_cells_around(tables) -> None:
    slow, fast = tables
    mesh = slow.numbering.u.function_space.mesh
    sizes = np.full(len(slow.strip.cells), np.nan)
    for row in np.flatnonzero(slow.strip.owner == slow.rank):
        a, b, c = mesh.geometry.x[geometry_dofmap(mesh)[slow.strip.local[row]]]
        sizes[row] = np.sqrt(np.linalg.norm(np.cross(b - a, c - a)))
    expected = [slow.smoothing(link, sizes) for link in slow.own_links()]
    np.testing.assert_allclose(fast.eps, expected, rtol=1e-12)


@pytest.mark.ranks
def test_folded_cells_have_the_parts_of_their_sides(tables) -> None:
    slow, fast = tables
    sides, segments = slow.sides()
    assert fast.folded.cells.tolist() == slow.strip.local[slow.rows].tolist()
    assert fast.folded.sides.tolist() == sides
    assert fast.folded.segments.tolist() == [list(pair) for pair in segments]
    parts = np.diff(fast.folded.side_pointers)
    assert np.array_equal(np.repeat(parts, parts) > 1, fast.folded.eps > 0)


@pytest.mark.ranks
def test_kinks_are_where_chords_leave_sides(tables) -> None:
    slow, fast = tables
    kinks = slow.kinks()
    assert fast.kinks.tolist() == [corners for corners, _, _ in kinks]
    assert fast.kink_cells.tolist() == [cell for _, cell, _ in kinks]
    assert slow.numbering.nodes.ids(fast.kink_nodes) == [node for _, _, node in kinks]


@pytest.mark.ranks
def test_facets_are_those_of_the_pieces(tables) -> None:
    """All cells are under pressure."""
    slow, fast = tables
    pieces = [piece for row in slow.rows for piece in slow.polygons(row)]
    facets, weights = facets_of(pieces)
    assert fast.facets.corners.tolist() == facets.tolist()
    assert fast.facets.weights.tolist() == weights.tolist()


@pytest.mark.ranks
def test_sliding_points_are_damped_along_their_edges(tables) -> None:
    slow, fast = tables
    sliders = slow.sliders()
    found = damping(slow.numbering, fast.segments).springs
    assert found.sliders.tolist() == [blocks for blocks, _ in sliders]
    assert found.fractions.tolist() == [fraction for _, fraction in sliders]


@pytest.mark.ranks
def test_simplices_are_those_around_the_cells(tables) -> None:
    strip = tables[0].strip
    found: Simplices = strip.simplices
    around = cells_around(strip)
    supports = np.full((len(around), 3), -1)
    for n, support in enumerate(around):
        supports[n, : len(support)] = support
    numbers = found.find(supports)
    assert sorted(numbers.tolist()) == list(range(len(supports)))
    for number, (support, rows) in zip(numbers, around.items(), strict=True):
        assert found.around(np.array([number]))[1].tolist() == rows
        assert strip.rows(support) == strip.rows(support[::-1]) == rows
        assert found.owner[number] == min(strip.owner[rows])
    lacking = np.array([(-1, -1, -1), (10**6, -1, -1), (strip.vertices[0], 10**6, -1)])
    assert found.find(lacking).tolist() == [-1, -1, -1]
    sides = [[edge for edge, _ in sides_of(cell)] for cell in strip.corners]
    ends = strip.vertices[found.corners[found.sides, :2]]
    assert [[tuple(edge) for edge in own] for own in ends.tolist()] == sides
    assert found.forward.tolist() == [[ahead for _, ahead in sides_of(c)] for c in strip.corners]


@cache
def scattered() -> System:
    """The net on one rank."""
    return net(MPI.COMM_SELF)


@pytest.mark.parametrize("seed", range(10))
def test_meetings_are_where_chords_alternate(seed: int) -> None:
    """Of cables with points anywhere on their edges, some of them lifted or slack."""
    system, rng = scattered(), np.random.default_rng(seed)
    strip = system.scene.net.strip
    assert strip is not None
    for cable in system.scene.cables:
        keep = np.array([node.kind != "crossing" for node in cable.state.nodes])
        nodes = [node for node in cable.state.nodes if node.kind != "crossing"]
        fractions = rng.uniform(0.01, 0.99, len(nodes))
        fractions[np.isnan(cable.state.fractions[keep])] = np.nan
        lifted = rng.random(len(nodes)) < 0.1
        cable.set_nodes(nodes, cable.state.positions[keep], fractions, lifted)
        cable.update(taut=bool(rng.random() < 0.9))
    cables, nodes = system.scene.cables, NodeTable.of(system.scene.cables)
    table = Meetings(nodes, fractions_of(cables), strip)
    found = table.on_edges() + table.in_cells()
    expected = meetings(cables, strip)
    assert len(expected) > 10
    links = [tuple(nodes.ids(np.array(meeting[:2]))) for meeting in found]
    assert set(links) == {pair[:2] for pair in expected}
    along = {(first, second): t for first, second, t in expected}
    for meeting, link in zip(found, links, strict=True):
        inside = np.clip(along[link], 0.0, 1.0)
        np.testing.assert_allclose(meeting.along, inside, atol=1e-9)
        (a, b), (p, q) = ([place(system, c, k + i) for i in (0, 1)] for c, k in link)
        x = dict(zip(meeting.point.support, meeting.point.weights, strict=True))
        for vertex in {*a, *b}:
            at = a.get(vertex, 0.0) + inside[0] * (b.get(vertex, 0.0) - a.get(vertex, 0.0))
            assert abs(x.get(vertex, 0.0) - at) < 1e-9
        assert {*p, *q} <= {*x}


def test_tables_of_nodes_are_kept_up() -> None:
    """Through crossings, changed paths, and cables that lift off and slacken."""
    of_scene = net(MPI.COMM_SELF).scene.net
    assert of_scene.strip is not None
    for change in range(4):
        of_scene.arrange_crossings()
        assert_table(of_scene.nodes, NodeTable.of(of_scene.cables), of_scene.strip.simplices)
        cable = of_scene.cables[change]
        if change == 1:
            cable.update(lifted=~cable.state.lifted)
        elif change == 2:
            cable.update(taut=False)
        else:
            every = (
                cable.state.nodes[::-1],
                cable.state.positions[::-1],
                cable.state.fractions[::-1],
            )
            cable.set_nodes(*every, cable.state.lifted[::-1])
        assert_table(of_scene.nodes, NodeTable.of(of_scene.cables), of_scene.strip.simplices)


def assert_table(found: NodeTable, expected: NodeTable, simplices: Simplices) -> None:
    assert all(a is b for a, b in zip(found.nodes, expected.nodes, strict=True))
    for name in ("rows", "starts", "cable", "place", "taut", "lifted", "slides", "weights"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    np.testing.assert_array_equal(found.on(simplices), expected.on(simplices))


def place(system: System, c: int, k: int) -> dict[int, float]:
    """Vertices and weights of a node."""
    return dict(zip(*system.scene.cables[c].interpolation(k), strict=True))


def vertices(scene: Scene) -> dict[int, np.ndarray]:
    """Stress-free and current positions (2, 3) of all vertices, by id."""
    own: dict[int, np.ndarray] = {}
    places = np.stack([scene.V.tabulate_dof_coordinates(), scene.positions()], axis=1)
    mesh = scene.mesh.mesh
    for cell in range(mesh.topology.index_map(2).size_local):
        for node, dof in zip(geometry_dofmap(mesh)[cell], scene.V.dofmap.list[cell], strict=True):
            own[int(mesh.geometry.input_global_indices[node])] = places[dof]
    return {i: x for part in scene.comm.allgather(own) for i, x in part.items()}


@pytest.mark.ranks
def test_places_in_space_on_edges_and_on_the_membrane(comm: MPI.Intracomm) -> None:
    system = cable_square(comm)
    scene = system.scene
    put(scene.cables[0], "lifted", 3, True)
    system.rebuild()
    system.read_scene()
    numbering, potential = system.cables.numbering, system.potential
    potential.x[: system.unknowns.n_owned] = displaced(system.unknowns, 2.0)
    potential.place()
    before = scene.cables[0].state.positions[3].copy()
    NodePositions(numbering, system.unknowns).gather(potential.x)
    known = vertices(scene)
    for (c, k), number in numbering.numbers.items():
        block, node = numbering.blocks[number], scene.cables[c].state.nodes[k]
        if block >= 0 and node.kind != "tied" and not scene.cables[c].state.lifted[k]:
            place = system.unknowns.X[block] + potential.x[block]
            np.testing.assert_allclose(scene.cables[c].state.positions[k], place)
    np.testing.assert_array_equal(scene.cables[0].state.positions[3], before)
    points = points_by_edge(scene.cables)
    assert max(len(line) for line in points.values()) == 2
    for edge, members in points.items():
        places = [scene.cables[c].state.positions[k] for _, c, k in members]
        line = np.array([known[edge[0]][1], *places, known[edge[1]][1]])
        run = np.linalg.norm(np.diff(line, axis=0), axis=1).cumsum()
        for (_, c, k), share in zip(members, run[:-1] / run[-1], strict=True):
            if scene.cables[c].state.nodes[k].slides:
                assert abs(scene.cables[c].state.fractions[k] - share) < 1e-13
    for cable in scene.cables:
        for k, node in enumerate(cable.state.nodes):
            if node.point is None or cable.state.lifted[k]:
                assert np.isnan(cable.state.reference_positions[k]).all()
            else:
                ids, weights = cable.interpolation(k)
                place = np.dot(weights, [known[i][0] for i in ids])
                np.testing.assert_allclose(cable.state.reference_positions[k], place, atol=1e-12)
        far = [
            abs(f - 0.5) < 0.5 - 1e-9
            for f in cable.state.fractions[np.isfinite(cable.state.fractions)]
        ]
        assert all(far) and not cable.blocked


@pytest.mark.ranks
def test_a_point_at_a_vertex_is_blocked(comm: MPI.Intracomm) -> None:
    system = cable_square(comm)
    scene = system.scene
    cable = scene.cables[0]
    k = next(k for k, node in enumerate(cable.state.nodes) if node.kind == "fold")
    point = cable.state.nodes[k].point
    assert isinstance(point, EdgePoint)
    place = vertices(scene)[point.edge[0]][1]
    put(cable, "positions", k, place + 1e-9 * (cable.state.positions[k] - place))
    system.read_scene()
    system.locate_cables()
    assert cable.blocked == [k] and cable.state.fractions[k] < 1e-6
