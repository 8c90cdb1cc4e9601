"""Supports that move by functions of place and time, and turn."""

import numpy as np
import pytest
from cabled_square import clamped

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Rotation, Scene, Solver, meshes
from crms_fenicsx.analysis.steps.movements import Motion

TURN = Rotation((0.0, 0.0, 0.0), (0.0, 0.0, 2.0), np.pi / 6)


def drum(comm, folder=None, resume=None):
    """A flat, prestressed disc."""
    mesh = meshes.circle(comm, radius=2.0, size=1.0)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=0.1, prestress=2.0))
    return Solver(scene, results=folder, resume=resume)


def turned(x, angle):
    """Places (n, 3) turned about z."""
    c, s = np.cos(angle), np.sin(angle)
    return x @ np.array([(c, s, 0), (-s, c, 0), (0, 0, 1.0)])


def test_a_rotation_is_that_of_its_matrix():
    """About any axis, also by more than a turn; by tiny angles without loss of digits."""
    rng = np.random.default_rng(2)
    point, axis, x = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(3, 7))
    k = axis / np.linalg.norm(axis)
    K = np.array([(0, -k[2], k[1]), (k[2], 0, -k[0]), (-k[1], k[0], 0)])
    for angle in (0.3, -9.0):
        for t in (0.0, 0.4, 1.0):
            a = t * angle
            R = np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K
            exact = (R - np.eye(3)) @ (x - point[:, None])
            found = Rotation(point, axis, angle)(x, t)
            np.testing.assert_allclose(found, exact, atol=1e-14)
    tiny = Rotation(point, axis, 1e-12)(x, 1.0)
    np.testing.assert_allclose(tiny, 1e-12 * K @ (x - point[:, None]), atol=1e-23)


@pytest.mark.ranks
def test_a_ring_turned_in_steps_goes_on_its_circle(comm):
    """And lands exactly; the membrane turns with it as a rigid body."""
    solver = drum(comm)
    solver.advance()
    scene, X = solver.scene, solver.scene.membrane.stress_free
    ring = scene.vertices("boundary")
    solver.advance(move={"boundary": TURN}, steps=3)
    np.testing.assert_allclose(scene.positions()[ring], turned(X[ring], np.pi / 6), atol=1e-14)
    np.testing.assert_allclose(scene.positions(), turned(X, np.pi / 6), atol=1e-8)
    assert all(step.verification.passed for step in solver.steps)


def test_positions_within_a_call_are_those_of_the_function(comm):
    """Not of the chord; displacements of two names add up."""
    solver = drum(comm)
    scene, seen = solver.scene, []
    ring = scene.vertices("boundary")
    accept = solver._accept

    def note(*arguments):
        seen.append(scene.positions()[ring])
        accept(*arguments)

    solver._accept = note
    up = (0.0, 0.0, 0.3)

    def tilt(x, t):
        assert x.shape[0] == 3
        return np.array([0 * x[0], 0 * x[0], 0.1 * t**2 * x[0]])

    X = scene.positions()[ring]
    solver.advance(move={"boundary": TURN}, steps=2)
    np.testing.assert_allclose(seen[0], turned(X, np.pi / 12), atol=1e-14)
    solver.advance(move={"boundary": tilt}, steps=2)
    x = turned(X, np.pi / 6)
    np.testing.assert_allclose(seen[2][:, 2] - x[:, 2], 0.025 * x[:, 0], atol=1e-14)
    np.testing.assert_allclose(seen[3][:, 2] - x[:, 2], 0.1 * x[:, 0], atol=1e-14)
    solver.advance(move={"boundary": up})
    np.testing.assert_allclose(seen[4] - seen[3], np.tile(up, (len(ring), 1)), atol=1e-14)
    tilted = Rotation((0.0, 0.0, 1.0), (0.0, 1.0, 1.0), 1e-3)
    assert Motion.of("", tilted, np.array([(0.0, 1.0, 2.0)]), 1).moving().sum() == 0, "the axis"


