"""Ends of cables over a membrane that rises above them."""

from __future__ import annotations

import warnings

import pytest
from cabled_square import clamped
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, PathWarning, Solver, meshes

pytestmark = pytest.mark.ranks


def test_an_end_that_the_membrane_rises_above_is_told(comm: MPI.Intracomm) -> None:
    mesh = meshes.spherical_cap(comm, 10.0, 4.0, 1.5)
    scene = clamped(mesh, IsotropicMembrane(E=100.0, nu=0.3, thickness=1.0))
    solver = Solver(scene)
    solver.advance(pressure=0.1)
    top = comm.allreduce(float(scene.positions()[:, 2].max(initial=0.0)), op=MPI.MAX)
    path = [(0.0, 1.0, top + 0.3), (12.0, 2.0, 0.0)]
    scene.lay_cable(Cable(1e3), path, L0=14.0, name="stay")
    assert solver.advance().warnings == ()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PathWarning)
        step = solver.advance(pressure=3.0)
    assert [one.category for one in caught] == [PathWarning] * (comm.rank == 0)
    (found,) = (one for one in step.warnings if one.kind == "cable end")
    assert found.text.startswith("the start of 'stay' at (0, 1, ")
    assert "under the membrane" in found.text
    assert solver.advance(pressure=0.1).warnings == ()
    assert scene.warnings == ()
