"""The loads of a call to `Solver.advance`: checked before anything is computed, then applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeVar

import numpy as np
from dolfinx.fem import locate_dofs_topological
from mpi4py import MPI

from crms_fenicsx.energies.pressure_rim import rim_of
from crms_fenicsx.equilibrium.state import State
from crms_fenicsx.model.fan_control import FanControl
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Indices
from crms_fenicsx.runtime.errors import InputError, as_text, raised_together
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.inner_pressure import InnerPressure, between, checked_pressure

Value = TypeVar("Value")

TYPE_OF_MOVE = "a laid cable, one of its ends, or the name of a group of held vertices"


@dataclass(frozen=True)
class Target:
    """Loads to reach, and those to start from.

    Attributes
    ----------
    pressure
        Way of the inner pressure.
    factors
        First and last factor of each load that changes, by its name.
    cable_ends
        Number of the cable, its first (0) or last (-1) node, and that end's displacement (length).
    moved : (n, 3)
        Displacements of the vertices (length).
    rigid_translation : (3,)
        Displacement that all supports have in common, and zero if there is none (length): the
        whole structure begins each increment displaced by it.
    lengths
        Number of the cable, its first and last unstressed length (length).
    """

    pressure: InnerPressure
    factors: dict[str, tuple[float, float]]
    cable_ends: list[tuple[int, int, Array]]
    moved: Array
    rigid_translation: Array
    lengths: list[tuple[int, float, float]]

    def apply(self, scene: Scene, first: State, before: float, share: float) -> None:
        """Set the loads at a share of the way from the state `first`; `before` is that reached."""
        scene._loads = tuple(
            replace(load, factor=between(*self.factors[load.name], share))
            if load.name in self.factors
            else load
            for load in scene.loads
        )
        scene._ponds = tuple(
            replace(pond, factor=between(*self.factors[pond.name], share))
            if pond.name in self.factors
            else pond
            for pond in scene.ponds
        )
        self.pressure.apply(scene, share)
        u = scene.u.x.array.reshape(-1, 3)
        u += (share - before) * self.rigid_translation
        for cable in scene.cables:
            cable.update(positions=cable.positions + (share - before) * self.rigid_translation)
        some = self.moved != 0.0
        u[some] = first.u.reshape(-1, 3)[some] + share * self.moved[some]
        moved = {c: scene.cables[c].positions.copy() for c, _, _ in self.cable_ends}
        for c, k, _ in self.cable_ends:
            moved[c][k] = first.cables[c].positions[k]
        for c, k, displacement in self.cable_ends:
            moved[c][k] += share * displacement
        for c, positions in moved.items():
            scene.cables[c].update(positions=positions)
        for c, start, end in self.lengths:
            scene.cables[c].update(L0=start + share * (end - start))


def checked_target(
    scene: Scene,
    pressure: float | FanControl | None = None,
    move: Mapping[object, tuple[float, float, float]] = MappingProxyType({}),
    L0: Mapping[object, float] = MappingProxyType({}),
    load: float | Mapping[str, float] | None = None,
    temperature: float | None = None,
    atmosphere: float | None = None,
) -> Target:
    """Check the loads and say what they change; see `Solver.advance`. Collective.

    Raises
    ------
    InputError
        A load that cannot be applied, on all ranks.
    """
    scene.membrane.check_finite("advance")
    if not scene.comm.allreduce(int(scene.held.any())):
        raise InputError(
            "advance: nothing of the membrane is held; hold its boundary with "
            'scene.fix("boundary").'
        )
    inner = checked_pressure(scene, pressure, temperature, atmosphere)
    factors = {} if load is None else _factors(scene, load)
    _check_wind(scene, factors)
    for name, given in (("move", move), ("L0", L0)):
        if not isinstance(given, Mapping):
            raise InputError(
                f"advance: {name} = {given!r} is no mapping; write {name}={{what: value}}."
            )
    ends: list[tuple[int, int, Array]] = []
    vertices: list[tuple[Indices, Array]] = []
    for key, vector in _in_order(move):
        displacement = checks.vector(f"advance: move of {key!r}", vector)
        if isinstance(key, LaidCable):
            wanted = [key.start, key.end]
        elif isinstance(key, CableEnd):
            wanted = [key]
        elif isinstance(key, str):
            vertices.append((_held_group(scene, key, displacement), displacement))
            continue
        else:
            raise InputError(f"advance: cannot move {key!r}; give {TYPE_OF_MOVE}.")
        for end in wanted:
            c, k = _number(scene, end.cable), 0 if end.which == "start" else -1
            if end.cable.nodes[k].kind != "anchor":
                raise InputError(
                    f"advance: the {end.which} of {end.cable.name!r} is tied to the membrane, "
                    "which is not held there; hold it with scene.fix before laying the cable, "
                    "or lay the cable to an anchor off the membrane."
                )
            # The last node's number changes with the path.
            ends.append((c, 0 if k == 0 else -1, displacement))
    if inner.acts:
        _check_rim(scene)
    moved = _moved(scene, vertices)
    _check_above_floor(scene, moved)
    lengths = []
    for key, length in _in_order(L0):
        if not isinstance(key, LaidCable):
            raise InputError(f"advance: L0 of {key!r}; give a laid cable.")
        if key.cable.law == "step":
            raise InputError(
                f"advance: {key.name!r} has the step-wise law (2.2-2), which has no unstressed "
                'length; use Cable(law="total").'
            )
        length = checks.positive(f"advance: L0 of {key.name!r}", length)
        lengths.append((_number(scene, key), key.L0, length))
    rigid_translation = _carried(scene, moved, ends)
    return Target(inner, factors, ends, moved, rigid_translation, lengths)


def _factors(scene: Scene, load: float | Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """First and last factors of loads and ponds, by their names."""
    present = scene.factors
    if not present:
        raise InputError(
            f"advance: load = {load!r}, but there is none on the membrane; put one there with "
            "scene.put_load, scene.put_wind or scene.put_pond."
        )
    if not isinstance(load, Mapping):
        only = next(iter(present))
        if len(present) > 1:
            names = ", ".join(map(repr, present))
            raise InputError(
                f"advance: load = {load!r}, but there are the loads {names}; write "
                f"load={{{only!r}: {load!r}}}."
            )
        return {only: (present[only], checks.finite("advance: load", load))}
    found = {
        name: (
            checks.named("load", present, name),
            checks.finite(f"advance: load of {name!r}", factor),
        )
        for name, factor in load.items()
    }
    for pond in scene.ponds:
        if found.get(pond.name, (0.0, 0.0))[1] < 0.0:
            raise InputError(
                f"advance: load of {pond.name!r} = {load[pond.name]:g}, of water, which cannot "
                "pull; give 0 or more."
            )
    return found


def _check_wind(scene: Scene, factors: Mapping[str, tuple[float, float]]) -> None:
    """The paper's pressure goes from one state to another in turn, and wind with it."""
    for load in scene.loads:
        if load.suction is not None and scene.pressure_law == "step":
            _, factor = factors.get(load.name, (0.0, load.factor))
            if factor != 0.0:
                raise InputError(
                    f"advance: load of {load.name!r} = {factor:g}, a wind that follows the "
                    'surface, with Scene(..., pressure="step"); use pressure="total", or put the '
                    "wind as a dead load with scene.put_load."
                )


