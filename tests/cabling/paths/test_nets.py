"""Cables that cross: one free point that both share, wherever it slides; and cables that part.

The reference figures are extrapolated from meshes whose lines carry both cables, which share a
vertex at the crossing.
"""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from cabled_square import CABLE, KINDS, PRESSURE, advanced, order, place, sheet
from mpi4py import MPI

from crms_fenicsx import LaidCable, Scene, Solver
from crms_fenicsx.cabling.paths import vertex_trials
from crms_fenicsx.cabling.paths.held_vertices import VertexRun
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.cabling.paths.vertex_trials import Trial, VertexTrials
from crms_fenicsx.model.tolerances import TOL

T_EXACT, Z_EXACT = (68.176, 33.193), 4.4317


def crossed(comm, n: int, kind: str = "structured", *, levels=(1, 0), L0=(100.3, 100.6)):
    """A cable along y on one along x, over the inflated square."""
    scene = sheet(comm, n, kind)
    upper = scene.lay_cable(CABLE, [(50, 0), (50, 100)], L0=L0[0], layer=levels[0])
    lower = scene.lay_cable(CABLE, [(0, 50), (100, 50)], L0=L0[1], layer=levels[1])
    Solver(scene).advance(pressure=PRESSURE)
    return scene, upper, lower


def heights(scene: Scene) -> list[float]:
    """Heights of upper over lower cable wherever they cross in plan, by all pairs of segments."""
    found = []
    for a, lower in enumerate(scene.cables):
        for b, upper in enumerate(scene.cables):
            if (lower.layer, a) < (upper.layer, b) and lower.taut and upper.taut:
                found += segments_above(lower, upper)
    return found


def segments_above(lower: LaidCable, upper: LaidCable) -> list[float]:
    found = []
    p, q = (cable.state.positions[cable.contacts()] for cable in (lower, upper))
    for a, b in pairwise(p):
        for c, d in pairwise(q):
            u, v, w = b - a, d - c, c - a
            cross = u[0] * v[1] - u[1] * v[0]
            if abs(cross) < 1e-14:
                continue
            s, t = (w[0] * v[1] - w[1] * v[0]) / cross, (w[0] * u[1] - w[1] * u[0]) / cross
            if max(abs(s - 0.5), abs(t - 0.5)) <= 0.5 + 1e-9:  # a crossing at a point counts
                found.append(float((c + t * v - a - s * u)[2]))
    return found


