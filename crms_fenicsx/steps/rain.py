"""Rain that stands in the hollows of a roof, as a load that follows from its shape.

The water of each hollow is a load of fixed direction on the shape that it was found on. The
membrane sinks under it, its hollows grow, and the load with them, again and again: if it settles,
the water stands in equilibrium. Where hollows will be, and up to which level, nobody has to know
before, as for ponds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.energies.ponding import add_water_pressure, find_level, water_sums
from crms_fenicsx.meshes.triangles import double_areas, norm
from crms_fenicsx.model.membrane_load import MembraneLoad
from crms_fenicsx.results.hollows import Hollow, Hollows, find_hollows
from crms_fenicsx.runtime.arrays import Array, Indices
from crms_fenicsx.runtime.checks import counted
from crms_fenicsx.scene import Scene
from crms_fenicsx.scene.state import SceneState

NAME = "rain in hollows"
"""The load's name."""

SETTLED, PATIENCE = 1e-4, 10
"""Change of the water's volume, relative, from which on it has settled, and how often that change
may be without becoming less."""


@dataclass(frozen=True, repr=False)
class PondingCheck:
    """What became of rain on a roof.

    Attributes
    ----------
    passed
        Whether the water has settled in an equilibrium, or there are no hollows.
    verdict
        Why, in words.
    hollows
        Those of the last shape, with the water in it.
    volumes
        Of the water on the roof each time that the hollows were filled (length cubed).
    snapshot
        The last state, with the water on; `Solver.restore` goes there.
    """

    passed: bool
    verdict: str
    hollows: tuple[Hollow, ...]
    volumes: tuple[float, ...]
    snapshot: SceneState

    @property
    def depth(self) -> float:
        """Of the deepest hollow (length), 0 where there is none."""
        return max((hollow.depth for hollow in self.hollows), default=0.0)

    def __repr__(self) -> str:
        lines = [self.verdict, *(f"  {hollow!r}" for hollow in self.hollows)]
        return "\n".join(lines)


class Rain:
    """Fills the hollows of a scene's current shape. Units: depth (length) of the rain that falls on
    the plan, weight by volume (force / length cubed)."""

    def __init__(self, scene: Scene, depth: float, weight: float) -> None:
        self.scene, self.depth, self.weight = scene, depth, weight
        self.found = Hollows((), np.zeros(0, dtype=np.int64), 0.0)
        self.volumes: list[float] = []
        self.settled, self.takes_all = False, False
        self._changes: list[float] = []

    def put(self) -> None:
        """Put the load on the scene, without water. Collective."""
        scene = self.scene
        scene.loads.add(MembraneLoad(NAME, np.zeros(scene.membrane.held.shape), 0.0))

    def fill(self) -> bool:
        """Fill the hollows of the current shape; return whether that changes the load. Collective.

        Each takes all the rain that falls on the roof at most, as others may run over into it."""
        scene, membrane = self.scene, self.scene.membrane
        self.found = find_hollows(scene.net)
        cells = membrane.V.dofmap.list[: membrane.mesh.mesh.topology.index_map(2).size_local]
        points = membrane.positions()
        number = self.found.of_points[: len(points)]
        origin, forces, volume = np.zeros_like(points), np.zeros_like(points), 0.0
        most, self.takes_all = self.depth * self.found.plan, False
        for k, hollow in enumerate(self.found.hollows):
            own = np.ascontiguousarray(cells[(number[cells] == k).any(axis=1)], dtype=np.int32)
            side = np.sign(double_areas(points[own])[:, 2])
            level, sums = hollow.level, np.zeros(3)

            def water(
                level: float, own: Indices = own, side: Array = side, out: Array = sums
            ) -> None:
                water_sums(origin, points, own, side, level, out)

            if hollow.volume > most:
                self.takes_all = True
                level = find_level(scene.comm, water, sums, most, hollow.level)
            add_water_pressure(origin, points, own, side, level, -self.weight, forces)
            water(level)
            volume += float(scene.comm.allreduce(float(sums[1])))
        total = scene.comm.allreduce(float(norm(forces).sum()), op=MPI.SUM)
        loads = [
            replace(load, forces=forces, intensity=total / membrane.size**2)
            if load.name == NAME else load
            for load in scene.loads
        ]  # fmt: skip
        change = abs(volume - (self.volumes[-1] if self.volumes else 0.0))
        self.volumes.append(volume)
        self._changes.append(change)
        self.settled = change <= SETTLED * volume
        if self.settled or (
            len(self._changes) > PATIENCE
            and min(self._changes[-PATIENCE:]) >= min(self._changes[:-PATIENCE])
        ):
            return False
        scene.loads.update(loads=tuple(loads))
        scene.versions.change_model()
        return True

    def check(self, snapshot: SceneState, why: str) -> PondingCheck:
        """Say what has come of it."""
        volume = self.volumes[-1] if self.volumes else 0.0
        passed = self.settled and not why
        if passed and not self.found.hollows:
            verdict = "no water stands on the roof"
        elif passed:
            verdict = (
                f"water of the volume {volume:.4g} stands in equilibrium in "
                f"{counted(len(self.found.hollows), 'hollow')}"
            ) + (", one of which takes all the rain" if self.takes_all else "")
        else:
            why = why or f"it does not settle in {len(self.volumes)} fillings of the hollows"
            verdict = (
                f"water gathers, a volume of {volume:.4g} at last: {why}. Give the roof more "
                "prestress or slope, or the water a way out"
            )
        return PondingCheck(passed, verdict, self.found.hollows, tuple(self.volumes), snapshot)
