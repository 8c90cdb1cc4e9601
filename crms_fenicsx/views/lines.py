"""Lines of cables with their tensions, and of bars with their forces, for output."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.contact.contact_force import contact_forces
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.views.data import Line

Segments = tuple[Array, Integers, dict[str, NDArray[Any]], dict[str, NDArray[Any]]]
"""Points, pairs of them, and data on points and on pairs."""


def cable_lines(net: CableNet) -> list[Line]:
    """Return the cables as lines, the same on all ranks. Collective.

    Their data are "tension", of each segment where friction along the cable makes it vary, "lifted"
    segments off the membrane, and "contact force" at their points: the normal force per length of
    cable, zero where they do not touch the membrane.
    """
    if not net.cables:
        return []
    shape = net.strip_shape()
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
        for cable in net.cables
    ]


def bar_lines(bars: Sequence[PlacedBar]) -> list[Line]:
    """Return bars as lines, the same on all ranks.

    Their "tension" is the axial force, negative in compression; they are never "lifted".
    """
    return [Line(bar.points, {"tension": bar.force, "lifted": 0.0}, bar.name) for bar in bars]


def joined(lines: Sequence[Line]) -> Segments:
    """Return checked lines as one mesh of two-point segments.

    Their data become arrays with NaN where a line has none; the array "line" counts the lines from
    0.
    """
    counts = np.array([len(line.points) for line in lines], dtype=np.int64)  # type: ignore[arg-type]
    starts = np.concatenate([[0], np.cumsum(counts)])
    last = np.zeros(starts[-1], dtype=bool)
    last[starts[1:] - 1] = True
    first = np.flatnonzero(~last)
    on_points: dict[str, NDArray[Any]] = {}
    on_segments: dict[str, NDArray[Any]] = {"line": np.repeat(np.arange(len(lines)), counts - 1)}
    for index, line in enumerate(lines):
        for name, values in line.data.items():
            array = np.asarray(values)
            per_point = array.shape == (counts[index],)
            target = on_points if per_point else on_segments
            start = starts[index] if per_point else starts[index] - index
            whole = target.setdefault(
                name, np.full(starts[-1] if per_point else len(first), np.nan)
            )
            whole[start : start + counts[index] - (not per_point)] = array
    points: Array = np.concatenate([np.empty((0, 3)), *(a.points for a in lines)])
    return points, np.column_stack([first, first + 1]), on_points, on_segments
