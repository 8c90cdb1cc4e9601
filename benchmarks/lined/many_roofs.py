"""Random roofs of gmsh under nets of cables along lines, cut and embedded, in many load steps.

A roof follows from its number: a spherical cap with great circles in two or three families, an air
hall, or a form found over a rectangle or an ellipse; with cables of random stiffness and length. It
is inflated to 0.3 kPa and on to 1.0 kPa by 0.1; at 0.6 kPa a wind comes, and goes.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from roofs import suction

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    InputError,
    IsotropicMembrane,
    LaidCable,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
    nets,
)
from crms_fenicsx.design.form_finding import find_form

Floats = NDArray[np.float64]

COMM = MPI.COMM_WORLD
KINDS = ("cap", "air hall", "found rectangle", "found ellipse")
PRESSURES = tuple(round(0.3 + 0.1 * k, 1) for k in range(8))
WINDY, GUST = 0.6, 0.5
STEPS: list[dict[str, Any]] = [
    *({"pressure": p} for p in PRESSURES),
    {"pressure": WINDY, "load": {"wind": 1.0}},
    {"load": {"wind": 0.0}},
]
POINTS = 33  # of a straight line in plan


@dataclass
class Roof:
    """What a number draws."""

    number: int
    extent: tuple[float, float, float]
    routes: dict[str, Floats] = field(default_factory=dict)  # in plan

    @property
    def kind(self) -> str:
        """One of `KINDS`."""
        return KINDS[self.number % 4]

    @property
    def embeds(self) -> bool:
        """Whether its mesh embeds its lines; otherwise it is cut along them."""
        return self.number // 4 % 2 == 1

    @property
    def families(self) -> list[list[Floats]]:
        """Routes by family."""
        letters = dict.fromkeys(name[0] for name in self.routes)
        return [[p for name, p in self.routes.items() if name[0] == one] for one in letters]

    def size(self, unknowns: float) -> float:
        """The size of cells with which it has about that many unknowns."""
        width, depth, height = self.extent
        area = width * depth + (width + depth) * height
        if self.kind == "cap":
            area = np.pi * (width**2 / 4 + height**2)
        return float(np.sqrt(2 / np.sqrt(3) * area * 3 / unknowns))


def roof(number: int) -> Roof:
    """Extent and lines of a roof."""
    draw = np.random.default_rng([number, 7])
    turn, skew = draw.uniform(0.0, np.pi), draw.uniform(0.5, np.pi / 2)
    angles = [turn, turn + skew]
    if number % 4 == 0:
        R = draw.uniform(12.0, 60.0)
        found = Roof(number, (2 * R, 2 * R, R * draw.uniform(0.25, 0.6)))
        if draw.random() < 0.4:
            angles = [turn, turn + np.pi / 3, turn + 2 * np.pi / 3]
    else:
        width, depth = draw.uniform(20.0, 60.0), draw.uniform(20.0, 60.0)
        height = min(width, depth) * draw.uniform(0.25, 0.45)
        found = Roof(number, (width, depth, height))
        if found.kind == "air hall":
            found.extent = (max(width, depth), min(width, depth), height)
            # the ridge and hoops are shortest as they are; diagonals are pulled taut
            along, across = (0.0, np.pi / 2), (np.pi / 2 - skew / 2, np.pi / 2 + skew / 2)
            angles = list(along if found.embeds else across)
    width, depth, _ = found.extent
    for family, angle in zip("ABC", angles, strict=False):
        count = int(draw.integers(2, 9)) if angle else 1
        reach = min(width, depth) / 2
        if found.kind == "air hall":
            reach = abs(width / 2 * np.sin(angle)) + abs(depth / 2 * np.cos(angle))
        shift = draw.uniform(-0.1, 0.1)
        for k in range(count):
            offset = reach * 0.8 * ((2 * k + 1) / count - 1 + shift / count)
            found.routes[f"{family}{k + 1}"] = line_of(found, angle, float(offset))
    return found


def line_of(one: Roof, angle: float, offset: float) -> Floats:
    """A straight line in plan, or a great circle on a cap, from rim to rim."""
    width, depth, height = one.extent
    if one.kind == "cap":
        return np.asarray(nets.great_circle(width / 2, height, angle, offset))
    way, half = np.array([np.cos(angle), np.sin(angle)]), np.array([width / 2, depth / 2])
    foot = offset * np.array([-np.sin(angle), np.cos(angle)])
    p, q = way / half, foot / half
    if one.kind == "found ellipse":
        middle, reach = -(p @ q) / (p @ p), np.sqrt((p @ q) ** 2 - p @ p * (q @ q - 1)) / (p @ p)
        ends = middle + reach * np.array([-1.0, 1.0])
    else:
        with np.errstate(divide="ignore"):
            first, second = (-1.0 - q) / p, (1.0 - q) / p
        ends = np.array([np.minimum(first, second).max(), np.maximum(first, second).min()])
    return np.asarray(foot + np.linspace(*ends, POINTS)[:, None] * way)


def built(one: Roof, unknowns: float) -> tuple[Scene, dict[LaidCable, float]]:
    """The roof on a mesh that is cut along its lines, or that embeds them; its cables' lengths."""
    width, depth, height = one.extent
    draw, size = np.random.default_rng([one.number, 8]), one.size(unknowns)
    lines = one.routes if one.embeds else None
    fabric: Any = IsotropicMembrane(E=draw.uniform(500.0, 1500.0), nu=0.3, thickness=1.0)
    if draw.random() < 0.5:
        fabric = OrthotropicMembrane(E1=1100.0, E2=800.0, G12=40.0, nu21=0.2, thickness=1.0)
    corner = (-width / 2, -depth / 2)
    if one.kind in KINDS[:2]:
        if one.kind == "cap":
            mesh = meshes.spherical_cap(COMM, width / 2, height, size, lines=lines)
        else:
            mesh = meshes.air_hall(COMM, width, depth, height, size, corner=corner, lines=lines)
        if not one.embeds:
            taut = one.kind != "cap"
            net = nets.from_paths(Scene(mesh, fabric), one.families, shortest=taut)
            mesh = meshes.along(mesh, net.paths)
        scene = Scene(mesh, fabric)
        scene.fix("boundary")
    else:
        if one.kind == "found rectangle":
            plan = meshes.rectangle(COMM, width, depth, size, corner=corner, lines=lines)
        else:
            plan = meshes.ellipse(COMM, width / 2, depth / 2, size, lines=lines)
        form = find_form(plan, 0.16 * min(width, depth), fixed=["boundary"], pressure=PRESSURES[0])
        if not one.embeds:
            scene = form.scene(fabric)
            form = form.along(nets.from_paths(scene, one.families, shortest=True))
        scene = form.scene(fabric)
    EA = 10 ** draw.uniform(4.0, 5.0) * max(1.0, min(width, depth) / 40.0)
    share = draw.uniform(0.98, 1.0)
    cables = [scene.lay_cable(Cable(EA=EA), along=name) for name in one.routes]
    return scene, {cable: share * cable.L0 for cable in cables}


