"""Sweeps over numerical parameters of the method: penalty, smoothings, units."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import cache
from unittest.mock import patch

import numpy as np

from crms_fenicsx import Cable, Friction, IsotropicMembrane, PenaltyWarning, Scene, Solver, meshes
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import STABLE_PENALTY
from crms_fenicsx.model.tolerances import TOL
from sweeps.judge import Judge, Point
from sweeps.scenes import COMM, MODULUS, PRESSURE, ROPE, SIDE, across, clamped, crossed, square

FACTORS = 10.0 ** np.arange(-6, 7)
LOCKED = 1e3
"""Factor from which on cables cannot slide any more, and stop where they are; some hang on creases
that cannot turn, and pull on the membrane by a fifth of a per cent of their tension."""


def penalty() -> Iterator[Point]:
    """Factors from 1e-6 to 1e6, of the default penalty and of the paper's.

    Wrong is an energy that falls where the penalty grows, which that of the best state cannot (of
    stiff penalties that lock there are several); in the range that is said to be sound, a tension
    that differs; and a factor beyond it without a warning.
    """
    n = 12
    area = (SIDE / n) ** 2 / 2

    @cache
    def run(factor: float, literal: bool) -> tuple[Solver, LaidCable, list[str]]:
        how = {"literal_penalty": factor * MODULUS * area} if literal else {"penalty": factor}
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", PenaltyWarning)
            solver, cable = crossed(square(n), across(43.0), **how)
        said = [str(w.message) for w in caught if issubclass(w.category, PenaltyWarning)]
        return solver, cable, said

    def point(judge: Judge, factor: float, literal: bool) -> None:
        inside = STABLE_PENALTY[0] <= factor <= STABLE_PENALTY[1]
        solver, cable, said = run(factor, literal)
        judge.solved(solver, lying=factor <= LOCKED)
        judge.must("warning outside of the range", literal or bool(said) != inside)
        W, usual = solver.scene.energy, run(0.1, False)
        if inside:
            judge.same("tension with 0.1", cable.tension, usual[1].tension, 0.02)
            judge.same("energy with 0.1", W, usual[0].scene.energy, 0.005)
        if FACTORS[0] < factor <= LOCKED:
            less = run(factor / 10, literal)[0].scene.energy
            judge.must("energy rises with the penalty", W >= less - 1e-9 * abs(W))

    for literal in (False, True):
        for factor in FACTORS.tolist():
            inside = STABLE_PENALTY[0] <= factor <= STABLE_PENALTY[1]
            yield Point(
                f"{'mu / E t A' if literal else 'penalty'} = {factor:g}",
                lambda judge, a=(factor, literal): point(judge, *a),
                solvable=inside,
                quick=factor == 1.0,
            )


def smoothing() -> Iterator[Point]:
    """Lengths from 1e-6 h to 0.3 h over which a short segment's length, and friction, are smoothed.

    Wrong are tensions that differ from those with the usual length by more than the cable is
    lengthened by, which is 0.4 of it at each vertex; friction's heat and tension that differ from
    those of the usual tolerance by more than the share of the slip that it takes away.
    """

    n = 12

    @cache
    def smoothed(size: float, y: float, end: float) -> tuple[Solver, LaidCable]:
        with patch.dict(vars(TOL), smoothing=size):
            return crossed(square(n), across(y, end), L0=float(np.hypot(SIDE, end - y)))

    @cache
    def dragged(tolerance: float) -> tuple[Solver, LaidCable]:
        scene = clamped(square(n))
        solver = Solver(scene)
        solver.advance(pressure=PRESSURE)
        cable = scene.lay_cable(
            Cable(ROPE, friction=Friction(0.3, tolerance=tolerance)),
            [(-5.0, 43.0, 0.0), (105.0, 43.0, 0.0)],
            tension=40.0,
        )
        solver.advance(move={cable: (0.0, 12.0, 0.0)}, steps=6)
        return solver, cable

    def lengths(judge: Judge, size: float, y: float, end: float) -> None:
        solver, cable = smoothed(size, y, end)
        judge.count(solver)
        usual = smoothed(TOL.smoothing, y, end)
        for each in solver, usual[0]:
            judge.must("not finite", bool(np.isfinite(each.scene.energy)))
        near = sum(
            min(f, 1 - f) < 2 * max(size, TOL.smoothing) for f in cable.state.fractions[1:-1]
        )
        lengthened = 0.4 * (size + TOL.smoothing) * SIDE / n * (near + 1)
        # A membrane that gives way takes most of what the cable is too long by.
        judge.drift(
            "tension, usual length",
            (cable.tension - usual[1].tension) / usual[1].tension,
            ROPE / usual[1].tension * lengthened / SIDE,
        )

    def friction(judge: Judge, tolerance: float) -> None:
        solver, cable = dragged(tolerance)
        judge.solved(solver, anew=False)
        usual = dragged(3e-3)
        judge.same(
            "tension, usual tolerance", cable.tension, usual[1].tension, 0.5 * tolerance + 5e-3
        )
        heats = [s.scene.dissipated for s in (solver, usual[0])]
        judge.same("heat, usual tolerance", *heats, 3 * tolerance + 0.01)

    for size in (1e-6, 1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3):
        for y, end in ((30.0, 30.0), (20.0, 55.0), (50.0, 50.0)):
            yield Point(
                f"lengths by {size:g} h, ends {y:g}, {end:g}",
                lambda judge, a=(size, y, end): lengths(judge, *a),
                quick=size == 1e-2 and y == 30.0,
            )
    for tolerance in (1e-6, 1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 0.1):
        yield Point(
            f"friction by {tolerance:g} h",
            lambda judge, tolerance=tolerance: friction(judge, tolerance),
        )


def units() -> Iterator[Point]:
    """Units of length and force from 1e-12 to 1e12 of the usual ones.

    Wrong is any result that is not the same in these units.
    """

    @cache
    def run(unit: float, force: float, kind: str) -> tuple[float, float, int]:
        side = SIDE * unit
        mesh = meshes.rectangle(COMM, side, side, side / 12, structured=True)
        E = 300.0 * force / unit**2
        scene = Scene(mesh, IsotropicMembrane(E, 0.25, 0.08 * unit))
        scene.fix("boundary")
        solver = Solver(scene)
        p, ends = PRESSURE * force / unit**2, np.array([(0.0, 43.0), (SIDE, 43.0)]) * unit
        if kind == "held":
            cable = scene.lay_cable(Cable(ROPE * force), ends, L0=side)
            solver.advance(pressure=p)
        else:
            beyond = unit * np.array([(-5.0, 43.0, 2.0), (105.0, 43.0, 2.0)])
            solver.advance(pressure=p)
            rough = 0.3 if kind == "rough" else 0.0
            cable = scene.lay_cable(Cable(ROPE * force, friction=rough), beyond)
            solver.advance(move={cable: (0.0, 3.0 * unit, -6.0 * unit)}, steps=3)
        work = sum(step.outcome.evaluations for step in solver.steps)
        return scene.energy / (force * unit), cable.tension / force, work

    def point(judge: Judge, unit: float, force: float, kind: str) -> None:
        W, T, judge.evaluations = run(unit, force, kind)
        W1, T1, _ = run(1.0, 1.0, kind)
        judge.same("energy", W, W1, 1e-8 if kind != "rough" else 1e-6)
        judge.same("tension", T, T1, 1e-6 if kind != "rough" else 1e-4)

    for kind in ("held", "moved", "rough"):
        for unit, force in (
            (1e-12, 1.0), (1e-6, 1.0), (1e-3, 1e3), (0.01, 9.81), (1 / 3, 1.0), (1e3, 1e-3),
            (1e6, 1.0), (1e12, 1.0), (1.0, 1e-12), (1.0, 1e12), (1e-6, 1e12), (1e6, 1e-12),
        ):  # fmt: skip
            yield Point(
                f"{kind}, length {unit:.3g}, force {force:g}",
                lambda judge, a=(unit, force, kind): point(judge, *a),
                quick=unit == 1e-6 and force == 1.0 and kind == "held",
            )
