"""Roofs with walls that hang from them: surfaces with seams of three cells."""

from collections import Counter

import numpy as np

from crms_fenicsx.foundation.meshes import from_arrays
from crms_fenicsx.foundation.meshes.membrane_mesh import vertex_nodes
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap


def walled_roof(n=6, size=100.0, walls=(0.5,), height=20.0, rise=0.0, levels=2, seed=None):
    """Points, cells and parts of a square roof of n x n x 2 cells with walls below it.

    Parameters
    ----------
    n, size
        Squares a side, and their total length.
    walls
        Places x / size of the walls, from front to back.
    height, levels
        Their height, and how many rows of cells they have.
    rise
        Height of the roof at its middle, over a parabola in x and y.
    seed
        Renumber and turn everything at random.
    """
    s = np.linspace(0.0, 1.0, n + 1)
    y, x = (a.ravel() for a in np.meshgrid(s, s, indexing="ij"))
    z = rise * 16 * x * (1 - x) * y * (1 - y)
    points = [np.column_stack([size * x, size * y, z])]
    grid = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    cells, parts = [quads(grid)], {"roof": np.arange(2 * n * n)}
    count, wall = len(points[0]), []
    for place in walls:
        top = grid[:, round(place * n)]
        rows = [top]
        for level in range(1, levels + 1):
            below = points[0][top] - (0.0, 0.0, height * level / levels)
            rows.append(np.arange(count, count + n + 1))
            points.append(below)
            count += n + 1
        cells.append(quads(np.array(rows)))
        wall.append(np.arange(len(cells[-1])) + sum(map(len, cells[:-1])))
    parts |= {"wall": np.concatenate(wall)} if wall else {}
    points, cells = np.concatenate(points), np.concatenate(cells)
    if seed is None:
        return points, cells, parts
    rng = np.random.default_rng(seed)
    new, order = rng.permutation(len(points)), rng.permutation(len(cells))
    place = np.argsort(order)
    moved = np.empty_like(points)
    moved[new] = points
    cells = np.array([rng.permutation(cell) for cell in new[cells][order]])
    return moved, cells, {name: place[members] for name, members in parts.items()}


def quads(grid):
    """Triangles (m, 3) of a grid of vertices."""
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def roof_mesh(comm, ranks=None, **options):
    """The mesh of a walled roof, its wall's outside towards x."""
    points, cells, parts = walled_roof(**options)
    outside = {"wall": (1.0, 0.0, 0.0)} if "wall" in parts else (0.0, 0.0, 1.0)
    return from_arrays(comm, points, cells, parts=parts, outside=outside, ranks=ranks)


def ids(membrane):
    """Vertices of this rank's cells, (m, 3), as they were given."""
    mesh = membrane.mesh
    owned = mesh.topology.index_map(2).size_local
    return mesh.geometry.input_global_indices[geometry_dofmap(mesh)[:owned]]


def edge_counts(cells):
    """How many cells each edge has."""
    pairs = np.sort(np.asarray(cells)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return Counter(map(tuple, pairs.tolist()))


def group_edges(membrane, name):
    """All ranks' edges of a group, as given vertices."""
    mesh = membrane.mesh
    vertices = mesh.geometry.input_global_indices[vertex_nodes(mesh)]
    ends = mesh.topology.connectivity(1, 0).array.reshape(-1, 2)[membrane.edges[name]]
    own = {tuple(sorted(pair)) for pair in vertices[ends].tolist()}
    return set().union(*membrane.comm.allgather(own))
