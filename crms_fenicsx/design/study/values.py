"""Quantities of an equilibrium compared between meshes, and their error bars.

Errors fall with the square of the cell size where the mesh resolves the solution. Halving the cells
then leaves a third of the last difference d (L. F. Richardson, 1911). The order of the last two
differences shows whether this holds. The error bar is P. J. Roache's (Perspective: a method for
uniform reporting of grid refinement studies, 1994) with the factors of safety of L. Eca and M.
Hoekstra (A procedure for the estimation of the numerical uncertainty of CFD calculations based on
grid refinement studies, 2014): the error at the observed order, times 1.25 if that is near the
expected order, else times 3. As differences may be consistent, or small, by chance, values without
an order, or that changed direction, get three times the largest error of all differences, each
reduced to the finest level with order 2. `docs/benchmarks/cable_accuracy.md` tells how often bars
contain known limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.foundation.surface.closest_point import ON_SURFACE
from crms_fenicsx.results.membrane_results import MembraneResults
from crms_fenicsx.results.places import Places, nearest_places
from crms_fenicsx.solver import Solver

ORDER = 2.0
REGULAR = (1.2, 3.0)
"""Observed orders at which the levels are taken to converge with order 2."""
NEAR, SAFE, SAFER = 0.3, 1.25, 3.0
"""Distance from order 2 up to which the first of the two safety factors applies."""
FAR = 0.3
"""Relative difference above which the first level is too coarse."""
SAME = 1e-7
"""Differences, relative to the largest value, due to the solver's tolerance."""


@dataclass(frozen=True)
class Quantity:
    """A number on several meshes and its limit.

    Attributes
    ----------
    values
        Values from the coarsest mesh to the finest.
    limit, bar
        Value extrapolated to fine meshes, and its error bar: it held the exact value in 19 of 20
        cases with a known limit.
    order
        Order of convergence on the last three levels; NaN without one.
    regular
        Whether the bar relies on the order; else it is as wide as the levels scatter.
    remark
        Remark for the table.
    size
        Scale of the number, such as the length of the vector that it is a component of.
    """

    values: tuple[float, ...]
    limit: float
    bar: float
    order: float
    regular: bool
    remark: str
    size: float

    @property
    def error(self) -> float:
        """Bound of the error on the first mesh."""
        return abs(self.values[0] - self.limit) + self.bar


SCATTER = 3.0
"""Error bar of scattered values relative to their range: with it, a fourth value of a normal
distribution lies in the bar about one of three with 95 %."""


def extrapolated(values: Sequence[float], size: float = 0.0, scattered: bool = False) -> Quantity:
    """Extrapolate values on two or more levels, each with half the previous cell size; `scattered`:
    of states that may be one of several equilibria."""

    def found(limit: float, bar: float, order: float, regular: bool, remark: str) -> Quantity:
        whole = max(size, abs(limit))
        return Quantity(tuple(values), limit, bar, order, regular, remark, whole)

    differences = [b - a for a, b in pairwise(values)]
    d, finest, scale = differences[-1], values[-1], max(size, *map(abs, values))
    least = SAME * scale
    if max(map(abs, differences)) <= least:
        return found(finest, least, math.nan, True, "the same on all levels")
    limit = finest + d / (2**ORDER - 1)
    if len(differences) == 1:
        return found(limit, abs(d), math.nan, False, "two levels show no order: 2 assumed")
    errors = [abs(x) / (2**ORDER - 1) / 2 ** (k * ORDER) for k, x in enumerate(differences[::-1])]
    widest, before = max(SAFER * max(errors), least), differences[-2]
    if scattered and (before * d <= 0.0 or abs(d) >= abs(before)):
        widest = max(widest, SCATTER * (max(values) - min(values)))
        remark = "no order: mostly wrinkled, with several equilibria"
        return found(finest, widest, math.nan, False, remark)
    if before * d <= 0.0:
        remark = "no order: the levels go to and fro"
        return found(finest, widest, math.nan, False, remark)
    order, remark = math.log2(before / d), ""
    if order <= 0.0:
        remark, widest = "no order: differences grow", max(widest, abs(d) + abs(before))
    elif order < REGULAR[0]:
        remark = "low order"
    elif order > REGULAR[1]:
        remark = "order too high: the coarsest is too coarse"
    elif abs(before) > FAR * scale:
        remark = "the coarsest is too coarse"
    elif any(a * b < 0.0 for a, b in pairwise(differences)):
        remark = "no order: coarser levels go to and fro"
    if remark:
        return found(limit, widest, order, False, remark)
    error = abs(d) / (2 ** min(order, ORDER) - 1)
    bar = (SAFE if abs(order - ORDER) < NEAR else SAFER) * error
    return found(limit, max(bar, least), order, True, "")


ALL = "membrane"
"""Name of the whole membrane as a part."""

Value = tuple[float, float]
"""A value and its reference size."""


@dataclass(frozen=True)
class Quantities:
    """Quantities compared besides energy and tensions; see `convergence`."""

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
        """Checked arguments of `convergence`. Collective."""
        for name, given in (("points", points), ("quantities", others)):
            example = f'{name}={{"middle": ...}}'
            checks.collection(
                f"convergence: {name}", {} if given is None else given, Mapping, example
            )
        for name, groups in (("reactions", reactions), ("stresses", stresses)):
            checks.collection(f"convergence: {name}", groups, Sequence, f'{name}=["..."]')
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
