"""Foundation forces at points, where cable and bar ends meet, and along held edges."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np
from dolfinx import fem

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.checks import as_counted
from crms_fenicsx.results.cable_and_bar_results import Force, triple
from crms_fenicsx.results.reactions import (
    AT,
    HeldEnd,
    held_ends,
    held_groups,
    held_lengths,
    hung_bars,
    nodal_forces,
    support_forces,
)


@dataclass(frozen=True)
class FoundationPoint:
    """Foundation point of cables, bars and held points of the membrane."""

    members: tuple[str, ...]  # names of the ends that meet here
    at: Force  # position (length)
    force: Force  # total force on the foundation (force)
    joints: tuple[str, ...] = ()  # names of the held joints here
    moment: Force = (0.0, 0.0, 0.0)  # of a foundation's forces about `at` (force x length)


@dataclass(frozen=True)
class FoundationLine:
    """Held edges or vertices of a group, without those of larger groups."""

    name: str  # of the group, or "other supports"
    force: Force  # of the membrane on the foundation, without ends of cables and bars (force)
    length: float  # of the edges (length); 0 for points
    # mean, largest: force magnitude per length, in the mean and at a vertex (force per length)
    mean: float
    largest: float


@dataclass(frozen=True)
class Foundations:
    """All foundations of a scene. Forces act on the foundations: reactions with reversed sign."""

    points: tuple[FoundationPoint, ...]
    lines: tuple[FoundationLine, ...]
    loads: Mapping[str, Force]  # resultants by name of load, and "pressure"
    rim: Array  # (k, 2, 3) present ends of held edges (length), on all ranks
    per_length: Array  # (k, 2, 3) force per length at these ends (force per length)

    @property
    def _forces(self) -> list[Force]:
        return [one.force for one in self.points] + [one.force for one in self.lines]

    @property
    def total(self) -> Force:
        """Sum of the foundation forces (force)."""
        return triple(np.sum([(0.0, 0.0, 0.0), *self._forces], axis=0))

    @property
    def unbalanced(self) -> float:
        """Difference from the sum of the loads, relative to the largest of all these forces."""
        loads = [*self.loads.values()]
        sizes = np.abs([*loads, *self._forces])
        gap = np.abs(np.subtract(self.total, np.sum(loads, axis=0) if loads else 0.0))
        return float(gap.max() / (sizes.max(initial=0.0) or 1.0))


OTHERS = "other supports"
"""Name for held vertices that belong to no group held as a whole."""


def foundations(system: System) -> Foundations:
    """Forces on all foundations. Collective."""
    scene, forces = system.scene, support_forces(system)
    membrane, comm, n = scene.membrane, scene.comm, len(forces)
    hung = hung_bars(scene)
    for dof, end in hung:
        forces[dof] -= end.force
    every = [*held_ends(scene), *chain.from_iterable(comm.allgather([end for _, end in hung]))]
    lengths = held_lengths(membrane)
    line = forces / np.where(lengths[:n] > 0.0, lengths[:n], np.inf)
    sizes, lines = np.linalg.norm(line, axis=1), []
    for name, dofs in partition(scene).items():
        own = lengths[dofs].max(axis=1, initial=0.0)
        total = triple(comm.allreduce(forces[dofs].sum(axis=0)))
        if name in membrane.mesh.points and not comm.allreduce(float(own.sum())):
            places = [x for x in comm.allgather(scene.positions()[dofs]) if len(x)]
            every.append(HeldEnd(name, places[0][0], np.array(total)))
            continue
        length, loaded = comm.allreduce(np.array([own.sum(), (own * sizes[dofs]).sum()])).tolist()
        largest = max(comm.allgather(float(sizes[dofs].max(initial=0.0))))
        lines.append(
            FoundationLine(name, _reversed(total), length, loaded / (length or 1.0), largest)
        )
    function, rim = fem.Function(scene.V), held_edges(scene)
    function.x.array[: line.size] = line.ravel()
    function.x.scatter_forward()
    return Foundations(
        tuple(_points(every, AT * membrane.size)), tuple(lines), _resultants(system),
        held_rim(scene), np.concatenate(comm.allgather(-function.x.array.reshape(-1, 3)[rim])),
    )  # fmt: skip


def partition(scene: Scene) -> dict[str, Indices]:
    """This rank's owned held vertices, each assigned to its largest group. Collective."""
    n, comm = scene.V.dofmap.index_map.size_local, scene.comm
    left: Booleans = np.any(scene.held[:n], axis=1)
    groups = {name: dofs[dofs < n] for name, (_, dofs) in held_groups(scene.membrane).items()}
    counts = {name: comm.allreduce(len(own)) for name, own in groups.items()}
    found = dict[str, Indices]()
    for name in sorted(groups, key=lambda one: (-counts[one], as_counted(one))):
        own = groups[name]
        own = own[left[own]]
        left[own] = False
        if comm.allreduce(len(own)):
            found[name] = own
    if comm.allreduce(int(left.sum())):
        found[OTHERS] = np.flatnonzero(left).astype(np.int32)
    return found


