"""Pressure of sealed air, which falls with the volume, on plain cells, folded cells and rim.

Each term of a given pressure knows its part of the volume. Here these terms have unit pressure and
are combined in one term of the whole volume, as the pressure follows from the sum over all ranks.
The second derivatives are those of a given pressure plus the dyad ``Pi'' grad(V) grad(V)^T``, which
H0 treats like those of cables.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.energy.terms.folded_pressure import Facets, FoldedFollowerPressure
from crms_fenicsx.energy.terms.pressure import FollowerPressure
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, BlockSink
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans
from crms_fenicsx.model.sealed_air import SealedAir


class SealedPressure(EnergyTerm):
    """Potential of sealed air; see `SealedAir`.

    Attributes: `air`: the air; load steps change its temperature and the atmospheric pressure;
    `parts`: terms of parts of the volume.
    """

    name = "pressure"

    def __init__(
        self,
        air: SealedAir,
        plain: FollowerPressure,
        others: Sequence[EnergyTerm],
        unit: fem.Constant,
    ) -> None:
        self.air, self._unit = air, unit
        self.parts: list[EnergyTerm] = [plain, *others]
        self.integral, self._origin = plain.integral, plain.origin
        self._pressed = fem.Constant(plain.u.function_space.mesh, PETSc.ScalarType(0.0))

    @property
    def n_sums(self) -> int:  # type: ignore[override]
        """One volume for each part."""
        return len(self.parts)

    @property
    def exact_hessian(self) -> bool:  # type: ignore[override]
        return all(part.exact_hessian for part in self.parts)

    def attach(self, unknowns: Unknowns) -> None:
        super().attach(unknowns)
        for part in self.parts:
            part.attach(unknowns)
        self._forces: Array = np.zeros((unknowns.n_local, 3))

    def sums(self, x: Array, out: Array) -> None:
        """This rank's parts of the volumes gained (length cubed)."""
        for k, part in enumerate(self.parts):
            part.sums(x, out[k : k + 1])

    def pressure(self, sums: Array) -> float:
        """Gauge pressure (force per area)."""
        return self.air.pressure(float(sums.sum()))

    def energy(self, sums: Array) -> float:
        """Potential of the air and of the atmosphere (force x length)."""
        return self.air.energy(float(sums.sum()))

    def _add_forces(self, pressure: float, x: Array, sums: Array, g: Array) -> None:
        """Add the nodal forces of a pressure, with the sign of a gradient."""
        self._forces[:] = 0.0
        for k, part in enumerate(self.parts):
            part.add_gradient(x, sums[k : k + 1], self._forces)
        self._forces *= pressure
        g += self._forces

    def add_gradient(self, x: Array, sums: Array, g: Array) -> None:
        self._add_forces(self.pressure(sums), x, sums, g)

    @property
    def patterns(self) -> Sequence[BlockPattern]:  # type: ignore[override]
        return tuple(pattern for part in self.parts for pattern in part.patterns)

    def add_hessian(self, x: Array, sums: Array, A: BlockSink) -> None:
        """Add the second derivatives at the current pressure."""
        self._unit.value = self.pressure(sums)
        try:
            for k, part in enumerate(self.parts):
                part.add_hessian(x, sums[k : k + 1], A)
        finally:
            self._unit.value = 1.0

    def dyads(self, sums: Array, exact: bool) -> Sequence[float]:
        """Stiffness of the air (force / length^5)."""
        return (self.air.stiffness(float(sums.sum())),)

    def add_dyad_column(self, k: int, x: Array, g: Array) -> None:
        """Add the gradient of the volume."""
        self._add_forces(-1.0, x, np.zeros(len(self.parts)), g)

    def elements_on(self, chosen: Booleans) -> Facets | None:
        """Facets of plain and folded cells with chosen corners."""
        given: list[Any] = [part.elements_on(chosen) for part in self.parts]
        found = [table for table in given if table is not None]
        return Facets.concatenated(found) if found else None

    def of_elements(self, table: Facets, sums: Array) -> FoldedFollowerPressure:
        """The current pressure, held fixed, on such facets, as a few change the volume little."""
        self._pressed.value = self.pressure(sums)
        return FoldedFollowerPressure(table, self._pressed, self._origin.value)
