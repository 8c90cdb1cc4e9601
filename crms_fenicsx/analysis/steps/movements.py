"""Movements of supports, cable ends and joints in `Solver.advance`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Axis, Finite, Vector, checked
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array, Booleans, Indices
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.model.bar import Joint
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE

Way = Callable[[Array, float], Array]
"""Displacements (3, n) (length) of places (3, n) given at the call's start, at a fraction t of the
call, 0 to 1; zero at t = 0."""

Move = Sequence[float] | Array | Way
"""One displacement (3,) for all, applied in equal increments, or a function."""

ROUNDING = 64 * EPSILON
"""Rounding allowed in a function's zeros, relative to places and displacements."""


@checked
@dataclass(frozen=True)
class Rotation:
    """Rotation of supports about an axis, for `Solver.advance`.

    Parameters
    ----------
    point
        A point on the axis, (3,) (length).
    axis
        Direction of the axis, (3,), of any length.
    angle
        Angle over the whole call (rad), right-handed about the axis; it may exceed a full turn.

    Raises
    ------
    InputError
        A point, axis or angle that is not finite, or an axis of zero length.

    Examples
    --------
    >>> turn = Rotation((0, 0, 0), (0, 0, 1), np.pi / 6)
    >>> step = solver.advance(move={"boundary": turn}, steps=3)
    """

    point: Vector
    axis: Axis
    angle: Finite

    def __call__(self, x: Array, t: float) -> Array:
        """Displacements (3, n) of places x (3, n) at a fraction t of the turn (Rodrigues)."""
        axis = np.asarray(self.axis, dtype=float)
        axis = axis / np.linalg.norm(axis)
        arm = x - np.reshape(np.asarray(self.point, dtype=float), (3, 1))
        across = np.cross(axis, arm, axisa=0, axisb=0, axisc=0)
        half = 0.5 * t * self.angle  # 1 - cos without cancellation
        inwards = np.cross(axis, across, axisa=0, axisb=0, axisc=0)
        way: Array = np.sin(2 * half) * across + 2 * np.sin(half) ** 2 * inwards
        return way


@dataclass(frozen=True)
class Motion:
    """A checked movement of some places."""

    what: str  # name for messages
    move: Array | Way  # one displacement (3,) for all, or a function
    places: Array  # (n, 3) at the call's start (length)
    steps: int  # of the call; a function is checked at their ends

    @classmethod
    def of(cls, what: str, given: object, places: Array, steps: int) -> Motion:
        """Check the user's movement; `sampled` checks a function's values."""
        if callable(given):
            return cls(what, given, places, steps)
        return cls(what, checks.vector(what, given), places, steps)

    def at(self, share: float) -> Array:
        """Displacements (n, 3) at a fraction of the call, or (3,) for all (length)."""
        if not callable(self.move):
            return share * self.move
        places, what = self.places.T, f"{self.what}: the function at t = {share:g}"
        return checks.returned(what, self.move(places.copy(), share), places, places.shape).T

    @cached_property
    def sampled(self) -> Array:
        """Displacements at the increments' ends, (steps, n, 3); only the last if one for all."""
        if callable(self.move):
            start = self.at(0.0)
            ends = [self.at((k + 1) / self.steps) for k in range(self.steps)]
            size = max(float(np.abs(v).max(initial=0.0)) for v in (self.places, *ends))
            far = np.flatnonzero(np.abs(start).max(axis=1, initial=0.0) > ROUNDING * size)
            if len(far):
                raise InputError(
                    f"{self.what}: the function returned {start[far[0]]} for the place "
                    f"{self.places[far[0]]} at t = 0; displacements count from the call's start "
                    "and must begin at zero."
                )
            return np.array(ends).reshape(self.steps, -1, 3)
        return np.broadcast_to(self.move, (1, *self.places.shape))

    def moving(self) -> Booleans:
        """Which components of the places move by more than rounding, (n, 3)."""
        least = 0.0
        if callable(self.move):
            least = max(np.abs(v).max(initial=0.0) for v in (self.places, self.sampled))
        return np.asarray((np.abs(self.sampled) > ROUNDING * least).any(axis=0))

    @property
    def displacement(self) -> Array | None:
        """Final displacement (3,) common to all places; None for a function."""
        return None if callable(self.move) else self.move


