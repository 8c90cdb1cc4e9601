"""The user's function that builds a roof on a mesh."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.solver import Solver

Build = Callable[[MembraneMesh], Solver]
"""Function that makes scene and solver on a mesh, applies the loads and returns the solver."""


def comm_of(study: str, mesh: MembraneMesh) -> MPI.Intracomm:
    """Communicator of a checked mesh."""
    checks.of_type(f"{study}: mesh", mesh, MembraneMesh)
    return mesh.comm


def built(study: str, build: Build, mesh: MembraneMesh) -> Solver:
    """The solver built on a mesh, in equilibrium. Collective."""
    with raised_together(mesh.comm):
        if not callable(build):
            raise InputError(
                f"{study}: build = {build!r} is no function; give one of a mesh that returns a "
                "Solver."
            )
        solver = build(mesh)
        if not isinstance(solver, Solver):
            raise InputError(f"{study}: build returned {solver!r}; return a Solver.")
    solver.scene.require_equilibrium(study)
    return solver
