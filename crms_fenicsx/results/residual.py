"""Residual and tangent of a scene's energy, for coupled solvers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.minimization.initial_hessian import stiffen_across_edge_sliders
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.dofs.block_patterns import StiffnessMatrix
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.reactions import nodal_forces


@dataclass(frozen=True)
class Residual:
    """Unbalanced forces, the gradient of the potential energy.

    Attributes
    ----------
    membrane
        On the membrane's vertices (force), a function on `Scene.V`, ghosts included. At supports:
        the support forces.
    joints
        On the joints (force), (3,), by name, on all ranks.
    vector
        On all unknowns (force), zero for held ones. Each rank stores the membrane's vertices first,
        in the order of the owned degrees of freedom of `Scene.V`, then cable points; the first rank
        stores joints last. Without cables and joints it is a vector of `Scene.V`.
    """

    membrane: fem.Function
    joints: dict[str, Array]
    vector: PETSc.Vec

    def destroy(self) -> None:
        """Free the vector. Collective."""
        self.vector.destroy()


@dataclass(frozen=True)
class Tangent:
    """Tangent stiffness, for the unknowns of `Residual.vector`.

    Rows and columns of held unknowns are those of the identity.

    Attributes
    ----------
    matrix
        Second derivatives of the potential energy (force per length): of type "aij"; or, where one
        quantity such as a cable length or a sealed volume couples very many unknowns, of type
        "lrc", the sum of `sparse` and a few dyads.
    sparse
        The tangent without these dyads, of type "aij", for preconditioners; identical to `matrix`
        if there are none.
    inexact
        Names of terms with an inexact tangent: friction (a law of forces), the paper's step-wise
        laws, wind (its turning is missing), pressure on a sliding rim, and your own terms
        without ``exact_hessian = True``. None if all is exact.
    """

    matrix: PETSc.Mat
    sparse: PETSc.Mat
    inexact: tuple[str, ...]

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        self.matrix.destroy()
        self.sparse.destroy()


def residual(system: System) -> Residual:
    """Unbalanced forces in a scene's present state; see `Residual`. Collective."""
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
    """Tangent stiffness in a scene's present state; see `Tangent`. Collective."""
    system.update()
    potential = system.potential
    potential.evaluate()
    whole, sparse = _exact_matrix(potential)
    inexact = {term.name: None for term in potential.terms if not term.exact_hessian}
    inexact |= {load.name: None for load in system.scene.loads if load.is_active_wind}
    return Tangent(whole, sparse, tuple(inexact))


def _exact_matrix(potential: Potential) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Second derivatives at the potential's current state, which must be evaluated, as
    `Tangent.matrix` and `Tangent.sparse`. Rows and columns of held components, of those across edge
    sliders and of points that no term touches are the identity's."""
    unknowns = potential.unknowns
    n, held = unknowns.n_owned, unknowns.held[: unknowns.n_owned]
    stiffness = StiffnessMatrix(unknowns, potential.patterns())
    potential.add_stiffness(stiffness, exact=True)
    stiffness.assemble()
    A = stiffness.petsc
    if unknowns.comm.allreduce(unknowns.n_edge_sliders):
        stiffen_across_edge_sliders(A, unknowns, 1.0)
    diagonal = A.getDiagonal()
    idle = ~diagonal.array.reshape(-1, 3).any(axis=1)
    idle[: unknowns.n_vertices] = False
    diagonal.destroy()
    rows = np.flatnonzero(held | idle[:, None]) + 3 * unknowns.start
    A.zeroRowsColumns(rows.astype(PETSc.IntType), diag=1.0)
    stiffnesses, columns = potential.dyad_columns(held, exact=True)
    if not len(stiffnesses):
        return A, A
    size = ((3 * n, 3 * unknowns.n_global), (None, len(stiffnesses)))
    U = PETSc.Mat().createDense(size, array=columns, comm=unknowns.comm)
    values = PETSc.Vec().createWithArray(stiffnesses, comm=PETSc.COMM_SELF)
    whole = PETSc.Mat().createLRC(A, U, values, U)
    U.destroy()
    values.destroy()
    return whole, A
