"""What of a scene cannot be carried over to a finer mesh."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.energies.residual_stress import ResidualStress
from crms_fenicsx.model.membrane import COMPONENTS, Membrane
from crms_fenicsx.runtime.errors import InputError, raised_together
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.loading import has_free_rim


def refuse(scene: Scene, terms: object, method: str) -> None:
    """Refuse, for a method, a scene of which something cannot be carried over. Collective."""
    if scene.strain_law != "total":
        raise InputError(
            f'{method}: the scene has strain="step", whose state depends on the steps taken; use '
            'Scene(..., strain="total"), or run the script with a finer mesh.'
        )
    if scene.pressure_law != "total" and scene.pressure != 0.0 and not has_free_rim(scene):
        raise InputError(
            f'{method}: the scene has pressure="step" and no free edges, so that its state '
            'depends on the steps taken; use pressure="total", or run the script with a finer mesh.'
        )
    if any(isinstance(term, ResidualStress) for term in scene.terms):
        raise InputError(
            f"{method}: the scene is that of a found form, which is in equilibrium on its own mesh "
            "only; find the form on finer meshes with find_form, and compare."
        )
    if scene.terms and terms is None:
        raise InputError(
            f"{method}: the term {scene.terms[0].name!r} of your own is made for this mesh; give a "
            "function that makes it for another scene, terms=lambda scene: ..."
        )
    if terms is not None and not callable(terms):
        raise InputError(
            f"{method}: terms = {terms!r}; give a function of a scene that returns the added terms "
            "made for it, terms=lambda scene: ..."
        )
    if terms is not None and not scene.terms:
        raise InputError(f"{method}: terms is given, but no term has been added to the scene.")
    for load in scene.loads:
        if load.again is None:
            raise InputError(
                f"{method}: of the load {load.name!r}, a function or forces on vertices, only the "
                "forces on this mesh are known; put it again with scene.put_load, as a force per "
                "area (after loading a checkpoint: with the same function, before)."
            )
    for cable in scene.cables:
        friction = cable.cable.sideways
        if cable.cable.law == "step" or (friction is not None and friction.law == "step"):
            raise InputError(
                f'{method}: the cable {cable.name!r} has law="step", whose state depends on the '
                "steps taken; use the other law, or run the script with a finer mesh."
            )
    _refuse_changes(scene, method)
    _check_supports(scene.membrane, method)


def _refuse_changes(scene: Scene, method: str) -> None:
    """Refuse what was put on a scene before its materials, cables or bars became others."""
    changed = [cable.name for cable in scene.cables if cable.laying is not None
               and cable.laying.EA != cable.cable.EA]  # fmt: skip
    changed += [bar.name for bar in scene.bars if bar.placing is not None
                and bar.placing.EA != bar.bar.EA]  # fmt: skip
    membrane = scene.membrane
    if membrane.materials != membrane.first_materials and (
        scene.loads or scene.cables or scene.bars or scene.air is not None
    ):
        what, call = "the membrane's material", "set_material"
    elif changed:
        what, call = f"the stiffness of {changed[0]!r}", "set_stiffness"
    else:
        return
    raise InputError(
        f"{method}: {what} has been changed by scene.{call}(...), and the states in which things "
        "were put on the scene were found before; make another scene with it from the beginning."
    )


def _check_supports(membrane: Membrane, method: str) -> None:
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
                    f"{method}: the vertex {membrane.stress_free[np.argmax(differ)]} is held, or "
                    "free, otherwise than scene.fix(...) was told, as after loading a checkpoint; "
                    "call scene.fix(...) for all supports."
                )
