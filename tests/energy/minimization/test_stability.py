"""Numbers of negative eigenvalues, and compliances, against those of a dense matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Solver
from crms_fenicsx.energy.minimization.stability import ExactTangent, is_convex_from

COMM = MPI.COMM_SELF


def solved(weight: float) -> Solver:
    """A sheet with a cable and a prop, its tangent with dyads; unstable under more water."""
    soft = IsotropicMembrane(E=10.0, nu=0.3, thickness=1.0, prestress=1.0)
    scene = sheet(COMM, 4, material=soft, side=4.0)
    scene.lay_cable(Cable(100.0), [(0.0, 1.3), (4.0, 2.1)], tension=0.5)
    prop = scene.add_bar(Bar(1e3), (3.0, 3.0, -2.0), scene.vertex_at((3.0, 3.0, 0.0)))
    scene.put_load((0.0, 0.0, 0.02), name="lift", per="plan")
    solver = advanced(Solver(scene, stability="ignore"), load=1.0, L0={prop: 1.999})
    scene.put_pond(weight, volume=30.0)
    return solver


@pytest.mark.parametrize("weight", [1e-3, 5.0], ids=["stable", "unstable"])
def test_against_a_dense_matrix(weight: float) -> None:
    solver = solved(weight)
    system = solver.system
    system.prepare()
    scene = solver.scene
    scene.loads.replace_each(lambda load: replace(load, factor=1.0))
    system.prepare()
    system.read_scene()
    assert system.minimizer is not None
    system.potential.evaluate()
    found = solver.tangent()
    dense = found.matrix.convert("dense").getDenseArray()
    free = ~system.unknowns.held[: system.unknowns.n_owned].ravel()
    K = dense[np.ix_(free, free)]
    expected = int(np.sum(np.linalg.eigvalsh((K + K.T) / 2) < 0.0))
    assert (expected > 0) == (weight > 1.0)
    tangent = ExactTangent(system.potential, system.minimizer.h0)
    assert tangent.negative == expected
    blocks = np.array([0, 7, 12], dtype=np.int32)
    rows = (3 * blocks[:, None] + np.arange(3)).ravel()
    full = np.zeros_like(dense)
    full[np.ix_(free, free)] = np.linalg.inv(K)
    np.testing.assert_allclose(
        tangent.compliance(blocks), full[np.ix_(rows, rows)], rtol=1e-4, atol=1e-6
    )
    tangent.destroy()
    found.destroy()


def test_a_way_is_convex_or_not() -> None:
    """Of a bar that is pushed through its flat state, and one that is not."""
    scene = sheet(
        COMM, 2, material=IsotropicMembrane(E=1.0, nu=0.3, thickness=1.0, prestress=1.0), side=2.0
    )
    top = scene.add_joint((0.0, 9.0, 1.0), held="xy")
    scene.add_bar(Bar(1e3), (4.0, 9.0, 0.0), top)
    solver = advanced(Solver(scene, stability="ignore"))
    potential, system = solver.system.potential, solver.system
    assert system.bars is not None
    (joint,) = system.bars.blocks_of([top])
    for end, convex in ((0.95, True), (-1.0, False)):
        start = potential.x.copy()
        potential.x[joint, 2] = end - 1.0
        assert is_convex_from(potential, start) == convex
        assert potential.x[joint, 2] == end - 1.0
        potential.x[:] = start
