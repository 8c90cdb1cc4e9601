"""Cables bonded to the fabric: their bonds, and a tension for each part between these."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.triangles import arc_lengths, norm
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.model.cable import Bonds, ClampedParts
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE


def bonds_of(cable: LaidCable) -> Bonds:
    """Bonds of a cable lying on the membrane, at uniform strain."""
    last, x = len(cable.state.nodes) - 1, cable.state.positions
    passed = arc_lengths(x)
    inside = [
        k
        for k in cable.path_nodes()
        if 0 < k < last and norm(x[[k, k]] - x[[0, last]]).min() > SAME_PLACE * passed[-1]
    ]
    places = tuple(cable.state.nodes[k].support for k in inside)
    return Bonds(places, passed[inside] / passed[-1])


def bonded_parts(cable: LaidCable) -> ClampedParts:
    """Parts of a newly bonded cable."""
    assert cable.state.bonds is not None
    count = len(cable.state.bonds.at) + 1
    force = np.full(count, cable.tension)
    inner = np.zeros(count - 1)
    return ClampedParts(
        cable.state.bonds.at, tuple(bonded_nodes(cable)), force, np.zeros(count), inner, inner
    )


def bonded_nodes(cable: LaidCable) -> list[int]:
    """Nodes at which a cable is bonded to the fabric, in order."""
    assert cable.state.bonds is not None
    on, found = iter(cable.path_nodes()), []
    for support in cable.state.bonds.supports:
        node = next((k for k in on if cable.state.nodes[k].support == support), None)
        if node is None:
            raise PathError(
                f"{cable.name!r} has an end that has moved past places at which it is bonded to "
                "the fabric; move it with the edge that it is sewn to, or lay the cable anew."
            )
        found.append(node)
    return found
