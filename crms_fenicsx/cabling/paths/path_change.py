"""Changes of a cable's path: its surface, its typed nodes, and its replacement.

A path is first a sequence of points on the current surface, with arbitrary places on edges. Given
to a cable it keeps the cable's old points on the same edges, where equilibrium has put them.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Sequence, Set

import numpy as np

from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.crossings import at_nodes
from crms_fenicsx.cabling.cables.strip import Strip, StripShape
from crms_fenicsx.cabling.paths.creased_surface import CreasedSurface, FoldPoints
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, flags
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.path import without_backtracking
from crms_fenicsx.foundation.surface.points import (
    CellPoint,
    EdgePoint,
    Support,
    SurfacePoint,
    VertexPoint,
)
from crms_fenicsx.model.cable_state import CableNode, CableState, End
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL


def nodes_of(
    points: Sequence[SurfacePoint], strip: Strip, ends: tuple[End, End]
) -> tuple[CableNode, ...]:
    """Nodes for the points of a polyline, with anchors at its ends as needed."""
    nodes: list[CableNode] = []
    last = len(points) - 1
    for k, point in enumerate(points):
        in_place = (k == 0 and ends[0] != "off") or (k == last and ends[1] != "off")
        if isinstance(point, VertexPoint):
            nodes.append(CableNode("vertex", point))
        elif in_place or isinstance(point, CellPoint):
            nodes.append(CableNode("tied", point))
        elif point.edge in strip.held_edges:
            nodes.append(CableNode("edge slider", point))
        else:
            nodes.append(CableNode("fold", point))
    if ends[0] != "tied":
        nodes.insert(0, CableNode("anchor"))
    if ends[1] != "tied":
        nodes.append(CableNode("anchor"))
    return tuple(nodes)


def fractions_of(nodes: Sequence[CableNode]) -> Array:
    """Edge fractions of the nodes; NaN for other nodes."""
    points = (node.point for node in nodes)
    return np.array([p.fraction if isinstance(p, EdgePoint) else np.nan for p in points])


def is_crossed(cable: LaidCable) -> bool:
    """Whether a cable is in contact with a crossing one. The surface for geodesics lacks the points
    inside cells where cables press each other in. So geodesics ignore the bends there, and on fine
    meshes propose paths that cables would not take."""
    return any(node.crossing is not None for node in cable.state.nodes)


def leaves_cells(cable: LaidCable) -> bool:
    """Whether a cable slides into other cells by the membrane's shape alone."""
    return cable.slides_freely and not cable.keeps_line


def lifted_runs(cable: LaidCable) -> list[tuple[bool, range]]:
    """Lifted and other parts of a path: indices of their points."""
    lifted = flags(cable.state.lifted)
    off = [lifted[k] for k in cable.path_nodes()]
    starts = [k for k in range(len(off)) if k == 0 or off[k] != off[k - 1]]
    return [(off[a], range(a, b)) for a, b in itertools.pairwise([*starts, len(off)])]


def vertices_near(cable: LaidCable, near: float) -> set[int]:
    """Vertices within the fraction `near` of an edge from a cable's sliding points."""
    nodes, fractions = cable.state.nodes, cable.state.fractions
    beside = np.flatnonzero((np.minimum(fractions, 1 - fractions) < near) & ~cable.state.lifted)
    at = [(nodes[k].support, int(fractions[k] > 0.5)) for k in beside if nodes[k].slides]
    return {support[end] for support, end in at}


