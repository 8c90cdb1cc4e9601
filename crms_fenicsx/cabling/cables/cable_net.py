"""The cables on a membrane, their crossings, and the strip of cells around them on all ranks."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt
from dolfinx import fem, la
from mpi4py import MPI

from crms_fenicsx.cabling.cables.clamping import divide, meetings, named
from crms_fenicsx.cabling.cables.crossings import arrange
from crms_fenicsx.cabling.cables.points_on_edges import NodeTable
from crms_fenicsx.cabling.cables.strip import EMPTY, Strip, StripShape, cells_at, grown
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.foundation.runtime.checks import counted
from crms_fenicsx.foundation.runtime.errors import InputError, NetWarning, as_text
from crms_fenicsx.model.cable import HOLDS, Clamp
from crms_fenicsx.model.cable_state import CableState, Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import COMPONENTS, Marker, Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL


@dataclass(frozen=True)
class CableNetState:
    """Variable state of a membrane's cables; see the attributes of `CableNet`."""

    cables: Mapping[LaidCable, CableState]
    strip: Strip | None
    crossings: tuple[Crossing, ...]
    arranged: tuple[LaidCable, ...]
    laid: int
    removed_dissipation: float
    clamps: tuple[Clamp, ...]


class CableNet:
    """The laid cables of a membrane, the same on all ranks."""

    def __init__(self, membrane: Membrane) -> None:
        self.membrane = membrane
        self.cables: tuple[LaidCable, ...] = ()  # in the order of laying
        self.strip: Strip | None = None  # cells around their paths; None without cables
        self.crossings: tuple[Crossing, ...] = ()  # of cables in tension
        self.arranged: tuple[LaidCable, ...] = ()  # the cables whose crossings were arranged
        self.laid = 0  # number of cables laid so far, including removed ones
        self.clamps: tuple[Clamp, ...] = ()  # between pairs of cables
        self.removed_dissipation = 0.0  # by friction of removed cables (force x length)
        self._nodes: NodeTable | None = None
        # the last, with the displacements and the placement of stress-free vertices there
        self._shape: tuple[StripShape, Array, int] | None = None

    @property
    def nodes(self) -> NodeTable:
        """All nodes; unchanged cables are reused from the last table."""
        self._nodes = NodeTable.of(self.cables, self._nodes)
        return self._nodes

    @property
    def state(self) -> CableNetState:
        """Variable state of the cables."""
        cables = {cable: cable.state for cable in self.cables}
        return CableNetState(
            cables, self.strip, self.crossings, self.arranged, self.laid, self.removed_dissipation,
            self.clamps,
        )  # fmt: skip

    @state.setter
    def state(self, state: CableNetState) -> None:
        if self.cables != tuple(state.cables):
            self.cables, self.strip = tuple(state.cables), state.strip
        # Otherwise the strip has at most grown, and remains valid.
        for cable, was in state.cables.items():
            cable.state = was
        self.crossings, self.arranged = state.crossings, state.arranged
        self.laid, self.removed_dissipation = state.laid, state.removed_dissipation
        self.clamps = state.clamps

    @property
    def dissipated(self) -> float:
        """Energy dissipated by friction in all load steps (force x length)."""
        return self.removed_dissipation + sum(cable.dissipated for cable in self.cables)

    @property
    def has_friction(self) -> bool:
        """Whether some cable has lateral friction."""
        return not all(cable.slides_freely for cable in self.cables)

    @property
    def may_touch(self) -> bool:
        """Whether two cables in tension have diameters, so that they may touch side by side."""
        return sum(one.cable.diameter > 0.0 and one.taut for one in self.cables) > 1

    def cable(self, name: str) -> LaidCable:
        """Cable of a given name."""
        return checks.named("cable", {cable.name: cable for cable in self.cables}, name)

    def strip_shape(self) -> StripShape:
        """Current positions of the strip's vertices, gathered only if they have changed.
        Collective."""
        assert self.strip is not None
        u, placement, known = self.membrane.u.x.array, self.membrane.placement, self._shape
        same = (
            known is not None
            and known[0].strip is self.strip
            and known[2] == placement
            and np.array_equal(known[1], u)
        )
        if known is None or not self.membrane.comm.allreduce(same, op=MPI.LAND):
            known = StripShape.of(self.membrane, self.strip), u.copy(), placement
            self._shape = known
        return known[0]

    def grow_strip(self, vertices: npt.ArrayLike, rings: int = 1) -> None:
        """Add the cells around some vertices to the strip. Collective."""
        self.strip = grown(self.membrane, self.strip or EMPTY, vertices, rings)

    def arrange_crossings(self) -> None:
        """Find the crossings of taut cables and insert their points into the cables."""
        self.arranged = self.cables
        if self.strip is None:
            self.crossings = ()
            return
        number = {cable.name: c for c, cable in enumerate(self.cables)}
        clamped = {
            (*sorted(number[name] for name in clamp.cables), clamp.vertex) for clamp in self.clamps
        }
        self.crossings, self._nodes = arrange(
            self.nodes, self.cables, self.strip, self.crossings, clamped
        )
        if self.clamps or any(cable.state.law.parts is not None for cable in self.cables):
            self.clamps = divide(self.cables, self.clamps)

    def add(self, cables: Sequence[LaidCable], strip: Strip) -> None:
        """Add cables laid over the cells of `strip`."""
        self.strip = strip if self.strip is None else self.strip.merged(strip)
        self.cables = (*self.cables, *cables)
        self.laid += len(cables)

    def remove(self, cable: LaidCable | str) -> None:
        """Remove a cable and its crossings. Collective."""
        gone = self.cable(cable) if isinstance(cable, str) else cable
        checks.own("remove", "cable", gone, self.cables)
        number = self.cables.index(gone)

        def renumbered(c: int) -> int:
            return -1 if c == number else c - (c > number)  # -1: of the removed cable

        self.crossings = tuple(  # nodes refer to them by number until the next arrangement
            replace(k, lower=renumbered(k.lower), upper=renumbered(k.upper)) for k in self.crossings
        )
        self.removed_dissipation += gone.dissipated
        self.cables = tuple(own for own in self.cables if own is not gone)
        self.clamps = tuple(clamp for clamp in self.clamps if gone.name not in clamp.cables)
        points = (node.point for own in self.cables for node in own.state.nodes)
        vertices = [vertex for point in points if point is not None for vertex in point.support]
        covers = EMPTY.cells if self.strip is None else self.strip.covers
        vertices += covers.ravel().tolist() if vertices else []
        strip = cells_at(self.membrane, vertices).with_covers(covers) if vertices else None
        self.strip = strip
        self.arrange_crossings()

    def clamp(
        self, cables: Sequence[LaidCable | str], near: object, slip: float | None = None
    ) -> tuple[Clamp, ...]:
        """Clamp cables where they cross, see `Scene.clamp`. Collective."""
        own = self._cables("clamp", cables)
        for cable in own:
            if cable.cable.law == "step":
                raise InputError(
                    f'clamp: {cable.name!r} has law="step", with which its tension cannot differ '
                    "from clamp to clamp; lay it without."
                )
        refuse_clamps_off_lines([one.name for one in own if one.state.laid.line is None])
        new: list[Clamp] = []
        apart: list[str] = []
        held = {(frozenset(clamp.cables), clamp.vertex) for clamp in self.clamps}
        for a, b in combinations(own, 2):
            for one, gap, reach in meetings(a, b):
                if (frozenset(one.cables), one.vertex) in held:
                    continue
                parted = any(
                    {self.cables[k.lower], self.cables[k.upper]} == {a, b}
                    and k.separated
                    and k.support == (one.vertex,)
                    for k in self.crossings
                )
                if parted or gap > TOL.touching * reach:
                    apart.append(
                        f"{a.name!r} and {b.name!r} lie {gap:.3g} apart where they cross, at "
                        f"{as_text(one.place)}"
                    )
                    continue
                name = named([*self.clamps, *new], (a.name, b.name))
                new.append(replace(one, name=name, slip=slip))
        if apart and len(own) == 2:
            raise InputError(
                f"clamp: {apart[0]}; bring them into contact first, or clamp other cables."
            )
        if near is not None:
            new = _nearest("clamp", new, near)
        elif apart and self.membrane.comm.rank == 0:
            text = f"clamp: {counted(len(apart), 'crossing')} left open: {apart[0]}."
            warnings.warn(text, NetWarning, stacklevel=5)
        if not new and not apart and not self._between(own):
            *first, last = (repr(one.name) for one in own)
            raise InputError(
                f"clamp: {', '.join(first)} and {last} do not cross between their ends; lay one of "
                "them so that it crosses another, or clamp those that do."
            )
        _refuse_two_grips([*self.clamps, *new])
        self.clamps = (*self.clamps, *new)
        self.arrange_crossings()
        return tuple(new)

    def unclamp(self, cables: Sequence[LaidCable | str], near: object) -> None:
        """Open clamps, see `Scene.unclamp`. Collective."""
        gone = self._between(self._cables("unclamp", cables))
        if near is not None:
            gone = _nearest("unclamp", gone, near)
        if not gone:
            names = ", ".join(clamp.name for clamp in self.clamps) or "none"
            raise InputError(f"unclamp: there is no such clamp; the scene has {names}.")
        self.clamps = tuple(clamp for clamp in self.clamps if clamp not in gone)
        self.arrange_crossings()

    def release(self, where: str | Marker, directions: str) -> None:
        """Release vertices of the membrane, and edges over their length, but for what edges that
        stay held have in common with them. Collective."""
        membrane, dofs, comm = self.membrane, self.membrane.vertices(where), self.membrane.comm
        self._refuse_anchors_at(where, dofs[membrane.held[dofs].any(axis=1)])
        edges: Indices = np.zeros(0, dtype=np.int32)
        if isinstance(where, str) and where in membrane.mesh.edges:
            edges = membrane.mesh.edges[where]
        if self.cables and comm.allreduce(int(membrane.held_edges[edges].sum())):
            raise InputError(
                f"release: the edge {where!r} would be released after cables have been laid, which "
                "slide along held edges without folding them; release edges first."
            )
        staying, kept = membrane.held_edges.copy(), fem.Function(membrane.V)
        staying[edges] = False
        kept.x.array.reshape(-1, 3)[edge_ends(membrane.V)[staying]] = 1.0
        kept.x.scatter_reverse(la.InsertMode.add)
        kept.x.scatter_forward()
        dofs = dofs[kept.x.array.reshape(-1, 3)[dofs, 0] == 0.0]
        marks = [k for x, k in COMPONENTS.items() if x in directions]
        if not comm.allreduce(int(membrane.held[dofs][:, marks].sum())):
            raise InputError(
                f"release: {where!r} is not held in {directions!r}, or only by edges that stay "
                "held; release these."
            )
        membrane.held[np.ix_(dofs, np.array(marks))] = False
        membrane.held_edges[edges] = False

    def _refuse_anchors_at(self, where: str | Marker, dofs: Indices) -> None:
        """Refuse the release of vertices at which cables have anchors of their own. Collective."""
        membrane = self.membrane
        free = np.concatenate(membrane.comm.allgather(membrane.positions()[dofs]))
        for cable in self.cables:
            for k in (0, -1):
                ways = norm(free - cable.line[k])
                anchored = cable.state.nodes[k].kind == "anchor"
                if anchored and ways.min(initial=np.inf) <= SAME_PLACE * membrane.size:
                    raise InputError(
                        f"release: {cable.name!r} has an anchor of its own at {where!r}, which "
                        "would stay; hold the place by bars, which scene.remove_bar removes."
                    )

    def _cables(self, call: str, cables: Sequence[LaidCable | str]) -> list[LaidCable]:
        """Check and return two or more different cables."""
        own = [self.cable(one) if isinstance(one, str) else one for one in cables]
        for one in own:
            checks.own(call, "cable", one, self.cables)
        if len(own) < 2 or len(set(own)) < len(own):
            names = ", ".join(one.name for one in own)
            raise InputError(
                f"{call}: the cables are {names or '(none)'}; pass two or more different ones."
            )
        return own

    def _between(self, cables: Sequence[LaidCable]) -> list[Clamp]:
        """Clamps between some of the cables."""
        names = {cable.name for cable in cables}
        return [clamp for clamp in self.clamps if names >= set(clamp.cables)]


