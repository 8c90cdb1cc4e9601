"""Where nothing but loads acts on the membrane, and how large its forces are."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.runtime.arrays import Booleans, Integers
from crms_fenicsx.scene import Scene


def plain_vertices(system: System) -> Integers:
    """This rank's free vertices at which neither a cable in tension nor a bar acts. Collective.

    The potential's gradient is lost.
    """
    scene, unknowns, potential = system.scene, system.unknowns, system.potential
    n = unknowns.n_vertices
    plain: Booleans = np.logical_not(np.any(unknowns.held[:n], axis=1))
    if unknowns.bounds is not None:
        plain &= potential.x[:n, 2] > unknowns.bounds[0][:n, 2]
    if system.cables is not None and system.cables.taut:
        assert system.cables.tables is not None
        near = scene.V.dofmap.list[system.cables.tables.folded.cells].ravel()
        folded = np.zeros((n + unknowns.n_ghost_vertices, 3))
        folded[near] = 1.0
        potential.g[:] = 0.0
        unknowns.add_to_vertices(folded, potential.g)
        unknowns.gather_forces(potential.g_vector, potential.g)
        plain &= potential.g[:n, 0] == 0.0
    for vertex in scene.frame.vertices:
        rank, dof = scene.frame.home(vertex)
        if rank == scene.comm.rank:
            plain[dof] = False
    return np.flatnonzero(plain)


def section_forces(scene: Scene) -> float:
    """Size of the membrane's forces in a cut through it: of prestress and strain (force)."""
    materials = scene.materials.values()
    modulus = max(m.reference_modulus for m in materials)
    prestress = max(float(np.abs(m.prestress_vector).max()) for m in materials)
    stored = abs(scene.energies.get("membrane", 0.0))
    return float(prestress * scene.membrane.size + np.sqrt(2 * modulus * stored))
