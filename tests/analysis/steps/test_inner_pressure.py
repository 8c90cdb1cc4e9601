"""Sealed air and fans: closed forms of a sphere, cables, and what keeps or refuses them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet
from mpi4py import MPI
from octant import ET, NU, RADIUS, octant, stretch
from scipy.optimize import brentq

from crms_fenicsx import Cable, FanControl, InputError, Scene, Solver, meshes


def given(lam: float) -> float:
    """Pressure that a sphere of this stretch needs."""
    return ET / (1 - NU) * (lam**2 - 1) / (lam * RADIUS)


START = brentq(lambda lam: given(lam) - 1.0, 1.0, 1.2)


def closed_form(heat: float, atmosphere: float, exponent: float) -> tuple[float, float]:
    """Stretch and pressure of the sphere, sealed at p = 1."""

    def smoothing_length(lam: float) -> float:
        absolute = heat * 102.325 * (START / lam) ** (3 * exponent)
        return absolute - atmosphere - given(lam)

    lam = brentq(smoothing_length, 0.9, 1.3)
    return lam, given(lam)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("heat", "atmosphere", "exponent", "expected"),
    [
        (1.1, 101.325, 1.0, (1.045309, 2.53297)),
        (1.0, 96.325, 1.0, (1.031974, 1.79880)),
        (1.1, 101.325, 1.4, None),
        (0.98, 98.0, 1.4, None),
    ],
)
def test_a_sealed_sphere(
    comm: MPI.Intracomm,
    heat: float,
    atmosphere: float,
    exponent: float,
    expected: tuple[float, float] | None,
) -> None:
    """Of second order in the cells' size, to what the closed form says."""
    lam, p = closed_form(heat, atmosphere, exponent)
    if expected is not None:
        assert (lam, p) == pytest.approx(expected, rel=1e-5)
    errors = []
    for n in (8, 16):
        scene = octant(comm, n)
        solver = advanced(Solver(scene), pressure=1.0)
        scene.seal(volume=np.pi / 6 * (START * RADIUS) ** 3, exponent=exponent)
        energy = scene.energy
        step = solver.advance()
        assert step.outcome.iterations == 0  # sealed, it is in the equilibrium that it was
        assert scene.energy == pytest.approx(energy, rel=1e-9)
        assert scene.pressure == pytest.approx(1.0, rel=1e-9)
        step = solver.advance(temperature=heat, atmosphere=atmosphere)
        assert step.verification is not None
        assert step.verification.passed
        errors.append((stretch(scene) - lam, scene.pressure - p))
        assert solver.history["temperature"][-1] == heat
    np.testing.assert_allclose(errors[1], (0.0, 0.0), atol=0.02)
    rates = np.log2(np.array(errors[0]) / np.array(errors[1]))
    np.testing.assert_allclose(rates, 2.0, atol=0.2)


def dome(comm: MPI.Intracomm, folder: Path | None = None, resume: bool | None = None) -> Solver:
    """An inflated square under a cable, with wind."""
    scene = sheet(comm, 5, "unstructured")
    solver = advanced(Solver(scene, results=folder, resume=resume), pressure=0.02)
    scene.lay_cable(Cable(32000.0), [(0.0, 41.0), (100.0, 55.0)], tension=20.0, name="ridge")
    scene.put_wind(0.01, lambda x, n: 0.4 - 1.2 * x[0] / 100.0)
    solver.advance()
    return solver


