"""Import and export of shapes: drawings (DXF), triangles (OBJ, STL, PLY), meshes of compas."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes import MembraneMesh, from_arrays
from crms_fenicsx.foundation.meshes.gmsh_model import imported
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import File, Positive, checked, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, MeshError, raised_together
from crms_fenicsx.foundation.runtime.files import (
    DXF_UNITS,
    absolute,
    dxf_library,
    make_writable,
    new_drawing,
    replaced,
)
from crms_fenicsx.model.tolerances import SAME_POINT
from crms_fenicsx.results.view_data import Surface, whole_shape

SURVEY_FOOT = 1200 / 3937
"""US survey foot (m)."""

UNITS = {
    0: 1.0, 1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8,
    9: 2.54e-5, 10: 0.9144, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 21: SURVEY_FOOT,
    22: SURVEY_FOOT / 12, 23: 3 * SURVEY_FOOT, 24: 5280 * SURVEY_FOOT,
}  # fmt: skip
"""Lengths (m) of DXF unit codes ($INSUNITS); 0 is a drawing without a unit."""

CHORD = 1e-3
"""Largest distance of a curve from its chords, relative to the curve's size."""


@dataclass(frozen=True)
class Lines:
    """Contents of a drawing's layer.

    Attributes
    ----------
    outlines
        Closed lines, (n, 3) each (length), without repeating the first corner.
    lines
        Open lines, (n, 3) each (length).
    points
        Points, (n, 3) (length).
    """

    outlines: list[Array] = field(default_factory=list)
    lines: list[Array] = field(default_factory=list)
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))


@checked
def read_dxf(path: File, *, unit: Positive | None = None) -> dict[str, Lines]:
    """Read outlines, lines and points of a DXF drawing, by layer.

    Lines, polylines, circles, arcs, ellipses, splines and points of the model space are read, but
    not blocks, texts and hatches. Lines of one layer that together enclose an area, with exactly
    two ends at each corner, become one outline. The call is not collective: read on one rank and
    broadcast, or read on all.

    Parameters
    ----------
    path
        The file. Requires ezdxf.
    unit
        Length of the drawing's unit; by default in m, from the file's unit, or 1 if the file names
        none.

    Returns
    -------
    dict
        `Lines` by layer name.

    Raises
    ------
    InputError
        The file does not exist, is not a DXF drawing or was cut short; coordinates are not finite;
        the file's unit is unknown or from astronomy or optics, or `unit` is not positive.
    ImportError
        ezdxf is missing.

    Examples
    --------
    >>> outline = exchange.read_dxf("site.dxf")["ROOF"].outlines[0]
    >>> mesh = meshes.polygon(MPI.COMM_WORLD, outline[:, :2], size=0.5)
    """
    file, ezdxf = Path(path), dxf_library("read_dxf")
    if not file.is_file():
        raise InputError(f"read_dxf: the file '{file}' does not exist (in {Path.cwd()}).")
    try:
        # ezdxf would read a file that was cut between two entities, without those that are missing
        if not file.read_bytes().rstrip(b"\0\x1a \r\n\t").endswith(b"EOF"):
            raise ValueError("its last line is not EOF, so it is another file or was cut short")
        document = ezdxf.readfile(file)
        curves, points = _contents(document)
    except Exception as error:  # ezdxf raises whatever a broken file makes its parser meet
        why = str(error) or type(error).__name__
        raise InputError(f"read_dxf: '{file}' cannot be read as DXF: {why}") from None
    if unit is None:
        if document.units not in UNITS:
            raise InputError(
                f"read_dxf: '{file}' has the unit code $INSUNITS = {document.units}, which is not "
                "a unit of drawings of structures; pass unit = its length in m."
            )
        unit = UNITS[document.units]
    return {
        layer: Lines(
            *_contours([unit * line for line in curves.get(layer, [])]),
            unit * np.array(points.get(layer, []), dtype=float).reshape(-1, 3),
        )
        for layer in dict.fromkeys((*curves, *points))
    }


