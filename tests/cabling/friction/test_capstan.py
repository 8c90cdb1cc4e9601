"""Friction along cables: the capstan's law, stick, what it dissipates, and on a soft membrane."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, clamped, order, sheet
from mpi4py import MPI
from roped_drum import AROUND, EA, FREE, WRAP, exact_tensions, places, roped
from taylor import OnMesh, dense, gradient_order, is_semidefinite
from term_scene import ISOTROPIC, directions, displaced, irregular_square, on_mesh

from crms_fenicsx import Cable, Friction, InputError, LaidCable, Scene, Solver
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.cabling.friction.passes import capstan_bounds
from crms_fenicsx.energy.terms.axial_friction import CapstanTension
from crms_fenicsx.energy.terms.capstan_chain import ENERGY, LAW, find_slips, spread_evenly


def pull(solver: Solver, cable: LaidCable, by: float, steps: int = 1) -> float:
    """Pull the rope's end straight down; return the work by the trapezoidal rule."""
    work = 0.0
    for _ in range(steps):
        before = cable.end.reaction[2]
        solver.advance(move={cable.end: (0.0, 0.0, -by / steps)})
        work -= (before + cable.end.reaction[2]) / 2 * by / steps
    return work


# the law


@pytest.mark.ranks
@pytest.mark.parametrize("jitter", [0.0, 0.25])
@pytest.mark.parametrize("mu", [0.1, 0.3, 1.0])
def test_sliding_rope_follows_the_capstan_law(comm, mu: float, jitter: float) -> None:
    """Whatever the mesh: each node has its exact ratio, and the angles add up to the wrap."""
    scene, rope = roped(comm, 40, mu, jitter=jitter)
    step = Solver(scene).advance(move={rope.end: (0.0, 0.0, -0.1)})
    T = rope.tensions
    assert T[-1] / T[0] == pytest.approx(np.exp(mu * WRAP), rel=1e-4)
    assert np.all(np.diff(T) >= -1e-9 * T[-1])
    for end, tension in ((rope.start, T[0]), (rope.end, T[-1])):
        assert np.linalg.norm(end.reaction) == pytest.approx(tension, rel=1e-12)
        assert -end.reaction[2] == pytest.approx(tension, rel=1e-6)
    # the mean by unstressed length is what a rope without friction would have
    assert rope.tension == pytest.approx(EA * (rope.length / rope.L0 - 1), rel=1e-12)
    assert step.outcome.passes <= 4


def test_friction_along_does_not_hold_sideways(comm) -> None:
    """A rope pulled sideways at its end slides to the same geodesic as one without friction.

    Most edges are oblique to it, so that friction along would have a part along them.
    """
    paths = []
    for mu in (0.0, 1.0):
        scene, rope = roped(comm, 20, mu, tension=5.0, jitter=0.25)
        Solver(scene).advance(move={rope.end: (0.1, 0.0, -0.05)})
        paths.append(rope.line)
        assert rope.end.reaction[0] > 0.02 * rope.tensions[-1]
    assert rope.tensions[-1] > 5 * rope.tensions[0]
    z = np.linspace(-1.0, 1.0, 9)
    free, held = (np.interp(z, x[1:-1, 1], x[1:-1, 0]) for x in paths)
    assert np.ptp(free) > 0.05
    np.testing.assert_allclose(held, free, atol=1e-3)  # a hundredth of its way


def test_pulled_tension_converges_with_the_square_of_the_cells(comm) -> None:
    """Against the exact state of an elastic rope that sticks on part of the drum."""
    sizes, errors = (10, 20, 40), []
    for n in sizes:
        scene, rope = roped(comm, n, 0.3, tension=5.0)
        pull(Solver(scene), rope, 0.012)
        errors.append(rope.tensions[-1] / exact_tensions(5.0, 0.3, [0.012])[-1] - 1)
    assert order([1 / n for n in sizes], errors) > 1.7
    assert abs(errors[-1]) < 3e-4


