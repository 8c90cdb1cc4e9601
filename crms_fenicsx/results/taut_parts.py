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
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.optimize import nnls

from crms_fenicsx.analysis.equilibrium.cable_contribution import current_lengths
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.terms.bar_energy import BarTable
from crms_fenicsx.energy.terms.cable_tension import CableTension
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.laid_cable import LaidCable

AT_THRESHOLD = 1e-9
"""Strain of a part, of either sign, up to which it is about to turn taut or slack: more than what
an equilibrium leaves open, and less than any change of length of practical size."""


class TautParts:
    """Keeps the parts of a system's cables, and guys, taut or slack until `release`. Collective.

    Slack cables with parts at the threshold, such as belts laid without force, are added to the
    system, except those that slide sideways: without tension nothing would hold their points.

    Attributes: `loose`: those, which stay slack; `owners`: cables and guys of the other parts at
    the threshold, which are taken as slack until `choose`; `settled`: names of those counted as
    taut by `settle`.
    """

    def __init__(self, system: System) -> None:
        self.system, scene, self._before = system, system.scene, system.scene.state
        slack = [
            cable for cable in scene.cables
            if not cable.taut and np.any(np.abs(_strains_of(cable)) <= AT_THRESHOLD)
        ]  # fmt: skip
        self._added = [cable for cable in slack if cable.keeps_line]
        self.loose = [cable for cable in slack if not cable.keeps_line]
        if self._added:
            self._add()
        self.owners: list[LaidCable | PlacedBar] = []
        self.settled: set[str] = set()
        # numbers of those at the threshold
        self._parts: Indices = np.zeros(0, dtype=np.int32)
        self._guys: Indices = np.zeros(0, dtype=np.int32)
        self._term = None if system.cables is None else system.cables.tension
        if self._term is not None:
            self._keep_parts(self._term)
        self._bars: BarTable | None = None
        if any(bar.bar.tension_only for bar in scene.bars):
            self._keep_guys()

    def _add(self) -> None:
        """Add the slack cables with parts at the threshold to the system."""
        system = self.system
        try:
            for cable in self._added:
                cable.update(taut=True)
            system.rebuild()
            system.update()
            system.potential.bring_up_to_date()
            system.renew_smoothing_length()
        except BaseException:
            system.scene.state = self._before
            system.invalidate()
            raise

    def _keep_parts(self, term: CableTension) -> None:
        """Keep the parts of the cables."""
        assert self.system.cables is not None
        found, owners = [], []
        for cable in self.system.cables.sliding:
            own = _strains_of(cable)
            if len(own) == 1 and not cable.keeps_line:
                own = np.ones(1)  # in the system because it is taut
            found.append(own)
            owners += [cable] * len(own)
        strains = np.concatenate(found)
        term.kept = strains > AT_THRESHOLD
        self._parts = np.flatnonzero(np.abs(strains) <= AT_THRESHOLD).astype(np.int32)
        self.owners += [owners[k] for k in self._parts]

    def _keep_guys(self) -> None:
        """Keep the guys: bars without compression."""
        assert self.system.bars is not None
        bars = self.system.scene.bars
        self._bars = table = self.system.bars.energy.table
        self._table_before = table.EA.copy(), table.tension_only.copy()
        strains = np.array([
            bar.length / bar.L0 - 1 if bar.bar.tension_only else 1.0 for bar in bars
        ])  # fmt: skip
        self._taut_bars = strains > AT_THRESHOLD
        self._guys = np.flatnonzero(np.abs(strains) <= AT_THRESHOLD).astype(np.int32)
        self.owners += [bars[k] for k in self._guys]
        self._set_guys()

    def _set_guys(self) -> None:
        """Copy to the potential which guys are taut."""
        if self._bars is not None and len(self._bars.EA):  # on the first rank
            shares = np.where(self._taut_bars, 1.0, 0.0)
            # without any, the tangent may be singular, as that of a mast that slack guys hold
            shares[self._guys] = np.maximum(shares[self._guys], 1e-7)
            self._bars.EA[:] = shares * self._table_before[0]
            self._bars.tension_only[:] = False

    def choose(self, taut: Booleans) -> None:
        """Set which of the parts at the threshold count as taut."""
        if self._term is not None and self._term.kept is not None:
            self._term.kept[self._parts] = taut[: len(self._parts)]
        if self._bars is not None:
            self._taut_bars[self._guys] = taut[len(self._parts) :]
            self._set_guys()

    def settle(self) -> None:
        """Count all parts at the threshold as taut from now on."""
        self.settled = {one.name for one in self.owners}
        self.choose(np.ones(len(self.owners), dtype=bool))
        self._parts = self._guys = self._parts[:0]
        self.owners = []

    def force(self, bar: PlacedBar) -> float:
        """Axial force of a bar, that of a guy as long as it keeps its state (force)."""
        force = bar.bar.EA * (bar.length - bar.L0) / bar.L0
        slack = self._bars is not None and not self._taut_bars[self.system.scene.bars.index(bar)]
        return 0.0 if slack else force

    def unstressed_lengths(self) -> Array:
        """Unstressed lengths of the parts at the threshold in the scene last read (length)."""
        parts = np.zeros(0) if self._term is None else self._term.L0[self._parts]
        bars = self.system.scene.bars
        return np.concatenate([parts, [bars[k].L0 for k in self._guys]])

    def stiffnesses(self) -> Array:
        """EA/L0 of the parts at the threshold (force/length)."""
        parts = np.zeros(0) if self._term is None else (self._term.EA / self._term.L0)[self._parts]
        bars = self.system.scene.bars
        return np.concatenate([parts, [bars[k].bar.EA / bars[k].L0 for k in self._guys]])

    def gradients(self) -> Array:
        """This rank's gradients of the lengths of the parts at the threshold, (3 n_owned, n)."""
        potential, columns = self.system.potential, []
        for k in self._parts:
            assert self._term is not None
            potential.g[:] = 0.0
            self._term.add_length_gradient(int(k), potential.x, potential.g)
            columns.append(self._free())
        for k in self._guys:
            potential.g[:] = 0.0
            if self._bars is not None and len(self._bars.EA):
                first, last = self._bars.ends[k]
                bar = self.system.scene.bars[k]
                potential.g[last] = (bar.points[1] - bar.points[0]) / bar.length
                potential.g[first] = -potential.g[last]
            columns.append(self._free())
        return np.array(columns).T

    def _free(self) -> Array:
        """The potential's `g`, gathered from all ranks, in the free components, (3 n_owned,)."""
        potential, unknowns = self.system.potential, self.system.unknowns
        n = unknowns.n_owned
        unknowns.gather_forces(potential.g_vector, potential.g)
        unknowns.project(potential.g)
        potential.g[:n][unknowns.held[:n]] = 0.0
        return potential.g[:n].ravel().copy()

    def release(self) -> None:
        """Let lengths decide again, and restore the scene."""
        if self._term is not None:
            self._term.kept = None
        if self._bars is not None:
            self._bars.EA[:], self._bars.tension_only[:] = self._table_before
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
        for k in range(len(parts.owners)):
            self._moves[:, k] = solve(self._columns[:, k])
        own: Array = np.asarray(self._columns.T @ self._moves)
        flexible: Array = self._comm.allreduce(own, op=MPI.SUM)
        flexible = (flexible + flexible.T) / 2 + np.diag(1 / parts.stiffnesses())
        try:
            self._root = cholesky(self._comm.bcast(flexible))  # R^T R
        except LinAlgError:
            raise InputError(
                "sensitivities: without the parts of cables and the guys that are about to become "
                "taut or slack the equilibrium is unstable; use another state."
            ) from None

    def of(self, way: Array, shortened: Array, sign: float) -> tuple[Array, Booleans]:
        """Movement of the unknowns, and which parts turn taut, for a change in the direction
        `sign` that without these parts moves the unknowns by `way` and shortens the parts'
        unstressed lengths by `shortened`, both per unit."""
        q = self._comm.allreduce(self._columns.T @ way, op=MPI.SUM) + shortened
        right = solve_triangular(self._root, sign * q, trans="T")
        tensions = self._comm.bcast(nnls(self._root, right)[0])
        return sign * way - self._moves @ tensions, tensions > 0.0


def _strains_of(cable: LaidCable) -> Array:
    """Strains of a cable's parts between clamps and bonds, negative where slack."""
    return np.asarray(current_lengths(cable) / cable.part_lengths - 1)
