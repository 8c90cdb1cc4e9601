"""Taylor tests of gradients and stiffnesses.

The remainder of the energy's first-order expansion is quadratic in the step if the gradient is
right, else linear; with the right stiffness in the second-order expansion it is cubic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.block_patterns import BlockPattern, StiffnessMatrix
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes.triangles import area_vectors
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.foundation.runtime.errors import InputError

STEPS = tuple(0.01 * 0.25 ** np.arange(6))
"""Step lengths relative to the direction: small enough to reveal an error of 1e-3 in a gradient."""
CUBIC_STEPS = tuple(0.1 * 0.5 ** np.arange(5))
"""Step lengths for third-order remainders, which soon drown in rounding."""
SHAKEN = 0.1
"""Amplitude of the displacements at which terms are tested, relative to the cell size."""
SLACK = 0.2
"""Allowed deficit of a fitted order."""

SYMMETRIC = 1e-9
"""Largest relative asymmetry of a stiffness."""


class Differentiable(Protocol):
    """Energy of points (n, 3), with gradient and stiffness."""

    def value(self, x: Array) -> tuple[float, Array]:
        """Energy and gradient (n, 3)."""

    def times(self, x: Array, d: Array) -> Array:
        """Stiffness times a direction, (n, 3)."""

    def dot(self, a: Array, b: Array) -> float:
        """Scalar product over all ranks."""


class TermsOnLayout:
    """Terms of a distributed layout as a function of the owned points' displacements, (n, 3)."""

    def __init__(
        self,
        unknowns: Unknowns,
        u: fem.Function,
        terms: Sequence[EnergyTerm],
        exact: bool = False,
    ) -> None:
        self.potential = Potential(unknowns, u, terms)
        self.unknowns, self.exact = unknowns, exact

    def value(self, x: Array) -> tuple[float, Array]:
        """Energy (force x length) and gradient (force). Collective."""
        n = self.unknowns.n_owned
        self.potential.x[:n] = x
        self.potential.place()
        energy = self.potential.evaluate()
        return energy, self.potential.g[:n].copy()

    def assembled(self, x: Array) -> PETSc.Mat:
        """Distributed stiffness without dyads, to be destroyed by the caller. Collective."""
        self.value(x)
        stiffness = StiffnessMatrix(self.unknowns, self.potential.patterns())
        self.potential.add_stiffness(stiffness, self.exact)
        stiffness.assemble()
        return stiffness.petsc

    def times(self, x: Array, d: Array) -> Array:
        """Stiffness without dyads times a direction. Collective."""
        A = self.assembled(x)
        vector, result = A.createVecRight(), A.createVecLeft()
        vector.setArray(d.ravel())
        A.mult(vector, result)
        product: Array = result.getArray().reshape(-1, 3).copy()
        for thing in (A, vector, result):
            thing.destroy()
        return product

    def asymmetry(self, x: Array, d: Array, other: Array) -> float:
        """``other K d - d K other`` by all blocks that terms add; a matrix takes those on and above
        its diagonal only. Collective."""
        self.value(x)
        sink = _Asymmetry()
        for values in (d, other):
            vector, local = self.unknowns.vector()
            local[: len(values)] = values
            self.unknowns.update_ghosts(vector)
            vector.destroy()
            sink.directions.append(local)
        self.potential.add_stiffness(sink, self.exact)
        return float(self.unknowns.comm.allreduce(sink.value))

    def dot(self, a: Array, b: Array) -> float:
        """Scalar product over all ranks."""
        return float(self.unknowns.comm.allreduce(float(np.vdot(a, b))))


class _Asymmetry:
    """Sums up the asymmetry of blocks between two directions, (n_local, 3)."""

    def __init__(self) -> None:
        self.directions: list[Array] = []
        self.value = 0.0

    def take(self, pattern: BlockPattern) -> None:
        (d, other), blocks, both = self.directions, pattern.blocks(), "ni,nij,nj"
        self.value += float(np.einsum(both, other[pattern.rows], blocks, d[pattern.cols]))
        self.value -= float(np.einsum(both, d[pattern.rows], blocks, other[pattern.cols]))


class TermsWithDyads(TermsOnLayout):
    """Terms with their dyads in the stiffness."""

    def times(self, x: Array, d: Array) -> Array:
        product, n = super().times(x, d), self.unknowns.n_owned
        for term, k, value in list(self.potential.dyads(self.exact)):
            self.potential.dyad_column(term, k)
            column = self.potential.g[:n].copy()
            product += value * self.dot(column, d) * column
        return product


def fitted_order(steps: Sequence[float], remainders: Sequence[float]) -> float:
    """Order of the remainders: their exponent in the step."""
    return float(np.polyfit(np.log(steps), np.log(remainders), 1)[0])


def _order(
    f: Differentiable, x: Array, d: Array, curvature: float, steps: Sequence[float]
) -> float:
    """Order of the expansion's remainder; infinite if it is pure rounding."""
    energy, g = f.value(x)
    slope, seen = f.dot(g, d), []
    for h in steps:
        value = f.value(x + h * d)[0]
        remainder = abs(value - energy - h * slope - h**2 / 2 * curvature)
        # less is rounding of the energies and works subtracted
        if remainder > 1e3 * EPSILON * max(abs(value), abs(energy), abs(h * slope)):
            seen.append((h, remainder))
    return fitted_order(*zip(*seen, strict=True)) if len(seen) > 2 else math.inf


