"""Wind by EN 1991-1-4: zones on roofs, tables at their ends and between, and bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, Scene, meshes
from crms_fenicsx.design.codes import (
    ArchWind,
    asce7_arch_zones,
    canopy,
    dome,
    en1991_vault_zones,
    peak_pressure,
    vault,
    wind_table,
)
from crms_fenicsx.design.codes import wind as module
from crms_fenicsx.design.codes.wind import Footprint
from crms_fenicsx.foundation.runtime.arrays import Array

FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
UNIT = Footprint((1.0, 0.0), (0.0, 0.0), 10.0, 20.0, 0.0, 5.0)


def at(*places: tuple[float, float]) -> Array:
    return np.array([[x, y, 0.0] for x, y in places]).T


def flat(comm: MPI.Intracomm) -> Scene:
    return Scene(meshes.rectangle(comm, 10.0, 20.0, 1.0, structured=True), FOIL)


def test_zones_of_vaults() -> None:
    """The quarters A and C of the arc and the half B between them; half a circle has 0.8, -1.2,
    -0.4, and A up to 45 degrees, (1 - cos 45) / 2 = 0.146 of its depth."""
    wind = ArchWind(UNIT, en1991_vault_zones(0.5), stepped=True)
    found = wind(at((0.1, 3.0), (1.4, 9.0), (1.5, 9.0), (8.5, 1.0), (8.6, 1.0)), at())
    np.testing.assert_allclose(found, [0.8, 0.8, -1.2, -1.2, -0.4])
    flat = ArchWind(replace(UNIT, high=0.0), (0.1, -0.8, -0.4), stepped=True)
    found = flat(at((2.4, 0.0), (2.6, 0.0), (7.4, 0.0), (7.6, 0.0)), at())
    np.testing.assert_allclose(found, [0.1, -0.8, -0.8, -0.4])
    assert en1991_vault_zones(0.275) == pytest.approx((0.45, -1.0, -0.4))  # half way
    assert asce7_arch_zones(0.5, raised=False) == pytest.approx((0.7, -1.2, -0.5))
    assert asce7_arch_zones(0.1, raised=True) == pytest.approx((-0.9, -0.8, -0.5))
    assert asce7_arch_zones(0.25, raised=True) == pytest.approx((0.075, -0.95, -0.5))
    assert asce7_arch_zones(0.25, raised=True, alternative=True)[0] == pytest.approx(-0.6)
    assert asce7_arch_zones(0.4, raised=True)[0] == pytest.approx(0.4)


def test_a_published_reading_of_the_figure_of_vaults() -> None:
    """Graitec's example of 2021 (civil-engineering-design.com, "Wind action evaluation on vaulted
    roofs"): f/d = 2.51 / 9.60, for h/d = 0 it reads A = 0.42, B = -0.96, C = -0.40."""
    found = en1991_vault_zones(2.51 / 9.60)
    np.testing.assert_allclose(found, (0.42, -0.96, -0.40), atol=0.03)


def test_monopitch_canopies_as_in_the_british_standard() -> None:
    """BS 6399-2:1997, table 13, from which EN 1991-1-4, table 7.6, has these rows: overall, A, B
    and C for pitches of 0, 5 ... 30 degrees, largest ones and, of empty canopies, least ones."""
    largest = """0.2 0.5 1.8 1.1  0.4 0.8 2.1 1.3  0.5 1.2 2.4 1.6  0.7 1.4 2.7 1.8  0.8 1.7 2.9 2.1
        1.0 2.0 3.1 2.3  1.2 2.2 3.2 2.4"""
    least = """0.5 0.6 1.3 1.4  0.7 1.1 1.7 1.8  0.9 1.5 2.0 2.1  1.1 1.8 2.4 2.5  1.3 2.2 2.8 2.9
        1.6 2.6 3.2 3.2  1.8 3.0 3.8 3.6"""
    for text, table, sign in (
        (largest, module.CANOPIES["monopitch"][1], 1), (least, module.CANOPIES["monopitch"][2], -1),
    ):  # fmt: skip
        expected = sign * np.array(text.split(), dtype=float).reshape(7, 4).T
        np.testing.assert_allclose([table[x] for x in ("overall", "A", "B", "C")], expected)


