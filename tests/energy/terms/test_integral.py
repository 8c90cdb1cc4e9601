"""Terms that are assembled in one pass over the cells."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from mpi4py import MPI
from term_scene import FABRIC, ISOTROPIC, cable_square, displaced, on_mesh

from crms_fenicsx.model.materials import MembraneMaterial

BOTH = "MembraneEnergy", "FollowerPressure"


@pytest.mark.ranks
@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC])
def test_terms_together_are_those_alone(comm: MPI.Intracomm, material: MembraneMaterial) -> None:
    system = cable_square(comm, material)
    x = displaced(system.unknowns, 2.0)
    energies, gradients = zip(*(on_mesh(system, name).value(x) for name in BOTH), strict=True)
    energy, gradient = on_mesh(system, *BOTH).value(x)
    assert energy == pytest.approx(sum(energies), rel=1e-12)
    size = comm.allreduce(max(np.abs(g).max() for g in gradients), op=MPI.MAX)
    np.testing.assert_allclose(gradient, sum(gradients), rtol=0, atol=1e-12 * size)


def test_a_new_layout_of_the_unknowns_compiles_nothing(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = cable_square(comm)
    system.potential.evaluate()
    energies = system.potential.energies()
    monkeypatch.delattr(fem, "form")
    monkeypatch.delattr(fem, "compile_form")
    system.rebuild()
    system.read_scene()
    system.potential.evaluate()
    assert system.potential.energies() == pytest.approx(energies, rel=1e-12)
