"""Tables of what a rank computes for the cables with friction along their axis."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.cables.element_tables import CableTables
from crms_fenicsx.cables.numbering import CableNumbering
from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.energies.axial_friction import Chains, Grips
from crms_fenicsx.friction.axial import gripped_nodes, reference_arcs
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array


def held_along(cable: LaidCable) -> bool:
    """Whether a cable is in tension and friction holds it along its axis."""
    return cable.taut and cable.axial is not None


def chain_table(numbering: CableNumbering, tables: CableTables) -> Chains:
    """Spans and nodes of the cables that friction holds along their axis."""
    cables = [c for c, cable in enumerate(numbering.cables) if held_along(cable)]
    held = {c: gripped_nodes(numbering.cables[c]) for c in cables}
    starts = np.cumsum([0] + [len(held[c]) + 1 for c in cables])
    first = dict(zip(cables, starts, strict=False))
    begins = numbering.nodes.ids(tables.links[:, 0])
    own = [s for s, (c, _) in enumerate(begins) if c in first]
    span = [
        first[c] + np.searchsorted(held[c], k, side="right") for c, k in (begins[s] for s in own)
    ]
    strip, pointers, places = numbering.strip, [0], []
    blocks: list[int] = []
    nodes: list[int] = []
    owned: list[bool] = []
    on_edge = numbering.on_edge
    for n, c, i, edge in _fold_points(numbering):
        line = numbering.line(edge, on_edge[edge])
        blocks += line
        pointers.append(len(blocks))
        places.append(line.index(numbering.block(c, held[c][i])))
        nodes.append(int(first[c]) - n + i)
        owned.append(strip.owner_of(edge) == numbering.rank)
    return Chains(
        np.array([numbering.cables[c].cable.EA for c in cables]),
        starts.astype(np.int64),
        tables.segments[own], tables.eps[own], np.array(span, dtype=np.int32),
        np.array(pointers, dtype=np.int32), np.array(blocks, dtype=np.int32),
        np.array(places, dtype=np.int32), np.array(nodes, dtype=np.int32),
        np.array(owned, dtype=bool),
    )  # fmt: skip


def grip_table(numbering: CableNumbering, shape: StripShape) -> Grips:
    """What holds these cables now."""
    places = {c: reference_arcs(k, shape) for c, k in enumerate(numbering.cables) if held_along(k)}
    grips = [axial for c in places if (axial := numbering.cables[c].axial) is not None]

    def joined(parts: list[Array]) -> Array:
        return np.concatenate([np.zeros(0), *parts])

    bound = joined([grip.bounds for grip in grips])
    return Grips(
        joined([p.offset for p in places.values()]),
        bound,
        np.where(bound > 0.0, joined([grip.eps for grip in grips]), 1.0),
        np.where(bound > 0.0, joined([grip.elastic for grip in grips]), 1.0),
        joined([grip.slips for grip in grips]),
        np.array([places[c].slope[i] for _, c, i, _ in _fold_points(numbering)]),
    )


def _fold_points(numbering: CableNumbering) -> list[tuple[int, int, int, tuple[int, int]]]:
    """Fold points and rails on the edges of this rank's cells that friction holds.

    The number of the cable among those held, its number, that of the node among its held ones, and
    the edge.
    """
    strip = numbering.strip
    found = []
    cables = [c for c, cable in enumerate(numbering.cables) if held_along(cable)]
    for n, c in enumerate(cables):
        for i, k in enumerate(gripped_nodes(numbering.cables[c])):
            node = numbering.cables[c].nodes[k]
            if node.slides and node.point is not None:
                a, b = node.point.support
                if np.any(strip.owner[strip.rows((a, b))] == numbering.rank):
                    found.append((n, c, i, (a, b)))
    return found
