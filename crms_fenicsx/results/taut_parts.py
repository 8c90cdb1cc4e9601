"""Parts of cables and guys that turn taut or slack, for derivatives of an equilibrium.

The energy of a part of a cable between clamps or bonds, k/2 max(L - L0, 0)^2 with k = EA/L0, has
no second derivative where L = L0. Elsewhere a part keeps its state, taut or slack, under a small
change of a parameter p. Parts at L = L0 become taut where the change stretches them. With the
tangent K of the other parts, the derivatives b of the forces by p, and the gradients G of the
lengths, a change in the direction s = 1 or -1 moves the unknowns by w and causes tensions t:

    w = s K^-1 b - K^-1 G t,    t = k max(y, 0),    y = G^T w - s dL0/dp.

So t minimises the convex 1/2 t^T (1/k + G^T K^-1 G) t - s q^T t over t >= 0, where
q = G^T K^-1 b - dL0/dp. Where other parts become taut for s = 1 than for -1, derivatives differ.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from crms_fenicsx.equilibrium.cable_contribution import current_lengths
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices

AT_THRESHOLD = 1e-9
"""Strain of a part, of either sign, up to which it is about to turn taut or slack: more than what
an equilibrium leaves open, and less than any change of length of practical size."""


class TautParts:
    """Keeps the parts of a system's cables taut or slack until `release`. Collective.

    Slack cables with parts at the threshold, such as belts laid without force, are added to the
    system, except those that slide sideways: without tension nothing would hold their points.

    Attributes: `open` (n,): parts at the threshold, numbered as in the term of the cables' tension;
    `owners`: their cables; `taut`: parts that count as taut, those in `open` only after `choose`.
    """

    def __init__(self, system: System) -> None:
        self.system, self._before = system, system.scene.state
        self._added = [
            cable
            for cable in system.scene.cables
            if not cable.taut and _is_sewn_at_threshold(cable)
        ]
        if self._added:
            for cable in self._added:
                cable.update(taut=True)
            system.rebuild()
            system.update()
            system.potential.bring_up_to_date()
            system.renew_smoothing_length()
        self.open: Indices = np.zeros(0, dtype=np.int32)
        self.owners: list[LaidCable] = []
        part = None if system.cables is None else system.cables.tension
        self._term = part
        if part is None or system.cables is None:
            return
        strains, owners = [], []
        for cable in system.cables.sliding:
            own = strains_of(cable)
            if len(own) == 1 and not cable.keeps_line:
                own = np.ones(1)  # in the system because it is taut
            strains.append(own)
            owners += [cable] * len(own)
        strain = np.concatenate(strains)
        self.open = np.flatnonzero(np.abs(strain) <= AT_THRESHOLD).astype(np.int32)
        self.owners = [owners[k] for k in self.open]
        self.taut: Booleans = strain > AT_THRESHOLD
        part.kept = self.taut

    def choose(self, taut: Booleans) -> None:
        """Set which of the parts in `open` count as taut."""
        if len(self.open):
            self.taut[self.open] = taut

    def unstressed_lengths(self) -> Array:
        """Unstressed lengths of the parts in `open` in the scene last read (length)."""
        return np.zeros(0) if self._term is None else self._term.L0[self.open].copy()

    def gradients(self) -> Array:
        """This rank's gradients of the lengths of the parts in `open`, (3 n_owned, n)."""
        potential, unknowns = self.system.potential, self.system.unknowns
        n = unknowns.n_owned
        columns = np.zeros((3 * n, len(self.open)))
        for column, k in zip(columns.T, self.open, strict=True):
            assert self._term is not None
            potential.g[:] = 0.0
            self._term.add_length_gradient(int(k), potential.x, potential.g)
            unknowns.gather_forces(potential.g_vector, potential.g)
            unknowns.project(potential.g)
            potential.g[:n][unknowns.held[:n]] = 0.0
            column[:] = potential.g[:n].ravel()
        return columns

    def stiffnesses(self) -> Array:
        """EA/L0 of the parts in `open` (force/length)."""
        assert self._term is not None
        return np.asarray((self._term.EA / self._term.L0)[self.open])

    def release(self) -> None:
        """Let lengths decide again, and restore the scene."""
        if self._term is not None:
            self._term.kept = None
        self.system.scene.state = self._before
        if self._added:
            self.system.invalidate()
        else:
            self.system.read_scene()


class Tightening:
    """Tensions that parts at the threshold get from small changes. Collective."""

    def __init__(self, parts: TautParts, solve: Callable[[Array], Array]) -> None:
        self._comm = parts.system.scene.comm
        self._columns = parts.gradients()
        self._moves = np.zeros_like(self._columns)
        for k, column in enumerate(self._columns.T):
            self._moves[:, k] = solve(column)
        flexible = self._comm.allreduce(self._columns.T @ self._moves, op=MPI.SUM)
        flexible = (flexible + flexible.T) / 2 + np.diag(1 / parts.stiffnesses())
        self._root = cholesky(flexible)  # of the parts' flexibility: R^T R

    def of(self, way: Array, shortened: Array, sign: float) -> tuple[Array, Booleans]:
        """Movement of the unknowns, and which parts turn taut, for a change in the direction
        `sign` that without these parts moves the unknowns by `way` and shortens the parts'
        unstressed lengths by `shortened`, both per unit."""
        q = self._comm.allreduce(self._columns.T @ way, op=MPI.SUM) + shortened
        right = solve_triangular(self._root, sign * q, trans="T")
        tensions, _ = self._comm.bcast(nnls(self._root, right) if self._comm.rank == 0 else None)
        return sign * way - self._moves @ tensions, tensions > 0.0


def strains_of(cable: LaidCable) -> Array:
    """Strains of a cable's parts between clamps and bonds, negative where slack."""
    return np.asarray(current_lengths(cable) / cable.part_lengths - 1)


def _is_sewn_at_threshold(cable: LaidCable) -> bool:
    """Whether a cable keeps its line and has parts at the threshold."""
    return cable.keeps_line and bool(np.any(np.abs(strains_of(cable)) <= AT_THRESHOLD))
