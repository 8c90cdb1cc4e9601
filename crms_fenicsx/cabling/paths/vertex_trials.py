"""Trials of passing vertices of the mesh on the other side, kept if they lower the energy.

On the other side the path crosses the edges near the vertices, on a string between kept points.

Geodesics do not tell where a cable held by vertices goes: it is shortest in the valley that it
presses into a mesh line. The forces on it tell (see `held_vertices`), and the energy decides. With
friction, cables first leave overloaded vertices one by one, which may not suffice.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Literal

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.paths.creased_surface import NO_FOLDS, CreasedSurface
from crms_fenicsx.cabling.paths.held_vertices import VertexRun, held_runs
from crms_fenicsx.cabling.paths.path_change import PathChange
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.foundation.runtime.errors import MeshError
from crms_fenicsx.foundation.runtime.work_sharing import share_out
from crms_fenicsx.foundation.surface.corridor import Corridor, corridor, why_invalid
from crms_fenicsx.foundation.surface.flip_geodesic import shorten
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells, other_side
from crms_fenicsx.model.cable_state import CableNode, CableState
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET, TOL


def pass_run(
    change: PathChange, number: int, run: VertexRun, shape: StripShape | None = None
) -> bool:
    """Move a cable past the vertices of a run; return whether that is possible. Collective."""
    cable = change.net.cables[number]
    found = way_past(change, cable, run, shape)
    if found is None:
        return False
    adopt(change, cable, found)
    return True


@dataclass(frozen=True)
class _WayPast:
    """A path past a run of vertices."""

    supports: Corridor  # of the path, between the cable's anchors
    vertices: frozenset[int]  # those passed
    replaced: Corridor  # supports left, and those taken instead
    shape: StripShape


def way_past(
    change: PathChange, cable: LaidCable, run: VertexRun, shape: StripShape | None = None
) -> _WayPast | None:
    """Find the path of a cable past a run; None if it can pass none of the vertices. Collective."""
    string: Corridor = tuple(cable.state.nodes[k].support for k in cable.path_nodes())
    shape = change.shape(run.vertices, like=shape)
    joined = change.with_anchors(cable, CreasedSurface(shape, NO_FOLDS))
    n = change.n_vertices
    first, last = n in joined.anchors, n + 1 in joined.anchors
    string = (((n,),) if first else ()) + string + (((n + 1,),) if last else ())
    replaced: Corridor = ()
    passed = set()
    for vertex in run.vertices:
        found = None
        for rings in itertools.count(1):
            try:
                ring = joined.membrane_ring(vertex).neighbours
                cell = joined.strip.corners[joined.strip.outer_rows((vertex, *ring[:2]))[0]]
                counterclockwise = cell[cell.index(vertex) - 2] == ring[0]  # seen from outside
                found = other_side(string, joined, vertex, counterclockwise != run.to_left)
                break
            except MissingCells as missing:
                change.net.grow_strip(missing.vertices, rings)
                shape = change.shape()
                joined = change.with_anchors(cable, CreasedSurface(shape, NO_FOLDS))
            except MeshError:
                break  # a vertex where several sheets meet holds the cable
        # No cable lies between the membrane's boundary and an anchor.
        if found is None or any(len(s) != 2 or max(s) >= n for s in found.taken):
            continue
        string, replaced = found.corridor, (*replaced, *found.left, *found.taken)
        passed.add(vertex)
    if not passed:
        return None
    kept = string[first : len(string) - last]
    return _WayPast(kept, frozenset(passed), replaced, shape)


def adopt(change: PathChange, cable: LaidCable, way: _WayPast) -> None:
    """Give a cable a path past vertices, with its remaining nodes unchanged."""
    supports, on_path = way.supports, cable.path_nodes()
    shape = change.shape([v for support in supports for v in support], like=way.shape)
    old = {cable.state.nodes[k].support: k for k in on_path}
    taken = [v for support in supports if support not in old for v in support]
    surface = CreasedSurface(shape, change.folds_near(taken))
    least = TOL.beyond * (1 + 0.02 * change.net.cables.index(cable))

    first, last = on_path[0] > 0, on_path[-1] < len(cable.state.nodes) - 1  # anchors
    edges = [*[None] * first, *supports, *[None] * last]
    rows = [*[0] * first, *(old.get(support, -1) for support in supports), *[-1] * last]
    nodes, lifted = [cable.state.nodes[k] for k in rows], cable.state.lifted[rows]
    positions, fractions = cable.state.positions[rows], cable.state.fractions[rows]
    for i, edge in enumerate(edges):
        if edge is None or edge in old:
            continue
        a, b = edge
        fractions[i] = fraction = least if a in way.vertices else 1 - least
        kind: Literal["edge slider", "fold"] = "fold"
        if (a, b) in shape.strip.held_edges:
            kind = "edge slider"
        nodes[i] = CableNode(kind, EdgePoint((a, b), fraction))
        lifted[i] = shape.strip.over_hole((a, b))
        positions[i] = surface.place((a, b), fraction)
    cable.set_nodes(nodes, positions, fractions, lifted)
    on_path = cable.path_nodes()
    added = [i for i, k in enumerate(on_path) if cable.state.nodes[k].support not in old]
    if added:  # along the boundary nodes may only vanish
        part = on_path[max(added[0] - 1, 0) : added[-1] + 2]
        straighten(change, cable, part, shape)


def straighten(
    change: PathChange, cable: LaidCable, part: list[int], shape: StripShape | None = None
) -> bool:
    """Pull a part of a cable, given by nodes, taut in its cells between its ends, and return
    whether that is possible. Collective. Gathers vertex positions that are not known."""
    points = cable.points(part)
    vertices = [v for point in points for v in point.support]
    surface = CreasedSurface(change.shape(vertices, like=shape), change.folds_near(vertices))
    if len(points) < 3 or why_invalid(corridor(points), surface.opposite_vertices):
        return False
    string = shorten(points, surface, max_flips=0).points
    positions, fractions = cable.state.positions.copy(), cable.state.fractions.copy()
    for k, point in zip(part[1:-1], string[1:-1], strict=True):
        if cable.state.nodes[k].slides and isinstance(point, EdgePoint):
            fraction = min(max(point.fraction, TOL.beyond), 1 - TOL.beyond)
            fractions[k] = fraction
            positions[k] = surface.place(point.edge, fraction)
    cable.update(positions=positions, fractions=fractions)
    return True


Trial = tuple[int, VertexRun]
"""A cable, by number, and the run of vertices to pass."""


class VertexTrials:
    """Trials of one load step, in rounds. A round first passes all runs that hold cables at once;
    if that is rejected, each half of them, and each half of these."""

    def __init__(self, change: PathChange, tried: TriedPaths) -> None:
        self.change, self.tried = change, tried
        self._groups: list[tuple[int, list[Trial]]] = []  # with number of halvings
        self._energy = math.inf
        self._halved = 0
        self._runs: dict[int, tuple[CableState, list[VertexRun]]] = {}
        """Runs of each cable, by number, with the state in which they were found."""

    def next(self, energy: float, scale: float) -> list[Trial]:
        """Move cables past the runs of vertices that hold them and return what was moved; nothing
        if no trial is left. Collective. Units: energy (force x length)."""
        while runs := self._held():
            if not self._groups:
                if self._energy - energy < TOL.round_gain * scale:
                    self._note(runs)  # so that repeating the load starts no other round
                    break
                self._energy = energy
                self._groups = [(0, runs)]
            self._halved, group = self._groups.pop()
            known = {(c, run.key) for c, run in group}
            group = [(c, run) for c, run in runs if (c, run.key) in known]
            vertices = [vertex for _, run in group for vertex in run.vertices]
            shape = self.change.shape(vertices, rings=2)  # also around the edges beside the runs
            moved = [(c, run) for c, run in group if pass_run(self.change, c, run, shape)]
            self._note([trial for trial in group if trial not in moved])
            if moved:
                return moved
        return []

    def halve(self, moved: list[Trial]) -> bool:
        """Schedule the halves of a rejected trial and return True, or reject it finally."""
        half = len(moved) // 2
        if half == 0 or self._halved == BUDGET.halvings:
            self._note(moved)
            return False
        self._groups += [(self._halved + 1, part) for part in (moved[half:], moved[:half])]
        return True

    def _held(self) -> list[Trial]:
        """Untried runs that hold cables."""
        net, shape = self.change.net, self.change.net.strip_shape()
        cables = net.cables
        least: dict[int, int] = {}
        for c, cable in enumerate(cables):
            if not cable.taut:
                continue
            if cable.slides_freely:
                least[c] = 1
            elif cable.state.law.lateral is not None and cable.state.law.lateral.known:
                from crms_fenicsx.cabling.friction.lateral import remap

                remap(cable)
                least[c] = 2  # `sliding_with_friction` has handled single vertices
        known = self._runs
        moved = [c for c in least if c not in known or known[c][0] is not cables[c].state]
        runs = share_out(
            self.change.net.membrane.comm, moved, lambda c: held_runs(cables[c], shape)
        )
        known |= {c: (cables[c].state, own) for c, own in zip(moved, runs, strict=True)}
        found = [(c, run) for c in least for run in known[c][1] if len(run.vertices) >= least[c]]
        return [(c, run) for c, run in found if run.key not in self._tried(c)]

    def _tried(self, c: int) -> set[tuple[int, ...]]:
        return self.tried.left.setdefault(self.change.net.cables[c].name, set())

    def _note(self, trials: list[Trial]) -> None:
        """Exclude these trials while the cable does not move."""
        for c, run in trials:
            self._tried(c).add(run.key)
