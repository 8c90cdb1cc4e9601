"""Water that stands on a membrane, up to a level of its own or of the amount that there is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from mpi4py import MPI

from crms_fenicsx.meshes.triangles import cell_normals, double_areas
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Booleans
from crms_fenicsx.runtime.errors import InputError, as_text, raised_together

UPRIGHT = 1e-6
"""Area of the plan, relative to that of the surface, from which on cells have an upper side."""


@dataclass(frozen=True)
class Pond:
    """Water on a membrane.

    Attributes
    ----------
    name
        What load steps, history and checkpoints know it by.
    weight
        Weight by volume (force / length cubed) at the factor 1.
    given
        Whether the "level" or the "volume" stays as it is.
    level
        Height z of the water's surface (length).
    volume
        Amount of water (length cubed).
    parts
        Names of the parts of the mesh that it stands on; without any, where the outer side faces
        up.
    side
        1 if it stands on the outer side of the cells, else -1.
    factor
        What the weight is multiplied by; load steps change it.
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
        """Whether this rank's cells, with ghosts, can have water on them: those of its parts, or
        of the whole mesh those whose outer side, stress-free, faces as its side does."""
        known = membrane.mesh.mesh.topology.index_map(2)
        if not self.parts:
            up: Booleans = self.side * cell_normals(membrane.mesh.mesh)[:, 2] > -UPRIGHT
            return up
        cells = np.zeros(known.size_local + known.num_ghosts, dtype=bool)
        for part in self.parts:
            cells[membrane.mesh.parts[part]] = True
        return cells

    def found_side(self, membrane: Membrane) -> int:
        """The side of its cells that faces up: of the whole mesh the outer side where that faces
        up anywhere, of parts the one that faces up in the current shape. Collective.

        Raises
        ------
        InputError
            On all ranks: they stand upright, or some of the parts face up and others down.
        """
        own = membrane.mesh.mesh.topology.index_map(2).size_local
        if not self.parts:
            heights = cell_normals(membrane.mesh.mesh)[:own, 2]
            up = membrane.comm.allreduce(float(heights.max(initial=-1.0)), op=MPI.MAX)
            down = membrane.comm.allreduce(float(-heights.min(initial=1.0)), op=MPI.MAX)
            if max(up, down) <= UPRIGHT:
                raise InputError(self._no_side())
            return 1 if up > UPRIGHT else -1
        on = np.flatnonzero(self.cells(membrane)[:own])
        corners = membrane.positions()[membrane.V.dofmap.list[on]]
        vectors = double_areas(corners)
        areas = np.linalg.norm(vectors, axis=1)
        local = np.array([vectors[:, 2].sum(), areas.sum()])
        plan, area = membrane.comm.allreduce(local, op=MPI.SUM)
        if abs(plan) <= UPRIGHT * area:
            raise InputError(self._no_side())
        side = 1 if plan > 0.0 else -1
        with raised_together(membrane.comm):
            turned = np.flatnonzero(side * vectors[:, 2] < -UPRIGHT * areas)
            if len(turned):
                part = next(
                    name for name in self.parts if on[turned[0]] in membrane.mesh.parts[name]
                )
                raise InputError(
                    f"put_pond: some cells of {self.name!r} face the other way than most, as at "
                    f"{as_text(corners[turned[0]].mean(axis=0))} in the part {part!r}, where water "
                    'would hang below them; name the parts that face up, as in on=["roof"].'
                )
        return side

    def _no_side(self) -> str:
        return (
            f"put_pond: the cells of {self.name!r} have no upper side; name the parts of the "
            'roof, as in on=["roof"].'
        )