@pytest.mark.parametrize("jitter", [0.0, 0.25])
def test_rope_sticks_beyond_the_slip_front_and_reverses(comm, jitter: float) -> None:
    """Pulled, pulled further, let back, and back until all of the pulled part slides home."""
    n, mu, T0 = 40, 0.3, 5.0
    scene, rope = roped(comm, n, mu, tension=T0, jitter=jitter)
    solver = Solver(scene)
    pulls = [0.006, 0.004, -0.003, -0.005]
    for k, by in enumerate(pulls, start=1):
        pull(solver, rope, by)
        exact = exact_tensions(T0, mu, pulls[:k])
        # The tension jumps at each node; a jump is mu h T.
        error = np.abs(rope.tensions - np.interp(places(rope), AROUND, exact))
        assert error.max() < 0.5 * mu * WRAP / n * exact.max()
        assert rope.tensions[-1] == pytest.approx(exact[-1], rel=1e-3)
        if k == 2:  # the front: half-way in tension between the neighbours of an element
            front = AROUND[np.argmax(exact > T0 * (1 + 1e-12))]
            found = np.interp(T0 * (1 + mu * WRAP / n), rope.tensions, places(rope))
            assert found == pytest.approx(front, abs=1.5 * WRAP / n)
    # not reached by the pulls: nothing has moved there
    still = places(rope) < front - 2 * WRAP / n
    np.testing.assert_allclose(rope.tensions[still], T0, rtol=1e-4)


def test_cycles_dissipate_the_same_and_the_balance_closes(comm) -> None:
    """The trapezoidal rule's error of the work falls with the square of the steps."""
    gaps = []
    for steps, rounds in ((4, 3), (8, 2)):
        scene, rope = roped(comm, 12, 0.3, tension=5.0)
        solver = advanced(Solver(scene))
        start, losses, work = scene.energy, [0.0], 0.0
        for _ in range(rounds):
            for by in (0.012, -0.012):
                before = scene.dissipated
                work += pull(solver, rope, by, steps)
                assert scene.dissipated > before
            losses.append(scene.dissipated)
        if rounds == 3:
            assert losses[3] - losses[2] == pytest.approx(losses[2] - losses[1], rel=2e-3)
        gaps.append((work - (scene.energy - start) - scene.dissipated) / scene.dissipated)
    assert abs(gaps[1]) < 0.03
    assert abs(gaps[1]) < 0.35 * abs(gaps[0])
    assert solver.history["dissipated"][-1] == scene.dissipated


def test_result_does_not_depend_on_the_number_of_steps(comm) -> None:
    tensions = []
    for steps in (1, 5):
        scene, rope = roped(comm, 20, 0.3, tension=5.0)
        pull(Solver(scene), rope, 0.01, steps)
        tensions.append(rope.tensions)
    np.testing.assert_allclose(tensions[0], tensions[1], rtol=1e-3)  # passes settle to 1e-3


def test_winch_at_the_end_pulls_like_a_moved_end(comm) -> None:
    """Unstressed length is let in and out at the last end."""
    scene, moved = roped(comm, 20, 0.3, tension=5.0)
    pull(Solver(scene), moved, 0.01)
    scene, wound = roped(comm, 20, 0.3, tension=5.0)
    Solver(scene).advance(L0={wound: wound.L0 - 0.01 / (1 + moved.tensions[-1] / EA)})
    assert wound.tensions[0] == pytest.approx(5.0, rel=1e-6)
    np.testing.assert_allclose(wound.tensions[-1], moved.tensions[-1], rtol=2e-3)


def test_rope_that_does_not_move_keeps_its_tensions(comm) -> None:
    scene, rope = roped(comm, 20, 0.3, tension=5.0)
    solver = Solver(scene)
    pull(solver, rope, 0.01)
    before, lost = rope.tensions.copy(), scene.dissipated
    for _ in range(10):
        solver.advance()
    np.testing.assert_allclose(rope.tensions, before, rtol=1e-6)
    assert scene.dissipated - lost < 1e-6 * lost


def test_units_do_not_matter(comm) -> None:
    tensions = []
    for scale, force in ((1.0, 1.0), (1e3, 1e-2)):
        scene, rope = roped(comm, 10, 0.3, tension=5.0, scale=scale, force=force)
        Solver(scene).advance(move={rope.end: (0.0, 0.0, -0.01 * scale)})
        tensions.append(rope.tensions / force)
    np.testing.assert_allclose(tensions[0], tensions[1], rtol=1e-8)


