"""Membrane materials with a user-defined energy density in UFL."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from crms_fenicsx.foundation.meshes.triangles import vectors
from crms_fenicsx.foundation.runtime.arrays import Array, floats
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.materials import (
    UFL_LAW,
    Direction,
    LawTerms,
    MembraneMaterial,
    check_warp,
    symmetric,
    taut_stiffness,
)

ENERGY_AT_REST = 1e-12
"""Largest energy at zero strain, relative to the stiffness."""
PROBED = 0.01
"""Size of the strains at which a density is compared with its tangent plane at zero strain."""
PROBES = PROBED * np.array([e for e in product((-1.0, 0.0, 1.0), repeat=3) if any(e)])
"""These strains (n, 3), (E11, E22, 2 E12)."""
BELOW = 1e-10
"""Tolerance below the tangent plane, relative to the stiffness times the squared strain."""

SMALL = 0.01
"""Strain up to which energy and section forces are integrated from zero strain."""
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(4)
"""Gauss points on (-1, 1) and their weights: the error is of order SMALL^8."""


@dataclass(frozen=True)
class UflMembrane(MembraneMaterial):
    """Membrane with a user-defined energy density in UFL.

    Forces and stiffness in H0 are its UFL derivatives. It is only for cells that no cable folds,
    since those need compiled laws. It wrinkles if its density does: a density without compression
    is zero under it.

    Parameters
    ----------
    psi
        Energy per area of the stress-free surface (force / length): a function of the UFL
        Green-Lagrange strain in two in-plane axes, (2, 2), that returns a UFL scalar made of the
        strain and of numbers. It must be zero at zero strain and convex, with a positive definite
        second derivative there. Its slope at zero strain is a prestress.
    warp
        Direction of the first in-plane axis in space, as for `OrthotropicMembrane`; None for an
        isotropic density.

    Raises
    ------
    InputError
        If it is not a function of the strain that returns a scalar, or is not convex.

    Examples
    --------
    An incompressible neo-Hookean sheet in plane stress with the shear modulus mu times thickness:

    >>> def psi(E):
    ...     C = ufl.Identity(2) + 2 * E
    ...     return mu / 2 * (ufl.tr(C) + 1 / ufl.det(C) - 3)
    >>> rubber = UflMembrane(psi)
    """

    psi: Callable[[Any], Any]
    warp: Direction | None = None

    def __post_init__(self) -> None:
        if not callable(self.psi):
            raise InputError(
                f"UflMembrane: psi = {self.psi!r} is not a function; pass one of the UFL strain"
                " (2, 2) that returns the energy per area."
            )
        if self.warp is not None:
            check_warp("UflMembrane", self.warp)
        energy, slope, D = self._at_rest
        if not np.all(np.isfinite([energy, *slope, *D.ravel()])):
            raise InputError(
                f"UflMembrane: psi or a derivative is not finite at zero strain: {energy:g}, "
                f"{slope}, {D.tolist()}."
            )
        least = float(np.linalg.eigvalsh(D).min())
        if not least > 0.0:
            raise InputError(
                "UflMembrane: psi is not convex: the eigenvalues of its second derivative at zero "
                f"strain are {np.linalg.eigvalsh(D)}, and must be positive."
            )
        if abs(energy) > ENERGY_AT_REST * D.max():
            raise InputError(
                f"UflMembrane: psi is {energy:g} at zero strain, and must be zero there; subtract "
                "it."
            )
        for strain, value in zip(list(PROBES), self.samples, strict=True):
            if value < slope @ strain - BELOW * D.max() * PROBED**2:
                raise InputError(
                    f"UflMembrane: psi is not convex: at the strain (E11, E22, 2 E12) = {strain} "
                    f"it is {value:g}, below its tangent at zero strain."
                )

    @cached_property
    def _at_rest(self) -> tuple[float, Array, Array]:
        """Energy, section forces (3,) and stiffness (3, 3) at zero strain, in Voigt order."""
        E = ufl.variable(ufl.as_matrix([[0.0, 0.0], [0.0, 0.0]]))
        energy = self._energy(E)
        slope = ufl.diff(energy, E)
        try:
            S, D = _values(slope, 2), _values(ufl.diff(slope, E), 4)
            value = float(energy)
        except Exception as error:
            raise _not_evaluated(error) from error
        return value, _by_voigt(S, 1), _by_voigt(D, 2)

    @cached_property
    def samples(self) -> tuple[float, ...]:
        """Values at sample strains (force / length), to tell densities apart."""
        values = []
        for x, y, shear in map(floats, vectors(PROBES)):
            E = ufl.as_matrix([[x, shear / 2], [shear / 2, y]])
            try:
                values.append(float(self._energy(E)))
            except (TypeError, ValueError, ArithmeticError) as error:
                raise _not_evaluated(error) from error
        return tuple(values)

    def _energy(self, E: Any) -> Any:
        """The density at a UFL strain, a UFL scalar."""
        try:
            energy = ufl.as_ufl(self.psi(E))
        except Exception as error:
            raise InputError(
                f"UflMembrane: psi fails on a UFL strain of shape (2, 2): {error!r}; write it with "
                "the functions of ufl, not with those of numpy or math."
            ) from error
        if energy.ufl_shape != () or energy.ufl_free_indices:
            raise InputError(
                f"UflMembrane: psi returns a tensor of shape {energy.ufl_shape}, and must return "
                "a scalar, the energy per area."
            )
        return energy

    @property
    def stiffness(self) -> Array:
        return self._at_rest[2]

    @property
    def prestress_vector(self) -> Array:
        return self._at_rest[1]

    @property
    def law(self) -> int:
        return UFL_LAW

    @property
    def law_parameters(self) -> tuple[float, float, float]:
        return self.reference_modulus, 0.0, 0.0

    @cached_property
    def reference_modulus(self) -> float:
        """Mean of the moduli along both axes at zero strain, times thickness (force / length)."""
        compliance = np.linalg.inv(self.stiffness)
        return float(1 / np.sqrt(compliance[0, 0] * compliance[1, 1]))

    def law_terms(self, E: Any, p: Any) -> LawTerms:
        """The law's UFL expressions; see `model.materials.law_terms`."""
        strain = ufl.variable(E)
        energy = self._energy(strain)
        slope = ufl.diff(energy, strain)
        curvature = ufl.diff(slope, strain)
        near = ufl.lt(ufl.inner(E, E), SMALL**2)
        own = self._integrated(E)
        energy = ufl.conditional(near, own[0], energy)
        at = product(range(2), repeat=2)
        S = [ufl.conditional(near, own[1][i, j], slope[i, j]) for i, j in at]

        def tangent(a: Any, b: Any) -> Any:
            return _twice(curvature, a, b)

        stress = ufl.sym(ufl.as_matrix([S[:2], S[2:]]))
        return LawTerms(energy, stress, ufl.as_ufl(2.0), tangent, taut_stiffness(p)[1])

    def _integrated(self, E: Any) -> tuple[Any, Any]:
        """Energy and its slope at a small UFL strain by integrals of the second derivatives from
        zero strain: in the density itself, as in tr C + 1/det C - 3, large terms cancel."""
        prestress = symmetric(self.prestress_vector)
        energy, slope = ufl.inner(prestress, E), prestress
        i, j, k, m = ufl.indices(4)
        for part, weight in zip((GAUSS + 1) / 2, WEIGHTS / 2, strict=True):
            strain = ufl.variable(float(part) * E)
            curvature = ufl.diff(ufl.diff(self._energy(strain), strain), strain)
            energy += float(weight * (1 - part)) * _twice(curvature, E, E)
            slope += float(weight) * ufl.as_tensor(curvature[i, j, k, m] * E[k, m], (i, j))
        return energy, slope


