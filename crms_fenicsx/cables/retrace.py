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
from crms_fenicsx.cables.corridor import Support, flaw
from crms_fenicsx.cables.crossings import note_places
from crms_fenicsx.cables.folded_surface import FoldedSurface, bends
from crms_fenicsx.cables.intrinsic import MissingStars
from crms_fenicsx.cables.laying import fractions_of, nodes_of
from crms_fenicsx.cables.path import EdgePoint, SurfacePoint, VertexPoint, without_backtracking
from crms_fenicsx.cables.shadow import with_shadows
from crms_fenicsx.cables.shorten import Corridor, corridor, shorten
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


MISLED, MISLED_AT_CROSSINGS = 2, 1
"""How often in a load step strings may propose paths of higher energy, before only the forces of
vertices tell where cables go; and where cables cross, of which strings know little."""


STILL = 1e-4
"""Movement, relative to a cable's length, within which rejected paths stay rejected."""


ContactKey = tuple[str, Support] | tuple[str, str]
"""A cable and its place on the mesh, or the upper and the lower one of two cables that cross."""


class Tried(NamedTuple):
    """What was tried in earlier load steps, by cable.

    Attributes
    ----------
    refused
        Paths that have been given up.
    left
        Runs of vertices that were left, and taken again: 1 for those left to the cable's left or
        -1, and the vertices.
    at : (n, 3)
        Where the cable was then, at the end of a load step (length).
    L0
        Unstressed length then (length).
    released, settled
        Where cables were let go, and where they stay however they pull.
    withheld, put_back
        What cables with friction have not taken: ways past vertices, and fold points put back in
        place.
    """

    refused: dict[str, set[Corridor]]
    left: dict[str, set[tuple[int, ...]]]
    at: dict[str, Array]
    L0: dict[str, float]
    released: set[ContactKey]
    settled: set[ContactKey]
    withheld: set[tuple[str, Corridor]]
    put_back: set[tuple[str, Corridor]]

    def forget(self, name: str) -> None:
        """Forget all of a cable."""
        for table in (self.refused, self.left, self.at, self.L0):
            table.pop(name, None)
        for keys in (self.released, self.settled):
            keys -= {key for key in keys if name in key}
        for ways in (self.withheld, self.put_back):
            ways -= {way for way in ways if way[0] == name}


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
        self.left: dict[str, set[tuple[int, ...]]] = {}
        """Runs of vertices that cables without friction were led past: 1 for their left or -1, and
        the vertices."""
        self._tried_at: dict[str, Array] = {}
        self._L0: dict[str, float] = {}
        self.released: set[ContactKey] = set()
        self.settled: set[ContactKey] = set()
        """Where cables have been let go in the last load step, and where they stay then."""
        self._first_look = True
        self._misled = 0
        """How often strings have told wrong, in this load step, where cables go."""
        self.offered: set[tuple[str, Corridor]] = set()
        self.withheld: set[tuple[str, Corridor]] = set()
        """Ways past a vertex, by cable, that cables with friction are led now, and that they have
        not taken."""
        self.led: Counter[tuple[str, int, bool]] = Counter()
        """How often cables with friction have been led past a vertex in this step, to its left or
        not."""
        self.put_back: set[tuple[str, Corridor]] = set()
        """Where their caught fold points have been put back in place."""

    @property
    def tried(self) -> Tried:
        """The paths that were tried in earlier load steps."""
        return Tried(
            self.refused, self.left, self._tried_at, self._L0, self.released, self.settled,
            self.withheld, self.put_back,
        )  # fmt: skip

    def remember(self, tried: Tried) -> None:
        """Go on from the load steps of another retracer of the same cables."""
        (
            self.refused, self.left, self._tried_at, self._L0, self.released, self.settled,
            self.withheld, self.put_back,
        ) = tried  # fmt: skip

    def begin_step(self) -> None:
        """Prepare for a load step."""
        self._first_look, self._misled = True, 0
        self.offered = set()
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
            if self._has_moved(cable):
                self.refused.pop(cable.name, None)
                self.left.pop(cable.name, None)
                for ways in (self.withheld, self.put_back):
                    ways -= {way for way in ways if way[0] == cable.name}

    def _has_moved(self, cable: LaidCable) -> bool:
        """Whether a cable is somewhere else than where the load steps before have left it."""
        before, x = self._tried_at.get(cable.name), cable.positions
        if before is None or before.shape != x.shape:
            return True
        return bool(np.abs(before - x).max() > STILL * cable.length)

    def has_rested(self, cable: LaidCable) -> bool:
        """Whether a cable is as the last load step has found it."""
        return self._L0.get(cable.name) == cable.L0 and not self._has_moved(cable)

    def end_step(self) -> None:
        """Remember where the cables are, and how long.

        One that has hardly moved is still compared to where it was, so that it cannot creep away.
        """
        for cable in self.scene.cables:
            if self._has_moved(cable):
                self._tried_at[cable.name] = cable.positions.copy()
        self._L0 = {cable.name: cable.L0 for cable in self.scene.cables}

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
            cable.state.taut = cable.is_tight(nearly=True)
            cable.state.traced = cable.taut
        return True

    def lay_again(self, numbers: Set[int]) -> None:
        """Forget where the fold points of some cables are, given by number, so that `straighten`
        puts them on straight edges."""
        for c in numbers:
            self.scene.cables[c].state.traced = False

    def renew_shadows(self) -> list[str]:
        """Bring the paths of lifted parts under their spans; say which changed. Collective."""
        changes: list[str] = []
        off = [cable for cable in self.scene.cables if cable.taut and cable.lifted.any()]
        if not off:
            return changes
        surface = self.surface()
        for cable in off:
            for rings in itertools.count(1):
                try:
                    found = with_shadows(cable, surface.shape)
                    break
                except MissingStars as missing:
                    grow(self.scene, missing.vertices, rings)
                    surface = self.surface()
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
                    raise _slid_off(cable, surface.shape.at(vertex))

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
            if cable.taut
            and cable.slides_freely
            and self._misled < (MISLED_AT_CROSSINGS if _is_crossed(cable) else MISLED)
        ]
        return self._retrace(free, max_flips) if free else 0

    def refused_now(self) -> dict[str, set[Corridor]]:
        """A copy of what has been tried."""
        return {name: set(ways) for name, ways in self.refused.items()}

    def count_misled(self) -> None:
        """Count that strings have told wrong where cables go; soon only forces do, in this step."""
        self._misled += 1

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
            left = {v for _, *vertices in self.left.get(cable.name, ()) for v in vertices}
            held_at = visited | _near(cable, PRESSED) - left
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
        n = self.scene.V.dofmap.index_map.size_global
        if len(points) < 2 or any(max(point.support) >= n for point in points):
            raise _slid_off(cable, cable.positions[cable.rim()[0]])
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
        anchors, n = self._anchors(cable, surface), self.scene.V.dofmap.index_map.size_global
        if not before and n in anchors and surface.is_boundary(path[0].support):
            before = [VertexPoint(n)]
        if not after and n + 1 in anchors and surface.is_boundary(path[-1].support):
            after = [VertexPoint(n + 1)]
        return list(before), list(after)

    def _anchors(self, cable: LaidCable, surface: FoldedSurface) -> dict[int, Array]:
        """Positions of a cable's anchors off the membrane, by ids that no vertex has.

        Not of one that a cable in a sleeve has left at a corner of the membrane, as at a mast that
        has been moved: pulled straight to it the cable would leave the membrane.
        """
        n, path = self.scene.V.dofmap.index_map.size_global, cable.path.points
        return {
            n + k: cable.positions[-k]
            for k in (0, 1)
            if cable.ends[k] == "off" and not (cable.sleeve and _is_corner(path[-k], surface))
        }

    def with_anchors(self, cable: LaidCable, surface: FoldedSurface) -> FoldedSurface:
        anchors = self._anchors(cable, surface)
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
        cable.state.traced = False

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