@pytest.mark.ranks
def test_a_failed_step_leaves_no_trace(comm) -> None:
    """The state saved has the grip: a step taken again gives the same to the last digit."""
    scene, rope = roped(comm, 10, 0.3, tension=5.0)
    solver = Solver(scene)
    pull(solver, rope, 0.006)
    good = scene.state
    pull(solver, rope, 0.006)
    first = rope.tensions.copy(), scene.dissipated
    scene.state = good
    solver.system.invalidate()
    assert scene.dissipated < first[1]
    pull(solver, rope, 0.006)
    # the terms are made anew, and round otherwise
    np.testing.assert_allclose(rope.tensions, first[0], rtol=1e-10)
    assert scene.dissipated == pytest.approx(first[1], rel=1e-10)


# on an inflated membrane


@pytest.fixture(scope="module")
def inflated(comm) -> Callable[..., Any]:
    """The inflated square with a cable over it, and its last end pulled down; each solved once."""

    @functools.cache
    def solve(n: int, friction: float | Friction, kind: str):
        scene = sheet(comm, n, kind)
        solver = advanced(Solver(scene), pressure=0.01)
        path = [(-20.0, 47.0, 0.0), (120.0, 51.0, 0.0)]
        cable = scene.lay_cable(Cable(32000.0, friction=friction), path)
        for _ in range(2):
            step = solver.advance(move={cable.end: (0.0, 0.0, -8.0)})
        return scene, cable, step

    return solve


@pytest.mark.parametrize("mu", [0.0, 0.3])
@pytest.mark.parametrize("kind", ["structured", "unstructured"])
def test_tension_falls_from_the_pulled_end(inflated, kind: str, mu: float) -> None:
    """At most as steeply as the law; without friction sideways the mean tension is the same."""
    along = 0.3
    scene, cable, step = inflated(9, Friction(mu, along=along), kind)
    T, x = cable.tensions, cable.line
    assert np.all(np.diff(T) >= -1e-6 * T[-1])
    way = np.diff(x, axis=0) / np.linalg.norm(np.diff(x, axis=0), axis=1)[:, None]
    wrap = np.arccos(np.clip(np.sum(way[1:] * way[:-1], axis=1), -1.0, 1.0)).sum()
    assert 1.2 < T[-1] / T[0] <= np.exp(along * wrap) * (1 + 1e-3)
    assert step.outcome.passes <= 6
    assert scene.dissipated > 0.0
    _, free, without = inflated(9, mu, kind)
    assert cable.tension == pytest.approx(free.tension, rel=2e-3)
    assert step.outcome.evaluations < 4 * without.outcome.evaluations


def test_vanishing_friction_leaves_one_tension(inflated) -> None:
    _, free, _ = inflated(9, 0.0, "structured")
    spreads = []
    for along in (1e-2, 1e-4):
        _, cable, _ = inflated(9, Friction(0.0, along=along), "structured")
        spreads.append(np.ptp(cable.tensions) / cable.tension)
    assert spreads[1] == pytest.approx(spreads[0] / 100, rel=0.05)
    np.testing.assert_allclose(cable.tensions, free.tension, rtol=1e-4)


def test_tensions_converge_with_the_mesh(inflated) -> None:
    """Both ends', against their extrapolation from the finer meshes of the benchmark."""
    sizes, ends = (9, 17), []
    for n in sizes:
        _, cable, _ = inflated(n, Friction(0.0, along=0.3), "unstructured")
        ends.append(cable.tensions[[0, -1]])
    errors = np.abs(np.array(ends) / LIMIT - 1)
    assert np.all(errors[1] < 0.6 * errors[0])
    assert np.all(errors[1] < 1.5e-3)


LIMIT = (853.2, 1049.7)
"""Tensions at the two ends, extrapolated; see benchmarks/capstan.py."""


