"""Consistent orientation of the cells of each connected piece of a surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import MeshError, as_text

_VANISHING = 1e-6  # share of a piece's area below which `outside` does not tell its sides apart


@dataclass(frozen=True)
class AwayFrom:
    """The outside is the side of the membrane that faces away from a point.

    For closed or steep surfaces, where no single direction separates inside from outside.

    Parameters
    ----------
    point
        Coordinates (3 numbers, length) of a point inside.

    Examples
    --------
    >>> points = [(1.0, 0, 0), (-1.0, 1.0, 0), (-1.0, -1.0, 0), (0, 0, 1.0)]
    >>> cells = [(0, 1, 3), (1, 2, 3), (2, 0, 3)]
    >>> outside = meshes.AwayFrom((0.0, 0.0, 0.2))
    >>> mesh = meshes.from_arrays(MPI.COMM_WORLD, points, cells, outside=outside)
    """

    point: Sequence[float]


UPWARD = (0.0, 0.0, 1.0)

Side = Sequence[float] | AwayFrom
"""A nonzero direction in space (3 numbers), or `AwayFrom` a point."""

Outside = Side | Mapping[str, Side]
"""A side for the whole surface, or sides by part name; other parts then face upward."""


def connected_labels(size: int, a: Integers, b: Integers) -> Integers:
    """Label the connected components of the graph with links a[k]-b[k] between `size` nodes."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(len(a), dtype=bool), (a, b)), shape=(size, size))
    labels: Integers = connected_components(links, directed=False)[1].astype(np.int64)
    return labels


def oriented(
    points: Array,
    cells: Integers,
    table: EdgeTable,
    outside: Outside,
    parts: Mapping[str, Integers],
) -> tuple[Integers, Integers]:
    """The cells (m, 3), oriented with normals to the outside, and the piece (m,) of each."""
    # Each cell is two nodes of a graph, "as given" (index c) and "flipped" (index m + c). An inner
    # edge links the consistently oriented nodes of its two cells; a seam of three or more links
    # none. An orientable piece has two components, one for each of its sides.
    first, second = table.linked_sides(table.counts == 2)
    turned = len(cells) * (table.ascending[first] == table.ascending[second])
    a, b = first // 3, second // 3
    labels = connected_labels(
        2 * len(cells),
        np.concatenate([a, a + len(cells)]),
        np.concatenate([b + turned, b + len(cells) - turned]),
    ).reshape(2, len(cells))
    one_sided = np.flatnonzero(labels[0] == labels[1])
    if len(one_sided):
        raise MeshError(
            f"the piece of the surface with cell {one_sided[0]} has only one side, like a "
            "Moebius strip; cut it open or remove the twist."
        )
    turn = labels[0] > labels[1]
    piece = np.unique(np.minimum(labels[0], labels[1]), return_inverse=True)[1]
    targets = _targets(points[cells].mean(axis=1), outside, parts)
    turn ^= _pieces_inside_out(points, _turned(cells, turn), piece, targets, outside)[piece]
    return _turned(cells, turn), piece.astype(np.int64)


def _turned(cells: Integers, turn: Booleans) -> Integers:
    return np.where(turn[:, None], cells[:, [0, 2, 1]], cells)


def _targets(centres: Array, outside: Outside, parts: Mapping[str, Integers]) -> Array:
    """Directions (m, 3) of any length towards which the cells' normals shall point."""
    if not isinstance(outside, Mapping):
        return _along(centres, outside)
    targets = _along(centres, UPWARD)
    named = np.zeros(len(centres), dtype=bool)
    for part, side in outside.items():
        if part not in parts:
            raise MeshError(
                f"`outside` names the part {part!r}, but there are the parts "
                f"{', '.join(sorted(parts)) or '(none)'}; name one of these."
            )
        own = parts[part]
        if named[own].any():
            raise MeshError(
                f"`outside` is given twice for {np.count_nonzero(named[own])} cells of the part "
                f"{part!r}, which other parts share; name parts without common cells."
            )
        named[own] = True
        targets[own] = _along(centres[own], side)
    return targets


def _along(centres: Array, side: Side) -> Array:
    if isinstance(side, AwayFrom):
        return centres - _three_numbers(side.point, "the inner point of `outside`")
    direction = _three_numbers(side, "the direction `outside`")
    if not direction.any():
        raise MeshError("the direction `outside` is (0, 0, 0); pass a non-zero vector.")
    return np.tile(direction, (len(centres), 1))


def _pieces_inside_out(
    points: Array,
    cells: Integers,
    piece: NDArray[np.intp],
    targets: Array,
    outside: Outside,
) -> Booleans:
    """Whether the area vector of each piece points inside."""
    corners = points[cells]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flux = np.bincount(piece, weights=np.einsum("ij,ij->i", area, targets))
    scale = np.linalg.norm(area, axis=1) * np.linalg.norm(targets, axis=1)
    unclear = np.flatnonzero(np.abs(flux) <= _VANISHING * np.bincount(piece, weights=scale))
    if len(unclear):
        cell = int(np.flatnonzero(piece == unclear[0])[0])
        raise MeshError(
            f"outside={outside} does not tell the two sides of the piece with cell {cell} at "
            f"{as_text(corners[cell].mean(axis=0))} apart, as on a closed or vertical surface; "
            "pass another direction, a point well inside (AwayFrom(point)), or a part of the mesh "
            "its own side ({'wall': (1, 0, 0)})."
        )
    return flux < 0


def _three_numbers(values: Sequence[float], what: str) -> Array:
    try:
        vector = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        vector = np.empty(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise MeshError(f"{what} is {values!r}; pass three finite numbers (x, y, z).")
    return vector
