"""One or two points of each sweep of `benchmarks/stability.py`, judged as there."""

from __future__ import annotations

import pytest
from cabled_square import advanced
from sweeps.judge import Judge, Point, judged
from sweeps.register import SWEEPS
from sweeps.scenes import PRESSURE, clamped, square

from crms_fenicsx import Solver

QUICK = [(name, point) for name, sweep in SWEEPS.items() for point in sweep() if point.quick]


@pytest.mark.parametrize("name, point", QUICK, ids=[f"{n}: {p.label}" for n, p in QUICK])
def test_quick_points(name: str, point: Point) -> None:
    row = judged(name, point)
    assert row.verdict == "converged", row.remarks


def moved_after_the_step(judge: Judge) -> None:
    solver = advanced(Solver(clamped(square(4))), pressure=PRESSURE)
    solver.scene.u.x.array[~solver.scene.held.ravel()] *= 1.0001
    judge.solved(solver)


def endless(judge: Judge) -> None:
    solver = Solver(clamped(square(4)))
    while True:
        solver.advance(pressure=PRESSURE)


def failing(judge: Judge) -> None:
    raise KeyError("nothing that a user could understand")


def drifting(judge: Judge) -> None:
    judge.same("what should not change", 1.0, 1.1, 0.01)


@pytest.mark.parametrize(
    "run, verdict",
    [
        (moved_after_the_step, "WRONG"),
        (endless, "HANG"),
        (failing, "WRONG"),
        (drifting, "WRONG"),
        (lambda judge: Solver(clamped(square(4))).advance(pressure=float("nan")), "REFUSED"),
    ],
)
def test_what_is_wrong_is_found(run, verdict: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sweeps.judge.EVALUATIONS", 200)
    assert judged("none", Point("none", run)).verdict == verdict
