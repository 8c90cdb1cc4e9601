"""Random scenes as plain data: meshes, materials, cables and actions.

A scene follows from its number alone. Here membranes with cables are drawn, in the sizes of a
square of 100 cm with E t = 24 kgf/cm; `fuzzing.feature_scenes` draws scenes with all else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
from grids import numbered, triangles

from crms_fenicsx.foundation.runtime.arrays import Array, Integers

Choice = TypeVar("Choice")
Event = tuple[str, dict[str, Any]]

WIDTH = 100.0
TWINS = ("units", "turned", "mirrored", "renumbered", "more steps", "laid later")
"""Scenes that must have the same answer as one of `scene`, and how they differ."""


class Draws(Protocol):
    """Where random choices come from: a seed, or hypothesis."""

    def integer(self, low: int, high: int) -> int: ...
    def real(self, low: float, high: float) -> float: ...


class Seeded:
    """Choices that follow from a number."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def integer(self, low: int, high: int) -> int:
        """A number from low to high, both included."""
        return int(self._random.integers(low, high + 1))

    def real(self, low: float, high: float) -> float:
        """A number between low and high."""
        return float(self._random.uniform(low, high))


@dataclass(frozen=True)
class SceneData:
    """A scene and what is done to it.

    Attributes
    ----------
    number, kind
        It follows from its number; the kind of mesh.
    points, cells
        The stress-free mesh.
    material
        Class and arguments.
    laws
        Options of `Scene`.
    held
        "all" of the boundary, "ends" along x, beyond 40 % of the width from the middle, or a
        "plane" x = constant of symmetry besides.
    pressure
        What it is inflated by at first; None if not.
    features
        What is put on the scene then, in any order: calls of `World.put_...`.
    events
        What is done to it then, in this order: calls of `World`.
    twins
        What is to be compared; see `fuzzing.twins`.
    source
        "arrays", "dolfinx", "form" or "walled".
    walls
        How many of the cells, the last ones, are of a wall below the roof.
    ambiguous
        Whether membranes and nets may be slack, so that there are several equilibria.
    """

    number: int
    kind: str
    points: Array
    cells: Integers
    material: tuple[str, dict[str, Any]]
    laws: dict[str, str] = field(default_factory=dict)
    held: str = "all"
    pressure: float | None = None
    features: tuple[Event, ...] = ()
    events: tuple[Event, ...] = ()
    twins: tuple[str, ...] = ()
    source: str = "arrays"
    walls: int = 0
    ambiguous: bool = True

    @property
    def cables(self) -> list[dict[str, Any]]:
        """All cables, in the order in which they are laid."""
        return [what for name, what in self.features + self.events if name in ("cable", "lay")]

    @property
    def depends_on_way(self) -> bool:
        """Whether the answer depends on the way to it."""
        own = any(cable["friction"] or cable["law"] == "step" for cable in self.cables)
        return own or "step" in self.laws.values()


def scene(number: int) -> SceneData:
    """The scene with a number."""
    return drawn(Seeded(number), number)


def drawn(draws: Draws, number: int = 0) -> SceneData:
    """A scene of a membrane with cables from random choices."""
    kind = of(draws, ("structured", "jiggled", "square", "ellipse", "polygon", "hole", "cap"))
    points, cells = mesh(kind, draws.integer(5, 8), draws.integer(0, 10**6))
    held = "ends" if kind not in ("hole", "cap") and _percent(draws, 8) else "all"
    laws: dict[str, str] = {}
    if _percent(draws, 5):
        laws["pressure"] = "lagged" if held == "ends" else "step"
    material = _material(draws, held)
    if not material[1].get("wrinkling", True) and _percent(draws, 20):
        laws["strain"] = "step"
    has_floor = kind != "cap" and _percent(draws, 15)
    floor = (("floor", {"below": draws.real(0.01, 6.0)}),) if has_floor else ()
    events: list[Event] = []
    count = of(draws, (0, 1, 1, 1, 2, 2, 3))
    first = draws.integer(0, count)  # laid before anything else, the others after the first step
    for n in range(count):
        if n == first:
            events.append(_step(draws, held, n))
        events.append(("lay", cable(draws, points, cells)))
    has_load = _percent(draws, 30)
    if has_load:
        downward = draws.real(-4e-3, -1e-4)
        events.append(("load", {"F": (draws.real(-1e-3, 1e-3), 0.0, downward)}))
    events += [_step(draws, held, count, has_load) for _ in range(draws.integer(1, 3))]
    twin = of(draws, (*TWINS, *[""] * len(TWINS)))
    return SceneData(
        number, kind, points, cells, material, laws, held,
        features=floor, events=tuple(events), twins=(twin,) if twin else (),
    )  # fmt: skip


