"""Dimensions of a roof in plan, and positions relative to it along a direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.membrane_mesh import cells_of
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import EPSILON, Array
from crms_fenicsx.foundation.runtime.errors import InputError


def checked_within(what: str, value: object, low: float, high: float, unit: str = "") -> float:
    """A number checked to lie in [low, high], the range of its figure."""
    number = checks.finite(what, value)
    if not low - 8 * EPSILON <= number <= high + 8 * EPSILON:
        unit = unit and f" {unit}"
        raise InputError(f"{what} = {number:g} is outside the range of {low:g} to {high:g}{unit}.")
    return number


def plan_vector(what: str, value: object) -> Array:
    """Two finite numbers, (2,); a third one is ignored."""
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if numbers.shape not in ((2,), (3,)) or not np.all(np.isfinite(numbers)):
        raise InputError(f"{what} = {value!r} must be two finite numbers (x, y).")
    return numbers[:2]


class Along:
    """Coordinate (length) along a direction in plan, from an origin."""

    def __init__(self, call: str, direction: Sequence[float], origin: Sequence[float]) -> None:
        vector = plan_vector(f"{call}: direction", direction)
        size = float(np.hypot(*vector))
        if size == 0.0:
            raise InputError(f"{call}: direction = {direction!r} has no length; give another one.")
        self.direction, self.origin = vector / size, plan_vector(f"{call}: point", origin)

    def __call__(self, x: Array) -> Array:
        """Coordinates (n,) of points (3, n)."""
        return np.asarray(self.direction @ (x[:2] - self.origin[:, None]))


@dataclass(frozen=True)
class Footprint:
    """Dimensions of a roof in its current shape (length), along a direction in plan."""

    direction: tuple[float, float]
    start: tuple[float, float]  # its start along the direction and, from the left, across it
    depth: float  # d, along the direction
    breadth: float  # b, across it
    low: float  # z of its lowest and highest point
    high: float

    @property
    def rise(self) -> float:
        """f, from the lowest to the highest point (length)."""
        return self.high - self.low

    def parts(self, x: Array) -> tuple[Array, Array]:
        """Relative positions of points (3, n) along depth and breadth, 0 to 1."""
        c, s = self.direction
        along, across = c * x[0] + s * x[1], c * x[1] - s * x[0]
        return (along - self.start[0]) / self.depth, (across - self.start[1]) / self.breadth

    def arcs(self, x: Array) -> Array:
        """Positions of points (3, n) along a circular arc of this depth and rise, from -1 to 1."""
        half, rise = self.depth / 2, max(self.rise, EPSILON**0.25 * self.depth)
        radius = max((half**2 + rise**2) / (2 * rise), half)
        distance = half * np.clip(2 * self.parts(x)[0] - 1.0, -1.0, 1.0)
        return np.asarray(np.arcsin(distance / radius) / np.arcsin(half / radius))


def footprint(call: str, scene: Scene, direction: Sequence[float], part: str | None) -> Footprint:
    """Dimensions of a scene's membrane, or of a part. Collective."""
    checks.of_type(f"{call}: scene", scene, Scene)
    checks.same(scene.comm, call, direction=direction, part=part)
    unit = Along(call, direction, (0.0, 0.0)).direction
    c, s = float(unit[0]), float(unit[1])
    membrane = scene.membrane
    membrane.check_finite(call)
    cells = np.arange(membrane.mesh.mesh.topology.index_map(2).size_local)
    if part is not None:
        checks.named("part", membrane.mesh.parts, part)
        cells = np.flatnonzero(cells_of(membrane.mesh, (part,))[: len(cells)])
    points = membrane.positions()[membrane.V.dofmap.list[cells]].reshape(-1, 3)
    x, y, z = points.T
    values = np.array([c * x + s * y, c * y - s * x, z])
    low, high = np.empty(3), np.empty(3)
    membrane.comm.Allreduce(values.min(axis=1, initial=np.inf), low, op=MPI.MIN)
    membrane.comm.Allreduce(values.max(axis=1, initial=-np.inf), high, op=MPI.MAX)
    depth, breadth = float(high[0] - low[0]), float(high[1] - low[1])
    if depth <= 0.0 or breadth <= 0.0:
        raise InputError(f"{call}: the roof has no area in plan; name the part that is the roof.")
    first, left, bottom = map(float, low)
    return Footprint((c, s), (first, left), depth, breadth, bottom, float(high[2]))
