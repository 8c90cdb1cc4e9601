"""What a study does with a roof on a mesh: build it, and read the quantities to compare."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, as_text, raised_together
from crms_fenicsx.foundation.surface.closest_point import ON_SURFACE
from crms_fenicsx.results.membrane_results import MembraneResults
from crms_fenicsx.results.places import Places, nearest_places
from crms_fenicsx.solver import Solver

Build = Callable[[MembraneMesh], Solver]
"""Function that makes scene and solver on a mesh, applies the loads and returns the solver."""


def built(study: str, build: Build, mesh: MembraneMesh) -> Solver:
    """The solver built on a mesh, in equilibrium. Collective."""
    with raised_together(mesh.comm):
        if not callable(build):
            raise InputError(f"{study}: build = {build!r} is not a function.")
        solver = build(mesh)
        if not isinstance(solver, Solver):
            raise InputError(f"{study}: build returned {solver!r}, expected a Solver.")
    solver.scene.require_equilibrium(study)
    return solver


ALL = "membrane"
"""Name of the whole membrane as a part."""

Value = tuple[float, float]
"""A value and its reference size."""


class Quantities:
    """Quantities compared besides energy and tensions: the checked arguments of `convergence`."""

    def __init__(
        self,
        scene: Scene,
        points: Mapping[str, Sequence[float]] | None,
        reactions: Sequence[str],
        stresses: Sequence[str],
        others: Mapping[str, Callable[[Solver], float]] | None,
    ) -> None:
        for name, given in (("points", points), ("quantities", others)):
            if given is not None:
                checks.collection(f"convergence: {name}", given, Mapping, f'{name}={{"a": ...}}')
        for name, groups in (("reactions", reactions), ("stresses", stresses)):
            checks.collection(f"convergence: {name}", groups, Sequence, f'{name}=["..."]')
        self.points = {
            name: checks.vector(f"convergence: the point {name!r}", place)
            for name, place in checks.in_one_order(scene.comm, points or {}).items()
        }
        self.reactions, self.stresses = reactions, stresses
        self.others = checks.in_one_order(scene.comm, others or {})
        if self.points:
            _refuse_off(scene, self.points)
        for group in reactions:
            scene.vertices(group)
        known = {ALL: (), **scene.mesh.parts}
        for part in stresses:
            checks.named("part", known, part)
        for name, function in self.others.items():
            if not callable(function):
                raise InputError(
                    f"convergence: the quantity {name!r} is {function!r}, expected a function of a "
                    "solver that returns a number."
                )

    def of(self, solver: Solver) -> dict[str, Value]:
        """Values of a solver's state by name. Collective."""
        scene = solver.scene
        size = sum(map(abs, scene.energies.values()))
        found: dict[str, Value] = {"energy": (scene.energy, size)}
        tensions = [cable.tension for cable in scene.cables]
        greatest = max(tensions, default=0.0)
        if len(tensions) > 1:
            found["mean tension"] = (float(np.mean(tensions)), greatest)
            found["greatest tension"] = (greatest, greatest)
        for cable in scene.cables:
            found[f"tension {cable.name}"] = (cable.tension, greatest)
        if self.points:
            moved = displacements(scene, np.array(list(self.points.values())))
            for name, vector in zip(self.points, moved, strict=True):
                found |= _components(f"displacement {name}", np.asarray(vector))
        for group in self.reactions:
            forces = solver.reactions(group)
            size = float(np.abs(forces.forces).sum()) if len(forces.forces) else 0.0
            size = scene.comm.allreduce(size)
            found |= _components(f"reaction {group}", forces.total, size)
        if self.stresses:
            found |= self._stresses(scene.comm, solver.results())
        for name, function in self.others.items():
            found[name] = (checks.finite(f"convergence: {name!r}", function(solver)), 0.0)
        return found

    def _stresses(self, comm: MPI.Intracomm, results: MembraneResults) -> dict[str, Value]:
        found: dict[str, Value] = {}
        for part in self.stresses:
            cells = results.parts[part] if part != ALL else slice(None)
            forces, areas = results.true_forces[cells, 0], results.areas[cells]
            total, area = comm.allreduce(np.array([forces @ areas, areas.sum()]))
            most = comm.allreduce(float(forces.max(initial=-np.inf)), op=MPI.MAX)
            found[f"mean section force {part}"] = (float(total / area), 0.0)
            found[f"greatest section force {part}"] = (most, 0.0)
        return found


def _components(name: str, vector: Array, size: float = 0.0) -> dict[str, Value]:
    size = max(size, float(np.linalg.norm(vector)))
    return {f"{name} {axis}": (float(x), size) for axis, x in zip("xyz", vector, strict=True)}


def displacements(scene: Scene, points: Array) -> Array:
    """Displacements (length) at the stress-free places nearest to points (k, 3). Collective."""
    found = _nearest(scene, points)
    return found.positions - found.stress_free


def _nearest(scene: Scene, points: Array) -> Places:
    return nearest_places(scene.comm, current_surface(scene.net), points, "stress-free")


def _refuse_off(scene: Scene, points: Mapping[str, Array]) -> None:
    """Raise `InputError` for points off the stress-free surface. Collective."""
    found = _nearest(scene, np.array(list(points.values())))
    for k, (name, place) in enumerate(points.items()):
        if found.gaps[k] > ON_SURFACE:
            nearest = found.stress_free[k]
            raise InputError(
                f"convergence: the point {name!r} at {as_text(place)} is "
                f"{np.linalg.norm(nearest - place):.6g} off the stress-free surface; the nearest "
                f"place on it is {as_text(nearest)}."
            )
