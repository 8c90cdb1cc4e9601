"""The cables on a membrane: their crossings, and the strip of cells that all ranks know of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy.typing as npt

from crms_fenicsx.cables.crossings import arrange
from crms_fenicsx.cables.points_on_edges import NodeTable
from crms_fenicsx.cables.strip import EMPTY, Strip, StripShape, cells_at, grown
from crms_fenicsx.model.cable_state import CableState, Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError


@dataclass(frozen=True)
class CableNetState:
    """What can change of the cables of a membrane; see the attributes of `CableNet`."""

    cables: Mapping[LaidCable, CableState]
    strip: Strip | None
    crossings: tuple[Crossing, ...]
    arranged: tuple[LaidCable, ...]
    laid: int
    removed_dissipation: float


class CableNet:
    """The laid cables of a membrane, the same on all ranks."""

    def __init__(self, membrane: Membrane) -> None:
        self.membrane = membrane
        self.cables: tuple[LaidCable, ...] = ()  # in the order of laying
        self.strip: Strip | None = None  # cells around their paths; None before the first is laid
        self.crossings: tuple[Crossing, ...] = ()  # of cables in tension
        self.arranged: tuple[LaidCable, ...] = ()  # the cables whose crossings were arranged
        self.laid = 0  # how many cables have been laid, those since removed included
        self.removed_dissipation = 0.0  # by friction of removed cables (force x length)
        self._nodes: NodeTable | None = None

    @property
    def nodes(self) -> NodeTable:
        """All nodes; what has not changed since the last time is kept."""
        self._nodes = NodeTable.of(self.cables, self._nodes)
        return self._nodes

    @property
    def state(self) -> CableNetState:
        """What can change of them."""
        cables = {cable: cable.state for cable in self.cables}
        return CableNetState(
            cables, self.strip, self.crossings, self.arranged, self.laid, self.removed_dissipation
        )

    @state.setter
    def state(self, state: CableNetState) -> None:
        if self.cables != tuple(state.cables):
            self.cables, self.strip = tuple(state.cables), state.strip
        # Else the strip has grown at most: what it knows more than it did holds as well.
        for cable, was in state.cables.items():
            cable.state = was
        self.crossings, self.arranged = state.crossings, state.arranged
        self.laid, self.removed_dissipation = state.laid, state.removed_dissipation

    @property
    def dissipated(self) -> float:
        """Energy that friction has dissipated in all load steps (force x length)."""
        return self.removed_dissipation + sum(cable.dissipated for cable in self.cables)

    @property
    def has_friction(self) -> bool:
        """Whether friction holds some cable sideways."""
        return not all(cable.slides_freely for cable in self.cables)

    def cable(self, name: str) -> LaidCable:
        """The cable with a name."""
        return checks.named("cable", {cable.name: cable for cable in self.cables}, name)

    def strip_shape(self) -> StripShape:
        """Gather the current positions of the strip's vertices. Collective."""
        assert self.strip is not None
        return StripShape.of(self.membrane, self.strip)

    def grow_strip(self, vertices: npt.ArrayLike, rings: int = 1) -> None:
        """Add the cells around some vertices to the strip. Collective."""
        self.strip = grown(self.membrane, self.strip or EMPTY, vertices, rings)

    def arrange_crossings(self) -> None:
        """Find the crossings of the cables in tension, and insert their points into the cables."""
        self.arranged, known = self.cables, self.crossings
        self.crossings = ()
        if self.strip is not None:
            self.crossings, self._nodes = arrange(self.nodes, self.cables, self.strip, known)

    def add(self, cable: LaidCable, strip: Strip) -> None:
        """Add a cable that has been laid over the cells of `strip`."""
        self.strip = strip if self.strip is None else self.strip.merged(strip)
        self.cables = (*self.cables, cable)
        self.laid += 1

    def remove(self, cable: LaidCable | str) -> None:
        """Take a cable away, and the crossings of others with it. Collective."""
        gone = self.cable(cable) if isinstance(cable, str) else cable
        if not isinstance(gone, LaidCable) or gone not in self.cables:
            raise InputError(
                f"remove: {gone!r} is not a cable of this scene; give one of scene.cables, or its "
                "name."
            )
        number = self.cables.index(gone)

        def renumbered(c: int) -> int:
            return -1 if c == number else c - (c > number)  # -1: of a cable that is gone

        self.crossings = tuple(  # the nodes refer to them by number until they are arranged anew
            replace(k, lower=renumbered(k.lower), upper=renumbered(k.upper)) for k in self.crossings
        )
        self.removed_dissipation += gone.dissipated
        self.cables = tuple(own for own in self.cables if own is not gone)
        points = (node.point for own in self.cables for node in own.nodes)
        vertices = [vertex for point in points if point is not None for vertex in point.support]
        self.strip = cells_at(self.membrane, vertices) if vertices else None
        self.arrange_crossings()
