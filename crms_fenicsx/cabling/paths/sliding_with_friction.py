"""Path changes of cables with friction: over the vertices that they have reached.

A cable with friction does not follow a geodesic, and pulling it taut would release it where it
sticks. Its path changes only where friction yields: a sliding fold point that has reached a vertex
moves around it, and a node on a vertex leaves it when the lateral pull exceeds friction. The new
path is kept if the energy, including friction work, falls; see `analysis.equilibrium.search`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import contact_forces, held_nodes
from crms_fenicsx.cabling.friction.lateral import friction_forces
from crms_fenicsx.cabling.paths.held_vertices import HeldVertex, VertexRun, held_vertices
from crms_fenicsx.cabling.paths.path_change import PathChange
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.cabling.paths.vertex_trials import adopt, straighten, way_past
from crms_fenicsx.foundation.runtime.arrays import ints
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET, TOL


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
        if cable.taut
        and cable.state.law.lateral is not None
        and cable.state.law.lateral.known
        and not cable.keeps_line
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
            caught |= {(c, k) for k in one.nodes if not cable.state.lifted[k]}
    moved = _flatten_edges(change, tried, shape)
    for c, k in sorted(caught):
        cable = change.net.cables[c]
        if cable.slides_freely or not cable.state.nodes[k].slides:
            continue
        on_path = cable.path_nodes()
        i = on_path.index(k)
        way = (
            cable.name,
            tuple(cable.state.nodes[m].support for m in on_path[max(i - 1, 0) : i + 2]),
        )
        if way in tried.straightened:
            continue
        tried.straightened.add(way)
        contacts = [j for j, m in enumerate(on_path) if not cable.state.lifted[m]]
        at = contacts.index(i)
        first, last = contacts[max(at - 2, 0)], contacts[min(at + 2, len(contacts) - 1)]
        moved |= straighten(change, cable, on_path[first : last + 1])
    return moved


def _flatten_edges(change: PathChange, tried: TriedPaths, shape: StripShape) -> bool:
    """Put fold points whose edges hold the cable, and their neighbours, back on straight edges at
    the same fractions; return whether any was moved. An edge pressed to the other side of its cells
    can hold a cable with much more than friction."""
    moved = False
    for cable in _held(change.net.cables).values():
        nodes = _pulled(cable, shape)
        way = cable.name, tuple(cable.state.nodes[k].support for k in nodes)
        if not nodes or way in tried.straightened:
            continue
        tried.straightened.add(way)
        positions = cable.state.positions.copy()
        for k in sorted({k + beside for k in nodes for beside in (-1, 0, 1)}):
            if cable.state.nodes[k].slides and not cable.state.lifted[k]:
                positions[k] = shape.mean(*cable.interpolation(k))
        cable.update(positions=positions)
        moved = True
    return moved


def _pulled(cable: LaidCable, shape: StripShape) -> list[int]:
    """Fold points whose lateral pull is far from the friction force."""
    assert cable.state.law.lateral is not None
    if cable.state.law.lateral.elements is not None:  # their forces do not turn with the cable
        return []
    nodes = np.array(held_nodes(cable), dtype=np.int64)
    carried = friction_forces(cable, shape)
    excess = contact_forces(cable, shape).lateral[nodes] - carried
    far = np.abs(excess) > TOL.bent_pull * cable.state.law.lateral.bounds
    return [k for k in ints(nodes[far]) if cable.state.nodes[k].slides]


def _run_into(cable: LaidCable, shape: StripShape) -> list[HeldVertex]:
    """Vertices at which a cable's pull exceeds friction."""
    return [one for one in held_vertices(cable, shape) if one.excess > 0.0]


def _pass(change: PathChange, tried: TriedPaths, cable: LaidCable, run: VertexRun) -> int:
    """Move a cable with friction past a vertex, if allowed; return the number passed."""
    here = (cable.name, run.vertices[0], run.to_left)
    back = (cable.name, run.vertices[0], not run.to_left)
    if min(tried.passes[here], tried.passes[back]) >= BUDGET.there_and_back:
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