def test_friction_zero_changes_nothing(inflated) -> None:
    scene, cable, step = inflated(9, Friction(0.0, along=0.0), "structured")
    twin, other, same = inflated(9, 0.0, "structured")
    assert cable.state.law.axial is None
    # the same operations, but sums over several ranks may come in another order
    assert cable.tension == pytest.approx(other.tension, rel=1e-12)
    assert scene.energy == pytest.approx(twin.energy, rel=1e-12)
    assert step.outcome.evaluations == same.outcome.evaluations
    np.testing.assert_array_equal(cable.tensions, np.full(len(cable.contacts()) - 1, cable.tension))


@pytest.mark.ranks
def test_cables_with_and_without_in_one_scene(comm) -> None:
    """Two cables side by side, far apart: the one without has the same tension everywhere."""
    scene = sheet(comm, 9)
    solver = advanced(Solver(scene), pressure=0.01)
    plain = scene.lay_cable(Cable(32000.0), [(-20.0, 28.0, 0.0), (120.0, 28.0, 0.0)])
    rough = scene.lay_cable(
        Cable(32000.0, friction=Friction(0.0, along=0.3)), [(-20.0, 72.0, 0.0), (120.0, 72.0, 0.0)]
    )
    solver.advance(move={plain.end: (0.0, 0.0, -8.0), rough.end: (0.0, 0.0, -8.0)})
    assert np.ptp(plain.tensions) == 0.0
    assert rough.tensions[-1] > 1.1 * rough.tensions[0]
    assert rough.tension == pytest.approx(plain.tension, rel=1e-2)
    from crms_fenicsx.results.view_data import cable_lines

    of_plain, of_rough = (np.asarray(line.data["tension"]) for line in cable_lines(scene.net))
    assert of_plain.shape == ()
    assert of_rough.shape == (len(rough.line) - 1,)
    assert (of_rough[0], of_rough[-1]) == (rough.tensions[0], rough.tensions[-1])
    ends = [solver.history[f"tension {rough.name} {end}"][-1] for end in ("start", "end")]
    assert ends == [rough.tensions[0], rough.tensions[-1]]


def test_step_law_knows_no_friction_along() -> None:
    with pytest.raises(InputError, match=r"one tension for the whole cable.*along = 0\.2"):
        Cable(1.0, law="step", friction=Friction(0.0, along=0.2))


# the term


def gripped(comm: MPI.Intracomm, bound: float = 3.0, eps: float = 0.05, seed: int = 0) -> System:
    """The irregular square with two cables that friction holds along, and one without."""
    scene = clamped(irregular_square(comm), ISOTROPIC)
    rough, rng = Friction(0.0, along=0.3), np.random.default_rng(seed)
    scene.lay_cable(Cable(3200.0, friction=rough), [(0, 31), (100, 52)], tension=20.0)
    scene.lay_cable(Cable(2000.0), [(22, 72), (78, 82)], tension=20.0)
    scene.lay_cable(Cable(1000.0, friction=rough), [(20, 12), (83, 19)], tension=20.0)
    for cable in scene.cables:
        if cable.state.law.axial is not None:
            n = len(cable.state.law.axial.supports)
            bounds = bound * rng.uniform(0.5, 1.5, n) * (np.arange(n) % 5 != 2)
            cable.update(axial=replace(cable.state.law.axial, bounds=bounds, eps=np.full(n, eps)))
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    return system


def term_of(f: OnMesh) -> CapstanTension:
    (term,) = f.potential.terms
    assert isinstance(term, CapstanTension)
    return term


@pytest.mark.ranks
@pytest.mark.parametrize(("size", "eps"), [(0.3, 0.05), (3.0, 1.0)])
def test_gradient(comm, size: float, eps: float) -> None:
    """Of the reduced energy: slips are eliminated, and rest depends on the places on edges."""
    f = on_mesh(gripped(comm, eps=eps), "CapstanTension")
    x = displaced(f.unknowns, size)
    f.value(x)
    y = np.abs(term_of(f).slips) / eps
    assert np.any(y > 1), "some slide"
    assert np.any(y < 1), "some stick"
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03), name


def test_gradient_of_rest(comm) -> None:
    """Where the cable sticks, a fold point takes along on its edge what rests there."""
    f = on_mesh(gripped(comm, bound=1e4, eps=1.0), "CapstanTension")
    term = term_of(f)
    assert comm.allreduce(float(np.abs(term.grips.slope).max(initial=0.0)), op=MPI.MAX) > 5.0
    x = displaced(f.unknowns, 0.3)
    d = directions(f.unknowns)["points"]
    assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03)


