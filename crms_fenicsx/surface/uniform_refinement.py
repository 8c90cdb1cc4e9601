"""Meshes each of whose cells is divided into four."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crms_fenicsx.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.meshes.surface import Surface
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.surface.mesh_refinement import Division, MeshRefinement

QUARTERS = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))


class UniformRefinement(MeshRefinement):
    """A mesh and the finer one that has four cells for each of its own."""

    @classmethod
    def of(
        cls, mesh: MembraneMesh, project: Callable[[Array], Array] | None = None
    ) -> UniformRefinement:
        """Divide each cell into four. Collective; all as for `made`."""

        def quarters(surface: Surface) -> Division:
            m = len(surface.cells)
            return Division(np.repeat(np.arange(m), 4), np.tile(QUARTERS, (m, 1)))

        return cls.made(mesh, quarters, project)
