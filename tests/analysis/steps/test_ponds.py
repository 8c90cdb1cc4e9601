"""Water on membranes: closed forms of small slopes, its limits, and what keeps or refuses it."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from scipy.special import j0, j1
from term_scene import irregular_square

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    InputError,
    IsotropicMembrane,
    PondWarning,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.energy.minimization.potential import Potential

TENSION, RADIUS = 2.0, 3.0
SOFT = IsotropicMembrane(
    E=1e-6, nu=0.3, thickness=1.0, prestress=TENSION, wrinkling=False
)  # its tension stays as it is


def drum(comm: MPI.Intracomm, size: float) -> Scene:
    return clamped(meshes.ellipse(comm, RADIUS, RADIUS, size), SOFT)


def depth(scene: Scene) -> float:
    lowest = float(scene.positions()[:, 2].min(initial=0.0))
    return -scene.comm.allreduce(lowest, op=MPI.MIN)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("k", "expected"), [(1.0, 0.30685), (1.5, 0.95378), (2.0, 3.46647)], ids=str
)
def test_water_at_a_level_over_a_drum(comm: MPI.Intracomm, k: float, expected: float) -> None:
    """Deflection and volume, of second order; the rim carries the water."""
    closed = 1 / j0(k) - 1
    assert closed == pytest.approx(expected, rel=2e-5)
    h0, volume, errors = 1e-3, np.pi * RADIUS**2 * 1e-3 * 2 / k * j1(k) / j0(k), []
    for size in (0.6, 0.3):
        scene = drum(comm, size)
        scene.put_pond(TENSION * (k / RADIUS) ** 2, level=h0)
        solver = Solver(scene)
        step = solver.advance(load=1.0)
        assert step.verification is not None
        assert step.verification.passed
        (pond,) = scene.ponds
        errors.append((depth(scene) / h0 / closed - 1, pond.volume / volume - 1))
        lift = solver.reactions("boundary").total[2]
        assert lift == pytest.approx(pond.weight * pond.volume, rel=1e-8)
    np.testing.assert_allclose(errors[1], (0.0, 0.0), atol=0.01)
    rate = np.log2(errors[0][1] / errors[1][1])
    assert rate == pytest.approx(2.0, abs=0.15)
    assert solver.history["volume pond"][-1] == pond.volume


def test_water_gathers_without_end(comm: MPI.Intracomm) -> None:
    """From k R = 2.404826 on a given level has no equilibrium, and a given volume has."""
    scene = drum(comm, 0.4)
    scene.put_pond(TENSION * (3.0 / RADIUS) ** 2, level=1e-3)
    solver = Solver(scene)
    with pytest.raises(ConvergenceError, match="Under 'pond' there may be no equilibrium"):
        solver.advance(load=1.0)
    (pond,) = scene.ponds
    critical = (2.404826 / 3.0) ** 2
    assert critical - 0.02 < pond.factor < critical + 0.01
    level, volume = pond.level, pond.volume
    scene.remove_load("pond")
    scene.put_pond(pond.weight, volume=volume)
    solver.advance(load=pond.factor)  # the same water
    assert scene.ponds[0].level == pytest.approx(level, rel=1e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("error", PondWarning)
        solver.advance(load=1.0)  # beyond what the level had; stable, as the dyad counts
    assert solver.steps[-1].outcome.converged
    assert scene.ponds[0].level < level
    assert scene.ponds[0].volume == volume


@pytest.mark.ranks
@pytest.mark.parametrize("part", [0.99, 1.01], ids=["carried", "lost"])
def test_an_equilibrium_that_is_not_stable(comm: MPI.Intracomm, part: float) -> None:
    """Water on a flat strip that an equal load from below carries: N = weight L^2 / pi^2."""
    length = 4.0
    mesh = meshes.rectangle(comm, length, 1.0, 0.25, structured=True)
    scene = Scene(mesh, SOFT)
    scene.fix(lambda x: np.isclose(x[0] * (length - x[0]), 0.0))
    scene.fix(lambda x: np.isclose(x[1] * (1.0 - x[1]), 0.0), "y")
    weight = part * TENSION * np.pi**2 / length**2
    scene.put_pond(weight, level=1e-3)
    scene.put_load((0.0, 0.0, 1e-3 * weight), name="lift", per="plan")
    solver = Solver(scene)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PondWarning)
        step = solver.advance(load={"pond": 1.0, "lift": 1.0})
    assert np.abs(scene.u.x.array).max(initial=0.0) < 1e-9
    assert step.outcome.iterations == 0
    told = comm.allreduce(sum(issubclass(one.category, PondWarning) for one in caught))
    assert told == (part > 1.0)


def test_ponds_beyond_their_limit_are_refused_soon(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where the fabric stretches a little: some 700 evaluations with cells of 0.25."""
    count, evaluate = [0], Potential.evaluate

    def counted(potential: Potential) -> float:
        count[0] += 1
        return evaluate(potential)

    monkeypatch.setattr(Potential, "evaluate", counted)
    stretchy = IsotropicMembrane(E=1.0, nu=0.3, thickness=1.0, prestress=TENSION, wrinkling=False)
    scene = clamped(meshes.ellipse(comm, RADIUS, RADIUS, 0.25), stretchy)
    scene.put_pond(TENSION * (2.41 / RADIUS) ** 2, level=1e-3)
    solver = Solver(scene)
    with pytest.raises(ConvergenceError, match=r"the membrane moves without end.*Limits of load"):
        solver.advance(load=1.0)
    assert count[0] < 1200
    assert scene.ponds[0].factor == pytest.approx((2.404826 / 2.41) ** 2, abs=0.02)


