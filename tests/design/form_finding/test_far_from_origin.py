"""Forms in coordinates such as those of a map are those near the origin."""

from __future__ import annotations

import numpy as np
import pytest
from form_meshes import CORNERS, SIDES
from mpi4py import MPI
from scipy.spatial import cKDTree

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Solver, meshes
from crms_fenicsx.design.form_finding import FormBar, FormCable, FoundForm, find_form

FAR = np.array([5.0e5, 1.0e6, 0.0])
FOIL = IsotropicMembrane(E=500.0, nu=0.3, thickness=1.0)
pytestmark = pytest.mark.usefixtures("comm")


def tent(comm: MPI.Intracomm, at: np.ndarray) -> FoundForm:
    """Corners lifted by vectors and by a function of the place, in the user's coordinates."""
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.0, structured=True, corner=(at[0], at[1]))

    def raised(x: np.ndarray) -> np.ndarray:
        return np.stack([0 * x[0], 0 * x[0], 0.3 * (x[0] - at[0]) + 0.0 * (x[1] - at[1])])

    return find_form(
        mesh, 2.0, fixed=CORNERS,
        lifted={"front left": (0.0, 0.0, 3.0), "back right": raised},
        cables=[FormCable(SIDES[0], length=10.8)]
        + [FormCable(side, tension=25.0) for side in SIDES[1:]],
    )  # fmt: skip


def dome(comm: MPI.Intracomm, at: np.ndarray) -> FoundForm:
    mesh = meshes.rectangle(comm, 10.0, 8.0, 1.0, structured=True, corner=(at[0], at[1]))
    return find_form(mesh, 2.0, fixed=["boundary"], rise=2.0)


def bubble(comm: MPI.Intracomm, at: np.ndarray) -> FoundForm:
    mesh = meshes.rectangle(comm, 10.0, 8.0, 1.0, structured=True, corner=(at[0], at[1]))
    return find_form(mesh, (2.0, 1.5), fixed=["boundary"], volume=60.0, warp=(0.0, 1.0, 0.0))


def all_points(form: FoundForm) -> np.ndarray:
    """The points of a found form's mesh on all ranks, (points, 3), in no particular order."""
    geometry = form.mesh.mesh.geometry
    owned = geometry.x[: geometry.index_map().size_local]
    return np.concatenate(form.mesh.mesh.comm.allgather(owned))


@pytest.mark.ranks
@pytest.mark.parametrize("make", [tent, dome, bubble])
def test_forms_far_from_the_origin(comm: MPI.Intracomm, make: object) -> None:
    near, far = (make(comm, at) for at in (0.0 * FAR, FAR))  # type: ignore[operator]
    x, y = all_points(near), all_points(far) - FAR  # the meshes may be distributed differently
    distances, nearest = cKDTree(x).query(y)
    assert distances.max() < 3e-8
    np.testing.assert_array_equal(np.unique(nearest), np.arange(len(x)))
    assert len(y) == len(x)
    assert far.area == pytest.approx(near.area, rel=1e-9)
    assert far.pressure == pytest.approx(near.pressure, rel=1e-8)
    assert far.volume == pytest.approx(near.volume, rel=1e-9)
    assert far.iterations == near.iterations
    for name, reaction in near.reactions.items():
        np.testing.assert_allclose(far.reactions[name], reaction, atol=1e-7)
    for one, other in zip(near.cables, far.cables, strict=True):
        assert other.tension == pytest.approx(one.tension, rel=1e-8)
        assert other.length == pytest.approx(one.length, rel=1e-9)


def test_a_tent_on_masts_far_from_the_origin(comm: MPI.Intracomm) -> None:
    """Feet are in the user's coordinates; the first step moves nothing."""
    found, forces = [], []
    for at in (0.0 * FAR, FAR):
        form = tent(comm, at)
        reaction = form.reactions["front left"]
        top = at + np.array([0.0, 0.0, 3.0])
        ways = [(0.5, 0.5, -6.0), (-5.0, 0.0, -6.0), (0.0, -5.0, -6.0)]
        bars = [FormBar("front left", Bar(EA=1e5), foot=tuple(top + np.array(w))) for w in ways]
        scene = form.scene(FOIL, Cable(EA=8000.0), bars=bars)
        Solver(scene).advance()
        moved = float(np.abs(scene.u.x.array).max(initial=0.0))
        assert comm.allreduce(moved, op=MPI.MAX) < 1e-6
        found.append(reaction)
        forces.append([bar.force for bar in scene.bars])
    np.testing.assert_allclose(found[1], found[0], atol=1e-7)
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-5)
