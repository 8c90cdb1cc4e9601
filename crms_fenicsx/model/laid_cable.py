"""A cable laid on a membrane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, flags, floats, ints
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.runtime.handle import Handle, ReadOnly
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.foundation.surface.points import LEAST, MOST, EdgePoint, SurfacePoint
from crms_fenicsx.model.cable import HOLDS, Cable, Hold
from crms_fenicsx.model.cable_state import CableNode, CableState, End
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL, UNSTRAINED

FOUND = "it follows from the loads; call solver.advance(...)"
RELAY = "lay another cable with scene.lay_cable(...) instead"
"""Remedy for assignments to attributes of laid cables."""


@dataclass(frozen=True)
class CableEnd:
    """An end of a laid cable, a key for movements: ``solver.advance(move={cable.start: v})``."""

    cable: LaidCable
    which: Literal["start", "end"]

    def __repr__(self) -> str:
        return f"<{self.which} of {self.cable!r}>"

    @property
    def reaction(self) -> Array:
        """Force (3,) of the anchor on the cable: its tension, along its end (force).

        At a held edge the anchor of the cable carries this force, not the membrane's support.
        """
        cable = self.cable
        if cable.state.nodes[cable.node_of(self.which)].kind != "anchor":
            raise InputError(
                f"reaction: the {self.which} of {cable.name!r} is tied to the membrane, which is "
                "not held there, and so has no reaction; lay the cable to a held edge or an anchor."
            )
        points = cable.state.positions if self.which == "start" else cable.state.positions[::-1]
        outward = points[0] - points[1:]
        away = np.linalg.norm(outward, axis=1)
        first = int(np.argmax(away > SAME_PLACE * cable.length))
        tension = cable.part_tensions[0 if self.which == "start" else -1]
        return np.asarray(tension * outward[first] / away[first])


class LaidCable(Handle[CableState]):
    """A cable on its path over the membrane. Made by `Scene.lay_cable`, and read-only.

    Attributes
    ----------
    name
        Name in tables and pictures.
    cable
        Its stiffness, law and friction.
    L0
        Unstressed length at the present temperature (length).
    reference_positions : (n, 3)
        Positions of its points on the stress-free membrane: the cable's material curve (length).
        NaN where the cable is off the membrane.
    length, tension
        Current length, that of `line`, and tension (force): ``EA (length - L0)/L0`` for a taut
        cable with the total law. With friction along the cable, the mean tension by unstressed
        length; see `tensions`.
    taut
        Whether it has tension; sliding points of a slack cable are not solved for.
    hold
        Attachment to the membrane: "outside", "sleeve", "pocket" or "bonded"; see
        `Scene.lay_cable`.
    layer
        Of two crossing cables the one with the higher layer lies on top; with equal layers, the one
        laid later.

    Examples
    --------
    >>> round(ridge.tension, 2), round(ridge.length - ridge.L0, 3)
    (5.02, 0.02)
    >>> ridge.line[0]
    array([0., 2., 0.])
    """

    cable: ReadOnly[Cable] = ReadOnly(
        "state.law.cable", "call scene.set_stiffness(...) or lay another one"
    )
    hold: ReadOnly[Hold] = ReadOnly("state.laid.hold", RELAY)
    layer: ReadOnly[int] = ReadOnly("state.laid.layer", RELAY)
    L0: ReadOnly[float] = ReadOnly("state.law.L0", "call solver.advance(L0={cable: length})")
    reference_positions: ReadOnly[Array] = ReadOnly("state.reference_positions", FOUND)
    length: ReadOnly[float] = ReadOnly("state.law.length", FOUND)
    tension: ReadOnly[float] = ReadOnly("state.law.tension", FOUND)
    taut: ReadOnly[bool] = ReadOnly("state.law.taut", FOUND)

    def update(self, **changes: Any) -> None:
        """Replace fields of the state or of its parts, by name; internal to the package."""
        for part in ("law", "laid", "memory"):
            old = getattr(self.state, part)
            if own := {name: changes.pop(name) for name in vars(old).keys() & changes.keys()}:
                changes[part] = replace(old, **own)
        super().update(**changes)

    @property
    def lifts_off(self) -> bool:
        """Whether it may lift off the membrane."""
        return HOLDS[self.hold].lifts

    @property
    def keeps_line(self) -> bool:
        """Whether it always crosses the same edges: it stays on its line on the fabric, or lies
        along a line of the mesh, with which it may slide."""
        return not HOLDS[self.hold].sideways or self.state.laid.line is not None

    @property
    def takes_line(self) -> bool:
        """Whether it lies along a line of the mesh and may slide sideways with it."""
        return HOLDS[self.hold].sideways and self.state.laid.line is not None

    @property
    def folds_cells(self) -> bool:
        """Whether it crosses edges, and does not only run along them."""
        return any(node.kind == "fold" for node in self.state.nodes)

    @property
    def slides_freely(self) -> bool:
        """Whether it slides sideways without friction."""
        return self.cable.sideways is None

    @property
    def has_coulomb(self) -> bool:
        """Whether it has sideways friction with stick and slip."""
        friction = self.cable.sideways
        return friction is not None and friction.law == "coulomb"

    @property
    def blocked(self) -> list[int]:
        """Its sliding nodes that have run into a vertex of the mesh."""
        if not self.taut:
            return []
        fractions, nodes = self.state.fractions, self.state.nodes
        close = ((fractions < TOL.smoothing) | (fractions > 1 - TOL.smoothing)) & ~self.state.lifted
        return [k for k in ints(np.flatnonzero(close)) if nodes[k].slides]

    @property
    def dissipated(self) -> float:
        """Energy dissipated by friction and by slip through clamps (force x length)."""
        grips = (self.state.law.lateral, self.state.law.axial, self.state.law.parts)
        return sum(grip.dissipated for grip in grips if grip is not None)

    @property
    def line(self) -> Array:
        """Its polyline in space, from end to end, as (n, 3) positions on all ranks (length).

        Its length is `length`. As a path of `Scene.lay_cable`, it gives a cable on the same line.
        """
        return np.asarray(self.state.positions[self.line_nodes()])

    @property
    def free_spans(self) -> Booleans:
        """Which of the n - 1 segments of its `line` are off the membrane."""
        nodes = self.line_nodes()
        points = [self.state.nodes[k] for k in nodes]
        off = [
            one.kind == "anchor" or (one.kind == "crossing" and len(one.support) == 1)
            for one in points
        ]
        return (np.diff(nodes) > 1) | np.logical_or(off[1:], off[:-1])

    @property
    def tensions(self) -> Array:
        """Tensions of the n - 1 segments of its `line` (force)."""
        first = int(self.line_nodes()[0] != 0)
        return self.part_tensions[first:][: len(self.line_nodes()) - 1]

    @property
    def part_tensions(self) -> Array:
        """Tensions between consecutive `contacts` (force)."""
        law, parts = self.state.law, int(np.count_nonzero(~self.state.lifted)) - 1
        if self.taut and law.axial is not None and len(law.axial.tensions) == parts:
            return law.axial.tensions
        if self.taut and law.parts is not None and self.clamped:
            return np.asarray(law.parts.tensions[self.parts_of(self.contacts()[:-1])])
        return np.full(parts, self.tension)

    def parts_of(self, nodes: Sequence[int]) -> Integers:
        """Numbers of the parts between clamps that begin at or contain the nodes."""
        return np.searchsorted(np.array(self.clamped, dtype=np.int64), nodes, side="right")

    @property
    def clamped(self) -> tuple[int, ...]:
        """Its nodes at clamps and bonds, between which its tensions may differ."""
        return () if self.state.law.parts is None else self.state.law.parts.nodes

    @property
    def is_divided(self) -> bool:
        """Whether friction or clamps let its tension vary along it."""
        return self.state.law.axial is not None or self.state.law.parts is not None

    @property
    def may_slip(self) -> bool:
        """Whether it can slip through a clamp."""
        return self.state.law.parts is not None and bool(self.state.law.parts.grips.any())

    @property
    def at_clamps(self) -> Array:
        """1 at the points of its `line` held by clamps, 0 elsewhere."""
        bonds = () if self.state.laid.bonds is None else self.state.laid.bonds.supports
        nodes = [k for k in self.clamped if self.state.nodes[k].support not in bonds]
        return np.isin(self.line_nodes(), nodes).astype(float)

    @property
    def part_lengths(self) -> Array:
        """Unstressed lengths of its parts between clamps, or its own (length)."""
        parts = self.state.law.parts
        if parts is None:
            return np.array([self.L0])
        return np.diff([0.0, *(self.L0 * parts.at + parts.slips), self.L0])

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
        """Its current path over the mesh; where it is lifted, over the cells below it."""
        points = self.points(self.path_nodes())
        first, last = (
            tuple(self.state.positions[k].tolist())
            if self.state.nodes[k].kind == "anchor"
            else None
            for k in (0, -1)
        )
        return Path(tuple(points), start_anchor=first, end_anchor=last)

    def point(self, k: int) -> SurfacePoint:
        """Current point of node k on the mesh; not for anchors."""
        return self.points([k])[0]

    def points(self, nodes: Sequence[int]) -> list[SurfacePoint]:
        """Current points of nodes on the mesh; not for anchors."""
        found: list[SurfacePoint] = []
        all_nodes, fractions = self.state.nodes, floats(self.state.fractions)
        for k in nodes:
            point = all_nodes[k].point
            assert point is not None
            if isinstance(point, EdgePoint) and all_nodes[k].slides:
                point = EdgePoint(point.edge, min(max(fractions[k], LEAST), MOST))
            found.append(point)
        return found

    def set_nodes(
        self, nodes: Sequence[CableNode], positions: Array, fractions: Array, lifted: Booleans
    ) -> None:
        """Replace the nodes of the polyline."""
        self.update(
            nodes=tuple(nodes), positions=positions, fractions=fractions, lifted=lifted,
            reference_positions=np.full_like(positions, np.nan),
            parts=None if self.state.law.parts is None else replace(self.state.law.parts, nodes=()),
        )  # fmt: skip

    @property
    def ends(self) -> tuple[End, End]:
        """Supports of its two ends; an anchor next to a tied or coinciding node counts as held."""

        def end(anchor: int, beside: int) -> End:
            if self.state.nodes[anchor].kind != "anchor":
                return "tied"
            away = np.linalg.norm(self.state.positions[anchor] - self.state.positions[beside])
            held = self.state.nodes[beside].kind == "tied" or away <= SAME_PLACE * self.length
            return "held" if held else "off"

        return end(0, 1), end(-1, -2)

    def interpolation(self, k: int) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Vertex ids and weights that give node k's position; see `CableNode.interpolation`."""
        fraction = float(self.state.fractions[k])
        return self.state.nodes[k].interpolation(None if np.isnan(fraction) else fraction)

    def path_nodes(self) -> list[int]:
        """Nodes of its `path` over the mesh, in order: no anchors, no crossings."""
        off = ("anchor", "crossing")
        return [k for k, node in enumerate(self.state.nodes) if node.kind not in off]

    def contacts(self) -> list[int]:
        """Nodes where the cable is not lifted, ends included, in order."""
        return [k for k, lifted in enumerate(flags(self.state.lifted)) if not lifted]

    def line_nodes(self) -> list[int]:
        """Nodes of its line: its contacts, without an anchor that coincides with the next one."""
        nodes = self.contacts()
        for at, beside in ((0, 1), (-1, -2)):
            away = np.linalg.norm(
                self.state.positions[nodes[at]] - self.state.positions[nodes[beside]]
            )
            if len(nodes) > 2 and away <= SAME_PLACE * self.length:
                del nodes[at]
        return nodes

    def is_tight(self, nearly: bool) -> bool:
        """Whether it is short enough to be taut, or `nearly`, as folds bulge."""
        steps = np.diff(self.state.positions[self.contacts()], axis=0)
        sizes = np.linalg.norm(steps, axis=1)
        too_long = -UNSTRAINED
        if nearly:
            apart = sizes > SAME_PLACE * sizes.sum()
            ways = steps[apart] / sizes[apart, None]
            # Folds bulge and lengthen the path. Turns are averaged over some nodes, as those from
            # node to node alternate between small and large, left and right.
            some = min(4, len(ways) - 1)
            turns = np.linalg.norm(ways[some:] - ways[:-some], axis=1) / some if some else [0.0]
            bulge = TOL.bulge * float(np.median(turns)) ** 2
            too_long = max(TOL.nearly_taut, min(bulge, TOL.most_bulge))
        part = self.parts_of(self.contacts()[:-1])
        lengths = np.bincount(part, sizes, len(self.part_lengths))
        return self.cable.law == "step" or bool(
            np.any(lengths > self.part_lengths * (1 - too_long))
        )

    def node_of(self, which: Literal["start", "end"]) -> int:
        """Index of an end among the nodes."""
        return 0 if which == "start" else len(self.state.nodes) - 1

    def __repr__(self) -> str:
        state = f"tension {self.tension:.6g}" if self.taut else "slack"
        return f"LaidCable({self.name!r}, {len(self.state.nodes)} points, {state})"


def polyline_length(positions: Array) -> float:
    """Length of a polyline (n, 3)."""
    return float(np.sum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
