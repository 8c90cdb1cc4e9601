"""Meshes of the dome that are cut along its net, embed it, or are mirrored themselves."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from roofs import HEIGHT, RADIUS, cap, great_circles

from crms_fenicsx import meshes, nets
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

CABLES = 14  # of a family
NEAR = 1e-6 * RADIUS  # of vertices that are one


def embedded(unknowns: float) -> meshes.MembraneMesh:
    """The dome with the net's lines in it."""
    return cap(unknowns, great_circles(CABLES))


def cut(unknowns: float) -> meshes.MembraneMesh:
    """The dome cut along the net."""
    return meshes.along(cap(unknowns), great_circles(CABLES))


def mirrored(unknowns: float) -> meshes.MembraneMesh:
    """A quarter of the dome with the lines in it, mirrored in both directions of the net."""
    lines = great_circles(CABLES)
    axes = {f"{name} axis": nets.great_circle(RADIUS, HEIGHT, angle, 0.0)
            for name, angle in (("A", np.pi / 4), ("B", -np.pi / 4))}  # fmt: skip
    whole = cap(unknowns, {**lines, **axes})
    points, cells = whole.mesh.geometry.x, geometry_dofmap(whole.mesh)
    turn = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, np.sqrt(2)]]) / np.sqrt(2)
    own = points @ turn.T  # x along the cables of the first family
    own[np.abs(own) < NEAR] = 0.0
    quarter = cells[(own[cells].mean(axis=1)[:, :2] > 0.0).all(axis=1)]
    places, triangles = [], []
    for k, signs in enumerate(((1, 1, 1), (-1, 1, 1), (-1, -1, 1), (1, -1, 1))):
        places.append(own * signs)
        triangles.append((quarter if k % 2 == 0 else quarter[:, ::-1]) + k * len(own))
    everywhere = np.concatenate(places)
    one, number = np.unique(np.round(everywhere / NEAR).astype(int), axis=0, return_inverse=True)
    first = np.zeros(len(one), dtype=int)
    first[number.ravel()] = np.arange(len(everywhere))
    merged = number.ravel()[np.concatenate(triangles)]
    used, merged = np.unique(merged, return_inverse=True)
    found, merged = everywhere[first[used]] @ turn, merged.reshape(-1, 3)
    return meshes.from_arrays(
        MPI.COMM_WORLD, found, merged, edges=edges_on(found, merged, lines), outside=(0.0, 0.0, 1.0)
    )


def edges_on(
    points: NDArray[np.float64], cells: NDArray[np.int64], lines: dict[str, NDArray[np.float64]]
) -> dict[str, NDArray[np.int64]]:
    """The edges of a mesh along great circles."""
    edges = np.unique(np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    centre = np.array([0.0, 0.0, HEIGHT - (RADIUS**2 + HEIGHT**2) / (2 * HEIGHT)])
    found = {}
    for name, path in lines.items():
        p, q = np.pad(path[[0, -1]], ((0, 0), (0, 1))) - centre
        normal = np.cross(p, q)
        on = np.abs((points - centre) @ normal) < 1e-5 * np.linalg.norm(normal) * RADIUS
        found[name] = edges[on[edges].all(axis=1)]
    return found


MESHES = {"cut": cut, "embedded": embedded, "mirrored": mirrored}
