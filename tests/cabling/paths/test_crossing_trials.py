"""Two crossing cables on hills: the same load leads to the same state in whatever order."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, clamped
from grids import hills
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Solver, meshes
from crms_fenicsx.cabling.paths.crossing_trials import CrossingTrials, Way
from crms_fenicsx.cabling.paths.tried_paths import TriedPaths
from crms_fenicsx.model.tolerances import BUDGET


def loaded(comm: MPI.Intracomm, number: int, over: bool) -> Solver:
    """The cables shortened under pressure; with or without half the pressure more before."""
    draws = np.random.default_rng(number)
    n = int(draws.integers(7, 11))
    points, cells = hills(n, draws)
    membrane = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
    scene = clamped(meshes.from_arrays(comm, points, cells), membrane)
    along, across = draws.uniform(20, 80, (2, 2))
    paths = [[(-5.0, along[0], 0.0), (105.0, along[1], 0.0)]]
    paths += [[(across[0], -5.0, 0.0), (across[1], 105.0, 0.0)]]
    short = [draws.uniform(108, 113) for _ in paths]
    solver = advanced(Solver(scene), pressure=0.015 if over else 0.01)
    cables = [
        scene.lay_cable(Cable(32000.0), path, L0=L0 + 8)
        for path, L0 in zip(paths, short, strict=True)
    ]
    lengths = dict(zip(cables, short, strict=True))
    if over:
        solver.advance(L0=lengths, pressure=0.005)
        solver.advance(pressure=0.01)
    else:
        solver.advance(L0=lengths, steps=2)
    return solver


# What the cables are laid on, and the energy that another order of the loads has led to before.
@pytest.mark.parametrize(("number", "least"), [(511, -58.3501), (505, 64.2605), (527, 73.8845)])
def test_ways_of_crossing_cables_do_not_depend_on_the_loads_before(number: int, least: float):
    """A cable beside a vertex and off the membrane, a crossing beside an edge, a span cut short."""
    energies = []
    for over in (False, True):
        scene = loaded(MPI.COMM_SELF, number, over).scene
        energies.append(scene.energy)
        scale = sum(map(abs, scene.energies.values()))
        assert scene.energy < least + 1e-5 * scale
    assert abs(energies[1] - energies[0]) < 1e-8 * scale


def test_repeating_a_load_starts_none_of_the_trials_beyond_the_limit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(vars(BUDGET), "crossing_trials", 1)
    solver = loaded(MPI.COMM_SELF, 505, over=False)
    energy = solver.scene.energy
    outcome = solver.advance(pressure=0.01).outcome
    assert outcome.solves == 1
    assert solver.scene.energy == pytest.approx(energy, rel=1e-12)


class Listed(CrossingTrials):
    """Trials of given keys, which move nothing; records those that are started."""

    keys: tuple[str, ...] = ("a", "b", "c")

    def _sides(self) -> Iterator[Way]:
        for key in self.keys:
            yield Way(0, ("side", key, (0,), False), lambda key=key: not self.started.append(key))

    def _exchanges(self) -> Iterator[Way]:
        yield from ()

    _open = _closed = _exchanges


def listed() -> Any:
    """Such trials of two crossing cables."""
    net = SimpleNamespace(
        cables=[SimpleNamespace(name="cable")],
        crossings=[SimpleNamespace(support=(0, 1, 2))],
        clamps=[],
    )
    trials = Listed(SimpleNamespace(net=net), TriedPaths())  # type: ignore[arg-type]
    trials.started = []
    return trials


def test_a_rejected_trial_comes_again_once_the_energy_has_fallen_by_more() -> None:
    trials = listed()
    for excess in (2.0, 5.0):
        assert trials.next()
        trials.reject(excess)
    assert trials.next()
    trials.accept(3.0)  # of "c"; "a" may pay from here
    assert trials.next()
    assert trials.started == ["a", "b", "c", "a"]
    trials.reject(1.0)
    assert trials.next()  # "c" the other way
    trials.reject(4.0)
    assert not trials.next()
    trials.accept(2.5)  # of others: 5.5 > 5, and 2.5 < 4
    assert trials.next() and trials.next()
    assert trials.started[4:] == ["c", "a", "b"]
    assert not trials.next()
