"""Roofs that have collapsed or turned over since their base state."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, Scene, meshes
from crms_fenicsx.results.output.report.case import _shape_change, shape_of

pytestmark = pytest.mark.ranks


def cap(comm: MPI.Intracomm, rise: float) -> Scene:
    """A paraboloid over a square, far from the origin."""
    mesh = meshes.rectangle(comm, 2.0, 2.0, 0.25, structured=True, corner=(-1.0, -1.0))
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    lift(scene, rise)
    return scene


def lift(scene: Scene, rise: float) -> None:
    x = scene.V.tabulate_dof_coordinates()
    scene.u.x.array[2::3] = rise * (1.0 - x[:, 0] ** 2) * (1.0 - x[:, 1] ** 2)


def test_volume_and_sides(comm: MPI.Intracomm) -> None:
    scene = cap(comm, 0.5)
    before = shape_of(scene)
    assert before.volume == pytest.approx(0.5 * (4.0 / 3.0) ** 2, rel=0.05)
    for rise in (0.5, 0.2, -0.5):
        lift(scene, rise)
        volume, turned = _shape_change(before, scene)
        assert volume == pytest.approx(rise / 0.5)
        assert turned == 0.0
    scene.u.x.array[1::3] = -2.0 * scene.V.tabulate_dof_coordinates()[:, 1]  # mirrored
    assert _shape_change(before, scene)[1] == pytest.approx(1.0)


def test_a_flat_roof_encloses_nothing(comm: MPI.Intracomm) -> None:
    scene = cap(comm, 0.0)
    before = shape_of(scene)
    lift(scene, -0.3)
    assert _shape_change(before, scene)[0] is None
    assert np.isfinite(before.area)
