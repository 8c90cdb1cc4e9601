"""Clamps of limited grip, through which cables slip.

A cable with m clamps is a chain of m + 1 parts (`energy.terms.capstan_chain`), with dry
friction bounded by the grip at each clamp. The rest arc is that at clamping or after the last slip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crms_fenicsx.cabling.cables.element_tables import CableTables
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.energy.terms.axial_friction import CapstanTension, Chains, Grips
from crms_fenicsx.foundation.runtime.arrays import Array, floats, ints, pointers
from crms_fenicsx.model.cable import Clamp
from crms_fenicsx.model.laid_cable import LaidCable

TOLERANCE = 1e-3
"""Elastic slip at a clamp, relative to the elongation of the adjacent part under its grip."""

CLAMP_SLIP = 1e-6
"""Elastic slip at a clamp of unlimited grip, with axial friction, relative to the cable length."""


def bounds_and_slips(cable: LaidCable) -> tuple[Array, Array]:
    """Grips (m,) and elastic slips (m,) (length) of clamps; unlimited grips are EA."""
    assert cable.state.parts is not None
    EA, lengths = cable.cable.EA, cable.L0 * np.diff([0.0, *cable.state.parts.at, 1.0])
    bounds = np.where(cable.state.parts.grips > 0.0, np.minimum(cable.state.parts.grips, EA), EA)
    return bounds, TOLERANCE * bounds / EA * np.minimum(lengths[1:], lengths[:-1])


def held_by_clamps(cable: LaidCable) -> tuple[Array, Array]:
    """The same for a cable with axial friction: unlimited grips get a smaller elastic slip, since
    spans between its nodes are shorter than parts."""
    assert cable.state.parts is not None
    bounds, eps = bounds_and_slips(cable)
    return bounds, np.where(cable.state.parts.grips > 0.0, eps, CLAMP_SLIP * cable.L0)


def smallest_slip(cables: Sequence[LaidCable]) -> float:
    """Smallest elastic slip of clamps through which cables may slip (length)."""
    own = [bounds_and_slips(cable)[1] for cable in cables if cable.taut and cable.may_slip]
    return float(np.concatenate([[np.inf], *own]).min())


def slipping_tension(
    numbering: CableNumbering, tables: CableTables, cables: Sequence[LaidCable]
) -> CapstanTension:
    """Tension term of cables that may slip through clamps."""
    numbers = [numbering.cables.index(cable) for cable in cables]
    counts = np.array([len(cable.part_lengths) for cable in cables], dtype=np.int64)
    starts = pointers(counts).astype(np.int64)
    first = dict(zip(numbers, ints(starts), strict=False))
    begins = numbering.nodes.ids(tables.links[:, 0])
    own = [s for s, (c, _) in enumerate(begins) if c in first]
    span = [
        first[c] + int(numbering.cables[c].parts_of([k])[0]) for c, k in (begins[s] for s in own)
    ]
    none, no_rows = np.zeros(0, dtype=np.int32), np.zeros(1, dtype=np.int32)
    chains = Chains(
        np.array([cable.cable.EA for cable in cables]), starts,
        tables.segments[own], tables.eps[own], np.array(span, dtype=np.int32),
        no_rows, none, none, none, np.zeros(0, dtype=bool),
    )  # fmt: skip
    return CapstanTension(chains, clamp_grips(cables), whole_lengths(cables))


def whole_lengths(cables: Sequence[LaidCable]) -> Array:
    """Unstressed lengths including smoothing (length)."""
    return np.array(
        [cable.L0 + float(c.smoothing.sum()) for cable in cables if (c := cable.state.parts)]
    )


def clamp_grips(cables: Sequence[LaidCable]) -> Grips:
    """Grips of such cables at their clamps."""
    rows: list[Array] = [np.zeros((4, 0))]
    for cable in cables:
        parts = cable.state.parts
        assert parts is not None
        bounds, eps = bounds_and_slips(cable)
        rest = cable.L0 * parts.at + np.cumsum(parts.smoothing)[:-1]
        rows.append(np.array([rest, bounds, eps, parts.slips]))
    rest, bounds, eps, slips = np.concatenate(rows, axis=1)
    return Grips(rest, bounds, eps, eps, slips, np.zeros(0))


def end_step(cables: Sequence[LaidCable], clamps: Sequence[Clamp]) -> tuple[Clamp, ...]:
    """End a load step: clamps adopt the slipped positions. Returns the clamps."""
    moved: dict[tuple[str, float], float] = {}
    for cable in cables:
        parts = cable.state.parts
        if parts is None or not parts.slips.any():
            continue
        if cable.state.axial is None:
            (_, eps), length = bounds_and_slips(cable), cable.L0
        else:
            (_, eps), length = held_by_clamps(cable), cable.L0 + cable.state.smoothing_length
        elastic = np.clip(parts.slips, -eps, eps)
        at = np.asarray(parts.at + (parts.slips - elastic) / length)
        moved |= {
            (cable.name, old): new for old, new in zip(floats(parts.at), floats(at), strict=True)
        }
        spent = parts.dissipated + parts.loss
        cable.update(parts=replace(parts, at=at, slips=elastic, loss=0.0, dissipated=spent))
    return tuple(
        replace(clamp, at=(first, second)) if (first, second) != clamp.at else clamp
        for clamp in clamps
        for first, second in [
            tuple(moved.get(key, key[1]) for key in zip(clamp.cables, clamp.at, strict=True))
        ]
    )
