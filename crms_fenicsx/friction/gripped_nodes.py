"""Nodes of a cable that friction holds."""

from __future__ import annotations

from collections.abc import Sequence

from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.surface.points import Support


def succession(
    old: Sequence[Support], now: Sequence[Support]
) -> tuple[list[int], list[int], list[tuple[slice, list[int]]]]:
    """How the nodes of a changed path follow on those of the old one.

    Returns stays, rows: nodes that stay, and what they were; heirs: old nodes that go, a stretch at
    a time, with those that take their place: the new ones there, or the neighbours.
    """
    was = {support: k for k, support in enumerate(old)}
    stays = [k for k, support in enumerate(now) if support in was]
    rows = [was[now[k]] for k in stays]
    if sorted(rows) != rows:  # no such path comes from this one
        stays, rows = [], []
    starts, ends = [-1, *stays], [*stays, len(now)]
    was_starts, was_ends = [-1, *rows], [*rows, len(old)]
    heirs = []
    for a, b, c, d in zip(starts, ends, was_starts, was_ends, strict=True):
        new = list(range(a + 1, b)) or [k for k in (a, b) if 0 <= k < len(now)]
        if new and d > c + 1:
            heirs.append((slice(c + 1, d), new))
    return stays, rows, heirs


def held_nodes(cable: LaidCable) -> list[int]:
    """Nodes that friction may hold: those that touch the membrane, inside of the cable's ends."""
    return [
        k
        for k in cable.contacts()
        if cable.nodes[k].kind in ("fold", "rail", "vertex") and 0 < k < len(cable.nodes) - 1
    ]


def supports_of(cable: LaidCable) -> Sequence[Support]:
    """Places of these nodes on the mesh."""
    return [cable.nodes[k].support for k in held_nodes(cable)]
