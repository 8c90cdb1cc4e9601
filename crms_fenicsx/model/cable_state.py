"""State of a laid cable, changed by load steps: path, tension, friction history."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.foundation.surface.points import EdgePoint, SurfacePoint
from crms_fenicsx.model.cable import Bonds, Cable, ClampedParts, Hold
from crms_fenicsx.model.friction import AxialFrictionState, LateralFrictionState


@dataclass(frozen=True, eq=False)
class Crossing:
    """A crossing of two cables: one free point that both share, identified by its number; at a
    vertex of both only where both are lifted."""

    lower: int  # number of the lower cable
    upper: int  # number of the upper cable
    # ids of the vertices of the cell (3) or edge (2) that it lies in, or of its vertex (1)
    support: tuple[int, ...]
    links: tuple[int, int]  # preceding node of each cable, or that there; crossings not counted
    place: Annotated[Array, 3]  # (3,) where they cross, or would (length)
    between: tuple[tuple[int, ...], ...]  # supports of the ends of the links, the lower one first
    separated: bool = False  # whether the upper cable has lifted off: no shared point
    clamped: bool = False  # whether a clamp joins them


NodeId = tuple[int, int]
"""A node of a cable: number of the cable, number of the node."""


End = Literal["tied", "held", "off"]
"""Support of a cable's end: tied to a point of the membrane, held at a point of a held part of the
membrane, or held by an anchor off the membrane."""


@dataclass(frozen=True)
class CableNode:
    """A point of a cable's polyline."""

    # "vertex": at a mesh vertex. "fold": slides freely on an edge, which folds there. "edge
    # slider": slides freely along a held edge, which stays straight. "tied": tied to a point of the
    # membrane. "anchor": held in space. "crossing": free, shared with another cable.
    kind: Literal["vertex", "fold", "edge slider", "tied", "anchor", "crossing"]
    point: SurfacePoint | None = None  # its point on the mesh; None for an anchor
    crossing: int | None = None  # also set for a fold point on an edge that another cable follows

    @property
    def slides(self) -> bool:
        """Whether its position on its edge is an unknown."""
        return self.kind in ("fold", "edge slider")

    @property
    def support(self) -> tuple[int, ...]:
        """Ids of the vertices of the mesh entity it lies on; not for anchors."""
        assert self.point is not None, "an anchor has no place on the mesh"
        return self.point.support

    @property
    def touches_cable(self) -> bool:
        """Whether another cable crosses over or under it."""
        return self.kind == "crossing" or self.crossing is not None

    def interpolation(
        self, fraction: float | None = None
    ) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Vertex ids and weights that interpolate its position on the unfolded mesh."""
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
class LaidAs:
    """How a cable was laid, which load steps do not change."""

    hold: Hold = "outside"  # its attachment to the membrane
    layer: int = 0  # of two crossing cables the one with the higher layer lies on top
    joints: tuple[str | None, str | None] = (None, None)  # to which its ends are fixed, by name
    bonds: Bonds | None = None  # to the fabric
    # group of edges along which it lies, from vertex to vertex, and which slides with it
    line: str | None = None


@dataclass(frozen=True)
class CableLaw:
    """A cable's stiffness, lengths, tension and friction.

    Attributes: `taut`: whether it has tension, as sliding points of a slack cable are not solved
    for; `step_start`: start of the load step, with the step-wise law; `smoothing_length`: excess of
    the smoothed lengths of its segments over their true lengths in the last equilibrium; `parts`:
    its parts between clamps and bonds; `lateral`, `axial`: friction sideways, None before the first
    load step, and along it.
    """

    cable: Cable
    L0: float
    length: float
    tension: float
    taut: bool = False
    step_start: StepStart | None = None
    smoothing_length: float = 0.0
    parts: ClampedParts | None = None
    lateral: LateralFrictionState | None = None
    axial: AxialFrictionState | None = None


@dataclass(frozen=True)
class SearchMemory:
    """What searches of an equilibrium remember of a cable from one load step to the next."""

    # whether its path has been straightened once, under tension and free to slide
    path_is_geodesic: bool = False
    ends_before: Annotated[Array, 2, 3] | None = None  # places of its ends in the last equilibrium

    def __post_init__(self) -> None:
        if self.ends_before is not None:
            self.ends_before.flags.writeable = False


@dataclass(frozen=True)
class CableState:
    """State of a laid cable: its path, its law, how it was laid, and what searches remember.
    Checkpoints are checked against the shapes in the type hints.

    Attributes: `nodes`: points of its path over the mesh, with anchors and crossings, also where it
    spans straight above the membrane; `positions`: where they are, on all ranks; `fractions`: of
    fold points on their unfolded edges, and of edge sliders on their held edges, outside 0 ... 1 if
    pulled beyond an end, NaN for other nodes; `lifted`: nodes that the cable passes off the
    membrane, in a straight line; `reference_positions`: of the nodes on the stress-free membrane,
    the cable's material curve, NaN where it is off the membrane; `row`: of the vertices of its line
    when the mesh last followed them, with the surface's normals there, which give the directions in
    which these shift since; None before they first did.
    """

    nodes: Annotated[tuple[CableNode, ...], "n"]
    positions: Annotated[Array, "n", 3]
    fractions: Annotated[Array, "n"]
    lifted: Annotated[Booleans, "n"]
    reference_positions: Annotated[Array, "n", 3]
    law: CableLaw
    laid: LaidAs = LaidAs()
    memory: SearchMemory = SearchMemory()
    row: Annotated[Array, "v", 2, 3] | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
