"""Slope and curvature of a scene's energy, for programs that solve for more than the scene."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.membrane_multigrid import exact_matrix
from crms_fenicsx.results.reactions import nodal_forces
from crms_fenicsx.runtime.arrays import Array


@dataclass(frozen=True)
class Residual:
    """Forces that are not balanced, the slope of the potential energy.

    Attributes
    ----------
    membrane
        Those on the membrane's vertices (force), a function on `Scene.V`, ghosts included. At
        supports, which hold them, they are the supports' forces.
    joints
        Those on the joints (force), (3,), by their names, on all ranks.
    vector
        Those on all unknowns (force), with zeros where something is held: on each rank the
        membrane's vertices first, in the order of the owned degrees of freedom of `Scene.V`, then
        points of cables, at last, on the first rank, joints. Without cables and joints it is a
        vector of `Scene.V`.
    """

    membrane: fem.Function
    joints: dict[str, Array]
    vector: PETSc.Vec

    def destroy(self) -> None:
        """Free the vector. Collective."""
        self.vector.destroy()


@dataclass(frozen=True)
class Tangent:
    """Second derivatives of the potential energy, for the unknowns of `Residual.vector`.

    Rows and columns of held components are those of the identity.

    Attributes
    ----------
    matrix
        All of them (force per length): of the type "aij", or, where one number such as the length
        of a cable or a sealed volume couples very many unknowns, of the type "lrc", the sum of
        `sparse` and of few dyads.
    sparse
        Without these dyads, of the type "aij", of which preconditioners can be made; the same as
        `matrix` if there are none.
    inexact
        Names of what has other second derivatives than are here: friction (a law of forces), the
        paper's step-wise laws, wind (its turning is missing), pressure on a rim that slides, and
        terms of your own that do not say ``exact_hessian = True``. None if all is exact.
    """

    matrix: PETSc.Mat
    sparse: PETSc.Mat
    inexact: tuple[str, ...]

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        self.matrix.destroy()
        self.sparse.destroy()


def residual(system: System) -> Residual:
    """Forces that are not balanced at a scene's current state; see `Residual`. Collective."""
    forces = nodal_forces(system)
    scene, unknowns = system.scene, system.unknowns
    membrane = fem.Function(scene.V, name="residual")
    owned = unknowns.n_vertices
    membrane.x.array[: 3 * owned] = forces[:owned].ravel()
    membrane.x.scatter_forward()
    joints: dict[str, Array] = {}
    if system.bars is not None:
        own = forces[system.bars.blocks.joint_blocks] if scene.comm.rank == 0 else None
        joints = dict(zip((j.name for j in scene.joints), scene.comm.bcast(own), strict=True))
    system.potential.evaluate()
    vector = PETSc.Vec().createMPI(
        (3 * unknowns.n_owned, 3 * unknowns.n_global), bsize=3, comm=scene.comm
    )
    system.potential.free_gradient(vector)
    return Residual(membrane, joints, vector)


def tangent(system: System) -> Tangent:
    """Second derivatives at a scene's current state; see `Tangent`. Collective."""
    system.update()
    potential = system.potential
    potential.evaluate()
    whole, sparse = exact_matrix(potential)
    inexact = {term.name: None for term in potential.terms if not term.exact_hessian}
    inexact |= {load.name: None for load in system.scene.loads if load.blows}
    return Tangent(whole, sparse, tuple(inexact))
