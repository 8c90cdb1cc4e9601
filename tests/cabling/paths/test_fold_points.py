"""Fold points on edges, against loops over all nodes."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import CABLE, PRESSURE, sheet
from table_twins import points_by_edge

from crms_fenicsx import Scene, Solver
from crms_fenicsx.cabling.paths.creased_surface import CreasedSurface, FoldPoints
from crms_fenicsx.cabling.paths.path_change import vertices_near
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.surface.points import EdgePoint


def net(comm) -> Scene:
    """Three cables along x, close together, under two along y, over the inflated square."""
    scene = sheet(comm, 9, "unstructured")
    for at in (41.0, 43.0, 48.0):
        scene.lay_cable(CABLE, [(0, at), (100, at + 5)], L0=100.6)
    for at in (35.0, 62.0):
        scene.lay_cable(CABLE, [(at, 0), (at, 100)], L0=100.6)
    Solver(scene).advance(pressure=PRESSURE)
    return scene


def bends(cables) -> dict:
    """Positions of the points on each edge."""
    return {
        edge: np.array([cables[c].state.positions[k] for _, c, k in points])
        for edge, points in points_by_edge(cables).items()
    }


def same(found: FoldPoints, expected: dict) -> bool:
    """Whether the edges and the points on them are the same, these in their order."""
    alike = all(np.array_equal(found.on(edge), points) for edge, points in expected.items())
    return alike and list(map(tuple, found.edges.tolist())) == sorted(expected)


@pytest.mark.ranks
def test_points_are_those_of_a_table_made_anew(comm) -> None:
    scene = net(comm)
    cables = scene.cables
    first, expected = FoldPoints.of(cables, scene.net.nodes), bends(cables)
    assert max(map(len, expected.values())) > 1
    assert len(first.on((10**6, 10**6 + 1))) == 0

    cables[1].update(taut=False)
    assert same(FoldPoints.of(cables, scene.net.nodes), bends(cables))
    cables[0].update(lifted=np.arange(len(cables[0].state.nodes)) % 3 == 1)
    assert same(FoldPoints.of(cables, scene.net.nodes), bends(cables))
    nodes, x = cables[2].state.nodes, cables[2].state.positions
    cables[2].set_nodes(
        nodes[::-1], x[::-1].copy(), cables[2].state.fractions[::-1], cables[2].state.lifted
    )
    cables[1].update(taut=True)
    assert same(FoldPoints.of(cables, scene.net.nodes), bends(cables))
    near = sorted(expected)[0]
    some = {edge: points for edge, points in bends(cables).items() if {*edge} <= {*near}}
    assert len(some) == 1 and same(FoldPoints.of(cables, scene.net.nodes, near), some)
    assert len(FoldPoints.of(cables, scene.net.nodes, []).edges) == 0
    assert same(first, expected), "what becomes of the cables changes nothing"
    assert same(FoldPoints.of(cables[1:]), bends(cables[1:]))


@pytest.mark.ranks
def test_bent_edges_are_measured_as_by_arrays(comm) -> None:
    scene = net(comm)
    shape, folds = scene.net.strip_shape(), bends(scene.cables)
    surface = CreasedSurface(shape, FoldPoints.of(scene.cables))
    for edge, points in folds.items():
        line = np.array([shape.at(edge[0]), *points, shape.at(edge[1])])
        arc = arc_lengths(line)
        assert surface.length(edge) == pytest.approx(arc[-1], rel=4e-16)
        for part in (0.0, 0.013, 0.5, arc[1] / arc[-1], 1 - 1e-9, 1.0):
            place = [np.interp(part * arc[-1], arc, line[:, i]) for i in range(3)]
            np.testing.assert_array_equal(surface.place(edge, part), place)


def test_vertices_near_points_are_found_one_by_one(comm) -> None:
    scene, found = net(comm), 0
    scene.cables[0].update(lifted=np.arange(len(scene.cables[0].state.nodes)) % 3 == 1)
    for cable in scene.cables:
        for near in (0.02, 0.1, 0.3):
            slow = set()
            for k in cable.contacts():
                point, fraction = cable.state.nodes[k].point, float(cable.state.fractions[k])
                if cable.state.nodes[k].slides and isinstance(point, EdgePoint):
                    if min(fraction, 1 - fraction) < near:
                        slow.add(point.edge[int(fraction > 0.5)])
            assert vertices_near(cable, near) == slow
            found += len(slow)
    assert found > 5