def test_cable_ends_turn(comm):
    solver = drum(comm)
    scene = solver.scene
    cable = scene.lay_cable(Cable(1e3), [(-3.0, 0.2, 0.0), (3.0, 0.1, 0.0)], tension=1.0)
    ends = cable.state.positions[[0, -1]]
    solver.advance(move={cable: TURN, "boundary": TURN}, steps=2)
    np.testing.assert_allclose(cable.state.positions[[0, -1]], turned(ends, np.pi / 6), atol=1e-14)


@pytest.mark.ranks
def test_groups_need_hold_only_where_functions_move_them(comm):
    mesh = meshes.rectangle(comm, 4.0, 4.0, 1.0, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=0.1, prestress=2.0))
    scene.fix("left")
    scene.fix("right", "xz")
    solver = Solver(scene)

    def lift(x, t):
        return t * np.array([0 * x[0], 0 * x[1], 0.1 + 0.05 * x[1]])

    solver.advance(move={"right": lift})
    right = scene.vertices("right")
    X = scene.membrane.stress_free[right]
    heights = scene.positions()[right, 2]
    np.testing.assert_allclose(heights, 0.1 + 0.05 * X[:, 1], atol=1e-14)
    with pytest.raises(InputError, match=r"'right' is not held in y, .*scene\.fix\('right', 'y'\)"):
        solver.advance(move={"right": Rotation((0, 0, 0), (1, 0, 0), 0.1)})


@pytest.mark.ranks
def test_functions_that_return_something_else_are_refused(comm):
    solver = drum(comm)
    u = solver.scene.u.x.array.copy()
    bad = {
        "shape": lambda x, t: t * x.T[:, :2],
        "finite": lambda x, t: np.full_like(x, np.nan) * t,
        "must begin at zero": lambda x, t: x,
        "real numbers": lambda x, t: x * 1j * t,
        "three finite numbers": "up",
    }
    for words, move in bad.items():
        with pytest.raises(InputError, match=words):
            solver.advance(move={"boundary": move})
    calls = []

    def fails_later(x, t):
        """In the middle of the second step, as on one rank alone."""
        calls.append(t)
        bad = len(calls) > 5 and comm.rank == comm.size - 1
        return np.full_like(x, np.nan) if bad else 0.01 * t * x

    with pytest.raises(InputError, match="must return finite numbers"):
        solver.advance(move={"boundary": fails_later}, steps=3)
    np.testing.assert_allclose(solver.scene.positions()[:, 2], 0.0, atol=1e-15)
    done, solver = len(solver.steps), drum(comm)
    assert done == 1
    with pytest.raises(InputError, match="must begin"):
        solver.advance(move={"boundary": lambda x, t: 1.0 + x})
    assert not solver.steps
    np.testing.assert_array_equal(solver.scene.u.x.array, u)
    for arguments, words in (
        (((0, 0), (0, 0, 1), 1.0), "point"),
        (((0, 0, 0), (0, 0, 0), 1.0), "axis"),
        (((0, 0, 0), (0, 0, 1), np.inf), "angle"),
    ):
        with pytest.raises(InputError, match=f"Rotation: {words}"):
            Rotation(*arguments)


def test_a_run_goes_on_and_knows_functions_by_their_values(comm, folder):

    def wave(size):
        return lambda x, t: size * t * np.array([0 * x[0], 0 * x[0], np.sin(x[0])])

    first = drum(comm, folder, False)
    first.advance(move={"boundary": wave(0.3)}, steps=2)
    first.advance(move={"boundary": TURN})
    u = first.scene.u.x.array.copy()
    del first
    again = drum(comm, folder, True)
    again.advance(move={"boundary": wave(0.3)}, steps=2)
    again.advance(move={"boundary": TURN})
    np.testing.assert_array_equal(again.scene.u.x.array, u)
    assert [step.number for step in again.steps] == [1, 2, 3]
    del again
    other = drum(comm, folder, True)
    with pytest.raises(InputError, match=r"at call 1 of advance the script is not the one"):
        other.advance(move={"boundary": wave(0.31)}, steps=2)