def _in_order(given: Mapping[object, Value]) -> list[tuple[object, Value]]:
    """The items by the names of their keys: sums and errors are then the same on all ranks."""
    return sorted(given.items(), key=lambda item: repr(item[0]))


def _number(scene: Scene, cable: object) -> int:
    for c, other in enumerate(scene.cables):
        if other is cable:
            return c
    raise InputError(f"advance: {cable!r} is not a cable of this scene.")


def _held_group(scene: Scene, name: str, displacement: Array) -> Indices:
    dofs = scene.vertices(name)
    moving = displacement != 0.0
    with raised_together(scene.comm):
        if not scene.held[dofs][:, moving].all():
            letters = "".join(np.array(list("xyz"))[moving])
            raise InputError(
                f"advance: {name!r} is not held in {letters}, so that it cannot be moved by "
                f"{displacement}; call scene.fix({name!r}, {letters!r}) first."
            )
    return dofs


def _check_above_floor(scene: Scene, moved: Array) -> None:
    """The floor is for the free vertices; held ones must not be moved through it."""
    if scene.floor_level is None:
        return
    with raised_together(scene.comm):
        places = scene.positions()
        heights = places[:, 2] + moved[:, 2]
        through = np.flatnonzero((moved[:, 2] < 0) & (heights < scene.floor_level))
        if len(through):
            raise InputError(
                f"advance: move brings the vertex at {places[through[0]]} to z = "
                f"{heights[through[0]]:g}, below the floor z = {scene.floor_level:g}; move it "
                "less."
            )


