"""The tables of a report's model: what its figures follow from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    Friction,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    UflMembrane,
    codes,
)
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.results.output.report.design_tables import alike
from crms_fenicsx.results.output.report.model_tables import merged, model_of_scene
from crms_fenicsx.results.output.report.page import Units

COMM = MPI.COMM_SELF
WOVEN: dict[str, Any] = {"G12": 30.0, "nu21": 0.2, "warp": (0.0, 1.0, 0.0), "prestress": (2, 1)}


def scene_of(material: MembraneMaterial, **options: Any) -> Scene:
    return sheet(COMM, 2, material=material, side=4.0, **options)


@pytest.mark.parametrize(
    ("material", "text"),
    [
        (
            OrthotropicMembrane(900.0, 600.0, thickness=1.0, **WOVEN),
            "E1 t = 900 kN/m, E2 t = 600 kN/m, G12 t = 30 kN/m, nu21 = 0.2, warp = (0, 1, 0), "
            "prestress = (2, 1) kN/m, wrinkling = yes",
        ),
        (
            IsotropicMembrane(E=8e5, nu=0.45, thickness=2.5e-4),
            "E t = 200 kN/m, nu = 0.45, thickness = 0.00025 m, prestress = 0 kN/m, wrinkling = yes",
        ),
        (UflMembrane(lambda E: E[0, 0] ** 2 + E[1, 1] ** 2 + E[0, 1] ** 2), None),
    ],
)
def test_materials_are_told_by_force_per_length(
    material: MembraneMaterial, text: str | None
) -> None:
    (row,) = model_of_scene(scene_of(material), Units("m", "kN")).tables["materials"].rows
    assert "kN/m²" not in str(row[3])
    assert row[3] == text or (text is None and "psi = function" in str(row[3]))


def test_warp_of_cells_with_shapes_of_their_own() -> None:
    """No direction of the material, which is not computed with."""
    frames = np.tile([[(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)]], (8, 1, 1))
    fabric = OrthotropicMembrane(900.0, 600.0, thickness=1.0, **WOVEN)
    (row,) = model_of_scene(scene_of(fabric, frames=frames), Units()).tables["materials"].rows
    assert "warp = as the pieces are cut" in str(row[3])


def test_design_values_can_be_followed() -> None:
    """Of cables and bars with all factors, by hand; of alike members in turn in one row."""
    scene = scene_of(IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0))
    scene.lay_cable(Cable(EA=2e3, expansion=1.2e-5), [(0.0, 1.7), (4.0, 2.2)], name="A1")
    rough = Cable(EA=2e3, friction=Friction(0.1, along=0.2))
    scene.lay_cable(rough, [(1.7, 0.0), (2.2, 4.0)], name="A2")
    scene.lay_cable(Cable(EA=2e3, friction=0.3), [(2.9, 0.0), (2.8, 4.0)], name="A3")
    mast = codes.steel_bar("CHS 168.3x8", 235e3, curve="a", gamma_M=1.1)
    scene.add_bar(mast, (9.0, 0.0, 0.0), (9.0, 0.0, 5.5), name="mast")
    for k in range(1, 5):
        guy = Bar(EA=9.0, tension_only=True, strength=50.0)
        scene.add_bar(guy, (8.0, float(k), 0.0), (9.0, 0.0, 4.0), name=f"guy {k}")
    rope = codes.CableDesign(breaking=220.0, ending=0.9, proof=130.0, gamma_R=0.9)
    scene.set_strengths((40.0, 40.0), cables={"A1": rope, "A2": 117.7})
    tables = model_of_scene(scene, Units("m", "kN")).tables
    frictions = [str(row[3])[:8] for row in tables["cables"].rows]
    assert frictions == ["none", "mu = 0.1", "mu = 0.3"]
    assert [row[-1] for row in tables["cables"].rows] == [1.2e-5, None, None]
    assert [row[-1] for row in tables["bars"].rows] == [1.2e-5, *[None] * 4]
    assert [row[3] for row in tables["bars"].rows] == [bar.L0 for bar in scene.bars]
    first, second, third = tables["cable values"].rows
    # F_Rd = min(0.9 220 / (1.5 0.9), 130 / 0.9), in service 0.45 0.9 220
    assert first[:6] == ("A1", 220.0, 0.9, 198.0, 130.0, 0.9)
    assert first[6:] == pytest.approx((130.0 / 0.9, 89.1))
    assert second == ("A2", *(None,) * 5, 117.7, None) and set(third[1:]) == {None}
    values = tables["bar values"]
    assert values.columns[4] == "N_t,Rd [kN]" and values.columns[10] == "N_b,Rd [kN]"
    of = dict(zip(values.columns, values.rows[0], strict=True))
    assert of["Section"] == "CHS 168.3x8: A = 40.29 cm², I = 1297 cm⁴, f_y = 235 N/mm²"
    # EN 1993-1-1, 6.3.1.2, by hand: A = 40.29 cm^2, I = 1297 cm^4, L_cr = 5.5 m
    euler = np.pi**2 * 210e6 * 1297e-8 / 5.5**2
    slender = np.sqrt(40.29e-4 * 235e3 / euler)
    phi = 0.5 * (1 + 0.21 * (slender - 0.2) + slender**2)
    chi = 1 / (phi + np.sqrt(phi**2 - slender**2))
    due = (947.0 / 1.1, 5.5, euler, slender, chi, chi * 947.0 / 1.1)
    names = ("N_t,Rd [kN]", "L_cr [m]", "N_cr [kN]", "Slenderness", "chi", "N_b,Rd [kN]")
    assert [of[name] for name in names] == pytest.approx(due, rel=1e-3)
    assert [row[0] for row in alike(values).rows] == ["mast", "guy 1 ... guy 4"]
    assert {*values.rows[1][5:]} == {None} and values.rows[1][4] == 50.0
    scene.set_limits(deflection=0.3, prestress=0.4, slope=2.0, water=0.0)
    limits = model_of_scene(scene, Units("m", "kN")).tables["limits"].rows
    assert [row[1] for row in limits] == ["0.3000 m", "0.4000 kN/m", "2.000°", "0 m"]


def test_design_values_not_given_have_no_table() -> None:
    scene = scene_of(IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0))
    scene.lay_cable(Cable(EA=2e3), [(0.0, 1.7), (4.0, 2.2)], name="A1")
    tables = model_of_scene(scene, Units()).tables
    assert not any(tables[name].rows for name in ("cable values", "bar values", "limits"))


def test_make_of_cables() -> None:
    """As given with the design value; EA of the cable in the model."""
    strand = codes.CableDesign(
        220.0, construction="spiral strand 1x19", diameter=0.016, area=153e-6, modulus=150e6
    )
    assert strand.stiffness == pytest.approx(22950.0)
    scene = scene_of(IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0))
    scene.lay_cable(Cable(EA=strand.stiffness), [(0.0, 1.7), (4.0, 2.2)], name="A1")
    scene.lay_cable(Cable(EA=2e3), [(1.7, 0.0), (2.2, 4.0)], name="A2")
    guy = Bar(EA=9e3, tension_only=True)
    scene.add_bar(guy, (8.0, 0.0, 0.0), (9.0, 0.0, 4.0), name="guy")
    plain = codes.CableDesign(breaking=90.0)
    scene.set_strengths((40.0, 40.0), cables={"A2": plain, "guy": plain})
    assert model_of_scene(scene, Units("m", "kN")).tables["cable make"].rows == []
    scene.set_strengths((40.0, 40.0), cables={"A1": strand, "A2": 50.0, "guy": plain})
    table = model_of_scene(scene, Units("m", "kN")).tables["cable make"]
    assert table.columns[2:5] == ["Diameter [m]", "Metallic area [m²]", "Modulus [kN/m²]"]
    first, second = table.rows
    assert first == ("A1", "spiral strand 1x19", 0.016, 153e-6, 150e6, strand.stiffness, 220.0)
    assert second == ("guy", *[None] * 4, 9e3, 90.0)
    with pytest.raises(InputError, match="area"):
        _ = plain.stiffness


def test_temperatures_say_what_they_follow() -> None:
    """Reference temperature, range and coefficients of expansion of what a load changes."""
    material = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0, expansion=5e-5)
    scene = scene_of(material)
    for k, name in enumerate(("A1", "A2")):
        rope = Cable(EA=2e3, expansion=1.2e-5)
        scene.lay_cable(rope, [(0.0, 1.7 + k), (4.0, 1.2 + k)], name=name)
    scene.put_temperature(-30.0, name="temperature winter", reference=10.0)
    scene.put_temperature({"fabric": 45.0}, name="temperature summer")
    basis = model_of_scene(scene, Units("m", "kN")).basis
    assert basis["Load temperature winter"] == (
        "T_0 = 10 °C, all -30 K to -20 °C, coefficients of expansion: 5e-05 1/K of fabric; "
        "1.2e-05 1/K of A1, A2"
    )
    assert basis["Load temperature summer"] == "coefficients of expansion: 5e-05 1/K of fabric"


def test_loads_say_what_they_follow() -> None:
    """Data of loads by code, and docstrings of functions, in the basis of design."""
    scene = scene_of(IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0))

    def drift(points: Array, normals: Array) -> Array:
        """Snow behind the parapet."""
        return np.stack([0 * points[0], 0 * points[0], 0 * points[0] - 0.3])

    scene.put_load(codes.snow_load(0.75, exposure=1.2), name="snow", per="plan")
    scene.put_load(drift, name="drift", per="plan")
    scene.put_load((0.0, 0.0, -0.01), name="weight")
    scene.put_wind(0.65, -0.8, name="suction")
    scene.put_wind(0.65, codes.canopy(scene, (1, 0), "monopitch", 5.0, "up"), name="up")
    q_p = codes.peak_pressure(25.0, 10.0, "II")
    scene.put_wind(q_p, lambda x, n: 0.2 * x[0], name="storm")
    vault = codes.CylindricalSnow((0, 0), across=(1, 0), span=4.0, rise=1.0, case="ii")
    scene.put_load(codes.snow_load(0.75, vault), name="snow drifted", per="plan")
    model = model_of_scene(scene, Units("m", "kN"))
    basis = model.basis
    names = ("snow", "drift", "suction", "up", "storm", "snow drifted")
    assert set(basis) == {f"Load {name}" for name in names}
    assert basis["Load snow"].startswith("s_k = 0.75, C_e = 1.2, C_t = 1, mu: Snow on a monopitch")
    assert basis["Load snow"].endswith("5.3.2, and on any surface by its own slope")
    assert basis["Load drift"] == "Snow behind the parapet."
    assert basis["Load suction"] == "q_p = 0.6500 kN/m\u00b2, c_p = -0.8"
    assert basis["Load up"].startswith("q_p = 0.6500 kN/m\u00b2, Net wind on a canopy, EN 1991-1-4")
    assert "(A)" in basis["Load up"] and basis["Load up"].endswith("d = 4, b = 4, f/d = 0")
    # (4.8) by hand: v_m = 0.19 ln(200) 25, I_v = 1 / ln(200)
    mean, turbulence = 0.19 * np.log(200.0) * 25.0, 1.0 / np.log(200.0)
    assert q_p == pytest.approx((1 + 7 * turbulence) * 1.25 * mean**2 / 2000)
    assert basis["Load storm"] == (
        f"q_p = {q_p:.4f} kN/m\u00b2, EN 1991-1-4, 4.5: v_b = 25 m/s, z = 10 m, terrain category "
        "II, c_o = 1, rho = 1.25 kg/m\u00b3"
    )
    # mu_3 = 0.2 + 10 / 4 is cut off at 2; 2 R sin 60 = 2 x 2.5 x 0.866 is more than the span
    assert basis["Load snow drifted"].endswith("case = ii, mu_3 = 2, h/b = 0.25, l_s = 4")
    ranges = {row[0]: row[3] for row in model.tables["loads"].rows}
    assert ranges["drift"] == "0.3000" and ranges["suction"] == "\u22120.8000"
    low, high = map(float, ranges["storm"].split(" to "))
    assert 0.0 < low < 0.3 and 0.5 < high < 0.8  # of centres, averaged around vertices


def test_meshes_with_lines_that_have_slid_are_told_once() -> None:
    """Sides of cells are those of the first base state; what else differs has its combinations."""
    scene = sheet(COMM, 4, side=4.0)
    first = model_of_scene(scene, Units("m", "kN"))
    middle = np.linalg.norm(scene.mesh.mesh.geometry.x - (2.0, 2.0, 0.0), axis=1).argmin()
    scene.mesh.mesh.geometry.x[middle, 0] += 0.01
    scene.seal(volume=1000.0)
    slid = model_of_scene(scene, Units("m", "kN"))
    alone, later, both = (
        dict(model.tables["mesh"].rows)
        for model in (first, slid, merged({"calm": first, "gust": slid}))
    )
    sides = "Sides of cells [m]: least, mean, largest"
    assert later[sides] != alone[sides] == both[sides]
    assert str(both["Air"]).startswith("gust: sealed")