def _slid_off(cable: LaidCable, place: Array) -> PathError:
    """The error of a cable that no membrane is left for, with where it was last (length)."""
    return PathError(
        f"{cable.name!r} has slid off the membrane's edge at {place}; hold it there by a "
        "sleeve or an anchor, or load it less."
    )


def _key(node: CableNode) -> object:
    """What a node is known by while a path changes: its edge if it slides, else its place."""
    return None if node.point is None else node.point.support if node.slides else node.point


def _is_corner(point: SurfacePoint, surface: FoldedSurface) -> bool:
    """Whether a point is a vertex at which the membrane's boundary turns by 60 degrees or more."""
    if not isinstance(point, VertexPoint) or point.vertex not in surface.strip.complete:
        return False
    if not surface.is_boundary(point.support):
        return False
    around = surface.membrane_ring(point.vertex).neighbours
    at = surface.shape.at(point.vertex)
    a, b = (surface.shape.at(v) - at for v in (around[0], around[-1]))
    return bool(a @ b > -0.5 * np.linalg.norm(a) * np.linalg.norm(b))


def _is_crossed(cable: LaidCable) -> bool:
    """Whether a cable is in contact with another one that crosses it.

    The surface on which strings are pulled does not have the points inside cells where cables press
    each other in. So it tells them where they bend to within the angles by which they do so there
    only, and on fine meshes where they would not go.
    """
    return any(node.crossing is not None for node in cable.nodes)


def _runs(cable: LaidCable) -> list[tuple[bool, range]]:
    """The parts of a path that are lifted, and those that are not: indices of their points."""
    off = [
        bool(lifted)
        for lifted, node in zip(cable.lifted, cable.nodes, strict=True)
        if node.point is not None and node.kind != "crossing"
    ]
    starts = [k for k in range(len(off)) if k == 0 or off[k] != off[k - 1]]
    return [(off[a], range(a, b)) for a, b in itertools.pairwise([*starts, len(off)])]


def _near(cable: LaidCable, near: float) -> set[int]:
    """Vertices near which a cable's points slide, within a part of the edge."""
    found = set()
    for k in cable.contacts():
        point = cable.nodes[k].point
        if cable.nodes[k].slides and isinstance(point, EdgePoint):
            fraction = float(cable.fractions[k])
            if min(fraction, 1 - fraction) < near:
                found.add(point.edge[int(fraction > 0.5)])
    return found


def _stays(cable: LaidCable, old: int, node: CableNode) -> bool:
    """Whether a point that the path had before stays where equilibrium has put it."""
    if not node.slides or not isinstance(node.point, EdgePoint):
        return True
    fraction = float(cable.fractions[old])
    moved = 0.0 if cable.slides_freely else abs(fraction - node.point.fraction)
    return moved <= NEAR and INSIDE <= fraction <= 1 - INSIDE
