"""Derivatives of results by lengths, loads and stiffnesses, from the exact tangent.

With the gradient g of the potential energy and the tangent K, a parameter p moves the equilibrium
by du/dp = -K^-1 dg/dp, one solve each with the factors of K. A result changes with p directly and
through du. Contacts and the cells that cables cross are kept, and so is whether parts of cables are
taut or slack. Where parts are about to become taut or slack, derivatives for an increase and for a
decrease of p differ (see `taut_parts`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.steps.loading import checked_target
from crms_fenicsx.energy.minimization.augmented_stiffness import AugmentedStiffness
from crms_fenicsx.energy.minimization.initial_hessian import Preconditioner
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.bar import PlacedBar
from crms_fenicsx.model.laid_cable import CableEnd, LaidCable
from crms_fenicsx.results.reactions import tangent
from crms_fenicsx.results.taut_parts import TautParts, Tightening

STEP = 1e-5
"""Relative change of a length or stiffness in finite differences of gradients and results."""
ROUNDING = 100 * EPSILON
"""Rounding error of results, relative to their size."""


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of results by parameters.

    Attributes
    ----------
    values : (n, m)
        Derivatives of the n results by the m parameters, the same on all ranks: means of the two
        below.
    increasing, decreasing : (n, m)
        Derivatives for an increase and for a decrease of the parameters. They differ where parts of
        cables, or guys, are about to become taut or slack, as those of belts laid without force.
    of, by
        Results and parameters, as given.
    inexact
        Names of loads and terms without an exact tangent, which make the derivatives inexact.
    one_sided
        Names of cables and guys that make the derivatives for an increase and a decrease differ, by
        parts that become taut or slack. Both hold the derivative with slack cables for cables that
        slide sideways, and the one with all parts taut where only guys and belts without force make
        the equilibrium stable.
    """

    values: Array
    increasing: Array
    decreasing: Array
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
    system.update()
    setters = [_parameter(system, one) for one in by]
    rubs = scene.net.has_friction or any(
        c.state.law.axial is not None or c.may_slip for c in scene.cables
    )
    if rubs or system.has_history:
        what = "friction" if rubs else "a step-wise law"
        raise InputError(
            f"sensitivities: {what} makes the state path-dependent, so it has no derivatives; "
            "compare load steps instead."
        )
    parts = TautParts(system)
    try:
        try:
            return _differentiated(system, parts, of, by, setters)
        except InputError:  # unstable without the parts about to become taut
            if not parts.owners:
                raise
            parts.settle()
            return _differentiated(system, parts, of, by, setters)
    finally:
        parts.release()


def _differentiated(
    system: System,
    parts: TautParts,
    of: Sequence[object],
    by: Sequence[object],
    setters: Sequence[Setter],
) -> Sensitivities:
    """Derivatives with the parts of cables and guys that are taut. Collective."""
    scene = system.scene
    read = [_result(scene, one, parts) for one in of]
    K = tangent(system)
    solver = _TangentSolver(K.matrix, K.sparse)
    try:
        changes = _Changes(system, read, parts)
        both, named = _by_parameters(changes, solver, of, setters)
    finally:
        solver.destroy()
        K.destroy()
    named |= parts.settled
    names = [cable.name for cable in scene.cables] + [bar.name for bar in scene.bars]
    one_sided = tuple(name for name in names if name in named)
    return Sensitivities(
        both.mean(axis=0), both[0], both[1], tuple(of), tuple(by), K.inexact, one_sided
    )


def _by_parameters(
    changes: _Changes, solver: _TangentSolver, of: Sequence[object], setters: Sequence[Setter]
) -> tuple[Array, set[str]]:
    """Derivatives with one solve per parameter, for its increase and its decrease, (2, n, m), and
    the names of the cables that make them differ."""
    parts, named = changes.parts, set[str]()
    tightening = Tightening(parts, solver.solve) if len(parts.owners) else None
    both = np.zeros((2, len(of), len(setters)))
    for j, setter in enumerate(setters):
        slope, shortened = changes.slope(setter)
        way = solver.solve(slope)
        if tightening is None:
            both[:, :, j], _ = changes.along(setter, way)
            named |= changes.stretched
        else:
            turned, rounding = [], np.zeros(len(of))
            for k, sign in enumerate((1.0, -1.0)):
                moved, taut = tightening.of(way, shortened, sign)
                parts.choose(taut)
                both[k, :, j], errors = changes.along(setter, sign * moved)
                turned.append(taut)
                rounding += errors
                named |= changes.stretched
            parts.choose(np.zeros(len(parts.owners), dtype=bool))
            energy = [one == "energy" for one in of]  # its first derivatives have no jumps
            both[:, energy, j] = both[:, energy, j].mean(axis=0)
            same = 1e-6 * np.abs(both[:, :, j]).max(axis=0) + rounding
            if np.any(np.abs(both[0, :, j] - both[1, :, j]) > same):
                own = np.flatnonzero(turned[0] != turned[1])
                named |= {parts.owners[i].name for i in own}
    return both, named


Setter = tuple[Callable[[float], None], float]
"""Function that changes a parameter by a number, and its step for differences."""


