"""Derivatives of results by lengths, loads and stiffnesses, from the exact tangent.

With the gradient g of the potential energy and the tangent K, a parameter p moves the equilibrium
by du/dp = -K^-1 dg/dp, one solve each with the factors of K. A result changes with p directly and
through du. With fewer results than parameters, one solve per result is used instead, K^-1 grad(R).
Contacts and the cells that cables cross are kept: where a cable is about to change them,
derivatives are one-sided.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.minimization.augmented_stiffness import AugmentedStiffness
from crms_fenicsx.minimization.initial_hessian import Preconditioner
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.results.residual import tangent
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene

STEP = 1e-5
"""Relative change of a length or stiffness in finite differences of gradients and results."""
MOVE = 1e-6
"""Largest movement of a point, relative to the membrane's size, in differences of results."""
SOLVED, ITERATIONS = 1e-11, 50
"""Relative residual of the tangent solves, and largest number of iterative refinements."""
NEAR_VERTEX = 0.02
"""Part of an edge within which a cable is about to pass a vertex."""


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of results by parameters.

    Attributes
    ----------
    values : (n, m)
        Derivatives of the n results by the m parameters, the same on all ranks.
    Results and parameters, as given.
        The results and the parameters, as they were given.
    inexact
        Names of loads and terms without an exact tangent, which make the derivatives inexact.
    one_sided
        Names of cables that touch a mesh vertex, or nearly so, and are about to pass it.
    """

    values: Array
    of: tuple[object, ...]
    by: tuple[object, ...]
    inexact: tuple[str, ...]
    one_sided: tuple[str, ...]

    def __getitem__(self, pair: tuple[object, object]) -> float:
        """The derivative of a result by a parameter."""
        result, parameter = pair
        return float(self.values[self.of.index(result), self.by.index(parameter)])


def sensitivities(system: System, of: Sequence[object], by: Sequence[object]) -> Sensitivities:
    """Derivatives at a scene's equilibrium; see `Solver.sensitivities`. Collective."""
    scene = system.scene
    setters = [_parameter(scene, one) for one in by]
    K = tangent(system)
    rubs = scene.net.has_friction or any(c.axial is not None or c.may_slip for c in scene.cables)
    if rubs or system.has_history:
        K.destroy()
        what = "friction" if rubs else "a step-wise law"
        raise InputError(
            f"sensitivities: {what} depends on the way here, so that there are no derivatives; "
            "compare load steps instead."
        )
    solver = _TangentSolver(K.matrix, K.sparse)
    changes = _Changes(system, [_result(scene, one) for one in of])
    try:
        if len(of) < len(by) and all(_has_slope(scene, one) for one in of):
            values = _by_results(changes, solver, of, setters)
        else:
            values = np.zeros((len(of), len(by)))
            for j, setter in enumerate(setters):
                way = solver.solve(changes.slope(setter))
                values[:, j] = changes.along(setter, way)
    finally:
        changes.restore()
        solver.destroy()
        K.destroy()
    return Sensitivities(values, tuple(of), tuple(by), K.inexact, _near_vertices(scene))


Setter = tuple[Callable[[float], None], float]
"""Function that changes a parameter by a number, and its step for differences."""


class _Changes:
    """Effects of parameters on a scene's equilibrium, by central differences. Collective."""

    def __init__(self, system: System, read: Sequence[Callable[[], float]]) -> None:
        self.system, self.scene, self.read = system, system.scene, read
        self.state = system.scene.state
        self.start = system.potential.x.copy()

    def slope(self, setter: Setter) -> Array:
        """Derivatives of the forces -g by a parameter, in the free components, (3 n_owned,)."""
        change, step = setter
        slopes = []
        for sign in (1.0, -1.0):
            change(sign * step)
            self.system.read_scene()
            self.system.potential.evaluate()
            self.system.potential.free_gradient(self.system.potential.g_vector)
            slopes.append(self.system.potential.g_vector.array.copy())
            self.scene.state = self.state
        return np.asarray((slopes[1] - slopes[0]) / (2 * step))

    def along(self, setter: Setter, way: Array) -> Array:
        """Derivatives of the results by a parameter that moves the unknowns along `way`, (n,)."""
        (change, step), system = setter, self.system
        comm, n = self.scene.comm, system.unknowns.n_owned
        far = comm.allreduce(float(np.abs(way).max(initial=0.0)), op=MPI.MAX)
        size = min(step, MOVE * self.scene.membrane.size / max(far, 1e-300))
        place = system.potential.x_vector.duplicate()
        found = []
        for sign in (1.0, -1.0):
            change(sign * size)
            system.read_scene()
            place.array[:] = self.start[:n].ravel() + sign * size * way
            system.potential.place(place)
            system.potential.sum_up()
            system.write_scene()
            found.append(np.array([one() for one in self.read]))
            self.scene.state = self.state
        place.destroy()
        return np.asarray((found[0] - found[1]) / (2 * size))

    def restore(self) -> None:
        """Restore the equilibrium."""
        self.scene.state = self.state
        self.system.read_scene()


