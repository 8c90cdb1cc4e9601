"""A hypar with edge cables against a net of force densities."""

from __future__ import annotations

import numpy as np
from form_meshes import SIDES, order, sail
from mpi4py import MPI


def net(n: int, lift: float, stress: float, tension: float) -> tuple[float, float, float]:
    """Area, length and sag of an edge: a net whose force densities are those of film and cables.

    Each side of a triangle of the film has half the cotangent of the angle opposite to it as its
    force density, times the section force; a link of a cable its tension over its length. With
    force densities held the places are the solution of a linear system (H.-J. Schek, 1974).
    """
    grid = np.linspace(0.0, 10.0, n + 1)
    x = np.zeros(((n + 1) ** 2, 3))
    x[:, :2] = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a = index[:-1, :-1].ravel()
    cells = np.concatenate(
        [np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)]
    )
    ends = np.concatenate([cells[:, [1, 2]], cells[:, [2, 0]], cells[:, [0, 1]]])
    lines = [index[0], index[:, -1], index[-1], index[:, 0]]
    cables = np.concatenate([np.stack([line[:-1], line[1:]], 1) for line in lines])
    corners = [index[0, 0], index[0, -1], index[-1, -1], index[-1, 0]]
    x[corners[::2], 2] = lift
    free = np.setdiff1d(index.ravel(), corners)
    for _ in range(2000):
        sides = np.roll(x[cells], -1, axis=1) - x[cells]
        twice = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        cotangents = [-np.sum(sides[:, k] * sides[:, k - 1], axis=1) / twice for k in range(3)]
        lengths = np.linalg.norm(x[cables[:, 1]] - x[cables[:, 0]], axis=1)
        q = np.concatenate([stress / 2 * np.concatenate(cotangents), tension / lengths])
        D = np.zeros((len(x), len(x)))
        i, j = np.concatenate([ends, cables]).T
        for one, other, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            np.add.at(D, (one, other), sign * q)
        step = np.linalg.solve(D[np.ix_(free, free)], -(D @ x)[free])
        x[free] += step
        if np.abs(step).max() < 3e-6:
            break
    edge = x[lines[0]]
    length = float(np.linalg.norm(np.diff(edge, axis=0), axis=1).sum())
    return float(twice.sum() / 2), length, sag(edge)


def sag(path: np.ndarray) -> float:
    """Mean distance of a line from its chord."""
    chord = path[-1] - path[0]
    along = (path - path[0]) @ chord / (chord @ chord)
    away = np.linalg.norm(path - path[0] - along[:, None] * chord, axis=1)
    return float(np.sum((away[1:] + away[:-1]) / 2 * np.diff(along)))


def test_hypar(comm: MPI.Intracomm) -> None:
    """Both converge to the same form, with second order."""
    nets = [np.array(net(n, 3.0, 2.0, 25.0)) for n in (5, 10)] if comm.rank == 0 else []
    coarse, fine = comm.bcast(nets)
    limit = (4 * fine - coarse) / 3
    sizes, found = (2.0, 1.0, 0.5), []
    for size in sizes:
        form = sail(comm, size, lift=3.0, tension=25.0)
        edge = form.cables[0]
        found.append([form.area, edge.length, sag(edge.path)])
        for own in SIDES:
            assert form.tensions[own] == 25.0
    best = (4 * np.array(found[2]) - np.array(found[1])) / 3
    np.testing.assert_allclose(best, limit, rtol=5e-4)
    for values, exact in zip(np.transpose(found), limit, strict=True):
        assert order(sizes, values - exact) > 1.7
        assert abs(values[-1] / exact - 1) < 3e-3
