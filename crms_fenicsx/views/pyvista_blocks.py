"""Surface, lines and points as meshes of pyvista, which is imported when it is called for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.views.data import Line, Surface
from crms_fenicsx.views.lines import joined

SLENDER = 0.003
"""Radius of tubes, where none is given, in parts of the diagonal of the box around the surface."""
SIDES = 12
"""Of a tube."""


def blocks_of(
    surface: Surface,
    lines: Mapping[str, Sequence[Line]],
    points: Mapping[str, tuple[Array, Booleans, Sequence[str]]],
    radius: float | None,
) -> Any:
    """Return a ``pyvista.MultiBlock`` of the block "membrane" and of those that have something.

    Shapes and units: points (n, 3), radius (length).
    """
    pyvista = _pyvista()
    surface = surface.checked()
    places, triangles = np.asarray(surface.points), np.asarray(surface.triangles)
    found = pyvista.MultiBlock()
    found["membrane"] = _mesh(
        pyvista, places, {"faces": triangles}, surface.point_data, surface.cell_data
    )
    if radius is None:
        radius = SLENDER * float(np.linalg.norm(np.ptp(places, axis=0)))
    for name, some in lines.items():
        if some:
            found[name] = _tubes(pyvista, [line.checked() for line in some], radius)
    for name, (there, held, names) in points.items():
        if len(there):
            found[name] = _mesh(pyvista, there, {}, {"held": held.astype(np.uint8)}, {})
            if names:
                found[name].field_data["names"] = list(names)
    return found


def _pyvista() -> Any:
    try:
        import pyvista
    except ImportError as error:
        raise ImportError(
            f"to_pyvista needs pyvista ({error}); install it: pip install pyvista, or apt install "
            "python3-pyvista"
        ) from None
    return pyvista


def _tubes(pyvista: Any, lines: Sequence[Line], radius: float) -> Any:
    """Lines with data, or a tube around each of their segments."""
    points, pairs, on_points, on_segments = joined(lines)
    mesh = _mesh(pyvista, points, {"lines": pairs}, on_points, on_segments)
    if radius > 0.0:
        mesh = mesh.tube(radius=radius, n_sides=SIDES, capping=True)
    mesh.field_data["names"] = [line.name for line in lines]
    return mesh


def _mesh(
    pyvista: Any,
    points: Array,
    cells: Mapping[str, Integers],
    point_data: Mapping[str, ArrayLike],
    cell_data: Mapping[str, ArrayLike],
) -> Any:
    """A mesh of points and cells, all with as many corners, and data on both."""
    padded: dict[str, NDArray[Any]] = {
        kind: np.insert(corners, 0, corners.shape[1], axis=1).ravel()
        for kind, corners in cells.items()
    }
    mesh = pyvista.PolyData(np.array(points, dtype=np.float64), **padded)
    for data, given in ((mesh.point_data, point_data), (mesh.cell_data, cell_data)):
        for name, values in given.items():
            data[name] = np.array(values)
    return mesh
