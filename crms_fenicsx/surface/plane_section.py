"""The section of a surface with a plane, as a graph of the points that it meets.

Which edges and vertices it meets is decided once, by the sign of every vertex's distance to the
plane, with a small neighbourhood of the plane counted as zero; after that no coordinate can
contradict it.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from crms_fenicsx.meshes.triangles import altitudes, dot, norm
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import PathError, as_text
from crms_fenicsx.surface.closest_point import Node, Surface, edge_count
from crms_fenicsx.surface.plane_cuts import Cut
from crms_fenicsx.surface.points import CellPoint, EdgePoint, SurfacePoint, VertexPoint, edge_of

# Nodes of a section: (vertex,), (smaller, larger) for an edge, and the two ends of a leg where
# they are neither.
START: Node = (-1,)
END: Node = (-2,)


# The rims of an opening face each other when both look along the line between them, within this
# cosine: domes narrow towards the ground less than that, up to three quarters of a circle.
FACING = float(np.sqrt(0.5))


@dataclass(frozen=True)
class Section:
    """The section of a surface with a plane, as a graph of the points it meets.

    Units: points, positions (length).
    """

    points: dict[Node, SurfacePoint]
    positions: dict[Node, Array]
    arcs: dict[Node, dict[Node, float]]
    cells: dict[Node, list[Node]]

    @property
    def rim(self) -> set[Node]:
        """The nodes on the surface's boundary: edges and vertices of edges with one cell."""
        count = edge_count(self.cells)
        vertices = {v for edge, n in count.items() if n == 1 for v in edge}
        return {
            node
            for node, point in self.points.items()
            if count[point.support] == 1 or (len(node) == 1 and node[0] in vertices)
        }

    def join(self, a: Node, b: Node) -> None:
        """Put in the arc between two nodes."""
        length = float(norm(self.positions[a] - self.positions[b]))
        self.arcs[a][b] = self.arcs[b][a] = length

    def put(self, point: SurfacePoint, position: Array, own: Node) -> Node:
        """Return the node of a point, which is `own`, put in, where there is none yet."""
        known = not isinstance(point, CellPoint) and point.support in self.points
        node = point.support if known else own
        self.points[node], self.positions[node] = point, position
        if known:
            for other in list(self.arcs[node]):
                self.join(node, other)
            return node
        self.arcs[node] = {}
        support = set(point.support)
        for corners, nodes in self.cells.items():
            if support.issubset(corners):
                for other in nodes:
                    self.join(node, other)
        return node

    def nearest(
        self, target: Array, surface: Surface, snap: float
    ) -> tuple[SurfacePoint, Array] | None:
        """Return the section's place nearest to a point of its plane; None if it is empty.

        It is a node where it is as near to one as `snap` says.
        """
        chords = sorted(
            (nodes[0], nodes[1], corners)
            for corners, nodes in self.cells.items()
            if len(nodes) == 2
        )
        if not chords:
            return None
        start = np.array([self.positions[a] for a, _, _ in chords])
        side = np.array([self.positions[b] for _, b, _ in chords]) - start
        t = np.clip(dot(target - start, side) / np.maximum(dot(side, side), 1e-300), 0.0, 1.0)
        places = start + t[:, None] * side
        i = int(np.argmin(norm(places - target)))
        a, b, corners = chords[i]
        reach = snap * float(altitudes(surface.points[[[surface.row_of[v] for v in corners]]])[0])
        closer = min((a, b), key=lambda node: float(norm(self.positions[node] - places[i])))
        if norm(self.positions[closer] - places[i]) <= reach:
            return self.points[closer], self.positions[closer]
        weights = dict.fromkeys(corners, 0.0)
        for node, part in ((a, 1.0 - float(t[i])), (b, float(t[i]))):
            point = self.points[node]
            f = point.fraction if isinstance(point, EdgePoint) else 0.0
            for vertex, weight in zip(node, (1.0 - f, f), strict=False):
                weights[vertex] += part * weight
        (u, v, w), (x, y, z) = corners, weights.values()
        return CellPoint((u, v, w), (x, y, z)), places[i]

    def gaps(self) -> dict[tuple[Node, Node], float]:
        """Return the openings in the section, with their widths along the arc over them.

        An opening is where the section ends at the boundary and would go on at another end of it
        that faces it. The outside of a dome or of a hall is none: what lies below the ground turns
        away from the membrane there.
        """
        ends: list[Node] = []
        looks: list[Array] = []
        for node in sorted(self.rim):
            if len(self.arcs[node]) == 1:
                (inner,) = self.arcs[node]
                outward = self.positions[node] - self.positions[inner]
                ends.append(node)
                looks.append(np.asarray(outward / max(float(norm(outward)), 1e-300)))
        found: dict[tuple[Node, Node], float] = {}
        for (a, out), (b, back) in combinations(zip(ends, looks, strict=True), 2):
            between = self.positions[b] - self.positions[a]
            width = float(norm(between))
            if min(float(dot(between, out)), -float(dot(between, back))) >= FACING * width:
                half = 0.5 * float(np.arccos(np.clip(-dot(out, back), -1.0, 1.0)))
                found[a, b] = width / float(np.sinc(half / np.pi))
        return found


def section_of(cut: Cut, name: str) -> Section:
    """Return the section of a surface with a plane from the cells that this cuts."""
    section = Section({}, {}, {}, {})
    points, arcs = section.points, section.arcs
    for row, ((u, v, w), meets) in enumerate(zip(cut.ids, cut.meets, strict=True)):
        keys: list[Node] = [(u,), (v,), (w,), edge_of(u, v), edge_of(v, w), edge_of(w, u)]
        nodes: list[Node] = []
        for k, node in enumerate(keys):
            if not meets[k]:
                continue
            nodes.append(node)
            if node not in points:
                arcs[node], section.positions[node] = {}, cut.places[row, k]
                if k < 3:
                    points[node] = VertexPoint(node[0])
                else:
                    points[node] = EdgePoint((node[0], node[1]), cut.fractions[row][k - 3])
        if len(nodes) == 3:
            raise PathError(
                f"{name} runs in the plane of cell {(u, v, w)} near "
                f"{as_text(section.positions[nodes[0]])}, a wall or a cell without area; "
                "turn the leg a little or put a route point beside it"
            )
        if len(nodes) == 2:
            a, b = nodes
            arcs[a][b] = arcs[b][a] = cut.lengths[row]
        section.cells[u, v, w] = nodes
    return section


def shortest(
    arcs: dict[Node, dict[Node, float]], start: Node
) -> tuple[dict[Node, float], dict[Node, Node]]:
    """Return lengths from `start` to all that hangs together with it, and the node before."""
    reached: dict[Node, float] = {}
    before: dict[Node, Node] = {}
    queue: list[tuple[float, Node, Node]] = [(0.0, start, start)]
    while queue:
        length, node, previous = heapq.heappop(queue)
        if node in reached:
            continue
        reached[node] = length
        before[node] = previous
        for other, step in arcs[node].items():
            if other not in reached:
                heapq.heappush(queue, (length + step, other, node))
    return reached, before


def way_back(before: dict[Node, Node], end: Node) -> list[Node]:
    """Return the nodes from the start of the shortest ways to `end`."""
    nodes = [end]
    while before[nodes[-1]] != nodes[-1]:
        nodes.append(before[nodes[-1]])
    return nodes[::-1]
