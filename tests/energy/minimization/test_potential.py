"""What the potential knows of its state, and when it works it out again."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from term_scene import cable_square, displaced

from crms_fenicsx.energy.minimization.potential import Potential

pytestmark = pytest.mark.ranks


def shaken(comm: MPI.Intracomm) -> tuple[Potential, list]:
    """A potential of a membrane with cables, and two states as the minimiser asks for them."""
    system = cable_square(comm)
    potential, n = system.potential, system.unknowns.n_owned
    states = []
    for size in (0.5, 0.6):
        X = potential.x_vector.duplicate()
        X.array[:] = (displaced(system.unknowns, size) * ~system.unknowns.held[:n]).ravel()
        states.append(X)
    return potential, states


def test_the_state_that_was_evaluated_last_is_not_evaluated_again(comm: MPI.Intracomm) -> None:
    potential, (a, b) = shaken(comm)
    G = a.duplicate()
    energy = potential.objective_gradient(None, a, G)
    gradient = G.array.copy()
    count = potential.evaluations
    potential.place(a)
    again, _ = potential.evaluate_terms()
    potential.free_gradient(G)
    assert potential.evaluations == count
    np.testing.assert_allclose(again, energy, rtol=1e-13)
    np.testing.assert_allclose(G.array, gradient, rtol=1e-12, atol=1e-12 * np.abs(gradient).max())
    # another state is, also if it was evaluated before the last one
    potential.objective_gradient(None, b, G)
    potential.place(a)
    np.testing.assert_allclose(potential.evaluate_terms()[0], energy, rtol=1e-13)
    assert potential.evaluations == count + 2


def test_a_state_placed_by_hand_is_evaluated(comm: MPI.Intracomm) -> None:
    potential, (a, b) = shaken(comm)
    G = a.duplicate()
    first = potential.objective_gradient(None, a, G)
    other = potential.objective_gradient(None, b, G)
    assert abs(other - first) > 1e-6 * abs(first)
    potential.x_vector.array[:] = a.array
    potential.place()
    assert abs(potential.evaluate_terms()[0] - first) < 1e-12 * abs(first)
    potential.place(b)  # asked for before, but not there any more
    assert abs(potential.evaluate_terms()[0] - other) < 1e-12 * abs(other)