def test_water_that_ends_at_a_free_edge(comm: MPI.Intracomm) -> None:
    scene = clamped(irregular_square(comm))
    scene.put_load((0.0, 0.0, -0.01), name="weight", per="material")
    solver = advanced(Solver(scene, max_halvings=1), load=1.0)
    scene.put_pond(1e-3, level=-5.0, on=["left"])
    with pytest.raises(ConvergenceError, match="reaches a free edge has no equilibrium"):
        solver.advance(load={"pond": 1.0})


def hollow(comm: MPI.Intracomm, folder: Path | None = None, resume: bool | None = None) -> Solver:
    """A sagging sheet with a cable and two ponds, one of them on one half."""
    scene = clamped(irregular_square(comm))
    scene.put_load((0.0, 0.0, -0.01), name="weight", per="material")
    solver = advanced(Solver(scene, results=folder, resume=resume), load=1.0)
    scene.lay_cable(Cable(32000.0), [(0.0, 31.0), (100.0, 52.0)], tension=20.0, name="ridge")
    scene.put_pond(1e-3, level=-5.0, on=["left", "right"], name="old")
    scene.put_pond(1e-3, volume=5000.0, name="rain")
    solver.advance(load={"old": 0.5, "rain": 0.5})
    return solver


@pytest.mark.ranks
def test_ponds_of_both_kinds_under_a_cable(comm: MPI.Intracomm) -> None:
    """Verified, in a branch and back, and with a factor for safety in a combination."""
    solver = hollow(comm)
    scene = solver.scene
    for step in solver.steps:
        assert step.verification is not None
        assert step.verification.passed
    kept, u = scene.ponds, scene.u.x.array.copy()
    found = solver.combine({"storm": {"old": 1.5, "rain": 1.5}})
    assert scene.ponds == kept
    assert np.array_equal(scene.u.x.array, u)
    old, rain = found["storm"].snapshot.loads.ponds
    assert (old.level, rain.volume) == (-5.0, 5000.0)
    assert old.volume > kept[0].volume > 0.0
    assert rain.level < kept[1].level < 0.0
    forces = solver.reactions("boundary").total[2]
    water = 0.5e-3 * (kept[0].volume + kept[1].volume)
    assert forces == pytest.approx(water + 0.01 * 100.0**2, rel=1e-7)


