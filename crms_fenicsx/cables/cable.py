"""A cable's data, and a cable that has been laid on a membrane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from crms_fenicsx import checks
from crms_fenicsx.cables.friction import Friction
from crms_fenicsx.cables.path import EdgePoint, Path, SurfacePoint, VertexPoint
from crms_fenicsx.errors import InputError

if TYPE_CHECKING:
    from crms_fenicsx.cables.axial import AxialGrip
    from crms_fenicsx.cables.grip import Grip

Array = npt.NDArray[np.float64]

LEAST, MOST = float(np.finfo(float).tiny), float(1.0 - np.finfo(float).epsneg)
"""Places on an edge of points that run into its ends."""

COINCIDENT = 1e-9
"""An anchor this near to the cable's next point, relative to its length, lies on it."""

NEARLY_TAUT = 2e-3
"""Strain by which a cable may be too long for its path and still count as taut at first."""


@dataclass(frozen=True)
class Cable:
    """A linearly elastic cable (section 2.2).

    Parameters
    ----------
    EA
        Axial stiffness (force).
    law
        "total": tension ``EA (L - L0)/L0`` where positive, L0 the unstressed length. "step": the
        paper's (2.2-2), tension that grows by ``EA/l_n`` times the elongation in the step, l_n
        the length at the step's start.
    friction
        Friction on the membrane: a coefficient, or a `Friction` that says more. With 0 there is
        none, and it costs nothing.
    """

    EA: float
    law: Literal["total", "step"] = "total"
    friction: float | Friction = 0.0

    def __post_init__(self) -> None:
        checks.positive("Cable: EA", self.EA)
        if not isinstance(self.friction, Friction):
            Friction(checks.finite("Cable: friction", self.friction))
        if self.law not in ("total", "step"):
            raise InputError(f"Cable: law = {self.law!r} is not known; use 'total' or 'step'.")
        if self.law == "step" and self.along:
            raise InputError(
                f'Cable: law = "step" has one tension for the whole cable, but its friction has '
                f'along = {self.along}; use law="total", or leave it out.'
            )

    @property
    def sideways(self) -> Friction | None:
        """Friction against sliding sideways; None if it slides freely."""
        friction = self.friction
        if not isinstance(friction, Friction):
            friction = Friction(friction)
        return friction if friction.at_rest > 0 else None

    @property
    def along(self) -> float:
        """Coefficient of friction along its axis."""
        return self.friction.along if isinstance(self.friction, Friction) else 0.0


End = Literal["tied", "held", "off"]
"""How a cable's end is held: tied to a place of the membrane, held at its place on a held part of
the membrane, or by an anchor off the membrane."""


@dataclass(eq=False)
class Crossing:
    """A place where two cables cross: one free point that both share.

    Attributes
    ----------
    lower, upper
        Numbers of the cables, the upper one on top.
    support
        Ids of the vertices of the cell (3) or edge (2) that it is in.
    links
        Where it is on the lower and on the upper cable: after which node, crossings not counted.
    place : (3,)
        Where they cross, or would (length).
    apart
        Whether the upper cable has lifted off the lower one; they share no point then.
    """

    lower: int
    upper: int
    support: tuple[int, ...]
    links: tuple[int, int]
    place: Array
    apart: bool = False


