"""Surfaces that cutting patterns are tested on, with seams along mesh lines; a sphere of gores."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from cabled_square import advanced
from grids import alternating, numbered, triangles
from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, OrthotropicMembrane, Solver, meshes, patterns
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array, Integers

FABRIC = OrthotropicMembrane(
    E1=900.0, E2=700.0, G12=30.0, nu21=0.2 * 700 / 900, thickness=1.0, warp=(0.0, 1.0, 0.0)
)


def grid(columns: int, rows: int, strips: int = 0) -> Integers:
    """Cells of a grid whose node (i, j) is i (rows + 1) + j, with diagonals in turn, or those of
    strips symmetric to their middles."""
    other = alternating(columns, rows)
    if strips:
        width = columns // strips
        early = np.arange(columns) % width < width // 2
        other = np.not_equal.outer(early, np.arange(rows) >= rows // 2)
    return triangles(numbered(columns + 1, rows + 1), other)


def lines(columns: int, rows: int, strips: int) -> dict[str, list[tuple[int, int]]]:
    """Edges of the grid's lines between strips of equal numbers of columns: "seam 1" ..."""
    found = {}
    for k in range(1, strips):
        o = k * columns // strips * (rows + 1)
        found[f"seam {k}"] = list(pairwise(range(o, o + rows + 1)))
    return found


def half_cylinder(
    comm: MPI.Intracomm, strips: int, columns: int, rows: int, jitter: float = 0.0
) -> MembraneMesh:
    """Radius 5, 8 long along y, in strips of some columns; vertices inside strips may be moved."""
    n = strips * columns
    a, y = np.meshgrid(np.linspace(0.0, np.pi, n + 1), np.linspace(0.0, 8.0, rows + 1),
                       indexing="ij")  # fmt: skip
    rng = np.random.default_rng(1)
    inner = np.zeros(a.shape, dtype=bool)
    inner[:, 1:-1] = (np.arange(n + 1) % columns != 0)[:, None]
    a = a + inner * rng.uniform(-jitter, jitter, a.shape) * np.pi / n
    y = y + inner * rng.uniform(-jitter, jitter, a.shape) * 8.0 / rows
    x = np.stack([-5.0 * np.cos(a), y, 5.0 * np.sin(a)], axis=-1).reshape(-1, 3)
    return meshes.from_arrays(comm, x, grid(n, rows), edges=lines(n, rows, strips))


def pieces_of(mesh: MembraneMesh) -> patterns.Pieces:
    """Cut along all edge groups but the boundary."""
    return patterns.cut(mesh, [patterns.edge_line(mesh, k) for k in mesh.edges if k != "boundary"])


def cone(comm: MPI.Intracomm, half_angle: float, columns: int, rows: int) -> MembraneMesh:
    """From 2 to 5 along its generators, over three quarters of a turn, in two strips."""
    a, r = np.meshgrid(np.linspace(0.0, 1.5 * np.pi, 2 * columns + 1),
                       np.linspace(2.0, 5.0, rows + 1), indexing="ij")  # fmt: skip
    r = r * np.sin(half_angle)
    z = -r / np.tan(half_angle)
    x = np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1).reshape(-1, 3)
    return meshes.from_arrays(comm, x, grid(2 * columns, rows), edges=lines(2 * columns, rows, 2))


def two_gores(comm: MPI.Intracomm, gores: int, columns: int, rows: int) -> MembraneMesh:
    """Two of the gores of a sphere of radius 10, from pole to pole."""
    a = np.linspace(-2 * np.pi / gores, 2 * np.pi / gores, 2 * columns + 1)
    b = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)[1:-1]
    a, b = np.meshgrid(a, b, indexing="ij")
    x = 10.0 * np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], axis=-1)
    points = np.concatenate([x.reshape(-1, 3), [(0.0, 0.0, -10.0), (0.0, 0.0, 10.0)]])
    start, south = np.arange(2 * columns) * (rows - 1), len(points) - 2
    end, north = start + rows - 2, len(points) - 1
    caps = [
        np.stack([np.full_like(start, south), start, start + rows - 1], axis=1),
        np.stack([np.full_like(start, north), end + rows - 1, end], axis=1),
    ]
    cells = np.concatenate([grid(2 * columns, rows - 2), *caps])
    middle = [south, *range(columns * (rows - 1), (columns + 1) * (rows - 1)), north]
    return meshes.from_arrays(
        comm, points, cells, edges={"seam 1": list(pairwise(middle))}, outside=(1.0, 0.0, 0.0)
    )