def test_canopies_as_in_the_south_african_standard() -> None:
    """SANS 10160-3, tables 13 and 14, as a public program has them: zones of canopies with blockage
    by pitch, without signs, and of the empty duopitch one. EN 1991-1-4 is their source."""
    monopitch = """1.5 1.8 2.2  1.6 2.2 2.5  2.1 2.6 2.7  1.6 2.9 3.0  1.6 2.9 3.0  1.5 2.5 2.8
        1.5 2.2 2.7"""
    blocked = """1.5 2.4 2.4 0.6  1.6 2.7 2.6 0.6  1.6 2.7 2.6 0.6  1.5 2.4 2.4 0.6  1.3 2.0 1.8 1.5
        1.3 2.0 1.8 1.8  1.3 2.2 1.6 2.1  1.4 2.2 1.6 2.1  1.4 2.0 1.5 2.0  1.4 1.8 1.4 2.0"""
    empty = """0.9 1.3 1.6 0.6  0.8 1.3 1.6 0.6  0.8 1.3 1.5 0.6  0.7 1.3 1.6 0.6  0.6 1.4 1.4 1.1
        0.7 1.5 1.4 1.4  0.9 1.7 1.4 1.8  1.2 1.8 1.4 2.0  1.4 1.9 1.4 2.0  1.4 1.9 1.4 2.0"""
    largest = """0.8 1.6 0.6 1.7  0.6 1.5 0.7 1.4  0.6 1.4 0.8 1.1  0.5 1.5 0.8 0.8  0.6 1.8 1.3 0.4
        0.7 1.8 1.4 0.4  0.9 1.9 1.4 0.4  1.1 1.9 1.5 0.4  1.2 1.9 1.6 0.5  1.3 1.9 1.6 0.7"""
    for text, table, zones, sign in (
        (monopitch, module.CANOPIES["monopitch"][3], "ABC", -1),
        (blocked, module.CANOPIES["duopitch"][3], "ABCD", -1),
        (empty, module.CANOPIES["duopitch"][2], "ABCD", -1),
        (largest, module.CANOPIES["duopitch"][1], "ABCD", 1),
    ):
        expected = sign * np.array(text.split(), dtype=float).reshape(-1, len(zones)).T
        np.testing.assert_allclose([table[x] for x in zones], expected)


@pytest.mark.ranks
def test_a_dome_on_the_ground(comm: MPI.Intracomm) -> None:
    """Linear along the arc over the crown: half way up, at 45 degrees, it is half way from A to B;
    the same across the wind."""
    scene = Scene(meshes.spherical_cap(comm, radius=5.0, height=5.0, size=1.5), FOIL)
    wind = dome(scene, (0.0, 2.0))
    assert wind.roof.depth == pytest.approx(10.0, rel=0.02)
    r = wind.roof.depth / 2
    s = r * np.sqrt(0.5)
    y0 = wind.roof.start[0] + r
    found = wind(at((0.0, y0 - r), (0.0, y0 - s), (0.0, y0), (3.0, y0 - s), (0.0, y0 + r)), at())
    np.testing.assert_allclose(found, [0.8, -0.2, -1.2, -0.2, 0.0], atol=0.02)
    scene.put_wind(0.8, wind, name="wind")
    assert scene.load("wind").intensity > 0.0
    shallow = Scene(meshes.spherical_cap(comm, radius=5.0, height=2.0, size=1.5), FOIL)
    with pytest.raises(InputError, match=r"f/d = 0\.1.* is not built in, only f/d = 0\.5"):
        dome(shallow, (1.0, 0.0))
    assert dome(shallow, (1.0, 0.0), zones=(0.1, -0.8, -0.2)).zones == (0.1, -0.8, -0.2)