@pytest.mark.ranks
@pytest.mark.parametrize(("bound", "eps"), [(3.0, 0.05), (1e4, 1e-3), (1e-3, 1e-6)])
def test_stiffness_is_positive_semidefinite_and_has_few_dyads(comm, bound, eps) -> None:
    f = on_mesh(gripped(comm, bound, eps), "CapstanTension")
    x = displaced(f.unknowns, 0.3)
    K = dense(f.assembled(x))
    assert is_semidefinite(K)
    term = term_of(f)
    values = term.dyads(f.potential.sums_of(term), exact=False)
    assert np.all(values > 0)
    assert len(values) <= 8 * 2
    if bound == 1e-3:  # all slides, each cable as one
        EA, L0 = term.chains.EA, term.L0
        np.testing.assert_allclose(np.sort(values), np.sort(EA / L0), rtol=1e-9)


def test_segments_as_short_as_rounding_are_not_stiff(comm) -> None:
    """At a held end a segment has no length, or what rounding makes of it; H0 is the same."""
    f = on_mesh(gripped(comm, bound=1e4, eps=1e-3), "CapstanTension")
    noise = np.random.default_rng(comm.rank).normal(size=(f.unknowns.n_owned, 3))
    exact, rounded = (np.abs(dense(f.assembled(size * noise))).max() for size in (0.0, 1e-13))
    assert rounded < 1e4 * exact


def test_a_crossing_inside_a_span_slides_along_it(comm: MPI.Intracomm) -> None:
    """It divides the span into segments, which share one elongation: only tensions hold it."""
    scene = clamped(irregular_square(comm), ISOTROPIC)
    rough = Friction(0.0, along=0.3)
    for path in [(0, 31), (100, 52)], [(22, 100), (38, 0)]:
        cable = scene.lay_cable(Cable(3200.0, friction=rough), path, tension=20.0)
        n = len(cable.state.law.axial.supports)
        cable.update(
            axial=replace(cable.state.law.axial, bounds=np.full(n, 1e4), eps=np.full(n, 1e-3))
        )
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    f = on_mesh(system, "CapstanTension")
    A = f.assembled(displaced(f.unknowns, 0.0))
    K, block, numbering = dense(A), 0, system.cables.numbering
    (k,) = [k for k, node in enumerate(cable.state.nodes) if node.kind == "crossing"]
    if numbering.is_mine(1, k):
        block = A.getOwnershipRange()[0] + 3 * numbering.block(1, k)
    block = comm.allreduce(block, op=MPI.MAX)
    own = K[block : block + 3, block : block + 3]
    way = cable.state.positions[k + 1] - cable.state.positions[k - 1]
    along = way / np.linalg.norm(way)
    across = along[[1, 0, 2]] * [1.0, -1.0, 1.0]
    ends = [[c.state.positions[i] for i in (j - 1, j, j + 1)] for c, j in _at_crossings(scene)]
    tensions = max(20.0 / np.linalg.norm(np.diff(x, axis=0), axis=1).min() for x in ends)
    for direction in (along, across):
        assert direction @ own @ direction < 10 * tensions


def _at_crossings(scene: Scene) -> list[tuple[LaidCable, int]]:
    return [
        (c, k)
        for c in scene.cables
        for k, node in enumerate(c.state.nodes)
        if node.kind == "crossing"
    ]


# the chain of slips


def chain(m: int, seed: int, strain: float = 0.01, noise: float = 0.3):
    """Spans, what rests between them, unstressed length, angles times friction, eps."""
    rng = np.random.default_rng(seed)
    spans = rng.uniform(0.05, 1.0, m)
    L0 = spans.sum() / (1 + strain)
    rest = np.cumsum(spans)[:-1] / (1 + strain) + noise * strain * rng.normal(size=m - 1)
    wrap = rng.uniform(0.01, 0.3, m - 1) * (rng.random(m - 1) > 0.2)
    return spans, rest, L0, wrap, np.where(wrap > 0, 0.02 * strain, 1.0)


