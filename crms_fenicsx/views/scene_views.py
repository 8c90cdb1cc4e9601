"""The part of a scene that shows it: as meshes of pyvista, and in a line of text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any
from weakref import WeakMethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.braced_membrane import BracedMembrane
from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.cables.deformed_surface import current_surface
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.runtime.checks import counted, span
from crms_fenicsx.runtime.errors import InputError, collective, raised_together
from crms_fenicsx.views.view_data import (
    Line,
    Surface,
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


def blocks_of(
    surface: Surface,
    lines: Mapping[str, Sequence[Line]],
    points: Mapping[str, tuple[Array, Booleans, Sequence[str]]],
    radius: float | None,
) -> Any:
    """Return a ``pyvista.MultiBlock`` of "membrane" and of the lines and points there are."""
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


Fields = Callable[[], Mapping[str, Array]]
"""What gives values of this rank's owned cells by name, (n,) or (n, c); collective."""


class SceneViews(BracedMembrane):
    """A braced membrane with cables that can be looked at."""

    net: CableNet
    _pressure: float
    fields: WeakMethod[Fields] | None = None
    """Internal: what gives section forces of the cells, a solver's; None without one."""

    @collective
    def to_pyvista(self, *, radius: float | None = None) -> Any:
        """The current state as meshes of pyvista, on the first rank. Collective.

        They have the arrays of the ParaView files. pyvista is imported only here.

        Parameters
        ----------
        radius
            Of the tubes that cables and bars become (length), 0.3 % of the membrane's size by
            default; 0: they stay lines.

        Returns
        -------
        pyvista.MultiBlock
            With the blocks "membrane" (the deformed surface with the facets of folded cells; its
            "displacement" at points and, once there is a `Solver` of this scene, section forces
            and state of the cells), "cables" and "bars" ("tension" of each segment, "lifted",
            "contact force", the number of the "line"), "supports" (held vertices, with the "held"
            directions) and "joints"; those that have nothing are left out. The names of cables,
            bars and joints are in ``field_data["names"]``. None on the other ranks.

        Raises
        ------
        InputError
            On all ranks: a radius that is negative or not finite.
        ImportError
            On all ranks: there is no pyvista.

        Examples
        --------
        >>> blocks = scene.to_pyvista()
        >>> plotter = pyvista.Plotter()
        >>> plotter.add_mesh(blocks["membrane"], scalars="warp", show_edges=True)
        >>> plotter.add_mesh(blocks["cables"], scalars="tension", cmap="YlOrRd")
        >>> plotter.show()
        """
        checks.same(self.comm, "to_pyvista", radius=radius)
        if radius is not None:
            radius = checks.finite("to_pyvista: radius", radius)
            if radius < 0.0:
                raise InputError(f"to_pyvista: radius = {radius:g} is negative; give 0 for lines.")
        self.membrane.check_finite("to_pyvista")
        fields = self.fields() if self.fields is not None else None
        piece = surface_piece(
            self.membrane, current_surface(self.net), {} if fields is None else fields()
        )
        surface = whole_surface(self.comm, piece)
        lines = {"cables": cable_lines(self.net), "bars": bar_lines(self.bars)}
        supports = self._supported()
        joints = (
            np.array([joint.position for joint in self.joints]).reshape(-1, 3),
            np.array([joint.held for joint in self.joints], dtype=bool).reshape(-1, 3),
        )
        with raised_together(self.comm):
            if surface is not None:
                names = [joint.name for joint in self.joints]
                points = {"supports": (*supports, ()), "joints": (*joints, names)}
                return blocks_of(surface, lines, points, radius)
        return None

    def __repr__(self) -> str:
        """In a line; not collective."""
        mesh, cables = self.membrane.mesh.mesh, self.net.cables
        loads = {"pressure": self._pressure, **self.factors}
        words = [
            counted(mesh.topology.index_map(2).size_global, "cell"),
            ", ".join(f"{name} {factor:.6g}" for name, factor in loads.items()),
        ]
        if cables:
            tensions = span([cable.tension for cable in cables])
            words.append(f"{counted(len(cables), 'cable')}, tension {tensions}")
        if self.bars:
            forces = span([bar.force for bar in self.bars])
            words.append(f"{counted(len(self.bars), 'bar')}, force {forces}")
        solved = self.versions.current.equilibrium is not None
        if solved and not self.versions.are_settled(self.membrane.owned_u):
            words.append(UNBALANCED)
        return f"Scene({'; '.join(words)})"

    def _supported(self) -> tuple[Array, Booleans]:
        """Held vertices of all ranks on the first one, and their directions. Collective."""
        held = self.membrane.held[: self.membrane.V.dofmap.index_map.size_local]
        rows = np.flatnonzero(held.any(axis=1))
        parts = self.comm.gather((self.membrane.positions()[rows], held[rows]))
        places, directions = zip(*parts or [(np.empty((0, 3)), held[:0])], strict=True)
        return np.concatenate(places), np.concatenate(directions)