@pytest.mark.parametrize("kind", ["on mesh lines", *KINDS])
def test_crossing_cables_converge(comm, kind: str) -> None:
    """Tensions with order 2 (they scatter on unstructured meshes); without a shared point: 8 %."""
    sizes, T = ((8, 16, 32) if kind == "on mesh lines" else (9, 17, 33)), []
    for n in sizes:
        _, upper, lower = crossed(comm, n, "structured" if kind == "on mesh lines" else kind)
        T.append([upper.tension - T_EXACT[0], lower.tension - T_EXACT[1]])
    h = [1 / n for n in sizes]
    assert min(order(h, errors) for errors in np.array(T).T) > 1.7
    assert np.abs(T[-1]) == pytest.approx(0.0, abs=0.12)
    x = place(upper, 50.0, axis=1)
    assert x == pytest.approx([50.0, 50.0, Z_EXACT], abs=0.005)
    assert place(lower, 50.0)[2] == pytest.approx(x[2], abs=1e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_crossing_point_lies_on_both_cables(comm, kind: str) -> None:
    scene, upper, lower = crossed(comm, 9, kind)
    shared = [[x for x, node in zip(cable.state.positions, cable.state.nodes, strict=True)
               if node.crossing is not None or node.kind == "vertex"]
              for cable in (upper, lower)]  # fmt: skip
    gaps = np.linalg.norm(np.array(shared[0])[:, None] - np.array(shared[1])[None], axis=2)
    assert gaps.min() == 0.0
    assert heights(scene) == pytest.approx([0.0] * len(heights(scene)), abs=1e-9)


@pytest.mark.ranks
@pytest.mark.parametrize("kind", KINDS)
def test_cables_part_where_the_slacker_one_is_on_top(comm, kind: str) -> None:
    together, upper, lower = crossed(comm, 9, kind)
    apart, tight, slack = crossed(comm, 9, kind, levels=(0, 1))
    assert tight.tension < upper.tension - 2.0
    assert slack.tension > lower.tension + 1.0
    assert min(heights(apart)) > 0.3
    assert apart.energy < together.energy


@pytest.mark.parametrize("kind", KINDS)
def test_net_without_tension_leaves_no_trace(comm, kind: str) -> None:
    scene, upper, lower = crossed(comm, 9, kind, L0=(110.0, 110.0))
    assert upper.tension == lower.tension == 0.0
    bare = sheet(comm, 9, kind)
    Solver(bare).advance(pressure=PRESSURE)
    assert scene.energy == pytest.approx(bare.energy, rel=1e-10)


def random_net(comm, seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    scene = sheet(comm, 11, KINDS[seed % 3])
    for _ in range(2 + seed):
        u, v = rng.uniform(8, 92, 2)
        path = [(0.0, u), (100.0, v)] if rng.random() < 0.5 else [(u, 0.0), (v, 100.0)]
        L0 = float(np.linalg.norm(np.subtract(*path)) * rng.uniform(1.0, 1.01))
        scene.lay_cable(CABLE, path, L0=L0, layer=int(rng.integers(3)))
    return scene


@pytest.mark.ranks
@pytest.mark.parametrize("seed", range(6))
def test_random_nets_converge(comm, seed: int) -> None:
    """No upper cable runs below a lower one, by more than a thousandth of a cell."""
    scene = random_net(comm, seed)
    step = Solver(scene).advance(pressure=PRESSURE)
    assert step.halvings == 0
    assert sum(cable.taut for cable in scene.cables) >= 2
    assert min(heights(scene), default=0.0) > -1e-3 * 100 / 11


@pytest.mark.ranks
@pytest.mark.parametrize("kind", KINDS)
def test_crossing_slides_over_cells_and_off(comm, kind: str) -> None:
    """A cable is dragged along one that ends at the middle of a side; then they do not cross."""

    def made(y: float):
        scene = sheet(comm, 9, kind)
        short = scene.lay_cable(CABLE, [(47, 0), (100, 50)], L0=72.9)
        ends = [(-5.0, y, 6.0), (105.0, y, 6.0)]
        long = scene.lay_cable(CABLE, ends, L0=109.6, layer=1)
        solver = advanced(Solver(scene), pressure=PRESSURE)
        return scene, short, long, solver

    scene, short, long, solver = made(18.0)
    cells = [crossing.support for crossing in scene.net.crossings]
    for y, number in ((36.0, 1), (62.0, 0)):
        solver.advance(move={long: (0.0, y - float(long.state.positions[0, 1]), 0.0)}, steps=2)
        fresh = made(y)
        assert len(scene.net.crossings) == len(fresh[0].net.crossings) == number
        assert not set(cells) & {crossing.support for crossing in scene.net.crossings}
        assert scene.energy == pytest.approx(fresh[0].energy, rel=1e-3)
        assert short.tension == pytest.approx(fresh[1].tension, rel=1e-2)
        assert long.tension == pytest.approx(fresh[2].tension, rel=1e-2)


@pytest.mark.ranks
def test_nets_do_not_depend_on_the_ranks(comm) -> None:
    found = []
    for group in (comm, MPI.COMM_SELF):
        scene = random_net(group, 3)
        Solver(scene).advance(pressure=PRESSURE)
        found.append([scene.energy, *(cable.tension for cable in scene.cables)])
    assert found[0] == pytest.approx(found[1], rel=1e-6, abs=1e-6)


def test_crossed_cables_pass_only_vertices_that_hold_them(comm, monkeypatch) -> None:
    """Strings do not know where crossings are pressed in, and say more: see `is_crossed`."""
    from crms_fenicsx.cabling.paths import geodesic_sliding

    passed: list[tuple[set[int], set[int]]] = []
    near: set[int] = set()
    pull, pull_cable = geodesic_sliding.shorten, geodesic_sliding.GeodesicSliding._pulled

    def of(self, cable, *args):
        near.clear()
        for node, fraction in zip(cable.state.nodes, cable.state.fractions.tolist(), strict=True):
            if node.slides and min(fraction, 1 - fraction) < TOL.beyond:
                near.add(node.support[int(fraction > 0.5)])
        return pull_cable(self, cable, *args)

    def recorded(points, surface, *, held_at=None, **options):
        result = pull(points, surface, held_at=held_at, **options)
        if held_at is not None:
            free = pull(points, surface, **options).flips
            passed.append((set(result.flips) - near, set(free) - near))
        return result

    monkeypatch.setattr(geodesic_sliding, "shorten", recorded)
    monkeypatch.setattr(geodesic_sliding.GeodesicSliding, "_pulled", of)
    for seed in (1, 2):
        scene = random_net(comm, seed)
        Solver(scene).advance(pressure=2 * PRESSURE)
    only_held, all_told = (set.union(*sets) for sets in zip(*passed, strict=True))
    assert not only_held and all_told


class Trials(VertexTrials):
    """Cables 0 ... n - 1, each held by a vertex of its own."""

    def __init__(self, n: int) -> None:
        change = SimpleNamespace(shape=lambda vertices, rings: None)
        super().__init__(change, TriedPaths())  # type: ignore[arg-type]
        self.runs = [(c, VertexRun((10 + c,), True, 1.0)) for c in range(n)]
        self.known: dict[int, set[tuple[int, ...]]] = {c: set() for c in range(n)}

    def _held(self) -> list[Trial]:
        return [(c, run) for c, run in self.runs if run.key not in self._tried(c)]

    def _tried(self, c: int) -> set[tuple[int, ...]]:
        return self.known[c]


def test_runs_are_left_together_then_by_halves_of_halves(monkeypatch) -> None:
    monkeypatch.setattr(vertex_trials, "pass_run", lambda *_: True)
    trials, tried = Trials(8), []
    while group := trials.next(energy=0.0, scale=1.0):
        tried.append([c for c, _ in group])
        trials.halve(group)
    whole = [*range(8)]
    assert tried == [whole, whole[:4], [0, 1], [2, 3], whole[4:], [4, 5], [6, 7]]
    assert all(trials.known.values())


def test_rounds_end_when_they_gain_little(monkeypatch) -> None:
    monkeypatch.setattr(vertex_trials, "pass_run", lambda *_: True)
    trials = Trials(4)
    for energy, goes_on in ((0.0, True), (-1.0, True), (-1.5, True), (-1.5 - 1e-7, False)):
        assert bool(trials.next(energy, scale=1.0)) == goes_on
        trials._groups = []


def test_runs_without_a_way_are_not_tried_again(monkeypatch) -> None:
    monkeypatch.setattr(vertex_trials, "pass_run", lambda change, c, run, shape: c == 2)
    trials = Trials(3)
    assert [c for c, _ in trials.next(energy=0.0, scale=1.0)] == [2]
    trials.halve([trials.runs[2]])
    assert trials.next(energy=-1.0, scale=1.0) == []
