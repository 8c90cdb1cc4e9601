"""Surface and lines of the current state as arrays, for files, pictures and pyvista."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.cable_net import CableNet
from crms_fenicsx.cabling.cables.deformed_surface import CurrentSurface, current_surface
from crms_fenicsx.cabling.contact.contact_force import contact_forces
from crms_fenicsx.foundation.dofs.layout import vertex_starts
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.results.membrane_results import membrane_results
from crms_fenicsx.results.quantities import fields_of


@dataclass(frozen=True)
class Surface:
    """Triangles in space with data at vertices and in triangles.

    Attributes
    ----------
    points : (n, 3) array of length
        Deformed vertices.
    triangles : (m, 3) array of int
        Vertices of each triangle. A folded cell is split into several triangles.
    point_data, cell_data : dict of (n,) or (n, c), and of (m,) or (m, c) arrays
        Values by name.
    homes : (n, 2) array of int, or None
        Owner of each point and its number among the owner's points, for pieces on several ranks
        that share points. None: this rank owns all.
    """

    points: ArrayLike
    triangles: ArrayLike
    point_data: Mapping[str, ArrayLike] = field(default_factory=dict)
    cell_data: Mapping[str, ArrayLike] = field(default_factory=dict)
    homes: ArrayLike | None = None

    def checked(self) -> Surface:
        """Return the surface with plain arrays (float, int64), or raise.

        Raises
        ------
        InputError
            Shapes disagree, an index is out of range or a coordinate is not finite.
        """
        points = checked_points("surface points", self.points)
        triangles = checked_integers("triangles", self.triangles, 3)
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            raise InputError(
                f"triangles refer to vertices {triangles.min()} to {triangles.max()}, but there "
                f"are {len(points)} points; number them from 0 within this surface."
            )
        homes = None if self.homes is None else checked_integers("homes", self.homes, 2)
        if homes is not None and len(homes) != len(points):
            raise InputError(
                f"homes: expected {len(points)}, one of each point, found {len(homes)}."
            )
        return Surface(
            points,
            triangles,
            _checked_data("point data", self.point_data, len(points)),
            _checked_data("cell data", self.cell_data, len(triangles)),
            homes,
        )


@dataclass(frozen=True)
class Line:
    """A polyline in space, such as a cable, with data.

    Attributes
    ----------
    points : (k, 3) array of length
        Corners, k >= 2.
    data : dict of float, (k,) or (k - 1,) array
        Values by name: one for the line, one per corner or one per segment.
    name : str
        Label in pictures.
    """

    points: ArrayLike
    data: Mapping[str, ArrayLike] = field(default_factory=dict)
    name: str = ""

    def checked(self) -> Line:
        """Return the line with plain arrays, or raise.

        Raises
        ------
        InputError
            Fewer than two points, or data of another length.
        """
        label = f"line {self.name!r}" if self.name else "line"
        points = checked_points(f"{label}: points", self.points)
        if len(points) < 2:
            raise InputError(f"{label} has {len(points)} points; pass two or more.")
        data: dict[str, NDArray[Any]] = {}
        for name, given in self.data.items():
            values = np.asarray(given)
            if values.dtype.kind not in "biuf":
                raise InputError(f"{label}: {name!r} is of type {values.dtype}; pass numbers.")
            if values.shape not in {(), (len(points),), (len(points) - 1,)}:
                raise InputError(
                    f"{label}: {name!r} has shape {values.shape}; pass one value, one for each "
                    f"of the {len(points)} points or {len(points) - 1} segments."
                )
            data[name] = values.astype(np.float64)
        return Line(points, data, self.name)


def checked_integers(what: str, given: ArrayLike, columns: int) -> Integers:
    """Return integers of shape (n, columns), or raise `InputError`."""
    array = np.asarray(given)
    if array.size == 0:
        return np.empty((0, columns), dtype=np.int64)
    if array.ndim != 2 or array.shape[1] != columns or array.dtype.kind not in "iu":
        raise InputError(
            f"{what}: expected integers of shape (n, {columns}), found {array.dtype} of shape "
            f"{array.shape}."
        )
    return np.ascontiguousarray(array, dtype=np.int64)


def checked_points(what: str, given: ArrayLike) -> Array:
    """Return points as an (n, 3) array of finite floats, or raise `InputError`."""
    points = np.ascontiguousarray(given, dtype=np.float64)
    if points.size == 0:
        return np.empty((0, 3))
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{what}: expected shape (n, 3), found shape {points.shape}.")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise InputError(f"{what}: number {bad[0]} is {points[bad[0]]}; pass finite coordinates.")
    return points


def _checked_data(what: str, given: Mapping[str, ArrayLike], count: int) -> dict[str, NDArray[Any]]:
    """Return data by name as arrays with `count` rows, or raise `InputError`."""
    data: dict[str, NDArray[Any]] = {}
    for name, values in given.items():
        array = np.ascontiguousarray(values)
        if array.dtype.kind not in "biuf":
            raise InputError(f"{what} {name!r} is of type {array.dtype}; pass real numbers.")
        if array.ndim not in (1, 2) or len(array) != count:
            raise InputError(
                f"{what} {name!r} has shape {array.shape}; pass ({count},) or ({count}, c)."
            )
        data[name] = array.astype(np.uint8) if array.dtype.kind == "b" else array
    return data


Segments = tuple[Array, Integers, dict[str, NDArray[Any]], dict[str, NDArray[Any]]]
"""Points, point pairs, and data at points and on pairs."""


def cable_lines(net: CableNet) -> list[Line]:
    """Cables with "tension", "lifted" and "contact force" (force per length), and with clamps
    "clamp", 1 at a clamp. Collective."""
    if not net.cables:
        return []
    shape = net.strip_shape()
    return [
        Line(
            cable.line,
            {
                "tension": cable.tensions if cable.is_divided else cable.tension,
                "lifted": cable.free_spans,
                "contact force": np.nan_to_num(
                    contact_forces(cable, shape).line[cable.line_nodes()]
                ),
                **({"clamp": cable.at_clamps} if net.clamps else {}),
            },
            cable.name,
        )
        for cable in net.cables
    ]


def bar_lines(bars: Sequence[PlacedBar]) -> list[Line]:
    """Bars as lines, never "lifted"; "tension": axial force, negative in compression."""
    return [Line(bar.points, {"tension": bar.force, "lifted": 0.0}, bar.name) for bar in bars]


def joined(lines: Sequence[Line]) -> Segments:
    """Lines as one mesh of segments; missing data are NaN; "line" numbers the lines from 0."""
    counts = np.array([len(line.points) for line in lines], dtype=np.int64)  # type: ignore[arg-type]
    starts = np.concatenate([[0], np.cumsum(counts)])
    last = np.zeros(starts[-1], dtype=bool)
    last[starts[1:] - 1] = True
    first = np.flatnonzero(~last)
    on_points: dict[str, NDArray[Any]] = {}
    on_segments: dict[str, NDArray[Any]] = {"line": np.repeat(np.arange(len(lines)), counts - 1)}
    for index, line in enumerate(lines):
        for name, values in line.data.items():
            array = np.asarray(values)
            per_point = array.shape == (counts[index],)
            target = on_points if per_point else on_segments
            start = starts[index] if per_point else starts[index] - index
            whole = target.setdefault(
                name, np.full(starts[-1] if per_point else len(first), np.nan)
            )
            whole[start : start + counts[index] - (not per_point)] = array
    points: Array = np.concatenate([np.empty((0, 3)), *(a.points for a in lines)])
    return points, np.column_stack([first, first + 1]), on_points, on_segments


def surface_piece(
    membrane: Membrane, shape: CurrentSurface, fields: Mapping[str, Array]
) -> Surface:
    """This rank's piece of the surface with "displacement" and cell data. Collective."""
    return Surface(
        shape.points,
        shape.triangles,
        {"displacement": shape.points - shape.stress_free},
        {name: values[shape.parents] for name, values in fields.items()},
        point_homes(membrane, len(shape.points)),
    )


