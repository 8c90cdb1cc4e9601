"""Points of cables that keep their line on the fabric, in pockets or bonded."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.energy.terms.held_line import HeldPoints
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial

HOLDING = 1e2
"""Relative stiffness of the points' springs: they yield by a hundredth of the fabric's strain."""


def holds_points(cables: Iterable[LaidCable]) -> bool:
    """Whether some taut cable has points held on their edges."""
    return any(c.taut and c.keeps_line and any(n.slides for n in c.state.nodes) for c in cables)


def held_points(
    numbering: CableNumbering, shape: StripShape, materials: Iterable[MembraneMaterial]
) -> HeldPoints:
    """Points of taut cables that are held on their edges."""
    fabric = max(m.reference_modulus + float(np.abs(m.prestress_vector).max()) for m in materials)
    rows, rest, lengths = [], [], []
    for c, cable in enumerate(numbering.cables):
        for k, node in enumerate(cable.state.nodes):
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
