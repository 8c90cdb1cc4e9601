"""Bars and joints of a scene: layout, strain energy and loads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crms_fenicsx.analysis.equilibrium.contribution import Contribution
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.damping import Damping, Springs
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.energy.terms.bar_energy import BarEnergy, BarTable
from crms_fenicsx.energy.terms.nodal_forces import JointForces
from crms_fenicsx.energy.terms.term import EnergyTerm
from crms_fenicsx.foundation.dofs.layout import FrameBlocks, Unknowns
from crms_fenicsx.foundation.runtime.arrays import Array, Indices
from crms_fenicsx.model.bar import BarEnd, Joint


class BarContribution(Contribution):
    """Bars, with their joints as further unknowns, all on the first rank.

    Attributes: `blocks`: joints and vertices in the layout that it creates; `energy`: the bars'
    strain energy.
    """

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        frame = scene.frame
        self._vertices = frame.vertices
        first = np.array([joint.first for joint in frame.joints]).reshape(-1, 3)
        homes = [frame.home(vertex) for vertex in self._vertices]
        places = np.array([vertex.place for vertex in self._vertices]).reshape(-1, 3)
        names = [joint.name for joint in frame.joints]
        self.blocks = FrameBlocks(names, first, homes, places)

    def terms(self, unknowns: Unknowns) -> list[EnergyTerm]:
        """The terms over a layout, in which the joints' supports are prescribed."""
        frame, blocks = self.scene.frame, self.blocks
        for joint, block in zip(frame.joints, blocks.joint_blocks, strict=True):
            unknowns.held[block] = joint.held
        if unknowns.bounds is not None:  # the floor acts on the membrane only
            unknowns.bounds[0][blocks.joint_blocks] = -np.inf
        at: dict[object, np.int32] = dict(zip(frame.joints, blocks.joint_blocks, strict=True))
        at |= dict(zip(self._vertices, blocks.vertex_blocks, strict=True))
        bars = frame.bars if self.scene.comm.rank == 0 else ()
        ends = np.array([(at[bar.start], at[bar.end]) for bar in bars], dtype=np.int32)
        self.energy = BarEnergy(
            BarTable(
                ends.reshape(-1, 2),
                np.array([bar.bar.EA for bar in bars]),
                np.array([bar.L0 for bar in bars]),
                np.array([bar.bar.tension_only for bar in bars], dtype=bool),
            )
        )
        mine = blocks.joint_blocks if self.scene.comm.rank == 0 else blocks.joint_blocks[:0]
        self._loads = JointForces(mine)
        return [self.energy, self._loads]

    def blocks_of(self, ends: Sequence[BarEnd]) -> Indices:
        """Blocks of bar ends on the first rank; on others those of vertices are -1."""
        at: dict[BarEnd, np.int32] = dict(
            zip(self.scene.joints, self.blocks.joint_blocks, strict=True)
        )
        at |= dict(zip(self._vertices, self.blocks.vertex_blocks, strict=True))
        return np.array([at[end] for end in ends], dtype=np.int32)

    def damping(self, of_cables: Damping | None) -> Damping:
        """Damping of quasi-Newton steps of bar ends, and of cables. Slack guys and bars without
        force have no lateral stiffness, and chains of them would not converge without damping."""
        none = np.zeros((0, 3), dtype=np.int32)
        springs = Springs(none, np.zeros(0), none[:, :2], none[:, 0], np.zeros(0))
        springs = springs if of_cables is None else of_cables.springs
        segments = np.concatenate([springs.segments, self.energy.table.ends])
        return Damping(replace(springs, segments=segments))

    def read_scene(self, potential: Potential) -> None:
        frame, joints = self.scene.frame, self.blocks.joint_blocks
        potential.x[joints] = _positions(frame.joints) - potential.unknowns.X[joints]
        if self.scene.comm.rank == 0:
            self.energy.table.L0[:] = [bar.L0 for bar in frame.bars]
            self._loads.forces[:] = self._forces()

    def _forces(self) -> Array:
        """Forces of the loads on the joints, (n, 3) (force)."""
        joints = self.scene.joints
        number = {joint.name: k for k, joint in enumerate(joints)}
        forces = np.zeros((len(joints), 3))
        for load in self.scene.loads:
            for name, force in load.joints.items():
                forces[number[name]] += load.factor * np.array(force)
        return forces

    def add_loads(self, loads: Array) -> None:
        """Add the loads on this rank's joints to forces of blocks, (n_local, 3)."""
        if self.scene.comm.rank == 0:
            loads[self.blocks.joint_blocks] += self._forces()

    def add_pulls(self, forces: Array, factor: float) -> None:
        """Add the bars' forces on their ends, in their current directions, to block forces."""
        if self.scene.comm.rank == 0:
            pulls = np.array([bar.pull(bar.start) for bar in self.scene.bars]).reshape(-1, 3)
            np.add.at(forces, self.energy.table.ends[:, 0], factor * pulls)
            np.subtract.at(forces, self.energy.table.ends[:, 1], factor * pulls)

    def found(self, potential: Potential) -> tuple[Array, Array]:
        """Positions (n, 2, 3) of the bar ends and bar forces (n,), valid on the first rank."""
        places = potential.unknowns.X + potential.x
        return places[self.energy.table.ends], self.energy.forces

    def locate(self, potential: Potential) -> None:
        """Copy positions from the first rank to joints and bars. Collective."""
        joints, frame = self.blocks.joint_blocks, self.scene.frame
        places = potential.unknowns.X + potential.x
        found = places[joints], places[self.energy.table.ends]
        positions, points = self.scene.comm.bcast(found)
        for joint, position in zip(frame.joints, positions, strict=True):
            joint.update(position=position.copy())
        for bar, ends in zip(frame.bars, points, strict=True):
            bar.update(points=ends.copy())

    def write_scene(self, potential: Potential) -> None:
        self.locate(potential)
        scene = self.scene
        forces = self._forces()
        for joint, force in zip(scene.joints, forces, strict=True):
            balance: Array = -np.asarray(force)
            for bar in scene.bars:
                if joint in (bar.start, bar.end):
                    balance -= bar.pull(joint)
            for cable in scene.cables:
                for end, name in zip(
                    (cable.start, cable.end), cable.state.laid.joints, strict=True
                ):
                    if name == joint.name and cable.taut:
                        balance += end.reaction
            joint.update(reaction=np.where(joint.held, balance, 0.0) + 0.0)  # no -0.0


def _positions(joints: tuple[Joint, ...]) -> Array:
    return np.array([joint.position for joint in joints]).reshape(-1, 3)
