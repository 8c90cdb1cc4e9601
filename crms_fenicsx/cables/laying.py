"""Laying a cable: from the user's path to a polyline with typed points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.cable import Cable, CableNode, LaidCable, polyline_length
from crms_fenicsx.cables.path import CellPoint, EdgePoint, Path, SurfacePoint, VertexPoint
from crms_fenicsx.cables.strip import EMPTY, Strip, gather_strip
from crms_fenicsx.cables.trace import chords_cross, trace
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
    name = f"cable {len(scene.cables) + 1}" if name is None else name
    if not isinstance(name, str) or not name or name != name.strip():
        raise InputError(f"lay_cable: name = {name!r}; tables need text without blanks around it.")
    if any(other.name == name for other in scene.cables):
        raise InputError(f"lay_cable: there is a cable {name!r} already; give another name.")
    if L0 is not None and tension is not None:
        raise InputError(f"lay_cable: {name!r} got both L0 and tension; give one of them.")
    for key, value in (("L0", L0), ("tension", tension)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"lay_cable: {key} = {value} of {name!r} must be positive and finite.")
    route = _route(path)
    strip, ids, positions, rows = gather_strip(scene.u, route)
    traced = trace(ids, positions, rows, route)
    held = _held_vertices(scene, strip)
    nodes = _nodes(traced, strip, held)
    at = dict(zip(ids.tolist(), positions, strict=True))
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
    laid = LaidCable(
        name, cable, traced, nodes, places, fractions, unstressed, length, force,
        step_energy=force * (length - unstressed) / 2, taut=force > 0 or cable.law == "step",
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


def _held_vertices(scene: Scene, strip: Strip) -> set[int]:
    """Ids of the strip's vertices that are held in all directions."""
    own = np.flatnonzero(strip.owner == scene.comm.rank)
    dofs = scene.V.dofmap.list[strip.local[own]]
    held = scene.held[dofs].all(axis=2)
    mine = set(strip.cells[own][held].tolist())
    return set().union(*scene.comm.allgather(mine))


def _is_held(point: SurfacePoint, strip: Strip, held: set[int]) -> bool:
    """Whether a place is held: a held vertex, or an edge of the boundary between two of them."""
    if not all(vertex in held for vertex in point.support):
        return False
    return isinstance(point, VertexPoint) or (
        isinstance(point, EdgePoint) and len(strip.rows(point.support)) == 1
    )


def _nodes(path: Path, strip: Strip, held: set[int]) -> tuple[CableNode, ...]:
    """The points of the polyline, with anchors at ends that are held."""
    nodes: list[CableNode] = []
    last = len(path.points) - 1
    for k, point in enumerate(path.points):
        at_end = (k == 0 and path.start_anchor is None) or (k == last and path.end_anchor is None)
        if isinstance(point, VertexPoint):
            nodes.append(CableNode("vertex", point))
        elif at_end or isinstance(point, CellPoint) or _is_held(point, strip, held):
            nodes.append(CableNode("rider", point))
        else:
            nodes.append(CableNode("fold", point))
    if path.start_anchor is not None or _is_held(path.points[0], strip, held):
        nodes.insert(0, CableNode("anchor"))
    if path.end_anchor is not None or _is_held(path.points[-1], strip, held):
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
    """Two cables may share edges and cells, but not cross."""
    crossed = chords_cross(path, other.path, strip.cells)
    if crossed:
        raise PathError(
            f"lay_cable: {name!r} crosses {other.name!r} at {crossed[0]}; crossing cables cannot "
            "be laid yet, lead them past each other."
        )
