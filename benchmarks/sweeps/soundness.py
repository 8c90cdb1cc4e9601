"""Independent check that a solved state is an equilibrium.

For scenes on one process whose membrane is held all around in a horizontal plane.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from crms_fenicsx import Scene, Solver
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.minimization.initial_hessian import at_bounds
from crms_fenicsx.foundation.meshes.triangles import area_vectors
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.laid_cable import polyline_length
from crms_fenicsx.model.tolerances import TOL

sys.path.append(str(Path(__file__).parents[2] / "tests" / "scenes"))  # its checks of contact
from contact_checks import deepest, strongest_pull

Test = tuple[str, float, float]
"""What is looked at, its value, and how large it may be."""

BALANCE = 1e-7
"""Unbalanced force and moment of the whole structure, relative to the sum of all forces."""
RESIDUAL = 2e-7
"""Unbalanced nodal forces of a state that is taken up anew, relative to the largest of one term."""
UNLOADED = 1e-5
"""Least force that counts as one without load, relative to E t L: there all may be rounding."""
CONTACT = 2e-3
"""Pull on the membrane, relative to the tension, and depth below it, relative to the cells: normals
turn from cell to cell."""
STIFFNESS = 1e-6
"""Most negative eigenvalue of a stable state's stiffness, relative to the largest."""


def tests(solver: Solver, *, anew: bool = True, lying: bool = True) -> Iterator[Test]:
    """What must hold in every state.

    Parameters
    ----------
    solver
        After a load step.
    anew
        Whether to set up the potential again; not with friction, which counts from a load step's
        start, and only if the solver makes no more steps.
    lying
        Whether to look where cables lift off: not on membranes that plumb lines pass twice.
    """
    scene = solver.scene
    yield "not finite", float(not _finite(scene)), 0.0
    yield "below the floor", _below_floor(scene), 0.0
    yield "energy is not the sum of its parts", abs(scene.energy - solver.steps[-1].energy), 0.0
    yield from _cables(scene, lying)
    system = System(scene, "crms_anew_", solver.rtol) if anew else solver.system
    system.read_scene()
    energy, scale = system.potential.evaluate_terms()
    forces = scale
    if scene.pressure == 0.0 and not any(load.factor != 0.0 for load in scene.loads):
        moduli = [material.reference_modulus for material in scene.materials.values()]
        forces = max(scale, UNLOADED * max(moduli) * scene.membrane.size)
    if anew:
        reached = 10 * solver.steps[-1].outcome.tolerance / forces  # more where forces cancel
        yield "forces anew", _unbalanced(system) / forces, max(RESIDUAL, reached)
        size = max(abs(value) for value in scene.energies.values()) or 1.0
        yield "energy anew", abs(energy - scene.energy) / size, 1e-9
    yield from _balance(solver, system, forces)
    if anew:
        system.destroy()


def _unbalanced(system: System) -> float:
    """Norm of the free nodal forces last computed, those against a floor left out."""
    n = system.unknowns.n_owned
    free = ~system.unknowns.held[:n]
    if system.unknowns.bounds is not None:
        free &= ~at_bounds(system.potential)
    return float(np.linalg.norm(system.potential.g[:n][free]))


def _finite(scene: Scene) -> bool:
    numbers = [scene.u.x.array, np.array(list(scene.energies.values()))]
    for cable in scene.cables:
        numbers += [cable.state.positions.ravel(), np.array([cable.tension, cable.length])]
    return all(bool(np.isfinite(values).all()) for values in numbers)


def _below_floor(scene: Scene) -> float:
    if scene.floor_level is None:
        return 0.0
    return max(
        0.0, scene.floor_level - float(scene.positions()[:, 2].min()) - 1e-12 * scene.membrane.size
    )


