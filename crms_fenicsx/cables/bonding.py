"""Cables that keep their line on the fabric: in pockets, or bonded to it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from crms_fenicsx.cables.strip import StripShape
from crms_fenicsx.meshes.triangles import arc_lengths, norm
from crms_fenicsx.model.clamp import ClampedParts
from crms_fenicsx.model.hold import Bonds
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.surface.points import EdgePoint

if TYPE_CHECKING:
    from crms_fenicsx.cables.numbering import CableNumbering
    from crms_fenicsx.energies.held_line import HeldPoints

HOLDING = 1e2
"""Stiffness with which points are held on their edges, relative to that of the fabric: it gives way
by a hundredth of what the fabric is strained."""


def bonds_of(cable: LaidCable) -> Bonds:
    """Where a cable that lies on the membrane is bonded to it, with the same strain everywhere."""
    last, x = len(cable.nodes) - 1, cable.positions
    passed = arc_lengths(x)
    inside = [
        k
        for k in cable.path_nodes()
        if 0 < k < last and norm(x[[k, k]] - x[[0, last]]).min() > SAME_PLACE * passed[-1]
    ]
    places = tuple(cable.nodes[k].support for k in inside)
    return Bonds(places, passed[inside] / passed[-1])


def bonded_parts(cable: LaidCable) -> ClampedParts:
    """The parts of a cable that has just been bonded."""
    assert cable.bonds is not None
    count = len(cable.bonds.at) + 1
    force = np.full(count, cable.tension)
    inner = np.zeros(count - 1)
    return ClampedParts(
        cable.bonds.at, tuple(bonded_nodes(cable)), force, np.zeros(count), inner, inner
    )


def bonded_nodes(cable: LaidCable) -> list[int]:
    """Nodes at which a cable is bonded to the fabric, in order."""
    assert cable.bonds is not None
    on = iter(cable.path_nodes())
    return [
        next(k for k in on if cable.nodes[k].support == support) for support in cable.bonds.supports
    ]


def holds_points(cables: Iterable[LaidCable]) -> bool:
    """Whether some cable in tension has points that are held on their edges."""
    return any(c.taut and c.keeps_line and any(n.slides for n in c.nodes) for c in cables)


def held_points(
    numbering: CableNumbering, shape: StripShape, materials: Iterable[MembraneMaterial]
) -> HeldPoints:
    """The points of cables in tension that are held on their edges."""
    from crms_fenicsx.energies.held_line import HeldPoints

    fabric = max(m.reference_modulus + float(np.abs(m.prestress_vector).max()) for m in materials)
    rows, rest, lengths = [], [], []
    for c, cable in enumerate(numbering.cables):
        for k, node in enumerate(cable.nodes):
            point = node.point
            if cable.taut and cable.keeps_line and node.slides and isinstance(point, EdgePoint):
                a, b = (shape.stress_free_at(vertex) for vertex in point.edge)
                rows.append(numbering.row(c, k))
                rest.append(point.fraction)
                lengths.append(float(np.linalg.norm(b - a)))
    all_rows = np.array(rows, dtype=np.int64)
    own = numbering.strip.simplices.owner[numbering.on[all_rows]] == numbering.rank
    all_rows = all_rows[own]
    points = numbering.points_now()
    pointers, blocks = numbering.lines(numbering.on[all_rows], points)
    places = (points.place[all_rows] + 1).astype(np.int32)
    stiffness = HOLDING * fabric * np.array(lengths)[own] ** 2
    return HeldPoints(pointers.astype(np.int32), blocks, places, np.array(rest)[own], stiffness)
