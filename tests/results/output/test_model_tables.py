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
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    UflMembrane,
    codes,
)
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.results.output.report.model_tables import model_of_scene
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
    (row,) = model_of_scene(scene_of(material), Units("m", "kN"), {}).tables["materials"].rows
    assert "kN/m²" not in str(row[3])
    assert row[3] == text or (text is None and "psi = function" in str(row[3]))


def test_warp_of_cells_with_shapes_of_their_own() -> None:
    """No direction of the material, which is not computed with."""
    frames = np.tile([[(0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)]], (8, 1, 1))
    fabric = OrthotropicMembrane(900.0, 600.0, thickness=1.0, **WOVEN)
    (row,) = model_of_scene(scene_of(fabric, frames=frames), Units(), {}).tables["materials"].rows
    assert "warp = as the pieces are cut" in str(row[3])


def test_strengths_are_told() -> None:
    """Utilisations can be followed: of cables, guys, and masts with their curve."""
    scene = scene_of(IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0))
    scene.lay_cable(Cable(EA=2e3), [(0.0, 1.7), (4.0, 2.2)], name="A1")
    rough = Cable(EA=2e3, friction=Friction(0.1, along=0.2))
    scene.lay_cable(rough, [(1.7, 0.0), (2.2, 4.0)], name="A2")
    scene.lay_cable(Cable(EA=2e3, friction=0.3), [(2.9, 0.0), (2.8, 4.0)], name="A3")
    mast = Bar(EA=846e3, EI=2724.0, strength=947.0, curve="a")
    scene.add_bar(mast, (9.0, 0.0, 0.0), (9.0, 0.0, 4.0), name="mast")
    scene.add_bar(Bar(EA=9.0, tension_only=True), (8.0, 0.0, 0.0), (9.0, 0.0, 4.0), name="guy")
    tables = model_of_scene(scene, Units("m", "kN"), {"A1": 117.7}).tables
    cables, bars = (
        [dict(zip(tables[name].columns, row, strict=True)) for row in tables[name].rows]
        for name in ("cables", "bars")
    )
    assert [one["Strength [kN]"] for one in cables] == [117.7, None, None]
    assert [str(one["Friction"])[:8] for one in cables] == ["none", "mu = 0.1", "mu = 0.3"]
    names = ("EI [kN m²]", "Strength [kN]", "Buckling curve or factor")
    assert [[one[name] for name in names] for one in bars] == [[2724.0, 947.0, "a"], [None] * 3]
    assert [one["Unstressed length [m]"] for one in bars] == [bar.L0 for bar in scene.bars]


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
    basis = model_of_scene(scene, Units("m", "kN"), {}).basis
    assert set(basis) == {"Load snow", "Load drift", "Load suction", "Load up"}
    assert basis["Load snow"].startswith("s_k = 0.75, C_e = 1.2, C_t = 1, mu: Snow on a monopitch")
    assert basis["Load drift"] == "Snow behind the parapet."
    assert basis["Load suction"] == "q_p = 0.6500 kN/m\u00b2, c_p = -0.8"
    assert basis["Load up"].startswith(
        "q_p = 0.6500 kN/m\u00b2, Net wind on a canopy, from canopy."
    )
    assert "zones = {'A': " in basis["Load up"] and "Footprint" not in basis["Load up"]
