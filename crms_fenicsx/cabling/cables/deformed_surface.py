"""Current shape of the membrane as triangles, and the volume between two shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.energy.terms.pressure import gain, moved_volume, rim_of, volume_change
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, pointers, runs
from crms_fenicsx.foundation.surface.polygons import Polygons, best_fans, fan_facets


@dataclass(frozen=True)
class _FoldedShape:
    """This rank's folded cells, cut along their cables."""

    # (n, 3) current and stress-free positions (length): vertices by local degree of freedom, then
    # cable points on edges of folded cells
    points: Array
    stress_free: Array
    pieces: Polygons  # oriented as the membrane, with local cell numbers

    @property
    def cells(self) -> Integers:
        """Local numbers of the folded cells, sorted, (n,)."""
        return np.unique(self.pieces.cell)


@dataclass(frozen=True)
class CurrentSurface:
    """This rank's part of the current surface."""

    points: Array  # (n, 3) current positions of vertices and cable points (length)
    stress_free: Array  # (n, 3) their stress-free positions
    triangles: Integers  # (m, 3) corners as rows of `points`, oriented as the membrane
    parents: Integers  # (m,) local number of the cell of each triangle
    # (h, 2) triangle sides that are neither mesh edges nor folds, as rows of `points`
    inner: Integers


def _folded_shape(net: CableNet) -> _FoldedShape:
    """Cut this rank's folded cells along taut cables. Not collective."""
    membrane = net.membrane
    places, stress_free = membrane.positions(), membrane.stress_free
    if net.strip is None or not any(cable.taut for cable in net.cables):
        none = np.zeros(0, dtype=np.int64)
        return _FoldedShape(places, stress_free, Polygons(np.zeros(1, dtype=np.int64), none, none))
    from crms_fenicsx.cabling.cables.element_tables import CutCells
    from crms_fenicsx.cabling.cables.numbering import CableNumbering
    from crms_fenicsx.cabling.cables.points_on_edges import VERTEX

    numbering = CableNumbering(net.cables, net.strip, membrane.u, net.nodes)
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
        share = float(np.clip(cable.state.fractions[k], 0.0, 1.0))
        vertices, weights = cable.state.nodes[k].interpolation(None if np.isnan(share) else share)
        new[i] = cable.state.positions[k]
        new_free[i] = np.dot(weights, stress_free[[numbering.dof(v) for v in vertices]])
    pieces = Polygons(cut.starts, cut.corners, net.strip.local[cells.rows[cut.cell]])
    return _FoldedShape(
        np.concatenate([places, new]), np.concatenate([stress_free, new_free]), pieces
    )


def current_surface(net: CableNet) -> CurrentSurface:
    """Triangulate this rank's part of the current membrane. Not collective."""
    shape = _folded_shape(net)
    n = net.membrane.mesh.mesh.topology.index_map(2).size_local
    plain = np.setdiff1d(np.arange(n), shape.cells)
    uncut = np.asarray(net.membrane.V.dofmap.list[plain], dtype=np.int64)
    starts, corners, cells = shape.pieces
    fans, polygons = best_fans(shape.points, starts, corners)
    inner = fans[1:][polygons[1:] == polygons[:-1], :2]  # each but a fan's first begins inside
    triangles, parents = np.concatenate([uncut, fans]), np.concatenate([plain, cells[polygons]])
    return CurrentSurface(shape.points, shape.stress_free, triangles, parents, inner)


def gained_volume(net: CableNet) -> float:
    """Volume between the stress-free cells under pressure, as given, and the current ones (length
    cubed), on which a pressure p does the work p V. Collective."""
    # With a rim that is held or slides in planes, this is the volume between the surfaces and the
    # planes; otherwise it includes the volume swept by the rim as seen from the centre.
    membrane = net.membrane
    V, mesh = membrane.V, membrane.mesh.mesh
    shape = _folded_shape(net)
    owned = mesh.topology.index_map(2).size_local
    plain = membrane.pressed[:owned].copy()
    plain[shape.cells] = False
    cells = V.dofmap.list[:owned]
    X, u = shape.stress_free - membrane.centre, shape.points - shape.stress_free
    local = volume_change(X, u, cells[plain]).sum()
    starts, corners, cell = shape.pieces
    pressed = np.flatnonzero(membrane.pressed[cell])
    sizes = np.diff(starts)[pressed]
    facets, weights = fan_facets(pointers(sizes), corners[runs(starts[pressed], sizes)])
    # The pieces of a folded cell make up the cell when stress-free: their changes add up.
    local += np.sum(weights * volume_change(X, u, facets))
    rim = rim_of(membrane)
    local += rim.factors @ gain(*(places.reshape(-1)[rim.components] for places in (X, u)))
    local += moved_volume(membrane, rim)
    return float(membrane.comm.allreduce(float(local)))
