"""Strains and section forces of the membrane's cells as tensors in their material axes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.runtime.arrays import Array, Booleans
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.scene import Scene


@dataclass(frozen=True)
class CellTensors:
    """Tensors in the material axes of this rank's owned cells."""

    # strains, forces: (n, 2, 2) Green-Lagrange strains, second Piola-Kirchhoff section forces
    # (force per length)
    strains: Array
    forces: Array
    # axes, images: (n, 2, 3) the material axes, unit vectors, and what they have become
    axes: Array
    images: Array
    sides: Array  # (n, 2, 3) two stress-free sides of each cell (length)
    state: npt.NDArray[np.int8]  # (n,) 2 taut, 1 wrinkled, 0 slack
    # (n,) whether a cable in tension folds the cell; its images are those of its three corners
    folded: Booleans


def cell_tensors(system: System) -> CellTensors:
    """Evaluate the cells at the scene's current state; see `membrane_results`. Collective."""
    system.update()
    scene, membrane = system.scene, system.membrane.energy
    values = membrane.cell_results()
    n = len(values)
    folded = np.zeros(n, dtype=bool)
    if system.cables is not None and system.cables.tables is not None:
        # It leaves the folded cells' values behind, and is collective: ranks without any join in.
        system.potential.sum_up()
        cells = system.cables.tables.folded.cells
        if len(cells):
            values[cells] = system.cables.folds.energy.cell_results()
            folded[cells] = True
    E = _symmetric(values[:, 0], values[:, 1], values[:, 2] / 2)
    S = _symmetric(values[:, 3], values[:, 4], values[:, 5])

    axes = membrane.material_axes(np.arange(n, dtype=np.int32))
    before, after = _edge_vectors(scene)
    # Columns of F are the current images of the material axes: edges = components x images.
    components = np.einsum("nki,nai->nka", before, axes)
    images = np.linalg.solve(components, after)
    state = np.rint(values[:, 6]).astype(np.int8)
    return CellTensors(E, S, axes, images, before, state, folded)


def added_forces(scene: Scene, axes: Array) -> Array:
    """Section forces that added terms put in the cells, in axes (n, 2, 3) of theirs, (n, 2, 2)."""
    found = np.zeros((len(axes), 2, 2))
    for term in scene.terms:
        if term.section_forces is not None:
            own = term.section_forces[: len(axes)]
            found += np.einsum("nai,nij,nbj->nab", axes, own, axes)
    return found


def _symmetric(a: Array, b: Array, c: Array) -> Array:
    """Matrices (n, 2, 2) with diagonal a, b and c off it."""
    return np.stack([np.stack([a, c], axis=-1), np.stack([c, b], axis=-1)], axis=-2)


def _edge_vectors(scene: Scene) -> tuple[Array, Array]:
    """Two sides of the owned cells, stress-free and current, (n, 2, 3) each."""
    mesh = scene.mesh.mesh
    owned = mesh.topology.index_map(2).size_local
    x = mesh.geometry.x[geometry_dofmap(mesh)[:owned]]
    u = scene.u.x.array.reshape(-1, 3)[scene.V.dofmap.list[:owned]]
    before: Array = np.asarray(x[:, 1:] - x[:, :1], dtype=np.float64)
    return before, before + (u[:, 1:] - u[:, :1])
