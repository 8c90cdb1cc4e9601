"""Snow by EN 1991-1-3: coefficients by hand, worked examples, on roofs, and bad input."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, Solver, meshes
from crms_fenicsx.design.codes import (
    CylindricalSnow,
    DriftedSnow,
    DuopitchSnow,
    MultispanSnow,
    PitchedSnow,
    snow_load,
    snow_on_pitch,
)
from crms_fenicsx.foundation.runtime.arrays import Array

FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)


def places(*x: float) -> Array:
    return np.array([x, np.zeros(len(x)), np.zeros(len(x))])


def level(n: int) -> Array:
    return np.tile([[0.0], [0.0], [1.0]], n)


def test_coefficients_of_pitches() -> None:
    """Table 5.2: 0.8 up to 30 degrees, 0.8 (60 - a) / 30, 0 from 60 degrees on."""
    pitches = np.array([0.0, 30.0, 37.5, 45.0, 60.0, 90.0])
    np.testing.assert_allclose(snow_on_pitch(pitches), [0.8, 0.8, 0.6, 0.4, 0.0, 0.0])
    np.testing.assert_allclose(snow_on_pitch(pitches, retained=True), 0.8)
    normals = np.array([np.sin(np.radians(pitches)), 0 * pitches, np.cos(np.radians(pitches))])
    found = PitchedSnow()(0 * normals, normals)
    np.testing.assert_allclose(found, snow_on_pitch(pitches), atol=1e-12)
    np.testing.assert_allclose(PitchedSnow(45.0)(0 * normals, normals), 0.4)


def test_the_three_arrangements_of_a_duopitch_roof() -> None:
    for case, expected in (("i", [0.8, 0.8]), ("ii", [0.4, 0.8]), ("iii", [0.8, 0.4])):
        shape = DuopitchSnow((5.0, 0.0), (1.0, 0.0), case=case, pitch=6.0)  # type: ignore[arg-type]
        np.testing.assert_allclose(shape(places(1.0, 9.0), level(2)), expected)


def test_cylindrical_roof_by_hand() -> None:
    """b = 20, h = 3: mu_3 = 0.2 + 10 x 3/20 = 1.7; R = 18.17, so that all of b is below 60."""
    shape = CylindricalSnow((10.0, 0.0), (1.0, 0.0), span=20.0, rise=3.0, case="ii")
    assert shape.mu_3 == pytest.approx(1.7)
    assert shape.width == 20.0
    found = shape(places(0.0, 5.0, 10.0, 12.5, 15.0, 20.0), level(6))
    np.testing.assert_allclose(found, [0.0, 0.85, 0.0, 0.85, 1.7, 0.0], atol=1e-12)
    half = CylindricalSnow((0.0, 0.0), (0.0, 2.0), span=20.0, rise=10.0)  # half a circle
    assert half.mu_3 == 2.0
    assert half.width == pytest.approx(20 * np.sin(np.radians(60)))  # 17.32
    beside = np.array([[0.0, 0.0], [8.0, 9.0], [0.0, 0.0]])
    np.testing.assert_allclose(half(beside, level(2)), [0.8, 0.0])


def test_drift_beside_a_taller_building() -> None:
    """Of the European steel design guide for single-storey buildings: b1 = 10, b2 = 40, s_k = 0.65,
    gamma = 2, h = 3: (b1 + b2)/2h = 8.3 <= gamma h/s_k = 9.2, so that mu_w is 4; l_s = 6."""
    shape = DriftedSnow((0.0, 0.0), (1.0, 0.0), height=3.0, upper=10.0, lower=40.0, s_k=0.65)
    assert (shape.mu_w, shape.mu_s, shape.length) == (4.0, 0.0, 6.0)
    np.testing.assert_allclose(shape(places(0.0, 3.0, 6.0, 40.0), level(4)), [4.0, 2.4, 0.8, 0.8])
    eaves = DriftedSnow((0.0, 0.0), (1.0, 0.0), height=4.25, upper=10.0, lower=40.0, s_k=0.65)
    assert (eaves.mu_w, eaves.length) == (4.0, 8.5)
    force = snow_load(0.65, eaves)(places(0.0, 8.5), level(2))
    np.testing.assert_allclose(force[2], [-2.60, -0.52])
    roof = DuopitchSnow((0.0, 0.0), (1.0, 0.0), case="ii", pitch=8.5)  # its upper roof, figure A.2
    force = snow_load(0.65, roof)(places(-1.0, 1.0), level(2))
    np.testing.assert_allclose(force[2], [-0.26, -0.52])
    low = DriftedSnow((0.0, 0.0), (1.0, 0.0), height=1.0, upper=10.0, lower=40.0, s_k=0.75)
    assert low.mu_w == pytest.approx(2.0 * 1.0 / 0.75)  # bound by gamma h / s_k
    assert low.length == 5.0
    steep = DriftedSnow((0.0, 0.0), (1.0, 0.0), 5.0, 10.0, 8.0, 0.65, 30.0, 5.0)
    assert steep.mu_w == pytest.approx(1.8)
    # half of the slope's snow, 0.5 x 0.8 x 5 = 2.0, is the triangle mu_s l_s / 2 with l_s = 10
    assert steep.mu_s * steep.length / 2 == pytest.approx(2.0)


@pytest.mark.ranks
def test_snow_on_a_cap_is_carried(comm: MPI.Intracomm) -> None:
    """Slopes below 30 degrees: the reaction is 0.8 s_k times the plan, with C_e and C_t."""
    mesh = meshes.spherical_cap(comm, radius=5.0, height=1.0, size=1.0)
    scene = clamped(mesh, FOIL)
    Solver(scene).advance(pressure=0.05)
    corners = scene.positions()[scene.V.dofmap.list[: mesh.mesh.topology.index_map(2).size_local]]
    a, b = (corners[:, k] - corners[:, 0] for k in (1, 2))
    plan = comm.allreduce(float(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2))
    scene.put_load(snow_load(0.5, exposure=1.2, thermal=0.9), name="snow", per="plan")
    total = comm.allreduce(float(scene.load("snow").forces[:, 2].sum()))
    assert total == pytest.approx(-0.8 * 0.5 * 1.2 * 0.9 * plan, rel=1e-12)


def test_bad_input() -> None:
    vault = {"crown": (0, 0), "across": (1, 0), "span": 20.0, "rise": 3.0}
    drift = {"wall": (0, 0), "away": (1, 0), "height": 3.0, "upper": 9.0, "lower": 9.0, "s_k": 0.6}
    for call, arguments, message in (
        (snow_on_pitch, {"pitch": 91.0}, "pitch = 91.0 is not between 0 and 90"),
        (
            PitchedSnow,
            {"pitch": -3.0},
            "pitch = -3 is outside the range of 0 to 90 degrees",
        ),
        (
            DuopitchSnow,
            {"ridge": (0, 0), "across": (0, 0)},
            "across = .* is zero in plan",
        ),
        (CylindricalSnow, {**vault, "rise": 10.1}, "rise / span = 0.505 is outside .* 0 to 0.5"),
        (DriftedSnow, {**drift, "upper_pitch": 20.0}, "upper_slope = 0.0 is not positive"),
        (snow_load, {"s_k": 1.0, "shape": 0.8}, "shape = 0.8 is not a snow shape"),
    ):
        with pytest.raises(InputError, match=message):
            call(**arguments)  # type: ignore[operator]


def test_multispan_roofs_by_hand() -> None:
    """Figure 5.4 with pitches of 40 and 20 degrees: mu_1 = 0.8 (60 - 40) / 30 = 0.533 and 0.8, in
    the valley mu_2 of 30 degrees, 1.6. Ridges at 5, 15 and 25, valleys at 10 and 20."""
    bays = {"origin": (0, 0), "across": (1, 0), "lines": (5, 10, 15, 20, 25), "pitches": (40, 20)}
    steep = 0.8 * 20 / 30
    at = places(2.0, 5.001, 7.5, 10.0, 12.5, 14.999, 17.5, 23.0, 27.0)
    even = MultispanSnow(**bays)(at, level(9))  # type: ignore[arg-type]
    np.testing.assert_allclose(even, [steep, 0.8, 0.8, 0.8, steep, steep, 0.8, steep, 0.8])
    drifted = MultispanSnow(**bays, case="ii")  # type: ignore[arg-type]
    assert drifted.mu_2 == pytest.approx(1.6)
    half = (steep + 1.6) / 2
    expected = [steep, 0.8, 1.2, 1.6, half, steep, 1.2, 1.6 + 0.6 * (steep - 1.6), 0.8]
    np.testing.assert_allclose(drifted(at, level(9)), expected, atol=1e-3)


def test_mu_2_of_table_5_2() -> None:
    """0.8 + 0.8 a / 30 up to 30 degrees, then 1.6."""
    for pitch, mu in ((0.0, 0.8), (15.0, 1.2), (30.0, 1.6), (45.0, 1.6)):
        shape = MultispanSnow((0, 0), (1, 0), (0, 1, 2), (pitch, pitch), "ii")
        assert shape.mu_2 == pytest.approx(mu)
    for bad in (
        {"lines": (5, 10)}, {"lines": (5, 10, 10)}, {"lines": (1, 2, 3, 4)}, {"lines": "abc"},
        {"pitches": (70.0, 60.0)}, {"pitches": (100.0, 0.0)}, {"pitches": 20.0}, {"case": "iii"},
    ):  # fmt: skip
        given = {"origin": (0, 0), "across": (1, 0), "lines": (0, 1, 2), "pitches": (20, 20), **bad}
        with pytest.raises(InputError, match="MultispanSnow"):
            MultispanSnow(**given)  # type: ignore[arg-type]