def potential(kind, spans, rest, L0, bound, eps, s) -> float:
    """What the slips minimise, as it is written down."""
    d = np.diff(np.concatenate([[0.0], rest + s, [L0]]))
    y = np.abs(s) / eps
    friction = np.sum(bound * eps * np.where(y < 1, y**2 - y**3 / 3, y - 1 / 3))
    if kind == LAW:
        return float(np.sum(d * np.log(d) + (spans - d) * np.log(spans - d)) + friction)
    return float(np.sum(np.maximum(spans - d, 0.0) ** 2 / (2 * d)) + friction)


@pytest.mark.parametrize("kind", [ENERGY, LAW])
@pytest.mark.parametrize("m", [1, 2, 5, 9])
def test_slips_minimise_the_potential(kind: int, m: int) -> None:
    """Against a general minimiser, from another start."""
    from scipy.optimize import minimize

    for seed in range(4):
        spans, rest, L0, wrap, eps = chain(m, seed)
        bound = wrap * (0.01 if kind == ENERGY else 1.0)
        s, d = np.zeros(m - 1), np.zeros(m)
        assert find_slips(kind, spans, rest, L0, bound, eps, s, d) >= 0
        assert d.sum() == pytest.approx(L0, rel=1e-14)
        np.testing.assert_allclose(d, np.diff(np.concatenate([[0], rest + s, [L0]])), rtol=1e-12)
        if m == 1:
            continue
        least = potential(kind, spans, rest, L0, bound, eps, s)
        even = np.zeros(m - 1)
        spread_evenly(spans, rest, L0, even)

        def value(t, data=(spans, rest, L0, bound, eps), even=even, least=least) -> float:
            energy = potential(kind, *data, even + 0.01 * t) - least
            return 1e4 * energy if np.isfinite(energy) else 1e9

        with np.errstate(invalid="ignore", divide="ignore"):
            found = minimize(
                value, np.zeros(m - 1), method="Powell",
                options={"xtol": 1e-10, "ftol": 1e-14, "maxiter": 20000},
            )  # fmt: skip
            assert found.fun > -1e-9, "it is the least value"
            np.testing.assert_allclose(even + 0.01 * found.x, s, atol=2e-5)


@pytest.mark.parametrize("m", [2, 30, 200])
@pytest.mark.parametrize("strain", [1e-5, 1e-2, 0.3])
def test_both_problems_have_one_solution(m: int, strain: float) -> None:
    """The law's bounds, given to the potential, lead to the law's slips: one pass settles."""
    spans, rest, L0, wrap, eps = chain(m, m, strain)
    s, d = np.zeros(m - 1), np.zeros(m)
    iterations = find_slips(LAW, spans, rest, L0, wrap, eps, s, d)
    assert 0 <= iterations < 200
    T = (spans - d) / d
    y = np.clip(s / eps, -1, 1)
    # forces of 1e-14 by rounding, relative to the strain and to the stiffness of the spans
    np.testing.assert_allclose(
        np.log(T[1:] / T[:-1]), -wrap * y * (2 - np.abs(y)), atol=1e-12 / strain
    )
    bound = capstan_bounds(np.sqrt(T[1:] * T[:-1]), wrap, s / eps)
    other, e = np.zeros(m - 1), np.zeros(m)
    assert 0 <= find_slips(ENERGY, spans, rest, L0, bound, eps, other, e) < 300
    np.testing.assert_allclose((spans - e) / e, T, rtol=1e-12 / strain + 1e-12)


def test_slack_spans_have_no_tension() -> None:
    """Bounds too large for the tension that there is: one part is slack, none is pushed."""
    spans = np.array([1.0, 1.0, 1.0])
    rest, L0 = np.array([1.02, 1.98]), 2.97
    bound, eps, s, d = np.full(2, 1.0), np.full(2, 1e-6), np.zeros(2), np.zeros(3)
    assert find_slips(ENERGY, spans, rest, L0, bound, eps, s, d) >= 0
    assert d[0] > 1.0
    assert np.all(d[1:] < 1.0)
    assert np.abs(s).max() < 1e-6


