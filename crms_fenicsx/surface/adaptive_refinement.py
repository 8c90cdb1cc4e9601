"""Meshes of which some cells are divided, and those beside them so that all fit together.

DOLFINx bisects cells at their longest sides (A. Plaza and G. F. Carey, Local refinement of
simplicial grids based on the skeleton, 2000), on all ranks at once. Of sides that are equally long
it takes the first in the cell's own order, which is the same on any number of ranks.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx.cpp.refinement import RefinementOption
from dolfinx.mesh import compute_incident_entities, refine

from crms_fenicsx.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.meshes.surface import Surface
from crms_fenicsx.runtime.arrays import Array, Indices
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.surface.mesh_refinement import CORNERS, Division, MeshRefinement


class AdaptiveRefinement(MeshRefinement):
    """A mesh and the one that is finer in some of its cells."""

    @classmethod
    def of(
        cls,
        mesh: MembraneMesh,
        marked: Indices,
        project: Callable[[Array], Array] | None = None,
    ) -> AdaptiveRefinement:
        """Divide the sides of some cells. Collective.

        Parameters
        ----------
        mesh
            The mesh.
        marked
            Local numbers of this rank's own cells whose three sides are to be divided.
        project
            As for `made`, which also tells the errors.
        """
        parents, places = _bisected(mesh, marked)

        def fitted(surface: Surface) -> Division:
            corners = surface.points[surface.cells]
            around = np.einsum("ck,mki->mci", CORNERS, corners)[parents]
            gaps = ((places[:, :, None] - around[:, None]) ** 2).sum(axis=-1)
            found = gaps.argmin(axis=-1)
            backward = np.linalg.det(CORNERS[found]) < 0
            found[backward] = found[backward][:, ::-1]
            start = found.argmin(axis=1)[:, None]
            found = np.take_along_axis(found, (start + np.arange(3)) % 3, axis=1)
            order = np.lexsort((*found.T[::-1], parents))
            return Division(parents[order], found[order])

        return cls.made(mesh, fitted, project)


def _bisected(mesh: MembraneMesh, marked: Indices) -> tuple[Array, Array]:
    """The finer cells' parents (k,) and the places of their corners (k, 3, 3). Collective.

    They are all on rank 0, in any order; elsewhere there are none.
    """
    topology, comm = mesh.mesh.topology, mesh.comm
    edges = compute_incident_entities(topology, marked, 2, 1)
    finer, parents, _ = refine(
        mesh.mesh, edges, partitioner=None, option=RefinementOption.parent_cell
    )
    own = finer.topology.index_map(2).size_local
    parts = comm.gather((
        topology.original_cell_index[parents],  # of the cells as DOLFINx has made them
        finer.topology.original_cell_index[:own],  # of which these are the numbers now
        finer.geometry.x[geometry_dofmap(finer)[:own]],
    ))  # fmt: skip
    if parts is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3))
    given, numbers, places = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return given[numbers], places