def refuse_clamps_off_lines(across: Sequence[str]) -> None:
    """Refuse to clamp cables that lie across the cells, given by name."""
    if across:
        lie = f" and {counted(len(across) - 1, 'other')} lie" if across[1:] else " lies"
        raise InputError(
            f"clamp: {across[0]!r}{lie} across the cells of the mesh; only cables along its lines "
            "can be clamped. Make lines by meshes.along(mesh, net.paths), or of routes of your "
            "own, and lay cables on them by lay_net(net, ...) or lay_cable(cable, along=...)."
        )


def _refuse_two_grips(clamps: Sequence[Clamp]) -> None:
    """Refuse clamps of different grips at one vertex, where they are one clamp."""
    at: dict[int, Clamp] = {}
    for clamp in clamps:
        if at.setdefault(clamp.vertex, clamp).slip != clamp.slip:
            other = at[clamp.vertex]
            raise InputError(
                f"clamp: {other.name!r} and {clamp.name!r} have slip = {other.slip} and "
                f"{clamp.slip} at one point, {as_text(clamp.place)}, where all cables have the "
                "same clamp. Give both the same slip."
            )


def refuse_held_clamps(net: CableNet) -> None:
    """Refuse clamps of cables that should slide over the fabric but are held on their lines."""
    for clamp in net.clamps:
        cables = [net.cable(name) for name in clamp.cables]
        if any(HOLDS[cable.hold].sideways for cable in cables):
            raise InputError(
                f"Solver: slide = False holds {cables[0].name!r} and {cables[1].name!r} on their "
                f"lines of the mesh, where the clamp {clamp.name!r} would hold the fabric too and "
                "strengthen it; let them slide, or lay both in pockets."
            )


def _nearest(call: str, clamps: Sequence[Clamp], near: object) -> list[Clamp]:
    """The clamps nearest to given points in space."""
    try:
        points = np.asarray(near, dtype=np.float64).reshape(-1, 3)
    except (TypeError, ValueError, OverflowError):
        points = np.zeros((0, 3))
    if not len(points) or not np.isfinite(points).all():
        raise InputError(f"{call}: near = {near!r}; expected points in space, (k, 3).")
    if not clamps:
        return []
    away = norm(np.array([clamp.place for clamp in clamps])[:, None] - points)
    return [clamps[k] for k in sorted(set(away.argmin(axis=0).tolist()))]
