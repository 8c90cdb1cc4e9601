"""Checks that arrays describe an orientable triangulated surface, before it is distributed."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys, hidden_cells
from crms_fenicsx.foundation.meshes.orientation import Outside, connected_labels, oriented
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import MeshError, as_text

BOUNDARY = "boundary"
"""Reserved name of the group of all edges with one cell."""

Projection = Callable[[Array, Booleans], Array]
"""Projects points (3, n) near a surface onto it, and those on its rim (n,) onto the rim."""

_DEGENERATE = 1e-10  # area / (longest edge)^2; a sliver of aspect ratio 1e4 has 5e-5


@dataclass(frozen=True)
class SurfaceArrays:
    """A surface from a generator or a reader, in the form of `from_arrays`."""

    points: ArrayLike
    cells: ArrayLike
    edges: Mapping[str, ArrayLike] = field(default_factory=dict)
    parts: Mapping[str, ArrayLike] = field(default_factory=dict)
    point_groups: Mapping[str, ArrayLike] = field(default_factory=dict)
    project: Projection | None = None  # to the surface that the cells approximate


@dataclass(frozen=True)
class CheckedSurface:
    """A checked and oriented surface, all on one rank."""

    points: Array = field(default_factory=lambda: np.zeros((0, 3)))  # (n, 3) coordinates (length)
    # (m, 3) vertices of the cells; all normals of a piece on its outer side
    cells: Integers = field(default_factory=lambda: np.zeros((0, 3), dtype=np.int64))
    # `edge_keys` of the edges of each group, including "boundary"
    edges: dict[str, Integers] = field(default_factory=dict)
    parts: dict[str, Integers] = field(default_factory=dict)  # cell indices of each group
    point_groups: dict[str, Integers] = field(default_factory=dict)  # vertex indices
    # (k, 2) pairs of cells that link all cells of each seam
    seam_links: Integers = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    # indices of the cells of pieces behind seams, see `hidden_cells`
    hidden: Integers = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def divided(
        self, points: Array, cells: Integers, parents: Integers, edges: dict[str, Integers]
    ) -> CheckedSurface:
        """The surface with other points, and the cells (m, 3) into which its cells `parents` (m,)
        have been divided."""

        def children(numbers: Integers) -> Integers:
            return np.flatnonzero(np.isin(parents, numbers))

        table = EdgeTable.of(cells)
        return CheckedSurface(
            points,
            cells,
            edges | {BOUNDARY: table.keys[table.counts == 1]},
            {name: children(members) for name, members in self.parts.items()},
            self.point_groups,
            table.seam_links(),
            children(self.hidden),
        )


EMPTY = CheckedSurface()
"""The surface on ranks other than 0."""


def checked_surface(arrays: SurfaceArrays, outside: Outside) -> CheckedSurface:
    """Check arrays and orient their cells."""
    points = _coordinates(arrays.points)
    cells = _cells(arrays.cells, points)
    check_shapes(points, cells)
    table = EdgeTable.of(cells)
    _check_fans(points, cells, table)
    parts = _index_groups(arrays.parts, "part", "cells", len(cells))
    cells, piece = oriented(points, cells, table, outside, parts)
    return CheckedSurface(
        points,
        cells,
        _edge_groups(arrays.edges, points, table),
        parts,
        _index_groups(arrays.point_groups, "point group", "vertices", len(points)),
        table.seam_links(),
        hidden_cells(points, cells, piece),
    )


def _place(points: Array, vertex: int) -> str:
    return f"vertex {vertex} at {as_text(points[vertex])}"


def _places(points: Array, vertices: Integers) -> str:
    return ", ".join(_place(points, int(vertex)) for vertex in vertices)


def _coordinates(given: ArrayLike) -> Array:
    try:
        points = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise MeshError(f"the points are not an array of numbers ({error}).") from None
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise MeshError(f"the points have shape {points.shape}; pass (n, 3) or (n, 2) coordinates.")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise MeshError(
            f"vertex {bad[0]} has the coordinates {tuple(points[bad[0]].tolist())}; "
            "pass finite coordinates."
        )
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return np.ascontiguousarray(points)


def _integers(given: ArrayLike, what: str) -> Integers:
    try:
        array: NDArray[Any] = np.asarray(given)
    except ValueError as error:  # rows of different lengths
        raise MeshError(f"{what} are not an array ({error}).") from None
    if array.size and array.dtype.kind not in "iu":
        raise MeshError(f"{what} have the type {array.dtype}; pass integer indices, from 0.")
    return array.astype(np.int64)


def _cells(given: ArrayLike, points: Array) -> Integers:
    cells = _integers(given, "the cells")
    if cells.size == 0:
        raise MeshError("the mesh has no cells; pass at least one triangle.")
    if cells.ndim != 2 or cells.shape[1] != 3:
        raise MeshError(
            f"the cells have shape {cells.shape}; pass triangles, shape (m, 3), and cut other "
            "polygons into triangles."
        )
    bad = np.flatnonzero(((cells < 0) | (cells >= len(points))).any(axis=1))
    if len(bad):
        raise MeshError(
            f"cell {bad[0]} has the vertices {cells[bad[0]].tolist()}, but there are only "
            f"vertices 0 to {len(points) - 1}."
        )
    return cells


def check_areas(points: Array, cells: Integers) -> None:
    """Refuse degenerate cells."""
    corners = points[cells]
    sides = corners[:, [1, 2, 0]] - corners
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    longest = np.einsum("ijk,ijk->ij", sides, sides).max(axis=1)
    bad = np.flatnonzero(area <= _DEGENERATE * longest)
    if len(bad):
        raise MeshError(
            f"cell {bad[0]} has no area; its vertices are {_places(points, cells[bad[0]])}; "
            "remove it or move a vertex."
        )


def check_shapes(points: Array, cells: Integers) -> None:
    """Refuse degenerate cells, duplicate cells and loose vertices."""
    check_areas(points, cells)
    triples = np.sort(cells, axis=1)
    order = np.lexsort(triples.T)
    same = np.flatnonzero((np.diff(triples[order], axis=0) == 0).all(axis=1))
    if len(same):
        one, two = sorted(order[same[0] : same[0] + 2].tolist())
        raise MeshError(
            f"cells {one} and {two} have the same vertices, {_places(points, triples[one])}; "
            "remove one of them."
        )
    loose = np.flatnonzero(np.bincount(cells.ravel(), minlength=len(points)) == 0)
    if len(loose):
        raise MeshError(
            f"{_place(points, loose[0])} belongs to no cell ({len(loose)} such vertices); "
            "remove it and renumber the others."
        )


def _check_fans(points: Array, cells: Integers, table: EdgeTable) -> None:
    """Refuse vertices where separate fans touch; an edge of any number of cells joins fans."""
    first, second = table.linked_sides(table.counts >= 2)
    next_corner = np.arange(cells.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    alike = table.ascending[first] == table.ascending[second]
    starts = np.where(alike, second, next_corner[second])
    ends = np.where(alike, next_corner[second], second)
    fan = connected_labels(
        cells.size,
        np.concatenate([first, next_corner[first]]),
        np.concatenate([starts, ends]),
    )
    corner_of_fan = np.unique(fan, return_index=True)[1]
    fans = np.bincount(cells.ravel()[corner_of_fan])
    bad = np.flatnonzero(fans > 1)
    if len(bad):
        raise MeshError(
            f"at {_place(points, int(bad[0]))} {fans[bad[0]]} separate parts of the membrane "
            "touch in nothing but this vertex; use a separate vertex for each, or join "
            "them along an edge."
        )


def _members(
    groups: Mapping[str, ArrayLike], kind: str, items: str
) -> Iterator[tuple[str, Integers]]:
    """Names of the groups, with their integer members."""
    if not isinstance(groups, Mapping):
        raise MeshError(f"the {kind}s are {groups!r}; pass a mapping of names to members.")
    for name, given in groups.items():
        if not isinstance(name, str) or not name.strip():
            raise MeshError(f"the {kind} {name!r} has no name; pass a non-empty string.")
        yield name, _integers(given, f"the {items} of {kind} '{name}'")


def _edge_groups(
    groups: Mapping[str, ArrayLike], points: Array, table: EdgeTable
) -> dict[str, Integers]:
    checked = {BOUNDARY: table.keys[table.counts == 1]}
    for name, pairs in _members(groups, "edge group", "edges"):
        if pairs.size == 0:
            raise MeshError(f"edge group '{name}' is empty; leave it out or add an edge.")
        if pairs.ndim != 2 or pairs.shape[1] != 2:
            raise MeshError(
                f"edge group '{name}' has shape {pairs.shape}; pass pairs of vertices, (k, 2)."
            )
        _check_range(pairs, f"edge group '{name}'", "vertices", len(points))
        keys = np.unique(edge_keys(pairs))
        missing = keys[~np.isin(keys, table.keys, assume_unique=True)]
        if len(missing):
            pair = np.array([missing[0] >> 32, missing[0] & 0xFFFFFFFF])
            raise MeshError(
                f"edge group '{name}' has a pair that is not an edge of the mesh: "
                f"{_places(points, pair)}; name only sides of triangles."
            )
        if name == BOUNDARY and not np.array_equal(keys, np.sort(checked[BOUNDARY])):
            raise MeshError(
                f"edge group '{BOUNDARY}' has {len(keys)} edges, but that name is reserved for "
                f"all {len(checked[BOUNDARY])} edges with one cell; choose another name."
            )
        checked[name] = keys
    return checked


def _index_groups(
    groups: Mapping[str, ArrayLike], kind: str, items: str, count: int
) -> dict[str, Integers]:
    checked = {}
    for name, indices in _members(groups, kind, items):
        if indices.size == 0:
            raise MeshError(f"{kind} '{name}' is empty; leave it out or add {items}.")
        if indices.ndim != 1:
            raise MeshError(f"{kind} '{name}' has shape {indices.shape}; pass a list of {items}.")
        _check_range(indices, f"{kind} '{name}'", items, count)
        checked[name] = np.unique(indices)
    return checked


def _check_range(indices: Integers, what: str, items: str, count: int) -> None:
    bad = indices[(indices < 0) | (indices >= count)]
    if len(bad):
        raise MeshError(f"{what} names {bad[0]}, but there are only {items} 0 to {count - 1}.")