def of(draws: Draws, choices: Sequence[Choice]) -> Choice:
    """One of some values."""
    return choices[draws.integer(0, len(choices) - 1)]


def _percent(draws: Draws, chance: int) -> bool:
    return draws.integer(0, 99) < chance


def _material(draws: Draws, held: str) -> tuple[str, dict[str, Any]]:
    prestress = draws.real(0.05, 0.5) if held == "ends" or _percent(draws, 25) else 0.0
    wrinkling = not _percent(draws, 20)
    if not _percent(draws, 30):
        return "isotropic", {
            "E": 300.0, "nu": draws.real(0.0, 0.45), "thickness": 0.08,
            "prestress": prestress, "wrinkling": wrinkling,
        }  # fmt: skip
    angle = draws.real(0.0, np.pi)
    return "orthotropic", {
        "E1": 300.0, "E2": 300.0 / draws.real(1.0, 12.0), "G12": draws.real(2.0, 100.0),
        "nu21": 0.065, "thickness": 0.08, "warp": (float(np.cos(angle)), float(np.sin(angle)), 0.0),
        "prestress": prestress, "wrinkling": wrinkling,
    }  # fmt: skip


def _step(draws: Draws, held: str, cables: int, has_load: bool = False) -> Event:
    """A load step of a scene with so many cables."""
    loads: dict[str, Any] = {"steps": of(draws, (1, 1, 1, 2, 3))}
    if held == "all" and _percent(draws, 80):
        loads["pressure"] = of(draws, (0.0, 1e-4, 2e-3, 5e-3, 0.01, 0.01, 0.03))
    if has_load:
        loads["load"] = {"load": of(draws, (0.0, 0.5, 1.0))}
    if cables and _percent(draws, 40):
        loads["ends"] = {
            (draws.integer(0, cables - 1), of(draws, ("both", "start", "end"))): tuple(
                draws.real(-6.0, 6.0) for _ in range(3)
            )
        }
    if cables and _percent(draws, 25):
        loads["lengths"] = {draws.integer(0, cables - 1): draws.real(0.97, 1.03)}
    if _percent(draws, 10):
        loads["boundary"] = tuple(draws.real(-1.0, 1.0) for _ in range(3))
    return "advance", loads


def cable(draws: Draws, points: Array, cells: Integers) -> dict[str, Any]:
    """A random cable over a mesh."""
    path = _path(draws, points, cells)
    span = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    friction: dict[str, float] | None = None
    if _percent(draws, 20):
        friction = {"mu": draws.real(0.05, 0.9)}
        if _percent(draws, 30):
            friction = {"mu": of(draws, (0.0, 0.4)), "along": draws.real(0.05, 0.5)}
    law = "step" if friction is None and _percent(draws, 4) else "total"
    L0 = tension = None
    how = of(draws, ("just taut", "length", "length", "tension"))
    if how == "length":
        L0 = span * draws.real(0.96, 1.08)
    elif how == "tension":
        tension = draws.real(0.1, 60.0)
    return {
        "path": path, "EA": of(draws, (1e3, 5e3, 32e3, 32e3, 1e6)), "law": law,
        "friction": friction, "L0": L0, "tension": tension,
        "sleeve": _percent(draws, 8), "layer": draws.integer(0, 1),
    }  # fmt: skip


def _path(draws: Draws, points: Array, cells: Integers) -> Array:
    """A way over a mesh: across it, beyond it, from vertex to vertex, or to places inside."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    way = of(draws, ("across", "across", "beyond", "beyond", "vertices", "inside", "bent"))
    if way == "vertices":
        a = draws.integer(0, len(points) - 1)
        b = (a + draws.integer(1, len(points) - 1)) % len(points)
        return points[[a, b], :2].copy()
    angle = draws.real(0.0, np.pi) if not _percent(draws, 30) else of(draws, (0.0, np.pi / 2))
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    centre = (low + high) / 2 + draws.real(-0.35, 0.35) * (high - low).min() * across
    back, reach = rim_crossings(points, cells, centre, along)
    if way == "across":
        return np.array([centre - back * along, centre + reach * along])
    if way == "beyond":
        out = draws.real(0.5, 10.0)
        ends = np.array([centre - (back + out) * along, centre + (reach + out) * along])
        heights = (draws.real(-3.0, 6.0), draws.real(-3.0, 6.0))
        return np.column_stack([ends, heights])
    if way == "inside":
        return np.array([centre - 0.6 * back * along, centre + 0.6 * reach * along])
    kink = centre + draws.real(-8.0, 8.0) * across
    return np.array([centre - back * along, kink, centre + reach * along])


def rim_crossings(
    points: Array, cells: Integers, centre: Array, along: Array
) -> tuple[float, float]:
    """How far back and ahead a line from a point meets a mesh's rim in plan for the first time."""
    sides = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    a, b = points[edges[count == 1], :2].transpose(1, 0, 2) - centre
    height_a, height_b = (along[0] * p[:, 1] - along[1] * p[:, 0] for p in (a, b))
    meets = (height_a <= 0.0) != (height_b <= 0.0)
    share = height_a[meets] / (height_a[meets] - height_b[meets])
    at = (a[meets] + share[:, None] * (b - a)[meets]) @ along
    return (
        float(np.min(-at[at < 0.0], initial=2 * WIDTH)),
        float(np.min(at[at > 0.0], initial=2 * WIDTH)),
    )


