"""Second derivatives of all terms: Taylor tests on the mesh, and a kink by differences; section
forces that stay."""

import numpy as np
import pytest
from mpi4py import MPI
from taylor import TermOnPoints, gradient_order, noise, stiffness_error, stiffness_order
from term_scene import (
    FABRIC,
    ISOTROPIC,
    STIFF,
    cable_square,
    corners,
    directions,
    displaced,
    irregular_square,
)

from crms_fenicsx import Scene
from crms_fenicsx.energy.minimization.taylor import TermsOnLayout, TermsWithDyads
from crms_fenicsx.energy.terms.fold_penalty import FoldAngles, FoldPenalty, add_curvature
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.dofs.layout import Unknowns

TERMS = [
    "MembraneEnergy", "FoldedMembraneEnergy", "FoldPenalty", "FollowerPressure",
    "FoldedFollowerPressure", "CableTension",
]  # fmt: skip


@pytest.mark.ranks
@pytest.mark.parametrize("material", [ISOTROPIC, STIFF, FABRIC], ids=["wrinkling", "raw", "fabric"])
@pytest.mark.parametrize("name", TERMS)
def test_second_derivatives(comm, name, material):
    """Where cells are taut, wrinkled and slack at once; raw ones are in compression as well."""
    system = cable_square(comm, material)
    term = next(t for t in system.potential.terms if type(t).__name__ == name)
    f = TermsWithDyads(system.unknowns, system.scene.u, [term], exact=True)
    x = displaced(f.unknowns, 1.5, stretch=1.02)
    for way, d in directions(f.unknowns).items():
        if np.abs(f.times(x, d)).max(initial=0.0) == 0.0 and way != "all":
            continue  # plain cells know no points
        assert stiffness_error(f, x, d, h=1e-5) < 2e-6, way


@pytest.mark.ranks
def test_second_derivatives_of_the_whole(comm):
    """The remainder of the potential's expansion is of third order."""
    system = cable_square(comm)
    f = TermsWithDyads(system.unknowns, system.scene.u, system.potential.terms, exact=True)
    x, d = displaced(f.unknowns, 0.05, stretch=1.1), directions(f.unknowns)["all"]
    assert stiffness_order(f, x, d, 0.02 * 0.5 ** np.arange(5)) == pytest.approx(3, abs=0.1)


@pytest.mark.parametrize("weighted", [True, False], ids=["weighted", "literal"])
def test_curvature_of_a_kink_by_differences(weighted):
    """Beside the Gauss-Newton stiffness: 2 mu w r times differences of the slope of w r."""
    for seed in range(20):
        X = np.random.default_rng(seed).normal(size=(4, 3))
        table = FoldAngles(np.array([(0, 1, 2, 3)], dtype=np.int32), np.array([3.0]), weighted)
        f = TermOnPoints(FoldPenalty(table), X)

        def slope(x, f=f):
            f.value(x)
            return f.term._dr[0].ravel().copy()

        h = 1e-6
        units = h * np.eye(12).reshape(12, 4, 3)
        twin = np.array([(slope(e) - slope(-e)) / (2 * h) for e in units])
        f.value(0 * X)
        r, blocks = f.term.residuals, np.zeros((1, 4, 4, 3, 3))
        add_curvature(X, 0 * X, table.points, table.coefficients, weighted, r, blocks)
        made = blocks[0].transpose(0, 2, 1, 3).reshape(12, 12) / (6.0 * r[0])
        np.testing.assert_allclose(made, twin, atol=1e-7 * np.abs(twin).max())


def test_zero_pressure_has_none(comm):
    """A scene's pressure may come back to zero; the places of its derivatives stay."""
    system = cable_square(comm)
    system.pressure.value.value = 0.0
    names = ("FollowerPressure", "FoldedFollowerPressure")
    terms = [t for t in system.potential.terms if type(t).__name__ in names]
    assert len(terms) == 2
    f = TermsWithDyads(system.unknowns, system.scene.u, terms, exact=True)
    x = displaced(f.unknowns, 1.0)
    assert np.all(f.times(x, noise(x, 3)) == 0.0)


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
