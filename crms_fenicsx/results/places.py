"""Locate users' points on the surface and evaluate results there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.cabling.cables.deformed_surface import CurrentSurface
from crms_fenicsx.foundation.meshes.triangles import (
    WALL,
    closest,
    double_areas,
    flattened,
    longest_sides,
    mix,
    norm,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.foundation.surface.closest_point import ON_SURFACE, RIM, Balls
from crms_fenicsx.results.quantities import shown_briefly


@dataclass(frozen=True, repr=False)
class PlaceResults:
    """Results at points of the surface, the same on all ranks.

    Attributes
    ----------
    positions, stress_free : (k, 3)
        The points on the current and on the stress-free surface (length).
    values
        Cell values by name, (k,) each; ``self[name]`` is short for it.
    """

    positions: Array
    stress_free: Array
    values: dict[str, Array]

    def __repr__(self) -> str:
        """One line."""
        values = ", ".join(f"{name} {span(self[name])}" for name in shown_briefly(self.values))
        return f"PlaceResults({counted(len(self.positions), 'place')}: {values} ...)"

    @property
    def displacement(self) -> Array:
        """Displacement from the stress-free position, (k, 3) (length)."""
        return self.positions - self.stress_free

    def __getitem__(self, name: str) -> Array:
        """Values by name, (k,)."""
        return checks.named("result", self.values, name)


@dataclass(frozen=True)
class Places:
    """Points of a surface distributed over ranks."""

    comm: MPI.Intracomm  # communicator
    mine: Booleans  # (k,) points in this rank's facets
    cells: Integers  # (k,) local cells, arbitrary for another rank's points
    # positions, stress_free: (k, 3) current and stress-free, on all ranks (length)
    positions: Array
    stress_free: Array
    corners: Array  # (n, 3) first the stress-free vertices by local degree of freedom (length)
    # (k,) distances from the requested points, relative to their facets' longest sides
    gaps: Array

    def of_cells(self, values: Array) -> Array:
        """Values (k,) of the cells that contain the points. Collective."""
        found = np.zeros(len(self.mine))
        found[self.mine] = values[self.cells[self.mine]]
        return np.asarray(self.comm.allreduce(found))

    def interpolated(self, function: fem.Function) -> Array:
        """Values of a linear function on the stress-free mesh, (k,). Collective."""
        dofs: Indices = function.function_space.dofmap.list[self.cells[self.mine]]
        weights, _, _ = closest(self.corners[dofs], self.stress_free[self.mine])
        found = np.zeros(len(self.mine))
        found[self.mine] = (weights * function.x.array[dofs]).sum(axis=1)
        return np.asarray(self.comm.allreduce(found))


def find_places(
    comm: MPI.Intracomm,
    surface: CurrentSurface,
    points: ArrayLike,
    on: Literal["current", "stress-free"],
) -> Places:
    """Find the facets that contain points. Collective."""
    targets, in_plan = _checked(points)
    places = nearest_places(comm, surface, targets, on, in_plan=in_plan)
    off = np.flatnonzero(places.gaps > (RIM if in_plan else ON_SURFACE))
    if len(off):
        k = int(off[0])
        target = targets[k, :2] if in_plan else targets[k]
        nearest = (places.positions if on == "current" else places.stress_free)[k]
        raise InputError(
            f"at: point {k} at {as_text(target)} is "
            f"{np.linalg.norm(nearest[: len(target)] - target):.6g} off the {on} surface, nearest "
            f"to {as_text(nearest)}; pass a place on it."
        )
    return places


def nearest_places(
    comm: MPI.Intracomm,
    surface: CurrentSurface,
    targets: Array,
    on: Literal["current", "stress-free"],
    *,
    in_plan: bool = False,
) -> Places:
    """Find the points of the surface nearest to targets (k, 3) (length). Collective."""
    corners = (surface.points if on == "current" else surface.stress_free)[surface.triangles]
    rows, weights, scores, sizes = _candidates(corners, targets, in_plan)
    every = np.array(comm.allgather(scores))
    rank = np.array([np.lexsort(every[:, k].T[::-1])[0] for k in range(len(scores))])
    best = every[rank, np.arange(len(scores))]
    if np.isinf(best).any():
        raise InputError("at: the membrane has no plan, only walls; pass places in space, (k, 3).")
    mine = rank == comm.rank
    size = np.asarray(comm.allreduce(np.where(mine, sizes, 0.0)))
    given = [np.zeros((len(targets), 3)), np.zeros((len(targets), 3))]
    for found, places in zip(given, (surface.points, surface.stress_free), strict=True):
        found[mine] = mix(weights[mine], places[surface.triangles[rows[mine]]])
    positions, stress_free = (np.asarray(comm.allreduce(found)) for found in given)
    cells = np.zeros(len(targets), dtype=np.int64)
    cells[mine] = surface.parents[rows[mine]]
    gaps = best[:, 0] / size
    return Places(comm, mine, cells, positions, stress_free, surface.stress_free, gaps)


def _checked(points: ArrayLike) -> tuple[Array, bool]:
    """The points as (k, 3), and whether they are in plan, with z = 0."""
    try:
        array = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim != 2 or array.shape[1] not in (2, 3) or not len(array):
        raise InputError(
            f"at: points = {points!r} must be places in plan, (k, 2), or in space, (k, 3), as in "
            "[(3.0, 4.0)]."
        )
    if not np.isfinite(array).all():
        raise InputError(f"at: points = {points!r} are not finite; pass finite coordinates.")
    in_plan = array.shape[1] == 2
    return (np.pad(array, ((0, 0), (0, 1))) if in_plan else array), in_plan


def _candidates(
    corners: Array, targets: Array, in_plan: bool
) -> tuple[Integers, Array, Array, Array]:
    """This rank's best facets (k,), weights (k, 3), scores (k, 2) and sizes (k,) for each
    target."""
    k = len(targets)
    rows, weights = np.zeros(k, dtype=np.int64), np.zeros((k, 3))
    scores, sizes = np.full((k, 2), np.inf), np.zeros(k)
    usable: Integers = np.arange(len(corners))
    flat = corners
    if in_plan:  # vertical facets have no area in plan
        flat = flattened(corners)
        usable = usable[norm(double_areas(flat)) > WALL * norm(double_areas(corners))]
    if not len(usable):
        return rows, weights, scores, sizes
    triangles = flat[usable]
    target, near = Balls.of(triangles).nearest(targets)
    share, _, gaps = closest(triangles[near], targets[target])
    size = longest_sides(triangles[near])
    gaps = np.where(gaps <= 1e-9 * size, 0.0, gaps)
    depth = -mix(share, corners[usable[near]])[:, 2] if in_plan else np.zeros(len(near))
    order = np.lexsort((near, depth, gaps, target))
    chosen = order[np.unique(target[order], return_index=True)[1]]
    rows, weights, sizes = usable[near[chosen]], share[chosen], size[chosen]
    return rows, weights, np.stack([gaps, depth], axis=1)[chosen], sizes
