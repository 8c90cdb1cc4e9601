"""Checks of bars and joints in equilibrium, relative to the bars that meet there."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.frame_contribution import BarContribution
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.verification.report import ROUNDED, UNBALANCED, Check
from crms_fenicsx.energy.minimization.outcome import NO_STRAIN
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.bar import Joint

FORCE = 1e-6
"""Largest relative error of a bar's force."""


def check_frame(system: System, bars: BarContribution) -> list[Check]:
    """Check all bars and joints. Collective."""
    scene = system.scene
    free, own = _free_forces(system, bars), _own_forces(scene)
    worst = np.concatenate([_errors(system, bars), free])
    scene.comm.Allreduce(MPI.IN_PLACE, worst, op=MPI.MAX)
    n = len(scene.bars)
    places, forces, free = worst[:n], worst[n : 2 * n], worst[2 * n :]
    shares = np.where(own > 0.0, free / np.where(own > 0.0, own, 1.0), 0.0)
    names = [bar.name for bar in scene.bars]
    points = [joint.name for joint in scene.joints] + [
        next(bar.name for bar in scene.bars if vertex in (bar.start, bar.end))
        for vertex in scene.frame.vertices
    ]
    checks = []
    if names:
        checks = [
            _worst("ends of bars off their place", places, ROUNDED, names),
            _worst("forces of bars", forces, FORCE, names),
        ]
    return [*checks, _worst("unbalanced forces of bars", shares, UNBALANCED, points, binding=False)]


def _worst(name: str, values: Array, limit: float, names: list[str], binding: bool = True) -> Check:
    values = np.nan_to_num(values, nan=np.inf)
    k = int(np.argmax(values))
    return Check(name, float(values[k]), limit, names[k], binding)


def _errors(system: System, bars: BarContribution) -> Array:
    """Errors of the bars' end positions and forces, (2 n,), on the first rank."""
    scene, found = system.scene, np.zeros((2, len(system.scene.bars)))
    if scene.comm.rank == 0:
        places, forces = bars.found(system.potential)
        for k, bar in enumerate(scene.bars):
            far = ROUNDED * float(np.abs(bar.points).max())
            away = float(np.linalg.norm(bar.points - places[k], axis=1).max())
            found[0, k] = max(away - far, 0.0) / bar.L0
            EA, force = bar.bar.EA, bar.force
            error = abs(force - forces[k]) - EA * (ROUNDED + far / bar.L0)
            found[1, k] = max(error, 0.0) / max(abs(force), abs(forces[k]), NO_STRAIN * EA)
    return found.ravel()


def _free_forces(system: System, bars: BarContribution) -> Array:
    """Unbalanced forces at joints and vertices of bars, (m,) (force), on their owners."""
    scene, g = system.scene, system.potential.g
    joints, vertices = scene.joints, scene.frame.vertices
    found = np.zeros(len(joints) + len(vertices))
    if scene.comm.rank == 0:
        held = np.array([joint.held for joint in joints]).reshape(-1, 3)
        forces = np.where(held, 0.0, g[bars.blocks.joint_blocks])
        found[: len(joints)] = np.linalg.norm(forces, axis=1)
    for k, vertex in enumerate(vertices, start=len(joints)):
        rank, dof = scene.frame.home(vertex)
        if rank == scene.comm.rank:
            found[k] = np.linalg.norm(np.where(scene.held[dof], 0.0, g[dof]))
    return found


def _own_forces(scene: Scene) -> Array:
    """Sums of bar and cable force magnitudes at joints and vertices of bars, (m,) (force)."""
    points: list[object] = [*scene.joints, *scene.frame.vertices]
    forces, least = np.zeros((2, len(points)))
    for bar in scene.bars:
        for end in (bar.start, bar.end):
            k = points.index(end)
            forces[k] += abs(bar.force)
            least[k] = max(least[k], NO_STRAIN * bar.bar.EA)
    for cable in scene.cables:
        for tension, name in zip(
            cable.part_tensions[[0, -1]], cable.state.laid.joints, strict=True
        ):
            for k, point in enumerate(points):
                if cable.taut and isinstance(point, Joint) and point.name == name:
                    forces[k] += tension
                    least[k] = max(least[k], NO_STRAIN * cable.cable.EA)
    return np.where(forces > least, forces, 0.0)
