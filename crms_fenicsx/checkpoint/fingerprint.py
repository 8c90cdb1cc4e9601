"""What tells the scene of a checkpoint from others: mesh, materials, laws."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from crms_fenicsx.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.ufl_material import UflMembrane
from crms_fenicsx.output.npy import digest
from crms_fenicsx.runtime.arrays import Integers
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene


def fingerprint(scene: Scene) -> dict[str, Any]:
    """Describe what a script must build alike, but for where the vertices are. Collective.

    Returns by name, in the order in which differences are worth telling; made of numbers and texts.
    """
    refuse_history(scene)
    mesh = scene.mesh.mesh
    cells = cell_vertex_ids(mesh)[: mesh.topology.index_map(2).size_local]
    tags = np.zeros((len(cells), 1), dtype=np.int64)
    if scene.membrane.cell_tags is not None:
        tags[:, 0] = scene.membrane.cell_tags.values[: len(cells)]
    return {
        "number of vertices": mesh.topology.index_map(0).size_global,
        "number of cells": mesh.topology.index_map(2).size_global,
        "cells (their vertices, mixed to one number)": mixed(scene, cells),
        "materials": [described(one) for one in scene.membrane.first_materials.values()],
        "cells of the materials (mixed to one number)": mixed(scene, np.hstack([cells, tags])),
        "strain": scene.strain_law,
        "pressure": scene.pressure_law,
        "penalty": scene.penalty,
        "literal_penalty": scene.literal_penalty,
        "added terms": [term.name for term in scene.terms],
    }


def refuse_history(scene: Scene) -> None:
    """Refuse to make checkpoints of a scene with terms whose history they would not keep."""
    for term in scene.terms:
        if term.has_history:
            raise InputError(
                f"the term {term.name!r} has a history, which checkpoints do not keep; do without "
                "checkpoints (resume=None), or without the term"
            )


def check_same(saved: dict[str, Any], scene: Scene) -> None:
    """Compare a scene with a fingerprint. Collective."""
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
    """A material in numbers and texts."""
    warp = material.warp
    direction = "a function" if callable(warp) else warp if warp is None else [*map(float, warp)]
    values = [float(value) for value in material.parameters]
    if isinstance(material, UflMembrane):
        values += material.samples
    return [type(material).__name__, values, direction]


def mixed(scene: Scene, rows: Integers) -> str:
    """A number of all ranks' rows of integers, whatever their order. Collective."""
    return digest(scene.comm, np.zeros(len(rows), dtype=np.int64), rows)
