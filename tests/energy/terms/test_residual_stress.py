"""Section forces that stay: derivatives, and the slow twin."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from taylor import gradient_order, noise, stiffness_error
from term_scene import ISOTROPIC, corners, displaced, irregular_square

from crms_fenicsx import Scene
from crms_fenicsx.energy.minimization.taylor import TermsOnLayout
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.dofs.layout import Unknowns


def energy_one_by_one(scene: Scene, forces: np.ndarray) -> float:
    """This rank's share of ``int S : E``, cell after cell, by sides: E gives half the changes of
    their squares."""
    total = 0.0
    for before, now, S in zip(*corners(scene), forces, strict=True):
        sides, moved = (np.diff(x, axis=0).T for x in (before, now))  # (3, 2)
        dual = np.linalg.pinv(sides)  # (2, 3): S in it has components with upper indices
        change = (moved.T @ moved - sides.T @ sides) / 2
        area = np.linalg.norm(np.cross(*sides.T)) / 2
        total += area * float(np.sum((dual @ S @ dual.T) * change))
    return total


@pytest.mark.ranks
def test_residual_stress(comm: MPI.Intracomm) -> None:
    scene = Scene(irregular_square(comm, 20.0), ISOTROPIC)
    forces = np.random.default_rng(comm.rank).normal(size=(len(scene.V.dofmap.list), 3, 3))
    forces = forces + forces.transpose(0, 2, 1)
    unknowns = Unknowns(scene.V)
    terms = TermsOnLayout(unknowns, scene.u, [ResidualStress(scene.u, forces)], exact=True)
    x = displaced(unknowns, 5.0)
    energy, _ = terms.value(x)
    assert energy == pytest.approx(comm.allreduce(energy_one_by_one(scene, forces)), rel=1e-10)
    d = noise(unknowns.X[: unknowns.n_owned], 7)
    assert gradient_order(terms, x, d) > 1.9
    assert stiffness_error(terms, x, d) < 1e-6
