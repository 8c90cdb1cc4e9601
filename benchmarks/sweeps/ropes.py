"""Sweeps over cables: stiffness, place, length, slackening, moving ends, friction."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from roped_drum import EA, exact_tensions, places, roped

from crms_fenicsx import Cable, Solver
from crms_fenicsx.model.laid_cable import LaidCable
from sweeps.judge import Judge, Point
from sweeps.scenes import COMM, MODULUS, PRESSURE, ROPE, SIDE, across, clamped, crossed, square

SIDES = 2e-3
"""Change of energy and tension with the side on which a cable passes a vertex of a coarse mesh."""


def inflated_square(n: int) -> float:
    """Energy of the square without cables."""
    solver = Solver(clamped(square(n)))
    solver.advance(pressure=PRESSURE)
    return solver.scene.energy


def middle(cable: LaidCable) -> np.ndarray:
    """Where a cable passes x = 50."""
    x = cable.line
    return np.array([np.interp(SIDE / 2, x[:, 0], x[:, i]) for i in range(3)])


def stiffness() -> Iterator[Point]:
    """EA/(E t h) from 1e-5 to 1e8: a cable 0.5 % longer than its chord, and one as long.

    Wrong is a tension that falls with EA; for stiff cables one other than of first order in 1/EA
    from its limit or, as long as the chord, than in proportion to the cubic root of EA, as that of
    a shallow arch; and what depends on the number of steps. Soft cables must not change the
    membrane; how long they are has the error of the mesh.
    """
    n = 12
    unit = MODULUS * SIDE / n
    bare = cache(lambda: inflated_square(n))

    @cache
    def run(ratio: float, longer: float, steps: int = 1) -> tuple[Solver, LaidCable]:
        L0 = (1 + longer) * SIDE
        return crossed(square(n), across(43.0), L0=L0, EA=ratio * unit, steps=steps)

    def point(judge: Judge, ratio: float, longer: float) -> None:
        solver, cable = run(ratio, longer)
        judge.solved(solver)
        T, W = cable.tension, solver.scene.energy
        other, again = run(ratio, longer, 4)
        judge.same("energy in 4 steps", W, other.scene.energy, 1e-8)
        judge.same("tension in 4 steps", T, again.tension, 1e-6)
        less = run(ratio / 10, longer)[1].tension
        judge.must("tension rises with EA", T >= less * (1 - 1e-6))
        if ratio <= 1e-2:
            judge.same("energy without cable", W, bare(), 3e-3)
        if ratio >= 1e4 and longer > 0.0:
            slopes = []
            for stiff in (ratio, ratio / 10):
                (_, a), (_, b) = run(stiff, longer), run(stiff / 10, longer)
                slopes.append((1 / b.tension - 1 / a.tension) / (1 / b.cable.EA - 1 / a.cable.EA))
            # The cable's strain is that of its length, of which rounding leaves EA times its own.
            allowed = 1e4 / ratio + 1e-3 + 4e-9 * ratio
            judge.same("slope of 1/T over 1/EA", slopes[0], slopes[1], allowed)
        elif ratio >= 1e4:
            # The next term of the expansion is smaller by the cubic root as well.
            judge.same("T / EA^(1/3)", T, less * 10 ** (1 / 3), 2 * ratio ** (-1 / 3))

    for longer in (0.005, 0.0):
        for ratio in 10.0 ** np.arange(-5, 9):
            yield Point(
                f"EA / E t h = {ratio:g}, L0 = {1 + longer:g} chord",
                lambda judge, a=(float(ratio), longer): point(judge, *a),
                quick=ratio == 1e4 and longer > 0.0,
            )


def places_on_mesh() -> Iterator[Point]:
    """Cables through vertices, along edges, that far off them, along the boundary, to corners.

    Wrong is a tension or energy that differs from that without the distance by more than its share.
    """

    @cache
    def run(a: tuple[float, float], b: tuple[float, float]) -> tuple[Solver, LaidCable]:
        return crossed(square(12), [a, b], L0=float(np.hypot(b[0] - a[0], b[1] - a[1])))

    half = SIDE / 2
    cases = {
        "along a line": ((0.0, half), (SIDE, half), (0.0, 1.0), (0.0, 1.0)),
        "through it": ((0.0, half), (SIDE, half), (0.0, 1.0), (0.0, -1.0)),
        "along the diagonals": ((0.0, 0.0), (SIDE, SIDE), (1.0, 0.0), (0.0, -1.0)),
        "to corners, across": ((0.0, SIDE), (SIDE, 0.0), (1.0, 0.0), (0.0, 1.0)),
        "from a corner": ((0.0, 0.0), (SIDE, 60.0), (0.0, 1.0), (0.0, 0.0)),
        "along the boundary": ((0.0, 0.0), (SIDE, 0.0), (0.0, 1.0), (0.0, 1.0)),
        "leaving the boundary": ((0.0, 0.0), (SIDE, 0.0), (0.0, 0.0), (0.0, 1.0)),
        "along a side for a while": ((0.0, 0.0), (half, 0.0), (0.0, 0.0), (0.0, 1.0)),
    }  # fmt: skip

    def point(judge: Judge, name: str, distance: float) -> None:
        (a, b, da, db), off = cases[name], distance * SIDE
        first = (a[0] + off * da[0], a[1] + off * da[1])
        last = (b[0] + off * db[0], b[1] + off * db[1])
        solver, cable = run(first, last)
        slack = "boundary" in name or "side" in name
        judge.solved(solver, lying=not slack)
        limit, straight = run(a, b)
        W = limit.scene.energy
        # On mesh lines cells do not fold, off them they do: from the distance on at which places
        # are told apart the two have another error of the mesh.
        on_line, mesh = distance < 1e-7, 2e-4
        allowed = 10 * distance + (1e-6 if on_line else mesh)
        judge.same("energy on it", solver.scene.energy, W, allowed)
        # Beside the boundary cells that fold bulge, and press on a cable that is hardly in tension.
        scale = max(straight.tension, 10.0)
        allowed = 100 * distance + (1e-4 if on_line else 0.5 if slack else 2e-3)
        judge.drift("tension on it", (cable.tension - straight.tension) / scale, allowed)

    for name in cases:
        for distance in (0.0, 1e-16, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-3):
            yield Point(
                f"{name}, {distance:g} L off",
                lambda judge, a=(name, distance): point(judge, *a),
                quick=distance == 1e-14 and name in ("along a line", "from a corner"),
            )


def short() -> Iterator[Point]:
    """Cables shorter than their chord, down to a ten thousandth of it.

    Wrong is a tension below that of the chord, or above it by more than the arch can add, and what
    depends on whether it is laid short or is shortened.
    """

    @cache
    def laid(share: float, stiff: float, way: str) -> tuple[Solver, LaidCable]:
        scene = clamped(square(12))
        solver = Solver(scene)
        L0 = share * SIDE if way == "laid" else SIDE
        cable = scene.lay_cable(Cable(stiff), across(43.0), L0=L0)
        solver.advance(pressure=PRESSURE)
        if way != "laid":
            solver.advance(L0={cable: share * SIDE}, steps=5)
        return solver, cable

    def point(judge: Judge, share: float, stiff: float) -> None:
        solver, cable = laid(share, stiff, "laid")
        judge.solved(solver)
        chord = stiff * (1 / share - 1)
        T = cable.tension
        judge.must("tension of the chord", T >= chord * (1 - 1e-9))
        # Its load is less than p times the side: the arch is longer by (p L^2/T)^2 / 24 at most.
        longer = min((PRESSURE * SIDE**2 / T) ** 2 / 24, 0.05)
        judge.must("tension of the arch", T <= chord + stiff / share * longer)
        other, shortened = laid(share, stiff, "shortened")
        judge.sound(other)
        judge.same("energy when shortened", solver.scene.energy, other.scene.energy, 1e-8)
        judge.same("tension when shortened", T, shortened.tension, 1e-6)

    for stiff in (200.0, ROPE, 1e7):
        for share in (0.999, 0.99, 0.9, 0.5, 0.1, 1e-2, 1e-4):
            yield Point(
                f"L0 / chord = {share:g}, EA = {stiff:g}",
                lambda judge, a=(share, stiff): point(judge, *a),
                quick=share in (0.9, 1e-2) and stiff == ROPE,
            )


def cycles() -> Iterator[Point]:
    """Cables that slacken and tighten up to 100 times.

    Wrong is a state that is not that of the first cycle, or that of a slack cable that is not that
    without one.
    """

    def point(judge: Judge, count: int, slack: float, ends: str, number: int) -> None:
        bare = Solver(clamped(square(10)))
        bare.advance(pressure=PRESSURE)
        scene = clamped(square(10))
        solver = Solver(scene)
        paths = [across(37.0), [(43.0, 0.0), (43.0, SIDE)]][:number]
        cables = [scene.lay_cable(Cable(ROPE), path, L0=SIDE) for path in paths]
        solver.advance(pressure=PRESSURE)
        W, T = scene.energy, cables[0].tension
        drifts = [[0.0], [0.0]]
        for _ in range(count):
            if ends == "length":
                solver.advance(L0={cable: slack * SIDE for cable in cables})
            else:
                solver.advance(pressure=slack * PRESSURE)
            if all(not cable.taut for cable in cables) and ends == "length":
                drifts[1].append(scene.energy / bare.scene.energy - 1)
                judge.must("slack", all(cable.tension == 0.0 for cable in cables))
            if ends == "length":
                solver.advance(L0={cable: SIDE for cable in cables})
            else:
                solver.advance(pressure=PRESSURE)
            drifts[0].append(scene.energy / W - 1)
        judge.solved(solver)
        judge.drift("energy of the first cycle", np.abs(drifts[0]).max(), 1e-8)
        judge.drift("energy without cables", np.abs(drifts[1]).max(), 1e-8)
        judge.same("tension of the first cycle", cables[0].tension, T, 1e-6)
        if ends == "length" and slack > 1.03:
            judge.must("it has been slack each time", len(drifts[1]) == count + 1)

    for count, slack, ends, number in (
        (5, 1.02, "length", 1), (100, 1.05, "length", 1), (100, 1.001, "length", 1),
        (30, 1.02, "length", 1),
        (100, 1.05, "length", 2), (30, 1.01, "length", 2), (30, 1e-3, "pressure", 1),
        (30, 1e-6, "pressure", 1), (30, 1e-3, "pressure", 2),
    ):  # fmt: skip
        what = f"L0 to {slack:g} L" if ends == "length" else f"p to {slack:g} of it"
        yield Point(
            f"{count} times {what}, {number} cables",
            lambda judge, a=(count, slack, ends, number): point(judge, *a),
            quick=count == 5,
        )


def ends() -> Iterator[Point]:
    """The ends of a cable move along two sides and back.

    Wrong is another state on the way back, than that of a cable laid there, or than in the image of
    the square turned by half; but for the side on which a vertex is passed where the cable is
    pressed against it, which is told by trying and of which both may be in equilibrium.
    """

    @cache
    def laid(y: float, end: float, pressure: float) -> tuple[float, float]:
        solver, cable = crossed(square(12), across(y, end), L0=SIDE, pressure=pressure)
        return solver.scene.energy, cable.tension

    def point(judge: Judge, moves: int, aslant: bool, pressure: float, steps: int) -> None:
        first, way = 20.0, 60.0
        scene = clamped(square(12))
        cable = scene.lay_cable(Cable(ROPE), across(first), L0=SIDE)
        solver = Solver(scene)
        solver.advance(pressure=pressure)
        states: list[list[tuple[float, float]]] = [[(scene.energy, cable.tension)]]
        for sign in (1.0, -1.0):
            states.append([])
            for _ in range(moves):
                step = (0.0, sign * way / moves, 0.0)
                if aslant:  # one end goes, the other stays
                    solver.advance(move={cable.start: step}, steps=steps)
                else:
                    solver.advance(move={cable: step}, steps=steps)
                states[-1].append((scene.energy, cable.tension))
                judge.sound(solver, anew=False)
        judge.solved(solver)
        there, back = states[0] + states[1], [*states[2][::-1], states[1][-1]]
        for k, ((W, T), (W_back, T_back)) in enumerate(zip(there, back, strict=True)):
            y = first + way * k / moves
            judge.same("energy on the way back", W, W_back, SIDES)
            judge.same("tension on the way back", T, T_back, SIDES)
            W_laid, T_laid = laid(y, first if aslant else y, pressure)
            judge.same("energy of one laid there", W, W_laid, SIDES)
            judge.same("tension of one laid there", T, T_laid, SIDES)
            if not aslant:
                W_image, T_image = there[moves - k]
                judge.same("energy, turned by half", W, W_image, SIDES)
                judge.same("tension, turned by half", T, T_image, SIDES)

    for moves in (1, 6, 23):
        for aslant in (False, True):
            for pressure in (PRESSURE, 1e-4):
                for steps in (1, 4):
                    if moves == 23 and steps > 1:
                        continue
                    yield Point(
                        f"{moves} x {steps} steps, {'one end' if aslant else 'both'}, "
                        f"p = {pressure:g}",
                        lambda judge, a=(moves, aslant, pressure, steps): point(judge, *a),
                        quick=moves == 1 and steps == 1 and pressure == PRESSURE and not aslant,
                    )


def friction_sideways() -> Iterator[Point]:
    """Coefficients from 1e-6 to 5: a cable that is dragged over the inflated square, and back.

    Wrong are heat below zero; work of the ends that is not in energy and heat, up to the error of
    the trapezoidal rule, relative to the tension times the way; for small coefficients a state
    that differs from that without friction by more than their share and the side on which a vertex
    is passed; and a cable that follows further than a smooth one.
    """

    @cache
    def dragged(mu: float) -> tuple[Solver, LaidCable, float, float]:
        scene = clamped(square(12))
        solver = Solver(scene)
        path = [(-5.0, 43.0, 0.0), (105.0, 43.0, 0.0)]
        solver.advance(pressure=PRESSURE)
        cable = scene.lay_cable(Cable(ROPE, friction=mu), path, tension=40.0)
        solver.advance()
        W, heat, work = scene.energy, scene.dissipated, 0.0
        for way in [(0.0, 1.5, 0.0)] * 8:
            before = cable.start.reaction + cable.end.reaction
            solver.advance(move={cable: way})
            work += float((before + cable.start.reaction + cable.end.reaction) @ way) / 2
        return solver, cable, work, scene.energy - W + scene.dissipated - heat

    def point(judge: Judge, mu: float) -> None:
        solver, cable, work, taken = dragged(mu)
        judge.solved(solver, anew=mu == 0.0)
        judge.must("heat below zero", solver.scene.dissipated >= 0.0)
        judge.drift(
            "work and what took it", (work - taken) / (cable.tension * 24.0), 1e-3 + 3e-3 * mu
        )
        smooth = dragged(0.0)
        if mu <= 1e-2:
            W, free = solver.scene.energy, smooth[0].scene.energy
            judge.same("energy without friction", W, free, mu + 1e-4)
            shift = abs(middle(cable)[1] - middle(smooth[1])[1]) / (SIDE / 12)
            judge.drift("place without friction", shift, 20 * mu + 0.01)
        judge.must("it follows less", middle(cable)[1] <= middle(smooth[1])[1] + 0.1)

    for mu in (0.0, 1e-6, 1e-4, 1e-2, 0.1, 0.3, 0.7, 1.0, 2.0, 5.0):
        yield Point(f"mu = {mu:g}", lambda judge, mu=mu: point(judge, mu), quick=mu == 0.3)


def friction_along() -> Iterator[Point]:
    """Coefficients from 0 to 5: a rope over a drum, pulled at one end and let back.

    Wrong are tensions other than those of the exact solution, to the error of 20 cells.
    """

    def point(judge: Judge, mu: float, back: bool) -> None:
        scene, cable = roped(COMM, 20, mu, tension=10.0)
        solver = Solver(scene)
        solver.advance()
        # so far that with little friction it would slide all the way
        pull = 10.0 / EA * 0.5 * min(1.0, mu)
        pulls = [pull, -pull / 2] if back else [pull]
        for each in pulls:
            solver.advance(move={cable.end: (0.0, 0.0, -each)})
        judge.count(solver)
        exact = exact_tensions(10.0, mu, pulls)
        found = np.interp(places(cable), np.linspace(0.0, np.pi, len(exact)), exact)
        error = np.abs(cable.tensions - found).max() / exact.max()
        # Where the rope begins to slide is known to half a cell.
        judge.drift("exact tensions", error, 0.005 + 0.12 * mu * np.pi / 20)
        judge.must("tension is negative", cable.tensions.min() >= 0.0)
        steepest = np.abs(np.diff(np.log(cable.tensions))).max() / (np.pi / 20)
        judge.must("steeper than exp(mu angle)", steepest <= mu * 1.02 + 1e-9)

    for mu in (1e-2, 0.1, 0.3, 0.7, 1.0, 2.0, 5.0):
        for back in (False, True):
            yield Point(
                f"mu along = {mu:g}{', and back' * back}",
                lambda judge, a=(mu, back): point(judge, *a),
                quick=mu == 0.3 and back,
            )
