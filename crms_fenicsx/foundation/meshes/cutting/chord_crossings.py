"""Places where lines meet inside cells, as nodes of both."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.cutting.division import Chords, CutNodes
from crms_fenicsx.foundation.meshes.triangles import cross_in_plane
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.points import Support


def meet(nodes: CutNodes, chords: Chords) -> None:
    """Put nodes where chords cross, or end at each other, into both."""
    for cell, own in chords.items():
        if len(own) > 1:
            _meet_in_cell(nodes, cell, [chord for _, chord in own])


def _meet_in_cell(nodes: CutNodes, cell: Support, chords: list[list[int]]) -> None:
    corners = nodes.corners[list(cell)]
    frame = _frame(corners)
    places = np.array([nodes.places[v] for chord in chords for v in chord])
    # with the cell's size as unit of distances
    ends = ((places - corners[0]) @ frame.T / (frame[0] @ frame[0])).reshape(-1, 2, 2)
    new: list[tuple[Array, int]] = []
    met: list[list[tuple[float, int]]] = [[] for _ in chords]
    for i, one in enumerate(chords):
        for j in range(i):
            other = chords[j]
            if {one[0], one[-1]} & {other[0], other[-1]}:
                continue
            (a, b), (c, d) = ends[i], ends[j]
            turn = float(cross_in_plane(b - a, d - c))
            if abs(turn) <= 1e-12:
                continue
            s = float(cross_in_plane(c - a, d - c)) / turn
            t = float(cross_in_plane(c - a, b - a)) / turn
            near = [nodes.within / max(float(np.hypot(*side)), 1e-300) for side in (b - a, d - c)]
            if not (-near[0] <= s <= 1.0 + near[0] and -near[1] <= t <= 1.0 + near[1]):
                continue
            ends_met = [
                v
                for chord, part, reach in ((one, s, near[0]), (other, t, near[1]))
                for v, gap in ((chord[0], abs(part)), (chord[-1], abs(1.0 - part)))
                if gap <= reach
            ]
            if len(ends_met) > 1 and not (0.0 <= s <= 1.0 and 0.0 <= t <= 1.0):
                continue  # side by side at a side of the cell; else they cross close to it
            at = a + s * (b - a)
            node = ends_met[0] if ends_met else _node(nodes, new, at, corners[0] + at @ frame)
            for k, part in ((i, s), (j, t)):
                if node not in chords[k] and all(node != v for _, v in met[k]):
                    met[k].append((part, node))
    for chord, found in zip(chords, met, strict=True):
        chord[1:1] = [node for _, node in sorted(found)]


def _frame(corners: Array) -> Array:
    """Two orthogonal axes (2, 3) in the plane of a cell, as long as its longer side."""
    u, v = corners[1] - corners[0], corners[2] - corners[0]
    x = u / np.linalg.norm(u)
    y = v - (v @ x) * x
    size = np.sqrt(max(u @ u, v @ v))
    return np.asarray(size * np.stack([x, y / np.linalg.norm(y)]))


def _node(nodes: CutNodes, new: list[tuple[Array, int]], at: Array, place: Array) -> int:
    """The node at a place (3,), `at` (2,) in the cell's frame, new if there is none nearby."""
    for other, node in new:
        if np.hypot(*(at - other)) <= nodes.within:
            return node
    new.append((at, nodes.new(place)))
    return new[-1][1]
