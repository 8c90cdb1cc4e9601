"""Ponding water on a membrane, up to a given level or of a given volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.meshes.membrane_mesh import cells_of
from crms_fenicsx.foundation.meshes.triangles import cell_normals, double_areas
from crms_fenicsx.foundation.runtime.arrays import Booleans
from crms_fenicsx.foundation.runtime.errors import InputError, as_text, raised_together
from crms_fenicsx.model.membrane import Membrane

UPRIGHT = 1e-6
"""Plan area over surface area above which cells have an upper side."""


@dataclass(frozen=True)
class Pond:
    """Water on a membrane.

    Attributes
    ----------
    name
        Name in load steps, history and checkpoints.
    weight
        Specific weight (force / length cubed) at the factor 1.
    given
        Which of "level" and "volume" is prescribed.
    level
        Height z of the water surface (length).
    volume
        Volume of water (length cubed).
    parts
        Names of the mesh parts it stands on; if empty, all cells whose `side` faces up.
    side
        1 if it stands on the outer side of the cells, else -1.
    factor
        Load factor of the weight, changed by load steps.
    """

    name: str
    weight: float
    given: Literal["level", "volume"]
    level: float
    volume: float
    parts: tuple[str, ...]
    side: int
    factor: float = 0.0

    def cells(self, membrane: Membrane) -> Booleans:
        """Whether water can stand on this rank's cells, (m,)."""
        if self.parts:
            return cells_of(membrane.mesh, self.parts)
        up: Booleans = self.side * cell_normals(membrane.mesh.mesh)[:, 2] > -UPRIGHT
        return up


def upper_side(pond: Pond, membrane: Membrane) -> int:
    """The side (1 or -1) of a pond's cells that faces up. Collective."""
    mesh, comm = membrane.mesh, membrane.comm
    none = InputError(
        f"put_pond: the cells of {pond.name!r} have no upper side; name the parts of the "
        'roof, as in on=["roof"].'
    )
    if not pond.parts:
        heights = cell_normals(mesh.mesh)[:, 2]
        up = comm.allreduce(float(heights.max(initial=-1.0)), op=MPI.MAX)
        down = comm.allreduce(float(-heights.min(initial=1.0)), op=MPI.MAX)
        if max(up, down) <= UPRIGHT:
            raise none
        return 1 if up > UPRIGHT else -1
    on = np.flatnonzero(pond.cells(membrane))
    corners = membrane.positions()[membrane.V.dofmap.list[on]]
    vectors = double_areas(corners)
    areas = np.linalg.norm(vectors, axis=1)
    plan, area = comm.allreduce(np.array([vectors[:, 2].sum(), areas.sum()]), op=MPI.SUM)
    if abs(plan) <= UPRIGHT * area:
        raise none
    side = 1 if plan > 0.0 else -1
    with raised_together(comm):
        turned = np.flatnonzero(side * vectors[:, 2] < -UPRIGHT * areas)
        if len(turned):
            part = next(name for name in pond.parts if on[turned[0]] in mesh.parts[name])
            raise InputError(
                f"put_pond: some cells of {pond.name!r} face the other way than most, as at "
                f"{as_text(corners[turned[0]].mean(axis=0))} in the part {part!r}, where water "
                'would hang below them; name the parts that face up, as in on=["roof"].'
            )
    return side
