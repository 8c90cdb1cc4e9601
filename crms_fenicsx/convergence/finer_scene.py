"""A scene on a finer mesh, in the same state."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from crms_fenicsx.convergence.carrier import Carrier
from crms_fenicsx.convergence.refusals import refuse
from crms_fenicsx.convergence.retrace import Retrace
from crms_fenicsx.energies.term import EnergyTerm
from crms_fenicsx.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene
from crms_fenicsx.surface.mesh_refinement import MeshRefinement

Terms = Callable[[Scene], EnergyTerm | Sequence[EnergyTerm]]
"""Makes the terms of the energy that were added to a scene for another one."""


def finer_scene(
    scene: Scene,
    divide: Callable[[MembraneMesh], MeshRefinement],
    solve: Callable[[Scene], object],
    terms: Terms | None = None,
    method: str = "refine",
) -> Scene:
    """Make the scene on the finer mesh; see `FinerMeshes.refine`. Collective.

    Cables, bars, loads and the air are put on the shapes that they were put on, which are solved
    again: their lengths, forces and volumes then have the finer mesh's error only.

    Parameters
    ----------
    scene, divide
        What is refined, and how.
    solve
        Finds the equilibrium of a scene at the loads that it has.
    terms
        Makes the added terms for the finer scene.
    method
        The user's call, which errors name.

    Returns
    -------
    The scene, in the equilibrium.

    Raises
    ------
    InputError
        On all ranks: something of the scene cannot be carried over; it names what.
    """
    refuse(scene, terms, method)
    refinement = divide(scene.mesh)
    membrane = scene.membrane
    materials = {part: membrane.materials[k] for k, part in membrane.parts.items()}
    finer = Scene(
        refinement.finer, materials or membrane.materials[0], pressure_on=membrane.pressure_on,
        pressure=scene.pressure_law, penalty=scene.penalty, literal_penalty=scene.literal_penalty,
    )  # fmt: skip
    for where, directions in membrane.supports:
        finer.fix(where, directions)
    finer.membrane.strengths = membrane.strengths
    made = () if terms is None else _made(scene, terms, finer, method)
    Retrace(Carrier(refinement, scene, finer), made, solve).all()
    finer._loads = tuple(finer.load(load.name) for load in scene.loads)  # in their order
    finer.net.laid = scene.net.laid
    return finer


def _made(scene: Scene, terms: Terms, finer: Scene, method: str) -> tuple[EnergyTerm, ...]:
    """The added terms on the finer mesh.

    Raises
    ------
    InputError
        They have not the names of those on the coarse one.
    """
    made = terms(finer)
    found = tuple(made) if isinstance(made, Sequence) else (made,)
    due = [term.name for term in scene.terms]
    if [getattr(term, "name", None) for term in found] != due:
        raise InputError(
            f"{method}: terms returned {made!r}; it must return the terms {due}, in this order, "
            "made for the scene that it is given."
        )
    return found
