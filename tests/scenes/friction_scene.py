"""The square of the terms' tests, with cables that friction holds: two on the same edges, and one
over edge sliders."""

from __future__ import annotations

from typing import Any

import numpy as np
from cabled_square import clamped, put
from mpi4py import MPI
from term_scene import ISOTROPIC, SIDE, irregular_square

from crms_fenicsx import Cable, Friction, Scene
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.friction.lateral import start_step

PATHS = (
    [(0, 31), (SIDE, 52)],
    [(22, 42), (78, 52)],
    [(-8.0, 15.0, -2.0), (SIDE + 8.0, 25.0, -2.0)],  # over the edges of the boundary
)


def friction_square(comm: MPI.Intracomm, friction: Any = 0.4, lift: float = 8.0) -> System:
    """A dome whose cables are in tension, at the start of a load step."""
    scene = clamped(irregular_square(comm, lift), ISOTROPIC)
    for path in PATHS:
        scene.lay_cable(Cable(32000.0, friction=friction), path, tension=20.0)
    scene.air.update(pressure=0.01)
    shape = scene.net.strip_shape()
    for cable in scene.cables:
        start_step(cable, shape)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    return system


def friction_dome(friction: float | Friction = 0.4) -> tuple[Scene, StripShape]:
    """The same scene on this process alone, as data."""
    scene = friction_square(MPI.COMM_SELF, friction).scene
    return scene, scene.net.strip_shape()


def shaken_fractions(scene: Scene, size: float, seed: int = 0) -> None:
    """Move sliding nodes along their edges by up to `size` of them, and onto the membrane."""
    shape, rng = scene.net.strip_shape(), np.random.default_rng(seed)
    for cable in scene.cables:
        for k, node in enumerate(cable.state.nodes):
            if node.slides and not cable.state.lifted[k]:
                shift = rng.uniform(-size, size)
                put(cable, "fractions", k, min(max(cable.state.fractions[k] + shift, 0.05), 0.95))
                ids, weights = cable.interpolation(k)
                put(cable, "positions", k, np.dot(weights, [shape.at(i) for i in ids]))