def _moved(scene: Scene, vertices: list[tuple[Indices, Array]]) -> Array:
    """Movements of all vertices, (n, 3); those of a vertex in several groups add up."""
    moved = np.zeros_like(scene.held, dtype=np.float64)
    for dofs, displacement in vertices:
        moved[dofs] += displacement
    return moved


def _carried(scene: Scene, moved: Array, ends: list[tuple[int, int, Array]]) -> Array:
    """The displacement that held vertices and anchors have in common, (3,); else zero."""
    given = np.where(scene.held, moved, np.nan)
    ranges: Array = np.stack([np.fmin.reduce(v, initial=np.inf) for v in (given, -given)])
    scene.comm.Allreduce(MPI.IN_PLACE, ranges, op=MPI.MIN)
    least, negative = ranges
    # A direction in which nothing is held stays as it is.
    common: Array = np.where(np.isinf(least), 0.0, least)
    travels: dict[tuple[int, int], Array] = {
        (c, k): np.zeros(3)
        for c, cable in enumerate(scene.cables)
        for k in (0, -1)
        if cable.nodes[k].kind == "anchor"
    }
    for c, k, displacement in ends:
        travels[c, k] = travels[c, k] + displacement
    alike = np.all((least == -negative) | np.isinf(least))
    alike &= all(np.array_equal(travel, common) for travel in travels.values())
    return common if alike and scene.floor_level is None else np.zeros(3)


def has_free_rim(scene: Scene) -> bool:
    """Whether the paper's pressure acts on a membrane with edges that are free. Collective."""
    if scene.pressure_law == "total" or scene.pressure == 0.0:
        return False
    return bool(scene.comm.allreduce(len(rim_of(scene.membrane).free)))


def _check_rim(scene: Scene) -> None:
    """The exact follower pressure has a potential only if its rim is held or slides in planes."""
    if scene.pressure_law != "total":
        return
    rim = rim_of(scene.membrane)
    boundary = locate_dofs_topological(scene.V, 1, scene.mesh.edges["boundary"])
    with raised_together(scene.comm):
        if len(rim.free):
            place = scene.membrane.stress_free[rim.free[0]]
            what, remedy = (
                (
                    "whose boundary is free at",
                    'scene.fix("boundary"), or in a plane of symmetry in its normal direction, as '
                    'by scene.fix(group, "y")',
                )
                if rim.free[0] in boundary
                else (
                    "whose cells under pressure end, or meet in a seam, at",
                    'scene.fix, or leave walls without pressure: Scene(..., pressure_on=["roof"])',
                )
            )
            raise InputError(
                f"advance: pressure on a membrane {what} {as_text(place)}: the follower pressure "
                f'needs it held ({remedy}); with free edges use Scene(..., pressure="step").'
            )
        edges = scene.membrane.open_edges
        sliding = {(int(a), int(b)) for a, b in edges.ids[np.isin(edges.numbers, rim.sliding)]}
        for cable in scene.cables:
            for node in cable.nodes:
                ids = node.interpolation()[0] if node.kind == "fold" else ()
                if tuple(sorted(ids)) in sliding:
                    raise InputError(
                        f"advance: pressure on a membrane whose edge slides in a plane, but "
                        f"{cable.name!r} runs over it and folds it; let the cable end there."
                    )