class PathChange:
    """Changes the paths of cables on the current surface."""

    def __init__(self, net: CableNet) -> None:
        self.net = net
        self._folds: tuple[list[CableState], FoldPoints] | None = None  # for these states

    @property
    def n_vertices(self) -> int:
        """Number of the membrane's vertices; larger ids are those of anchors."""
        return self.net.membrane.V.dofmap.index_map.size_global

    def surface(self, vertices: Sequence[int] = ()) -> CreasedSurface:
        """The current surface, including all cells around some vertices. Collective."""
        return CreasedSurface(self.shape(vertices), self.folds())

    def shape(
        self, vertices: Sequence[int] = (), rings: int = 1, like: StripShape | None = None
    ) -> StripShape:
        """The current shape, including all cells around some vertices: `like`, if that includes
        them. Collective."""
        self.net.grow_strip(vertices, rings)
        known = like is not None and like.strip is self.net.strip
        return like if like is not None and known else self.net.strip_shape()

    def folds_near(self, vertices: Sequence[int]) -> FoldPoints:
        """Fold points of all cables on the edges between some vertices."""
        return FoldPoints.of(self.net.cables, self.net.nodes, vertices)

    def folds(self) -> FoldPoints:
        """Fold points of all cables, cached until these change."""
        states = [cable.state for cable in self.net.cables]
        of, folds = self._folds or ([], None)
        same = len(of) == len(states) and all(map(operator.is_, of, states))
        if folds is None or not same:
            folds = FoldPoints.of(self.net.cables, self.net.nodes)
            self._folds = states, folds
        return folds

    def with_anchors(self, cable: LaidCable, surface: CreasedSurface) -> CreasedSurface:
        """The surface with triangles between its boundary and a cable's anchors."""
        anchors = self.anchors(cable, surface)
        if not anchors:
            return surface
        n, on_path = self.n_vertices, cable.path_nodes()
        # n is the first, n + 1 the last
        ends = {k: cable.state.nodes[on_path[n - k]].support for k in anchors}
        return surface.with_anchors(anchors, ends)

    def anchors(self, cable: LaidCable, surface: CreasedSurface) -> dict[int, Array]:
        """Positions of a cable's anchors off the membrane, by ids beyond those of vertices.
        Excluded is an anchor that a cable in a sleeve has left at a corner of the membrane, as at a
        moved mast: pulled straight to it the cable would leave the membrane."""
        ends, off = cable.ends, {}
        for k in (0, 1):
            if ends[k] == "off":
                if cable.lifts_off or not _is_corner(cable.path.points[-k], surface):
                    off[self.n_vertices + k] = cable.state.positions[-k]
        return off

    def beyond(
        self,
        cable: LaidCable,
        surface: CreasedSurface,
        path: Sequence[SurfacePoint],
        run: Sequence[int],
    ) -> tuple[list[SurfacePoint], list[SurfacePoint]]:
        """Points before and after a run of contacts between which it is pulled taut."""
        before, after = path[: run[0]][-1:], path[run[-1] + 1 :][:1]
        anchors, n = self.anchors(cable, surface), self.n_vertices
        if not before and n in anchors and surface.is_boundary(path[0].support):
            before = [VertexPoint(n)]
        if not after and n + 1 in anchors and surface.is_boundary(path[-1].support):
            after = [VertexPoint(n + 1)]
        return list(before), list(after)

    def move_ends(
        self, cable: LaidCable, points: Sequence[SurfacePoint], ends: tuple[End, End]
    ) -> None:
        """Replace the path of a cable whose ends have moved along the boundary. Collective. It must
        then be straightened: with its old folds the cable would cut into the membrane."""
        surface = self.surface([v for point in points for v in point.support])
        off = {
            node.point.support
            for node, is_off in zip(cable.state.nodes, cable.state.lifted, strict=True)
            if is_off and node.point is not None
        }
        way, lifted = shortened(points, off, surface.strip.outer_cells)
        self.replace(cable, way, lifted, surface, ends)
        cable.update(path_is_geodesic=False)

    def replace(
        self,
        cable: LaidCable,
        points: Sequence[SurfacePoint],
        lifted: Sequence[bool],
        surface: CreasedSurface,
        ends: tuple[End, End] | None = None,
    ) -> None:
        """Replace a cable's path, keeping points on edges that it crossed before, except those that
        lift off now. Before the first equilibrium they move to the string: along its laid line the
        cable would not be taut."""
        before = {
            _key(node): k
            for k, node in enumerate(cable.state.nodes)
            if node.kind != "crossing"
            and (cable.state.memory.path_is_geodesic or not cable.slides_freely or not node.slides)
        }
        ends = cable.ends if ends is None else ends
        first, last = (int(end != "off") for end in ends)
        slides = range(first, len(points) - last)
        clipped = [self._clipped(cable, p) if k in slides else p for k, p in enumerate(points)]
        nodes = nodes_of(clipped, surface.strip, ends)
        fractions = fractions_of(nodes)
        flags = np.zeros(len(nodes), dtype=bool)
        flags[[k for k, node in enumerate(nodes) if node.point is not None]] = [
            is_off or surface.strip.over_hole(point.support)
            for is_off, point in zip(lifted, clipped, strict=True)
        ]
        positions = np.zeros((len(nodes), 3))
        for k, node in enumerate(nodes):
            old = before.get(_key(node))
            if node.kind == "anchor":
                positions[k] = cable.state.positions[0 if k == 0 else -1]
            elif (
                old is not None and flags[k] <= cable.state.lifted[old] and _stays(cable, old, node)
            ):
                positions[k], fractions[k] = cable.state.positions[old], cable.state.fractions[old]
            elif isinstance(node.point, EdgePoint):
                positions[k] = surface.place(node.point.edge, node.point.fraction)
            else:
                positions[k] = surface.shape.mean(*node.interpolation())
        self.net.crossings = at_nodes(self.net.crossings, cable)
        cable.set_nodes(nodes, positions, fractions, flags)

    def _clipped(self, cable: LaidCable, point: SurfacePoint) -> SurfacePoint:
        """Keep a point of a string off the vertices. Strings of several cables may touch one
        vertex: their points must stay distinct there, with the same order all around."""
        if not isinstance(point, EdgePoint):
            return point
        least = TOL.inside * (1 + 0.02 * self.net.cables.index(cable))
        return EdgePoint(point.edge, min(max(point.fraction, least), 1 - least))


