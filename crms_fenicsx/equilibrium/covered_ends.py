"""Ends of cables that have come to lie under the membrane, which has risen above their anchors."""

from __future__ import annotations

from collections.abc import Iterator

from crms_fenicsx.contact.gap import size_at
from crms_fenicsx.contact.lift_off import SUNK, is_foot
from crms_fenicsx.model.state_warning import StateWarning
from crms_fenicsx.runtime.errors import as_text
from crms_fenicsx.scene import Scene


def covered_ends(scene: Scene) -> Iterator[StateWarning]:
    """Say which ends over the membrane lie under it in the current state. Collective."""
    over = [
        (cable, which, end, foot)
        for cable in scene.cables
        for which, end, foot in (("start", 0, 1), ("end", -1, len(cable.nodes) - 2))
        if len(cable.nodes) > 2 and cable.nodes[end].kind == "anchor" and is_foot(cable, foot)
    ]
    if not over:
        return
    shape = scene.net.strip_shape()
    for cable, which, end, foot in over:
        node = cable.nodes[foot]
        above = cable.positions[end] - shape.mean(*node.interpolation())
        gap = float(above @ shape.normal(node.support))
        if gap < -SUNK * size_at(shape, node.support):
            yield StateWarning(
                "cable end",
                f"the {which} of {cable.name!r} at {as_text(cable.positions[end])} lies {-gap:.3g} "
                "under the membrane, which a cable cannot pass; move it up or off the membrane.",
            )
