"""Routes that follow cables that are there already: their points lie in folds, not on the cells."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.points import SurfacePoint
from crms_fenicsx.surface.triangles import norm, vectors


def unfolded(net: CableNet, route: Array) -> tuple[Array, dict[int, SurfacePoint], list[Array]]:
    """Bring a route in space from the points of other cables to the unfolded cells. Collective.

    Parameters
    ----------
    net
        The cables, on the current shape of their membrane.
    route
        Points in plan, (k, 2), or in space, (k, 3).

    Returns
    -------
    route : (m, 3)
        Without points at which a cable crosses another one inside a cell, which no path has; those
        at the other points of cables are moved to their places on the unfolded cells.
    known
        These places, by their rows in the route.
    folds
        Where these points are in the folds, in the order of `known`.
    """
    if route.shape[1] == 2 or net.strip is None:
        return route, {}, []
    shape = net.strip_shape()
    contacts = [
        (cable, k)
        for cable in net.cables
        for k in cable.contacts()
        if cable.nodes[k].point is not None
    ]
    x = np.array([cable.positions[k] for cable, k in contacts]).reshape(-1, 3)
    rows: list[Array] = []
    known: dict[int, SurfacePoint] = {}
    folds: list[Array] = []
    for target in vectors(route):
        at = np.flatnonzero(norm(x - target) <= SAME_PLACE * net.membrane.size)
        if len(at):
            cable, k = contacts[at[0]]
            if cable.nodes[k].kind == "crossing":
                continue
            known[len(rows)] = cable.point(k)
            folds.append(x[at[0]])
            target = shape.mean(*cable.interpolation(k))
        rows.append(target)
    return np.array(rows), known, folds
