"""The membrane's current shape as triangles; folded cells are the facets that cables cut out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.surface.polygons import Polygons, best_fan


@dataclass(frozen=True)
class FoldedShape:
    """This rank's folded cells, cut along their cables."""

    # points, stress_free: (n, 3) current and stress-free places (length): the vertices by local
    # degree of freedom, then the cable points on edges of folded cells
    points: Array
    stress_free: Array
    # polygons, oriented as the membrane, with the local number of the cell they are part of
    pieces: Polygons

    @property
    def cells(self) -> Integers:
        """Local numbers of the folded cells, sorted, (n,)."""
        return np.unique(self.pieces.cell)


@dataclass(frozen=True)
class CurrentSurface:
    """This rank's part of the current surface."""

    # points, stress_free: (n, 3) current and stress-free places (length) of vertices and cable
    # points
    points: Array
    stress_free: Array
    triangles: Integers  # (m, 3) corners as rows of `points`, oriented as the membrane
    parents: Integers  # (m,) local number of the cell that each triangle is, or is a part of
    # (h, 2) sides of triangles as rows of `points` that are neither edges of the mesh nor folds:
    # they cut a piece of a folded cell into triangles
    inner: Integers


def folded_shape(net: CableNet) -> FoldedShape:
    """Cut this rank's folded cells along the cables in tension. Not collective."""
    membrane = net.membrane
    places, stress_free = membrane.positions(), membrane.stress_free
    if net.strip is None or not any(cable.taut for cable in net.cables):
        none = np.zeros(0, dtype=np.int64)
        return FoldedShape(places, stress_free, Polygons(np.zeros(1, dtype=np.int64), none, none))
    from crms_fenicsx.cables.cell_cuts import CutCells
    from crms_fenicsx.cables.node_table import VERTEX
    from crms_fenicsx.cables.numbering import CableNumbering

    numbering = CableNumbering(net.cables, net.strip, membrane.u)
    nodes, corners_of = numbering.nodes, net.strip.simplices.corners
    numbers = len(places) + numbering.number
    at_vertex = nodes.kind == VERTEX
    numbers[at_vertex] = numbering.dofs[corners_of[numbering.on[at_vertex], 0]]
    cells = CutCells(numbering)
    cut = cells.pieces(np.arange(len(cells.rows)), numbering.dofs, numbers)
    added, place = np.unique(cut.corners[cut.corners >= len(places)], return_inverse=True)
    cut.corners[cut.corners >= len(places)] = len(places) + place
    new, new_free = np.zeros((len(added), 3)), np.zeros((len(added), 3))
    for i, row in enumerate(numbering.first[added - len(places)]):
        cable, k = net.cables[nodes.cable[row]], int(nodes.place[row])
        vertices, weights = cable.nodes[k].interpolation(_fraction(cable.fractions[k]))
        new[i] = cable.positions[k]
        new_free[i] = np.dot(weights, stress_free[[numbering.dof(v) for v in vertices]])
    pieces = Polygons(cut.starts, cut.corners, net.strip.local[cells.rows[cut.cell]])
    return FoldedShape(
        np.concatenate([places, new]), np.concatenate([stress_free, new_free]), pieces
    )


def _fraction(value: float) -> float | None:
    """A place on an edge; what is pulled beyond its end is there in the stress-free shape."""
    return None if np.isnan(value) else float(np.clip(value, 0.0, 1.0))


def current_surface(net: CableNet) -> CurrentSurface:
    """Triangulate this rank's part of the membrane as it is now. Not collective."""
    shape = folded_shape(net)
    n = net.membrane.mesh.mesh.topology.index_map(2).size_local
    plain = np.setdiff1d(np.arange(n), shape.cells)
    triangles = [np.asarray(net.membrane.V.dofmap.list[plain], dtype=np.int64)]
    parents = [plain]
    inner: list[Integers] = [np.empty((0, 2), dtype=np.int64)]
    starts, corners, cells = shape.pieces
    for cell, polygon in zip(cells, np.split(corners, starts[1:-1]), strict=False):
        fan = best_fan(shape.points, [int(k) for k in polygon])
        triangles.append(fan)
        parents.append(np.full(len(fan), cell))
        inner.append(fan[1:, :2])
    return CurrentSurface(
        shape.points,
        shape.stress_free,
        np.concatenate(triangles),
        np.concatenate(parents),
        np.concatenate(inner),
    )
