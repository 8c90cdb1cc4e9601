"""Places behind a seam, such as a wall below a roof: no cable can lie there."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.cables.strip_gather import own_surface
from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.meshes.triangles import vectors
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import PathError, as_text
from crms_fenicsx.surface.closest_point import ON_SURFACE
from crms_fenicsx.surface.feet import feet_of
from crms_fenicsx.surface.path import Path


def refuse_places_behind(membrane: Membrane, route: Array, name: str) -> None:
    """Refuse a route with a point on cells behind a seam, and on no others. Collective.

    Shapes: route (k, 3).
    """
    positions, cells = own_surface(membrane)
    hidden = np.isin(np.arange(len(cells)), membrane.mesh.hidden)
    behind, outer = membrane.comm.allreduce(np.array([hidden.sum(), (~hidden).sum()]))
    if outer == 0:
        raise PathError(
            f"lay_cable: {name!r} finds no outer side of the membrane: each of its pieces meets "
            "others at a seam from behind; turn them with the `outside` of the mesh."
        )
    if behind == 0:
        return
    if route.shape[1] == 2:
        positions = positions * (1.0, 1.0, 0.0)
    course = np.pad(route, ((0, 0), (0, 3 - route.shape[1])))
    feet = [feet_of(positions, cells[some], course, membrane.comm) for some in (hidden, ~hidden)]
    for i, (point, on_hidden, on_outer) in enumerate(zip(vectors(course), *feet, strict=True)):
        reach = ON_SURFACE * on_hidden.size
        if on_hidden.distance <= reach and on_outer.distance > max(reach, on_hidden.distance):
            raise PathError(
                f"lay_cable: point {i} of {name!r} at {as_text(point)} lies on a part of the "
                "membrane behind a seam, such as a wall below a roof, where no cable can be laid; "
                "lead it over the outer side, or turn that part with the `outside` of the mesh."
            )


def refuse_forks(path: Path, shape: StripShape, name: str) -> None:
    """Refuse a path over a seam with more than two outer cells, where it has no one way on."""
    places = vectors(path.positions(shape.strip.vertices, shape.current))
    for point, place in zip(path.points, places, strict=True):
        if len(point.support) == 2 and (n := len(shape.strip.outer_rows(point.support))) > 2:
            raise PathError(
                f"lay_cable: {name!r} comes to a seam of {n} outer cells at {as_text(place)}, "
                "where it has no one way on; end it before the seam, and lay another one beyond."
            )
