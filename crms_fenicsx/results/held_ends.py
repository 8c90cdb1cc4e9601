"""Forces with which anchors and held joints hold the ends of cables and bars, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from crms_fenicsx.model.bar import Joint
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.scene import Scene

AT = 1e3 * SAME_PLACE
"""Distance, relative to the membrane's size, up to which an end is at a place of the membrane."""


@dataclass(frozen=True)
class HeldEnd:
    """What ends at an anchor or at a held joint, where, and the force that holds it, (3,)."""

    name: str
    place: Array
    force: Array


def held_ends(scene: Scene) -> list[HeldEnd]:
    """All ends of cables and bars, and loads on joints, that anchors and joints hold."""
    found = []
    for cable in scene.cables:
        for k, end in enumerate((cable.start, cable.end)):
            if cable.nodes[-k].kind == "anchor" and cable.joints[k] is None:
                beside = -2 if k else 1
                place = cable.positions[beside if cable.ends[k] == "held" else -k]
                found.append(HeldEnd(f"{cable.name} {end.which}", place, end.reaction))
    for joint in scene.joints:
        if joint.held.any():
            found += _at_joint(scene, joint)
    return found


def _at_joint(scene: Scene, joint: Joint) -> list[HeldEnd]:
    """What a held joint holds; the sum is its reaction."""
    forces = {bar.name: -bar.pull(joint) for bar in scene.bars if joint in (bar.start, bar.end)}
    for cable in scene.cables:
        for end, name in zip((cable.start, cable.end), cable.joints, strict=True):
            if name == joint.name and cable.taut:
                forces[f"{cable.name} {end.which}"] = end.reaction
    for load in scene.loads:
        if joint.name in load.joints:
            forces[load.name] = -load.factor * np.array(load.joints[joint.name])
    place = joint.position
    return [HeldEnd(name, place, np.where(joint.held, x, 0.0)) for name, x in forces.items()]


def bars_at_vertices(scene: Scene, dofs: Indices | Integers) -> list[HeldEnd]:
    """What this rank's owned vertices `dofs`, as far as they are held, hold of bars. Collective."""
    frame, comm, found = scene.frame, scene.comm, list[HeldEnd]()
    if not frame.vertices:
        return []
    for vertex in frame.vertices:
        rank, dof = frame.home(vertex)
        if rank == comm.rank and dof in dofs and scene.held[dof].any():
            held, place = scene.held[dof], scene.positions()[dof]
            found += [
                HeldEnd(bar.name, place, np.where(held, -bar.pull(vertex), 0.0))
                for bar in scene.bars if vertex in (bar.start, bar.end)
            ]  # fmt: skip
    return list(chain.from_iterable(comm.allgather(found)))


def are_at(membrane: Membrane, dofs: Indices | Integers, places: Sequence[Array]) -> Booleans:
    """Which places are at vertices `dofs` now, with ghosts, or between two of them. Collective."""
    if not places:
        return np.zeros(0, dtype=bool)
    topology = membrane.mesh.mesh.topology
    marked, dof_of = np.zeros((2, len(membrane.held)), dtype=np.int64)
    marked[dofs] = 1
    dof_of[topology.connectivity(2, 0).array.reshape(-1, 3)] = membrane.V.dofmap.list
    ends = dof_of[topology.connectivity(1, 0).array.reshape(-1, 2)]
    points = membrane.positions()
    start, end = points[ends[marked[ends].all(axis=1)]].transpose(1, 0, 2)
    start, end = (np.concatenate([x, points[dofs]]) for x in (start, end))
    way = end - start
    squared = np.maximum((way * way).sum(axis=1), 1e-300)
    near = np.zeros(len(places), dtype=np.int64)
    for k, place in enumerate(places):
        along = np.clip(((place - start) * way).sum(axis=1) / squared, 0.0, 1.0)
        gaps = np.linalg.norm(start + along[:, None] * way - place, axis=1)
        near[k] = gaps.min(initial=np.inf) <= AT * membrane.size
    return np.asarray(membrane.comm.allreduce(near)) > 0


def ends_at(
    scene: Scene, dofs: Indices | Integers, ends: Sequence[HeldEnd], others: Sequence[Array] = ()
) -> list[HeldEnd]:
    """Those of some ends that are at vertices `dofs`, or at some other places. Collective."""
    near = are_at(scene.membrane, dofs, [end.place for end in ends])
    for place in others:
        away = [np.linalg.norm(end.place - place) for end in ends]
        near |= np.array(away) <= AT * scene.membrane.size
    return [end for end, there in zip(ends, near, strict=True) if there]


def added(ends: Sequence[HeldEnd]) -> dict[str, Array]:
    """Their forces by names; of one name together."""
    found = dict[str, Array]()
    for end in ends:
        found[end.name] = found.get(end.name, np.zeros(3)) + end.force
    return found
