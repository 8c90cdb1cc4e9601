"""Clamps that hold two crossing cables to each other."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class Clamp:
    """A clamp at a crossing of two cables.

    Attributes
    ----------
    name
        Name: those of the cables, "A1 x B2", with a number where they have several.
    cables
        Names of the two cables.
    at
        Unstressed lengths from the starts of the cables to the clamp, as shares of those of the
        whole cables: they stay while it holds.
    place
        Where it is, (3,) (length).
    slip
        Difference of the tensions of a cable on its two sides at which that slips through it
        (force); None if it never does.
    """

    name: str
    cables: tuple[str, str]
    at: tuple[float, float]
    place: Annotated[Array, 3] = field(repr=False)
    slip: float | None = None


@dataclass(frozen=True)
class ClampedParts:
    """The m + 1 parts of a cable between m clamps, each with a tension of its own."""

    at: Annotated[Array, "m"]  # unstressed lengths up to the clamps, as shares of the whole
    nodes: tuple[int, ...]  # nodes at the clamps, in order; () until crossings are arranged
    tensions: Annotated[Array, "p"]  # of the parts (force)
    smoothing: Annotated[Array, "p"]  # what smoothing has added to their lengths (length)
    grips: Annotated[Array, "m"]  # most that the clamps hold, 0 where there is no limit (force)
    slips: Annotated[
        Array, "m"
    ]  # of the cable in its direction, in this step, the elastic one left
    # before included (length)
    loss: float = 0.0  # energy dissipated by slips in the step so far (force x length)
    dissipated: float = 0.0  # and up to the step's start
