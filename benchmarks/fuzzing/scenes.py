"""Random scenes as plain data: meshes, materials, cables and actions.

A scene follows from its number alone. Sizes are those of a square of 100 cm with E t = 24 kgf/cm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np

from crms_fenicsx.foundation.runtime.arrays import Array, Integers

Choice = TypeVar("Choice")

WIDTH = 100.0
TWINS = ("units", "turned", "mirrored", "renumbered", "more steps", "laid later")
"""Scenes that must have the same answer, and how they differ."""


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
class CableData:
    """A cable to be laid; see `Scene.lay_cable`."""

    path: Array
    EA: float
    law: str = "total"
    friction: dict[str, float] | None = None
    L0: float | None = None
    tension: float | None = None
    sleeve: bool = False
    layer: int = 0


@dataclass(frozen=True)
class SceneData:
    """A scene and what is done to it.

    Attributes
    ----------
    points, cells
        The stress-free mesh.
    kind
        Of mesh, for the table.
    material
        Class and arguments.
    laws
        Options of `Scene`.
    held
        "all": the boundary. "ends": what lies beyond 40 % of the width from the middle, along
    axis
        this direction.
    floor
        Height of a floor below; None for none.
    events
        In turn: ("lay", CableData) or ("advance", arguments), with cables by number; ("load",
        force per area).
    twin
        Which of `TWINS` is to be compared; empty for none.
    """

    number: int
    kind: str
    points: Array
    cells: Integers
    material: tuple[str, dict[str, Any]]
    laws: dict[str, str] = field(default_factory=dict)
    held: str = "all"
    axis: tuple[float, ...] = (1.0, 0.0, 0.0)
    floor: float | None = None
    events: tuple[tuple[str, Any], ...] = ()
    twin: str = ""

    @property
    def cables(self) -> list[CableData]:
        """All cables, in the order in which they are laid."""
        return [what for name, what in self.events if name == "lay"]

    @property
    def has_friction(self) -> bool:
        """Whether the answer depends on the way to it."""
        return any(cable.friction is not None or cable.law == "step" for cable in self.cables)


def scene(number: int) -> SceneData:
    """The scene with a number."""
    return drawn(Seeded(number), number)


def drawn(draws: Draws, number: int = 0) -> SceneData:
    """A scene from random choices."""
    kind = _of(draws, ("structured", "jiggled", "square", "ellipse", "polygon", "hole", "cap"))
    points, cells = mesh(kind, draws.integer(5, 8), draws.integer(0, 10**6))
    held = "ends" if kind not in ("hole", "cap") and _happens(draws, 0.08) else "all"
    laws: dict[str, str] = {}
    if _happens(draws, 0.05):
        laws["pressure"] = "lagged" if held == "ends" else "step"
    material = _material(draws, held)
    if not material[1].get("wrinkling", True) and _happens(draws, 0.2):
        laws["strain"] = "step"
    floor = -draws.real(0.01, 6.0) if kind != "cap" and _happens(draws, 0.15) else None
    events: list[tuple[str, Any]] = []
    loads = _Loads(draws, held)
    count = _of(draws, (0, 1, 1, 1, 2, 2, 3))
    first = draws.integer(0, count)  # laid before anything else, the others after the first step
    for n in range(count):
        if n == first:
            events.append(loads.next(n))
        events.append(("lay", cable(draws, points, cells)))
    if _happens(draws, 0.3):
        downward = draws.real(-4e-3, -1e-4)
        events.append(("load", (draws.real(-1e-3, 1e-3), 0.0, downward)))
    has_load = events[-1:] != [] and events[-1][0] == "load"
    events += [loads.next(count, has_load) for _ in range(draws.integer(1, 3))]
    twin = _of(draws, (*TWINS, *[""] * len(TWINS)))
    return SceneData(
        number, kind, points, cells, material, laws, held,
        floor=floor, events=tuple(events), twin=twin,
    )  # fmt: skip


def _of(draws: Draws, choices: Sequence[Choice]) -> Choice:
    return choices[draws.integer(0, len(choices) - 1)]


def _happens(draws: Draws, share: float) -> bool:
    return draws.integer(0, 99) < 100 * share


def _material(draws: Draws, held: str) -> tuple[str, dict[str, Any]]:
    prestress = draws.real(0.05, 0.5) if held == "ends" or _happens(draws, 0.25) else 0.0
    wrinkling = not _happens(draws, 0.2)
    if not _happens(draws, 0.3):
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


class _Loads:
    """Draws load steps."""

    def __init__(self, draws: Draws, held: str) -> None:
        self.draws, self.held = draws, held

    def next(self, cables: int, has_load: bool = False) -> tuple[str, Any]:
        """A load step of a scene with so many cables."""
        draws = self.draws
        loads: dict[str, Any] = {"steps": _of(draws, (1, 1, 1, 2, 3))}
        if self.held == "all" and _happens(draws, 0.8):
            loads["pressure"] = _of(draws, (0.0, 1e-4, 2e-3, 5e-3, 0.01, 0.01, 0.03))
        if has_load:
            loads["load"] = _of(draws, (0.0, 0.5, 1.0))
        if cables and _happens(draws, 0.4):
            loads["move"] = {
                (draws.integer(0, cables - 1), _of(draws, ("both", "start", "end"))): tuple(
                    draws.real(-6.0, 6.0) for _ in range(3)
                )
            }
        if cables and _happens(draws, 0.25):
            loads["L0"] = {draws.integer(0, cables - 1): draws.real(0.97, 1.03)}
        if _happens(draws, 0.1):
            loads["boundary"] = tuple(draws.real(-1.0, 1.0) for _ in range(3))
        return "advance", loads


def cable(draws: Draws, points: Array, cells: Integers) -> CableData:
    """A random cable over a mesh."""
    path = _path(draws, points, cells)
    span = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    friction: dict[str, float] | None = None
    if _happens(draws, 0.2):
        friction = {"mu": draws.real(0.05, 0.9)}
        if _happens(draws, 0.3):
            friction = {"mu": _of(draws, (0.0, 0.4)), "along": draws.real(0.05, 0.5)}
    law = "step" if friction is None and _happens(draws, 0.04) else "total"
    L0 = tension = None
    how = _of(draws, ("just taut", "length", "length", "tension"))
    if how == "length":
        L0 = span * draws.real(0.96, 1.08)
    elif how == "tension":
        tension = draws.real(0.1, 60.0)
    return CableData(
        path, _of(draws, (1e3, 5e3, 32e3, 32e3, 1e6)), law, friction, L0, tension,
        _happens(draws, 0.08), draws.integer(0, 1),
    )  # fmt: skip


def _path(draws: Draws, points: Array, cells: Integers) -> Array:
    """A way over a mesh: across it, beyond it, from vertex to vertex, or to places inside."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    way = _of(draws, ("across", "across", "beyond", "beyond", "vertices", "inside", "bent"))
    if way == "vertices":
        a = draws.integer(0, len(points) - 1)
        b = (a + draws.integer(1, len(points) - 1)) % len(points)
        return points[[a, b], :2].copy()
    angle = draws.real(0.0, np.pi) if not _happens(draws, 0.3) else _of(draws, (0.0, np.pi / 2))
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    centre = (low + high) / 2 + draws.real(-0.35, 0.35) * (high - low).min() * across
    back, reach = _crossings_of_rim(points, cells, centre, along)
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


def _crossings_of_rim(
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
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]
    turned = np.zeros(a.shape, dtype=bool)
    if random is not None:
        points[1:-1, 1:-1] += random.uniform(-0.25, 0.25, (n - 1, n - 1, 2)) * WIDTH / n
        turned = random.random(a.shape) < 0.5
    first = np.where(turned[..., None], np.stack([a, b, d], -1), np.stack([a, b, c], -1))
    second = np.where(turned[..., None], np.stack([b, c, d], -1), np.stack([a, c, d], -1))
    cells = np.stack([first, second], axis=-2).reshape(-1, 3)
    flat = points.reshape(-1, 2)
    return np.column_stack([flat, np.zeros(len(flat))]), cells


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
