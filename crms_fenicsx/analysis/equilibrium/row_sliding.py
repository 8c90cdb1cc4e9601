"""The stress-free mesh follows the rows of vertices that have slid with their cables."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.collapse_words import COLLAPSED, collapse_words
from crms_fenicsx.analysis.equilibrium.held_rims import within_held_rims
from crms_fenicsx.analysis.equilibrium.kept_vertices import kept_vertices
from crms_fenicsx.analysis.equilibrium.shift_contribution import ShiftContribution
from crms_fenicsx.analysis.scene.scene import Scene, place_stress_free
from crms_fenicsx.cabling.cables.points_on_edges import VERTEX
from crms_fenicsx.cabling.cables.row_shifts import (
    NEAR,
    SETTLED,
    RowShifts,
    fixed_vertices,
    row_places,
)
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.meshes.mesh_motion import MeshMotion
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import BUDGET

logger = logging.getLogger("crms_fenicsx")

SLOW, MOTIONS = 0.7, 5
"""Ratio of the largest shift to the one before, after solves with the same contacts, above which it
is slow (1 in wind), and number of slow ones in a load step after which all rows stay."""


@dataclass
class Motions:
    """Shifts of rows in the solves of a load step, and what follows from them.

    Attributes: `rest`: whether all rows stay for the rest of the load step.
    """

    rest: bool = False
    _slow: int = 0
    _last: float = np.inf
    _ways: list[Array] = field(default_factory=list)
    """Shifts of the last solves on the same contacts, and those made then."""
    _steps: list[Array] = field(default_factory=list)
    _thrown: tuple[Array, float] = (np.zeros((0, 3)), 1.0)
    """Shift of the last solve that was interrupted, and the part of it that was made."""

    def let_rest(self, way: float, solved: bool, windy: bool) -> None:
        """Let rows stay if the largest shift, relative to the cell size, is slow, and in wind once
        it is at the solver's tolerance: they would move the wind, and this them, to and fro."""
        # as the wind turns, so do the places at which rows come to rest
        ratio = 1.0 if windy else SLOW
        self._slow += solved and way > max(ratio * self._last, SETTLED)
        self._last = way if solved else np.inf
        self.rest = self._slow >= MOTIONS or (windy and way <= SETTLED)

    def further(self, rows: RowShifts, ways: Array, solved: bool) -> Array:
        """Shifts (m, 3) to make beyond those of a solve (m, 3), so that rows come to rest as their
        last motions tell: Anderson's extrapolation of a fixed point, not over new contacts. Rows
        that solves would throw to and fro move by a part of it, by Aitken's factor."""
        if not solved:
            self._ways, self._steps = [], []
            last, factor = self._thrown
            change = ways - last if ways.shape == last.shape else np.zeros_like(ways)
            back = -float(np.vdot(last, change)) if change.any() else 0.0
            factor = min(1.0, factor * back / float(np.vdot(change, change))) if back > 0.0 else 1.0
            self._thrown = ways, factor
            return (factor - 1.0) * ways
        self._thrown = np.zeros((0, 3)), 1.0
        step = ways.ravel()
        self._ways.append(step)
        if self._steps:
            changes = np.diff(self._ways, axis=0).T
            factors = np.linalg.lstsq(changes, step, rcond=None)[0]
            step = step - (np.transpose(self._steps) + changes) @ factors
            if (norm(step.reshape(-1, 3)) > rows.sizes).any():
                step = ways.ravel()
        self._steps.append(step)
        return step.reshape(-1, 3) - ways