def along_wind(points: Floats, normals: Floats) -> Floats:
    """Pressure coefficients of a wind askew."""
    return suction(0.8 * normals[0] + 0.6 * normals[1])


def run(number: int, unknowns: float) -> list[str]:
    """Load a roof, print what each step was, and return what was refused or is doubtful."""
    one = roof(number)
    name = f"{number}: {one.kind}, {len(one.routes)} cables, {'embedded' if one.embeds else 'cut'}"
    print(name, flush=True)
    wrong, begin = [], time.process_time()
    try:
        scene, lengths = built(one, unknowns)
        solver = Solver(scene)
        scene.put_wind(GUST, along_wind, name="wind")
        print(f"    laid in {time.process_time() - begin:.1f} s", flush=True)
        for k, step in enumerate(STEPS):
            begin = time.process_time()
            done = solver.advance(**step, L0=lengths if k == 0 else None)
            T = np.array([cable.tension for cable in scene.cables])
            doubts = [str(check) for check in done.verification.doubtful]
            wrong += [f"{name}, step {k}: doubtful: {doubt}" for doubt in doubts]
            print(f"    {k:<3}{3 * solver.system.unknowns.n_global:7} unknowns"
                  f"{time.process_time() - begin:8.2f} s{done.outcome.factorizations:5} fact."
                  f"{done.outcome.solves:4} solves  T {T.min():.2f} {T.mean():.2f} {T.max():.2f}  "
                  f"{done.verification.verdict}", flush=True)  # fmt: skip
    except (InputError, ConvergenceError, AssertionError) as error:
        wrong.append(f"{name}: {type(error).__name__}: {error}")
        print(f"    refused: {error}", flush=True)
    return wrong
