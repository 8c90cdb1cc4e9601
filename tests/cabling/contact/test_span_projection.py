"""The cells under free spans, against the section that `trace` finds with planes and graphs."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from cabled_square import clamped, square
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.cabling.cables.strip import StripShape, cells_near
from crms_fenicsx.cabling.contact.span_projection import (
    cell_under,
    project_span,
    with_span_projections,
)
from crms_fenicsx.cabling.paths.creased_surface import NO_FOLDS, CreasedSurface, FoldPoints
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint
from crms_fenicsx.foundation.surface.trace import trace
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells
from crms_fenicsx.model.cable_state import CableNode

UP = np.array([0.0, 0.0, 1.0])


def whole(comm, kind: str) -> tuple[Scene, StripShape]:
    """A flat square, all of whose cells are known."""
    scene = clamped(square(comm, 7, kind))
    return scene, whole_shape(scene, np.array([(0.0, 0.0, 0.0), (100.0, 100.0, 0.0)]))


def whole_shape(scene: Scene, line: np.ndarray) -> StripShape:
    """All cells of a membrane, found from those near a line."""
    ids = cells_near(scene.membrane, line, along_legs=False)
    scene.net.grow_strip(ids.vertices, rings=12)
    assert scene.net.strip is not None
    return StripShape.of(scene.membrane, scene.net.strip)


def route(shape: StripShape, start, end) -> tuple:
    cells = np.searchsorted(shape.strip.vertices, shape.strip.cells)
    return trace(shape.strip.vertices, shape.current, cells, [start, end]).points


@pytest.mark.parametrize("kind", ["structured", "unstructured", "rotated"])
def test_projections_are_sections(comm, kind: str) -> None:
    """From the first to the last point inside: in both directions, the same points between."""
    _, shape = whole(comm, kind)
    for start, end in [((0, 13), (100, 71)), ((7, 100), (83, 0)), ((0, 52), (100, 45))]:
        points = route(shape, start, end)[1:-1]
        first, last = (CableNode("fold", points[k]) for k in (0, -1))
        a, b = (node_place(shape, node) for node in (first, last))
        found = project_span(shape, first, a + 3 * UP, last, b + 3 * UP)
        back = project_span(shape, last, b + 3 * UP, first, a + 3 * UP)
        assert found is not None and back is not None
        for way in (found, back[::-1]):
            assert [p.support for p in way] == [p.support for p in points[1:-1]]
            wanted = [p.fraction for p in points[1:-1]]
            np.testing.assert_allclose([p.fraction for p in way], wanted, atol=1e-9)


def node_place(shape: StripShape, node: CableNode) -> np.ndarray:
    ids, weights = node.interpolation()
    return np.dot(weights, [shape.at(i) for i in ids])


def test_towards_anchors(comm) -> None:
    """Beyond the boundary the projection ends on it; above the membrane it ends at the foot."""
    _, shape = whole(comm, "unstructured")
    points = route(shape, (0, 13), (100, 71))
    node = CableNode("fold", points[len(points) // 2])
    at = node_place(shape, node)
    along = np.array([100.0, 58.0, 0.0])
    found = project_span(shape, node, at, CableNode("anchor"), at + along + 9 * UP)
    assert found is not None
    assert [p.support for p in found] == [p.support for p in points[len(points) // 2 + 1 :]]
    foot = project_span(shape, node, at, CableNode("anchor"), at + 0.2 * along + 9 * UP)
    assert foot is not None and isinstance(foot[-1], CellPoint)
    place = node_place(shape, CableNode("tied", foot[-1]))
    np.testing.assert_allclose(place, at + 0.2 * along, atol=1e-9)


@pytest.mark.ranks
@pytest.mark.parametrize("height", [9.0, 90.0])
def test_the_foot_is_below_the_anchor_however_steep_the_span_is(comm, height: float) -> None:
    _, shape = whole(comm, "unstructured")
    points = route(shape, (0, 13), (100, 71))
    node = CableNode("fold", points[len(points) // 2])
    at = node_place(shape, node)
    for way in (0.01, 2.0, 25.0):
        below = at + way * np.array([0.8, 0.6, 0.0])
        found = project_span(shape, node, at, CableNode("anchor"), below + height * UP)
        assert found is not None
        foot = node_place(shape, CableNode("tied", found[-1]))
        np.testing.assert_allclose(foot, below, atol=1e-6)


def test_to_an_anchor_far_below_the_membrane_a_path_goes_over_the_boundary(comm) -> None:
    """As below the edge of a roof, beside a corner: the cable does not end above it."""
    _, shape = whole(comm, "unstructured")
    points = route(shape, (0, 13), (100, 71))
    node = CableNode("fold", points[len(points) // 2])
    at = node_place(shape, node)
    for way in (2.0, 25.0):
        end = at + way * np.array([0.8, 0.6, 0.0]) - 90 * UP
        found = project_span(shape, node, at, CableNode("anchor"), end)
        assert found is not None and isinstance(found[-1], EdgePoint)
        assert np.isclose(node_place(shape, CableNode("fold", found[-1]))[:2], 100.0).any()


@pytest.mark.ranks
def test_unknown_cells_are_asked_for(comm) -> None:
    scene = clamped(square(comm, 7, "unstructured"))
    between = np.array([(0.0, 20.0, 0.0), (100.0, 20.0, 0.0)])
    near = cells_near(scene.membrane, between, along_legs=False)
    points = route(StripShape.of(scene.membrane, near), (0, 20), (100, 20))
    scene.net.grow_strip(points[1].support)
    assert scene.net.strip is not None
    shape = StripShape.of(scene.membrane, scene.net.strip)
    first, last = CableNode("fold", points[1]), CableNode("fold", points[-2])
    with pytest.raises(MissingCells):
        project_span(shape, first, node_place(shape, first), last, np.array([95.0, 20.0, 0.0]))


@pytest.mark.ranks
def test_bent_edges_and_anchors_of_the_folded_surface(comm) -> None:
    _, shape = whole(comm, "structured")
    points = route(shape, (0, 13), (100, 71))
    edge = points[3].edge
    bend = shape.at(edge[0]) + np.array([1.0, 2.0, -2.0])
    surface = CreasedSurface(shape, FoldPoints(np.array([edge]), np.array([1]), bend[None]))
    parts = [np.linalg.norm(bend - shape.at(v)) for v in edge]
    assert surface.length(edge) == pytest.approx(sum(parts), rel=1e-14)
    half = surface.place(edge, parts[0] / sum(parts))
    np.testing.assert_allclose(half, bend, atol=1e-12)

    rim = points[0].support
    anchor = 10**6
    joined = CreasedSurface(shape, NO_FOLDS, {anchor: np.array([-20.0, 13.0, 4.0])}, {anchor: rim})
    assert surface.is_boundary(rim) and len(surface.opposite_vertices(rim)) == 1
    assert joined.opposite_vertices(rim) == (*surface.opposite_vertices(rim), anchor)
    assert not surface.ring(rim[0]).closed and joined.ring(rim[0]).closed
    away = np.linalg.norm(shape.at(rim[0]) - np.array([-20.0, 13.0, 4.0]))
    assert joined.length((rim[0], anchor)) == pytest.approx(away)
    assert isinstance(points[0], EdgePoint)


@pytest.mark.parametrize("kind", ["structured", "unstructured", "rotated"])
def test_a_crossing_beyond_its_cell_is_found_from_cell_to_cell(comm, kind: str) -> None:
    """From a cell to the one under a place, near or far, or none beyond the boundary; barely out of
    its cell it stays in it."""
    _, shape = whole(comm, kind)
    cells = [tuple(cell) for cell in shape.strip.corners]
    middles = [np.mean([shape.at(v) for v in cell], axis=0) for cell in cells]
    first = cells[0]
    for cell, middle in zip(cells[1::7], middles[1::7], strict=True):
        found = cell_under(shape, first, middle + 2 * UP)
        assert found is not None and set(found) == set(cell)
    a, b, c = (shape.at(v) for v in first)
    assert cell_under(shape, first, 0.505 * (a + b) - 0.01 * c) == first
    assert cell_under(shape, first, np.array([500.0, 50.0, 0.0])) is None


def test_a_crossing_above_a_ridge_keeps_its_cell(comm) -> None:
    """High above it each of the two cells has the place beyond the other."""
    corners = [(0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, -1.0), (-1.0, 0.0, -1.0)]
    mesh = meshes.from_arrays(comm, np.array(corners), np.array([(0, 2, 1), (0, 1, 3)]))
    scene = Scene(mesh, IsotropicMembrane(E=1.0, nu=0.3, thickness=1.0))
    shape = whole_shape(scene, np.array([(-1.0, 0.0, -1.0), (1.0, 0.0, -1.0)]))
    for cell in map(tuple, shape.strip.corners):
        assert cell_under(shape, cell, np.array([0.0, 0.0, 3.0])) is None
        for side in (-0.3, 0.3):
            found = cell_under(shape, cell, np.array([side, 0.0, -0.2]))
            assert found is not None and (np.mean([shape.at(v)[0] for v in found]) > 0) == (
                side > 0
            )


@pytest.mark.parametrize("back", [False, True])
def test_a_crossing_slides_over_an_edge_beside_a_contact_pulled_aside(comm, back: bool) -> None:
    """The section from either end misses the edge that the cable has pulled aside."""
    corners = [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (2.0, 3.0, 0.0), (2.0, -3.0, 0.0)]
    mesh = meshes.from_arrays(comm, np.array(corners), np.array([(0, 1, 2), (0, 3, 1)]))
    scene = Scene(mesh, IsotropicMembrane(E=1.0, nu=0.3, thickness=1.0))
    shape = whole_shape(scene, np.array([(2.0, -1.0, 0.0), (2.0, 1.0, 0.0)]))
    at = [next(i for i in shape.strip.vertices if np.allclose(shape.at(i), x)) for x in corners]
    supports = [tuple(sorted(at[k] for k in ends)) for ends in ((0, 2), (0, 1, 2), (0, 1), (1, 3))]
    before, cell, over, after = supports
    nodes = [
        CableNode("fold", EdgePoint(before, 0.2)),
        CableNode("crossing", CellPoint(cell, (0.3, 0.3, 0.4)), crossing=0),
        CableNode("fold", EdgePoint(over, 0.5)),
        CableNode("fold", EdgePoint(after, 0.5)),
    ]
    places = np.array([(-0.5, -0.3, 0.0), (2.0, -0.6, 0.0), (2.5, -0.9, 0.0), (3.0, -1.5, 0.0)])
    lifted = np.array([False, False, True, False])
    order = slice(None, None, -1) if back else slice(None)
    nodes, places, lifted = nodes[order], places[order], lifted[order]
    cable = SimpleNamespace(
        state=SimpleNamespace(nodes=nodes, positions=places, lifted=lifted),
        contacts=lambda: np.flatnonzero(~lifted),
        point=lambda k: nodes[k].point,
        points=lambda chosen: [nodes[k].point for k in chosen],
    )
    found = with_span_projections(cable, shape, {0})
    assert found is not None
    points, off = found
    assert [point.support for point in points] == [before, over, after][order]
    assert off == [False, True, False]
    assert node_place(shape, CableNode("fold", points[1])) == pytest.approx(
        [0.0, 0.0, 0.0], abs=1e-6
    )
    assert with_span_projections(cable, shape, set()) is None


TENT = {
    "ridge": [(-8.0, 0.0), (8.0, 0.0)], "valley": [(0.0, -7.0), (0.0, 7.0)],
    "north": [(-4.43, 1.94), (6.08, 0.89)], "south": [(6.08, -0.89), (-4.43, -1.94)],
    "across": [(1.57, 4.67), (3.11, -3.03)],
}  # fmt: skip
"""Lines in plan, from rim to rim."""


@pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")
def test_cables_slide_off_the_lines_of_a_tent(comm: MPI.Intracomm) -> None:
    """A lifted cable that followed an edge as far as a crossing, and now crosses it there, keeps
    that point: without it two points of its path have no cell in common."""
    rim, high = ["south east", "north east", "north west", "south west"], 6.0
    places = [(0.0, -7.0, 1.2), (8.0, 0.0, high), (0.0, 7.0, 1.2), (-8.0, 0.0, high)]
    flat = meshes.polygon(comm, [place[:2] for place in places], size=2.0, names=rim)
    corners = {f"corner {k + 1}": (0.0, 0.0, place[2]) for k, place in enumerate(places)}
    edges = [FormCable(side, tension=45.0) for side in rim]
    form = find_form(flat, stress=2.5, fixed=[*corners], lifted=corners, cables=edges).along(TENT)
    fabric = OrthotropicMembrane(E1=900.0, E2=700.0, G12=30.0, nu21=0.2, thickness=1.0)
    rows = form.scene(fabric, Cable(EA=31.5e3))
    paths = {name: rows.lay_cable(Cable(EA=1e4), along=name).line for name in TENT}
    scene = form.scene(fabric, Cable(EA=31.5e3), belts=Cable(EA=1500.0))
    solver = Solver(scene)
    solver.advance()
    cables = [scene.lay_cable(Cable(EA=1e4), path, name=name) for name, path in paths.items()]
    solver.advance(L0={cable: 0.985 * cable.L0 for cable in cables})
    assert solver.steps[-1].verification.passed
    assert all(cable.taut for cable in cables) and cables[0].state.lifted.any()
