"""Friction along a cable in the pocket of a free edge, which presses on it in all directions."""

from __future__ import annotations

import numpy as np
import pytest
from grids import numbered, triangles
from mpi4py import MPI
from roped_drum import AROUND, EA, FREE, WRAP, exact_tensions
from scipy.spatial.transform import Rotation

from crms_fenicsx import Cable, Friction, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.cabling.contact.contact_force import wrap_angles

TURNED = Rotation.from_rotvec([0.3, -1.1, 0.7])
RISE = 0.6
"""Height of the helix per radian."""


def pocket(
    comm: MPI.Intracomm, n: int, along: float, rise: float = 0.0, tension: float = 5.0,
    back: bool = False, scale: float = 1.0, force: float = 1.0,
) -> tuple[Scene, LaidCable]:  # fmt: skip
    """A cable in the inner edge of a stiff ring sector, or helicoid, which it leaves on tangents.

    The radius of the edge is 1, and its angle `WRAP`; the membrane has n cells around, and lies
    anyhow in space. `back` is the cable's direction; `scale` and `force` are the units.
    """
    j, k = np.meshgrid(np.arange(n + 1), np.arange(3), indexing="ij")
    angle, r = j / n * WRAP, 1 + 0.15 * k
    points = np.stack([r * np.cos(angle), r * np.sin(angle), rise * angle], axis=-1)
    far = 3 * np.arange(n + 1) + 2
    mesh = meshes.from_arrays(
        comm,
        scale * TURNED.apply(points.reshape(-1, 3)),
        triangles(numbered(n + 1, 3)),
        edges={"held": np.column_stack([far[:-1], far[1:]])},
    )
    fabric = IsotropicMembrane(E=1e7 * force / scale**2, nu=0.3, thickness=scale, wrinkling=False)
    scene = Scene(mesh, fabric)
    scene.fix("held")
    edge, tail = points[:, 0], FREE * np.array([0.0, 1.0, rise])
    path = scale * TURNED.apply(np.vstack([edge[0] - tail, edge, edge[-1] + tail * (1, -1, 1)]))
    cable = Cable(EA * force, friction=Friction(0.0, along=along))
    return scene, scene.lay_cable(cable, path[:: -1 if back else 1], tension=tension * force)


def pull(solver: Solver, cable: LaidCable, by: float) -> None:
    """Pull the cable's end out along its tangent."""
    last = cable.line[-1] - cable.line[-2]
    solver.advance(move={cable.end: by * last / np.linalg.norm(last)})


@pytest.mark.ranks
@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("rise", [0.0, RISE])
def test_sliding_cable_has_the_ratio_of_the_capstan(comm, rise: float, back: bool) -> None:
    """The pocket pulls in the membrane's plane alone, and the plane turns along a helix."""
    mu = 0.3
    scene, cable = pocket(comm, 24, mu, rise, back=back)
    solver = Solver(scene)
    for by, sign in ((0.1, 1.0), (-0.095, -1.0)):
        pull(solver, cable, by)
        found = np.log(cable.tensions[-1] / cable.tensions[0])
        assert found == pytest.approx(sign * mu * WRAP / np.hypot(1.0, rise), rel=1e-3)
    assert scene.dissipated > 0.0


def test_cable_sticks_beyond_the_slip_front_and_reverses(comm) -> None:
    """Pulled, pulled further, and let back twice: the exact state of an elastic cable."""
    mu, pulls, errors = 0.3, [0.006, 0.004, -0.003, -0.005], []
    for n in (16, 32):
        scene, cable = pocket(comm, n, mu)
        solver = Solver(scene)
        places = np.clip((np.arange(n + 2) - 0.5) / n, 0.0, 1.0) * WRAP
        for k, by in enumerate(pulls, start=1):
            pull(solver, cable, by)
            exact = exact_tensions(5.0, mu, pulls[:k])
            off = np.abs(cable.tensions - np.interp(places, AROUND, exact)).max()
            assert off < 0.02 * mu * WRAP / n * exact.max()  # the jump at a node
            errors.append(abs(cable.tensions[-1] / exact[-1] - 1))
    coarse, fine = max(errors[:4]), max(errors[4:])
    assert coarse < 1e-3
    assert fine < 0.3 * coarse


def test_units_do_not_matter(comm) -> None:
    tensions = []
    for scale, force in ((1.0, 1.0), (1e3, 1e-2)):
        scene, cable = pocket(comm, 8, 0.3, scale=scale, force=force)
        pull(Solver(scene), cable, 0.01 * scale)
        tensions.append(cable.tensions / force)
    np.testing.assert_allclose(tensions[0], tensions[1], rtol=1e-8)


def test_cable_on_the_membrane_is_not_pressed_by_its_turn_sideways(comm) -> None:
    """It is the same one inside of the membrane, where it goes straight."""
    scene, cable = pocket(comm, 8, 0.3)
    shape = scene.net.strip_shape()
    in_pocket = wrap_angles(cable, shape)
    assert in_pocket.sum() == pytest.approx(WRAP, rel=1e-12)
    cable.update(hold="sleeve")
    assert np.all(wrap_angles(cable, shape) < 1e-12)