@dataclass(frozen=True)
class _EdgeEnd:
    """A cable's end held at a moved edge or vertex, whose movement nobody has given."""

    end: CableEnd
    k: int  # its node, 0 or -1
    dofs: Indices  # of this rank's vertices there
    weights: Array  # (n,) of their displacements


@dataclass(frozen=True)
class Movements:
    """Checked movements of supports and anchors."""

    # local degrees of freedom and movement of each group
    vertices: list[tuple[Indices, Motion]]
    # cable, first (0) or last (-1) node, and the movement of that end
    cable_ends: list[tuple[LaidCable, int, Motion]]
    joints: list[tuple[Joint, Motion]]
    sewn_ends: list[_EdgeEnd]  # ends that go with the edge they are sewn to
    staying_ends: list[CableEnd]  # others at moved edges, which stay in space
    # (3,) displacement common to all supports, zero if there is none (length); each increment
    # starts with the whole structure displaced by it
    rigid_translation: Array
    travel: float  # largest displacement at an increment's end (length)
    # numbers that identify each movement, by the user's key: displacement, or sums of a function
    samples: dict[object, list[float]]

    def apply(self, scene: Scene, first: SceneState, before: float, share: float) -> None:
        """Move from share `before` to `share` of the step that began in `first`. Collective."""
        with raised_together(scene.comm):  # evaluate functions before anything moves
            of_vertices = [motion.at(share) for _, motion in self.vertices]
            of_ends = [motion.at(share).reshape(3) for *_, motion in self.cable_ends]
            of_joints = [motion.at(share).reshape(3) for _, motion in self.joints]
        u = scene.u.x.array.reshape(-1, 3)
        if self.rigid_translation.any():
            further = (share - before) * self.rigid_translation
            u += further
            for cable in scene.cables:
                cable.update(positions=cable.state.positions + further)
            for joint in scene.joints:
                joint.update(position=joint.position + further)
        some, moved_by = np.zeros(u.shape, dtype=bool), np.zeros_like(u)
        for (dofs, motion), displacement in zip(self.vertices, of_vertices, strict=True):
            some[dofs] |= motion.moving()
            moved_by[dofs] += displacement
        some &= scene.held
        u[some] = first.u.reshape(-1, 3)[some] + moved_by[some]
        displaced = u - first.u.reshape(-1, 3)
        moved = {cable: cable.state.positions.copy() for cable, _, _ in self.cable_ends}
        sewn = np.zeros((len(self.sewn_ends), 3))
        for e, one in enumerate(self.sewn_ends):
            sewn[e] = one.weights @ displaced[one.dofs]
            moved.setdefault(one.end.cable, one.end.cable.state.positions.copy())
        scene.comm.Allreduce(MPI.IN_PLACE, sewn)
        for one, displacement in zip(self.sewn_ends, sewn, strict=True):
            cable = one.end.cable
            moved[cable][one.k] = first.net.cables[cable].positions[one.k] + displacement
        for cable, k, _ in self.cable_ends:
            moved[cable][k] = first.net.cables[cable].positions[k]
        for (cable, k, _), displacement in zip(self.cable_ends, of_ends, strict=True):
            moved[cable][k] += displacement
        for cable, positions in moved.items():
            cable.update(positions=positions)
        for (joint, _), displacement in zip(self.joints, of_joints, strict=True):
            joint.update(position=first.frame.joints[joint].position + displacement)


