"""What the step-wise laws know of the load steps before."""

from __future__ import annotations

from dataclasses import dataclass

from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class StepHistory:
    """What the step-wise laws know of the load steps before, this rank's part."""

    # (n, 6) or None section forces and shapes of this rank's cells, as
    # `StepMembraneEnergy.history`; None where the strain has the total law
    cells: Array | None = None
    # energy, folded_energy: strain energy so far of plain and folded cells (force x length)
    energy: float = 0.0
    folded_energy: float = 0.0
    # volume, folded_volume: volume gained so far under plain and folded cells (length cubed)
    volume: float = 0.0
    folded_volume: float = 0.0
