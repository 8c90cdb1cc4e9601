"""What a checkpoint holds besides the fields on the mesh: what is the same on all ranks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from typing import Annotated, Any

from crms_fenicsx.checkpoint.codec import Plain
from crms_fenicsx.energies.paper.step_history import StepHistory
from crms_fenicsx.model.bar import Bar, MeshVertex
from crms_fenicsx.model.bar_state import BarState, JointState
from crms_fenicsx.model.cable import Cable
from crms_fenicsx.model.cable_state import CableState
from crms_fenicsx.model.crossing import Crossing
from crms_fenicsx.model.pond import Pond
from crms_fenicsx.model.sealed_air import SealedAir
from crms_fenicsx.model.state_warning import StateWarning
from crms_fenicsx.paths.tried_paths import TriedPaths
from crms_fenicsx.runtime.arrays import Array, Booleans
from crms_fenicsx.steps.load_step import Step
from crms_fenicsx.surface.points import Support


@dataclass(frozen=True)
class Run:
    """What a solver knows of its load steps, besides the scene."""

    steps: list[Step]  # the accepted steps
    rows: list[Mapping[str, int | float | str]]  # rows of the history
    step_history: StepHistory | None  # what the step-wise laws know; None where there are none
    tried: TriedPaths | None  # paths that cables have not taken; None before any were tried

    def with_cells(self, cells: Array | None) -> Run:
        """The run with a state of the cells, (n, 6), in what its step-wise laws know."""
        if self.step_history is None:
            return self
        return replace(self, step_history=replace(self.step_history, cells=cells))


@dataclass(frozen=True)
class SavedCable:
    """A laid cable; see `LaidCable`."""

    name: str
    cable: Cable
    sleeve: bool
    layer: int
    in_edge: bool
    joints: tuple[str | None, str | None]
    state: CableState


@dataclass(frozen=True)
class SavedJoint:
    """A joint; see `Joint`."""

    name: str
    first: Annotated[Array, 3]
    held: Annotated[Booleans, 3]
    state: JointState


@dataclass(frozen=True)
class SavedBar:
    """A bar, between joints by their numbers or vertices; see `PlacedBar`."""

    name: str
    bar: Bar
    ends: tuple[int | MeshVertex, int | MeshVertex]
    state: BarState


@dataclass(frozen=True)
class SavedLoad:
    """A load on the membrane without its fields; see `MembraneLoad`."""

    name: str
    intensity: float
    follows: bool  # whether it follows the surface's normals
    factor: float
    joints: dict[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Contents:
    """All that a checkpoint holds but for the fields."""

    scene: Plain  # what tells the scene from others, see `fingerprint`
    held_edges: int  # how many edges are held
    digests: dict[str, str]  # of the files with the fields, by their names
    pressure: float  # pressure, air, floor, dissipated, energies: as in the scene
    air: SealedAir | None
    state_version: int  # as in the scene's versions
    in_equilibrium: bool  # whether nothing had changed since the last load step
    floor: float | None
    laid: int  # how many cables have been laid
    dissipated: float
    energies: dict[str, float]
    materials: tuple[dict[str, Any], ...]
    loads: tuple[SavedLoad, ...]  # those on the membrane but for their forces
    ponds: tuple[Pond, ...]  # as in the scene
    strip: tuple[int, ...]  # ids of the vertices all whose cells are known to the cables
    cables: tuple[SavedCable, ...]
    crossings: tuple[Crossing, ...]
    joints: tuple[SavedJoint, ...]
    bars: tuple[SavedBar, ...]
    run: Run  # of its step history without the cells
    # the call of `Solver.advance` that the checkpoint belongs to; None if to none
    call: Plain | None
    warnings: tuple[StateWarning, ...]  # as in the scene

    def check(self, n_vertices: int) -> None:
        """Refuse what does not fit together, or a mesh with some number of vertices."""
        if self.laid < len(self.cables):
            raise ValueError(f"{self.laid} cables were laid, but {len(self.cables)} are there")
        for load in self.loads:
            if not load.intensity >= 0:
                raise ValueError(f"a load {load.name!r} of the intensity {load.intensity}")
            if not load.joints.keys() <= {joint.name for joint in self.joints}:
                raise ValueError(f"a load {load.name!r} on joints that are not there")
        fixed = {name for cable in self.cables for name in cable.joints} - {None}
        if not fixed <= {joint.name for joint in self.joints}:
            raise ValueError("a cable that is fixed to a joint that is not there")
        ends = list(chain.from_iterable(bar.ends for bar in self.bars))
        if any(isinstance(end, int) and end not in range(len(self.joints)) for end in ends):
            raise ValueError("a bar that ends at a joint that is not there")
        for pond in self.ponds:
            if not (pond.weight > 0 and pond.side in (-1, 1)):
                raise ValueError(f"a pond {pond.name!r} of {pond.weight} on the side {pond.side}")
        if self.air is not None and not min(self.air.volume, self.air.absolute) > 0:
            raise ValueError(f"sealed air that is none, {self.air}")
        ids = [*self.strip, *chain.from_iterable(self._supports())]
        ids += [end.number for end in ends if isinstance(end, MeshVertex)]
        if ids and not 0 <= min(ids) <= max(ids) < n_vertices:
            raise ValueError(f"vertices {min(ids)} to {max(ids)} of a mesh with {n_vertices}")
        numbers = range(len(self.cables))
        if any(k.lower not in numbers or k.upper not in numbers for k in self.crossings):
            raise ValueError("a crossing of cables that are not there")
        for state in (cable.state for cable in self.cables):
            for node in state.nodes:
                if (node.point is None) != (node.kind == "anchor"):
                    raise ValueError(f"a node of kind {node.kind!r} with the point {node.point!r}")
                if node.crossing is not None and node.crossing not in range(len(self.crossings)):
                    raise ValueError(f"a node of the crossing {node.crossing}, which is not there")
            if state.axial is not None and len(state.axial.rest) != len(state.axial.curve.arc):
                raise ValueError("a cable whose unstressed arcs are not those of its curve")

    def _supports(self) -> Iterator[Support]:
        """The vertices on or between which cables and crossings are."""
        states = [cable.state for cable in self.cables]
        nodes = chain.from_iterable(state.nodes for state in states)
        yield from (node.point.support for node in nodes if node.point is not None)
        yield from (crossing.support for crossing in self.crossings)