def test_ponds_go_on(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """From a checkpoint, and when the script runs again."""
    folder, found = comm.bcast(tmp_path), []
    for resume in (False, True):
        solver = hollow(comm, folder / "run", resume)
        scene = solver.scene
        solver.save(folder / "checkpoint")
        solver.advance(load={"rain": 1.0})
        found.append((scene.ponds, scene.energy, scene.cable("ridge").tension))
        del solver, scene
    assert found[0] == found[1]
    other = Solver(clamped(irregular_square(comm)))
    other.load(folder / "checkpoint")
    other.advance(load={"rain": 1.0})
    for was, now in zip(found[0][0], other.scene.ponds, strict=True):
        assert (now.name, now.factor, now.side, now.parts) == (
            was.name, was.factor, was.side, was.parts,
        )  # fmt: skip
        assert now.level == pytest.approx(was.level, rel=1e-7)
        assert now.volume == pytest.approx(was.volume, rel=1e-6)


@pytest.mark.ranks
def test_bad_input(comm: MPI.Intracomm) -> None:
    scene = clamped(irregular_square(comm))
    for message, arguments in (
        ("level = 1.0 and volume = 2.0; pass one", {"weight": 10, "level": 1.0, "volume": 2.0}),
        ("level = None and volume = None", {"weight": 10}),
        ("'attic'.*there are 'left', 'right'", {"weight": 10, "level": 0.0, "on": ["attic"]}),
        ("on = 'left' is not a valid list", {"weight": 10, "level": 0.0, "on": "left"}),
        ("means another thing", {"weight": 10, "level": 0.0, "name": "pressure"}),
    ):
        with pytest.raises(InputError, match=message):
            scene.put_pond(**arguments)
    assert scene.ponds == ()
    scene.put_pond(10.0, level=0.0)
    with pytest.raises(InputError, match="there is a load 'pond' already"):
        scene.put_load((0.0, 0.0, 1.0), name="pond")
    solver = Solver(scene)
    with pytest.raises(InputError, match="'pond' = -1, of water, which cannot pull"):
        solver.advance(load={"pond": -1.0})
    with pytest.raises(InputError, match="no load 'snow'; there are 'pond'"):
        scene.remove_load("snow")
    scene.remove_load("pond")
    assert scene.factors == {}
    points = [(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)]
    cells = np.array([(0, 1, 2), (0, 2, 3)])
    mesh = meshes.from_arrays(comm, np.array(points, float), cells, outside=(0.0, 1.0, 0.0))
    wall = clamped(mesh)
    with pytest.raises(InputError, match="'pond' have no upper side"):
        wall.put_pond(10.0, level=0.0)


def cushion(comm: MPI.Intracomm, n: int = 4) -> Scene:
    """Two foils over a square that meet at its edges, the lower one facing down."""
    x = np.linspace(0.0, 6.0, n + 1)
    inner = [(i, j) for j in range(1, n) for i in range(1, n)]
    rise = {(i, j): 0.3 * np.sin(np.pi * i / n) * np.sin(np.pi * j / n) for i, j in inner}
    top = {(i, j): (n + 1) * j + i for j in range(n + 1) for i in range(n + 1)}
    low = top | {ij: (n + 1) ** 2 + k for k, ij in enumerate(inner)}
    points = [(x[i], x[j], rise.get((i, j), 0.0)) for i, j in top]
    points += [(x[i], x[j], -rise[i, j]) for i, j in inner]
    up, down = [], []
    for i, j in ((i, j) for j in range(n) for i in range(n)):
        for cells, at in ((up, top), (down, low)):
            a, b, c, d = (at[ij] for ij in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))
            pairs = ((a, b, c), (a, c, d)) if (i < n / 2) == (j < n / 2) else ((a, b, d), (b, c, d))
            cells += pairs
    mesh = meshes.from_arrays(
        comm, points, up + down,
        parts={
            "top": np.arange(len(up)), "bottom": len(up) + np.arange(len(down)),
            "half": len(up) + np.arange(len(down) // 2),
        },
        outside={"top": (0, 0, 1.0), "bottom": (0, 0, -1.0)},
    )  # fmt: skip
    scene = Scene(mesh, IsotropicMembrane(E=1e3, nu=0.3, thickness=1.0))
    scene.fix(lambda x: np.isclose(abs(x[:2] - 3.0).max(axis=0), 3.0))
    return scene


def test_water_does_not_hang_below_cells(comm: MPI.Intracomm) -> None:
    """Without parts water stands where the outer side faces up; a part that faces down is named."""
    scene = cushion(comm)
    solver = advanced(Solver(scene), pressure=0.5)
    before = scene.versions.current
    with pytest.raises(InputError, match=r"'pond' face the other way .* in the part 'half'"):
        scene.put_pond(1.0, level=0.1, on=["top", "half"])
    assert scene.versions.current == before
    scene.put_pond(1.0, level=0.1, on=["top"])
    assert solver.advance(load=1.0).verification.passed
    volume = scene.ponds[0].volume
    assert volume > 0.0
    scene.remove_load("pond")
    scene.put_pond(1.0, level=0.1)
    assert solver.advance(load=1.0).verification.passed
    assert scene.ponds[0].volume == pytest.approx(volume, rel=1e-8)


def test_cells_that_turn_over_under_water_are_no_equilibrium(comm: MPI.Intracomm) -> None:
    """Which only one that begins there can come to."""
    scene = drum(comm, 1.0)
    scene.put_pond(1e-3, level=1.0)
    solver = Solver(scene, max_halvings=0)
    x, u = scene.membrane.stress_free, scene.u.x.array.reshape(-1, 3)
    inside = np.hypot(x[:, 0], x[:, 1]) < 0.9 * RADIUS
    u[inside, 0], u[~inside, 2] = -2.5 * x[inside, 0], 3.0
    scene.held[:] = True
    with pytest.raises(ConvergenceError, match="the pond 'pond' has the volume -"):
        solver.advance(load=1.0)
