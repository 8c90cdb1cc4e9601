"""The states in which things were put on a scene, in checkpoints.

Finer meshes need them. Each is saved once, with a field of displacements unless it is stress-free.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Annotated, Any, Literal

import numpy as np
from mpi4py import MPI

from crms_fenicsx.energies.dead_load import MembraneLoad, dead_load, joint_load, wind_load
from crms_fenicsx.model.bar import PlacedBar, Placing
from crms_fenicsx.model.bar_state import BarState, JointState
from crms_fenicsx.model.cable_state import CableState, End
from crms_fenicsx.model.laid_cable import LaidCable, Laying
from crms_fenicsx.model.pond import Pond
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.stage import Stage, same
from crms_fenicsx.output.npy import read_rows, write_rows
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene
from crms_fenicsx.surface.path import Path

KINDS: dict[str, Callable[..., MembraneLoad]] = {
    "dead": dead_load,
    "wind": wind_load,
    "joints": joint_load,
}
"""What makes loads."""
CLOSE = 1e-9
"""Relative difference of loads that are the same: the order of sums makes it."""


@dataclass(frozen=True)
class SavedStage:
    """A stage without its field, the stage of its sealing by its number; see `Stage`.

    Attributes
    ----------
    deformed
        Whether there is a field of displacements.
    """

    number: int
    deformed: bool
    pressure: float
    factors: dict[str, float]
    cables: dict[str, CableState]
    joints: dict[str, JointState]
    bars: dict[str, BarState]
    ponds: tuple[Pond, ...]
    air: SealedAir | None
    sealed_on: int | None
    floor: float | None
    terms: tuple[str, ...]


@dataclass(frozen=True)
class SavedLaying:
    """How a cable was laid, on a stage by its number; see `Laying`."""

    route: Array
    path: Path
    ends: tuple[End, End]
    anchors: Annotated[Array, 2, 3]
    L0: float | None
    tension: float | None
    measured_on: Literal["surface", "facets"]
    length: float
    EA: float
    stage: int
    shortest: bool

    def laying(self, stages: Sequence[Stage]) -> Laying:
        """It, on its stage."""
        return Laying(**{**vars(self), "stage": stages[self.stage]})


@dataclass(frozen=True)
class SavedPlacing:
    """How a bar was placed, on a stage by its number; see `Placing`."""

    L0: float | None
    first: BarState
    EA: float
    stage: int

    def placing(self, stages: Sequence[Stage]) -> Placing:
        """It, on its stage."""
        return Placing(**{**vars(self), "stage": stages[self.stage]})


def stages_of(scene: Scene) -> list[Stage]:
    """States in which what is there was put on a scene, each once, in their order."""
    stages: list[Stage | None] = [load.stage for load in scene.loads]
    stages += [cable.laying.stage for cable in scene.cables if cable.laying is not None]
    stages += [bar.placing.stage for bar in scene.bars if bar.placing is not None]
    stages.append(scene._sealed_on)
    distinct: list[Stage] = []

    def add(stage: Stage | None) -> None:
        if stage is not None:
            add(stage.sealed_on)  # before what was put there later, on the same shape
            if not any(same(stage, other) for other in distinct):
                distinct.append(stage)

    for stage in stages:
        add(stage)
    return sorted(distinct, key=lambda stage: stage.number)


class Stages:
    """The stages of a scene, of which things are known by their numbers. Made on all ranks.

    Parameters
    ----------
    scene
        The scene.
    """

    def __init__(self, scene: Scene) -> None:
        self.found, comm = stages_of(scene), scene.comm
        self._deformed = [comm.allreduce(bool(one.u.any()), op=MPI.LOR) for one in self.found]

    def number(self, stage: Stage | None) -> int | None:
        """The number of a stage."""
        if stage is None:
            return None
        return next(k for k, other in enumerate(self.found) if same(other, stage))

    def laying(self, cable: LaidCable) -> SavedLaying | None:
        """How a cable was laid, if that is known."""
        if cable.laying is None:
            return None
        return SavedLaying(**{**vars(cable.laying), "stage": self.number(cable.laying.stage)})

    def placing(self, bar: PlacedBar) -> SavedPlacing | None:
        """How a bar was placed, if that is known."""
        if bar.placing is None:
            return None
        return SavedPlacing(**{**vars(bar.placing), "stage": self.number(bar.placing.stage)})

    def saved(self) -> tuple[SavedStage, ...]:
        """They without their fields."""
        return tuple(
            SavedStage(**{
                **{name: value for name, value in vars(stage).items() if name != "u"},
                "deformed": deformed,
                "sealed_on": self.number(stage.sealed_on),
            })
            for stage, deformed in zip(self.found, self._deformed, strict=True)
        )  # fmt: skip

    def write(self, folder: FilePath, scene: Scene) -> dict[str, str]:
        """Write their fields; digests of the files by their names. Collective."""
        vertices, digests = scene.V.dofmap.index_map, dict[str, str]()
        own, ids = vertices.size_local, scene.membrane.vertex_ids
        for k, (stage, deformed) in enumerate(zip(self.found, self._deformed, strict=True)):
            if deformed:
                name, u = f"stage_{k + 1}", stage.u[:own]
                file, total = folder / f"{name}.npy", vertices.size_global
                digests[name] = write_rows(file, scene.comm, ids[:own], u, total)
        return digests


def read_stages(
    folder: FilePath, scene: Scene, saved: Sequence[SavedStage], digests: Mapping[str, str]
) -> list[Stage]:
    """The stages with their fields. Collective."""
    shape, found = (scene.V.dofmap.index_map.size_global, 3), list[Stage]()
    for k, one in enumerate(saved):
        u: Array
        name, u = f"stage_{k + 1}", np.zeros(scene.membrane.held.shape, dtype=np.float64)
        if one.deformed:
            file, ids = folder / f"{name}.npy", scene.membrane.vertex_ids
            u = read_rows(file, scene.comm, ids, np.float64, shape, digests.get(name, ""))
        u.flags.writeable = False
        given = {key: value for key, value in vars(one).items() if key != "deformed"}
        sealed_on = None if one.sealed_on is None else found[one.sealed_on]
        found.append(Stage(**given | {"u": u, "sealed_on": sealed_on}))
    return found


def recipe(load: MembraneLoad) -> dict[str, Any] | None:
    """What a load was made of, plain data; None for functions, and forces on vertices."""
    again = load.again
    if not isinstance(again, partial) or any(map(callable, again.keywords.values())):
        return None
    kind = next((kind for kind, make in KINDS.items() if again.func is make), None)
    given = {
        key: np.asarray(value, dtype=float).tolist() if key == "traction" else value
        for key, value in again.keywords.items()
    }
    return None if kind is None else {"kind": kind, **given}


def with_recipe(
    load: MembraneLoad, given: Mapping[str, Any] | None, own: MembraneLoad | None, scene: Scene
) -> MembraneLoad:
    """A load that knows again how it is made. Collective.

    Parameters
    ----------
    load
        As it was saved, with its stage.
    given
        Its `recipe`.
    own
        The load of this name that the script has put on the scene. If it was saved without recipe,
        that has one, as of a function, if it gives the same forces on the stage.
    scene
        Its scene, whose shape does not count yet.
    """
    if given is not None:
        arguments = {key: value for key, value in given.items() if key != "kind"}
        return replace(load, again=partial(KINDS[given["kind"]], **arguments))
    if own is None or own.again is None or load.stage is None:
        return load
    scene.u.x.array[:] = load.stage.u.ravel()
    try:
        intensity = own.again(scene.membrane).intensity
    except InputError:
        return load
    alike = abs(intensity - load.intensity) <= CLOSE * load.intensity
    return replace(load, again=own.again) if alike else load
