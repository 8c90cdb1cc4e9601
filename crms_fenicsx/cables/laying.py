"""Laying a cable: from the user's path to a polyline with typed points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crms_fenicsx import checks
from crms_fenicsx.cables.cable import Cable, CableNode, LaidCable, StepStart, polyline_length
from crms_fenicsx.cables.path import CellPoint, EdgePoint, Path, VertexPoint, chords_cross
from crms_fenicsx.cables.strip import EMPTY, Strip, gather_strip
from crms_fenicsx.cables.trace import trace
from crms_fenicsx.errors import InputError, PathError

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene

Array = npt.NDArray[np.float64]


def lay(
    scene: Scene,
    cable: Cable,
    path: Sequence[Sequence[float]] | Array,
    *,
    L0: float | None,
    tension: float | None,
    name: str | None,
) -> LaidCable:
    """Trace the path, decide what each of its points is, and add the cable to the scene.

    See `Scene.lay_cable`. Everything here is the same on all ranks.
    """
    if not isinstance(cable, Cable):
        raise InputError(f"lay_cable: {cable!r} is no Cable; write Cable(EA=...).")
    taken = {other.name for other in scene.cables}
    if name is None:
        numbers = range(len(scene.cables) + 1, 2 * len(scene.cables) + 2)
        name = next(f"cable {n}" for n in numbers if f"cable {n}" not in taken)
    if not isinstance(name, str) or not name or name != name.strip():
        raise InputError(f"lay_cable: name = {name!r}; tables need text without blanks around it.")
    if name in taken:
        raise InputError(f"lay_cable: there is a cable {name!r} already; give another name.")
    if L0 is not None and tension is not None:
        raise InputError(f"lay_cable: {name!r} got both L0 and tension; give one of them.")
    for key, value in (("L0", L0), ("tension", tension)):
        if value is not None:
            checks.positive(f"lay_cable: {name!r} with {key}", value)
    route = _route(path)
    strip, ids, positions, rows = gather_strip(scene, route)
    traced = trace(ids, positions, rows, route)
    held = _held_places(scene, strip)
    nodes = _nodes(traced, held)
    at: dict[int, Array] = {int(vertex): positions[k] for k, vertex in enumerate(ids)}
    places = np.array([_position(node, traced, k, at) for k, node in enumerate(nodes)])
    strip = _used(strip, traced)
    for other in scene.cables:
        _refuse_crossing(name, traced, other, strip.merged(scene.strip or EMPTY))
    length = polyline_length(places)
    if length == 0.0:
        raise PathError(f"lay_cable: the path of {name!r} has no length.")
    if tension is not None:
        L0 = length / (1 + tension / cable.EA)
    unstressed = length if L0 is None else float(L0)
    force = cable.EA / unstressed * max(length - unstressed, 0.0)
    fractions = np.array(
        [n.point.fraction if isinstance(n.point, EdgePoint) else np.nan for n in nodes]
    )
    stepwise = cable.law == "step"
    energy = force * (length - unstressed) / 2
    laid = LaidCable(
        name, cable, traced, nodes, places, fractions, unstressed, length, force,
        step_start=StepStart(force, length, energy) if stepwise else None,
        taut=stepwise or force > 0,
    )  # fmt: skip
    scene.cables.append(laid)
    scene.strip = strip.merged(scene.strip or EMPTY)
    return laid


def _route(path: Sequence[Sequence[float]] | Array) -> Array:
    try:
        route = np.array(path, dtype=float)
    except (TypeError, ValueError) as error:
        raise PathError(f"path: {path!r} is no list of points ({error}).") from None
    if route.ndim != 2 or route.shape[0] < 2 or route.shape[1] not in (2, 3):
        raise PathError(
            f"path: an array of shape {route.shape}; give two or more points in plan, (k, 2), or "
            "in space, (k, 3)."
        )
    if not np.all(np.isfinite(route)):
        raise PathError(f"path: {path!r} has a coordinate that is not finite.")
    return route


def _held_places(scene: Scene, strip: Strip) -> set[tuple[int, ...]]:
    """Ids of the strip's vertices, (a,), and edges, (a, b), that are held in all directions."""
    own = np.flatnonzero(strip.owner == scene.comm.rank)
    cells, local = strip.cells[own], strip.local[own]
    vertices = scene.held[scene.V.dofmap.list[local]].all(axis=2)
    mine: set[tuple[int, ...]] = {(int(v),) for v in cells[vertices]}
    edges = scene.mesh.mesh.topology.connectivity(2, 1)
    for cell, number in zip(cells, local, strict=True):
        for k, edge in enumerate(edges.links(number)):
            if scene.held_edges[edge]:  # edge k lies opposite to vertex k
                a, b = sorted(int(vertex) for vertex in np.delete(cell, k))
                mine.add((a, b))
    return set().union(*scene.comm.allgather(mine))


def _nodes(path: Path, held: set[tuple[int, ...]]) -> tuple[CableNode, ...]:
    """The points of the polyline, with anchors at ends that are held."""
    nodes: list[CableNode] = []
    last = len(path.points) - 1
    for k, point in enumerate(path.points):
        at_end = (k == 0 and path.start_anchor is None) or (k == last and path.end_anchor is None)
        if isinstance(point, VertexPoint):
            nodes.append(CableNode("vertex", point))
        elif at_end or isinstance(point, CellPoint):
            nodes.append(CableNode("rider", point))
        elif point.support in held:
            nodes.append(CableNode("rail", point))
        else:
            nodes.append(CableNode("fold", point))
    if path.start_anchor is not None or path.points[0].support in held:
        nodes.insert(0, CableNode("anchor"))
    if path.end_anchor is not None or path.points[-1].support in held:
        nodes.append(CableNode("anchor"))
    return tuple(nodes)


def _position(node: CableNode, path: Path, k: int, at: dict[int, Array]) -> Array:
    """Where a node is at laying; an anchor without a place of its own is where the path ends."""
    if node.kind == "anchor":
        anchor, point = (
            (path.start_anchor, path.points[0]) if k == 0 else (path.end_anchor, path.points[-1])
        )
        if anchor is not None:
            return np.array(anchor, dtype=float)
        node = CableNode("rider", point)
    ids, weights = node.masters()
    return np.sum([w * at[i] for i, w in zip(ids, weights, strict=True)], axis=0)


def _used(strip: Strip, path: Path) -> Strip:
    """The cells that the cable crosses or touches along edges, and those around its ends."""
    rows: set[int] = set()
    for point in path.points:
        rows.update(strip.rows(point.support))
    keep = np.zeros(len(strip.cells), dtype=bool)
    keep[sorted(rows)] = True
    return strip.select(keep)


def _refuse_crossing(name: str, path: Path, other: LaidCable, strip: Strip) -> None:
    """Two cables may share edges, cells and vertices, but not cross elsewhere."""
    for meeting in chords_cross(path, other.path, strip.cells):
        if isinstance(meeting.at, VertexPoint):
            continue
        where = (
            f"the cell of vertices {tuple(strip.cells[meeting.cell].tolist())}"
            if meeting.cell is not None
            else str(meeting.at)
        )
        raise PathError(
            f"lay_cable: {name!r} crosses or touches {other.name!r} in {where}; cables may only "
            "meet at mesh vertices: lead them past each other, or put a vertex there."
        )
