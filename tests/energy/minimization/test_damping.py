"""Sliding points in Newton's steps: stopped short of the ends of their edges."""

from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from taylor import noise
from term_scene import cable_square

from crms_fenicsx.energy.minimization.damping import REACH, Damping, Springs


def step(place, to):
    """A point at a fraction of an edge goes to another; where it comes, on the edge moved."""
    X = np.array([[1.0, 2.0, 0.0], [4.0, 6.0, 0.0], [0.0, 0.0, 0.0]])
    X[2] = X[0] + place * (X[1] - X[0])
    none = np.zeros((0, 2), dtype=np.int32)
    sliders = np.array([[2, 0, 1]], dtype=np.int32)
    damping = Damping(Springs(sliders, np.array([place]), none, none[:, 0], np.zeros(0)))
    moved = np.array([[0.1, 0.0, 0.3], [0.0, -0.2, 0.5], [0.0, 0.0, 0.0]])
    start, end = X[:2] + moved[:2]
    aside = np.array([0.2, 0.1, -0.4])
    aside -= aside @ (end - start) / np.sum((end - start) ** 2) * (end - start)
    moved[2] = start + to * (end - start) + aside - X[2]
    went = moved.copy()
    points, change = damping.stop_short(SimpleNamespace(X=X), np.zeros((3, 3)), moved)
    assert np.array_equal(moved[:2], went[:2])
    assert np.allclose(moved[points], went[points] + change, atol=1e-15)
    came = X[2] + moved[2] - aside - start
    fraction = came @ (end - start) / np.sum((end - start) ** 2)
    assert np.allclose(came, fraction * (end - start), atol=1e-14)
    return fraction


@pytest.mark.parametrize(
    ("place", "to", "comes"),
    [
        (0.3, 0.6, 0.6),
        (0.3, 0.1, 0.1),
        (0.3, -4.0, 0.3 * (1 - REACH)),
        (0.3, 2.5, 0.3 + REACH * 0.7),
        (1e-4, -1.0, 1e-4 * (1 - REACH)),
        (-0.01, -0.5, -0.01),
        (-0.01, 0.4, 0.4),
        (1.02, 1.5, 1.02),
    ],
)
def test_sliding_points_stop_short_of_the_ends_of_their_edges(place, to, comes):
    assert step(place, to) == pytest.approx(comes, abs=1e-14)


@pytest.mark.ranks
def test_work_of_a_step_counts_points_that_were_stopped(comm):
    system = cable_square(comm)
    potential, unknowns = system.potential, system.unknowns
    newton = system.minimizer._newton_method
    x0, x, g = (potential.x_vector.duplicate() for _ in range(3))
    potential.x_vector.copy(x0)
    potential.evaluate()
    potential.free_gradient(g)
    n = unknowns.n_owned
    way = 30.0 * noise(unknowns.X[:n], 5) * ~unknowns.held[:n]  # several edges long
    x.array[:] = x0.array + way.ravel()
    straight = g.dot(x) - g.dot(x0)
    stopped = newton._stop_points(x0, x)
    assert comm.allreduce(len(stopped[0]), op=MPI.SUM) > 5
    work = straight + newton._work(g, stopped)
    assert work == pytest.approx(g.dot(x) - g.dot(x0), rel=1e-11, abs=1e-9 * g.norm() * x.norm())
    assert abs(work - straight) > 1e-3 * abs(straight)
    for vector in (x0, x, g):
        vector.destroy()
