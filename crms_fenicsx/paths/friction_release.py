"""Path changes of cables with friction: over the vertices that they have reached.

A cable with friction does not follow a geodesic, and pulling it taut would release it where it
sticks. Its path changes only where friction yields: a sliding fold point that has reached a vertex
moves around it, and a node on a vertex leaves it when the lateral pull exceeds friction. The new
path is kept if the energy, including friction work, falls; see `crms_fenicsx.equilibrium.search`.
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
"""Passes allowed to either side of a vertex in a load step: the friction bounds on each side may
favour the other one."""


def pass_vertices(change: PathChange, tried: TriedPaths, most: int | None = None) -> int:
    """Move cables with friction over the vertices that they have reached. Collective. Returns the
    largest number of vertices passed by one cable."""
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
    """Taut cables with known friction forces, by number."""
    return {
        c: cable
        for c, cable in enumerate(cables)
        if cable.taut and cable.lateral is not None and cable.lateral.known
    }


def straighten_kinks(
    change: PathChange, tried: TriedPaths, kinked: Iterable[tuple[int, int]]
) -> bool:
    """Put caught fold points of cables with friction back on straight edges. Collective.

    Two points on edges with a common vertex may have approached each other away from it, so that
    their chord has lost its direction. Then edges are kinked, or the points are pulled without
    moving. They are moved to where a string between the surrounding points crosses their edges.
    Returns whether any was moved that had not been moved before from the same place on the path: if
    that raised the energy, it would with other friction forces, too.
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
    """Vertices at which a cable's pull exceeds friction."""
    return [one for one in held_vertices(cable, shape) if one.excess > 0.0]


def _pass(change: PathChange, tried: TriedPaths, cable: LaidCable, run: VertexRun) -> int:
    """Move a cable with friction past a vertex, if allowed; return the number passed."""
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
