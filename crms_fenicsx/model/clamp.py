"""Clamps that join two crossing cables."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from crms_fenicsx.foundation.runtime.arrays import Array


@dataclass(frozen=True)
class Clamp:
    """A clamp at a crossing of two cables.

    Attributes
    ----------
    name
        Names of the cables, "A1 x B2", with a number if they have several clamps.
    cables
        Names of the two cables.
    at
        Unstressed lengths from the cables' starts to the clamp, relative to the whole cables';
        constant while it holds.
    place
        Its position, (3,) (length).
    slip
        Difference of a cable's tensions on the clamp's two sides at which the cable slips (force);
        None if it never does.
    """

    name: str
    cables: tuple[str, str]
    at: tuple[float, float]
    place: Annotated[Array, 3] = field(repr=False)
    slip: float | None = None


@dataclass(frozen=True)
class ClampedParts:
    """The m + 1 parts of a cable between m clamps, each with its own tension."""

    at: Annotated[Array, "m"]  # unstressed lengths up to the clamps, relative to the whole cable's
    nodes: tuple[int, ...]  # nodes at the clamps, in order; () until crossings are arranged
    tensions: Annotated[Array, "p"]  # of the parts (force)
    smoothing: Annotated[Array, "p"]  # lengths added to the parts by smoothing (length)
    grips: Annotated[Array, "m"]  # slip forces of the clamps, 0 if unlimited (force)
    slips: Annotated[
        Array, "m"
    ]  # of the cable, in its direction, in this step, including the elastic slip of earlier steps
    # (length)
    loss: float = 0.0  # energy dissipated by slips in this step (force x length)
    dissipated: float = 0.0  # energy dissipated before this step (force x length)