def quarter_sphere(comm: MPI.Intracomm, gores: int, columns: int) -> MembraneMesh:
    """A quarter of the gores of a sphere of radius 10, from pole to pole, between the planes x = 0
    and y = 0, with cells as long as wide at the equator."""
    n, rows = columns * gores // 4, columns * gores // 4
    a, b = np.linspace(0.0, np.pi / 2, n + 1), np.linspace(-np.pi / 2, np.pi / 2, rows + 1)[1:-1]
    a, b = np.meshgrid(a, b, indexing="ij")
    x = 10.0 * np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], axis=-1)
    points = np.concatenate([x.reshape(-1, 3), [(0.0, 0.0, -10.0), (0.0, 0.0, 10.0)]])
    points[n * (rows - 1) : -2, 0] = 0.0
    start, south = np.arange(n) * (rows - 1), len(points) - 2
    end, north = start + rows - 2, len(points) - 1
    caps = [
        np.stack([np.full_like(start, south), start, start + rows - 1], axis=1),
        np.stack([np.full_like(start, north), end + rows - 1, end], axis=1),
    ]
    cells = np.concatenate([grid(n, rows - 2, gores // 4), *caps])
    edges = {}
    for k in range(gores // 4 + 1):
        o = k * columns * (rows - 1)
        name = {0: "y0", gores // 4: "x0"}.get(k, f"seam {k}")
        edges[name] = list(pairwise([south, *range(o, o + rows - 1), north]))
    return meshes.from_arrays(comm, points, cells, edges=edges, outside=(1.0, 1.0, 0.0))


def hypar(comm: MPI.Intracomm, columns: int) -> MembraneMesh:
    """Minimal surface between the straight edges of z = xy/9 over 6 x 6, in 3 strips along y."""
    n = 3 * columns
    g = np.linspace(-3.0, 3.0, n + 1)
    x, y = (a.ravel() for a in np.meshgrid(g, g, indexing="ij"))
    points, cells = np.stack([x, y, x * y / 9.0], axis=1), grid(n, n)
    held = (np.abs(points[:, :2]) > 3.0 - 1e-9).any(axis=1)
    return meshes.from_arrays(
        comm, minimal(points, cells, held), cells, edges=lines(n, n, 3)
    )  # fmt: skip


def minimal(points: Array, cells: Integers, held: Array) -> Array:
    """The minimal surface with held vertices: updates by U. Pinkall and K. Polthier."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.linalg import spsolve

    N = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
    rows, columns = np.repeat(cells, 3, axis=1).ravel(), np.tile(cells, (1, 3)).ravel()
    free = np.flatnonzero(~held)
    for _ in range(60):
        x = points[cells]
        F = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=-1)
        G = np.swapaxes(F, 1, 2) @ F
        k = np.sqrt(np.linalg.det(G))[:, None, None] / 2 * (N @ np.linalg.inv(G) @ N.T)
        K = csr_matrix((k.ravel(), (rows, columns)), shape=2 * (len(points),))
        points = points.copy()
        points[free] = spsolve(K[free][:, free].tocsc(), -(K[free][:, held] @ points[held]))
    return points


def inflated_sphere(
    comm: MPI.Intracomm, gores: int, wrinkling: bool, extra: float = 1.0
) -> tuple[Solver, patterns.Pattern, Array]:
    """A quarter of a sphere of radius 10 cut for section forces of 1.5, stretched more by a factor,
    under the pressure .3, and the radii of its vertices."""
    film = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, wrinkling=wrinkling)
    mesh = quarter_sphere(comm, gores, 8)
    seams = [patterns.edge_line(mesh, name) for name in mesh.edges if name.startswith("seam")]
    pattern = patterns.flatten(
        patterns.cut(mesh, seams), film, shrink=patterns.shrink_for(film, 1.5)
    ).adjusted({f"piece {k + 1}": (extra, extra) for k in range(gores // 4)})
    scene = patterns.sew(pattern)
    scene.fix("x0", "x")
    scene.fix("y0", "y")
    scene.fix(lambda x: np.abs(x[2]) < 1e-9, "z")
    solver = advanced(Solver(scene), pressure=0.3)
    own = scene.V.dofmap.index_map.size_local
    radii = comm.allgather(np.linalg.norm(scene.positions()[:own], axis=1))
    return solver, pattern, np.concatenate(radii)