def _contents(document: Any) -> tuple[dict[str, list[Array]], dict[str, list[Any]]]:
    """Lines (n, 3) and points (3,) by layer, in the drawing's unit."""
    from ezdxf import path as paths
    from ezdxf.math import Matrix44

    curves: dict[str, list[Array]] = {}
    points: dict[str, list[Any]] = {}
    for entity in document.modelspace():
        layer, kind = entity.dxf.layer, entity.dxftype()
        if kind in ("HATCH", "MPOLYGON"):
            continue
        if kind == "POINT":
            corners = np.array([tuple(entity.dxf.location)])
        else:
            try:
                curve = paths.make_path(entity)
            except TypeError:  # not a curve
                continue
            corners = np.array([tuple(corner) for corner in curve.control_vertices()])
        if not np.isfinite(corners).all():
            raise ValueError(f"{entity} on the layer '{layer}' has coordinates that are not finite")
        if kind == "POINT":
            points.setdefault(layer, []).append(corners[0])
        elif len(corners) and (size := _size(corners)) > 0:
            # far from the origin, rounding could exceed the distance wanted: chords would not end
            moved = curve.transform(Matrix44.translate(*-corners[0]))
            places = list[Any]()
            for place in moved.flattening(CHORD * size):
                # rounding makes two corners where the arcs of a circle meet
                if not places or place.distance(places[-1]) > SAME_POINT * size:
                    places.append(place)
            line = corners[0] + np.array([tuple(place) for place in places])
            curves.setdefault(layer, []).append(line)
    return curves, points


def _size(corners: Array) -> float:
    """Diagonal of the box around points (n, 3)."""
    return float(np.linalg.norm(np.ptp(corners, axis=0)))


