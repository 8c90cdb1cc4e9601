"""Vertices whose stress-free places stay, for what is fixed to the material there."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Booleans
from crms_fenicsx.model.cable import HOLDS


def kept_vertices(scene: Scene) -> Booleans:
    """Whether the stress-free place of each local vertex (n,) must stay for what is fixed to the
    material there: ends of bars and cables, bonded cables and those that cross edges, and loads on
    vertices, but for fields of them: where such a load acts on all vertices around. Collective."""
    V, ids = scene.V, {vertex.number for vertex in scene.frame.vertices}
    for cable in scene.cables:
        fixed = cable.state.laid.line is None or not HOLDS[cable.hold].along
        nodes = cable.state.nodes if fixed else (cable.state.nodes[0], cable.state.nodes[-1])
        for point in (node.point for node in nodes):
            ids |= set() if point is None else set(point.support)
    kept = np.isin(scene.membrane.vertex_ids, [*ids])
    dofs = V.dofmap.list[: V.mesh.topology.index_map(2).size_local]
    for load in scene.loads:
        if load.at_vertices:
            on = _on_any_rank(V, norm(load.forces) > 0.0)
            rims = np.zeros(len(kept), dtype=bool)
            rims[dofs[~on[dofs].all(axis=1)]] = True
            kept |= on & _on_any_rank(V, rims)
    return kept


def _on_any_rank(V: fem.FunctionSpace, flags: Booleans) -> Booleans:
    """Logical OR over the ranks of the flags (n,) of each vertex. Collective."""
    sums = la.vector(V.dofmap.index_map, 1, dtype=np.float64)
    sums.array[:] = flags
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    return np.asarray(sums.array > 0.0)