@pytest.mark.ranks
def test_zones_of_canopies(comm: MPI.Intracomm) -> None:
    """Strips of d/10 and b/10, of d/5 along the ridge; the worse one where strips meet."""
    scene = flat(comm)
    places = at((3.5, 10.0), (3.5, 1.0), (0.5, 10.0), (5.5, 10.0), (0.5, 1.0), (5.0, 19.0))
    up = canopy(scene, (1, 0), "duopitch", 20.0, "up")
    np.testing.assert_allclose(up(places, at()), [-1.2, -1.8, -1.4, -2.0, -1.8, -2.0])
    down = canopy(scene, (1, 0), "monopitch", 20.0, "down", blockage=0.3)
    np.testing.assert_allclose(down(places, at()), [1.7, 2.9, 2.1, 1.7, 2.9, 2.9])
    half = canopy(scene, (1, 0), "monopitch", 20.0, "up", blockage=0.5, take="overall")
    assert half.zones["overall"] == pytest.approx((-1.3 - 1.4) / 2)
    trough = canopy(scene, (1, 0), "duopitch", -7.5, "down", take="first")
    np.testing.assert_allclose(trough(places, at()), [0.35, 0.35, 0.35, 0.0, 0.35, 0.35])


def test_tables_have_a_value_for_each_pitch() -> None:
    for pitches, *tables in module.CANOPIES.values():
        for table in tables:
            assert {len(row) for row in table.values()} == {len(pitches)}
            sizes = {name: np.abs(row) for name, row in table.items()}
            assert np.all(np.maximum(sizes["A"], sizes["B"]) >= sizes["overall"])


@pytest.mark.ranks
def test_bad_input(comm: MPI.Intracomm) -> None:
    scene = flat(comm)
    tent = {"scene": scene, "direction": (1, 0), "kind": "duopitch", "pitch": 12.0, "effect": "up"}
    for call, arguments, message in (
        (en1991_vault_zones, {"rise": 0.6}, "f/d = 0.6 is outside the range of 0.05 to 0.5"),
        (en1991_vault_zones, {"rise": 0.3, "height": 0.4}, "h/d = 0.4 is not built in"),
        (asce7_arch_zones, {"rise": 0.7, "raised": True}, "rise = 0.7 is outside the range of 0"),
        (asce7_arch_zones, {"rise": 0.4, "raised": True, "alternative": True}, "the range of 0.2"),
        (vault, {"scene": scene, "direction": (1, 0)}, "f/d = 0 is outside the range of 0.05"),
        (vault, {"scene": scene, "direction": (1, 0), "height": -1.0}, "outside the range of 0"),
        (vault, {"scene": scene, "direction": (1, 0), "part": "attic"}, "no part 'attic'"),
        (
            vault,
            {"scene": scene, "direction": (1, 0), "zones": (1, 2)},
            "must be three",
        ),
        (dome, {"scene": scene, "direction": (1, 0)}, "the roof has no rise"),
        (canopy, {**tent, "pitch": 31.0}, "pitch of a duopitch roof = 31 .* -20 to 30 degrees"),
        (canopy, {**tent, "pitch": 3.0}, "pitch = 3 degrees of a duopitch roof is outside table"),
        (canopy, {**tent, "kind": "monopitch", "pitch": -1.0}, "monopitch roof = -1 is outside"),
        (canopy, {**tent, "blockage": 1.1}, "blockage = 1.1 is outside the range of 0 to 1"),
        (canopy, {**tent, "kind": "monopitch", "take": "first"}, "take = 'first' is for duopitch"),
    ):
        with pytest.raises(InputError, match=message):
            call(**arguments)  # type: ignore[operator]


@pytest.mark.parametrize(
    ("v_b", "z", "terrain", "q_p"),
    [
        # Steel Buildings in Europe, part 3, appendix B: c_r = 0.706, c_e = 1.56, q_b = 422.5 N/m^2
        (26.0, 8.0, "III", 0.659),
        # a published spreadsheet (scribd, "Wind Eurocode"), sea: k_r = 0.156, v_m = 39.62 m/s
        (25.0, 77.36, "0", 1.658),
        (25.0, 28.0, "0", 1.403),
    ],
)
def test_published_peak_pressures(v_b: float, z: float, terrain: str, q_p: float) -> None:
    assert peak_pressure(v_b, z, terrain) == pytest.approx(q_p, rel=5e-3)  # type: ignore[arg-type]