def checked_movements(scene: Scene, move: Mapping[object, Move], steps: int) -> Movements:
    """Check movements and return what they move; see `Solver.advance`. Collective."""
    places = scene.positions()
    ends: list[tuple[LaidCable, int, Motion]] = []
    joints: list[tuple[Joint, Motion]] = []
    vertices: list[tuple[Indices, Motion]] = []
    samples: dict[object, list[float]] = {}
    travel = 0.0
    for key, given in sorted(move.items(), key=lambda item: repr(item[0])):  # same on all ranks
        what = f"advance: move of {key!r}"
        own: list[Motion] = []
        if isinstance(key, LaidCable | CableEnd):
            for end in (key.start, key.end) if isinstance(key, LaidCable) else (key,):
                k = _anchor(scene, end)
                own.append(Motion.of(what, given, end.cable.state.positions[k][None], steps))
                ends.append((end.cable, k, own[-1]))
        elif isinstance(key, Joint):
            checks.own("advance", "joint", key, scene.joints)
            own.append(Motion.of(what, given, key.position[None], steps))
            remedy = "make it with held={!r}"
            _check_held(scene, key, key.held[None], own[0], remedy)
            joints.append((key, own[0]))
        elif isinstance(key, str):
            dofs = scene.vertices(key)
            own.append(Motion.of(what, given, places[dofs], steps))
            _check_held(
                scene, key, scene.held[dofs], own[0], f"call scene.fix({key!r}, {{!r}}) first"
            )
            vertices.append((dofs, own[0]))
        else:
            raise InputError(
                f"advance: cannot move {key!r}; expected a laid cable, one of its ends, a held "
                "joint, or the name of a group of held vertices."
            )
        samples[key] = _samples(scene, own, vertices[-1][0] if isinstance(key, str) else None)
        with raised_together(scene.comm):
            sizes = (np.linalg.norm(motion.sampled, axis=2) for motion in own)
            travel = max(travel, *(float(size.max(initial=0.0)) for size in sizes))
    _check_above_floor(scene, vertices, steps)
    travel = scene.comm.allreduce(travel, op=MPI.MAX)
    at_edges = _ends_at_moved_edges(scene, vertices, ends)
    sewn = [one for one in at_edges if one.end.cable.keeps_line]
    staying = [one.end for one in at_edges if not one.end.cable.keeps_line]
    carried = _carried(scene, vertices, ends, sewn, joints)
    return Movements(vertices, ends, joints, sewn, staying, carried, travel, samples)


def _ends_at_moved_edges(
    scene: Scene,
    vertices: list[tuple[Indices, Motion]],
    given: list[tuple[LaidCable, int, Motion]],
) -> list[_EdgeEnd]:
    """Ends held at edges or vertices that move, without those whose movement is given.
    Collective."""
    moves = np.zeros(len(scene.held), dtype=bool)
    for dofs, motion in vertices:
        moves[dofs] |= motion.moving().any(axis=1)
    owned = scene.V.dofmap.index_map.size_local
    ids = scene.membrane.vertex_ids[:owned]
    named, found, moving = {(cable, k) for cable, k, _ in given}, [], []
    for cable in scene.cables:
        for end, k in ((cable.start, 0), (cable.end, -1)):
            if cable.state.nodes[k].kind != "anchor" or cable.state.laid.joints[k] is not None:
                continue
            beside = cable.path_nodes()[k]
            away = np.linalg.norm(cable.state.positions[k] - cable.state.positions[beside])
            support, weights = cable.interpolation(beside)
            if (cable, k) in named or len(support) > 2 or away > SAME_PLACE * cable.length:
                continue
            rows = [np.flatnonzero(ids == vertex) for vertex in support]
            dofs = np.concatenate(rows).astype(np.int32)
            own = np.repeat(weights, [len(row) for row in rows])
            found.append(_EdgeEnd(end, k, dofs, own))
            moving.append(bool(moves[dofs].any()))
    anywhere = scene.comm.allreduce(np.array(moving, dtype=np.int64))
    return [one for one, count in zip(found, anywhere, strict=True) if count]


def _samples(scene: Scene, motions: list[Motion], dofs: Indices | None) -> list[float]:
    """Numbers that identify a movement: displacement or weighted sums. Collective."""
    if motions[0].displacement is not None:
        return [float(x) for x in motions[0].displacement]
    found: Array = np.zeros(0)
    with raised_together(scene.comm):
        given = np.concatenate([motion.sampled for motion in motions], axis=1)
        weights = np.ones(given.shape[1])
        if dofs is not None:
            own = dofs < scene.V.dofmap.index_map.size_local
            weights = own * (0.5 + (0.6180339887498949 * scene.membrane.vertex_ids[dofs]) % 1.0)
        elif scene.comm.rank:  # all ranks have the same ends
            weights *= 0.0
        found = np.einsum("n,sni->si", weights, given).ravel()
    return [float(x) for x in scene.comm.allreduce(found)]


