"""Numbers of an equilibrium that are compared between meshes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from mpi4py import MPI

from crms_fenicsx.cables.deformed_surface import current_surface
from crms_fenicsx.results.membrane_results import MembraneResults
from crms_fenicsx.results.places import Places, nearest_places
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError, as_text
from crms_fenicsx.scene import Scene
from crms_fenicsx.solver import Solver
from crms_fenicsx.surface.closest_point import ON_SURFACE

ALL = "membrane"
"""What names the whole membrane among its parts."""

Value = tuple[float, float]
"""A number, and the size of those of its kind."""


@dataclass(frozen=True)
class Quantities:
    """What is compared besides the energy and the tensions; see `convergence`."""

    points: Mapping[str, Array] = field(default_factory=dict)
    reactions: Sequence[str] = ()
    stresses: Sequence[str] = ()
    others: Mapping[str, Callable[[Solver], float]] = field(default_factory=dict)

    @classmethod
    def checked(
        cls,
        scene: Scene,
        points: Mapping[str, Sequence[float]] | None,
        reactions: Sequence[str],
        stresses: Sequence[str],
        others: Mapping[str, Callable[[Solver], float]] | None,
    ) -> Quantities:
        """Check what a user gives. Collective."""
        for name, given in (("points", points), ("quantities", others)):
            if given is not None and not isinstance(given, Mapping):
                raise InputError(
                    f'convergence: {name} = {given!r} has no names; write {name}={{"middle": ...}}.'
                )
        for name, groups in (("reactions", reactions), ("stresses", stresses)):
            if isinstance(groups, str) or not isinstance(groups, Sequence):
                raise InputError(
                    f"convergence: {name} = {groups!r} is no list; write {name}=[{groups!r}]."
                )
        places = {
            name: checks.vector(f"convergence: the point {name!r}", place)
            for name, place in (points or {}).items()
        }
        _refuse_off(scene, places)
        for group in reactions:
            scene.vertices(group)
        known = {ALL: (), **scene.mesh.parts}
        for part in stresses:
            checks.named("part", known, part)
        for name, function in (others or {}).items():
            if not callable(function):
                raise InputError(
                    f"convergence: the quantity {name!r} is {function!r}; give a function of a "
                    "solver that returns a number."
                )
        return cls(places, tuple(reactions), tuple(stresses), dict(others or {}))

    def of(self, solver: Solver) -> dict[str, Value]:
        """Their values in the state of a solver, by their names. Collective."""
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


def displacements(scene: Scene, places: Array) -> Array:
    """Displacements of the folded surface's stress-free places nearest to points. Collective.

    Shapes and units: places (k, 3) (length). Returns the same on all ranks (length).
    """
    found = _nearest(scene, places)
    return found.positions - found.stress_free


def _nearest(scene: Scene, places: Array) -> Places:
    return nearest_places(scene.comm, current_surface(scene.net), places, "stress-free")


def _refuse_off(scene: Scene, points: Mapping[str, Array]) -> None:
    """Raise where a point is off the stress-free surface. Collective."""
    if not points:
        return
    found = _nearest(scene, np.array(list(points.values())))
    for k, (name, place) in enumerate(points.items()):
        if found.gaps[k] > ON_SURFACE:
            nearest = found.stress_free[k]
            raise InputError(
                f"convergence: the point {name!r} at {as_text(place)} is "
                f"{np.linalg.norm(nearest - place):.6g} off the stress-free surface, nearest to "
                f"{as_text(nearest)}; give a place on it."
            )
