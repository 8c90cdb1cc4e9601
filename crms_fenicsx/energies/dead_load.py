"""Dead load: nodal forces of the membrane that keep direction and size, as the shape changes.

Snow and weight are such loads. Wind is not: its suction stays normal to the surface, and varies
over it, and forces of that kind have no potential. Wind as a dead load keeps the normals and areas
of the shape on which it was put; see `Scene.put_load` for what error that makes and how to remove
it. (The paper's pressure, section 2.4, is a dead load in each step.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, raised_together

Traction = Sequence[float] | Array | Callable[[Array, Array], Array]
"""Force per area, (3,), or a function of points and unit normals, both (3, n), giving (3, n)."""


@dataclass(frozen=True)
class DeadForces:
    """The forces of a dead load at the factor 1.

    Attributes
    ----------
    forces : (n, 3)
        What this rank's cells give to its vertices (force), by local degree of freedom.
    intensity
        Mean size of the force per area, over the whole membrane.
    """

    forces: Array
    intensity: float


def dead_forces(membrane: Membrane, traction: Traction) -> DeadForces:
    """Forces of a load on the membrane's current shape. Collective.

    A cell gives a third of its load, taken at its centre, to each of its vertices. That a cable
    folds it changes nothing: the load goes by the triangle of its corners, and together these
    triangles cover the same surface up to the depth of the folds. Fold points get no load.

    Raises
    ------
    InputError
        As `Scene.put_load`.
    """
    cells = membrane.V.dofmap.list[: membrane.mesh.mesh.topology.index_map(2).size_local]
    corners = membrane.positions()[cells]
    sides = corners[:, 1:] - corners[:, :1]
    vectors = np.cross(sides[:, 0], sides[:, 1]) / 2
    areas = np.linalg.norm(vectors, axis=1)
    loads = np.zeros_like(vectors)
    with raised_together(membrane.comm):
        loads[:] = _tractions(traction, corners.mean(axis=1), vectors / areas[:, None])
        loads *= areas[:, None]
    forces = np.zeros((len(membrane.held), 3))
    np.add.at(forces, cells, loads[:, None] / 3)
    local = np.array([np.linalg.norm(loads, axis=1).sum(), areas.sum()])
    total, area = membrane.comm.allreduce(local)
    return DeadForces(forces, float(total / area))


def _tractions(traction: Traction, points: Array, normals: Array) -> Array:
    """Forces per area at points with unit normals, (n, 3)."""
    if not callable(traction):
        return np.broadcast_to(
            checks.vector("put_load: the force per area", traction), points.shape
        )
    given = np.asarray(traction(points.T, normals.T))
    if given.shape != points.T.shape or given.dtype.kind not in "fiu":
        raise InputError(
            f"put_load: the function returned an array of shape {given.shape} and type "
            f"{given.dtype}; it must return real numbers of shape {points.T.shape}."
        )
    bad = ~np.isfinite(given).all(axis=0)
    if bad.any():
        first = int(np.argmax(bad))
        raise InputError(
            f"put_load: the function returned {given[:, first]} at {points[first]}; it must "
            "return finite forces per area."
        )
    return np.asarray(given.T, dtype=np.float64)


class DeadLoad(EnergyTerm):
    """Potential ``-factor F . u`` of a dead load with the nodal forces F.

    Parameters
    ----------
    load
        The forces at the factor 1.

    Attributes
    ----------
    factor
        What the forces are multiplied by.
    """

    name = "dead load"

    def __init__(self, load: DeadForces) -> None:
        self.forces, self.factor = load.forces, 0.0
        self._u, self._scaled = np.zeros_like(load.forces), np.zeros_like(load.forces)

    def sums(self, x: Array, out: Array) -> None:
        """This rank's part of the work at the factor 1 (force x length)."""
        self.unknowns.read_vertices(x, self._u)
        out[0] = np.vdot(self.forces, self._u)

    def energy(self, sums: Array) -> float:
        """Minus the work of the forces since the stress-free shape (force x length)."""
        return -self.factor * float(sums[0])

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        """Subtract the forces."""
        np.multiply(self.forces, -self.factor, out=self._scaled)
        self.unknowns.add_to_vertices(self._scaled, g)