def _anchor(scene: Scene, end: CableEnd) -> int:
    """Node of a cable's end, 0 or -1, if it is an anchor."""
    checks.own("advance", "cable", end.cable, scene.cables)
    k = 0 if end.which == "start" else -1
    if end.cable.state.nodes[k].kind != "anchor":
        raise InputError(
            f"advance: the {end.which} of {end.cable.name!r} is tied to the membrane, "
            "which is not held there; hold it with scene.fix before laying the cable, "
            "or lay the cable to an anchor off the membrane."
        )
    if end.cable.state.laid.joints[k] is not None:
        raise InputError(
            f"advance: the {end.which} of {end.cable.name!r} is fixed to the joint "
            f"{end.cable.state.laid.joints[k]!r}, which is free; move its supports."
        )
    return k  # the last node's number changes with the path


def _check_held(scene: Scene, what: object, held: Booleans, motion: Motion, remedy: str) -> None:
    """Refuse movements in directions in which the places, (n, 3), are free. Collective."""
    with raised_together(scene.comm):
        free = motion.moving() & ~held
        if free.any():
            letters = "".join(np.array(list("xyz"))[free.any(axis=0)])
            raise InputError(
                f"advance: {what!r} is not held in {letters}, so that it cannot be moved by "
                f"{motion.sampled[-1, np.argmax(free.any(axis=1))]}; {remedy.format(letters)}."
            )


def _check_above_floor(scene: Scene, vertices: list[tuple[Indices, Motion]], steps: int) -> None:
    """Refuse supports moved through the floor, which stops free vertices only."""
    if scene.floor_level is None:
        return
    with raised_together(scene.comm):
        places = scene.positions()
        for k in range(steps):
            moved = np.zeros(len(places))
            for dofs, motion in vertices:
                moved[dofs] += motion.at((k + 1) / steps)[..., 2]
            heights = places[:, 2] + moved
            through = np.flatnonzero((moved < 0) & (heights < scene.floor_level))
            if len(through):
                raise InputError(
                    f"advance: move brings the vertex at {places[through[0]]} to z = "
                    f"{heights[through[0]]:g}, below the floor z = {scene.floor_level:g}; move it "
                    "less."
                )


def _carried(
    scene: Scene,
    vertices: list[tuple[Indices, Motion]],
    ends: list[tuple[LaidCable, int, Motion]],
    sewn: list[_EdgeEnd],
    joints: list[tuple[Joint, Motion]],
) -> Array:
    """Displacement common to supports, anchors and held joints, (3,); zero if there is none."""
    motions = (
        [own[-1] for own in vertices] + [own[-1] for own in ends] + [own[-1] for own in joints]
    )
    if any(motion.displacement is None for motion in motions):
        return np.zeros(3)
    moved = np.zeros_like(scene.held, dtype=np.float64)
    for dofs, motion in vertices:
        moved[dofs] += motion.at(1.0)
    of_held = np.where(scene.held, moved, np.nan)
    ranges: Array = np.stack([np.fmin.reduce(v, initial=np.inf) for v in (of_held, -of_held)])
    scene.comm.Allreduce(MPI.IN_PLACE, ranges, op=MPI.MIN)
    least, negative = ranges
    # Directions without supports do not move.
    common: Array = np.where(np.isinf(least), 0.0, least)
    travels: dict[object, Array] = {
        (cable, k): np.zeros(3)
        for cable in scene.cables
        for k in (0, -1)
        if cable.state.nodes[k].kind == "anchor" and cable.state.laid.joints[k] is None
    }
    for one in sewn:  # they move as their supports
        del travels[one.end.cable, one.k]
    for cable, k, motion in ends:
        travels[cable, k] = travels[cable, k] + motion.at(1.0)
    moved_by = {joint: motion.at(1.0) for joint, motion in joints}
    for joint in scene.joints:
        if joint.held.any():  # carried along in its free directions
            travels[joint] = np.where(joint.held, moved_by.get(joint, 0.0), common)
    alike = np.all((least == -negative) | np.isinf(least))
    alike &= all(np.array_equal(travel, common) for travel in travels.values())
    return common if alike and scene.floor_level is None else np.zeros(3)