def mesh(kind: str, n: int, seed: int) -> tuple[Array, Integers]:
    """Points (k, 3) and cells (m, 3) of a mesh of about n cells a side."""
    random = np.random.default_rng(seed)
    if kind in ("structured", "jiggled"):
        return _grid(n, random if kind == "jiggled" else None)
    h = WIDTH / n
    turn = random.uniform(0, 2 * np.pi)
    circle = np.linspace(0, 2 * np.pi, 4 * n, endpoint=False)
    holes: list[Array] = []
    if kind in ("square", "hole"):
        side = np.linspace(-0.5, 0.5, n + 1)[:-1]
        rim = np.concatenate(
            [np.column_stack(line) for line in
             ((side, 0 * side - 0.5), (0 * side + 0.5, side), (-side, 0 * side + 0.5),
              (0 * side - 0.5, -side))]
        ) * WIDTH  # fmt: skip
        if kind == "hole":
            holes = [random.uniform(0.1, 0.22) * WIDTH * _ring(circle[::3] + turn)]
    elif kind == "polygon":
        corners = np.sort(random.uniform(0, 2 * np.pi, random.integers(4, 7)))
        corners = (
            0.5 * WIDTH * _ring(np.linspace(0, 2 * np.pi, len(corners), endpoint=False) + turn)
        )
        corners *= random.uniform(0.75, 1.1, (len(corners), 1))
        rim = np.concatenate(
            [a + np.linspace(0, 1, n, endpoint=False)[:, None] * (b - a)
             for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
        )  # fmt: skip
    else:
        rim = 0.5 * WIDTH * _ring(circle) * (1.0, random.uniform(0.6, 1.0))
    points, cells = _triangulated(rim, holes, h, random)
    height = np.zeros(len(points))
    if kind == "cap":
        half = np.abs(rim).max(axis=0)
        height = random.uniform(0.05, 0.35) * WIDTH * (1 - np.sum((points / half) ** 2, axis=1))
        height[: len(rim)] = 0.0
    return np.column_stack([points, height]), cells


def _ring(angles: Array) -> Array:
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _grid(n: int, random: np.random.Generator | None) -> tuple[Array, Integers]:
    line = np.linspace(-0.5, 0.5, n + 1) * WIDTH
    points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)
    turned: Any = False
    if random is not None:
        points[1:-1, 1:-1] += random.uniform(-0.25, 0.25, (n - 1, n - 1, 2)) * WIDTH / n
        turned = random.random((n, n)) < 0.5
    flat = points.reshape(-1, 2)
    points = np.column_stack([flat, np.zeros(len(flat))])
    return points, triangles(numbered(n + 1, n + 1), turned)


def _triangulated(
    rim: Array, holes: Sequence[Array], h: float, random: np.random.Generator
) -> tuple[Array, Integers]:
    """Delaunay's triangles of an outline with holes and of shaken points inside."""
    from matplotlib.path import Path
    from scipy.spatial import Delaunay, cKDTree

    lattice = np.stack(np.meshgrid(*[np.arange(-0.6 * WIDTH, 0.6 * WIDTH, h)] * 2), axis=-1)
    inner = lattice.reshape(-1, 2) + random.uniform(-0.3, 0.3, (lattice.size // 2, 2)) * h
    border = np.concatenate([rim, *holes])
    inner = inner[Path(rim).contains_points(inner)]
    for hole in holes:
        inner = inner[~Path(hole).contains_points(inner)]
    inner = inner[cKDTree(border).query(inner)[0] > 0.5 * h]
    points = np.concatenate([border, inner])
    cells = Delaunay(points).simplices.astype(np.int64)
    corners = points[cells]
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
    middle = corners.mean(axis=1)
    keep = (areas > 1e-3 * h * h) & Path(rim).contains_points(middle)
    for hole in holes:
        keep &= ~Path(hole).contains_points(middle)
    cells = cells[keep]
    used, cells = np.unique(cells, return_inverse=True)
    return points[used], cells.reshape(-1, 3).astype(np.int64)
