"""Routes that follow cables that are there already: their points lie in folds, not on the cells."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.meshes.triangles import norm, vectors
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.feet import pairs_within
from crms_fenicsx.surface.points import SurfacePoint


def unfolded(net: CableNet, route: Array) -> tuple[Array, dict[int, SurfacePoint], list[Array]]:
    """Bring a route in space from the points of other cables to the unfolded cells. Collective.

    Shapes: route (k, 3). Returns route (m, 3): without points at which a cable crosses another one
    inside a cell, which no path has; those at the other points of cables are moved to their places
    on the unfolded cells; known: these places, by their rows in the route; folds: where these
    points are in the folds, in the order of `known`.
    """
    if route.shape[1] == 2 or net.strip is None:
        return route, {}, []
    contacts: list[tuple[LaidCable, int]] = []
    positions: list[Array] = [np.zeros((0, 3))]
    for cable in net.cables:
        on = [k for k, node in enumerate(cable.nodes) if node.point is not None]
        here = [k for k, lifted in zip(on, cable.lifted[on], strict=True) if not lifted]
        contacts += [(cable, k) for k in here]
        positions.append(cable.positions[here])
    x, reach = np.concatenate(positions), SAME_PLACE * net.membrane.size
    target, contact = pairs_within(x, route, np.full(len(route), reach))
    same = norm(x[contact] - route[target]) <= reach
    if not same.any():
        return route, {}, []
    first_at: dict[int, int] = {}
    for row, at in zip(target[same], contact[same], strict=True):
        first_at.setdefault(int(row), int(at))
    shape = net.strip_shape()
    rows: list[Array] = []
    known: dict[int, SurfacePoint] = {}
    folds: list[Array] = []
    for i, place in enumerate(vectors(route)):
        if i in first_at:
            cable, k = contacts[first_at[i]]
            if cable.nodes[k].kind == "crossing":
                continue
            known[len(rows)] = cable.point(k)
            folds.append(x[first_at[i]])
            place = shape.mean(*cable.interpolation(k))
        rows.append(place)
    return np.array(rows), known, folds
