"""Retracing: cables without friction slide sideways to where they are straight on the membrane.

A taut cable without friction lies along a geodesic of the current, folded surface. Instead of
moving it over one vertex per equilibrium, its path is pulled taut on the shape that is there and
the new path tried: it is kept if the energy falls, else only half of the flips are tried. No path
is tried twice, so this ends.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence, Set
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.active import bends
from crms_fenicsx.cables.cable import CableNode, LaidCable
from crms_fenicsx.cables.contact import INSIDE
from crms_fenicsx.cables.intrinsic import MissingStars, Ring
from crms_fenicsx.cables.laying import fractions_of, nodes_of
from crms_fenicsx.cables.path import EdgePoint, SurfacePoint
from crms_fenicsx.cables.shorten import Corridor, corridor, shorten
from crms_fenicsx.cables.strip import StripShape, grow

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene

Array = npt.NDArray[np.float64]
Edge = tuple[int, int]


GRIP = 0.05
"""Angle (rad) by which a path along mesh lines must bend at a vertex to leave it before the cable
has pressed its crease into the membrane: a path along a line of the mesh stays there."""


NEAR = 0.1
"""Points nearer to the string's than this part of an edge stay where equilibrium has put them;
others would make the new path a zigzag."""


class FoldedSurface:
    """Lengths and neighbours on the current surface, folded by the cables in tension.

    Parameters
    ----------
    shape
        Positions of the vertices around the cables.
    bends
        Positions of the fold points on each edge, in order.
    """

    def __init__(self, shape: StripShape, bends: Mapping[Edge, Sequence[Array]]) -> None:
        self.shape, self.strip, self.bends = shape, shape.strip, bends
        self._at: dict[int, tuple[float, float, float]] = {}
        for vertex, row in shape.strip.row_of.items():
            x, y, z = shape.current[row]
            self._at[vertex] = (float(x), float(y), float(z))

    def line(self, edge: Edge) -> Array:
        """Positions along an edge: its vertices and the fold points between, (n, 3)."""
        return np.array([self.shape.at(edge[0]), *self.bends.get(edge, ()), self.shape.at(edge[1])])

    def length(self, edge: Edge) -> float:
        """Length of an edge through all fold points on it."""
        if edge not in self.bends:
            return math.dist(self._at[edge[0]], self._at[edge[1]])
        return float(np.linalg.norm(np.diff(self.line(edge), axis=0), axis=1).sum())

    def thirds(self, edge: Edge) -> tuple[int, ...]:
        """Vertices opposite to an edge."""
        cells = (self.strip.corners[row] for row in self.strip.rows(edge))
        return tuple(v for cell in cells for v in cell if v not in edge)

    def ring(self, vertex: int) -> Ring:
        """Neighbours of a vertex in order."""
        if vertex not in self.strip.complete:
            raise MissingStars([vertex])
        after: dict[int, int] = {}
        for row in self.strip.rows((vertex,)):
            cell = self.strip.corners[row]
            k = cell.index(vertex)
            after[cell[k - 2]] = cell[k - 1]
        starts = set(after) - set(after.values())
        first = min(starts) if starts else min(after)
        around = [first]
        while around[-1] in after and (len(around) == 1 or around[-1] != first):
            around.append(after[around[-1]])
        closed = not starts
        return Ring(tuple(around[:-1] if closed else around), closed)

    def place(self, edge: Edge, fraction: float) -> Array:
        """Position on an edge at a share of its length."""
        line = self.line(edge)
        run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        place = [np.interp(fraction * run[-1], run, line[:, i]) for i in range(3)]
        return np.array(place)


class Retracer:
    """Pulls the paths of the cables taut, and remembers which paths have been tried.

    Parameters
    ----------
    scene
        The scene; its cables are changed.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.refused: dict[str, set[Corridor]] = {}

    def straighten(self) -> bool:
        """Pull the paths of cables taut that have not been in equilibrium yet. Collective.

        A taut cable on a bad path would cut into the membrane, and nothing converge.

        Returns
        -------
        Whether there were any.
        """
        fresh = [cable for cable in self.scene.cables if cable.taut and not cable.traced]
        if not fresh:
            return False
        others = [cable for cable in self.scene.cables if cable not in fresh]
        self._retrace(fresh, folded_by=others, fresh=True)
        for cable in fresh:
            cable.traced = True
        return True

    def lay_again(self, numbers: Set[int]) -> None:
        """Forget where the fold points of some cables are, given by number, so that `straighten`
        puts them on straight edges."""
        for c in numbers:
            self.scene.cables[c].traced = False

    def retrace(self, max_flips: int | None = None) -> int:
        """Pull the paths of all cables in tension taut on the current surface. Collective.

        Parameters
        ----------
        max_flips
            How many vertices each may pass; None: as many as it takes.

        Returns
        -------
        How many vertices the cable that has passed most has; 0: no path has changed.
        """
        return self._retrace([cable for cable in self.scene.cables if cable.taut], max_flips)

    def _retrace(
        self,
        cables: Sequence[LaidCable],
        max_flips: int | None = None,
        folded_by: Sequence[LaidCable] | None = None,
        fresh: bool = False,
    ) -> int:
        scene = self.scene
        assert scene.strip is not None
        folds = bends(scene.cables if folded_by is None else folded_by)
        shape = StripShape.of(scene, scene.strip)
        surface = FoldedSurface(shape, folds)
        done: list[tuple[LaidCable, tuple[list[SurfacePoint], list[bool], int]]] = []
        for cable in cables:
            for rings in itertools.count(1):
                try:
                    done.append((cable, self._pulled(cable, surface, max_flips, fresh)))
                    break
                except MissingStars as missing:
                    grow(scene, missing.vertices, rings)
                    shape = StripShape.of(scene, scene.strip)
                    surface = FoldedSurface(shape, folds)
        most = 0
        for cable, (points, lifted, flips) in done:
            if flips or fresh:
                self._adopt(cable, points, lifted, surface)
                most = max(most, flips)
        if most or fresh:
            nodes = [node.point for cable in cables for node in cable.nodes]
            grow(scene, [v for point in nodes if point is not None for v in point.support])
        return most

    def _pulled(
        self, cable: LaidCable, surface: FoldedSurface, max_flips: int | None, fresh: bool
    ) -> tuple[list[SurfacePoint], list[bool], int]:
        """The path pulled taut: its points, which of them are lifted, how many flips."""
        path = list(cable.path.points)
        own = [
            k
            for k, node in enumerate(cable.nodes)
            if node.point is not None and node.kind != "crossing"
        ]
        off = [bool(cable.lifted[k]) for k in own]
        refused = self.refused.setdefault(cable.name, set())
        refused.add(corridor(path))
        points: list[SurfacePoint] = []
        lifted: list[bool] = []
        passed = 0
        for is_off, group in itertools.groupby(range(len(path)), key=off.__getitem__):
            run = list(group)
            if is_off:
                points += [path[k] for k in run]
                lifted += [True] * len(run)
                continue
            # A run of contacts is pulled between the places under the spans at its ends.
            first, last = max(run[0] - 1, 0), min(run[-1] + 1, len(path) - 1)
            new = list(path[first : last + 1])
            if len(new) > 2:
                result = shorten(
                    new, surface, refused=refused, max_flips=max_flips,
                    grip=GRIP if fresh else 0.0,
                )  # fmt: skip
                passed += len(result.flips)
                new = list(result.points)
            new = new[run[0] - first : len(new) - (last - run[-1])]
            points += new
            lifted += [False] * len(new)
        return points, lifted, passed

    def _adopt(
        self,
        cable: LaidCable,
        points: Sequence[SurfacePoint],
        lifted: Sequence[bool],
        surface: FoldedSurface,
    ) -> None:
        """Give a cable a new path; points on edges that it crossed before stay where they are.

        Before the first equilibrium they go to the string's places: the way in which a cable was
        laid is none in which it could be taut.
        """
        before = {
            _key(node): k
            for k, node in enumerate(cable.nodes)
            if node.kind != "crossing" and (cable.traced or not node.slides)
        }
        nodes = nodes_of([self._clipped(cable, p) for p in points], surface.strip, cable.ends)
        fractions = fractions_of(nodes)
        flags = np.zeros(len(nodes), dtype=bool)
        flags[[k for k, node in enumerate(nodes) if node.point is not None]] = lifted
        positions = np.zeros((len(nodes), 3))
        for k, node in enumerate(nodes):
            old = before.get(_key(node))
            if node.kind == "anchor":
                positions[k] = cable.positions[0 if k == 0 else -1]
            elif old is not None and self._stays(cable, old, node):
                positions[k], fractions[k] = cable.positions[old], cable.fractions[old]
            elif isinstance(node.point, EdgePoint):
                positions[k] = surface.place(node.point.edge, node.point.fraction)
            else:
                ids, weights = node.masters()
                positions[k] = np.dot(weights, [surface.shape.at(i) for i in ids])
        cable.set_nodes(nodes, positions, fractions, flags)

    def _stays(self, cable: LaidCable, old: int, node: CableNode) -> bool:
        """Whether a point that the path had before may stay where it is."""
        if not node.slides or not isinstance(node.point, EdgePoint):
            return True
        fraction = float(cable.fractions[old])
        near = abs(fraction - node.point.fraction) <= NEAR
        return near and INSIDE <= fraction <= 1 - INSIDE

    def _clipped(self, cable: LaidCable, point: SurfacePoint) -> SurfacePoint:
        """Keep a point of a string off the vertices.

        Strings of several cables may touch one vertex: there, too, no two of their points may be
        in one place, and their order must be the same all around.
        """
        if not isinstance(point, EdgePoint):
            return point
        least = INSIDE * (1 + 0.02 * self.scene.cables.index(cable))
        return EdgePoint(point.edge, min(max(point.fraction, least), 1 - least))


def _key(node: CableNode) -> object:
    return None if node.point is None else node.point.support
