"""Ponding: rainwater in the hollows of a roof as a load that depends on its shape.

The water in each hollow acts as a load of fixed direction on the shape it was computed for. The
membrane deflects, the hollows and the load grow, and the iteration repeats; if it converges, the
water is in equilibrium. Unlike ponds, it needs neither the places of hollows nor their water
levels in advance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.energy.terms.ponding import add_water_pressure, find_level, water_sums
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.foundation.runtime.checks import counted
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.model.membrane_load import MembraneLoad
from crms_fenicsx.results.hollows import Hollow, Hollows, find_hollows

NAME = "rain in hollows"
"""Name of the load."""


@dataclass(frozen=True, repr=False)
class PondingCheck:
    """Result of a ponding check.

    Attributes
    ----------
    settled
        Whether the water that stands is in equilibrium; True of a dry roof. A load case to
        design for, not a verdict on the roof.
    verdict
        What stands where and in which load case, in words.
    hollows
        Hollows of the last shape, with their water.
    volumes
        Total volume of water after each filling (length cubed).
    snapshot
        Last state, water included; pass it to `Solver.restore`.
    """

    settled: bool
    verdict: str
    hollows: tuple[Hollow, ...]
    volumes: tuple[float, ...]
    snapshot: SceneState

    @property
    def dry(self) -> bool:
        """Whether no water stands anywhere."""
        return self.settled and not self.hollows

    @property
    def depth(self) -> float:
        """Depth of the deepest hollow (length), 0 if there is none."""
        return max((hollow.depth for hollow in self.hollows), default=0.0)

    def __repr__(self) -> str:
        lines = [self.verdict, *(f"  {hollow!r}" for hollow in self.hollows)]
        return "\n".join(lines)


class Rain:
    """Fills the hollows of a scene's current shape. Units: depth of rain on the plan (length),
    specific weight (force / length cubed)."""

    def __init__(self, scene: Scene, depth: float, weight: float) -> None:
        self.scene, self.depth, self.weight = scene, depth, weight
        self.found = Hollows((), np.zeros(0, dtype=np.int64), 0.0)
        self.volumes: list[float] = []
        self.settled, self.takes_all = False, False
        self._changes: list[float] = []

    def put(self) -> None:
        """Add the load, with no water yet. Collective."""
        scene = self.scene
        scene.loads.add(MembraneLoad(NAME, np.zeros(scene.membrane.held.shape), 0.0))

    def fill(self) -> bool:
        """Fill the hollows of the current shape; return whether the load changes. Collective.

        Each hollow is limited to all the rain on the roof, since others may overflow into it."""
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
        self.settled = change <= 1e-4 * volume
        # given up after ten fillings without a smaller change
        last, before = self._changes[-10:], self._changes[:-10]
        if self.settled or (before and min(last) >= min(before)):
            return False
        scene.loads.update(loads=tuple(loads))
        scene.versions.change_model()
        return True

    def check(self, snapshot: SceneState, why: str, case: str) -> PondingCheck:
        """Verdict on the ponding iteration; `case` tells the loads besides the rain."""
        volume, hollows = self.volumes[-1] if self.volumes else 0.0, self.found.hollows
        settled, where = self.settled and not why, ""
        if hollows:
            at, count = as_text(hollows[0].at), counted(len(hollows), "hollow")
            where = f" in {count}, up to {hollows[0].depth:.3g} deep at {at}"
        water = f"water of the volume {volume:.4g}, weight {volume * self.weight:.4g},"
        if settled and not hollows:
            verdict = f"{case}: no water stands on the roof"
        elif settled:
            all_of_it = ", one of which takes all the rain" if self.takes_all else ""
            verdict = (
                f"{case}: {water} stands{where}{all_of_it}. The roof is in equilibrium; design it "
                "for this load, or make it drain"
            )
        else:
            why = why or f"it does not converge in {len(self.volumes)} fillings of the hollows"
            verdict = (
                f"{case}: {water} finally gathers{where}: {why}. Use more prestress or slope, or "
                "add a drain"
            )
        return PondingCheck(settled, verdict, hollows, tuple(self.volumes), snapshot)


def acting_loads(scene: Scene, case: str) -> str:
    """The loads of a scene's state, in words, after the name of the load case if it has one."""
    words = [f"{name} {factor:.4g}" for name, factor in scene.factors.items() if factor != 0.0]
    words += [f"pressure {scene.pressure:.4g}"] if scene.pressure != 0.0 else []
    return f"{case}{', ' if case else ''}under {', '.join(words) or 'no load'}"
