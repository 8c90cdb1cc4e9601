"""Where the vertices are when stress-free, to the last digit the same on any ranks."""

from __future__ import annotations

import numpy as np
from dolfinx import fem

from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.compat import geometry_dofmap


def vertex_places(V: fem.FunctionSpace) -> Array:
    """Stress-free positions (length) of the vertices by local degree of freedom, (n, 3).

    Those of the mesh as it was given: DOLFINx's `tabulate_dof_coordinates` maps them from the
    reference cell, which rounds differently from one of the cells around a vertex to another, and
    which of them it takes depends on how the mesh is shared out.
    """
    vertices = V.dofmap.index_map
    places = np.zeros((vertices.size_local + vertices.num_ghosts, 3))
    places[V.dofmap.list] = V.mesh.geometry.x[geometry_dofmap(V.mesh)]
    return places
