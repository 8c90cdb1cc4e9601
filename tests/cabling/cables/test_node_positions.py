"""Where the cables' points are, against point by point and edge by edge, on any number of ranks."""

from __future__ import annotations

import numpy as np
import pytest
from cable_edits import put
from mpi4py import MPI
from table_twins import points_by_edge
from term_scene import cable_square, displaced

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.node_positions import NodePositions
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.surface.points import EdgePoint


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