@pytest.mark.ranks
def test_a_cable_over_sealed_air(comm: MPI.Intracomm) -> None:
    """A gust raises the volume less; the same pressure, given, is in the same equilibrium."""
    solver = dome(comm)
    scene = solver.scene
    volume, pressure = scene.volume, scene.pressure
    with solver.branch("fans"):
        solver.advance(load={"wind": 1.0})
        free = scene.volume
    with solver.branch("gust"):
        scene.seal(volume=volume, atmosphere=0.3, exponent=1.4)
        step = solver.advance(load={"wind": 1.0})
        assert step.verification is not None
        assert step.verification.passed
        expected = 0.32 * (volume / scene.volume) ** 1.4 - 0.3
        assert scene.pressure == pytest.approx(expected, rel=1e-9)
        assert 0 < scene.volume - volume < 0.7 * (free - volume)
        total = solver.reactions("boundary").total
        tension, u = scene.cable("ridge").tension, scene.u.x.array.copy()
        scene.unseal()
        solver.advance()
        np.testing.assert_allclose(scene.u.x.array, u, atol=1e-5)
        assert scene.cable("ridge").tension == pytest.approx(tension, rel=1e-7)
        again = solver.reactions("boundary").total
        np.testing.assert_allclose(again, total, atol=1e-6 * np.abs(total).max())
    with solver.branch("hot"):
        scene.seal(volume=volume, atmosphere=0.3)
        for given in (293.0, 20.0, 0.02):
            with pytest.raises(InputError, match=r"over that at sealing, from 0\.5 to 2"):
                solver.advance(temperature=given)
        solver.advance(temperature=1.02)
        assert scene.pressure > pressure
    assert scene.air.sealed is None
    assert scene.pressure == pressure
    assert solver.advance().outcome.iterations == 0


def test_combinations_of_sealed_air(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 4, "unstructured")
    scene.put_load((0.0, 0.0, -2e-3), name="snow", per="plan")
    solver = advanced(Solver(scene), pressure=0.02)
    scene.seal(volume=60000.0, atmosphere=0.3)
    found = solver.combine(
        {"cold": {"temperature": 0.98}, "high": {"atmosphere": 0.29, "snow": 1.0}}
    )
    states = [found[name].snapshot.air for name in ("cold", "high")]
    assert [(s.sealed.temperature, s.sealed.atmosphere) for s in states] == [
        (0.98, 0.3),
        (1.0, 0.29),
    ]
    assert states[0].pressure < 0.02 < states[1].pressure
    assert scene.pressure == 0.02
    with pytest.raises(InputError, match="'warm': advance: temperature = 0 is not positive"):
        solver.combine({"warm": {"temperature": 0}})


def test_sealed_air_goes_on(comm: MPI.Intracomm, folder: Path) -> None:
    """From a checkpoint, and when the script runs again."""
    found = []
    for resume in (False, True):
        solver = dome(comm, folder / "run", resume)
        scene = solver.scene
        scene.seal(volume=60000.0, atmosphere=0.3)
        solver.advance(temperature=1.05, steps=2)
        solver.advance(atmosphere=0.295)
        found.append((scene.pressure, scene.energy, scene.cable("ridge").tension))
        assert len(solver.steps) == 5
        solver.save(folder / "checkpoint")
        kept = scene.air.sealed
        solver.advance(temperature=1.0)
        found[-1] += (scene.pressure,)
        del solver, scene
    assert found[0] == found[1]
    other = Solver(clamped(meshes.rectangle(comm, 100.0, 100.0, 20.0)))
    other.load(folder / "checkpoint")
    assert other.scene.air.sealed == kept
    other.advance(temperature=1.0)
    assert other.scene.pressure == pytest.approx(found[0][3], rel=1e-9)


def test_fans_follow_a_load(comm: MPI.Intracomm) -> None:
    """In increments, from the pressure before, in a call of its own and in combinations."""
    scene = sheet(comm, 4, "unstructured")
    scene.put_load((0.0, 0.0, -2e-3), name="snow", per="plan")
    solver = advanced(Solver(scene), pressure=0.02)
    fans = FanControl("snow", factors=[0.0, 0.5, 1.0], pressures=[0.01, 0.03, 0.035])
    solver.advance(load={"snow": 1.5}, pressure=fans, steps=4)
    # What is on top of the fans' 0.01 at the beginning goes off evenly.
    expected = np.interp([0.375, 0.75, 1.125, 1.5], fans.factors, fans.pressures)
    expected += 0.01 * np.array([0.75, 0.5, 0.25, 0.0])
    np.testing.assert_allclose(solver.history["pressure"][1:], expected, rtol=1e-12)
    found = solver.combine({"half": {"snow": 0.5, "pressure": fans}})
    assert found["half"].snapshot.air.pressure == pytest.approx(0.03, rel=1e-12)


