"""Loads on the membrane as forces per area of its cells, for pictures."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array


def load_label(scene: Scene, name: str) -> tuple[str, str]:
    """Label of a load's values and the kind of unit."""
    if any(load.name == name and load.suction is not None for load in scene.loads):
        return f"c_p of {name}", ""
    return f"{name} per area", "pressure"


def load_values(scene: Scene, name: str) -> Array:
    """Load or pond in this rank's cells at factor 1, (m,). Collective.

    For wind the pressure coefficients, positive for pressure on the outer side; otherwise the
    magnitude of the force per area, averaged around vertices.
    """
    membrane, own = scene.membrane, scene.mesh.mesh.topology.index_map(2).size_local
    cells = membrane.V.dofmap.list[:own]
    corners = membrane.positions()[cells]
    for pond in scene.ponds:
        if pond.name == name:
            depth = np.maximum(pond.level - corners[..., 2].mean(axis=1), 0.0)
            return np.asarray(pond.weight * depth * pond.cells(membrane)[:own])
    load = checks.named("load", {one.name: one for one in scene.loads}, name)
    if load.suction is not None:
        return np.asarray(-load.suction[:own] / load.peak)
    forces, areas = fem.Function(membrane.V), fem.Function(membrane.nodal_values)
    forces.x.array[:] = load.forces.ravel()
    shares = norm(double_areas(corners))[:, None] / 6
    np.add.at(areas.x.array, areas.function_space.dofmap.list[:own], shares)
    for function in (forces, areas):
        function.x.scatter_reverse(la.InsertMode.add)
        function.x.scatter_forward()
    at = np.linalg.norm(forces.x.array.reshape(-1, 3), axis=1)[cells].mean(axis=1)
    around = areas.x.array[areas.function_space.dofmap.list[:own]].mean(axis=1)
    return np.asarray(at / around)
