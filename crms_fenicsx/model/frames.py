"""Stress-free shapes of cells that differ from the mesh, as images of unit vectors in it."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.meshes.triangles import cell_normals
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.model.tolerances import SAME_PLACE


def own_areas(frames: Array) -> Array:
    """Ratio (n,) of the areas of the cells' own stress-free shapes to those in the mesh."""
    return np.asarray(1.0 / np.linalg.norm(np.cross(frames[:, 0], frames[:, 1]), axis=1))


def checked_frames(mesh: MembraneMesh, frames: Array) -> Array:
    """Check that frames lie in this rank's cells, right-handed with the normals. Collective."""
    with raised_together(mesh.comm):
        given, normals = np.asarray(frames, dtype=float), cell_normals(mesh.mesh)
        if given.shape != (len(normals), 2, 3) or not np.isfinite(given).all():
            raise InputError(
                f"Scene: frames of shape {given.shape} for {len(normals)} cells; pass finite ones "
                "(n, 2, 3), as patterns.sew does."
            )
        sense = np.einsum("ni,ni->n", np.cross(given[:, 0], given[:, 1]), normals)
        size = np.linalg.norm(given, axis=2)
        tilt = np.abs(np.einsum("nai,ni->na", given, normals))
        if (sense <= 0.0).any() or (tilt > SAME_PLACE * size).any():
            raise InputError(
                "Scene: frames turn a cell over, or do not lie in it; pass those of patterns.sew."
            )
    return given
