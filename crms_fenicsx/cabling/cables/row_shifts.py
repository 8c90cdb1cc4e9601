"""Vertices of rows whose stress-free places are unknowns, and the directions in which they shift.

A cable along a line of the mesh slides sideways as the stress-free places of its vertices shift
across it, within the stress-free surface: the fabric passes below. Where two cables that slide
cross, their common vertex shifts in the tangent plane, below one in a pocket along this one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from dolfinx import la
from mpi4py import MPI

from crms_fenicsx.cabling.cables.clamping import clamped_nodes
from crms_fenicsx.cabling.cables.points_on_edges import (
    ANCHOR,
    FOLD,
    VERTEX,
    NodeTable,
    positions_of,
)
from crms_fenicsx.cabling.cables.strip import NOBODY, StripShape
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE, SmoothSurface
from crms_fenicsx.foundation.meshes.triangles import altitudes, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints
from crms_fenicsx.model.cable import HOLDS
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_POINT

NEAR = 1e-3
"""Shift, relative to the cell size, below which the mesh around the rows stays as it is: the rest
of the solve then has one energy, and converges."""

SETTLED = 1e-5
"""The same below which the rows have come to rest."""


@dataclass(frozen=True)
class RowShifts:
    """The m vertices that shift, in the order of their ids; the same on all ranks."""

    nodes: Integers  # (m,) row of a node at each, in the table of nodes
    vertices: Integers  # (m,) ids
    projectors: Array  # (m, 3, 3) onto the directions in which they shift
    held: Booleans  # (m,) whether the membrane is held there, and moves with its stress-free place
    sizes: Array  # (m,) least altitudes of the cells around, on which they collapse (length)

    @classmethod
    def none(cls) -> RowShifts:
        """No vertices."""
        none = np.zeros(0, dtype=np.int64)
        places = np.zeros((0, 3, 3))
        return cls(none, none, places, np.zeros(0, dtype=bool), np.zeros(0))

    @classmethod
    def of(
        cls,
        cables: Sequence[LaidCable],
        nodes: NodeTable,
        shape: StripShape,
        membrane: Membrane,
        kept: Booleans,
    ) -> RowShifts:
        """Those of taut cables on their rows, but for vertices (n,) to be kept. Collective."""
        slides = np.array([c.taut and c.takes_line for c in cables], dtype=bool)
        if not slides.any():
            return cls.none()
        vertex = nodes.size == 1
        inner = np.zeros(len(vertex), dtype=bool)
        inner[1:-1] = vertex[:-2] & vertex[1:-1] & vertex[2:]
        inner[nodes.starts[:-1]] = inner[nodes.starts[1:] - 1] = False
        on = np.flatnonzero((nodes.kind == VERTEX) & ~nodes.lifted & nodes.taut)
        strip = shape.strip
        held, fixed = _held_and_fixed(membrane, nodes, shape, kept)
        at = np.searchsorted(strip.vertices, nodes.support[on, 0])
        own = slides[nodes.cable[on]]
        ids, first, of = np.unique(at, return_index=True, return_inverse=True)
        rows = row_places(cables, nodes, shape)
        tangents, normals = _tangents(rows[:, 0], on), rows[on[first], 1]
        count = np.bincount(of, own)
        beyond = on[own & _passes_the_rim(nodes, positions_of(cables))[on]]
        rim = _rim_tangents(nodes, shape, beyond, held)[ids]
        ends = rim.any(axis=1) & (count == 1) & (np.bincount(of) == 1) & ~fixed[ids]
        free = (count > 0) & ~fixed[ids] & normals.any(axis=1)
        free &= np.bincount(of, ~inner[on]) == 0
        bonded = np.array([not HOLDS[cable.hold].along for cable in cables], dtype=bool)
        free |= ends
        free &= np.bincount(of, bonded[nodes.cable[on]]) == 0
        pockets = np.bincount(of, ~own)
        free &= pockets < 2
        n = normals
        projectors = np.eye(3) - n[:, :, None] * n[:, None, :]
        # across the only row that slides, or along the row of the cable in a pocket
        one, pocket = np.zeros((2, len(ids), 3))
        one[of[own]] = tangents[own]
        pocket[of[~own]] = tangents[~own]
        along = np.where(
            (pockets == 1)[:, None], pocket - np.sum(pocket * n, axis=1)[:, None] * n,
            np.cross(n, one),
        )  # fmt: skip
        along[ends] = rim[ends]
        # clamped to a slack cable it drags this one along
        joined = np.bincount(of, clamped_nodes(nodes, cables)[on]) > 0
        single = free & ((count == 1) & ~joined | (pockets == 1))
        d = along[single] / norm(along[single])[:, None]
        projectors[single] = d[:, :, None] * d[:, None, :]
        if not free.any():
            return cls.none()
        some = on[first[free]]
        sizes, cells = (
            np.full(len(strip.vertices), np.inf),
            strip.simplices.cells[strip.owner != NOBODY],
        )
        np.minimum.at(sizes, cells, altitudes(shape.stress_free[cells])[:, None])
        chosen = ids[free]
        return cls(some, strip.vertices[chosen], projectors[free], held[chosen], sizes[chosen])

    def still(self) -> RowShifts:
        """The same vertices, all of which stay."""
        return replace(self, projectors=np.zeros_like(self.projectors))

    def renewed(self, now: RowShifts) -> RowShifts:
        """The same vertices with the directions and sizes of now, where these shift now: one that
        has come to lie on a crease keeps its own."""
        _, here, there = np.intersect1d(self.vertices, now.vertices, return_indices=True)
        projectors, sizes = self.projectors.copy(), self.sizes.copy()
        projectors[here], sizes[here] = now.projectors[there], now.sizes[there]
        return replace(self, projectors=projectors, sizes=sizes)


def _normals(shape: StripShape, vertices: Integers) -> Array:
    """Normals of the stress-free surface at vertices of the strip, (n, 3); zero at rims, seams and
    creases. On a rigid surface the cable's pressure, much larger than its sideways pull, has a part
    along a direction that is off the surface."""
    strip = shape.strip
    solid = strip.simplices.cells[strip.is_outer & (strip.owner != NOBODY)]
    return SmoothSurface.of(shape.stress_free, solid).fitted(solid, vertices)


def row_places(cables: Sequence[LaidCable], nodes: NodeTable, shape: StripShape) -> Array:
    """Stress-free places and normals (n, 2, 3) of the nodes at vertices when the mesh last followed
    the rows of these cables, or now if no cables are given: directions that turned with each shift
    would let the rows settle more slowly."""
    at = np.searchsorted(shape.strip.vertices, nodes.support[:, 0])
    at = np.minimum(at, len(shape.strip.vertices) - 1)
    rows = np.zeros((len(at), 2, 3))
    new = nodes.kind == VERTEX
    for (start, end), cable in zip(pairwise(ints(nodes.starts)), cables, strict=False):
        if cable.state.row is not None:
            own = start + np.flatnonzero(nodes.kind[start:end] == VERTEX)
            rows[own], new[own] = cable.state.row, False
    if new.any():
        ids, of = np.unique(at[new], return_inverse=True)
        rows[new, 0], rows[new, 1] = shape.stress_free[at[new]], _normals(shape, ids)[of]
    return rows


def _tangents(places: Array, on: Integers) -> Array:
    """Tangents of the rows at some nodes on the stress-free surface, (n, 3) (length)."""
    before, after = np.maximum(on - 1, 0), np.minimum(on + 1, len(places) - 1)
    return np.asarray(places[after] - places[before])


def _passes_the_rim(nodes: NodeTable, positions: Array) -> Booleans:
    """Nodes (n,) at vertices from which a row goes on to an anchor elsewhere."""
    last = len(nodes.kind) - 1
    found = np.zeros(len(nodes.kind), dtype=bool)
    for k, j in ((nodes.starts[:-1], 1), (nodes.starts[1:] - 1, -1)):
        beside = np.clip(k + j, 0, last)
        away = norm(positions[beside] - positions[k])
        near = norm(positions[np.clip(k + 2 * j, 0, last)] - positions[beside])
        found[beside] = (nodes.kind[k] == ANCHOR) & (away > SAME_POINT * near)
    return found & (nodes.kind == VERTEX)


def _rim_tangents(nodes: NodeTable, shape: StripShape, on: Integers, held: Booleans) -> Array:
    """Tangents (n, 3) of the rim at the strip's vertices where it is held and a cable passes on to
    an anchor beyond, which slides along it; zero elsewhere, and at corners. `on`: rows of nodes at
    which rows end."""
    strip, X = shape.strip, shape.stress_free
    found = np.zeros((len(strip.vertices), 3))
    ends = np.unique(np.searchsorted(strip.vertices, nodes.support[on, 0]))
    for v in ends[held[ends]]:
        around = strip.simplices.cells[(strip.simplices.cells == v).any(axis=1)]
        others, counts = np.unique(around[around != v], return_counts=True)
        beside = others[counts == 1]
        if len(beside) != 2:
            continue
        a, b = X[v] - X[beside[0]], X[beside[1]] - X[v]
        if a @ b >= CREASE * norm(a) * norm(b):
            found[v] = a + b
    return found


def _held_and_fixed(
    membrane: Membrane, nodes: NodeTable, shape: StripShape, kept: Booleans
) -> tuple[Booleans, Booleans]:
    """Whether each vertex of the strip (n,) is held in all directions, and whether its stress-free
    place must stay: where it is kept, held in some, on the borders of parts, and beside cells that
    cables fold. Collective."""
    strip = shape.strip
    held, fixed, stays = np.zeros((3, len(strip.vertices)), dtype=np.int64)
    mine = np.flatnonzero(strip.owner == membrane.comm.rank)
    corners = strip.simplices.cells[mine]
    dofs = membrane.V.dofmap.list[strip.local[mine]]
    held[corners] = membrane.held[dofs].all(axis=2)
    fixed[corners], stays[corners] = membrane.held[dofs].any(axis=2), kept[dofs]
    kinds = membrane.kinds[strip.local[mine]]
    least, most = np.full(len(fixed), np.iinfo(np.int64).max), np.full(len(fixed), -1)
    np.minimum.at(least, corners, kinds[:, None])
    np.maximum.at(most, corners, kinds[:, None])
    membrane.comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
    membrane.comm.Allreduce(MPI.IN_PLACE, most, op=MPI.MAX)
    flags = np.stack([held, fixed, stays])
    membrane.comm.Allreduce(MPI.IN_PLACE, flags, op=MPI.MAX)
    held, fixed, stays = flags
    folds = nodes.support[nodes.kind == FOLD, :2].ravel()
    crossed = np.isin(strip.vertices, folds)
    still = (fixed > held) | (stays > 0) | (least < most) | crossed
    return held.astype(bool), np.asarray(still)


def fixed_vertices(membrane: Membrane, kept: Booleans, but: Booleans | bool = False) -> Booleans:
    """Whether the stress-free place of each local vertex (n,) must stay in all motions of the mesh:
    where it is to be kept, where it is held, `but` for some (n,), but not within held areas, and on
    the borders of parts. Collective."""
    own = membrane.mesh.mesh.topology.index_map(2).size_local
    dofs = membrane.V.dofmap.list[:own]
    free = ~np.asarray(membrane.held.all(axis=1))[dofs].all(axis=1)
    kinds = membrane.kinds[:own].astype(float)
    sums = la.vector(membrane.V.dofmap.index_map, 4, dtype=np.float64)
    total = sums.array.reshape(-1, 4)
    for k, values in enumerate((free, np.ones(own), kinds, kinds**2)):
        total[:, k] = np.bincount(dofs.ravel(), np.repeat(values, 3), len(total))
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    n_free, count, mean, square = total.T
    borders = square * count - mean**2 > 0.5
    held = membrane.held.any(axis=1) & ~np.asarray(but)
    return np.asarray((held & (n_free > 0)) | borders | kept)
