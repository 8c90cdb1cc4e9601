"""Membrane materials: energy densities, stresses and tangents.

All are functions of the Green-Lagrange strain in two in-plane material axes, as UFL expressions of
its components. Section forces and moduli are per length (modulus times thickness), energies per
area of the stress-free surface.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Finite, Positive, checked
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.temperature import check_expansion
from crms_fenicsx.model.tolerances import UNSTRAINED

Direction = tuple[float, float, float] | Callable[[Array], Array]

LINEAR, TENSION_FIELD, ORTHOTROPIC_TENSION_FIELD, UFL_LAW = 0, 1, 2, 3
"""Codes of the stress laws; kernels of all but the last: `energy.terms.compiled_laws`."""

N_PARAMETERS = 18
"""Length of `MembraneMaterial.parameters`."""


def check_warp(owner: str, warp: object) -> None:
    """Refuse a zero warp direction."""
    if not callable(warp) and not np.any(checks.vector(f"{owner}: warp", warp)):
        raise InputError(f"{owner}: warp = {warp} must be a nonzero direction.")


class MembraneMaterial(ABC):
    """A membrane material. Its axes 1 (warp) and 2 (weft) lie in the surface."""

    prestress: float | tuple[float, float]
    # coefficients of thermal expansion (per kelvin); None: unknown
    expansion: float | tuple[float, float] | None = None
    dT: float = 0.0  # temperature change of the present state, set by load steps (kelvin)

    @property
    @abstractmethod
    def stiffness(self) -> Array:
        """Membrane stiffness ``D t`` in Voigt order (11, 22, 12), (3, 3), force per length."""

    @property
    @abstractmethod
    def law(self) -> int:
        """Code of the stress law."""

    @property
    @abstractmethod
    def reference_modulus(self) -> float:
        """Modulus times thickness, E t, that scales the penalty (force per length)."""

    @property
    @abstractmethod
    def law_parameters(self) -> tuple[float, float, float]:
        """Parameters of the wrinkling law: isotropic E t, nu, 0; orthotropic E1 t, rho, kappa."""

    @property
    def warp(self) -> Direction | None:
        """Direction of material axis 1; None if irrelevant."""
        return None

    @property
    def prestress_vector(self) -> Array:
        """Section forces (S11, S22, S12) at zero strain, (3,), force per length: the prestress,
        less what a restrained change of temperature takes away."""
        s = np.broadcast_to(np.asarray(self.prestress, dtype=float), (2,))
        given = np.array([s[0], s[1], 0.0])
        return given if self.dT == 0.0 else given - self.stiffness @ self.thermal_strain

    @property
    def thermal_strain(self) -> Array:
        """Green-Lagrange strain (E11, E22, 2 E12) of the free material, (3,): its lengths grow by
        the factor ``1 + expansion dT``."""
        by = np.broadcast_to(0.0 if self.expansion is None else self.expansion, (2,)) * self.dT
        return np.array([*(by + by**2 / 2), 0.0])

    @property
    def parameters(self) -> Array:
        """D t by rows, strain and forces of the prestress, `law_parameters`, (N_PARAMETERS,)."""
        elastic = np.linalg.solve(self.stiffness, self.prestress_vector)
        return np.concatenate(
            [self.stiffness.ravel(), elastic, self.prestress_vector, self.law_parameters]
        )

    def _check_prestress(self) -> None:
        owner = type(self).__name__
        try:
            values = np.atleast_1d(np.asarray(self.prestress, dtype=float))
        except (TypeError, ValueError, OverflowError):
            values = np.full(1, np.nan)
        if values.shape not in [(1,), (2,)] or not np.all(np.isfinite(values)):
            raise InputError(
                f"{owner}: prestress = {self.prestress!r} must be one number or two (warp, weft), "
                "in force per length."
            )
        if self.law != LINEAR and np.any(values < 0):
            raise InputError(
                f"{owner}: prestress = {self.prestress} is compressive, which a wrinkling membrane "
                "cannot carry; use tension, or wrinkling=False."
            )


@checked
@dataclass(frozen=True)
class IsotropicMembrane(MembraneMaterial):
    """Isotropic membrane, equation (2.3-12), St. Venant-Kirchhoff in Green-Lagrange strain.

    Parameters
    ----------
    E
        Young's modulus (force per area).
    nu
        Poisson's ratio, -1 < nu < 1 (plane stress; materials have 0 ... 0.5).
    thickness
        Thickness (length).
    prestress
        Section force at zero strain (force per length), equal in all directions or (11, 22).
    wrinkling
        True: tension-field theory: the relaxed energy, without compression, for wrinkles finer than
        the mesh. False: the membrane resists compression, and compressed regions have no unique
        equilibrium.
    expansion
        Coefficient of thermal expansion alpha (per kelvin), needed by temperature loads
        (`Scene.put_temperature`); None: unknown.
    dT
        Temperature change of the present state (kelvin), set by load steps.

    Examples
    --------
    >>> fabric = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)
    >>> fabric.stiffness.round()
    array([[879., 264.,   0.],
           [264., 879.,   0.],
           [  0.,   0., 308.]])
    """

    E: Positive
    nu: Finite
    thickness: Positive
    prestress: float | tuple[float, float] = 0.0
    wrinkling: bool = True
    expansion: float | None = None
    dT: float = field(default=0.0, repr=False)

    def __post_init__(self) -> None:
        owner = type(self).__name__
        if not -1.0 < self.nu < 1.0:
            raise InputError(f"{owner}: nu = {self.nu} lies outside -1 < nu < 1 (plane stress).")
        self._check_prestress()
        check_expansion(owner, self.expansion)
        s = np.broadcast_to(self.prestress, (2,))
        if s[0] != s[1]:
            raise InputError(
                f"{owner}: prestress = {self.prestress} has a direction, but an isotropic material "
                "has none; use OrthotropicMembrane with E1 = E2 and a warp direction."
            )

    @property
    def stiffness(self) -> Array:
        nu = self.nu
        factor = self.E * self.thickness / (1 - nu**2)
        return factor * np.array([[1, nu, 0], [nu, 1, 0], [0, 0, (1 - nu) / 2]])

    @property
    def law(self) -> int:
        return TENSION_FIELD if self.wrinkling else LINEAR

    @property
    def law_parameters(self) -> tuple[float, float, float]:
        D = self.stiffness
        nu = float(D[0, 1] / D[1, 1])
        return float(D[0, 0] * (1 - nu**2)), nu, 0.0

    @property
    def reference_modulus(self) -> float:
        return self.E * self.thickness


@checked
@dataclass(frozen=True)
class OrthotropicMembrane(MembraneMaterial):
    """Orthotropic membrane, equation (2.3-13), St. Venant-Kirchhoff in Green-Lagrange strain.

    Parameters
    ----------
    E1, E2
        Young's moduli along warp and weft (force per area).
    G12
        Shear modulus (force per area).
    nu21
        Poisson's ratio for stress along weft: the strain along warp is -nu21 times the strain along
        weft. The stiffness is positive definite for ``nu21**2 < E2 / E1``.
    thickness
        Thickness (length).
    warp
        Direction of the warp in space, (3,), or a function of points (3, n) that returns directions
        (3, n); it is projected on the surface.
    prestress
        Section force at zero strain (force per length): one value or (warp, weft).
    wrinkling
        True: tension-field theory: the relaxed energy, without compression, for wrinkles finer than
        the mesh. False: the membrane resists compression, and compressed regions have no unique
        equilibrium.
    expansion
        Coefficients of thermal expansion alpha (per kelvin), one or (warp, weft), needed by
        temperature loads (`Scene.put_temperature`); None: unknown.
    dT
        Temperature change of the present state (kelvin), set by load steps.

    Examples
    --------
    >>> fabric = OrthotropicMembrane(900.0, 700.0, G12=30.0, nu21=0.15, thickness=1.0)
    >>> fabric.stiffness.round()
    array([[927., 139.,   0.],
           [139., 721.,   0.],
           [  0.,   0.,  30.]])
    """

    E1: Positive
    E2: Positive
    G12: Positive
    nu21: Finite
    thickness: Positive
    warp: Direction = (1.0, 0.0, 0.0)
    prestress: float | tuple[float, float] = 0.0
    wrinkling: bool = True
    expansion: float | tuple[float, float] | None = None
    dT: float = field(default=0.0, repr=False)

    def __post_init__(self) -> None:
        owner = type(self).__name__
        if self.nu21**2 * self.E1 / self.E2 >= 1:
            raise InputError(
                f"{owner}: nu21 = {self.nu21} with E1/E2 = {self.E1 / self.E2:g} makes the "
                "stiffness indefinite; nu21**2 must be smaller than E2/E1 (is it nu12?)."
            )
        check_warp(owner, self.warp)
        check_expansion(owner, self.expansion, pair=True)
        self._check_prestress()

    @property
    def stiffness(self) -> Array:
        n, m = self.E1 / self.E2, self.G12 / self.E2
        q = 1 - n * self.nu21**2
        factor = self.E2 * self.thickness / q
        return factor * np.array([[n, n * self.nu21, 0], [n * self.nu21, 1, 0], [0, 0, m * q]])

    @property
    def law(self) -> int:
        return ORTHOTROPIC_TENSION_FIELD if self.wrinkling else LINEAR

    @property
    def law_parameters(self) -> tuple[float, float, float]:
        # rho = (c11 / c22)^(1/4), kappa = (2 c12 + c66) / (2 (c11 c22)^(1/2)) with compliances c
        kappa = np.sqrt(self.E1 * self.E2) * (0.5 / self.G12 - self.nu21 / self.E2)
        return self.E1 * self.thickness, float((self.E2 / self.E1) ** 0.25), float(kappa)

    @property
    def reference_modulus(self) -> float:
        return float(np.sqrt(self.E1 * self.E2)) * self.thickness


@dataclass(frozen=True)
class LawTerms:
    """UFL expressions of a stress law at a strain E; tensors in the material axes."""

    energy: Any  # energy per area of the stress-free surface, zero at zero strain
    stress: Any  # second Piola-Kirchhoff section forces S, (2, 2)
    state: Any  # 2 taut, 1 wrinkled, 0 slack
    # bilinear forms of two strain increments: consistent tangent, tangent of the taut membrane
    tangent: Callable[[Any, Any], Any]
    taut_tangent: Callable[[Any, Any], Any]


def voigt(E: Any) -> Any:
    """Voigt vector (E11, E22, 2 E12) of a symmetric UFL strain tensor (2, 2)."""
    return ufl.as_vector([E[0, 0], E[1, 1], 2 * E[0, 1]])


def symmetric(s: Any) -> Any:
    """UFL tensor (2, 2) of section forces (S11, S22, S12)."""
    return ufl.as_matrix([[s[0], s[2]], [s[2], s[1]]])


def taut_stiffness(p: Any) -> tuple[Any, Callable[[Any, Any], Any]]:
    """Stiffness (3, 3) of the taut membrane from the parameters p, and its bilinear form."""
    D = ufl.as_matrix([[p[3 * i + j] for j in range(3)] for i in range(3)])
    return D, lambda a, b: ufl.dot(voigt(a), D * voigt(b))


def law_terms(law: int, E: Any, p: Any) -> LawTerms:
    """UFL expressions of a stress law at a strain E (2, 2), with the material's parameters p."""
    # Relaxed energy of the isotropic tension field with principal strains E1 >= E2 (A. C. Pipkin,
    # IMA J. Appl. Math. 36, 1986): the taut energy for E2 + nu E1 >= 0, otherwise E t/2 E1^2 if
    # E1 > 0 (wrinkled) or zero (slack). Unselected branches may divide by zero; the conditionals
    # drop them.
    if law not in (LINEAR, TENSION_FIELD):
        raise ValueError(
            f"law_terms: law {law} has no UFL expressions, only {LINEAR}, {TENSION_FIELD}"
        )
    D, taut_tangent = taut_stiffness(p)
    elastic = ufl.as_vector([p[9], p[10], p[11]])
    prestress = ufl.as_vector([p[12], p[13], p[14]])
    Et, nu = p[15], p[16]

    # The constant prestress energy S^2 / E t is left out: small changes would be lost in it.
    s = prestress + D * voigt(E)
    taut_energy = ufl.dot(prestress + s, voigt(E)) / 2
    if law == LINEAR:
        return LawTerms(taut_energy, symmetric(s), ufl.as_ufl(2.0), taut_tangent, taut_tangent)

    e = voigt(E) + elastic
    mean, half, shear = (e[0] + e[1]) / 2, (e[0] - e[1]) / 2, e[2] / 2
    radius = ufl.sqrt(half**2 + shear**2)
    larger, smaller = mean + radius, mean - radius
    deviator = ufl.as_matrix([[half, shear], [shear, -half]])
    along = (ufl.Identity(2) + deviator / radius) / 2
    across = ufl.as_matrix([[-shear, half], [half, shear]]) / (2 * radius)
    taut = ufl.ge(smaller + nu * larger, 0)
    wrinkled = ufl.gt(larger, 0)

    def select(if_taut: Any, if_wrinkled: Any, if_slack: Any) -> Any:
        return ufl.conditional(taut, if_taut, ufl.conditional(wrinkled, if_wrinkled, if_slack))

    rest = ufl.dot(elastic, prestress) / 2
    energy = select(taut_energy, Et * larger**2 / 2 - rest, -rest)
    stress_taut, stress_wrinkled = symmetric(s), Et * larger * along
    stress = ufl.as_matrix(
        [[select(stress_taut[i, j], stress_wrinkled[i, j], 0.0) for j in (0, 1)] for i in (0, 1)]
    )

    def tangent(a: Any, b: Any) -> Any:
        stretch = ufl.inner(along, a) * ufl.inner(along, b)
        turn = larger / radius * ufl.inner(across, a) * ufl.inner(across, b)
        wrinkling = ufl.conditional(wrinkled, Et * (stretch + turn), 0.0)
        nearly_taut = ufl.ge(smaller + nu * larger, -UNSTRAINED)
        return ufl.conditional(nearly_taut, taut_tangent(a, b), wrinkling)

    return LawTerms(energy, stress, select(2.0, 1.0, 0.0), tangent, taut_tangent)
