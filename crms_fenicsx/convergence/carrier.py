"""What carries the shape of a scene over to the one on the finer mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cables.strip_gather import cells_at
from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.scene import Scene
from crms_fenicsx.surface.mesh_refinement import MeshRefinement
from crms_fenicsx.surface.points import Edge, EdgePoint


@dataclass(frozen=True)
class Carrier:
    """Gives the scene on a finer mesh shapes of the coarse one.

    Attributes
    ----------
    refinement
        How the meshes belong together.
    coarse, finer
        The scenes.
    """

    refinement: MeshRefinement
    coarse: Scene
    finer: Scene

    def take_shape(self, u: Array, bends: Mapping[Edge, Array] | None = None) -> None:
        """Give the finer scene displacements (n, 3) of the coarse one's vertices. Collective.

        Parameters
        ----------
        u
            By local degree of freedom of the coarse scene (length).
        bends
            What is added in the middles of edges (length).
        """
        own = self.coarse.V.dofmap.index_map.size_local
        ids, wanted = self.coarse.membrane.vertex_ids, self.finer.membrane.vertex_ids
        found = self.refinement.carried(ids[:own], u[:own], wanted, bends)
        self.finer.u.x.array[:] = found.ravel()

    def take_state(self, u: Array, cables: Mapping[str, CableState]) -> None:
        """Give the finer scene the shape (n, 3) in which cables have bent edges. Collective.

        Parameters
        ----------
        u
            As for `take_shape`.
        cables
            States of the cables of then, by their names.
        """
        self.take_shape(u)
        folds = _folds(cables)
        if folds:
            vertices = {vertex for edge in folds for vertex in edge}
            strip = cells_at(self.coarse.membrane, sorted(vertices))
            now = self.coarse.u.x.array.copy()
            self.coarse.u.x.array[:] = u.ravel()
            shape = StripShape.of(self.coarse.membrane, strip)
            self.coarse.u.x.array[:] = now
            self.take_shape(u, {edge: _bend(shape, edge, folds[edge]) for edge in folds})


def _folds(states: Mapping[str, CableState]) -> dict[Edge, list[tuple[float, Array]]]:
    """Where cables in tension fold edges: fractions of these, and positions (3,)."""
    folds: dict[Edge, list[tuple[float, Array]]] = {}
    for state in states.values():
        for k, node in enumerate(state.nodes):
            on = state.taut and not state.lifted[k] and node.kind == "fold"
            if on and isinstance(node.point, EdgePoint):
                fold = float(state.fractions[k]), state.positions[k]
                folds.setdefault(node.point.edge, []).append(fold)
    return folds


def _bend(shape: StripShape, edge: Edge, folds: list[tuple[float, Array]]) -> Array:
    """How far the middle of a folded edge is from between its ends, (3,) (length)."""
    ends = [shape.mean((vertex,), (1.0,)) for vertex in edge]
    line = sorted([(0.0, ends[0]), *folds, (1.0, ends[1])], key=lambda point: point[0])
    at, x = [fraction for fraction, _ in line], np.array([place for _, place in line])
    middle = np.array([np.interp(0.5, at, x[:, i]) for i in range(3)])
    return np.asarray(middle - (ends[0] + ends[1]) / 2)
