"""Lines of cables with their tensions, and of bars with their forces, for output."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.contact.contact_force import contact_forces
from crms_fenicsx.output.data import Line
from crms_fenicsx.scene import Scene


def cable_lines(scene: Scene) -> list[Line]:
    """Return the scene's cables as lines, the same on all ranks. Collective.

    Their data are "tension", of each segment where friction along the cable makes it vary, "lifted"
    segments off the membrane, and "contact force" at their points: the normal force per length of
    cable, zero where they do not touch the membrane.
    """
    if not scene.cables:
        return []
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


def bar_lines(scene: Scene) -> list[Line]:
    """Return the scene's bars as lines, the same on all ranks.

    Their "tension" is the axial force, negative in compression; they are never "lifted".
    """
    return [Line(bar.points, {"tension": bar.force, "lifted": 0.0}, bar.name) for bar in scene.bars]