def _contours(lines: list[Array]) -> tuple[list[Array], list[Array]]:
    """Closed lines, also those put together from lines whose ends meet in pairs, and open ones."""
    closed = [
        len(a) > 3 and bool(np.linalg.norm(a[0] - a[-1]) <= SAME_POINT * _size(a)) for a in lines
    ]
    outlines = [line[:-1] for line, is_closed in zip(lines, closed, strict=True) if is_closed]
    lines = [line for line, is_closed in zip(lines, closed, strict=True) if not is_closed]
    if not lines:
        return outlines, []
    ends = np.array([line[k] for line in lines for k in (0, -1)])  # 2 i and 2 i + 1 of line i
    reach = SAME_POINT * np.repeat([_size(line) for line in lines], 2)
    meeting = cKDTree(ends).query_ball_point(ends, reach)
    other = {k: sum(found) - k for k, found in enumerate(meeting) if len(found) == 2}
    left, done = list[int](), set[int]()
    for first in range(0, len(ends), 2):
        chain, here = list[int](), first
        while here >= 0 and here // 2 not in done:
            done.add(here // 2)
            chain.append(here)
            there = other.get(here ^ 1, -1)
            here = there if other.get(there) == here ^ 1 else -1
        parts = [lines[k // 2][:: -1 if k % 2 else 1][:-1] for k in chain]
        if here == first and sum(map(len, parts)) > 2:
            outlines.append(np.concatenate(parts))
        else:
            left += [k // 2 for k in chain]
    return outlines, [lines[i] for i in sorted(left)]


@collective
def write_shape(scene: Scene, filename: File, *, unit: str = "m") -> None:
    """Write the current shape, such as a found form, to a file. Collective.

    A .dxf file has the surface as 3D faces on the layer MEMBRANE, and cables, bars and supported
    vertices on layers of their own ("CABLE ridge", "BAR mast", "SUPPORTS"); it requires ezdxf.
    Files .obj, .stl and .ply have the triangles of the surface, written by meshio.

    Parameters
    ----------
    scene
        The scene.
    filename
        Name of the file. An existing file is replaced once the new one is complete.
    unit
        Unit of length of the scene, recorded in .dxf files: "mm", "cm", "m", "in" or "ft".

    Raises
    ------
    InputError
        On all ranks, with nothing written: not a scene, an unknown suffix or unit, displacements
        that are not finite, or a file that cannot be written.
    ImportError, MeshError
        On all ranks: ezdxf or meshio is missing.

    Examples
    --------
    >>> exchange.write_shape(scene, "form.dxf")
    """
    checks.one_of("write_shape: unit", unit, DXF_UNITS)
    path = absolute(filename, scene.comm)
    suffix = path.suffix.lower()
    checks.one_of("write_shape: the suffix", suffix, (".dxf", ".obj", ".stl", ".ply"))
    scene.membrane.check_finite("write_shape")
    whole = whole_shape(scene)
    held = np.any(scene.held[: scene.V.dofmap.index_map.size_local], axis=1)
    places = scene.comm.gather(scene.positions()[: len(held)][held])
    with raised_together(scene.comm):
        if whole is not None and places is not None:
            make_writable(path.parent)
            if suffix == ".dxf":
                write = _document(scene, whole, np.concatenate(places), unit).saveas
            else:
                cells = [("triangle", np.asarray(whole.triangles))]
                mesh = imported("meshio").Mesh(np.asarray(whole.points), cells)
                write = partial(mesh.write, binary=True) if suffix == ".stl" else mesh.write
            with replaced(path) as file:
                write(file)


def _document(scene: Scene, surface: Surface, held: Any, unit: str) -> Any:
    """The drawing as an ezdxf document."""
    document = new_drawing("write_shape", unit, "write .obj, .stl or .ply")
    space = document.modelspace()

    def layer(name: str, colour: int) -> dict[str, str]:
        forbidden = '<>/\\":;?*|=`,'  # in names of layers, besides line breaks and the like
        plain = "".join("_" if c in forbidden or not c.isprintable() else c for c in name)
        if plain not in document.layers:
            document.layers.add(plain, color=colour)
        return {"layer": plain}

    membrane = layer("MEMBRANE", 8)
    for corners in np.asarray(surface.points)[np.asarray(surface.triangles)].tolist():
        space.add_3dface(corners, dxfattribs=membrane)
    for cable in scene.cables:
        space.add_polyline3d(cable.line.tolist(), dxfattribs=layer(f"CABLE {cable.name}", 1))
    for bar in scene.bars:
        space.add_line(*bar.points.tolist(), dxfattribs=layer(f"BAR {bar.name}", 5))
    supports = layer("SUPPORTS", 3)
    for place in held.tolist():
        space.add_point(place, dxfattribs=supports)
    if len(document.audit().errors):
        raise InputError("write_shape: ezdxf finds errors in the drawing; write .obj or .ply.")
    return document


def from_compas(comm: MPI.Intracomm, mesh: Any, **options: Any) -> MembraneMesh:
    """Make a membrane mesh from a compas mesh, or from vertices and faces.

    Parameters
    ----------
    comm
        Communicator of the mesh; the call is collective, and rank 0 holds the whole mesh first.
    mesh
        A ``compas.datastructures.Mesh``, or ``(vertices, faces)``: coordinates (x, y, z) (length),
        and the vertices of each face. Faces with more than three vertices are split into triangles
        from their first vertex. Only rank 0's argument is used.
    **options
        ``outside`` and ``ranks``, as in `meshes.from_arrays`.

    Raises
    ------
    MeshError
        On all ranks: not a mesh, a face with fewer than three vertices, or input that
        `meshes.from_arrays` refuses.

    Examples
    --------
    >>> roof = compas.datastructures.Mesh.from_obj("roof.obj")
    >>> mesh = exchange.from_compas(MPI.COMM_WORLD, roof)
    """

    def triangles() -> tuple[Any, Any]:
        given = mesh.to_vertices_and_faces() if hasattr(mesh, "to_vertices_and_faces") else mesh
        try:
            vertices, faces = given
            faces = [[int(k) for k in face] for face in faces]
            points = np.array([[float(x) for x in vertex] for vertex in vertices])
        except (TypeError, ValueError):
            raise MeshError(
                f"from_compas: mesh = {mesh!r:.200} is not a mesh; use one of compas, or "
                "(vertices, faces)."
            ) from None
        short = next((face for face in faces if len(face) < 3), None)
        if short is not None or not faces:
            raise MeshError(f"from_compas: the face {short} has fewer than three vertices.")
        fans = [(face[0], *pair) for face in faces for pair in pairwise(face[1:])]
        return points, np.array(fans, dtype=np.int64)

    points, cells = checks.from_first(comm, triangles)
    return from_arrays(comm, points, cells, **options)


@collective
def to_vertices_and_faces(
    scene: Scene,
) -> tuple[list[list[float]], list[list[int]]] | None:
    """The current shape as vertices and faces; folded cells are split. Collective.

    Parameters
    ----------
    scene
        The scene.

    Returns
    -------
    tuple or None
        Vertices (length) and the vertices of each face on the first rank; None on the others.

    Raises
    ------
    InputError
        On all ranks: not a scene.

    Examples
    --------
    >>> vertices, faces = exchange.to_vertices_and_faces(scene)
    >>> mesh = compas.datastructures.Mesh.from_vertices_and_faces(vertices, faces)
    """
    whole = whole_shape(scene)
    if whole is None:
        return None
    vertices: list[list[float]] = np.asarray(whole.points).tolist()  # type: ignore[assignment]
    faces: list[list[int]] = np.asarray(whole.triangles).tolist()  # type: ignore[assignment]
    return vertices, faces
