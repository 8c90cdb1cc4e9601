"""Fields per cell at the places that cells come to, against the fields themselves."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import FOIL, order
from grids import Floats, alternating, grid
from mpi4py import MPI

from crms_fenicsx import Scene, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh


def sheet(
    comm: MPI.Intracomm, k: int, rise: float = 0.0, parts: bool = False
) -> tuple[MembraneMesh, Floats]:
    """A unit square of k by k cells whose inner vertices lie askew, flat or a paraboloid, in one
    part or two halves."""
    at = np.linspace(0.0, 1.0, k + 1)
    points, cells = grid(at, at, other=alternating(k, k))
    points = askew(points, 0.2 / k)
    points[:, 2] = rise * (points[:, 0] ** 2 + points[:, 1] ** 2)
    left = points[cells][..., 0].mean(axis=1) < 0.5
    given = {"left": np.flatnonzero(left), "right": np.flatnonzero(~left)} if parts else None
    return meshes.from_arrays(comm, points, cells, parts=given), points


def askew(points: Floats, size: float) -> Floats:
    """Points of the square moved within it, but for those on the rim and in its middle."""
    x, y = points[:, 0], points[:, 1]
    inside = (np.minimum(x, 1 - x) > 1e-9) & (np.minimum(y, 1 - y) > 1e-9)
    inside &= np.abs(x - 0.5) > 1e-9
    new = points.copy()
    new[inside, 0] += size * np.sin(37.0 * x + 11.0 * y)[inside]
    new[inside, 1] += size * np.cos(23.0 * x - 31.0 * y)[inside]
    return new


def slid(X: Floats, rise: float = 0.0) -> Floats:
    """Places after a slide by up to .1 that leaves the rim and the middle."""
    x, y, z = X.T
    aside = np.sin(2 * np.pi * x) ** 2 * np.sin(np.pi * y)
    new = np.stack([x + 0.03 * aside * np.cos(3 * y), y + 0.1 * aside, z], axis=1)
    new[:, 2] = rise * (new[:, 0] ** 2 + new[:, 1] ** 2)
    return new


def error(
    comm: MPI.Intracomm, k: int, field: object, rise: float = 0.0, parts: bool = False
) -> tuple[float, float]:
    """The largest error of a field's values in cells that have moved, and of those it had."""
    mesh, _ = sheet(comm, k, rise, parts)
    scene = Scene(mesh, {"left": FOIL, "right": FOIL} if parts else FOIL)
    membrane = scene.membrane
    own = scene.mesh.mesh.topology.index_map(2).size_local
    cells = scene.V.dofmap.list[:own]
    first = membrane.given[cells].mean(axis=1)
    data = field(first)  # type: ignore[operator]
    assert membrane.at_places(data, membrane.given) is data
    X = slid(membrane.given, rise)
    membrane.place_stress_free(X)
    now = X[cells].mean(axis=1)
    found, due = membrane.at_places(data, membrane.given), field(now)  # type: ignore[operator]
    stays = np.linalg.norm(now - first, axis=1) < 1e-13
    np.testing.assert_array_equal(found[stays], data[stays])
    back = membrane.at_places(found, X)  # no motion since
    np.testing.assert_allclose(back, found, rtol=0, atol=1e-13)
    one, other = (float(np.abs(some - due).max(initial=0.0)) for some in (found, data))
    return comm.allreduce(one, op=MPI.MAX), comm.allreduce(other, op=MPI.MAX)


@pytest.mark.ranks
def test_linear_fields_are_exact(comm: MPI.Intracomm) -> None:
    """Of numbers and tensors, on a flat sheet; a part's own field does not see the other's."""
    slope = np.array([[0.3, -0.7], [1.1, 0.4]])

    def tensors(x: Floats) -> Floats:
        return np.asarray(x[:, :1, None] * slope - x[:, 1:2, None] * slope.T)

    def halves(x: Floats) -> Floats:
        return np.asarray(np.where(x[:, 0] < 0.5, 2.0 * x[:, 0] - x[:, 1], 9.0 + x[:, 1]))

    for field, parts in ((lambda x: 2.0 * x[:, 0] - x[:, 1], False), (tensors, False),
                         (halves, True)):  # fmt: skip
        found, before = error(comm, 12, field, parts=parts)
        assert before > 0.05 and found < 1e-12


@pytest.mark.ranks
@pytest.mark.parametrize("rise", [0.0, 0.3], ids=["flat", "curved"])
def test_smooth_fields_by_the_second_order(comm: MPI.Intracomm, rise: float) -> None:
    """Where cells have moved by up to 4 of their sizes."""
    found = [
        error(comm, k, lambda x: np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1]) + x[:, 2], rise)
        for k in (10, 20, 40)
    ]
    assert found[2][1] > 0.1
    assert order([1 / 10, 1 / 20, 1 / 40], [one[0] for one in found]) > 1.7
    assert found[2][0] < 0.02 * found[2][1]


def test_even_fields_stay_as_they_are(comm: MPI.Intracomm) -> None:
    """To the last digit, without any work."""
    mesh, _ = sheet(comm, 6)
    scene = Scene(mesh, FOIL)
    own = scene.mesh.mesh.topology.index_map(2).size_local
    data = np.full((own, 3), 0.1)
    scene.membrane.place_stress_free(slid(scene.membrane.given))
    assert scene.membrane.at_places(data, scene.membrane.given) is data