def gradient_order(f: Differentiable, x: Array, d: Array, steps: Sequence[float] = STEPS) -> float:
    """Order of the remainder: 2 or more if the gradient at x is right along d, else 1."""
    return _order(f, x, d, 0.0, steps)


def stiffness_order(
    f: Differentiable, x: Array, d: Array, steps: Sequence[float] = CUBIC_STEPS
) -> float:
    """Order of the remainder: 3 or more if gradient and stiffness at x are right along d; 2 if only
    the gradient is."""
    return _order(f, x, d, f.dot(d, f.times(x, d)), steps)


def noise(X: Array, seed: int) -> Array:
    """Random vectors (n, 3) of size about 1 that depend on position only, not on numbering. Waves
    shorter than the distances in a mesh of about 20 look random on its vertices."""
    rng = np.random.default_rng(seed)
    waves, phases = rng.uniform(-1, 1, (8, 3)), rng.uniform(0, 2 * np.pi, (8, 3))
    shake: Array = np.sin((X @ waves.T)[:, :, None] + phases).sum(axis=1) / 2
    return shake


@dataclass(frozen=True)
class TaylorRates:
    """Orders of the remainders in the step; infinite for pure rounding, as of quadratic energies.

    Attributes
    ----------
    gradient
        Order of the first-order expansion's remainder; 2 is expected.
    stiffness
        Order of the second-order expansion's remainder; 3 is expected. None without stiffness, or
        with one that is not meant to be exact.
    """

    gradient: float
    stiffness: float | None


def taylor_test(
    term: EnergyTerm,
    u: fem.Function,
    *,
    stiffness: Literal["exact", "semidefinite"] = "exact",
    seed: int = 0,
) -> TaylorRates:
    """Check a term's gradient and stiffness by Taylor expansions of its energy. Collective.

    The test state is `u` plus random displacements of a tenth of a cell, the directions are random;
    both are the same on any number of processes. The energy must be smooth there.

    Parameters
    ----------
    term
        A term of mesh vertices. One that belongs to a scene is left unchanged.
    u
        Vertex displacements such as ``scene.u``; restored afterwards.
    stiffness
        "exact": the stiffness (with its dyads), if any, is the energy's second derivative.
        "semidefinite": it is a bound or an approximation, and only has to be symmetric and
        positive semidefinite.
    seed
        Seed of the random displacements.

    Returns
    -------
    TaylorRates
        The orders found.

    Raises
    ------
    InputError
        On all ranks, if the gradient is not that of the energy, or the stiffness lacks the
        required property.

    Examples
    --------
    >>> taylor_test(Springs(0.1), scene.u)
    TaylorRates(gradient=2.0, stiffness=None)
    """
    V, layout, kept = u.function_space, getattr(term, "unknowns", None), u.x.array.copy()
    f = TermsWithDyads(Unknowns(V), u, [term])
    n = f.unknowns.n_owned
    cells = V.mesh.topology.index_map(2)
    area = float(np.linalg.norm(area_vectors(V.mesh)[: cells.size_local], axis=1).sum())
    size = math.sqrt(V.mesh.comm.allreduce(area) / cells.size_global)
    places = np.asarray(f.unknowns.X[:n] / size, dtype=float)
    x, d, other = (SHAKEN * size * noise(places, 3 * seed + k) for k in range(3))
    try:
        return _rates(f, term.name, f.potential.x[:n] + x, d, other, stiffness == "exact")
    finally:
        f.potential.destroy()
        u.x.array[:] = kept
        if layout is not None:
            term.attach(layout)


def _rates(
    f: TermsOnLayout, name: str, x: Array, d: Array, other: Array, exact: bool
) -> TaylorRates:
    """Rates of a term at x along d; `other` is a second direction."""
    order = gradient_order(f, x, d)
    if not order > 2 - SLACK:
        raise InputError(
            f"taylor_test: the gradient of {name!r} is not that of its energy: the remainder "
            f"shrinks with the power {order:.2f} of the step instead of 2."
        )
    product, twin = f.times(x, d), f.times(x, other)
    size = math.sqrt(f.dot(product, product) * f.dot(other, other))
    if size == 0.0:
        return TaylorRates(order, None)
    if abs(f.asymmetry(x, d, other)) > SYMMETRIC * size:
        raise InputError(f"taylor_test: the stiffness of {name!r} is not symmetric.")
    if not exact:
        if min(f.dot(d, product), f.dot(other, twin)) < -SYMMETRIC * size:
            raise InputError(f"taylor_test: the stiffness of {name!r} is not semidefinite.")
        return TaylorRates(order, None)
    cubic = stiffness_order(f, x, d)
    if not cubic > 3 - SLACK:
        raise InputError(
            f"taylor_test: the stiffness of {name!r} is not its energy's second derivative: the "
            f"remainder shrinks with the power {cubic:.2f} of the step instead of 3. If it "
            'is not meant to be, pass stiffness="semidefinite".'
        )
    return TaylorRates(order, cubic)
