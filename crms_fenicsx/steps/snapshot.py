"""Snapshots in memory: a state of a scene and its solver, to which load cases come back."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass

from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.equilibrium.state import State
from crms_fenicsx.model.bar import Joint, PlacedBar
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.membrane import Marker, StepHistory
from crms_fenicsx.model.versions import Version
from crms_fenicsx.paths.tried_paths import TriedPaths
from crms_fenicsx.runtime.arrays import Array, Booleans
from crms_fenicsx.runtime.checks import counted, span
from crms_fenicsx.scene import Scene


@dataclass(frozen=True, repr=False)
class Snapshot:
    """A state of a scene, with all that load steps, supports, loads and cables can change in it.

    It belongs to the process's part of the mesh, and is not for files; see `Solver.save`.

    Attributes
    ----------
    u
        Displacements of the vertices by local degree of freedom (length).
    energies
        Energy of each kind of term (force x length).
    tensions
        Tension of each cable, by its name (force).
    """

    state: State
    scene: Scene
    cables: tuple[LaidCable, ...]
    strip: Strip | None
    removed_dissipation: float
    joints: tuple[Joint, ...]
    bars: tuple[PlacedBar, ...]
    stiffnesses: tuple[float, ...]
    materials: dict[int, MembraneMaterial]
    held: Booleans
    held_edges: Booleans
    supports: tuple[tuple[str | Marker, str], ...]
    floor: float | None
    terms: tuple[EnergyTerm, ...]
    step_history: StepHistory | None
    tried: TriedPaths | None
    tensions: dict[str, float]

    @classmethod
    def of(cls, scene: Scene, tried: TriedPaths | None) -> Snapshot:
        """The scene's current state, with the paths that its solver has tried."""
        net, membrane = scene.net, scene.membrane
        return cls(
            State.of(scene),
            scene,
            net.cables,
            net.strip,
            net.removed_dissipation,
            scene.joints,
            scene.bars,
            (*(c.cable.EA for c in net.cables), *(bar.bar.EA for bar in scene.bars)),
            dict(membrane.materials),
            membrane.held.copy(),
            membrane.held_edges.copy(),
            membrane.supports,
            scene.floor_level,
            scene.terms,
            scene.step_history,
            deepcopy(tried),
            {cable.name: cable.tension for cable in net.cables},
        )

    def __repr__(self) -> str:
        """In a line."""
        words = [f"energy {sum(self.energies.values()):.6g}"]
        if self.cables:
            tensions = span(list(self.tensions.values()))
            words.append(f"{counted(len(self.cables), 'cable')}, tension {tensions}")
        return f"Snapshot({'; '.join(words)})"

    @property
    def version(self) -> Version:
        """Internal: the numbers of its model and state."""
        return self.state.version

    @property
    def u(self) -> Array:
        return self.state.u

    @property
    def energies(self) -> dict[str, float]:
        return self.state.energies

    def restore(self, scene: Scene) -> None:
        """Bring the scene back to this state, cables that were laid or removed since included."""
        net = scene.net
        net.cables = net.arranged = self.cables
        net.strip = self.strip
        net.removed_dissipation = self.removed_dissipation
        scene.frame.joints, scene.frame.bars = self.joints, self.bars
        stretched: tuple[LaidCable | PlacedBar, ...] = (*self.cables, *self.bars)
        for one, EA in zip(stretched, self.stiffnesses, strict=True):
            one.set_stiffness(EA)
        self.state.restore(scene)
        scene.membrane.materials.update(self.materials)
        scene.membrane.held[:] = self.held
        scene.membrane.held_edges[:] = self.held_edges
        scene.membrane.supports = self.supports
        scene._floor_level, scene._terms = self.floor, self.terms
        scene.step_history = self.step_history