def _by_results(
    changes: _Changes, solver: _TangentSolver, of: Sequence[object], setters: Sequence[Setter]
) -> Array:
    """Derivatives with one solve per result: ``dR/dp - grad(R) K^-1 dg/dp``."""
    still = np.zeros(3 * changes.system.unknowns.n_owned)
    adjoints = [solver.solve(_slope_of(changes, one)) for one in of]
    values = np.zeros((len(of), len(setters)))
    for j, setter in enumerate(setters):
        work = np.array(adjoints) @ changes.slope(setter)
        values[:, j] = changes.along(setter, still) + changes.scene.comm.allreduce(work)
    return values


def _has_slope(scene: Scene, one: object) -> bool:
    """Whether `_slope_of` supports a result."""
    cable = one.cable if isinstance(one, CableEnd) else one
    if isinstance(cable, LaidCable):
        return cable.taut
    return one != "volume" or scene.air.sealed is None


def _slope_of(changes: _Changes, one: object) -> Array:
    """Derivatives of a result by the unknowns, in the free components, (3 n_owned,): by Maxwell's
    reciprocity, the forces' derivatives by the conjugate parameter. The energy's derivatives are
    -(T + T^2/(2 EA)) by an unstressed length and -V by the pressure."""
    scene, slope = changes.scene, np.zeros(3 * changes.system.unknowns.n_owned)
    if isinstance(one, CableEnd | LaidCable):
        cable = one if isinstance(one, LaidCable) else one.cable
        if cable.parts is not None:
            end = one.which if isinstance(one, CableEnd) else None
            return changes.slope(_part_lengths(cable, end))
        one = cable
    if isinstance(one, LaidCable):
        return np.asarray(changes.slope(_parameter(scene, one)) / (1 + one.tension / one.cable.EA))
    if isinstance(one, PlacedBar):
        return np.asarray(changes.slope(_parameter(scene, one)) / (1 + one.force / one.bar.EA))
    if one == "volume":
        return changes.slope(_parameter(scene, "pressure"))
    if isinstance(one, tuple):
        vertex, axis = one
        rank, dof = scene.frame.home(vertex)
        at = 3 * dof + "xyz".index(axis)
        if rank == scene.comm.rank and not scene.held.ravel()[at]:
            slope[at] = 1.0
    return slope


def _part_lengths(cable: LaidCable, end: str | None) -> Setter:
    """Setter of the unstressed lengths of a cable's parts between clamps or bonds whose gradient is
    that of the mean tension, or of the tension at an end."""
    assert cable.parts is not None
    lengths, parts = cable.part_lengths, cable.parts
    weights = lengths / cable.L0
    if end is not None:
        weights = np.zeros(len(lengths))
        weights[0 if end == "start" else -1] = 1.0
    step = STEP * float(lengths[weights > 0.0].sum())
    weights = weights / (1 + parts.tensions / cable.cable.EA)

    def change(size: float) -> None:
        passed = np.cumsum(lengths + size * weights)
        cable.update(L0=float(passed[-1]), parts=replace(parts, at=passed[:-1] / passed[-1]))

    return change, step


