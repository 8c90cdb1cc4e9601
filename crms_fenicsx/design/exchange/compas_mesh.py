"""Exchange vertices and faces with compas, for Rhino and Grasshopper."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes import MembraneMesh, from_arrays
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, MeshError, collective
from crms_fenicsx.results.view_data import whole_shape

VerticesAndFaces = tuple[Sequence[Sequence[float]], Sequence[Sequence[int]]]


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
    >>> mesh = from_compas(MPI.COMM_WORLD, compas.datastructures.Mesh.from_obj("roof.obj"))
    """

    def triangles() -> tuple[Any, Any]:
        given = mesh.to_vertices_and_faces() if hasattr(mesh, "to_vertices_and_faces") else mesh
        try:
            vertices, faces = given
            faces = [[int(k) for k in face] for face in faces]
            points = np.array([[float(x) for x in vertex] for vertex in vertices])
        except (TypeError, ValueError):
            raise MeshError(
                f"from_compas: mesh = {mesh!r:.200} is no mesh; give one of compas, or "
                "(vertices, faces)."
            ) from None
        short = next((face for face in faces if len(face) < 3), None)
        if short is not None or not faces:
            raise MeshError(f"from_compas: there is a face {short}; each needs three vertices.")
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
    >>> mesh = compas.datastructures.Mesh.from_vertices_and_faces(*to_vertices_and_faces(scene))
    """
    if not isinstance(scene, Scene):
        raise InputError(f"to_vertices_and_faces: {scene!r} is no scene; give one.")
    whole = whole_shape(scene)
    if whole is None:
        return None
    vertices: list[list[float]] = np.asarray(whole.points).tolist()  # type: ignore[assignment]
    faces: list[list[int]] = np.asarray(whole.triangles).tolist()  # type: ignore[assignment]
    return vertices, faces
