"""Masts, struts and guys that support the membrane of a scene, and their joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Any

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Vector, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.foundation.runtime.handle import ReadOnly
from crms_fenicsx.model.bar import Bar, BarEnd, BarState, Joint, JointState, MeshVertex, PlacedBar
from crms_fenicsx.model.membrane import COMPONENTS, Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.model.versions import Versions, changes_model

Place = Sequence[float] | Array
"""A point in space, (3,) (length)."""


@dataclass(frozen=True)
class FrameState:
    """State of joints and bars, in the order in which they were added."""

    joints: Mapping[Joint, JointState]
    bars: Mapping[PlacedBar, BarState]


class Frame:
    """Joints, including anchors, and bars, in the order in which they were added."""

    joints: ReadOnly[tuple[Joint, ...]] = ReadOnly("_joints", "call scene.add_joint(...)")
    bars: ReadOnly[tuple[PlacedBar, ...]] = ReadOnly("_bars", "call scene.add_bar(...)")

    def __init__(self, membrane: Membrane, versions: Versions) -> None:
        self.membrane, self.comm, self.versions = membrane, membrane.comm, versions
        self._joints: tuple[Joint, ...] = ()
        self._bars: tuple[PlacedBar, ...] = ()
        self._homes: dict[int, tuple[int, int]] = {}

    @property
    def state(self) -> FrameState:
        """Their current state."""
        joints = {joint: joint.state for joint in self.joints}
        return FrameState(joints, {bar: bar.state for bar in self.bars})

    @state.setter
    def state(self, state: FrameState) -> None:
        self._joints, self._bars = tuple(state.joints), tuple(state.bars)
        for joint, was in state.joints.items():
            joint.state = was
        for bar, known in state.bars.items():
            bar.state = known

    def __bool__(self) -> bool:
        return bool(self.joints or self.bars)

    @collective
    def add_joint(self, position: Vector, *, name: str | None = None, held: str = "") -> Joint:
        """Add a joint off the membrane for bars to end at; its displacement is an unknown.

        Parameters
        ----------
        position
            Position, (3,) (length).
        name
            Name in messages and loads; "joint 1", "joint 2" ... by default.
        held
            Held components of the displacement, out of "xyz".

        Raises
        ------
        InputError
            On all ranks: a position that is not finite, other directions, or a name that is taken.

        Examples
        --------
        >>> foot = scene.add_joint((2.0, 2.0, -3.0), name="foot", held="xyz")
        >>> corner = scene.vertex_at((4.0, 4.0, 0.0))
        >>> mast = scene.add_bar(Bar(EA=1e5), foot, corner, name="mast")
        >>> round(mast.length, 3)
        4.123
        """
        joint = self._add_joint(np.asarray(position), name, held)
        self.versions.change_model(acts=False)
        return joint

    @collective
    def vertex_at(self, point: Vector) -> MeshVertex:
        """Find the membrane's vertex at a current place, for bars to end at. Collective.

        Parameters
        ----------
        point
            Current position, (3,) (length).

        Raises
        ------
        InputError
            On all ranks: no vertex is there; the message names the nearest.

        Examples
        --------
        >>> corner = scene.vertex_at((4.0, 0.0, 0.0))
        >>> guy = scene.add_bar(Bar(EA=1e4, tension_only=True), corner, (6.0, -2.0, -1.0))
        >>> guy.L0
        3.0
        """
        self.membrane.check_finite("vertex_at")
        membrane, point = self.membrane, np.asarray(point)
        n = membrane.V.dofmap.index_map.size_local
        away = np.linalg.norm(membrane.positions()[:n] - point, axis=1)
        nearest = int(np.argmin(away)) if n else -1
        mine = [np.inf, -1]
        if n:
            mine = [away[nearest], membrane.vertex_ids[nearest], *membrane.positions()[nearest]]
        found = min(membrane.comm.allgather(list(map(float, mine))))
        distance, number, *place = found
        if not distance <= 1e3 * SAME_PLACE * membrane.size:
            raise InputError(
                f"vertex_at: no vertex is at {as_text(point)}; the nearest is {distance:.3g} away, "
                f"at {as_text(place)}. Give its place."
            )
        return self._vertex(int(number), np.array([nearest] if mine == found else []))

    @collective
    @changes_model
    def add_bar(
        self,
        bar: Bar,
        start: Place | BarEnd | str,
        end: Place | BarEnd | str,
        *,
        L0: float | None = None,
        name: str | None = None,
    ) -> PlacedBar:
        """Add a bar: a mast, a strut or, with ``Bar(EA, tension_only=True)``, a guy. Collective.

        It is straight and hinged at both ends; the membrane between them does not touch it.

        Parameters
        ----------
        bar
            Data of the bar.
        start, end
            Ends: a point in space, which becomes an anchor (a held joint, ``bar.start``); a joint;
            a vertex of the membrane from `vertex_at`; or the name of a group of one vertex.
        L0
            Unstressed length (length); by default the current distance of the ends.
        name
            Name in tables and pictures; "bar 1", "bar 2" ... by default.

        Returns
        -------
        PlacedBar
            The bar, as a handle for load steps and results.

        Raises
        ------
        InputError
            On all ranks: an invalid end, both ends at one place, an L0 that is not positive or a
            name that is taken.

        Examples
        --------
        >>> top = scene.add_joint((8.0, 0.0, 6.0), name="mast top", held="y")
        >>> mast = scene.add_bar(Bar(EA=1e5), (8.0, 0.0, 0.0), top, name="mast")
        >>> guys = [
        ...     scene.add_bar(Bar(EA=2e4, tension_only=True), top, foot)
        ...     for foot in ((16.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        ... ]
        >>> step = solver.advance(move={mast.start: (0.0, 0.0, 0.1)})
        >>> bool(mast.force < 0.0 < guys[0].force), mast.start.reaction.round(0)
        """
        self.membrane.check_finite("add_bar")
        name = checks.new_name("add_bar", "bar", name, (bar.name for bar in self.bars))
        if {f"start of {name}", f"end of {name}"} & {joint.name for joint in self.joints}:
            raise InputError(f"add_bar: there is a joint 'start of {name}'; use another name.")
        if L0 is not None:
            L0 = checks.positive(f"add_bar: L0 of {name!r}", L0)
        given = {
            which: self._bar_end(name, which, e) for which, e in (("start", start), ("end", end))
        }
        points = np.array(
            [e if isinstance(e, np.ndarray) else self.place_of(e) for e in given.values()]
        )
        length = float(np.linalg.norm(points[1] - points[0]))
        if length <= SAME_PLACE * self.membrane.size:
            raise InputError(
                f"add_bar: both ends of {name!r} are at {as_text(points[0])}, so that it has no "
                "length; use two different places."
            )
        ends = [
            self._add_joint(e, f"{which} of {name}", "xyz") if isinstance(e, np.ndarray) else e
            for which, e in given.items()
        ]
        placed = PlacedBar(name, BarState(bar, ends[0], ends[1], L0 or length, points))
        self._bars = (*self.bars, placed)
        return placed

    def bar(self, name: str) -> PlacedBar:
        """Return the bar with a name.

        Raises
        ------
        InputError
            No bar has that name.
        """
        return checks.named("bar", {bar.name: bar for bar in self.bars}, name)

    def joint(self, name: str) -> Joint:
        """Return the joint with a name; anchors are "start of mast" or "end of mast".

        Raises
        ------
        InputError
            No joint has that name.
        """
        return checks.named("joint", {joint.name: joint for joint in self.joints}, name)

    @property
    def vertices(self) -> tuple[MeshVertex, ...]:
        """Vertices that are ends of bars, each once."""
        ends = (end for bar in self.bars for end in (bar.start, bar.end))
        return tuple(dict.fromkeys(end for end in ends if isinstance(end, MeshVertex)))

    def home(self, vertex: MeshVertex) -> tuple[int, int]:
        """The owning rank and local degree of freedom of a vertex. Collective at the first call."""
        if vertex.number not in self._homes:
            membrane = self.membrane
            own = membrane.vertex_ids[: membrane.V.dofmap.index_map.size_local]
            same = own == vertex.number
            away = np.abs(membrane.given[: len(own)] - vertex.place).max(axis=1)
            found = np.flatnonzero(same & (away <= SAME_PLACE * membrane.size))
            mine = (membrane.comm.rank, int(found[0])) if len(found) else None
            homes = [home for home in membrane.comm.allgather(mine) if home is not None]
            if len(homes) != 1:
                raise InputError(
                    f"{vertex}: the mesh has no such vertex; use one of this scene from "
                    "scene.vertex_at(...)."
                )
            self._homes[vertex.number] = homes[0]
        return self._homes[vertex.number]

    def vertex_in_group(self, group: str) -> MeshVertex:
        """The vertex of a group that must have exactly one. Collective."""
        membrane = self.membrane
        dofs = membrane.vertices(group)
        own = dofs[dofs < membrane.V.dofmap.index_map.size_local]
        numbers = np.concatenate(membrane.comm.allgather(membrane.vertex_ids[own]))
        if len(numbers) != 1:
            raise InputError(
                f"add_bar: the group {group!r} has {len(numbers)} vertices; name one by "
                "scene.vertex_at(point), or name a group with one."
            )
        return self._vertex(int(numbers[0]), own)

    def _vertex(self, number: int, dofs: Array) -> MeshVertex:
        """A vertex from its local degree of freedom, given on the owning rank only."""
        place = self.membrane.given[int(dofs[0])] if len(dofs) else None
        x, y, z = next(p for p in self.membrane.comm.allgather(place) if p is not None)
        return MeshVertex(number, (float(x), float(y), float(z)))

    def place_of(self, end: BarEnd) -> Array:
        """Current position (3,) of a bar end. Collective."""
        if isinstance(end, Joint):
            return end.position
        rank, dof = self.home(end)
        comm = self.membrane.comm
        place = self.membrane.positions()[dof] if comm.rank == rank else None
        return np.array(comm.bcast(place, root=rank))

    def _add_joint(self, position: Array, name: str | None, held: str) -> Joint:
        """Add a joint at a checked position."""
        if not isinstance(held, str) or set(held) - set(COMPONENTS):
            raise InputError(
                f'add_joint: held = {held!r} must be made of the letters x, y and z, or "".'
            )
        name = checks.new_name("add_joint", "joint", name, (j.name for j in self.joints))
        flags = np.array([letter in held for letter in COMPONENTS])
        joint = Joint(name, JointState(position.copy(), flags, position.copy(), np.zeros(3)))
        self._joints = (*self.joints, joint)
        return joint

    def _bar_end(self, name: str, which: str, given: Place | BarEnd | str) -> BarEnd | Array:
        """Checked end of a bar: a joint, a vertex, or an anchor's position (3,). Collective."""
        if isinstance(given, Joint):
            checks.own(f"add_bar: {which} of {name!r}", "joint", given, self.joints)
            return given
        if isinstance(given, MeshVertex):
            self.home(given)
            return given
        if isinstance(given, str):
            return self.vertex_in_group(given)
        return checks.vector(f"add_bar: {which} of {name!r}", given)

    def remove(self, bar: PlacedBar, needed: Set[str | None]) -> None:
        """Remove a bar, and its anchors unless other bars end there or `needed` names them."""
        self._bars = tuple(other for other in self.bars if other is not bar)
        used = {end for other in self.bars for end in (other.start, other.end)}
        own = {f"start of {bar.name}", f"end of {bar.name}"} - needed
        self._joints = tuple(j for j in self.joints if j.name not in own or j in used)

    def path_of(
        self, path: Sequence[Sequence[float] | Joint] | Array | None
    ) -> tuple[Any, tuple[str | None, str | None]]:
        """A cable's path with joints replaced by positions, and its end joints' names."""
        names: list[str | None] = [None, None]
        if not isinstance(path, list | tuple) or not any(isinstance(p, Joint) for p in path):
            return path, (None, None)
        points: list[Any] = list(path)
        for k, point in enumerate(points):
            if isinstance(point, Joint):
                checks.own("lay_cable: path", "joint", point, self.joints)
                if k not in (0, len(points) - 1):
                    raise InputError(
                        f"lay_cable: path has {point!r} as point {k + 1}; only its first and last "
                        "point may be joints."
                    )
                names[k > 0], points[k] = point.name, point.position
        return points, (names[0], names[1])

    def release(self, joint: Joint, directions: str) -> None:
        """Release components of a held joint that bars carry on."""
        checks.own("release", "joint", joint, self.joints)
        marks = np.array([letter in directions for letter in COMPONENTS])
        if not (joint.held & marks).any():
            raise InputError(
                f"release: the joint {joint.name!r} is not held in {directions!r}; its held "
                f"directions are {''.join(x for x, k in COMPONENTS.items() if joint.held[k])!r}."
            )
        if not any(joint in (bar.start, bar.end) for bar in self.bars):
            raise InputError(
                f"release: no bar ends at the joint {joint.name!r}; add the bars that hold it, or "
                "remove the cables that end at it."
            )
        joint.update(held=joint.held & ~marks)

    def check_held(self, cable_ends: Iterable[str | None]) -> None:
        """Raise an error for joints without support."""
        of_cables = set(cable_ends)
        reached: set[object] = {j for j in self.joints if j.held.all() or j.name in of_cables}
        reached |= set(self.vertices)
        grows = True
        while grows:
            ends = [{bar.start, bar.end} for bar in self.bars]
            more = set[object]().union(*(pair for pair in ends if pair & reached))
            grows = not more <= reached
            reached |= more
        for joint in self.joints:
            if joint not in reached:
                alone = not any(joint in (bar.start, bar.end) for bar in self.bars)
                why = "no bar ends there" if alone else "no bars connect it to a support"
                raise InputError(
                    f"advance: nothing holds {joint!r}: {why}; add bars to an anchor, to the "
                    'membrane or to a held joint, or make it with held="xyz".'
                )
