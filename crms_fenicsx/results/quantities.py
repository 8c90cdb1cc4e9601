"""What results know of the membrane's cells, by name: for fields, places, files and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class CellQuantity:
    """A number that each cell has."""

    label: str  # what it is, for people
    attribute: str  # attribute, column: where `MembraneResults` holds it; -1: it has one only
    column: int = -1
    unit: str = ""  # "stress" (force per length), or "" for a plain number

    def of(self, results: Any) -> Array:
        """Its values in some membrane results, (n,)."""
        values = np.asarray(getattr(results, self.attribute), dtype=np.float64)
        return values if self.column < 0 else values[:, self.column]


QUANTITIES = {
    "warp": CellQuantity("membrane force along warp", "warp_weft", 0, "stress"),
    "weft": CellQuantity("membrane force along weft", "warp_weft", 1, "stress"),
    "shear": CellQuantity("shear of warp and weft", "warp_weft", 2, "stress"),
    "true force 1": CellQuantity("larger principal membrane force", "true_forces", 0, "stress"),
    "true force 2": CellQuantity("smaller principal membrane force", "true_forces", 1, "stress"),
    "second Piola warp": CellQuantity(
        "second Piola-Kirchhoff force along warp", "second_piola_warp_weft", 0, "stress"
    ),
    "second Piola weft": CellQuantity(
        "second Piola-Kirchhoff force along weft", "second_piola_warp_weft", 1, "stress"
    ),
    "second Piola shear": CellQuantity(
        "second Piola-Kirchhoff shear", "second_piola_warp_weft", 2, "stress"
    ),
    "strain 1": CellQuantity("larger principal strain", "strains", 0),
    "strain 2": CellQuantity("smaller principal strain", "strains", 1),
    "state": CellQuantity("0 slack, 1 wrinkled, 2 taut", "state"),
    "utilisation": CellQuantity("utilisation", "utilised"),
}
"""All of them; "utilisation" needs the strengths of `Scene.set_strengths`."""

SHOWN = ("true force 1", "true force 2", "warp", "weft", "shear", "utilisation")
"""What ParaView files and pyvista get of them, beside directions and states."""


def fields_of(results: Any) -> dict[str, Array]:
    """What ParaView files and pyvista get of cells, by name, (n,) or (n, 3)."""
    found = {name: results.values(name) for name in SHOWN if name in results.names}
    return {**found, "direction 1": results.true_directions[:, 0], "state": results.state}
