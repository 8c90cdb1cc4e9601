"""Mesh refinement: all cells divided into four, or some of them bisected.

Rank 0 makes the finer mesh, as it makes all meshes. Vertices keep their numbers; the midpoint of
the k-th divided edge, in the order of `EdgeTable`, is vertex n + k. The result is therefore
independent of the number of ranks. Child cells stay on the rank of their parent.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx.cpp.refinement import RefinementOption
from dolfinx.mesh import compute_incident_entities
from dolfinx.mesh import refine as bisect
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, distribute, gathered
from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface
from crms_fenicsx.foundation.meshes.surface import EMPTY, CheckedSurface, Projection, check_areas
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import PerRank, collective
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together

CORNERS = np.array([(2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (0, 1, 1), (1, 0, 1)]) / 2
"""Barycentric coordinates of the possible child vertices: a cell's corners, and the midpoints of
its sides 0-1, 1-2 and 2-0."""
QUARTERS = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))
"""Rows of `CORNERS` of a cell's four children."""


@collective
def refine(
    mesh: MembraneMesh,
    cells: PerRank[ArrayLike | None] = None,
    *,
    project: Callable[[Array], Array] | None = None,
) -> MembraneMesh:
    """Divide all cells of a mesh into four, or bisect some of them. Collective.

    Groups and vertices are kept. DOLFINx bisects cells at their longest sides, and neighbours to
    keep the mesh conforming (A. Plaza and G. F. Carey, Local refinement of simplicial grids based
    on the skeleton, 2000): apart from the projection of new vertices on the surface, no angle drops
    below half the smallest one of the initial mesh.

    Parameters
    ----------
    mesh
        The mesh; it is not changed.
    cells : (n,)
        Local numbers of this rank's own cells to bisect, as in `mesh.parts`; None divides all
        cells.
    project
        Projection of new vertices: a function of points (3, n) near the stress-free surface that
        returns points (3, n) on it (length). By default the surface of the generator (circle,
        ellipse, spherical cap, air hall) or an earlier `project`; for meshes from arrays and files,
        the smooth surface approximated by the facets, with straight boundary edges, seams and
        ridges.

    Returns
    -------
    MembraneMesh
        The finer mesh.

    Raises
    ------
    InputError
        On all ranks: cells not owned by this rank, or invalid values of `project`.
    MeshError
        On all ranks: points that make cells degenerate.

    Examples
    --------
    >>> coarse = meshes.spherical_cap(MPI.COMM_WORLD, 20.0, 10.0, size=8.0)
    >>> fine = meshes.refine(coarse)
    >>> bisected = meshes.refine(coarse, [0, 1, 2])
    """
    with raised_together(mesh.comm):
        chosen = None if cells is None else _checked_cells(mesh, cells)
        onto = mesh.project if project is None else _checked(project)
    bisected = None if chosen is None else _bisected(mesh, chosen)
    surface, ranks = gathered(mesh)
    finer, m = EMPTY, len(surface.cells)
    parents, corners = np.repeat(np.arange(m), 4), np.tile(QUARTERS, (m, 1))
    with raised_together(mesh.comm):
        if mesh.comm.rank == 0:
            if bisected is not None:
                parents, corners = _fitted(surface, *bisected)
            finer = _divided(surface, parents, corners, onto)
    return distribute(mesh.comm, finer, ranks[parents], onto)


def _fitted(surface: CheckedSurface, parents: Integers, places: Array) -> tuple[Integers, Integers]:
    """Parents and corners, as of `_divided`, from parents (k,) and positions of corners (k, 3, 3)
    of DOLFINx's child cells."""
    corners = surface.points[surface.cells]
    around = np.einsum("ck,mki->mci", CORNERS, corners)[parents]
    gaps = ((places[:, :, None] - around[:, None]) ** 2).sum(axis=-1)
    found = gaps.argmin(axis=-1)
    backward = np.linalg.det(CORNERS[found]) < 0
    found[backward] = found[backward][:, ::-1]
    start = found.argmin(axis=1)[:, None]
    found = np.take_along_axis(found, (start + np.arange(3)) % 3, axis=1)
    order = np.lexsort((*found.T[::-1], parents))
    return parents[order], found[order]


