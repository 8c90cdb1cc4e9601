"""A cable's data, and a cable that has been laid on a membrane."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from crms_fenicsx import checks
from crms_fenicsx.cables.friction import Friction
from crms_fenicsx.cables.path import EdgePoint, Path, SurfacePoint, VertexPoint
from crms_fenicsx.errors import InputError
from crms_fenicsx.readonly import ReadOnly

if TYPE_CHECKING:
    from crms_fenicsx.cables.axial import AxialGrip
    from crms_fenicsx.cables.grip import Grip

Array = npt.NDArray[np.float64]

LEAST, MOST = float(np.finfo(float).tiny), float(1.0 - np.finfo(float).epsneg)
"""Places on an edge of points that run into its ends."""

COINCIDENT = 1e-9
"""An anchor this near to the cable's next point, relative to its length, lies on it."""

FOUND = "it follows from the loads, call solver.advance(...)"
RELAY = "lay another cable with scene.lay_cable(...) instead"
"""What to do instead of assigning attributes of laid cables."""

NEARLY_TAUT = 2e-3
"""Strain by which a cable may be too long for its path and still count as taut at first."""
BULGE, MOST_BULGE = 1.2, 0.02
"""The same, where folds bulge: relative to the square of the mean turn (rad) at nodes, and at most.
On cells of 9 a side cables keep some tension up to 1.0."""


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
    between
        Ids of the vertices on which the ends of these links lie, or between which: first those of
        the lower cable's link.
    apart
        Whether the upper cable has lifted off the lower one; they share no point then.
    """

    lower: int
    upper: int
    support: tuple[int, ...]
    links: tuple[int, int]
    place: Array
    between: tuple[tuple[int, ...], ...]
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

    @property
    def support(self) -> tuple[int, ...]:
        """Ids of the vertices on which it lies, or between which; it is no anchor."""
        assert self.point is not None, "an anchor has no place on the mesh"
        return self.point.support

    @property
    def touches_cable(self) -> bool:
        """Whether another cable lies over or under it."""
        return self.kind == "crossing" or self.crossing is not None

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

    cable: LaidCable
    which: Literal["start", "end"]

    def __repr__(self) -> str:
        return f"<{self.which} of {self.cable!r}>"

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
        tension = cable.part_tensions[0 if self.which == "start" else -1]
        return np.asarray(tension * outward[first] / away[first])


@dataclass
class StepStart:
    """State of a cable with the step-wise law at the start of a step, (2.2-2, 3)."""

    tension: float
    length: float
    energy: float


@dataclass
class CableState:
    """What changes of a laid cable; see the attributes of `LaidCable`."""

    nodes: tuple[CableNode, ...]
    positions: Array
    fractions: Array
    lifted: npt.NDArray[np.bool_]
    L0: float
    length: float
    tension: float
    step_start: StepStart | None = None
    taut: bool = False
    traced: bool = False
    ends_before: Array | None = None
    blocked: tuple[int, ...] = ()
    grip: Grip | None = None
    axial: AxialGrip | None = None
    excess: float = 0.0
    material: Array = field(init=False)

    def __post_init__(self) -> None:
        self.material = np.full_like(self.positions, np.nan)

    def copy(self) -> CableState:
        """A state that stays as it is when this one changes."""
        new = copy.copy(self)
        for name in ("positions", "fractions", "lifted", "material", "step_start"):
            setattr(new, name, copy.copy(getattr(self, name)))
        return new


class LaidCable:
    """A cable on its path over the membrane. Made by `Scene.lay_cable`, and read-only.

    Parameters
    ----------
    name, cable, sleeve, level
        As the attributes.
    state
        What changes of it; the package writes it, and users read its parts as attributes.

    Attributes
    ----------
    name
        Name in tables and pictures.
    cable
        Its data.
    nodes
        Internal: points of its way over the mesh, anchors and crossings included, also those that
        it passes straight above. Its own line is `line`.
    positions : (n, 3)
        Internal: current positions of the nodes, on all ranks; those of lifted ones mark the way.
    fractions : (n,)
        Internal: current places of fold points on their unfolded edges and of rails on their held
        ones, where one that is pulled beyond an end lies outside 0 ... 1; NaN for nodes off edges.
    lifted : (n,) bool
        Internal: nodes at which the cable is off the membrane. They take no part: it passes them
        straight.
    material : (n, 3)
        Where the nodes are on the stress-free membrane: the cable's material curve. NaN where the
        cable is off the membrane.
    L0
        Unstressed length (length).
    length, tension
        Current length, that of `line`, and tension (force), ``EA (length - L0)/L0`` where the cable
        has the total law and is in tension. With friction along the cable this is the mean tension
        by unstressed length; see `tensions`.
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
    excess
        Internal: by how much the smoothed lengths of its segments were longer than these in the
        last equilibrium (length).
    """

    name: ReadOnly[str] = ReadOnly("_name", "scene.lay_cable(..., name=...) gives a name")
    cable: ReadOnly[Cable] = ReadOnly("_cable", RELAY)
    sleeve: ReadOnly[bool] = ReadOnly("_sleeve", RELAY)
    level: ReadOnly[int] = ReadOnly("_level", RELAY)
    L0: ReadOnly[float] = ReadOnly("state.L0", "call solver.advance(L0={cable: length})")
    nodes: ReadOnly[tuple[CableNode, ...]] = ReadOnly("state.nodes", FOUND)
    positions: ReadOnly[Array] = ReadOnly("state.positions", FOUND)
    fractions: ReadOnly[Array] = ReadOnly("state.fractions", FOUND)
    lifted: ReadOnly[npt.NDArray[np.bool_]] = ReadOnly("state.lifted", FOUND)
    material: ReadOnly[Array] = ReadOnly("state.material", FOUND)
    length: ReadOnly[float] = ReadOnly("state.length", FOUND)
    tension: ReadOnly[float] = ReadOnly("state.tension", FOUND)
    step_start: ReadOnly[StepStart | None] = ReadOnly("state.step_start", FOUND)
    taut: ReadOnly[bool] = ReadOnly("state.taut", FOUND)
    traced: ReadOnly[bool] = ReadOnly("state.traced", FOUND)
    ends_before: ReadOnly[Array | None] = ReadOnly("state.ends_before", FOUND)
    blocked: ReadOnly[tuple[int, ...]] = ReadOnly("state.blocked", FOUND)
    grip: ReadOnly[Grip | None] = ReadOnly("state.grip", FOUND)
    axial: ReadOnly[AxialGrip | None] = ReadOnly("state.axial", FOUND)
    excess: ReadOnly[float] = ReadOnly("state.excess", FOUND)

    def __init__(
        self, name: str, cable: Cable, state: CableState, sleeve: bool = False, level: int = 0
    ) -> None:
        self._name, self._cable, self.state = name, cable, state
        self._sleeve, self._level = sleeve, level

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
    def dissipated(self) -> float:
        """Energy that its friction has dissipated (force x length)."""
        return sum(grip.dissipated for grip in (self.grip, self.axial) if grip is not None)

    @property
    def line(self) -> Array:
        """Its polyline in space, from end to end, as (n, 3) positions on all ranks (length).

        `length` is its length. As a path of `Scene.lay_cable` it gives a cable that lies the same.
        """
        return np.asarray(self.positions[self.line_nodes()])

    @property
    def free_spans(self) -> npt.NDArray[np.bool_]:
        """Which of the n - 1 parts of its `line` are off the membrane."""
        nodes = self.line_nodes()
        anchors = [self.nodes[k].kind == "anchor" for k in nodes]
        return (np.diff(nodes) > 1) | np.logical_or(anchors[1:], anchors[:-1])

    @property
    def tensions(self) -> Array:
        """Tensions of the n - 1 parts of its `line` (force)."""
        first = int(self.line_nodes()[0] != 0)
        return self.part_tensions[first:][: len(self.line_nodes()) - 1]

    @property
    def part_tensions(self) -> Array:
        """Internal: tensions of its parts between `contacts`, in order (force)."""
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
        points = [self.point(k) for k in self.rim()]
        first, last = (
            tuple(self.positions[k].tolist()) if self.nodes[k].kind == "anchor" else None
            for k in (0, -1)
        )
        return Path(tuple(points), start_anchor=first, end_anchor=last)

    def point(self, k: int) -> SurfacePoint:
        """Place of node k on the mesh as it is now; it is no anchor."""
        point = self.nodes[k].point
        assert point is not None
        if self.nodes[k].slides and isinstance(point, EdgePoint):
            return EdgePoint(point.edge, min(max(float(self.fractions[k]), LEAST), MOST))
        return point

    def set_nodes(
        self,
        nodes: Sequence[CableNode],
        positions: Array,
        fractions: Array,
        lifted: npt.NDArray[np.bool_],
    ) -> None:
        """Replace the points of the polyline."""
        state = self.state
        state.nodes, state.positions = tuple(nodes), positions
        state.fractions, state.lifted = fractions, lifted
        state.material, state.blocked = np.full_like(positions, np.nan), ()

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

    def line_nodes(self) -> list[int]:
        """Nodes of its line: its contacts, but an anchor that lies on the next one only once."""
        nodes = self.contacts()
        for at, beside in ((0, 1), (-1, -2)):
            away = np.linalg.norm(self.positions[nodes[at]] - self.positions[nodes[beside]])
            if len(nodes) > 2 and away <= COINCIDENT * self.length:
                del nodes[at]
        return nodes

    def is_tight(self, nearly: bool) -> bool:
        """Whether it is short enough for the way on which it lies to be in tension.

        Parameters
        ----------
        nearly
            Whether to count it as in tension where it may be once it has folded the membrane: the
            folds bulge out to a longer way. A new cable is where it is nearly so, too: a membrane
            that is inflated without its cables goes far beyond the equilibrium with them, and
            then it is a long way back.
        """
        steps = np.diff(self.positions[self.contacts()], axis=0)
        sizes = np.linalg.norm(steps, axis=1)
        too_long = -1e-12
        if nearly:
            apart = sizes > COINCIDENT * sizes.sum()
            ways = steps[apart] / sizes[apart, None]
            # Over some nodes: from one to the next small and large turns, left and right alternate.
            some = min(4, len(ways) - 1)
            turns = np.linalg.norm(ways[some:] - ways[:-some], axis=1) / some if some else [0.0]
            bulge = BULGE * float(np.median(turns)) ** 2
            too_long = max(NEARLY_TAUT, min(bulge, MOST_BULGE))
        return self.cable.law == "step" or float(sizes.sum()) > self.L0 * (1 - too_long)

    def node_of(self, which: Literal["start", "end"]) -> int:
        """Index of an end among the nodes."""
        return 0 if which == "start" else len(self.nodes) - 1

    def __repr__(self) -> str:
        state = f"tension {self.tension:.6g}" if self.taut else "slack"
        return f"LaidCable({self.name!r}, {len(self.nodes)} points, {state})"


def polyline_length(positions: Array) -> float:
    """Length of a polyline (n, 3)."""
    return float(np.sum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
