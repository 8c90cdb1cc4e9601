"""Cables of a scene, laid on a finer mesh in the place where they are.

A cable that was laid just taut, or with a tension, got its length from the mesh, and gets it from
the finer one again, on the shape and by the route of then: the physical problem is "just taut", not
a number that has the first mesh's error. A length that was given, at laying or in a load step, is
kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from crms_fenicsx.cables.strip_gather import cells_at
from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.model.cable_state import CableState, End
from crms_fenicsx.model.laid_cable import LaidCable, Laying
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.paths.laying import MeasuredOn, lay
from crms_fenicsx.paths.typed_nodes import fractions_of
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import PathError
from crms_fenicsx.scene import Scene
from crms_fenicsx.surface.mesh_refinement import MeshRefinement
from crms_fenicsx.surface.points import EdgePoint, SurfacePoint, VertexPoint

CLOSE = 0.03
"""Distance from a vertex, relative to its edge, at which a cable goes through it."""

Place = SurfacePoint | Array
"""A place on the mesh, or an anchor (3,) off it (length)."""


def laid_first(cable: LaidCable, finer: Scene, refinement: MeshRefinement) -> LaidCable:
    """Lay a cable as it was laid; so its length and where its ends are get known. Collective.

    Parameters
    ----------
    cable
        A cable of the coarse scene.
    finer
        The finer scene in the state in which it was laid.
    refinement
        How the meshes belong together.

    Returns
    -------
    LaidCable
        The cable on the finer scene.
    """
    laying = cable.laying
    assert laying is not None, "refused before"
    asked = laying.L0, laying.tension, laying.measured_on, laying.shortest
    places: list[Place] = [*refinement.along_edges(laying.path.points)]
    if laying.ends[0] == "off":
        places.insert(0, _anchor(cable, 0, finer, laying.anchors[0]))
    if laying.ends[1] == "off":
        places.append(_anchor(cable, -1, finer, laying.anchors[1]))
    try:  # by the route: the path has the detours around vertices that the coarse mesh makes
        if cable.in_edge:
            raise PathError("it lies on the edges of the coarse mesh")
        if laying.route.shape[1] == 2:
            return _lay(cable, finer, laying.route, {}, *asked)
        return _laid(cable, finer, [places[0], *laying.route[1:-1], places[-1]], *asked)
    except PathError:  # a route in space may follow facets that are not there
        return _laid(cable, finer, places, *asked)


def lay_again(
    cable: LaidCable,
    state: CableState,
    first: LaidCable | None,
    finer: Scene,
    refinement: MeshRefinement,
) -> None:
    """Lay a cable on the finer mesh as it was in some state. Collective.

    Parameters
    ----------
    cable
        A cable of the coarse scene.
    state
        Its state, now or before.
    first
        What `laid_first` has found.
    finer
        The finer scene, in the shape that belongs to the state.
    refinement
        How the meshes belong together.
    """
    was = LaidCable(
        cable.name, cable.cable, state, cable.sleeve, cable.layer, cable.in_edge, cable.joints
    )
    points: Sequence[SurfacePoint] = was.path.points
    if was.slides_freely and not was.in_edge:
        points = through_vertices(points, was.ends)
    places: list[Place] = [*refinement.along_edges(points)]
    anchors = {end: _set_end(was, end, places, cable.laying, first, finer) for end in (0, -1)}
    L0 = state.L0
    if cable.laying is not None and first is not None and L0 == cable.laying.length:
        L0 = first.L0
    laid = _laid(cable, finer, places, L0, None, "facets")
    if under := [k for k in (0, -1) if was.ends[k] == "off" and laid.ends[k] == "tied"]:
        finer.remove(laid)  # the edge that it slides along has moved beyond its anchor
        for end in under:
            places.pop(end)
        laid = _laid(cable, finer, places, L0, None, "facets")
        nodes = list(laid.nodes)
        for end in under:
            beside = 1 if end == 0 else -2
            on_edge = isinstance(nodes[beside].point, EdgePoint)
            nodes[beside] = replace(nodes[beside], kind="rail" if on_edge else "vertex")
        laid.update(nodes=tuple(nodes), fractions=fractions_of(nodes))
    laid.update(path_is_geodesic=state.path_is_geodesic)
    if was.taut:
        put_on_line(laid, was)
    positions = laid.positions.copy()
    for end, anchor in anchors.items():
        if anchor is not None and laid.nodes[end].kind == "anchor":
            positions[end] = anchor
    laid.update(positions=positions)
    if laid.axial is not None and state.axial is not None:
        was_long = state.L0 + state.excess
        rest = state.axial.rest * (L0 / was_long)
        laid.update(axial=replace(laid.axial, curve=state.axial.curve, rest=rest))
    if first is not None:
        laid.laying = first.laying


def put_on_line(laid: LaidCable, was: LaidCable) -> None:
    """Put the nodes of a cable in tension on the line that it had, in contact where that was.

    On straight edges of the finer mesh, between which it has pressed no valley yet, it would lift
    off most of them and be far too tight: an equilibrium that nobody wants would be found first.

    Parameters
    ----------
    laid
        The cable on the finer mesh; its positions change.
    was
        The cable on the coarse one.
    """
    at = was.line_nodes()
    start, way = was.positions[at[:-1]], np.diff(was.positions[at], axis=0)
    spans = np.array([bool(was.lifted[a:b].any()) for a, b in pairwise(at)])
    squares = np.maximum(np.sum(way**2, axis=1), np.finfo(float).tiny)
    positions, lifted = laid.positions.copy(), laid.lifted.copy()
    for k, node in enumerate(laid.nodes):
        if node.kind not in ("vertex", "fold"):
            continue
        along = np.clip(np.sum((positions[k] - start) * way, axis=1) / squares, 0.0, 1.0)
        nearest = start + along[:, None] * way
        i = int(np.argmin(np.sum((nearest - positions[k]) ** 2, axis=1)))
        if not spans[i]:
            lifted[k] = False
            if node.kind == "fold":
                positions[k] = nearest[i]
    laid.update(positions=positions, lifted=lifted)


def through_vertices(points: Sequence[SurfacePoint], ends: tuple[End, End]) -> list[SurfacePoint]:
    """A path that goes through the vertices that it has passed close by; held ends stay.

    On which side it passes them is the coarse mesh's matter. On the finer one a cable that is laid
    on the wrong side gets caught between edges; from the vertex it finds its side.
    """
    fixed = {k for k, end in ((0, ends[0]), (len(points) - 1, ends[1])) if end != "off"}
    found: list[SurfacePoint] = []
    for k, point in enumerate(points):
        if isinstance(point, EdgePoint) and k not in fixed:
            if min(point.fraction, 1.0 - point.fraction) < CLOSE:
                point = VertexPoint(point.edge[round(point.fraction)])
        if not found or point != found[-1]:
            found.append(point)
    return found


def _set_end(
    cable: LaidCable,
    end: int,
    places: list[Place],
    laying: Laying | None,
    first: LaidCable | None,
    finer: Scene,
) -> Array | None:
    """Put an end (0, -1) of a cable's places where it is on the finer mesh.

    One that lies where it was laid lies where it would be laid here: on a curved boundary that is
    not on the chord of the coarse mesh.

    Returns
    -------
    Where its anchor is, (3,) (length), which is not at the place if the edge there has moved; None
    where that is not known, or there is none.
    """
    kind, anchor = cable.ends[end], cable.positions[end]
    moved = True
    if laying is not None and first is not None:
        moved = bool(np.linalg.norm(anchor - laying.anchors[end]) > SAME_PLACE * cable.length)
        anchor = anchor + (first.positions[end] - laying.anchors[end])
        if kind == "tied" or (kind == "held" and not moved):
            places[end] = first.path.points[end]
    if kind == "off":
        anchor = _anchor(cable, end, finer, anchor)
        places.insert(0 if end == 0 else len(places), anchor)
    return anchor if kind != "tied" and first is not None else None


def _anchor(cable: LaidCable, end: int, finer: Scene, place: Array) -> Array:
    """Where an end off the membrane is: at the place, or at its joint where that is."""
    name = cable.joints[end]
    return next((joint.position for joint in finer.joints if joint.name == name), place)


def _laid(
    cable: LaidCable,
    finer: Scene,
    places: Sequence[Place],
    L0: float | None,
    tension: float | None,
    measured_on: MeasuredOn,
    shortest: bool = False,
) -> LaidCable:
    """Lay a cable over places on the finer mesh, in its current shape. Collective."""
    distinct = [places[0], *(b for a, b in pairwise(places) if not _same(a, b))]
    known = {k: place for k, place in enumerate(distinct) if not isinstance(place, np.ndarray)}
    strip = cells_at(finer.membrane, [v for place in known.values() for v in place.support])
    shape = StripShape.of(finer.membrane, strip)
    route = np.array([
        place if isinstance(place, np.ndarray) else shape.mean(place.support, place.weights)
        for place in distinct
    ])  # fmt: skip
    return _lay(cable, finer, route, known, L0, tension, measured_on, shortest)


def _same(a: Place, b: Place) -> bool:
    return not isinstance(a, np.ndarray) and not isinstance(b, np.ndarray) and a == b


def _lay(
    cable: LaidCable,
    finer: Scene,
    route: Array,
    known: Mapping[int, SurfacePoint],
    L0: float | None,
    tension: float | None,
    measured_on: MeasuredOn,
    shortest: bool = False,
) -> LaidCable:
    return lay(
        finer.net, cable.cable, route, L0=L0, tension=tension, sleeve=cable.sleeve,
        layer=cable.layer, name=cable.name, measured_on=measured_on, places=known,
        stage=finer.stage(), joints=cable.joints, shortest=shortest,
    )  # fmt: skip