def _twice(curvature: Any, a: Any, b: Any) -> Any:
    """Second derivatives, a UFL tensor of rank 4, in two directions."""
    i, j, k, m = ufl.indices(4)
    return curvature[i, j, k, m] * a[i, j] * b[k, m]


def _values(tensor: Any, rank: int) -> Array:
    """Components of a UFL tensor that contains only numbers, (2,) * rank."""
    tensor = apply_derivatives(apply_algebra_lowering(tensor))
    shape = (2,) * rank
    return np.array([float(tensor[index]) for index in np.ndindex(shape)]).reshape(shape)


def _by_voigt(tensor: Array, pairs: int) -> Array:
    """A derivative by E in Voigt form, by (E11, E22, 2 E12)."""
    to_voigt = np.zeros((3, 2, 2))
    to_voigt[0, 0, 0] = to_voigt[1, 1, 1] = 1.0
    to_voigt[2, 0, 1] = to_voigt[2, 1, 0] = 0.5
    if pairs == 1:
        return np.asarray(np.einsum("aij,ij->a", to_voigt, tensor))
    return np.asarray(np.einsum("aij,ijkl,bkl->ab", to_voigt, tensor, to_voigt))


def _not_evaluated(error: Exception) -> InputError:
    return InputError(
        f"UflMembrane: psi or a derivative cannot be evaluated around zero strain ({error!r}); "
        "make it smooth there, of the strain and of numbers, without functions of a mesh."
    )
