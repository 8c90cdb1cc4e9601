"""Lines of cables with their tensions, for output."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from crms_fenicsx.output.data import Line

if TYPE_CHECKING:
    from crms_fenicsx.scene import Scene


def cable_lines(scene: Scene) -> list[Line]:
    """The scene's cables as lines, the same on all ranks. Collective.

    They know their tension, of each segment where friction along the cable makes it vary, which
    segments are "lifted" off the membrane, and how hard they press on it at their points: "contact
    force", per length of cable, zero where they do not touch it.
    """
    if not scene.cables:
        return []
    from crms_fenicsx.contact.contact_force import contact_forces

    shape = scene.net.strip_shape()
    return [
        Line(
            cable.line,
            {
                "tension": cable.tension if cable.axial is None else cable.tensions,
                "lifted": cable.free_spans,
                "contact force": np.nan_to_num(
                    contact_forces(cable, shape).line[cable.line_nodes()]
                ),
            },
            cable.name,
        )
        for cable in scene.cables
    ]
