"""Geodesic sliding of cables without friction.

A taut cable without friction lies along a geodesic of the current, folded surface. Instead of
moving it over one vertex per equilibrium, its path is pulled taut on the current shape and tried:
it is kept if the energy falls, else half of the flips are tried. No path is tried twice.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.lift_off import drape
from crms_fenicsx.cabling.contact.span_projection import (
    Projected,
    loose_crossings,
    with_span_projections,
)
from crms_fenicsx.cabling.paths.creased_surface import CreasedSurface, FoldPoints
from crms_fenicsx.cabling.paths.path_change import (
    PathChange,
    is_crossed,
    leaves_cells,
    lifted_runs,
    shortened,
    slid_off,
    vertices_near,
)
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.foundation.runtime.work_sharing import share_out
from crms_fenicsx.foundation.surface.corridor import Corridor, corridor, why_invalid
from crms_fenicsx.foundation.surface.flip_geodesic import FlippedPath, shorten
from crms_fenicsx.foundation.surface.points import SurfacePoint, VertexPoint
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL

Result = TypeVar("Result")


@dataclass(frozen=True)
class _Pulled:
    """Result of pulling a path taut."""

    points: list[SurfacePoint]  # of the new path; empty if unchanged
    lifted: list[bool]  # whether each is lifted
    flips: int  # number of vertices passed
    followed: list[tuple[Corridor, bool]]  # see `GeodesicSliding._note`


class GeodesicSliding:
    """Pulls the paths of the cables taut."""

    def __init__(self, change: PathChange, tried: TriedPaths) -> None:
        self.change, self.tried, self.net = change, tried, change.net
        self._followed: set[Corridor] = set()
        """Corridors without anchors known to be valid, on any shape."""

    def straighten(self) -> bool:
        """Pull the paths of new taut cables taut, and return whether there are any. Collective.
        On bad paths these would cut into the membrane and prevent convergence."""
        fresh = [
            cable
            for cable in self.net.cables
            if cable.taut and not cable.state.memory.path_is_geodesic and leaves_cells(cable)
        ]
        if not fresh:
            return False
        others = [cable for cable in self.net.cables if cable not in fresh]
        for cable in fresh:
            cable.update(lifted=cable.state.lifted & False)
        self._slide(fresh, folded_by=others, fresh=True)
        shape = self.net.strip_shape()
        for cable in fresh:
            if cable.lifts_off:
                drape(cable, shape)
            # Pulled taut, the cable may turn out too long for its path: slack.
            taut = cable.is_tight(nearly=True)
            cable.update(taut=taut, path_is_geodesic=taut)
        return True

    def renew_projections(self, shape: StripShape) -> list[str]:
        """Move paths of lifted parts below their spans; return the changes in words. Collective."""
        loose = loose_crossings(self.net.cables)
        while True:
            renewed = self._projections(shape, loose)
            changed = {
                cable
                for cable, (points, lifted, _) in renewed.items()
                if corridor(points) != corridor(cable.path.points)
                or lifted != cable.state.lifted[cable.path_nodes()].tolist()
            }
            pairs = {n: self._crossed((n,)) for n in loose}
            # Only with both of its cables does a crossing move to another cell.
            moved = {n for n, pair in pairs.items() if pair <= renewed.keys() and pair & changed}
            stuck = {n for n in loose - moved if pairs[n] & renewed.keys()}
            if not stuck:
                break
            loose -= stuck
        for cable, (points, lifted, surface) in renewed.items():
            self.change.replace(cable, points, lifted, surface)
        return [f"{cable.name} hangs over other cells" for cable in renewed]

    def _crossed(self, crossings: Iterable[int]) -> set[LaidCable]:
        """Cables of crossings, given by number."""
        some = (self.net.crossings[n] for n in crossings)
        return {self.net.cables[c] for one in some for c in (one.lower, one.upper)}

    def _projections(
        self, shape: StripShape, loose: Set[int]
    ) -> dict[LaidCable, tuple[list[SurfacePoint], list[bool], CreasedSurface]]:
        """Updated paths with their surfaces, of cables whose projections change. Collective."""
        crossed = self._crossed(loose)
        off = [
            cable
            for cable in self.net.cables
            if cable.state.laid.line is None
            and (cable in crossed or (cable.taut and cable.state.lifted.any()))
        ]

        def projected(on: StripShape) -> Callable[[LaidCable], Projected | None]:
            return lambda cable: with_span_projections(cable, on, loose)

        renewed = {}
        for cable, found in zip(off, self._for_each(off, projected, shape), strict=True):
            if found is None:
                continue
            points, lifted = found
            surface = self.change.surface([v for point in points for v in point.support])
            # A span that folds back over its own touchdown keeps its old projection.
            invalid = why_invalid(corridor(points), surface.opposite_vertices)
            if invalid and cable in crossed:
                # Beside a crossing that has slid into another cell this touchdown is off the path.
                high = {p.support: p for p, is_off in zip(points, lifted, strict=True) if is_off}
                points, lifted = shortened(points, high.keys(), surface.strip.outer_cells)
                points = [high.get(point.support, point) for point in points]
                invalid = why_invalid(corridor(points), surface.opposite_vertices)
            if not invalid:
                renewed[cable] = points, lifted, surface
        return renewed

    def check_on_membrane(self) -> None:
        """Raise an error if a cable has slid off the membrane. Collective."""
        for cable in self.net.cables:
            nodes = [cable.state.nodes[k] for k in cable.contacts()]
            places = [set(node.point.support) for node in nodes if node.point is not None]
            if not cable.taut or not places or len(cable.blocked) < len(places):
                continue
            common = set.intersection(*places)
            surface = self.change.surface(sorted(common))
            for vertex in common:
                if surface.is_boundary((vertex,)):
                    raise slid_off(cable, surface.shape.at(vertex))

    def slide(self, max_flips: int | None = None) -> int:
        """Pull the paths of all taut cables taut on the current surface. Collective. Returns the
        largest number of vertices passed by one cable; 0 if no path has changed."""
        self.tried.forget_moved(self.net.cables)
        free = [
            cable
            for cable in self.net.cables
            if cable.taut and leaves_cells(cable) and self.tried.uses_geodesic(cable)
        ]
        return self._slide(free, max_flips) if free else 0

    def _slide(
        self,
        cables: Sequence[LaidCable],
        max_flips: int | None = None,
        folded_by: Sequence[LaidCable] | None = None,
        fresh: bool = False,
    ) -> int:
        folds = self.change.folds() if folded_by is None else FoldPoints.of(folded_by)

        def pull(on: StripShape) -> Callable[[LaidCable], _Pulled]:
            creased = CreasedSurface(on, folds)
            return lambda cable: self._pulled(cable, creased, max_flips, fresh)

        pulled = self._for_each(cables, pull, self.net.strip_shape())
        for cable, new in zip(cables, pulled, strict=True):
            self._note(cable, new.followed)
        most = max(new.flips for new in pulled)
        if most or fresh:
            surface = CreasedSurface(self.net.strip_shape(), folds)
            for cable, new in zip(cables, pulled, strict=True):
                if new.flips or fresh:
                    self.change.replace(cable, new.points, new.lifted, surface)
            nodes = [node.point for cable in cables for node in cable.state.nodes]
            self.net.grow_strip([v for p in nodes if p is not None for v in p.support])
        return most

    def _for_each(
        self,
        cables: Sequence[LaidCable],
        work_on: Callable[[StripShape], Callable[[LaidCable], Result]],
        shape: StripShape,
    ) -> list[Result]:
        """Results for cables, each worked out on one rank, growing the strip as needed. `work_on`
        returns what is to be done on a shape. Collective."""
        found: dict[int, Result] = {}
        for rings in itertools.count(1):
            work = work_on(shape)

            def done(c: int, work: Callable[[LaidCable], Result] = work) -> Result | MissingCells:
                try:
                    return work(cables[c])
                except MissingCells as missing:
                    return missing

            pending = [c for c in range(len(cables)) if c not in found]
            lacking: set[int] = set()
            new = share_out(self.net.membrane.comm, pending, done)
            for c, result in zip(pending, new, strict=True):
                if isinstance(result, MissingCells):
                    lacking.update(result.vertices)
                else:
                    found[c] = result
            if not lacking:
                break
            self.net.grow_strip(sorted(lacking), rings)
            shape = self.net.strip_shape()
        return [found[c] for c in range(len(cables))]

    def _note(self, cable: LaidCable, followed: Sequence[tuple[Corridor, bool]]) -> None:
        """Record the corridors in which a cable was pulled taut, and those valid on any shape."""
        self.tried.refused.setdefault(cable.name, set()).update(way for way, _ in followed)
        self._followed.update(way for way, always in followed if always)

    def _pulled(
        self, cable: LaidCable, surface: CreasedSurface, max_flips: int | None, fresh: bool
    ) -> _Pulled:
        """Pull one path taut."""
        on_path, parts = cable.path_nodes(), lifted_runs(cable)
        path = _old_points(cable, on_path, [run for _, run in parts])
        refused = set(self.tried.refused.get(cable.name, ()))
        held_at, n = None, self.change.n_vertices
        if is_crossed(cable) and not fresh:
            visited = {p.vertex for p in path if isinstance(p, VertexPoint)}
            left = {v for _, *vertices in self.tried.left.get(cable.name, ()) for v in vertices}
            held_at = visited | vertices_near(cable, TOL.beyond) - left
        pulled: dict[range, Callable[[], Sequence[SurfacePoint]]] = {}
        passed = 0
        followed: list[tuple[Corridor, bool]] = []
        for is_off, run in parts:
            if not is_off:
                new = path[run.start : run.stop]
                # Pulled taut between adjacent lifted points, or anchors.
                before, after = self.change.beyond(cable, surface, path, run)
                joined = self.change.with_anchors(cable, surface)
                string = [*before, *new, *after]
                given = corridor(string)
                fits = self._may_lie(given, joined)
                if not fits and len(string) > len(new):  # a span folds back over its own touchdown
                    before, after, string, given = [], [], new, corridor(new)
                    fits = self._may_lie(given, joined)
                if fits and len(string) > 2:
                    refused.add(given)
                    pulls = held_at is None or bool(held_at)
                    at_anchor = any(max(support) >= n for support in (given[0], given[-1]))
                    followed.append((given, pulls and not at_anchor))
                    if pulls:  # otherwise it flips over no vertex
                        result = shorten(
                            string, joined, refused=refused, max_flips=max_flips,
                            grip=TOL.kink if fresh else 0.0, held_at=held_at,
                            checked=given in self._followed,
                        )  # fmt: skip
                        passed += len(result.flips)
                        pulled[run] = partial(_without_ends, result, len(before), len(after))
        points: list[SurfacePoint] = []
        lifted: list[bool] = []
        if passed or fresh:
            for is_off, run in parts:
                own = partial(cable.points, on_path[run.start : run.stop])
                points += pulled.get(run, own)()
                lifted += [is_off] * (len(points) - len(lifted))
            if len(points) < 2 or any(max(point.support) >= n for point in points):
                raise slid_off(cable, cable.state.positions[cable.path_nodes()[0]])
        return _Pulled(points, lifted, passed, followed)

    def _may_lie(self, given: Corridor, surface: CreasedSurface) -> bool:
        """Whether a cable can follow a corridor."""
        return given in self._followed or why_invalid(given, surface.opposite_vertices) is None


def _old_points(
    cable: LaidCable, on_path: Sequence[int], parts: Sequence[range]
) -> list[SurfacePoint]:
    """Points of a path, in their current places at the ends of its parts: elsewhere only their
    edges count."""
    path = [point for k in on_path if (point := cable.state.nodes[k].point) is not None]
    ends = [i for part in parts for i in (part.start, part.stop - 1)]
    for i, point in zip(ends, cable.points([on_path[i] for i in ends]), strict=True):
        path[i] = point
    return path


def _without_ends(path: FlippedPath, first: int, last: int) -> Sequence[SurfacePoint]:
    """The points of a path without its first and last ones."""
    return path.points[first : len(path.points) - last]
