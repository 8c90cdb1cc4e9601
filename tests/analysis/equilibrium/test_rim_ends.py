"""Ends of lines that slide along a held rim, whose other vertices make way (kgf, cm)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cabled_square import SIDE, clamped
from grids import alternating, grid, numbered
from mpi4py import MPI
from sliding_rows import EA, PRESSURE, row_places

from crms_fenicsx import Cable, LaidCable, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.held_rims import within_held_rims

PLACES, TENSION = (13.9345, 40.6821), 348.670
"""Where the ends come to rest, and the tension there, by an independent program."""


def between_anchors(
    comm: MPI.Intracomm, ends: tuple[float, float], k: int = 20
) -> tuple[Scene, LaidCable]:
    """The square with a straight line from rim to rim, whose cable in a sleeve goes on to anchors
    beyond."""
    at, numbers = np.linspace(0.0, SIDE, k + 1), numbered(k + 1, k + 1)
    points, cells = grid(at, at, other=alternating(k, k))
    j = round(0.3 * k)
    for i, x in enumerate(at):
        y = [0.0, np.interp(x, [0.0, SIDE], ends), SIDE]
        points[numbers[i], 1] = np.interp(np.arange(k + 1), [0, j, k], y)
    row = numbers[:, j]
    edges = {"A": np.stack([row[:-1], row[1:]], axis=1)}
    scene = clamped(meshes.from_arrays(comm, points, cells, edges=edges))
    anchors = [(-15.0, 10.0, 0.0), (115.0, 45.0, -5.0)]
    return scene, scene.lay_cable(Cable(EA), anchors, along="A", L0=134.0, hold="sleeve")


@pytest.mark.ranks
def test_ends_slide_by_three_cells(comm: MPI.Intracomm) -> None:
    """From 15 away on either side they come to rest where others do that begin there; before, they
    ran into the next vertices of the rim, which now lie evenly between them and the corners."""
    for start in ((29.0, 26.0), (14.0, 41.0)):
        scene, cable = between_anchors(comm, start)
        step = Solver(scene, rtol=1e-9).advance(pressure=PRESSURE)
        assert step.verification.passed
        places = row_places(cable)
        np.testing.assert_allclose(places[[0, -1], 1], PLACES, atol=1e-3)
        assert cable.tension == pytest.approx(TENSION, rel=1e-5)
        X = scene.membrane.stress_free[: scene.V.dofmap.index_map.size_local]
        left = np.concatenate(comm.allgather(X[np.abs(X[:, 0]) < 1e-9, 1]))
        steps = np.diff(np.sort(left))
        np.testing.assert_allclose(steps[:6], PLACES[0] / 6, atol=0.1)
        np.testing.assert_allclose(steps[6:], (SIDE - PLACES[0]) / 14, atol=0.1)
        assert not scene.u.x.array.reshape(-1, 3)[scene.membrane.held.any(axis=1)].any()


@pytest.mark.ranks
def test_vertices_that_are_displaced_otherwise_stay(comm: MPI.Intracomm) -> None:
    """Beside a step in what is prescribed along the rim, and of rims that are not held."""
    scene, _ = between_anchors(comm, PLACES, 10)
    none: Any = np.zeros(0, dtype=np.int64)
    x, y, _ = scene.membrane.given.T
    rim = np.minimum(np.minimum(x, y), SIDE - np.maximum(x, y)) < 1e-9
    np.testing.assert_array_equal(within_held_rims(scene.membrane, none), rim)
    at = np.unique(np.concatenate(comm.allgather(y[x < 1e-9])))
    top = (x < 1e-9) & (y > at[4] - 1e-9)
    scene.u.x.array.reshape(-1, 3)[top, 2] = -1.0
    beside = (x < 1e-9) & ((np.abs(y - at[4]) < 1e-9) | (np.abs(y - at[3]) < 1e-9))
    corner = (x < 1e-9) & (y > SIDE - 1e-9) | (np.abs(x - SIDE / 10) < 1e-9) & (y > SIDE - 1e-9)
    found = within_held_rims(scene.membrane, none)
    np.testing.assert_array_equal(found, rim & ~beside & ~corner)
    scene.membrane.held[x < 1e-9] = False
    near = (np.abs(x - SIDE / 10) < 1e-9) & rim
    due = rim & (x > 1e-9) & ~near
    np.testing.assert_array_equal(within_held_rims(scene.membrane, none), due)
