"""Look for equilibria of less energy beside that of a mostly wrinkled membrane.

The energy of a membrane without compression under pressure is not convex: it can have several
minima, as where the edge of an air cushion falls into folds, and the history of loads decides which
one is found. So the loads are also put on the unstressed membrane at once, and the best state is
displaced at random, by up to a cell, and solved again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.tolerances import SAME_VALUE, TOL

SCATTER_CHECK = "scatter of the energy"
"""Name of the check in the verification."""


@dataclass(frozen=True)
class _Scatter:
    """Difference between the state of the load history and the one of least energy found."""

    outcome: Outcome  # of the additional solves
    energy: float  # fall of the energy, relative to the sum of all its kinds; 0 without another
    distance: float  # largest distance between the two states (length)
    place: Array  # (3,) where it is, on the stress-free membrane (length)


def may_have_others(system: System) -> bool:
    """Whether other states are looked for: a mostly wrinkled membrane alone and under pressure,
    whose state does not depend on its history. Collective."""
    scene = system.scene
    parts = scene.cables or scene.frame or scene.ponds or scene.terms
    follows = scene.loads.has_wind
    if parts or follows or system.has_history or scene.floor_level is not None:
        return False
    if scene.pressure == 0.0 and scene.air.sealed is None:  # the energy is convex
        return False
    taut = np.rint(system.membrane.energy.cell_results()[:, 6]) > 1
    areas = scene.membrane.cell_areas
    sums = scene.comm.allreduce(np.array([areas.sum(), areas[~taut].sum()]))
    return bool(sums[1] > TOL.wrinkled * sums[0])


def lower_state(system: System, at_once: tuple[float, ...]) -> _Scatter:
    """Bring the scene to the state of least energy found. Collective. `at_once`: extra prestress of
    H0 for the start from the unstressed membrane; empty if that has led to the present state."""
    scene, total = system.scene, None
    first, before = scene.u.x.array.copy(), scene.energy
    scale = sum(map(abs, scene.energies.values()))
    unstressed = np.where(scene.held.ravel(), first, 0.0)
    for prestress in filter(None, (at_once, (0.0,))):
        best, energy = scene.u.x.array.copy(), scene.energy
        kicked = best + _kick(scene)
        scene.u.x.array[:] = unstressed if prestress is at_once else kicked
        system.read_scene()
        outcome = system.minimize(prestress)
        system.write_scene()
        total = outcome if total is None else total + outcome
        near = _moved(scene, first)[0] < TOL.near_state * scene.membrane.size
        if not (outcome.converged and near and scene.energy < energy - SAME_VALUE * scale):
            scene.u.x.array[:] = best
            system.read_scene()
            system.write_scene()
    assert total is not None
    fall = max(before - scene.energy, 0.0) / scale
    return _Scatter(total, fall, *_moved(scene, first))


def _kick(scene: Scene) -> Array:
    """Random displacements of the vertices (length), the same on any number of ranks."""
    cells = scene.mesh.mesh.topology.index_map(2).size_global
    size = scene.membrane.size / np.sqrt(cells / 2)
    places = scene.membrane.stress_free / size
    ways = np.array([[12.9898, 78.233, 37.719], [39.346, 11.135, 83.155], [73.156, 52.235, 9.151]])
    noise = np.sin(places @ ways) * 43758.5453
    # with less than half a cell starts fall back to where they came from, in a square air cushion
    # of 32 cells a side
    kick = size * (2 * (noise - np.floor(noise)) - 1)
    return np.where(scene.held, 0.0, kick).ravel()


def _moved(scene: Scene, first: Array) -> tuple[float, Array]:
    """Largest displacement (length) since a state, and its place on the stress-free membrane."""
    own, moved = scene.V.dofmap.index_map.size_local, (scene.u.x.array - first).reshape(-1, 3)
    return furthest(scene.comm, moved[:own], scene.membrane.stress_free[:own])


def furthest(comm: MPI.Intracomm, moved: Array, places: Array) -> tuple[float, Array]:
    """Largest of this and other ranks' displacements (n, 3), and its place (3,). Collective."""
    sizes = np.linalg.norm(moved, axis=1)
    k = int(np.argmax(sizes)) if len(sizes) else -1
    found = (float(sizes[k]), places[k].tolist()) if k >= 0 else (0.0, [0.0] * 3)
    size, place = max(comm.allgather(found))
    return size, np.array(place)
