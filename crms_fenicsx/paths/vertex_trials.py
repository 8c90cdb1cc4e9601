"""Vertices that hold cables are left in runs, where that lowers the energy.

The string of `retrace` does not tell where a cable goes that is held by vertices: in the valley
that it presses into a line of the mesh it is the shortest. Its forces do (see `held_vertices`), and
whether it gets free the energy tells. Friction carries its part of the forces; vertices that hold a
cable beyond that have been left one by one before (see `friction_release`), which is not always
enough.
"""

from __future__ import annotations

import math

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.paths.held_vertices import Run, held_runs
from crms_fenicsx.paths.path_change import PathChange
from crms_fenicsx.paths.tried_paths import TriedPaths
from crms_fenicsx.paths.vertex_passing import pass_run

HALVINGS = 2
"""How often runs that were left together, and did not lower the energy, are tried by halves."""

GAIN = 1e-5
"""Energy, relative to the sum of all kinds, by which a round must lower it for another one. Meshes
of 64 cells a side err by a hundred times as much. On a roof of 30 000 unknowns under 28 cables the
rounds below this take a quarter of a load step, for 3e-5 of its energy."""

Trial = tuple[int, Run]
"""A cable, by number, and the run of vertices that it leaves."""


class VertexTrials:
    """What is tried in one load step, in rounds.

    In a round all runs that hold cables are left at once, and if that is rejected each half of
    them, and each half of these.
    """

    def __init__(self, change: PathChange, tried: TriedPaths) -> None:
        self.change, self.tried = change, tried
        self._groups: list[tuple[int, list[Trial]]] = []  # with how often halved
        self._energy = math.inf
        self._halved = 0
        self._runs: dict[int, tuple[CableState, list[Run]]] = {}
        """What holds each cable, by number, in the state in which it was found."""

    def next(self, energy: float, scale: float) -> list[Trial]:
        """Move cables past runs of vertices that hold them. Collective.

        Units: energy (force x length). Returns what was moved; nothing where there is nothing left
        to try.
        """
        while runs := self._held():
            if not self._groups:
                if self._energy - energy < GAIN * scale:
                    self._note(runs)  # the same load once more shall not begin another round
                    break
                self._energy = energy
                self._groups = [(0, runs)]
            self._halved, group = self._groups.pop()
            known = {self._key(trial) for trial in group}
            group = [trial for trial in runs if self._key(trial) in known]
            shape = self._shape(group)
            moved = [(c, run) for c, run in group if pass_run(self.change, c, run, shape)]
            self._note([trial for trial in group if trial not in moved])
            if moved:
                return moved
        return []

    def halve(self, moved: list[Trial]) -> bool:
        """Try the halves of what was rejected later, or never again; say whether the former."""
        half = len(moved) // 2
        if half == 0 or self._halved == HALVINGS:
            self._note(moved)
            return False
        self._groups += [(self._halved + 1, part) for part in (moved[half:], moved[:half])]
        return True

    def _shape(self, group: list[Trial]) -> StripShape:
        """The vertices around runs, also around the edges that ways past them cross. Collective."""
        vertices = [vertex for _, run in group for vertex in run.vertices]
        return self.change.surface(vertices, rings=2).shape

    def _held(self) -> list[Trial]:
        """Runs that hold cables, and have not been tried."""
        net = self.change.net
        shape = net.strip_shape()
        found: list[Trial] = []
        for c, cable in enumerate(net.cables):
            if not cable.taut:
                continue
            least = 1
            if not cable.slides_freely:
                if cable.grip is None or not cable.grip.known:
                    continue
                from crms_fenicsx.friction.lateral import remap

                remap(cable)
                least = 2  # single vertices have been passed by `friction_release`
            if c not in self._runs or self._runs[c][0] is not cable.state:
                self._runs[c] = cable.state, held_runs(cable, shape)
            found += [(c, run) for run in self._runs[c][1] if len(run.vertices) >= least]
        return [trial for trial in found if self._key(trial)[1] not in self._tried(trial[0])]

    def _tried(self, c: int) -> set[tuple[int, ...]]:
        return self.tried.runs_left(self.change.net.cables[c])

    def _note(self, trials: list[Trial]) -> None:
        """Do not try these again while the cable stays where it is."""
        for trial in trials:
            self._tried(trial[0]).add(self._key(trial)[1])

    @staticmethod
    def _key(trial: Trial) -> tuple[int, tuple[int, ...]]:
        """The cable; the side and the vertices."""
        c, run = trial
        return c, (1 if run.to_left else -1, *run.vertices)