def test_slack_spans_are_as_long_as_they_like() -> None:
    """Of a nearly slack chain with three spans in tension: between slack ones friction of 1e-10 of
    EA brings nodes back to where they have no slip, soon."""
    spans = np.array([10.020716320, 9.763430773, 9.467800322, 11.323795169, 11.808231211,
                      12.467055930, 13.024774050, 13.422646416, 13.631030025])  # fmt: skip
    rest = np.array([10.027547045, 19.813914993, 29.293633273, 40.606216203, 52.418013658,
                     64.891500363, 77.920840366, 91.356148969])  # fmt: skip
    bound = np.array([2.6e-10, 8.1e-10, 6.3e-6, 5.6e-9, 1.9e-9, 4.2e-8, 1.9e-9, 1.1e-9])
    eps = np.array([1.6e-11, 4.9e-11, 1.8e-7, 7e-11, 2.5e-11, 8.8e-10, 2.6e-11, 1.3e-11])
    s, d, L0 = np.zeros(8), np.zeros(9), 104.991564180
    assert 0 <= find_slips(ENERGY, spans, rest, L0, bound, eps, s, d) < 30
    strains = np.maximum(spans - d, 0.0) / d
    assert np.flatnonzero(strains).tolist() == [3, 4, 5]
    np.testing.assert_allclose(-np.diff(strains[3:6]), bound[3:5], rtol=1e-3)
    assert (np.abs(s[[0, 1, 6, 7]]) < 1e-6 * eps[[0, 1, 6, 7]]).all()


@pytest.mark.parametrize("kind", [ENERGY, LAW])
def test_slips_from_a_start_that_leaves_a_span_nothing(kind: int) -> None:
    """After a change of the path: it is so stiff that nothing else counts beside it."""
    spans, rest = np.array([1.0, 0.3, 0.21, 0.2, 1.0]), np.array([0.98, 1.18, 1.38, 1.38])
    bound, eps, d = np.full(4, 1e-3), np.full(4, 1e-4), np.zeros(5)
    even, s = np.zeros(4), np.array([0.0, 0.0, 0.0, 1e-15])
    spread_evenly(spans, rest, 2.36, even)
    assert find_slips(kind, spans, rest, 2.36, bound, eps, even, d) >= 0
    assert find_slips(kind, spans, rest, 2.36, bound, eps, s, d) >= 0
    np.testing.assert_allclose(s, even, atol=1e-9)


def test_bounds_of_small_angles() -> None:
    """Series and formula meet; a node that slides has the capstan's difference of P."""
    wrap, G = np.array([1e-9, 1.9e-4, 2.1e-4, 0.5]), np.full(4, 0.02)
    first, second = G * np.exp(-wrap / 2), G * np.exp(wrap / 2)
    difference = second - first + (second**2 - first**2) / 2
    np.testing.assert_allclose(capstan_bounds(G, wrap, np.full(4, -3.0)), difference, rtol=1e-7)
    np.testing.assert_allclose(capstan_bounds(G, wrap, np.zeros(4)), wrap * (G + G**2), rtol=1e-12)


def test_free_length_is_the_drums(comm) -> None:
    """What the other tests take for granted: the rope wraps half the drum, tangents beside it."""
    _, rope = roped(comm, 10, 0.3, tension=1.0)
    x = rope.line
    np.testing.assert_allclose(x[0] - x[1], (0, 0, -FREE), atol=1e-12)
    np.testing.assert_allclose(x[-1] - x[-2], (0, 0, -FREE), atol=1e-12)


def test_ends_on_vertices_that_are_held(comm: MPI.Intracomm) -> None:
    """The span from the anchor to the vertex that it lies on has no length, and takes no part."""
    tensions = []
    for start in ((0.0, 100.0 / 3), (0.0, 100.0 / 3 + 1e-4)):
        scene = sheet(comm, 6)
        cable = scene.lay_cable(
            Cable(32000.0, friction=Friction(0.0, along=0.2)), [start, (100.0, 100.0 / 3)], L0=101.0
        )
        solver = advanced(Solver(scene), pressure=0.01)
        solver.advance(L0={cable: 100.5})
        tensions.append([cable.tension, cable.tensions.min(), cable.tensions.max()])
    assert {cable.state.nodes[-2].kind} == {"vertex"}
    np.testing.assert_allclose(tensions[0], tensions[1], rtol=1e-3)