class RowSliding:
    """Moves the stress-free mesh of a scene with its rows after a solve.

    Attributes: `collapse`: why the last motion cannot be used; "" if it can; `motions`: those of
    the load step.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.collapse = scene, ""
        self._motion: MeshMotion | None = None
        self._rows: tuple[LaidCable, ...] = ()
        self._fixed: Booleans = np.zeros(0, dtype=bool)
        self._sliding: Integers = np.zeros(0, dtype=np.int64)
        self._aside = 0  # times that vertices have moved under spans in this solve
        self.motions = Motions()

    def destroy(self) -> None:
        """Free the PETSc objects."""
        if self._motion is not None:
            self._motion.destroy()
        self._motion = None

    def begin(self) -> None:
        """Begin a load step."""
        self.motions, self.collapse = Motions(), ""

    def follow(
        self, shifts: ShiftContribution, potential: Potential, begins: bool, solved: bool
    ) -> float:
        """Move the stress-free places by the shifts of the last solve, and the mesh around them
        unless all are small; return the largest, relative to the cell size. Vertices below spans
        move under these. `begins`: whether it is the first in a solve; `solved`: whether it
        follows a solved state without new contacts. Collective."""
        self.collapse = ""
        self._aside = 0 if begins else self._aside
        rows, membrane = shifts.numbering.shifts, self.scene.membrane
        ways = shifts.shifts(potential)
        way = float((norm(ways) / rows.sizes).max(initial=0.0))
        X, x = membrane.stress_free.copy(), membrane.positions()
        here = self._here(shifts)
        at = np.searchsorted(rows.vertices, membrane.vertex_ids[here])
        X[here] += ways[at]
        aside, X, x = self._below_spans(rows, X, x)
        way = max(way, aside)
        if way == 0.0:
            return 0.0
        windy = self.scene.loads.has_wind
        self.motions.let_rest(way, solved, windy)
        if way > NEAR:
            motion = self._renewed(rows.vertices)
            further = 0.0 * ways if windy else self.motions.further(rows, ways, solved)
            X, x = motion.move(X, x, (rows.vertices, further))
            self.collapse = self._narrowed(motion, X, COLLAPSED)
        self._keep_rows(moved=False)
        place_stress_free(self.scene, X)
        if way > NEAR:
            self._keep_rows(moved=True)
        u = membrane.u.x.array.reshape(-1, 3)
        stays = membrane.held & ~here[:, None]  # displaced as prescribed, wherever it is
        u[:] = np.where(stays, u, x - X)
        logger.debug("rows slide by %.3g cells", way)
        return way

    def _keep_rows(self, moved: bool) -> None:
        """Keep the present places of the rows of which none are known, or of all if the mesh has
        `moved`: shifts go across these. Collective."""
        net = self.scene.net
        rows = [cable for cable in net.cables if cable.state.laid.line is not None]
        rows = [cable for cable in rows if moved or cable.state.row is None]
        if not rows:
            return
        nodes = net.nodes
        places = row_places([], nodes, net.strip_shape())
        for (start, end), cable in zip(pairwise(ints(nodes.starts)), net.cables, strict=True):
            if cable in rows:
                at_vertices = nodes.kind[start:end] == VERTEX
                cable.update(row=places[start:end][at_vertices])

    def narrowed(self) -> str:
        """Words on cells that have lost more than half of their areas, for a solve that has failed
        since; "" if none have. Collective."""
        if self._motion is None:
            return ""
        why = self._narrowed(self._motion, self.scene.membrane.stress_free, 0.5)
        return f"; {why}" if why else ""

    def _narrowed(self, motion: MeshMotion, X: Array, most: float) -> str:
        """Words on the cell with the smallest ratio of its area to its first one, if that is at
        `most` so; else "". Collective."""
        (ratio, place, near), _ = motion.quality(X)
        rows = [self._rows[k] for k in near]
        return collapse_words(self.scene, place, rows) if ratio <= most else ""

    def _below_spans(self, rows: RowShifts, X: Array, x: Array) -> tuple[float, Array, Array]:
        """Move vertices of rows that lie beside the spans above them, a few times in a solve;
        return the largest way relative to the cell size, 0 if all are small, and the places.
        Collective."""
        lines = [cable for cable in self.scene.cables if cable.state.laid.line is not None]
        spans = [(k, *span) for k, cable in enumerate(lines) for span in _spans(cable)]
        if not spans or self._aside == BUDGET.changes:
            return 0.0, X, x
        motion = self._renewed(rows.vertices)
        found = motion.under(X, x, spans)
        way = float((norm(found[0] - X) / motion.size).max(initial=0.0))
        way = float(self.scene.comm.allreduce(way, op=MPI.MAX))
        if way <= NEAR:
            return 0.0, X, x
        self._aside += 1
        return way, *found

    def _here(self, shifts: ShiftContribution) -> Booleans:
        """Whether each local vertex shifts, (n,)."""
        return np.isin(self.scene.membrane.vertex_ids, shifts.numbering.shifts.vertices)

    def _renewed(self, shifting: Integers) -> MeshMotion:
        """The motion of the mesh with the present rows, of which the vertices `shifting` (m,) slide
        now; at their ends along the rim. Collective."""
        scene, membrane = self.scene, self.scene.membrane
        rows = tuple(cable for cable in scene.cables if cable.state.laid.line is not None)
        vertices = [
            np.array([k.support[0] for k in row.state.nodes if k.kind == "vertex"]) for row in rows
        ]
        ends = np.array([v for row in vertices for v in row[[0, -1]]], dtype=np.int64)
        sliding = ends[np.isin(ends, shifting)]
        goes = within_held_rims(membrane, sliding) if len(sliding) else False
        fixed = fixed_vertices(membrane, kept_vertices(scene), goes)
        fixed &= ~np.isin(membrane.vertex_ids, sliding)
        same = rows == self._rows and np.array_equal(fixed, self._fixed)
        same = same and np.array_equal(sliding, self._sliding)
        if self._motion is None or not scene.comm.allreduce(same, op=MPI.LAND):
            self.destroy()
            self._rows, self._fixed, self._sliding = rows, fixed, sliding
            self._motion = MeshMotion(membrane.V, membrane.first_surface, vertices, fixed, sliding)
        return self._motion


def _spans(cable: LaidCable) -> list[tuple[Integers, Array, Array]]:
    """The row vertices under each span of a taut cable along a line, and the span's ends."""
    state = cable.state
    if not cable.taut or not state.lifted.any():
        return []
    ids = np.array([-1 if k.kind != "vertex" else k.support[0] for k in state.nodes])
    ends = np.flatnonzero(~state.lifted)
    return [
        (below[below >= 0], state.positions[i], state.positions[j])
        for i, j in pairwise(ints(ends))
        if (below := ids[i + 1 : j]).max(initial=-1) >= 0
    ]
