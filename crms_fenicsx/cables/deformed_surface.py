"""The membrane's current shape as triangles; folded cells are the facets that cables cut out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.surface.polygons import best_fan

if TYPE_CHECKING:
    from crms_fenicsx.cables.numbering import Corner


@dataclass(frozen=True)
class FoldedShape:
    """This rank's folded cells, cut along their cables.

    Attributes
    ----------
    points, stress_free : (n, 3)
        Current and stress-free places (length): the vertices by local degree of freedom, then the
        cable points on edges of folded cells.
    pieces : list of (cell, corners)
        Polygons, oriented as the membrane, with the local number of the cell they are part of.
    """

    points: Array
    stress_free: Array
    pieces: list[tuple[int, list[int]]]

    @property
    def cells(self) -> Integers:
        """Local numbers of the folded cells, sorted, (n,)."""
        return np.unique(np.array([cell for cell, _ in self.pieces], dtype=np.int64))


@dataclass(frozen=True)
class CurrentSurface:
    """This rank's part of the current surface.

    Attributes
    ----------
    points, stress_free : (n, 3)
        Current and stress-free places (length) of vertices and cable points.
    triangles : (m, 3)
        Corners as rows of `points`, oriented as the membrane.
    parents : (m,)
        Local number of the cell that each triangle is, or is a part of.
    inner : (h, 2)
        Sides of triangles as rows of `points` that are neither edges of the mesh nor folds: they
        cut a piece of a folded cell into triangles.
    """

    points: Array
    stress_free: Array
    triangles: Integers
    parents: Integers
    inner: Integers


def folded_shape(net: CableNet) -> FoldedShape:
    """Cut this rank's folded cells along the cables in tension. Not collective."""
    membrane = net.membrane
    places, stress_free = membrane.positions(), membrane.stress_free
    if net.strip is None or not any(cable.taut for cable in net.cables):
        return FoldedShape(places, stress_free, [])
    from crms_fenicsx.cables.cell_cuts import pieces
    from crms_fenicsx.cables.numbering import CableNumbering

    numbering = CableNumbering(net.cables, net.strip, membrane.u)
    added: dict[tuple[int, int], int] = {}

    def number(corner: Corner) -> int:
        if isinstance(corner, int):
            return numbering.dof(corner)
        return added.setdefault(corner, len(places) + len(added))

    cut = pieces(numbering, number)
    new, new_free = np.zeros((len(added), 3)), np.zeros((len(added), 3))
    for i, (c, k) in enumerate(added):
        cable = net.cables[c]
        vertices, weights = cable.nodes[k].interpolation(_fraction(cable.fractions[k]))
        new[i] = cable.positions[k]
        new_free[i] = np.dot(weights, stress_free[[numbering.dof(v) for v in vertices]])
    return FoldedShape(np.concatenate([places, new]), np.concatenate([stress_free, new_free]), cut)


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
    for cell, corners in shape.pieces:
        fan = best_fan(shape.points, corners)
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