@pytest.mark.ranks
def test_fans_follow_several_loads(comm: MPI.Intracomm, folder: Path) -> None:
    """By kind, and the highest of all, by hand: snow .1 + .3 x .2, wind .1 + .4 x .5; also from a
    checkpoint of a run that goes on."""
    fans = [
        FanControl("snow", [0.0, 1.0], [0.01, 0.04]),
        FanControl("wind", [0.0, 2.0], [0.01, 0.03]),
    ]

    def begun() -> Solver:
        scene = sheet(comm, 4, "unstructured")
        for name in ("snow drifted", "wind x", "wind y"):
            scene.put_load((0.0, 0.0, -1e-4), name=name)
        return advanced(Solver(scene, results=folder, resume=True), pressure=0.01)

    solver = begun()
    solver.advance(load={"snow drifted": 0.2, "wind y": 1.0}, pressure=fans, steps=2)
    # of the snow .01 + .03 x .2, of the wind .01 + .02 x .5
    assert solver.history["pressure"][-2:] == pytest.approx([0.015, 0.02])
    found = solver.combine(
        {"snow": {"snow drifted": 0.8, "pressure": fans}, "kept": {"wind x": 1.5},
         "wind": {"wind x": 1.6, "pressure": tuple(fans)}}
    )  # fmt: skip
    pressures = {name: one.snapshot.air.pressure for name, one in found.items()}
    assert pressures == {
        "snow": pytest.approx(0.034), "kept": pytest.approx(0.02), "wind": pytest.approx(0.026)
    }  # fmt: skip
    tension = solver.scene.energy
    del solver
    again = begun()
    again.advance(load={"snow drifted": 0.2, "wind y": 1.0}, pressure=fans, steps=2)
    assert again.scene.energy == tension and again.scene.pressure == pytest.approx(0.02)


def refused(scene: Scene) -> list[tuple[str, object]]:
    """Messages, and calls that raise them."""
    solver = Solver(scene)
    return [
        ("temperature = 1.1, but the air is not", lambda: solver.advance(temperature=1.1)),
        ("unseal: the air is not sealed", scene.unseal),
        ("exponent = 0.9 is below 1", lambda: scene.seal(volume=1.0, exponent=0.9)),
        ("there is no load 'gale'", lambda: solver.advance(pressure=FanControl("gale", [0], [1]))),
        ("pressure = .* is not a valid list", lambda: solver.advance(pressure=[])),
        ("an item of pressure = .0.3. is of type float", lambda: solver.advance(pressure=[0.3])),
    ]  # fmt: skip


@pytest.mark.ranks
def test_bad_input(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 2, "unstructured")
    for message, call in refused(scene):
        with pytest.raises(InputError, match=message):
            call()
    scene.air.update(pressure=-2.0)
    with pytest.raises(InputError, match="below vacuum in an atmosphere of 1"):
        scene.seal(volume=1.0, atmosphere=1.0)
    scene.air.update(pressure=0.0)
    scene.seal(volume=1000.0)
    solver = Solver(scene)
    for message, arguments in (
        ("pressure = 1.0, but the air is sealed, .* scene.unseal", {"pressure": 1.0}),
        ("temperature = -1 is not positive", {"temperature": -1}),
        ("atmosphere = 0 is not positive", {"atmosphere": 0}),
    ):
        with pytest.raises(InputError, match=message):
            solver.advance(**arguments)
    with pytest.raises(InputError, match="sealed already"):
        scene.seal(volume=1.0)
    paper = sheet(comm, 2, "unstructured", pressure="step")
    with pytest.raises(InputError, match="exact follower pressure"):
        paper.seal(volume=1.0)
    for message, factors, pressures in (
        ("must increase", [1.0, 0.0], [0.1, 0.2]),
        ("2 factors and 1 pressures", [0.0, 1.0], [0.1]),
        ("factors = 3", 3, [0.1]),
        ("one of pressures = nan is not finite", [0.0], [float("nan")]),
    ):
        with pytest.raises(InputError, match=message):
            FanControl("wind", factors, pressures)