def _resultants(system: System) -> dict[str, Force]:
    """Resultants of all actions on membrane and joints except the supports'. Collective."""
    scene, found = system.scene, dict[str, Array]()
    for load in scene.loads:
        if load.factor != 0.0 and not load.warms:
            own = load.forces.sum(axis=0)
            joints = np.sum([(0.0, 0.0, 0.0), *load.joints.values()], axis=0)
            found[load.name] = load.factor * (scene.comm.allreduce(own) + joints)
    if scene.pressure != 0.0:
        vectors = system.pressed_facets()[1].sum(axis=0)
        found["pressure"] = scene.pressure * scene.comm.allreduce(vectors)
    potential, ponds = system.potential, system.ponds
    if ponds is not None:
        found["water"] = _sum(system, lambda g: ponds.add_pressure(potential, g, -1.0))
    potential.sum_up()
    for term in scene.terms:  # user terms, such as springs to the ground
        sums = potential.sums_of(term)
        found[term.name] = _sum(system, partial(term.add_gradient, potential.x, sums))
    if scene.floor_level is not None:
        free = nodal_forces(system)[: system.unknowns.n_vertices]
        up = np.where(scene.held[: len(free), 2], 0.0, free[:, 2]).sum()
        found["floor"] = np.array([0.0, 0.0, scene.comm.allreduce(float(up))])
    # internal forces have resultants of rounding errors
    nothing = 1e-10 * max((float(np.abs(x).max()) for x in found.values()), default=0.0)
    return {
        name: triple(np.asarray(force)) for name, force in found.items()
        if np.abs(force).max() > nothing
    }  # fmt: skip


def _sum(system: System, add: Callable[[Array], object]) -> Array:
    """Resultant of the forces whose negatives `add` adds to those on all blocks. Collective."""
    vector, g = system.unknowns.vector()
    add(g)
    system.unknowns.gather_forces(vector, g)
    vector.destroy()
    return -np.asarray(system.scene.comm.allreduce(g[: system.unknowns.n_owned].sum(axis=0)))


def _points(ends: Iterable[HeldEnd], near: float) -> list[FoundationPoint]:
    """Combine ends at the same place."""
    places = list[tuple[Array, list[HeldEnd]]]()
    for end in ends:
        for at, members in places:
            if np.linalg.norm(at - end.place) <= near:
                members.append(end)
                break
        else:
            places.append((end.place, [end]))
    return [
        FoundationPoint(
            tuple(end.name for end in members), triple(at),
            _reversed(np.sum([end.force for end in members], axis=0)),
            tuple(dict.fromkeys(end.joint for end in members if end.joint)),
        )
        for at, members in places
    ]  # fmt: skip


def held_edges(scene: Scene) -> Integers:
    """Vertex pairs of this rank's named edges held in some direction, (k, 2)."""
    membrane = scene.membrane
    own = membrane.mesh.mesh.topology.index_map(1).size_local
    named = np.unique(np.concatenate([np.zeros(0, np.int32), *membrane.mesh.edges.values()]))
    ends = edge_ends(membrane.V)[named[named < own]]
    return np.asarray(ends[membrane.held[ends].all(axis=1).any(axis=1)])


def held_rim(scene: Scene) -> Array:
    """Ends of all ranks' held named edges, (k, 2, 3) (length). Collective."""
    return np.concatenate(scene.comm.allgather(scene.positions()[held_edges(scene)]))


def _reversed(force: Sequence[float] | Array) -> Force:
    """The opposite force, without negative zeros."""
    return triple(0.0 - np.asarray(force))
