"""State of a scene as one value, for snapshots, halved increments and checkpoints.

Add whatever load steps can change to the state of the part that owns it (`MembraneState`,
`LoadsState`, `AirState`, `FrameState`, `CableNetState`): snapshots, branches, combinations, halving
and checkpoints then keep it. Type hints of mesh arrays name the entities of their rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from crms_fenicsx.analysis.scene.frame import FrameState
from crms_fenicsx.analysis.scene.loads import AirState, LoadsState
from crms_fenicsx.cabling.cables.cable_net import CableNetState
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.runtime.arrays import UNSAVED, Array
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.model.membrane import MembraneState, StepHistory
from crms_fenicsx.model.strengths import LIMIT_STATES
from crms_fenicsx.model.versions import StateWarning, Version

if TYPE_CHECKING:
    from crms_fenicsx.cabling.paths.tried_paths import TriedPaths


@dataclass(frozen=True)
class LoadCase:
    """What a state of a scene is for, which says how it is judged."""

    state: str = LIMIT_STATES[0]  # limit state
    base: SceneState | None = None  # in operation, before the loads of a combination; None: unknown
    prestress: float = 1.0  # partial factor of the prestress
    without: tuple[str, ...] = ()  # names of cables and bars that are missing
    stage: int = 0  # number of the last stage of erection that led to it


@dataclass(frozen=True, repr=False)
class SceneState:
    """State of a scene: everything that load steps, supports, loads and cables can change.

    In memory it holds this process's part of the mesh; `Solver.save` writes it to files.

    Attributes
    ----------
    u : (3 n,)
        Displacements of the vertices by local degree of freedom (length).
    energies
        Energy of each kind of term (force x length).
    tensions
        Tension of each cable, by its name (force).
    """

    membrane: MembraneState
    loads: LoadsState
    air: AirState
    frame: FrameState
    net: CableNetState
    floor: float | None  # height of the floor (length)
    energies: Mapping[str, float]
    warnings: tuple[StateWarning, ...]
    step_history: StepHistory | None
    terms: Annotated[tuple[EnergyTerm, ...], UNSAVED]
    version: Annotated[Version, UNSAVED]
    scene: Annotated[object, UNSAVED]  # the `Scene` of this state
    tried: Annotated[TriedPaths | None, UNSAVED] = None  # paths tried by a solver; in snapshots
    case: Annotated[LoadCase, UNSAVED] = LoadCase()

    @property
    def u(self) -> Array:
        return self.membrane.u.ravel()

    @property
    def tensions(self) -> dict[str, float]:
        return {cable.name: state.law.tension for cable, state in self.net.cables.items()}

    def __repr__(self) -> str:
        """One line."""
        words = [f"energy {sum(self.energies.values()):.6g}"]
        if self.net.cables:
            tensions = span(list(self.tensions.values()))
            words.append(f"{counted(len(self.net.cables), 'cable')}, tension {tensions}")
        return f"SceneState({'; '.join(words)})"
