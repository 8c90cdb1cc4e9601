"""Retracing: cables without friction slide sideways to where they are straight on the membrane.

A taut cable without friction lies along a geodesic of the current, folded surface. Instead of
moving it over one vertex per equilibrium, its path is pulled taut on the shape that is there and
the new path tried: it is kept if the energy falls, else only half of the flips are tried. No path
is tried twice, so this ends.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence, Set
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.cable import CableNode, End, LaidCable
from crms_fenicsx.cables.contact import INSIDE, drape
from crms_fenicsx.cables.corridor import flaw
from crms_fenicsx.cables.crossings import note_places
from crms_fenicsx.cables.folded_surface import FoldedSurface, bends
from crms_fenicsx.cables.intrinsic import MissingStars
from crms_fenicsx.cables.laying import fractions_of, nodes_of
from crms_fenicsx.cables.path import EdgePoint, SurfacePoint, VertexPoint, without_backtracking
from crms_fenicsx.cables.shadow import with_shadows
from crms_fenicsx.cables.shorten import Corridor, corridor, pass_vertex, shorten
from crms_fenicsx.cables.strip import StripShape, grow
from crms_fenicsx.errors import PathError

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene

Array = npt.NDArray[np.float64]

GRIP = 0.05
"""Angle (rad) by which a path along mesh lines must bend at a vertex to leave it before the cable
has pressed its crease into the membrane: a path along a line of the mesh stays there."""


NEAR = 0.1
"""Part of an edge by which a point of a cable with friction may have to move on a new path, and
still stays where it is: others are those that are put back in place."""


PRESSED = 0.01
"""Part of an edge: a point nearer than this to a vertex is held by it."""


STILL = 1e-4
"""Movement, relative to a cable's length, within which rejected paths stay rejected."""


