"""The current surface with fields on it: this rank's piece, and the whole on the first rank."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from mpi4py import MPI

from crms_fenicsx.cables.deformed_surface import CurrentSurface
from crms_fenicsx.dofs.layout import vertex_starts
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.views.data import Surface


def surface_piece(
    membrane: Membrane, shape: CurrentSurface, fields: Mapping[str, Array]
) -> Surface:
    """This rank's piece of the surface, with the points' "displacement". Collective.

    Shapes: fields (n,).
    """
    return Surface(
        shape.points,
        shape.triangles,
        {"displacement": shape.points - shape.stress_free},
        {name: values[shape.parents] for name, values in fields.items()},
        _homes(membrane, len(shape.points)),
    )


def _homes(membrane: Membrane, points: int) -> Integers:
    """Rank and number there of the points of the current surface, (points, 2). Collective.

    Vertices belong to their owners. After them come the points of cables on folded cells: each
    rank has its own, and writes them, so that those on the border of two ranks are there twice.
    """
    vertices = membrane.V.dofmap.index_map
    own, known = vertices.size_local, vertices.size_local + vertices.num_ghosts
    starts = vertex_starts(membrane.V)
    homes = np.full((points, 2), membrane.comm.rank, dtype=np.int64)
    homes[:own, 1] = np.arange(own)
    homes[own:known, 0] = vertices.owners
    homes[own:known, 1] = vertices.ghosts - starts[vertices.owners]
    homes[known:, 1] = own + np.arange(points - known)
    return homes


def whole_surface(comm: MPI.Intracomm, piece: Surface) -> Surface | None:
    """The surface of all ranks' pieces, on the first rank; None on the others. Collective."""
    pieces = comm.gather(piece)
    if pieces is None:
        return None
    homes = [np.asarray(one.homes) for one in pieces]
    own = [home[:, 0] == rank for rank, home in enumerate(homes)]
    starts = np.cumsum([0, *(np.count_nonzero(rows) for rows in own[:-1])])
    triangles = [
        (starts[home[:, 0]] + home[:, 1])[one.triangles]
        for home, one in zip(homes, pieces, strict=True)
    ]
    point_data = {"points": [one.points for one in pieces]}
    point_data |= {name: [one.point_data[name] for one in pieces] for name in piece.point_data}
    joined = {
        name: np.concatenate([np.asarray(v)[rows] for v, rows in zip(values, own, strict=True)])
        for name, values in point_data.items()
    }
    cell_data = {
        name: np.concatenate([one.cell_data[name] for one in pieces]) for name in piece.cell_data
    }
    return Surface(joined.pop("points"), np.concatenate(triangles), joined, cell_data)