def _bisected(mesh: MembraneMesh, marked: Indices) -> tuple[Integers, Array]:
    """Children's parents (k,) and corners (k, 3, 3), in any order, on rank 0. Collective."""
    # Of equally long sides DOLFINx takes the first in the cell's own order, which does not depend
    # on the number of ranks.
    topology, comm = mesh.mesh.topology, mesh.comm
    edges = compute_incident_entities(topology, marked, 2, 1)
    finer, parents, _ = bisect(
        mesh.mesh, edges, partitioner=None, option=RefinementOption.parent_cell
    )
    own = finer.topology.index_map(2).size_local
    parts = comm.gather((
        topology.original_cell_index[parents],  # indices into DOLFINx's input cells
        finer.topology.original_cell_index[:own],  # input index of each child
        finer.geometry.x[geometry_dofmap(finer)[:own]],
    ))  # fmt: skip
    if parts is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3))
    given, numbers, places = (np.concatenate([part[k] for part in parts]) for k in range(3))
    return given[numbers], places


def _checked_cells(mesh: MembraneMesh, cells: ArrayLike) -> Indices:
    """Check local numbers of this rank's own cells."""
    found, own = np.asarray(cells), mesh.mesh.topology.index_map(2).size_local
    if found.size == 0:
        return np.zeros(0, dtype=np.int32)
    if found.ndim != 1 or found.dtype.kind not in "iu":
        raise InputError(
            f"refine: cells is an array of shape {found.shape} and type {found.dtype}; pass the "
            "local numbers of cells, whole numbers of shape (n,)."
        )
    if found.min() < 0 or found.max() >= own:
        raise InputError(
            f"refine: cells names {found.min() if found.min() < 0 else found.max()}, but this rank "
            f"owns the cells 0 to {own - 1} of the mesh; pass its local numbers on each rank."
        )
    return found.astype(np.int32)


def _checked(project: Callable[[Array], Array]) -> Projection:
    """Wrap a user's projection so that its values are checked."""
    if not callable(project):
        raise InputError(
            f"project = {project!r} is not a function; pass one of points (3, n) that returns "
            "those in the surface, (3, n)."
        )

    def onto(points: Array, on_rim: Booleans) -> Array:
        return checks.returned("project", project(points.copy()), points, points.shape)

    return onto


def _divided(
    surface: CheckedSurface, parents: Integers, corners: Integers, onto: Projection | None
) -> CheckedSurface:
    """The surface of child cells: their parents (k,), ascending, and corners as rows of `CORNERS`
    (k, 3), in the parent's orientation. An undivided cell is its own only child."""
    n = len(surface.points)
    table = EdgeTable.of(surface.cells)
    sides = np.empty((len(surface.cells), 3), dtype=np.int64)  # edge of each side
    sides.ravel()[table.order] = np.repeat(np.arange(len(table.counts)), table.counts)
    middle = np.full(len(table.counts), -1)
    own, k = np.nonzero(corners >= 3)
    middle[sides[parents[own], corners[own, k] - 3]] = 0
    split = np.flatnonzero(middle == 0)
    middle[split] = n + np.arange(len(split))
    around = np.concatenate([surface.cells, middle[sides]], axis=1)
    cells = np.take_along_axis(around[parents], corners, axis=1)
    ends = table.vertices[split]
    middles = surface.points[ends].mean(axis=1)
    if onto is not None:
        middles = onto(middles.T, table.counts[split] == 1).T
    else:
        smooth = SmoothSurface.of(surface.points, surface.cells)
        both = np.column_stack([ends, ends[:, 0]])
        middles = middles + smooth.raised(both, np.tile([0.5, 0.5, 0.0], (len(both), 1)))[0]
    points = np.concatenate([surface.points, middles])
    check_areas(points, cells)

    def parts(keys: Integers) -> Integers:
        at = middle[np.searchsorted(table.keys, keys)]
        ends = np.stack([keys >> 32, keys & 0xFFFFFFFF])[:, at >= 0]
        halves = edge_keys(np.stack([ends, np.broadcast_to(at[at >= 0], ends.shape)], axis=-1))
        return np.unique(np.concatenate([keys[at < 0], halves]))

    edges = {name: parts(keys) for name, keys in surface.edges.items()}
    return surface.divided(points, cells, parents, edges)
