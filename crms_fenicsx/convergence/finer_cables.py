"""Cables of a scene, laid on a finer mesh in the place where they are.

A cable that was laid just taut, or with a tension, got its length from the mesh, and gets it from
the finer one again, on the shape and by the route of then: the physical problem is "just taut", not
a number that has the first mesh's error. A length that was given, at laying or in a load step, is
kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from crms_fenicsx.cables.strip_gather import cells_at
from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.model.laid_cable import LaidCable, Laying
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.paths.laying import MeasuredOn, lay
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import PathError
from crms_fenicsx.scene import Scene
from crms_fenicsx.surface.points import SurfacePoint
from crms_fenicsx.surface.uniform_refinement import UniformRefinement

Place = SurfacePoint | Array
"""A place on the mesh, or an anchor (3,) off it (length)."""


def laid_first(cable: LaidCable, finer: Scene, refinement: UniformRefinement) -> LaidCable | None:
    """Lay a cable as it was laid, to know its length and where its ends are. Collective.

    Parameters
    ----------
    cable
        A cable of the coarse scene.
    finer
        The finer scene in the state in which it was laid. The cable is taken away again.
    refinement
        How the meshes belong together.

    Returns
    -------
    LaidCable
        None for one from a checkpoint, of which this is not known.
    """
    laying = cable.laying
    if laying is None:
        return None
    asked = laying.L0, laying.tension, laying.measured_on, laying.shortest
    places: list[Place] = [*refinement.along_edges(laying.path.points)]
    if laying.ends[0] == "off":
        places.insert(0, laying.anchors[0])
    if laying.ends[1] == "off":
        places.append(laying.anchors[1])
    try:  # by the route: the path has the detours around vertices that the coarse mesh makes
        if cable.in_edge:
            raise PathError("it lies on the edges of the coarse mesh")
        if laying.route.shape[1] == 2:
            first = _lay(cable, finer, laying.route, {}, *asked)
        else:
            first = _laid(cable, finer, [places[0], *laying.route[1:-1], places[-1]], *asked)
    except PathError:  # a route in space may follow facets that are not there
        first = _laid(cable, finer, places, *asked)
    finer.remove(first)
    return first


def lay_again(
    cable: LaidCable,
    state: CableState,
    first: LaidCable | None,
    finer: Scene,
    refinement: UniformRefinement,
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
    was = LaidCable(cable.name, cable.cable, state, cable.sleeve, cable.layer, cable.in_edge)
    places: list[Place] = [*refinement.along_edges(was.path.points)]
    for end in (0, -1):
        _set_end(was, end, places, cable.laying, first)
    L0 = state.L0
    if cable.laying is not None and first is not None and L0 == cable.laying.length:
        L0 = first.L0
    laid = _laid(cable, finer, places, L0, None, "facets")
    laid.update(path_is_geodesic=state.path_is_geodesic)
    if first is not None:
        laid.laying = first.laying


def _set_end(
    cable: LaidCable,
    end: int,
    places: list[Place],
    laying: Laying | None,
    first: LaidCable | None,
) -> None:
    """Put an end (0, -1) of a cable's places where it is on the finer mesh.

    One that lies where it was laid lies where it would be laid here: on a curved boundary that is
    not on the chord of the coarse mesh.
    """
    kind, anchor = cable.ends[end], cable.positions[end]
    moved = True
    if laying is not None and first is not None:
        moved = bool(np.linalg.norm(anchor - laying.anchors[end]) > SAME_PLACE * cable.length)
        anchor = anchor + (first.positions[end] - laying.anchors[end])
        if kind == "tied" or (kind == "held" and not moved):
            places[end] = first.path.points[end]
    if kind == "off":
        places.insert(0 if end == 0 else len(places), anchor)


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
    finer.changes += 1
    return lay(
        finer.net, cable.cable, route, L0=L0, tension=tension, sleeve=cable.sleeve,
        layer=cable.layer, name=cable.name, measured_on=measured_on, places=known,
        stage=finer.stage(), shortest=shortest,
    )  # fmt: skip