class _Changes:
    """Effects of parameters on a scene's equilibrium, by central differences. Collective.

    Attributes: `stretched`: names of loose cables that the last change would tighten or loosen.
    """

    def __init__(
        self, system: System, read: Sequence[Callable[[], float]], parts: TautParts
    ) -> None:
        self.system, self.scene, self.read = system, system.scene, read
        self.parts, self.stretched = parts, set[str]()
        self.state = system.scene.state
        self.start = system.potential.x.copy()

    def restore(self) -> None:
        """Return to the state in which the derivatives are taken."""
        self.scene.state = self.state
        self.system.membrane.energy.renew_materials()

    def slope(self, setter: Setter) -> tuple[Array, Array]:
        """Derivatives by a parameter: of the forces -g in the free components, (3 n_owned,), and
        of minus the unstressed lengths of the parts about to become taut."""
        change, step = setter
        slopes, lengths = [], []
        for sign in (1.0, -1.0):
            change(sign * step)
            self.system.read_scene()
            self.system.potential.evaluate()
            self.system.potential.free_gradient(self.system.potential.g_vector)
            slopes.append(self.system.potential.g_vector.array.copy())
            lengths.append(self.parts.unstressed_lengths())
            self.restore()
        slope, shortened = (np.asarray((two[1] - two[0]) / (2 * step)) for two in (slopes, lengths))
        return slope, shortened

    def along(self, setter: Setter, way: Array) -> tuple[Array, Array]:
        """Derivatives of the results by a parameter that moves the unknowns along `way`, (n,), and
        bounds of their rounding errors."""
        (change, step), system = setter, self.system
        comm, n = self.scene.comm, system.unknowns.n_owned
        far = comm.allreduce(float(np.abs(way).max(initial=0.0)), op=MPI.MAX)
        size = min(step, 1e-6 * self.scene.membrane.size / max(far, 1e-300))
        place = system.potential.x_vector.duplicate()
        found, excess = [], []
        for sign in (1.0, -1.0):
            change(sign * size)
            system.read_scene()
            place.array[:] = self.start[:n].ravel() + sign * size * way
            system.potential.place(place)
            system.potential.sum_up()
            system.write_scene()
            found.append(np.array([one() for one in self.read]))
            excess.append(np.array([cable.length - cable.L0 for cable in self.parts.loose]))
            self.restore()
        place.destroy()
        grown = np.abs(excess[0] - excess[1])
        loose = zip(self.parts.loose, grown, strict=True)
        self.stretched = {cable.name for cable, much in loose if much > ROUNDING * cable.L0}
        slope = np.asarray((found[0] - found[1]) / (2 * size))
        return slope, np.asarray(ROUNDING * np.abs(found[0]) / size)


class _TangentSolver:
    """Solver of the tangent, factorised with the tensions of the cables' parts as extra unknowns.
    Collective."""

    def __init__(self, whole: PETSc.Mat, sparse: PETSc.Mat) -> None:
        self._ksp, self._factors = PETSc.KSP().create(whole.comm), None
        self._b, self._y = whole.createVecs()
        self._ksp.setOperators(whole, sparse)
        self._ksp.setType(PETSc.KSP.Type.GMRES)
        self._ksp.setTolerances(rtol=1e-11, max_it=50)
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
                "sensitivities: the tangent is singular here, as at the onset of "
                "snap-through; use another state."
            )
        return np.array(self._y.array_r)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for one in (self._ksp, self._b, self._y):
            one.destroy()
        if self._factors is not None:
            self._factors.destroy()


def _result(scene: Scene, one: object, parts: TautParts) -> Callable[[], float]:
    """Function that evaluates a result of the scene."""
    if isinstance(one, LaidCable) and one in scene.cables:
        return lambda: one.tension
    if isinstance(one, PlacedBar) and one in scene.bars:
        return lambda: parts.force(one)
    if isinstance(one, CableEnd) and one.cable in scene.cables:
        _ = one.reaction  # refuses ends without
        k = 0 if one.which == "start" else -1
        return lambda: float(one.cable.part_tensions[k])
    if isinstance(one, str) and one in ("energy", "volume"):
        return lambda: float(getattr(scene, one))
    if isinstance(one, tuple) and len(one) == 2 and one[1] in ("x", "y", "z"):
        vertex, axis = one
        return lambda: float(scene.frame.place_of(vertex)["xyz".index(axis)])
    raise InputError(
        f"sensitivities: of has {one!r}; pass cables and bars (their forces), ends of cables (the "
        'size of their reactions), "energy", "volume", or (vertex, "z") of scene.vertex_at(...).'
    )


def _temperature(system: System, name: str) -> Callable[[float], None]:
    """Function that changes the factor of a temperature load by a number."""
    scene = system.scene
    fabric = any(load.name == name for k in scene.materials for load, _ in scene.loads.warmings(k))
    if fabric and (system.folds is not None or system.shifts is not None):
        raise InputError(
            f"sensitivities: by has {name!r}, which changes the temperature of fabric that cables "
            "fold or slide over; compare load steps instead, or hold the cables in pockets along "
            "lines of the mesh."
        )

    def change_temperature(change: float) -> None:
        target = checked_target(scene, load={name: scene.factors[name] + change})
        target.apply(scene, scene.state, 0.0, 1.0)
        system.membrane.energy.renew_materials()

    return change_temperature


def _parameter(system: System, one: object) -> Setter:
    """Function that changes a parameter of the scene by a number, and its step."""
    scene = system.scene
    if isinstance(one, LaidCable) and one in scene.cables:
        return (lambda change: one.update(L0=one.L0 + change)), STEP * one.L0
    if isinstance(one, PlacedBar) and one in scene.bars:
        return (lambda change: one.update(L0=one.L0 + change)), STEP * one.L0
    if one == "pressure" and scene.air.sealed is None:
        return (lambda change: scene.air.update(pressure=scene.pressure + change)), max(
            STEP, STEP * abs(scene.pressure)
        )
    if isinstance(one, str) and any(load.name == one and load.warms for load in scene.loads):
        return _temperature(system, one), STEP
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
        f"sensitivities: by has {one!r}; pass cables and bars (their unstressed lengths), "
        '"pressure" where the air is not sealed, names of loads, or ("EA", cable).'
    )