def _cables(scene: Scene, lying: bool) -> Iterator[Test]:
    """Tensions that fit the lengths, contacts that only push."""
    for cable in scene.cables:
        length = polyline_length(cable.line)
        size = np.sqrt(np.linalg.norm(area_vectors(scene.mesh.mesh), axis=1).max() * 2)
        smoothed = 0.4 * TOL.smoothing * size * len(cable.state.nodes)
        yield "tension is negative", max(-cable.tension, 0.0), 0.0
        if not cable.taut:
            yield "slack cable too short", length / cable.L0 - 1, 1e-9
            continue
        law = cable.cable.EA * max(cable.length - cable.L0, 0.0) / cable.L0
        yield "tension and length", abs(cable.tension - law) / (law or 1.0), 1e-9
        yield "length and points", abs(cable.length - length) / (smoothed or 1.0), 1.0
        if lying and cable.tension > 0.0:
            yield "pull on the membrane", strongest_pull(scene, cable), CONTACT
            yield "depth below it", deepest(scene, cable), CONTACT


def _balance(solver: Solver, system: System, least: float) -> Iterator[Test]:
    """All outer forces on membrane and cables together, and their moments, vanish."""
    scene = solver.scene
    places, forces = [np.zeros((0, 3))], [np.zeros((0, 3))]

    def add(at: Array, force: Array) -> None:
        places.append(np.reshape(at, (-1, 3)))
        forces.append(np.reshape(force, (-1, 3)))

    supports = solver.reactions(lambda x: np.full(x.shape[1], True))
    add(supports.positions, supports.forces)
    for cable in scene.cables:
        for end, at in ((cable.start, cable.line[0]), (cable.end, cable.line[-1])):
            if cable.taut and cable.state.nodes[cable.node_of(end.which)].kind == "anchor":
                add(at, end.reaction)
    # A closed surface under uniform pressure is in equilibrium: the roof has that of its plan.
    triangles = scene.V.dofmap.list
    X = scene.V.tabulate_dof_coordinates()[triangles]
    plan = area_vectors(scene.mesh.mesh) * (0.0, 0.0, 1.0)
    centre = X.mean(axis=1)
    centre[:, 2] = X[:, :, 2].min()
    add(centre, scene.pressure * plan)
    for load in scene.loads:
        add(scene.positions(), load.factor * load.forces)
    if system.unknowns.bounds is not None:
        system.potential.evaluate()
        n = system.unknowns.n_owned
        pressed = at_bounds(system.potential)
        at = (system.unknowns.X + system.potential.x)[:n]
        add(at, np.where(pressed, system.potential.g[:n], 0.0))
    x, f = np.concatenate(places) - scene.membrane.centre, np.concatenate(forces)
    size = max(float(np.abs(f).sum()), least)
    yield "forces in balance", float(np.linalg.norm(f.sum(axis=0))) / size, BALANCE
    moment = float(np.linalg.norm(np.cross(x, f).sum(axis=0)))
    yield "moments in balance", moment / (size * scene.membrane.size), BALANCE


def least_stiffness(solver: Solver) -> Test:
    """Least eigenvalue of the stiffness by differences of the forces; negative at a saddle.

    For small meshes: two evaluations for each unknown.
    """
    system = solver.system
    system.read_scene()
    potential, unknowns = system.potential, system.unknowns
    n, step = unknowns.n_owned, 1e-6 * solver.scene.membrane.size
    free = ~unknowns.held[:n]
    if unknowns.bounds is not None:
        potential.evaluate()
        free &= ~at_bounds(potential)
    X, G = potential.x_vector.duplicate(), potential.x_vector.duplicate()
    start, u = potential.x[:n].copy(), solver.scene.u.x.array.copy()
    rows = []
    for k in np.flatnonzero(free.ravel()):
        sides = []
        for sign in (1.0, -1.0):
            X.array[:] = start.ravel()
            X.array[k] += sign * step
            potential.objective_gradient(None, X, G)
            sides.append(G.array.reshape(-1, 3)[free].copy())
        rows.append((sides[0] - sides[1]) / (2 * step))
    for vector in (X, G):
        vector.destroy()
    solver.scene.u.x.array[:] = u  # which evaluations change
    system.read_scene()
    stiffness = np.array(rows)
    values = np.linalg.eigvalsh((stiffness + stiffness.T) / 2)
    return "negative stiffness", max(0.0, -values[0] / values[-1]), STIFFNESS
