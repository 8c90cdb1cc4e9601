"""What load steps change of a laid cable: its path, its tension, what friction remembers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.clamp import ClampedParts
from crms_fenicsx.model.friction import AxialFrictionState, LateralFrictionState
from crms_fenicsx.model.hold import Bonds, Hold
from crms_fenicsx.runtime.arrays import Array, Booleans
from crms_fenicsx.surface.points import EdgePoint, SurfacePoint


@dataclass(frozen=True, eq=False)
class Crossing:
    """A place where two cables cross: one free point that both share, known by its number."""

    lower: int  # number of the cable below
    upper: int  # number of the cable on top
    support: tuple[int, ...]  # ids of the vertices of the cell (3) or edge (2) that it is in
    links: tuple[int, int]  # nodes of both before it, crossings not counted
    place: Annotated[Array, 3]  # (3,) where they cross, or would (length)
    between: tuple[tuple[int, ...], ...]  # supports of the ends of the links, the lower one first
    separated: bool = False  # whether the upper cable has lifted off, so that they share no point
    clamp: str | None = None  # name of the clamp that holds them to each other


NodeId = tuple[int, int]
"""A node of a cable: the cable's number, the node's number."""


End = Literal["tied", "held", "off"]
"""How a cable's end is held: tied to a place of the membrane, held at its place on a held part of
the membrane, or by an anchor off the membrane."""


@dataclass(frozen=True)
class CableNode:
    """A point of a cable's polyline."""

    # "vertex": a mesh vertex. "fold": slides freely on an edge, which folds there. "edge slider":
    # slides freely along an edge that is held, and so stays straight. "tied": is tied to a place of
    # the membrane. "anchor": held in space. "crossing": free, shared with another cable.
    kind: Literal["vertex", "fold", "edge slider", "tied", "anchor", "crossing"]
    point: SurfacePoint | None = None  # its place on the mesh; None for an anchor
    crossing: int | None = None  # also of a fold point on an edge that another cable follows

    @property
    def slides(self) -> bool:
        """Whether its place on its edge is an unknown."""
        return self.kind in ("fold", "edge slider")

    @property
    def support(self) -> tuple[int, ...]:
        """Ids of the vertices on which it lies, or between which; it is no anchor."""
        assert self.point is not None, "an anchor has no place on the mesh"
        return self.point.support

    @property
    def touches_cable(self) -> bool:
        """Whether another cable lies over or under it."""
        return self.kind == "crossing" or self.crossing is not None

    def interpolation(
        self, fraction: float | None = None
    ) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Vertices (ids) and weights that give the place on the unfolded mesh."""
        assert self.point is not None, "an anchor has no place on the mesh"
        if fraction is not None and isinstance(self.point, EdgePoint):
            return self.point.edge, (1 - fraction, fraction)
        return self.point.support, self.point.weights


@dataclass(frozen=True)
class StepStart:
    """State of a cable with the step-wise law at the start of a step, (2.2-2, 3)."""

    tension: float
    length: float
    energy: float


@dataclass(frozen=True)
class CableState:
    """All that is known of a laid cable, as one value: see the attributes of `LaidCable`."""

    # Checkpoints are checked against the shapes in the type hints.

    cable: Cable
    nodes: Annotated[tuple[CableNode, ...], "n"]
    positions: Annotated[Array, "n", 3]
    fractions: Annotated[Array, "n"]
    lifted: Annotated[Booleans, "n"]
    reference_positions: Annotated[Array, "n", 3]
    L0: float
    length: float
    tension: float
    step_start: StepStart | None = None
    taut: bool = False
    path_is_geodesic: bool = False
    ends_before: Annotated[Array, 2, 3] | None = None
    blocked: tuple[int, ...] = ()
    lateral: LateralFrictionState | None = None
    axial: AxialFrictionState | None = None
    smoothing_length: float = 0.0
    hold: Hold = "outside"
    layer: int = 0
    joints: tuple[str | None, str | None] = (None, None)
    parts: ClampedParts | None = None
    bonds: Bonds | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