def current_view(system: System) -> tuple[Surface, list[Line]]:
    """This rank's piece of the surface with the cell data of files, and the cables and bars.
    Collective."""
    scene, results = system.scene, membrane_results(system)
    piece = surface_piece(scene.membrane, results.surface, fields_of(results))
    return piece, [*cable_lines(scene.net), *bar_lines(scene.bars)]


def whole_shape(scene: Scene) -> Surface | None:
    """The whole current surface on the first rank; None on the others. Collective."""
    piece = surface_piece(scene.membrane, current_surface(scene.net), {})
    return whole_surface(scene.comm, piece)


def point_homes(membrane: Membrane, points: int) -> Integers:
    """Owner and number of the current surface's points, (points, 2). Collective."""
    vertices = membrane.V.dofmap.index_map
    own, known = vertices.size_local, vertices.size_local + vertices.num_ghosts
    starts = vertex_starts(membrane.V)
    homes = np.full((points, 2), membrane.comm.rank, dtype=np.int64)
    homes[:own, 1] = np.arange(own)
    homes[own:known, 0] = vertices.owners
    homes[own:known, 1] = vertices.ghosts - starts[vertices.owners]
    homes[known:, 1] = own + np.arange(points - known)
    return homes


def whole_surface(comm: MPI.Intracomm, piece: Surface) -> Surface | None:
    """The whole surface on the first rank; None on the others. Collective."""
    pieces, whole = comm.gather(piece), None
    with raised_together(comm):
        if pieces is not None:
            whole = _whole(pieces)
    return whole