def shortened(
    points: Sequence[SurfacePoint], off: Set[Support], cells: Integers
) -> tuple[list[SurfacePoint], list[bool]]:
    """A path without points where it turns back, and whether each is lifted: those `off`."""
    kept = list(without_backtracking(points, cells))
    return kept, [point.support in off for point in kept]


def slid_off(cable: LaidCable, place: Array) -> PathError:
    """Error for a cable that has slid off the membrane, with its last place (3,) (length)."""
    return PathError(
        f"{cable.name!r} has slid off the membrane's edge at {place}; hold it there by a "
        "sleeve or an anchor, or load it less."
    )


def _key(node: CableNode) -> object:
    """Key of a node while its path changes: its edge if it slides, else its place."""
    return None if node.point is None else node.point.support if node.slides else node.point


def _is_corner(point: SurfacePoint, surface: CreasedSurface) -> bool:
    """Whether a point is a vertex at which the boundary turns by 60 degrees or more."""
    if not isinstance(point, VertexPoint) or point.vertex not in surface.strip.complete:
        return False
    if not surface.is_boundary(point.support):
        return False
    around = surface.membrane_ring(point.vertex).neighbours
    at = surface.shape.at(point.vertex)
    a, b = (surface.shape.at(v) - at for v in (around[0], around[-1]))
    return bool(a @ b > -0.5 * np.linalg.norm(a) * np.linalg.norm(b))


def _stays(cable: LaidCable, old: int, node: CableNode) -> bool:
    """Whether an old point stays where equilibrium has put it."""
    if not node.slides or not isinstance(node.point, EdgePoint):
        return True
    fraction = float(cable.state.fractions[old])
    moved = 0.0 if cable.slides_freely else abs(fraction - node.point.fraction)
    return moved <= TOL.stays and TOL.inside <= fraction <= 1 - TOL.inside
