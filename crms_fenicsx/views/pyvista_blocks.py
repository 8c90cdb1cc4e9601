"""A scene as meshes of pyvista."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.cables.deformed_surface import current_surface
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.scene import Scene
from crms_fenicsx.views.view_data import (
    Line,
    bar_lines,
    cable_lines,
    joined,
    surface_piece,
    whole_surface,
)

SLENDER = 0.003
"""Radius of tubes, where none is given, in parts of the diagonal of the box around the surface."""
SIDES = 12
"""Of a tube."""


def to_pyvista(scene: Scene, cell_data: Mapping[str, Array], radius: float | None) -> Any:
    """Blocks of `Solver.to_pyvista`, with this rank's cell data. Collective."""
    checks.same(scene.comm, "to_pyvista", radius=radius)
    if radius is not None and checks.finite("to_pyvista: radius", radius) < 0.0:
        raise InputError(f"to_pyvista: radius = {radius:g} is negative; give 0 for lines.")
    scene.membrane.check_finite("to_pyvista")
    piece = surface_piece(scene.membrane, current_surface(scene.net), cell_data)
    surface = whole_surface(scene.comm, piece)
    lines = {"cables": cable_lines(scene.net), "bars": bar_lines(scene.bars)}
    supports, found = _supported(scene), None
    with raised_together(scene.comm):
        if surface is not None:
            try:
                import pyvista
            except ImportError as error:
                raise ImportError(
                    f"to_pyvista needs pyvista ({error}); install it: pip install pyvista, or apt "
                    "install python3-pyvista"
                ) from None
            found = pyvista.MultiBlock()
            surface = surface.checked()
            data = surface.point_data, surface.cell_data
            faces = {"faces": np.asarray(surface.triangles)}
            found["membrane"] = _mesh(pyvista, np.asarray(surface.points), faces, *data)
            if radius is None:
                radius = SLENDER * float(np.linalg.norm(np.ptp(surface.points, axis=0)))
            for name, some in lines.items():
                if some:
                    found[name] = _tubes(pyvista, [line.checked() for line in some], radius)
            joints = (
                np.array([joint.position for joint in scene.joints]).reshape(-1, 3),
                np.array([joint.held for joint in scene.joints], dtype=bool).reshape(-1, 3),
            )
            for name, (places, held) in {"supports": supports, "joints": joints}.items():
                if len(places):
                    found[name] = _mesh(pyvista, places, {}, {"held": held.astype(np.uint8)}, {})
            if scene.joints:
                found["joints"].field_data["names"] = [joint.name for joint in scene.joints]
    return found


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


def _supported(scene: Scene) -> tuple[Array, Booleans]:
    """Held vertices of all ranks on the first one, and their directions. Collective."""
    held = scene.held[: scene.V.dofmap.index_map.size_local]
    rows = np.flatnonzero(held.any(axis=1))
    parts = scene.comm.gather((scene.positions()[rows], held[rows]))
    places, directions = zip(*parts or [(np.empty((0, 3)), held[:0])], strict=True)
    return np.concatenate(places), np.concatenate(directions)
