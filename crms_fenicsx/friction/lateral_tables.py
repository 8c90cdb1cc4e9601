"""Tables of what a rank computes for friction: the cables' slips, or the paper's elements."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crms_fenicsx.cables.numbering import CableNumbering
from crms_fenicsx.cables.points_on_edges import points_by_edge
from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.contact_force import directions, turns
from crms_fenicsx.energies.lateral_friction import Slips
from crms_fenicsx.energies.paper.friction_element import FrictionElements
from crms_fenicsx.friction.slip import NodeSlips, node_slips
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.friction_history import Grip
from crms_fenicsx.model.laid_cable import LaidCable


def slip_table(numbering: CableNumbering, shape: StripShape) -> Slips:
    """Nodes with stick and slip."""
    on_edge = points_by_edge(numbering.cables)  # rails may have passed others since the layout
    pointers, places, rows = [0], [], []
    blocks: list[int] = []
    for c, _, friction, grip, slips in _slips(numbering, shape, "coulomb"):
        held = [grip.row_of[edge] for edge in slips.supports]
        bounds, eps, _ = grip.law(held, friction.tolerance * slips.size)
        for i, (k, edge) in enumerate(zip(slips.nodes, slips.supports, strict=True)):
            if numbering.strip.owner_of(edge) != numbering.rank:
                continue
            line = numbering.line((edge[0], edge[1]), on_edge[edge[0], edge[1]])
            blocks += line
            pointers.append(len(blocks))
            places.append(line.index(numbering.block(c, k)))
            rows.append((slips.slope[i], slips.offset[i], bounds[i], eps[i]))
    slope, offset, bound, eps_of = np.array(rows, dtype=float).reshape(-1, 4).T.copy()
    return Slips(
        np.array(pointers, dtype=np.int32), np.array(blocks, dtype=np.int32),
        np.array(places, dtype=np.int32), slope, offset, bound, eps_of,
    )  # fmt: skip


def element_table(numbering: CableNumbering, shape: StripShape) -> FrictionElements:
    """The paper's friction elements."""
    blocks, forces, offsets = [], [], []
    for c, cable, _, grip, slips in _slips(numbering, shape, "step"):
        direction = turns(cable)
        for k, edge, slip in zip(slips.nodes, slips.supports, slips.slip, strict=True):
            if numbering.strip.owner_of(edge) != numbering.rank:
                continue
            vertex = edge[int(cable.fractions[k] > 0.5)]
            work = grip.at(edge) * grip.moving[grip.row_of[edge]]
            force = work * directions(cable, [k], shape, *(way[None] for way in direction[k]))[1][0]
            blocks.append((numbering.vertex(vertex), numbering.block(c, k)))
            forces.append(force)
            # The work of a node that the path has got in this step begins with its slip.
            offsets.append(work * slip - float(force @ (cable.positions[k] - shape.at(vertex))))
    return FrictionElements(
        np.array(blocks, dtype=np.int32).reshape(-1, 2),
        np.array(forces, dtype=float).reshape(-1, 3),
        np.array(offsets, dtype=float),
    )


def _slips(
    numbering: CableNumbering, shape: StripShape, law: str
) -> Iterator[tuple[int, LaidCable, Friction, Grip, NodeSlips]]:
    """Slips of the nodes of the cables that friction of a law holds."""
    for c, cable in enumerate(numbering.cables):
        friction, grip = cable.cable.sideways, cable.grip
        if cable.taut and friction is not None and grip is not None and friction.law == law:
            yield c, cable, friction, grip, node_slips(cable, grip.curve, shape)
