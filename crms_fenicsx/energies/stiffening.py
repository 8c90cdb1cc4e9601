"""The stiffness of membrane cells for H0."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from dolfinx import fem
from petsc4py import PETSc

FLOOR, FLOOR_FROM_FLAT = 1e-5, 1e-2
"""Part of the taut stiffness that wrinkled and slack cells have in H0 on top of their tangent, so
that it stays definite; and while a sheet gets its first stresses, when cells turn from taut to
wrinkled and back. A hundredth later on would make the iterations grow with the mesh: 6 in a load
step of the inflated square with 32 cells a side and 19 with 128, where it takes 9 now."""


class Stiffening:
    """What plain and folded cells have in H0 that they have not in the energy.

    Attributes: `prestress`: isotropic section force (force per length): without it a flat sheet has
    no stiffness against pressure; `floor`: part of the taut stiffness added to the tangent of laws
    that wrinkle; `compression`: part of compressive section forces in the geometric stiffness: 0,
    as it is indefinite with them, or 1 in the second derivatives.
    """

    def __init__(self, mesh: Any) -> None:
        self.prestress = fem.Constant(mesh, PETSc.ScalarType(0.0))
        self.floor = fem.Constant(mesh, PETSc.ScalarType(FLOOR))
        self.compression = fem.Constant(mesh, PETSc.ScalarType(0.0))

    @contextmanager
    def none(self) -> Iterator[None]:
        """Leave the second derivatives of the energy, as long as this lasts."""
        parts = self.prestress, self.floor, self.compression
        kept = [float(part.value) for part in parts]
        for part, value in zip(parts, (0.0, 0.0, 1.0), strict=True):
            part.value = value
        try:
            yield
        finally:
            for part, value in zip(parts, kept, strict=True):
                part.value = value

    def set(self, prestress: float, failures: int = 0, least: float = 0.0) -> None:
        """Take this prestress, and the floor that goes with it, `least` or more.

        After a line search that has failed, as slack cells let a step go too far, the floor is
        higher, and ten times as high after each further one.
        """
        self.prestress.value = prestress
        raised = failures + (prestress > 0.0)
        floor = FLOOR_FROM_FLAT * 10.0 ** (raised - 1) if raised else FLOOR
        self.floor.value = min(max(floor, least), 1.0)
