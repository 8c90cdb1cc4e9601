"""How cables with friction change their path: over the vertices that they have run into.

A cable with friction does not lie along a geodesic, and pulling it taut would let it slide where
it sticks. It changes its path only where friction gives way: a fold point that slides and has run
into a vertex is moved around its other side, a node on a vertex leaves it when the cable pulls it
sideways by more than friction holds. The new path is kept if the energy falls, with the work of
friction in it; see `crms_fenicsx.equilibrium.search`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from crms_fenicsx.cables.strip import StripShape
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.paths.held_vertices import HeldVertex, VertexRun, held_vertices
from crms_fenicsx.paths.path_change import PathChange
from crms_fenicsx.paths.tried_paths import TriedPaths
from crms_fenicsx.paths.vertex_passing import adopt, straighten, way_past

THERE_AND_BACK = 3
"""How often in a load step a cable is moved around a vertex to either side: on each side friction
may have bounds with which the other one is better."""


def pass_vertices(change: PathChange, tried: TriedPaths, most: int | None = None) -> int:
    """Move cables with friction over the vertices that they have run into. Collective. Returns how
    many vertices the cable that has passed most has."""
    tried.proposed = set()
    held = _held(change.net.cables)
    if not held:
        return 0
    shape, passed = change.net.strip_shape(), 0
    for cable in held.values():
        done = 0
        for one in sorted(_run_into(cable, shape), key=lambda one: -one.excess):
            if most is None or done < most:
                done += _pass(change, tried, cable, VertexRun.of([one]))
        passed = max(passed, done)
    return passed


def _held(cables: Sequence[LaidCable]) -> dict[int, LaidCable]:
    """Cables that friction holds with known forces, by number."""
    return {
        c: cable
        for c, cable in enumerate(cables)
        if cable.taut and cable.lateral is not None and cable.lateral.known
    }


def straighten_kinks(
    change: PathChange, tried: TriedPaths, kinked: Iterable[tuple[int, int]]
) -> bool:
    """Put caught fold points of cables with friction back on straight edges. Collective.

    Two points on edges that meet in a vertex may have closed in on each other away from it, so that
    the chord between them has no direction any more. Then edges are kinked, or the points are
    pulled and do not move. They go to where a string between the points around them would cross
    their edges. Returns whether any was moved that has not been before from the same place on the
    path, where the cable still is: if that has raised the energy, it does with other friction
    forces, too.
    """
    shape, caught = change.net.strip_shape(), set(kinked)
    for c, cable in _held(change.net.cables).items():
        for one in _run_into(cable, shape):
            caught |= {(c, k) for k in one.nodes if not cable.lifted[k]}
    moved = False
    for c, k in sorted(caught):
        cable = change.net.cables[c]
        if cable.slides_freely or not cable.nodes[k].slides:
            continue
        on_path = cable.path_nodes()
        i = on_path.index(k)
        way = cable.name, tuple(cable.nodes[m].support for m in on_path[max(i - 1, 0) : i + 2])
        if way in tried.straightened:
            continue
        tried.straightened.add(way)
        contacts = [j for j, m in enumerate(on_path) if not cable.lifted[m]]
        at = contacts.index(i)
        first, last = contacts[max(at - 2, 0)], contacts[min(at + 2, len(contacts) - 1)]
        moved |= straighten(change, cable, on_path[first : last + 1])
    return moved


def _run_into(cable: LaidCable, shape: StripShape) -> list[HeldVertex]:
    """The vertices that hold a cable by more than friction does."""
    return [one for one in held_vertices(cable, shape) if one.excess > 0.0]


def _pass(change: PathChange, tried: TriedPaths, cable: LaidCable, run: VertexRun) -> int:
    """Move a cable with friction past a vertex, if it may; return how many it has passed."""
    here = (cable.name, run.vertices[0], run.to_left)
    back = (cable.name, run.vertices[0], not run.to_left)
    if min(tried.passes[here], tried.passes[back]) >= THERE_AND_BACK:
        return 0
    found = way_past(change, cable, run)
    if found is None:
        return 0
    way = cable.name, found.replaced
    if way in tried.rejected or way in tried.proposed:
        return 0
    adopt(change, cable, found)
    tried.proposed.add(way)
    tried.passes[here] += 1
    return 1
