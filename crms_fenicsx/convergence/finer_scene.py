"""A scene on a mesh that has four cells for each of its own, in the same state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from crms_fenicsx.convergence.carrier import Carrier
from crms_fenicsx.convergence.finer_cables import laid_first, lay_again
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.membrane import COMPONENTS, Membrane
from crms_fenicsx.model.stage import Stage
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.scene import Scene
from crms_fenicsx.surface.uniform_refinement import UniformRefinement

Project = Callable[[Array], Array]
"""A function of points (3, n) near a surface that returns points (3, n) in it."""


def finer_scene(scene: Scene, project: Project | None, solve: Callable[[Scene], object]) -> Scene:
    """Make the scene on the finer mesh; see `FinerMeshes.refine`. Collective.

    Cables and loads are put on the shapes that they were put on, which are solved again: their
    lengths and forces then have the finer mesh's error only.

    Parameters
    ----------
    scene, project
        What is refined, and how.
    solve
        Finds the equilibrium of a scene at the loads that it has.

    Raises
    ------
    InputError
        On all ranks: something of the scene cannot be carried over; it names what.
    """
    _refuse(scene)
    refinement = UniformRefinement.of(scene.mesh, project)
    membrane = scene.membrane
    materials = {part: membrane.materials[k] for k, part in membrane.parts.items()}
    finer = Scene(
        refinement.finer, materials or membrane.materials[0], pressure_on=membrane.pressure_on,
        penalty=scene.penalty, literal_penalty=scene.literal_penalty,
    )  # fmt: skip
    for where, directions in membrane.supports:
        finer.fix(where, directions)
    finer.membrane.strengths = membrane.strengths
    carrier = Carrier(refinement, scene, finer)
    first: dict[str, LaidCable | None] = {}
    for stage in _stages(scene):
        _bring_to(stage, carrier, first, solve)
        for load in scene.loads:
            if load.again is not None and load.stage is not None and _same(load.stage, stage):
                finer.add_load(load.again(finer.membrane))
        for cable in scene.cables:
            if cable.laying is not None and _same(cable.laying.stage, stage):
                first[cable.name] = laid_first(cable, finer, refinement)
    _bring_to(scene.stage(), carrier, first, None)
    finer._loads = tuple(finer.load(load.name) for load in scene.loads)  # in their order
    finer.net.laid = scene.net.laid
    if scene.floor_level is not None:
        heights = finer.u.x.array[2::3]
        least = scene.floor_level - finer.membrane.stress_free[:, 2]
        np.maximum(heights, least, out=heights)
        finer.floor(scene.floor_level)
    return finer


def _stages(scene: Scene) -> list[Stage]:
    """States in which loads and cables that are there were put on the scene, in their order."""
    stages = [load.stage for load in scene.loads]
    stages += [cable.laying.stage for cable in scene.cables if cable.laying is not None]
    distinct: list[Stage] = []
    for stage in stages:
        if stage is not None and not any(_same(stage, other) for other in distinct):
            distinct.append(stage)
    return sorted(distinct, key=lambda stage: stage.number)


def _same(a: Stage, b: Stage) -> bool:
    """Whether they are of the same shape; what is laid on it one after the other is there later."""
    return a.number == b.number and a.u is b.u


def _bring_to(
    stage: Stage,
    carrier: Carrier,
    first: Mapping[str, LaidCable | None],
    solve: Callable[[Scene], object] | None,
) -> None:
    """Bring the finer scene to a state of the coarse one. Collective.

    Parameters
    ----------
    stage
        The state.
    carrier
        Carries shapes over.
    first
        How cables were laid first on the finer mesh, by their names.
    solve
        Finds the equilibrium there, after which the cables are taken away; None leaves that to
        the caller.
    """
    coarse, finer = carrier.coarse, carrier.finer
    carrier.take_state(stage.u, stage.cables)
    finer._pressure = stage.pressure
    finer._loads = tuple(
        replace(load, factor=stage.factors.get(load.name, 0.0)) for load in finer.loads
    )
    finer.changes += 1
    there = [cable for cable in coarse.cables if cable.name in stage.cables]
    moved = coarse.comm.allreduce(bool(stage.u.any()), op=MPI.LOR)
    if solve is not None and not (moved and stage.number and len(there) == len(stage.cables)):
        return
    for cable in there:
        lay_again(cable, stage.cables[cable.name], first.get(cable.name), finer, carrier.refinement)
    if solve is not None:
        solve(finer)
        for cable in finer.cables:
            finer.remove(cable)


def _refuse(scene: Scene) -> None:
    """Refuse a scene of which something cannot be carried over. Collective."""
    for law, name in ((scene.strain_law, "strain"), (scene.pressure_law, "pressure")):
        if law != "total":
            raise InputError(
                f'refine: the scene has {name}="step", whose state depends on the steps taken; use '
                f'Scene(..., {name}="total"), or run the script with a finer mesh.'
            )
    others = {
        "bars": scene.bars, "joints": scene.joints, "ponds": scene.ponds,
        "sealed air": () if scene.air is None else (scene.air,),
    }  # fmt: skip
    for kind, ones in others.items():
        if ones:
            raise InputError(
                f"refine: the scene has {kind}, {ones[0]!r}, which cannot be carried over; run the "
                "script with a finer mesh."
            )
    if scene.terms:
        raise InputError(
            f"refine: the term {scene.terms[0].name!r} of your own is made for this mesh; run the "
            "script with a finer mesh."
        )
    _refuse_changes(scene)
    for load in scene.loads:
        if load.again is None:
            raise InputError(
                f"refine: of the load {load.name!r}, which is from a checkpoint or of forces on "
                "vertices, only the forces on this mesh are known; take it away with "
                "scene.remove_load(...), and put it again, as a force per area."
            )
    for cable in scene.cables:
        if cable.laying is None:
            raise InputError(
                f"refine: of the cable {cable.name!r}, which is from a checkpoint, only the length "
                "on this mesh is known; take it away with scene.remove(...), and lay it again."
            )
        friction = cable.cable.sideways
        if cable.cable.law == "step" or (friction is not None and friction.law == "step"):
            raise InputError(
                f'refine: the cable {cable.name!r} has law="step", whose state depends on the '
                "steps taken; use the other law, or run the script with a finer mesh."
            )
        if cable.cable.along > 0:
            raise InputError(
                f"refine: the cable {cable.name!r} has friction along = {cable.cable.along}, and "
                "how its tension varies depends on the steps taken; run the script with a finer "
                "mesh."
            )
    _check_supports(scene.membrane)


def _refuse_changes(scene: Scene) -> None:
    """Refuse what was put on a scene before its materials or cables became others."""
    changed = [cable.name for cable in scene.cables if cable.laying is not None
               and cable.laying.EA != cable.cable.EA]  # fmt: skip
    membrane = scene.membrane
    if membrane.materials != membrane.first_materials and (scene.loads or scene.cables):
        what, call = "the membrane's material", "set_material"
    elif changed:
        what, call = f"the stiffness of the cable {changed[0]!r}", "set_stiffness"
    else:
        return
    raise InputError(
        f"refine: {what} has been changed by scene.{call}(...), and the states in which loads and "
        "cables were put on the scene were found before; make another scene with it from the "
        "beginning."
    )


def _check_supports(membrane: Membrane) -> None:
    """Refuse held vertices that `Scene.fix` does not know of. Collective."""
    held = np.zeros_like(membrane.held)
    for where, directions in membrane.supports:
        dofs = membrane.vertices(where)
        for letter in directions:
            held[dofs, COMPONENTS[letter]] = True
    differ = (held != membrane.held).any(axis=1)
    if membrane.comm.allreduce(bool(differ.any()), op=MPI.LOR):
        with raised_together(membrane.comm):
            if differ.any():
                raise InputError(
                    f"refine: the vertex {membrane.stress_free[np.argmax(differ)]} is held, or "
                    "free, otherwise than scene.fix(...) was told, as after loading a checkpoint; "
                    "call scene.fix(...) for all supports."
                )
