"""What a DOLFINx must be to be used."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx import InputError, IsotropicMembrane, Scene, meshes
from crms_fenicsx.design.form_finding import find_form

pytestmark = pytest.mark.ranks

ROOT = Path(__file__).parents[3]
VERSIONS = r"geometry\.dofmaps?\b|\.create_mesh\([\w.]+, \w+, |interpolation_points\(\)"
"""What is written differently for some DOLFINx; names of arguments have stayed."""


@pytest.mark.parametrize("kind", [np.complex128, np.float32])
def test_numbers_that_are_not_real_are_refused(
    comm: MPI.Intracomm, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the first scene or form, with the builds that have real ones."""
    mesh = meshes.rectangle(comm, 1.0, 1.0, 0.5)
    material = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
    with monkeypatch.context() as patch:
        patch.setattr(PETSc, "ScalarType", kind)
        for call in (
            lambda: Scene(mesh, material),
            lambda: find_form(mesh, 1.0, fixed=["boundary"]),
        ):
            with pytest.raises(InputError, match=rf"type {kind.__name__} here .* petsc=\*=real\*"):
                call()
    Scene(mesh, material)


def test_differences_of_versions_are_in_one_place() -> None:
    """Also those that the DOLFINx of this run does not have."""
    files = [
        path
        for folder in ("crms_fenicsx", "tests", "benchmarks", "demos")
        for path in ROOT.joinpath(folder).rglob("*.py")
        if path.name not in ("compat.py", Path(__file__).name)
    ]
    found = [str(path) for path in files if re.search(VERSIONS, path.read_text())]
    assert len(files) > 100
    assert not found
