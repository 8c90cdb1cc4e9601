"""Equidistant nets: all meshes have sides of equal length, like nets made in a workshop.

Also called Chebyshev nets (P. L. Chebyshev, Sur la coupe des vêtements, 1878). Each new node is
found by the compass method, at one distance from two neighbours. On a surface of Gaussian curvature
K the angle w between the families changes by w_uv = -K sin w, so the meshes fold far from the two
first lines.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import pairwise, product
from typing import Literal

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.design.nets.assembly import assembled
from crms_fenicsx.design.nets.whole_surface import WholeSurface
from crms_fenicsx.foundation.meshes.triangles import cross, norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import PlanVector, Positive, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, NetWarning, PathError, as_text
from crms_fenicsx.model.cable import Net
from crms_fenicsx.model.tolerances import SAME_POINT

Node = tuple[int, int]

APART = 0.51
"""Distance from other nodes, relative to the width, below which a line has come around a tube; the
diagonals of meshes with angles of 30 degrees are longer."""


@collective
def equidistant(
    scene: Scene,
    width: Positive,
    origin: PlanVector,
    directions: Sequence[Sequence[float]] = ((1.0, 0.0), (0.0, 1.0)),
    *,
    least_angle: Positive = 30.0,
) -> Net:
    """Lay out a net whose meshes have sides of equal length. Collective.

    Two geodesics start from the origin; between them each node lies at the distance `width` from
    two others. The net ends where a mesh would have an angle below `least_angle`; from there, all
    lines run straight on to the rim. Where a geodesic meets the rim before the membrane ends, the
    next line of its family continues straight in its place.

    The lines are not geodesics, so cables that slide freely do not stay on them: clamp their
    crossings, or let friction hold them.

    Parameters
    ----------
    scene
        A scene, on whose current shape the net is laid out.
    width
        Straight distance between neighbouring nodes (length).
    origin
        One of the nodes, in plan, (2,), or in space, (3,) (length).
    directions
        Directions of both geodesics at the origin, in plan, (2,), or in space, (3,).
    least_angle
        Smallest angle of a mesh (degrees).

    Returns
    -------
    Net
        The net, with its `nodes`.

    Raises
    ------
    InputError
        On all ranks: a width too large for any mesh, or parallel directions.
    PathError
        An origin off the membrane, or a line that cannot be laid.

    Warns
    -----
    NetWarning
        The net ends where it would fold; the message says where.

    Examples
    --------
    >>> directions = [(1, 1), (-1, 1)]
    >>> net = nets.equidistant(scene, 4.0, origin=(0.0, 0.0), directions=directions)
    """
    call = "equidistant"
    surface = WholeSurface.of(call, scene)
    if least_angle >= 90.0:
        raise InputError(f"{call}: least_angle = {least_angle:g} must be less than 90 degrees.")
    if not isinstance(directions, Sequence | np.ndarray) or len(directions) != 2:
        raise InputError(f"{call}: directions = {directions!r}, expected one for each family.")
    ways = [checks.direction(f"{call}: direction", one, (2, 3)) for one in directions]
    try:
        place = surface.place(np.asarray(origin))
        u, v = (surface.tangent(place, way) for way in ways)
    except PathError as error:
        raise PathError(f"{call}: {error}") from None
    if np.degrees(np.arcsin(min(1.0, float(norm(cross(u, v)))))) < least_angle:
        raise InputError(
            f"{call}: the directions {as_text(ways[0])} and {as_text(ways[1])} make an angle of "
            f"less than {least_angle:g} degrees; use directions that cross at a larger one."
        )
    chart = Chart(surface, width, least_angle)
    chart.grow(place, (u, -u, v, -v))
    if not any(i and j for i, j in chart.nodes):
        raise InputError(
            f"{call}: no mesh of width = {width:g} has room around the origin {as_text(place)}; "
            "use a smaller width, or an origin farther from the rim."
        )
    if chart.folds and scene.comm.rank == 0:
        _, angle, at = min(chart.folds)
        warnings.warn(
            f"{call}: at {len(chart.folds)} nodes, first at {as_text(at)}, meshes would have "
            f"angles below {least_angle:g} degrees (there {angle:.1f}); the net ends there, and "
            "its lines run straight on to the rim. Start elsewhere, or lay out several nets.",
            NetWarning,
            stacklevel=3,
        )
    return assembled(call, surface, [chart.family(0), chart.family(1)], nodes=chart.table())


class Chart:
    """The nodes of a net, numbered along both families."""

    def __init__(self, surface: WholeSurface, width: float, least_angle: float) -> None:
        self.surface, self.width, self.least_angle = surface, width, least_angle
        self.nodes: dict[Node, Array] = {}
        # folds: number of meshes from the origin, angle (degrees), place
        self.folds: list[tuple[int, float, tuple[float, ...]]] = []
        self._folded: set[Node] = set()

    def grow(self, origin: Array, ways: Sequence[Array]) -> None:
        """Find the nodes along the two first lines, then those between."""
        self.nodes[0, 0] = origin
        axes = ((1, 0), (-1, 0), (0, 1), (0, -1))
        for (i, j), way in zip(axes, ways, strict=True):  # to the rim, or until the line closes
            line = self.surface.to_rim([origin], self.width, way)
            for k, (last, new) in enumerate(pairwise(line), start=1):
                if norm(new - last) > self.width * (1 - SAME_POINT):
                    self.nodes[k * i, k * j] = new
        for p, q in product((1, -1), repeat=2):
            self._fill(p, q)

    def _fill(self, p: int, q: int) -> None:
        """Find the nodes of a quadrant, in order of their distance from the origin."""
        reach = max(p * i + q * j for i, j in self.nodes)
        level = 1
        while level < max(reach, 2) + 1:
            level += 1
            for i in range(1, level):
                node = (p * i, q * (level - i))
                found = self._node(p, q, *node)
                if found is not None:
                    self.nodes[node] = found
                    reach = max(reach, level)

    def _node(self, p: int, q: int, i: int, j: int) -> Array | None:
        """A node from its neighbours closer to the origin; None if it cannot be found."""
        nodes, beside, below = self.nodes, (i - p, j), (i, j - q)
        if {beside, below, (i - p, j - q)} & self._folded:
            self._folded.add((i, j))
            return None
        if beside in nodes and below in nodes and (i - p, j - q) in nodes:
            return self._by_compass((i, j), nodes[beside], nodes[below], nodes[i - p, j - q])
        if beside in nodes and not any((i, k) in nodes for k in range(0, j, q)):
            return self._straight_on(beside, (i - 2 * p, j))
        if below in nodes and not any((k, j) in nodes for k in range(0, i, p)):
            return self._straight_on(below, (i, j - 2 * q))
        return None

    def _by_compass(self, node: Node, a: Array, b: Array, corner: Array) -> Array | None:
        """The fourth node of a mesh; None beyond the rim or where meshes fold."""
        found = self.surface.compass(a, b, self.width)
        found = found[norm(found - corner) > SAME_POINT * self.width]
        if not len(found):
            return None
        new = found[np.argmin(norm(found - (a + b - corner)))]
        angle = min(_angle(new, a, b), _angle(a, corner, new))
        if angle < self.least_angle:
            self._folded.add(node)
            self.folds.append((abs(node[0]) + abs(node[1]), angle, tuple(map(float, new))))
            return None
        return np.asarray(new)

    def _straight_on(self, last: Node, before: Node) -> Array | None:
        """The node straight ahead on a line whose adjacent line has ended at the rim."""
        if before not in self.nodes:
            return None
        point = self.nodes[last]
        way = np.asarray((point - self.nodes[before]) / self.width, dtype=np.float64)
        new = self.surface.step(point, way, self.width)
        if new is None or (norm(np.array([*self.nodes.values()]) - new) < APART * self.width).any():
            return None
        return new

    def table(self) -> Array:
        """Nodes by number from the lowest on, (n, m, 3); NaN where missing."""
        numbers = np.array(list(self.nodes))
        low, high = numbers.min(axis=0), numbers.max(axis=0)
        table = np.full((*(high - low + 1), 3), np.nan)
        table[tuple((numbers - low).T)] = list(self.nodes.values())
        return table

    def family(self, along: Literal[0, 1]) -> list[Array]:
        """Routes, from rim to rim, of the lines along which one of the node numbers increases."""
        found = []
        for other in sorted({node[1 - along] for node in self.nodes}):
            own = sorted(node[along] for node in self.nodes if node[1 - along] == other)
            ends = np.flatnonzero(np.diff(own) > 1) + 1
            for run in np.split(np.array(own), ends):
                if len(run) > 1:
                    keys = [(int(k), other) if along == 0 else (other, int(k)) for k in run]
                    line = self.surface.to_rim([self.nodes[key] for key in keys], self.width)
                    line = self.surface.to_rim(line[::-1], self.width)
                    found.append(np.array(line[::-1]))
        return found


def _angle(corner: Array, a: Array, b: Array) -> float:
    """Angle at a corner (degrees)."""
    a, b = a - corner, b - corner
    return float(np.degrees(np.arctan2(norm(cross(a, b)), a @ b)))