class Tried(NamedTuple):
    """Paths that were tried in earlier load steps, by cable.

    Attributes
    ----------
    refused
        Paths that have been given up.
    passed
        Vertices of which the other side was tried.
    at : (n, 3)
        Where the cable was then (length).
    """

    refused: dict[str, set[Corridor]]
    passed: dict[str, set[int]]
    at: dict[str, Array]


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
        self._passed: dict[str, set[int]] = {}
        self._tried_at: dict[str, Array] = {}
        self._first_look = True
        self._strings = True
        """Whether strings still tell where cables go that others cross."""
        self.offered: set[tuple[str, Corridor]] = set()
        self.withheld: set[tuple[str, Corridor]] = set()
        """Ways past a vertex, by cable, that cables with friction are led now, and that they have
        not taken."""
        self.led: Counter[tuple[str, int, bool]] = Counter()
        """How often cables with friction have been led past a vertex in this step, to its left or
        not."""

    @property
    def tried(self) -> Tried:
        """The paths that were tried in earlier load steps."""
        return Tried(self.refused, self._passed, self._tried_at)

    def remember(self, tried: Tried) -> None:
        """Go on from the load steps of another retracer of the same cables."""
        self.refused, self._passed, self._tried_at = tried

    def begin_step(self) -> None:
        """Prepare for a load step."""
        self._first_look = self._strings = True
        self.offered, self.withheld = set(), set()
        self.led.clear()

    def _forget(self) -> None:
        """Forget which paths were tried, but not those of cables that have not moved since.

        Once in a load step, in its first equilibrium: what was rejected in the state that is there
        would be rejected again, and a step without any load shall cost nothing.
        """
        if not self._first_look:
            return
        self._first_look = False
        for cable in self.scene.cables:
            before, x = self._tried_at.get(cable.name), cable.positions
            if (
                before is None
                or before.shape != x.shape
                or np.abs(before - x).max() > STILL * cable.length
            ):
                self.refused.pop(cable.name, None)
                self._passed.pop(cable.name, None)

    def end_step(self) -> None:
        """Remember where the cables are."""
        for cable in self.scene.cables:
            self._tried_at[cable.name] = cable.positions.copy()

    def straighten(self) -> bool:
        """Pull the paths of cables taut that have not been in equilibrium yet. Collective.

        A taut cable on a bad path would cut into the membrane, and nothing converge.

        Returns
        -------
        Whether there were any.
        """
        fresh = [
            cable
            for cable in self.scene.cables
            if cable.taut and not cable.traced and cable.slides_freely
        ]
        if not fresh:
            return False
        others = [cable for cable in self.scene.cables if cable not in fresh]
        for cable in fresh:
            cable.lifted[:] = False
        self._retrace(fresh, folded_by=others, fresh=True)
        shape = StripShape.of(self.scene)
        for cable in fresh:
            if not cable.sleeve:
                drape(cable, shape)
            # Pulled straight it may turn out to be too long for its path: slack after all.
            cable.taut = cable.is_tight(cable.ends_before is None)
            cable.traced = cable.taut
        return True

    def lay_again(self, numbers: Set[int]) -> None:
        """Forget where the fold points of some cables are, given by number, so that `straighten`
        puts them on straight edges."""
        for c in numbers:
            self.scene.cables[c].traced = False

    def renew_shadows(self) -> list[str]:
        """Bring the paths of lifted parts under their spans; say which changed. Collective."""
        changes = []
        for cable in self.scene.cables:
            if not cable.taut or not cable.lifted.any():
                continue
            for rings in itertools.count(1):
                surface = self.surface()
                try:
                    found = with_shadows(cable, surface.shape)
                    break
                except MissingStars as missing:
                    grow(self.scene, missing.vertices, rings)
            # A span that turns over its own touchdown keeps the shadow that it had.
            if found is not None and not flaw(corridor(found[0]), surface.thirds):
                points, lifted = found
                surface = self.surface([v for point in points for v in point.support])
                self._adopt(cable, points, lifted, surface)
                changes.append(f"{cable.name} hangs over other cells")
        return changes

    def check_on_membrane(self) -> None:
        """Make sure that no cable has slid off the membrane. Collective.

        Raises
        ------
        PathError
            All contacts of a cable have closed in on one vertex of the boundary.
        """
        for cable in self.scene.cables:
            nodes = [cable.nodes[k] for k in cable.contacts()]
            places = [set(node.point.support) for node in nodes if node.point is not None]
            if not cable.taut or not places or len(cable.blocked) < len(places):
                continue
            common = set.intersection(*places)
            surface = self.surface(sorted(common))
            for vertex in common:
                if surface.is_boundary((vertex,)):
                    raise PathError(
                        f"{cable.name!r} has slid off the membrane's edge at "
                        f"{surface.shape.at(vertex)}; hold it there by a sleeve or an anchor, or "
                        "load it less."
                    )

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
        self._forget()
        free = [
            cable
            for cable in self.scene.cables
            if cable.taut and cable.slides_freely and (self._strings or not _is_crossed(cable))
        ]
        return self._retrace(free, max_flips) if free else 0

    def refused_now(self) -> dict[str, set[Corridor]]:
        """A copy of what has been tried."""
        return {name: set(ways) for name, ways in self.refused.items()}

    def give_up_strings(self) -> None:
        """Let strings no longer tell, in this load step, where cables go that others cross."""
        self._strings = False

    def near_vertices(self, near: float) -> list[tuple[int, int]]:
        """Vertices near which cables pass, one for each cable: (cable, vertex), nearest first.

        The string does not tell on which side of a vertex the energy is lower where the fold
        points are pressed against it.

        Parameters
        ----------
        near
            Distance from the vertex, as a part of the edge, up to which a cable passes near it.

        Returns
        -------
        Those that have not been tried before.
        """
        found: list[tuple[float, int, int]] = []
        for c, cable in enumerate(self.scene.cables):
            if cable.taut and cable.slides_freely:
                close = _near(cable, max(near, PRESSED) if _is_crossed(cable) else near)
                for vertex in self._passed.get(cable.name, ()):
                    close.pop(vertex, None)
                found += sorted((away, c, vertex) for vertex, away in close.items())[:1]
        return [(c, vertex) for _, c, vertex in sorted(found)]

    def pass_vertices(self, group: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """Lead cables around the other side of vertices. Collective.

        Parameters
        ----------
        group
            Of different cables: (cable, vertex).

        Returns
        -------
        Those of the group that have another side. The others will not be tried again.
        """
        led = [one for one in group if self._pass_vertex(self.scene.cables[one[0]], one[1])]
        self.note_passed([one for one in group if one not in led])
        return led

    def note_passed(self, group: Sequence[tuple[int, int]]) -> None:
        """Do not try the other side of these vertices, (cable, vertex), again."""
        for c, vertex in group:
            self._passed.setdefault(self.scene.cables[c].name, set()).add(vertex)

    def _pass_vertex(self, cable: LaidCable, vertex: int) -> bool:
        surface = self.surface([vertex])
        refused = self.refused.setdefault(cable.name, set())
        points: list[SurfacePoint] = []
        lifted: list[bool] = []
        passed = False
        path = list(cable.path.points)
        around = {k for k, point in enumerate(path) if vertex in point.support}
        for is_off, run in _runs(cable, touching=vertex):
            new = path[run.start : run.stop]
            # All edges of the vertex that the cable crosses must be in one part that touches.
            if not is_off and len(run) > 2 and around and around.issubset(run):
                refused.add(corridor(new))
                other_side = pass_vertex(new, surface, vertex, refused=refused)
                if other_side is not None:
                    new, passed = list(other_side), True
            points += new
            lifted += [is_off] * len(new)
        if not passed:
            return False
        grow(self.scene, [v for point in points for v in point.support])
        self._adopt(cable, points, lifted, self.surface())
        return True

    def _retrace(
        self,
        cables: Sequence[LaidCable],
        max_flips: int | None = None,
        folded_by: Sequence[LaidCable] | None = None,
        fresh: bool = False,
    ) -> int:
        folds = bends(self.scene.cables if folded_by is None else folded_by)
        surface = FoldedSurface(StripShape.of(self.scene), folds)
        done: list[tuple[LaidCable, tuple[list[SurfacePoint], list[bool], int]]] = []
        for cable in cables:
            for rings in itertools.count(1):
                try:
                    done.append((cable, self._pulled(cable, surface, max_flips, fresh)))
                    break
                except MissingStars as missing:
                    grow(self.scene, missing.vertices, rings)
                    surface = FoldedSurface(StripShape.of(self.scene), folds)
        most = 0
        for cable, (points, lifted, flips) in done:
            if flips or fresh:
                self._adopt(cable, points, lifted, surface)
                most = max(most, flips)
        if most or fresh:
            nodes = [node.point for cable in cables for node in cable.nodes]
            grow(self.scene, [v for p in nodes if p is not None for v in p.support])
        return most

    def surface(self, vertices: Sequence[int] = ()) -> FoldedSurface:
        """The current surface, with all cells around some vertices. Collective."""
        grow(self.scene, vertices)
        return FoldedSurface(StripShape.of(self.scene), bends(self.scene.cables))

    def _pulled(
        self, cable: LaidCable, surface: FoldedSurface, max_flips: int | None, fresh: bool
    ) -> tuple[list[SurfacePoint], list[bool], int]:
        """The path pulled taut: its points, which of them are lifted, how many flips."""
        path = list(cable.path.points)
        refused = self.refused.setdefault(cable.name, set())
        held_at = None
        if _is_crossed(cable) and not fresh:
            visited = {p.vertex for p in path if isinstance(p, VertexPoint)}
            held_at = visited | set(_near(cable, PRESSED)) - self._passed.get(cable.name, set())
        points: list[SurfacePoint] = []
        lifted: list[bool] = []
        passed = 0
        for is_off, run in _runs(cable):
            new = path[run.start : run.stop]
            if not is_off:
                # Pulled between the places under the spans at its ends, or the anchors beyond.
                before, after = self._beyond(cable, surface, path, run)
                joined = self.with_anchors(cable, surface)
                string = [*before, *new, *after]
                if flaw(corridor(string), joined.thirds):  # a span over its own touchdown
                    before, after, string = [], [], new
                if len(string) > 2 and not flaw(corridor(string), joined.thirds):
                    refused.add(corridor(string))
                    result = shorten(
                        string, joined, refused=refused, max_flips=max_flips,
                        grip=GRIP if fresh else 0.0, held_at=held_at,
                    )  # fmt: skip
                    passed += len(result.flips)
                    new = list(result.points[len(before) : len(result.points) - len(after)])
            points += new
            lifted += [is_off] * len(new)
        return points, lifted, passed

    def _beyond(
        self,
        cable: LaidCable,
        surface: FoldedSurface,
        path: Sequence[SurfacePoint],
        run: Sequence[int],
    ) -> tuple[list[SurfacePoint], list[SurfacePoint]]:
        """What a run of contacts is pulled between, before and after it."""
        before, after = path[: run[0]][-1:], path[run[-1] + 1 :][:1]
        anchors = [VertexPoint(k) for k in self._anchors(cable)]
        if not before and cable.ends[0] == "off" and surface.is_boundary(path[0].support):
            before = anchors[:1]
        if not after and cable.ends[1] == "off" and surface.is_boundary(path[-1].support):
            after = anchors[-1:]
        return list(before), list(after)

    def _anchors(self, cable: LaidCable) -> dict[int, Array]:
        """Positions of a cable's anchors off the membrane, by ids that no vertex has."""
        n = self.scene.V.dofmap.index_map.size_global
        places = (cable.positions[0], cable.positions[-1])
        return {n + k: places[k] for k in (0, 1) if cable.ends[k] == "off"}

    def with_anchors(self, cable: LaidCable, surface: FoldedSurface) -> FoldedSurface:
        anchors = self._anchors(cable)
        if not anchors:
            return surface
        n, path = self.scene.V.dofmap.index_map.size_global, cable.path.points
        ends = {k: path[n - k].support for k in anchors}  # n is the first, n + 1 the last
        return FoldedSurface(surface.shape, surface.bends, anchors, ends)

    def lead(self, cable: LaidCable, points: Sequence[SurfacePoint], ends: tuple[End, End]) -> None:
        """Give a cable a path whose ends have been moved along the boundary. Collective.

        It is to be straightened then: with its old folds it would cut into the membrane.
        """
        surface = self.surface([v for point in points for v in point.support])
        off = {
            node.point.support
            for node, lifted in zip(cable.nodes, cable.lifted, strict=True)
            if lifted and node.point is not None
        }
        way = without_backtracking(points, surface.strip.outer_cells)
        self._adopt(cable, way, [point.support in off for point in way], surface, ends)
        cable.traced = False

    def _adopt(
        self,
        cable: LaidCable,
        points: Sequence[SurfacePoint],
        lifted: Sequence[bool],
        surface: FoldedSurface,
        ends: tuple[End, End] | None = None,
    ) -> None:
        """Give a cable a new path; points on edges that it crossed before stay where they are.

        Before the first equilibrium they go to the string's places: the way in which a cable was
        laid is none in which it could be taut.
        """
        before = {
            _key(node): k
            for k, node in enumerate(cable.nodes)
            if node.kind != "crossing"
            and (cable.traced or not cable.slides_freely or not node.slides)
        }
        ends = cable.ends if ends is None else ends
        first, last = (int(end != "off") for end in ends)
        slides = range(first, len(points) - last)
        clipped = [self._clipped(cable, p) if k in slides else p for k, p in enumerate(points)]
        nodes = nodes_of(clipped, surface.strip, ends)
        fractions = fractions_of(nodes)
        flags = np.zeros(len(nodes), dtype=bool)
        flags[[k for k, node in enumerate(nodes) if node.point is not None]] = lifted
        positions = np.zeros((len(nodes), 3))
        for k, node in enumerate(nodes):
            old = before.get(_key(node))
            if node.kind == "anchor":
                positions[k] = cable.positions[0 if k == 0 else -1]
            elif old is not None and _stays(cable, old, node):
                positions[k], fractions[k] = cable.positions[old], cable.fractions[old]
            elif isinstance(node.point, EdgePoint):
                positions[k] = surface.place(node.point.edge, node.point.fraction)
            else:
                ids, weights = node.masters()
                positions[k] = np.dot(weights, [surface.shape.at(i) for i in ids])
        note_places(cable)
        cable.set_nodes(nodes, positions, fractions, flags)

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
    """What a node is known by while a path changes: its edge if it slides, else its place."""
    return None if node.point is None else node.point.support if node.slides else node.point


def _is_crossed(cable: LaidCable) -> bool:
    """Whether a cable is in contact with another one that crosses it.

    The surface on which strings are pulled does not have the points inside cells where cables press
    each other in. So it tells them where they bend to within the angles by which they do so there
    only, and on fine meshes where they would not go.
    """
    return any(node.crossing is not None for node in cable.nodes)


def _runs(cable: LaidCable, touching: int | None = None) -> list[tuple[bool, range]]:
    """The parts of a path that are lifted, and those that are not: indices of their points.

    Where the cable lifts only from edges of the vertex `touching` it counts as touching.
    """
    path = cable.path.points
    off = [
        bool(lifted)
        for lifted, node in zip(cable.lifted, cable.nodes, strict=True)
        if node.point is not None and node.kind != "crossing"
    ]
    runs = _alike(off)
    if touching is None:
        return runs
    for is_off, run in runs:
        if is_off and all(touching in path[k].support for k in run):
            off[run.start : run.stop] = [False] * len(run)
    return _alike(off)


def _alike(flags: Sequence[bool]) -> list[tuple[bool, range]]:
    """Runs of equal flags, and their indices."""
    starts = [k for k in range(len(flags)) if k == 0 or flags[k] != flags[k - 1]]
    return [(flags[a], range(a, b)) for a, b in itertools.pairwise([*starts, len(flags)])]


def _near(cable: LaidCable, near: float) -> dict[int, float]:
    """Vertices near which a cable's points slide, and how near, as a part of the edge."""
    found: dict[int, float] = {}
    for k in cable.contacts():
        point = cable.nodes[k].point
        if cable.nodes[k].slides and isinstance(point, EdgePoint):
            fraction = float(cable.fractions[k])
            vertex, away = point.edge[int(fraction > 0.5)], min(fraction, 1 - fraction)
            if away < near:
                found[vertex] = min(away, found.get(vertex, 1.0))
    return found


def _stays(cable: LaidCable, old: int, node: CableNode) -> bool:
    """Whether a point that the path had before stays where equilibrium has put it."""
    if not node.slides or not isinstance(node.point, EdgePoint):
        return True
    fraction = float(cable.fractions[old])
    moved = 0.0 if cable.slides_freely else abs(fraction - node.point.fraction)
    return moved <= NEAR and INSIDE <= fraction <= 1 - INSIDE
