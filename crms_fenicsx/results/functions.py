"""Values of cells as DOLFINx functions on the stress-free mesh."""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la

from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Array


def by_cells(membrane: Membrane, name: str, values: Array) -> fem.Function:
    """A function that is constant in each cell. Collective.

    Shapes: values (n,).
    """
    found = fem.Function(membrane.cell_values, name=name)
    found.x.array[membrane.cell_values.dofmap.list[: len(values), 0]] = values
    found.x.scatter_forward()
    return found


def nodal_means(membrane: Membrane, name: str, values: Array, areas: Array) -> fem.Function:
    """A linear function whose values at the vertices are means of the cells around. Collective.

    Shapes: values, areas (n,).
    """
    V = membrane.nodal_values
    weight, found = fem.Function(V), fem.Function(V, name=name)
    known = np.isfinite(values)
    corners = V.dofmap.list[: len(values)][known]
    for function, amount in ((weight, areas), (found, areas * values)):
        np.add.at(function.x.array, corners, amount[known, None])
        function.x.scatter_reverse(la.InsertMode.add)
        function.x.scatter_forward()
    with np.errstate(invalid="ignore"):
        found.x.array[:] /= weight.x.array
    return found