def _whole(pieces: Sequence[Surface]) -> Surface:
    """One surface of the ranks' pieces, each point from the rank that it belongs to."""
    homes = [
        np.stack([np.full(n := len(np.asarray(one.points)), rank), np.arange(n)], axis=1)
        if one.homes is None else np.asarray(one.homes, dtype=np.int64)
        for rank, one in enumerate(pieces)
    ]  # fmt: skip
    own = [np.flatnonzero(home[:, 0] == rank) for rank, home in enumerate(homes)]
    own = [rows[np.argsort(home[rows, 1])] for rows, home in zip(own, homes, strict=True)]
    counts = np.array([len(rows) for rows in own])
    starts, triangles = np.cumsum(counts) - counts, []
    for rank, (home, one) in enumerate(zip(homes, pieces, strict=True)):
        ranks, numbers = home.T
        lost = (ranks < 0) | (ranks >= len(counts)) | (numbers < 0)
        lost |= numbers >= counts[np.where(lost, 0, ranks)]
        if lost.any() or not np.array_equal(numbers[own[rank]], np.arange(counts[rank])):
            raise InputError(
                f"homes: rank {rank} has points number {numbers[own[rank]].tolist()[:9]} of its "
                f"own and, of others, {home[lost].tolist()[:3]}, where the ranks have "
                f"{counts.tolist()}; number each rank's from 0."
            )
        triangles.append((starts[ranks] + numbers)[np.asarray(one.triangles)])
    places = [np.asarray(one.points)[rows] for one, rows in zip(pieces, own, strict=True)]
    known = [rank for rank, home in enumerate(homes) if len(home)] or [0]  # others have no data
    return Surface(
        np.concatenate(places),
        np.concatenate(triangles),
        _gathered({rank: pieces[rank].point_data for rank in known}, own),
        _gathered({rank: pieces[rank].cell_data for rank in known}, None),
    )


def _gathered(
    data: Mapping[int, Mapping[str, ArrayLike]], own: Sequence[Integers] | None
) -> dict[str, NDArray[Any]]:
    """Data of ranks by name, of `own` rows or of all; refuses other names or types than the first
    rank's."""
    arrays = {rank: {k: np.asarray(x) for k, x in some.items()} for rank, some in data.items()}
    kinds = {rank: {k: (x.dtype.str, *x.shape[1:]) for k, x in some.items()}
             for rank, some in arrays.items()}  # fmt: skip
    first = next(iter(kinds))
    for rank, kind in kinds.items():
        if kind != kinds[first]:
            raise InputError(
                f"data differ: rank {first} has {kinds[first]}, rank {rank} has {kind}; pass the "
                "same on all ranks."
            )
    return {
        name: np.concatenate([
            some[name] if own is None else some[name][own[rank]] for rank, some in arrays.items()
        ])
        for name in kinds[first]
    }  # fmt: skip


def to_pyvista(scene: Scene, cell_data: Mapping[str, Array], radius: float | None) -> Any:
    """Blocks of `Solver.to_pyvista`, with this rank's cell data. Collective."""
    scene.membrane.check_finite("to_pyvista")
    piece = surface_piece(scene.membrane, current_surface(scene.net), cell_data)
    surface = whole_surface(scene.comm, piece)
    lines = {"cables": cable_lines(scene.net), "bars": bar_lines(scene.bars)}
    supports, found = held_places(scene), None
    with raised_together(scene.comm):
        if surface is not None:
            try:
                import pyvista
            except ImportError as error:
                raise ImportError(
                    f"to_pyvista needs pyvista ({error}); install it: pip install pyvista, or apt "
                    "install python3-pyvista."
                ) from None
            found = pyvista.MultiBlock()
            surface = surface.checked()
            data = surface.point_data, surface.cell_data
            faces = {"faces": np.asarray(surface.triangles)}
            found["membrane"] = _mesh(pyvista, np.asarray(surface.points), faces, *data)
            if radius is None:
                radius = 0.003 * float(np.linalg.norm(np.ptp(surface.points, axis=0)))
            for name, some in lines.items():
                if some:
                    found[name] = _tubes(pyvista, some, radius)
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
    """Lines with data, or tubes around their segments."""
    points, pairs, on_points, on_segments = joined(lines)
    mesh = _mesh(pyvista, points, {"lines": pairs}, on_points, on_segments)
    if radius > 0.0:
        mesh = mesh.tube(radius=radius, n_sides=12, capping=True)
    mesh.field_data["names"] = [line.name for line in lines]
    return mesh


def _mesh(
    pyvista: Any,
    points: Array,
    cells: Mapping[str, Integers],
    point_data: Mapping[str, ArrayLike],
    cell_data: Mapping[str, ArrayLike],
) -> Any:
    """A mesh of points and cells of one type, with data on both."""
    padded: dict[str, NDArray[Any]] = {
        kind: np.insert(corners, 0, corners.shape[1], axis=1).ravel()
        for kind, corners in cells.items()
    }
    mesh = pyvista.PolyData(np.array(points, dtype=np.float64), **padded)
    for data, given in ((mesh.point_data, point_data), (mesh.cell_data, cell_data)):
        for name, values in given.items():
            data[name] = np.array(values)
    return mesh


def held_places(scene: Scene) -> tuple[Array, Booleans]:
    """Places of all ranks' held vertices and their directions, (k, 3) each. Collective."""
    held = scene.held[: scene.V.dofmap.index_map.size_local]
    rows = np.flatnonzero(held.any(axis=1))
    parts = scene.comm.allgather((scene.positions()[rows], held[rows]))
    places, directions = zip(*parts, strict=True)
    return np.concatenate(places), np.concatenate(directions)