def test_peak_pressures_by_hand() -> None:
    """Below z_min it is that of z_min; a hill raises the mean wind, not its turbulence."""
    assert peak_pressure(26.0, 1.0, "III") == peak_pressure(26.0, 5.0, "III")
    flat, hill = (peak_pressure(26.0, 8.0, "II", orography=c) for c in (1.0, 1.2))
    profile = np.log(8.0 / 0.05)
    assert flat == pytest.approx(0.19**2 * profile * (profile + 7) * 0.625 * 26.0**2 / 1000)
    assert hill / flat == pytest.approx(1.2 * (1.2 * profile + 7) / (profile + 7))
    for bad in ((26.0, 300.0, "II"), (26.0, 8.0, "V"), (0.0, 8.0, "II"), (26.0, -1.0, "II")):
        with pytest.raises(InputError, match="peak_pressure"):
            peak_pressure(*bad)  # type: ignore[arg-type]


def bent(comm: MPI.Intracomm, height) -> Scene:  # type: ignore[no-untyped-def]
    """A surface over 10 x 20, by its height over relative places from -1 to 1."""
    mesh = meshes.rectangle(comm, 10.0, 20.0, 1.0, structured=True)
    x = mesh.mesh.geometry.x
    x[:, 2] = height(x[:, 0] / 5 - 1, x[:, 1] / 10 - 1)
    return Scene(mesh, FOIL)


@pytest.mark.parametrize(
    ("height", "words"),
    [
        (lambda s, t: 3 * s * s - 3 * t * t, "sags along the wind"),
        (lambda s, t: -3 * s * s + 3 * t * t, "is a saddle or twisted: it is 3 higher"),
        (lambda s, t: 2 * s * t, "is a saddle or twisted|sags along the wind"),
        (lambda s, t: -3 * t * t, "sags along the wind"),  # wind along the vault
        (lambda s, t: -3 * s * s, None),
        (lambda s, t: -3 * s * s - 2 * t * t, None),  # as an air hall
        (lambda s, t: -3 * s * s + 0.9 * t * t, None),  # hung between arches
    ],
)
def test_a_saddle_is_no_vault(comm: MPI.Intracomm, height, words) -> None:  # type: ignore[no-untyped-def]
    scene = bent(comm, height)
    zones = (0.4, -0.9, -0.4)
    if words is None:
        assert vault(scene, (1.0, 0.0), zones=zones).zones == zones
        return
    with pytest.raises(InputError, match=words):
        vault(scene, (1.0, 0.0), zones=zones)


@pytest.mark.ranks
def test_a_table_of_ones_own(comm: MPI.Intracomm) -> None:
    scene = bent(comm, lambda s, t: 3 * s * s - 3 * t * t)
    values = [[0.5, 0.6], [-0.5, -0.9]]
    zones = wind_table(scene, (1.0, 0.0), (0.2, 0.6), (0.25, 0.75), values)
    found = zones(at((1.0, 1.0), (3.9, 11.0), (4.1, 9.0), (9.0, 19.0)), at())
    np.testing.assert_allclose(found, [0.5, 0.6, -0.5, -0.9])
    smooth = wind_table(scene, (1.0, 0.0), (0.0, 1.0), (0.0, 1.0), values, linear=True)
    np.testing.assert_allclose(smooth(at((5.0, 0.0), (5.0, 10.0)), at()), [0.0, -0.075], atol=1e-12)
    scene.put_wind(0.8, zones, name="wind x")
    for bad in (
        {"along": (0.6, 0.2)}, {"along": (0.2, 1.2)}, {"across": ()}, {"values": [[1.0, 2.0]]},
        {"values": [[1.0, np.nan], [0.0, 0.0]]}, {"values": [["a", "b"], ["c", "d"]]},
    ):  # fmt: skip
        given = {"along": (0.2, 0.6), "across": (0.25, 0.75), "values": values, **bad}
        with pytest.raises(InputError, match="wind_table"):
            wind_table(scene, (1.0, 0.0), **given)  # type: ignore[arg-type]
