"""Contents of a checkpoint except its arrays, and the fingerprint of its scene."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.load_step import Step
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.energy.terms.kinematics import warp_field
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.runtime.arrays import Integers
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.bar import Joint, MeshVertex
from crms_fenicsx.model.changed_materials import numbers
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.results.checkpoint.codec import Plain, encode
from crms_fenicsx.results.output.shared_file import digest


@dataclass(frozen=True)
class Run:
    """A solver's record of its load steps."""

    steps: list[Step]  # accepted load steps
    rows: list[Mapping[str, int | float | str]]  # rows of the history
    tried: TriedPaths | None  # paths tried and rejected; None before the first


@dataclass(frozen=True)
class Contents:
    """Contents of a checkpoint except the arrays on the mesh."""

    scene: Plain  # identifies the scene, see `fingerprint`
    positions: Plain  # description of the file of stress-free vertices
    state: Plain  # a `SceneState`
    state_version: int  # of the scene's versions
    in_equilibrium: bool  # whether the scene was unchanged since the last load step
    run: Run
    # call of `Solver.advance` that the checkpoint belongs to, if any
    call: Plain | None


def check(state: SceneState, parts: Collection[str], n_vertices: int) -> None:
    """Refuse an inconsistent state, or one that does not fit the mesh's parts and vertices."""
    net, loads, joints = state.net, state.loads, {joint.name for joint in state.frame.joints}
    if net.laid < len(net.cables):
        raise ValueError(f"{net.laid} cables were laid, but {len(net.cables)} are there")
    for load in loads.loads:
        if not load.intensity >= 0:
            raise ValueError(f"a load {load.name!r} of the intensity {load.intensity}")
        if not load.joints.keys() <= joints:
            raise ValueError(f"a load {load.name!r} on joints that are not there")
    if not {name for cable in net.cables.values() for name in cable.joints} - {None} <= joints:
        raise ValueError("a cable that is fixed to a joint that is not there")
    ends = [end for bar in state.frame.bars.values() for end in (bar.start, bar.end)]
    if any(isinstance(end, Joint) and end not in state.frame.joints for end in ends):
        raise ValueError("a bar that ends at a joint that is not there")
    for pond in loads.ponds:
        if not (pond.weight > 0 and pond.side in (-1, 1)):
            raise ValueError(f"a pond {pond.name!r} of {pond.weight} on the side {pond.side}")
        if unknown := set(pond.parts) - set(parts):
            raise ValueError(f"ponds on parts {sorted(unknown)}, which the mesh has not")
    air = state.air.sealed
    if air is not None and not min(air.volume, air.absolute) > 0:
        raise ValueError(f"sealed air that is none, {air}")
    nodes = [node for one in net.cables.values() for node in one.nodes]
    supports = [node.point.support for node in nodes if node.point is not None]
    ids = [*chain(*supports, *(crossing.support for crossing in net.crossings))]
    ids += [] if net.strip is None else net.strip.complete
    ids += [end.number for end in ends if isinstance(end, MeshVertex)]
    if ids and not 0 <= min(ids) <= max(ids) < n_vertices:
        raise ValueError(f"vertices {min(ids)} to {max(ids)} of a mesh with {n_vertices}")
    numbers = range(len(net.cables))
    if any(k.lower not in numbers or k.upper not in numbers for k in net.crossings):
        raise ValueError("a crossing of cables that are not there")
    names = {cable.name for cable in net.cables}
    if any(not names >= {*clamp.cables} for clamp in net.clamps):
        raise ValueError("a clamp of cables that are not there")
    for node in nodes:
        if (node.point is None) != (node.kind == "anchor"):
            raise ValueError(f"a node of kind {node.kind!r} with the point {node.point!r}")
        if node.crossing is not None and node.crossing not in range(len(net.crossings)):
            raise ValueError(f"a node of the crossing {node.crossing}, which is not there")
    for one in net.cables.values():
        if one.parts is not None and len(one.parts.tensions) != len(one.parts.at) + 1:
            raise ValueError("a cable whose tensions are not those of its parts between clamps")
        if one.axial is not None and len(one.axial.rest) != len(one.axial.curve.arc):
            raise ValueError("a cable whose unstressed arcs are not those of its curve")


def fingerprint(scene: Scene) -> dict[str, Any]:
    """What a script must rebuild identically, as numbers and texts by name. Collective."""
    refuse_history(scene)
    mesh = scene.mesh.mesh
    cells = cell_vertex_ids(mesh)
    first = scene.membrane.first_materials
    tags = np.zeros((len(cells), 1), dtype=np.int64)
    if scene.membrane.cell_tags is not None:
        tags[:, 0] = scene.membrane.cell_tags.values
    frames, shapes = scene.membrane.frames, None
    if frames is not None:
        rounded = np.rint(1e8 * frames.reshape(-1, 6)).astype(np.int64)
        shapes = mixed(scene, np.hstack([cells, rounded]))
    warps = None
    if frames is None and any(callable(one.warp) for one in first.values()):
        ways = np.zeros((len(cells), 3))
        for tag, one in first.items():
            if callable(one.warp):
                own = np.flatnonzero(tags[:, 0] == tag).astype(np.int32)
                ways[own] = warp_field(mesh, one, own).x.array.reshape(-1, 3)[own]
        warps = mixed(scene, np.hstack([cells, np.rint(1e8 * ways).astype(np.int64)]))
    return {
        "number of vertices": mesh.topology.index_map(0).size_global,
        "number of cells": mesh.topology.index_map(2).size_global,
        "cells (their vertices, mixed to one number)": mixed(scene, cells),
        "materials": [described(one) for one in first.values()],
        "warp (directions in the cells, mixed to one number)": warps,
        "cells of the materials (mixed to one number)": mixed(scene, np.hstack([cells, tags])),
        "stress-free shapes of the cells (mixed to one number)": shapes,
        "strain": scene.strain_law,
        "pressure": scene.pressure_law,
        "penalty": scene.penalty,
        "literal_penalty": scene.literal_penalty,
        "added terms": [term.name for term in scene.terms],
    }


def refuse_history(scene: Scene) -> None:
    """Refuse to checkpoint a scene whose terms have a history that would be lost."""
    for term in scene.terms:
        if term.has_history:
            raise InputError(
                f"the term {term.name!r} has a history, which checkpoints do not keep; do without "
                "checkpoints (resume=None), or without the term"
            )


def check_same(saved: dict[str, Any], scene: Scene) -> None:
    """Refuse a scene that does not match a saved fingerprint. Collective."""
    for name, value in fingerprint(scene).items():
        was = saved.get(name)
        if not _same(was, value):
            raise InputError(
                f"load: the checkpoint is of another scene: {name} {was!r}, and here {value!r}; "
                "build the mesh and the scene as they were when it was saved"
            )


def _same(a: object, b: object) -> bool:
    """Whether two values agree, numbers up to rounding."""
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=1e-12)
    return a == b


def described(material: MembraneMaterial) -> list[Any]:
    """A material as numbers and texts."""
    warp = material.warp
    direction = "a function" if callable(warp) else warp if warp is None else [*map(float, warp)]
    values = [*encode(numbers(material)).values()]
    if isinstance(material, UflMembrane):
        values += material.samples
    return [type(material).__name__, values, direction]


def mixed(scene: Scene, rows: Integers) -> str:
    """Hash of all ranks' integer rows, independent of their order. Collective."""
    return digest(scene.comm, np.zeros(len(rows), dtype=np.int64), rows)
