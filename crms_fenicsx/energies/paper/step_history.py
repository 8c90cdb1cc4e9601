"""What the step-wise laws know of the load steps before."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class StepHistory:
    """What the step-wise laws know of the load steps before, this rank's part.

    Attributes
    ----------
    cells : (n, 6) or None
        Section forces and shapes of this rank's cells, as `StepMembraneEnergy.history`; None where
        the strain has the total law.
    energy, folded_energy
        Strain energy so far of plain and folded cells (force x length).
    volume, folded_volume
        Volume gained so far under plain and folded cells (length cubed).
    """

    cells: Array | None = None
    energy: float = 0.0
    folded_energy: float = 0.0
    volume: float = 0.0
    folded_volume: float = 0.0