@dataclass(frozen=True)
class CableNode:
    """A point of a cable's polyline.

    Attributes
    ----------
    kind
        "vertex": a mesh vertex. "fold": slides freely on an edge, which folds there. "rail":
        slides freely along an edge that is held, and so stays straight. "rider": is tied to a
        place of the membrane. "anchor": held in space. "crossing": free, shared with another
        cable.
    point
        Its place on the mesh; None for an anchor.
    crossing
        The crossing that it belongs to; a fold point on an edge that another cable follows has one
        as well.
    """

    kind: Literal["vertex", "fold", "rail", "rider", "anchor", "crossing"]
    point: SurfacePoint | None = None
    crossing: Crossing | None = None

    @property
    def slides(self) -> bool:
        """Whether its place on its edge is an unknown."""
        return self.kind in ("fold", "rail")

    def masters(self, fraction: float | None = None) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Vertices (ids) and weights that give the place on the unfolded mesh."""
        point = self.point
        if isinstance(point, VertexPoint):
            return (point.vertex,), (1.0,)
        if isinstance(point, EdgePoint):
            s = point.fraction if fraction is None else fraction
            return point.edge, (1 - s, s)
        assert point is not None, "an anchor has no place on the mesh"
        return point.cell, point.weights


@dataclass(frozen=True)
class CableEnd:
    """An end of a laid cable, a key for movements: ``solver.advance(move={cable.start: v})``."""

    cable: LaidCable = field(repr=False)
    which: Literal["start", "end"]

    @property
    def reaction(self) -> Array:
        """Force (3,) with which the anchor holds the cable: its tension, along its end.

        Where the end lies on the held edge that it was laid to, the anchor carries it, and not
        the membrane's support.

        Raises
        ------
        InputError
            If the end is no anchor, but tied to the membrane.
        """
        cable = self.cable
        if cable.nodes[cable.node_of(self.which)].kind != "anchor":
            raise InputError(
                f"reaction: the {self.which} of {cable.name!r} is tied to the membrane, which is "
                "not held there, and so has no reaction; lay the cable to a held edge or an anchor."
            )
        points = cable.positions if self.which == "start" else cable.positions[::-1]
        outward = points[0] - points[1:]
        away = np.linalg.norm(outward, axis=1)
        first = int(np.argmax(away > COINCIDENT * cable.length))
        tension = cable.tensions[0 if self.which == "start" else -1]
        return np.asarray(tension * outward[first] / away[first])


@dataclass
class StepStart:
    """State of a cable with the step-wise law at the start of a step, (2.2-2, 3)."""

    tension: float
    length: float
    energy: float


@dataclass(eq=False)
class LaidCable:
    """A cable on its path over the membrane. Made by `Scene.lay_cable`.

    Attributes
    ----------
    name
        Name in tables and pictures.
    cable
        Its data.
    nodes
        Points of the polyline, anchors and crossings included.
    positions : (n, 3)
        Current positions of the nodes, on all ranks.
    fractions : (n,)
        Current places of fold points on their unfolded edges and of rails on their held ones,
        where one that is pulled beyond an end lies outside 0 ... 1; NaN for nodes off edges.
    lifted : (n,) bool
        Nodes at which the cable is off the membrane. They take no part: it passes them straight.
    material : (n, 3)
        Where the nodes are on the stress-free membrane: the cable's material curve. NaN where the
        cable is off the membrane.
    L0
        Unstressed length (length).
    length, tension
        Current length and tension (force). With friction along the cable this is the mean tension
        by unstressed length, ``EA (length - L0)/L0`` as without; see `tensions`.
    step_start
        State at the start of a step, where the cable has the step-wise law.
    taut
        Whether it has tension; the sliding points of a slack cable take no part.
    sleeve
        Whether a sleeve holds it to the membrane, so that it slides but cannot lift off.
    level
        Of two cables that cross the one with the higher level lies on top; of equal ones the one
        laid later.
    traced
        Whether its path has been pulled taut once: it has been in tension, free to slide.
    ends_before : (2, 3)
        Where its ends were in the last equilibrium; None before the first.
    blocked
        Nodes that have run into a mesh vertex.
    grip
        What friction holds it with sideways; None before its first load step, or without.
    axial
        What friction holds it with along its axis; None without.
    """

    name: str
    cable: Cable
    nodes: tuple[CableNode, ...]
    positions: Array
    fractions: Array
    lifted: npt.NDArray[np.bool_]
    L0: float
    length: float
    tension: float
    step_start: StepStart | None = None
    taut: bool = False
    sleeve: bool = False
    level: int = 0
    traced: bool = False
    ends_before: Array | None = None
    blocked: tuple[int, ...] = ()
    grip: Grip | None = None
    axial: AxialGrip | None = None

    def __post_init__(self) -> None:
        self.material = np.full_like(self.positions, np.nan)

    @property
    def slides_freely(self) -> bool:
        """Whether no friction holds it sideways."""
        return self.cable.sideways is None

    @property
    def has_coulomb(self) -> bool:
        """Whether friction with stick and slip holds it sideways."""
        friction = self.cable.sideways
        return friction is not None and friction.law == "coulomb"

    @property
    def tensions(self) -> Array:
        """Tensions of its parts between the nodes that it touches, in order (force)."""
        parts = int(np.count_nonzero(~self.lifted)) - 1
        if self.axial is not None and self.taut and len(self.axial.tensions) == parts:
            return self.axial.tensions
        return np.full(parts, self.tension)

    @property
    def start(self) -> CableEnd:
        """Its first end."""
        return CableEnd(self, "start")

    @property
    def end(self) -> CableEnd:
        """Its last end."""
        return CableEnd(self, "end")

    @property
    def path(self) -> Path:
        """Its way over the mesh as it is now; where it is lifted, over the cells under it."""
        points: list[SurfacePoint] = []
        for node, fraction in zip(self.nodes, self.fractions, strict=True):
            if node.slides and isinstance(node.point, EdgePoint):
                points.append(EdgePoint(node.point.edge, min(max(fraction, LEAST), MOST)))
            elif node.point is not None and node.kind != "crossing":
                points.append(node.point)
        first, last = (
            tuple(self.positions[k].tolist()) if self.nodes[k].kind == "anchor" else None
            for k in (0, -1)
        )
        return Path(tuple(points), start_anchor=first, end_anchor=last)

    def set_nodes(
        self,
        nodes: Sequence[CableNode],
        positions: Array,
        fractions: Array,
        lifted: npt.NDArray[np.bool_],
    ) -> None:
        """Replace the points of the polyline."""
        self.nodes, self.positions = tuple(nodes), positions
        self.fractions, self.lifted = fractions, lifted
        self.material = np.full_like(positions, np.nan)
        self.blocked = ()

    @property
    def ends(self) -> tuple[End, End]:
        """How its two ends are held; one that passes a fixed place counts as held there."""

        def end(anchor: int, beside: int) -> End:
            if self.nodes[anchor].kind != "anchor":
                return "tied"
            away = np.linalg.norm(self.positions[anchor] - self.positions[beside])
            held = self.nodes[beside].kind == "rider" or away <= COINCIDENT * self.length
            return "held" if held else "off"

        return end(0, 1), end(-1, -2)

    def masters(self, k: int) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Vertices (ids) and weights that give node k's place now; see `CableNode.masters`."""
        fraction = float(self.fractions[k])
        return self.nodes[k].masters(None if np.isnan(fraction) else fraction)

    def rim(self) -> list[int]:
        """Nodes of its way over the mesh, in order: no anchors, no crossings."""
        return [
            k
            for k, node in enumerate(self.nodes)
            if node.point is not None and node.kind != "crossing"
        ]

    def contacts(self) -> list[int]:
        """Nodes that the cable touches, its ends included, in order."""
        return [k for k, lifted in enumerate(self.lifted) if not lifted]

    def is_tight(self, new: bool) -> bool:
        """Whether it is short enough for the way on which it lies to be in tension.

        A new cable is where it is nearly so: a membrane that is inflated without its cables goes
        far beyond the equilibrium with them, and then it is a long way back.
        """
        length = polyline_length(self.positions[self.contacts()])
        too_long = NEARLY_TAUT if new else -1e-12
        return self.cable.law == "step" or length > self.L0 * (1 - too_long)

    def node_of(self, which: Literal["start", "end"]) -> int:
        """Index of an end among the nodes."""
        return 0 if which == "start" else len(self.nodes) - 1

    def __repr__(self) -> str:
        state = f"tension {self.tension:.6g}" if self.taut else "slack"
        return f"LaidCable({self.name!r}, {len(self.nodes)} points, {state})"


def polyline_length(positions: Array) -> float:
    """Length of a polyline (n, 3)."""
    return float(np.sum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