class _TangentSolver:
    """Solver of the tangent, factorised with the tensions of the cables' parts as extra unknowns.
    Collective."""

    def __init__(self, whole: PETSc.Mat, sparse: PETSc.Mat) -> None:
        self._ksp, self._factors = PETSc.KSP().create(whole.comm), None
        self._b, self._y = whole.createVecs()
        self._ksp.setOperators(whole, sparse)
        self._ksp.setType(PETSc.KSP.Type.GMRES)
        self._ksp.setTolerances(rtol=SOLVED, max_it=ITERATIONS)
        pc = self._ksp.getPC()
        if whole.getType() != PETSc.Mat.Type.LRC:
            pc.setType(PETSc.PC.Type.LU)
            pc.setFactorSolverType("mumps")
            return
        _, columns, values, _ = whole.getLRCMats()
        self._factors = AugmentedStiffness(sparse, "crms_tangent_")
        self._factors.factorize(columns.getDenseArray() * np.sqrt(values.array_r))
        pc.setType(PETSc.PC.Type.PYTHON)
        pc.setPythonContext(Preconditioner(self._factors.solve))

    def solve(self, b: Array) -> Array:
        """This rank's part of the solution of ``K y = b``, or an `InputError`."""
        self._b.array[:] = b
        self._ksp.solve(self._b, self._y)
        if self._ksp.getConvergedReason() < 0:
            raise InputError(
                "sensitivities: the tangent is singular here, as where something is about to "
                "snap through; go to another state."
            )
        return np.array(self._y.array_r)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for one in (self._ksp, self._b, self._y):
            one.destroy()
        if self._factors is not None:
            self._factors.destroy()


def _result(scene: Scene, one: object) -> Callable[[], float]:
    """Function that evaluates a result of the scene."""
    if isinstance(one, LaidCable) and one in scene.cables:
        return lambda: one.tension
    if isinstance(one, PlacedBar) and one in scene.bars:
        return lambda: one.force
    if isinstance(one, CableEnd) and one.cable in scene.cables:
        return lambda: float(np.linalg.norm(one.reaction))
    if isinstance(one, str) and one in ("energy", "volume"):
        return lambda: float(getattr(scene, one))
    if isinstance(one, tuple) and len(one) == 2 and one[1] in ("x", "y", "z"):
        vertex, axis = one
        return lambda: float(scene.frame.place_of(vertex)["xyz".index(axis)])
    raise InputError(
        f"sensitivities: of has {one!r}; give cables and bars (their forces), ends of cables (the "
        'size of their reactions), "energy", "volume", or (vertex, "z") of scene.vertex_at(...).'
    )


def _parameter(scene: Scene, one: object) -> Setter:
    """Function that changes a parameter of the scene by a number, and its step."""
    if isinstance(one, LaidCable) and one in scene.cables:
        return (lambda change: one.update(L0=one.L0 + change)), STEP * one.L0
    if isinstance(one, PlacedBar) and one in scene.bars:
        return (lambda change: one.update(L0=one.L0 + change)), STEP * one.L0
    if one == "pressure" and scene.air.sealed is None:
        return (lambda change: scene.air.update(pressure=scene.pressure + change)), max(
            STEP, STEP * abs(scene.pressure)
        )
    if isinstance(one, str) and one in [load.name for load in scene.loads]:

        def change_load(change: float) -> None:
            scene.loads.replace_each(
                lambda load: replace(load, factor=load.factor + change * (load.name == one))
            )

        return change_load, STEP
    if isinstance(one, tuple) and len(one) == 2 and one[0] == "EA":
        cable = one[1]
        if isinstance(cable, LaidCable) and cable in scene.cables:
            EA = cable.cable.EA
            return (
                lambda change: cable.update(cable=replace(cable.cable, EA=cable.cable.EA + change))
            ), STEP * EA
    raise InputError(
        f"sensitivities: by has {one!r}; give cables and bars (their unstressed lengths), "
        '"pressure" where the air is not sealed, names of loads, or ("EA", cable).'
    )


def _near_vertices(scene: Scene) -> tuple[str, ...]:
    """Names of taut cables that touch an interior vertex of the mesh, or nearly so."""
    found = []
    for cable in scene.cables:
        s = cable.fractions[~cable.lifted]
        if cable.taut and np.any(np.minimum(s, 1 - s) < NEAR_VERTEX):
            found.append(cable.name)
    return tuple(found)
