"""Loads and design values by codes: snow and wind for `Scene.put_load` and `Scene.put_wind`, load
combinations, and strengths for `Scene.set_strengths`.

Recommended values of EN 1990, EN 1991-1-3 and EN 1991-1-4, and ASCE 7, each with its clause;
national annexes may differ.
"""

from crms_fenicsx.design.codes.combinations import (
    CombinationRules,
    asce7,
    asce7_16,
    asce7_22,
    combinations,
    en1990,
)
from crms_fenicsx.design.codes.snow import (
    CylindricalSnow,
    DriftedSnow,
    DuopitchSnow,
    MultispanSnow,
    PitchedSnow,
    snow_load,
    snow_on_pitch,
)
from crms_fenicsx.design.codes.steel import steel_bar
from crms_fenicsx.design.codes.wind import (
    ArchWind,
    CanopyWind,
    TableWind,
    asce7_arch_zones,
    canopy,
    dome,
    en1991_vault_zones,
    peak_pressure,
    vault,
    wind_table,
)
from crms_fenicsx.model.strengths import CableDesign, FabricDesign

__all__ = [
    "ArchWind", "CableDesign", "CanopyWind", "CombinationRules", "CylindricalSnow",
    "DriftedSnow", "DuopitchSnow", "FabricDesign", "MultispanSnow", "PitchedSnow", "TableWind",
    "asce7", "asce7_16", "asce7_22", "asce7_arch_zones", "canopy", "combinations", "dome",
    "en1990", "en1991_vault_zones", "peak_pressure", "snow_load", "snow_on_pitch", "steel_bar",
    "vault", "wind_table",
]  # fmt: skip
