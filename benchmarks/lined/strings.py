"""Random nets of clamped cables on a rigid flat sheet, against strings that meet at points.

On a sheet that cannot move frictionless cables are strings, straight between their ends and the
clamps. Their forces balance at the clamps in one way, at which scipy's solver arrives by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.optimize import root

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, Solver, meshes

Floats = NDArray[np.float64]

SIDE, BEYOND, KINK = 10.0, 1.0, 0.1
"""Of the sheet; from its rim to the anchors; by which the routes of the cables are crooked."""


@dataclass(frozen=True)
class Net:
    """A net: errors of its tensions, relative to the largest, and how far its clamps have gone."""

    error: float
    way: float
    slack: int  # parts
    told: bool


def rigid_sheet(seed: int, across: int, along: int, size: float) -> tuple[Scene, list[LaidCable]]:
    """A rigid sheet with cables along crooked lines, in two families; those of an odd seed run to
    anchors beyond its rim."""
    draw, lines = np.random.default_rng(seed), {}
    for family, count in (("a", across), ("b", along)):
        for k in range(count):
            ends = SIDE * (k + 1) / (count + 1) + draw.uniform(-0.8, 0.8, 2)
            share = np.linspace(0.0, 1.0, 5)
            way = ends[0] + share * (ends[1] - ends[0])
            way[1:-1] += draw.uniform(-KINK, KINK, 3)
            path = np.column_stack([SIDE * share, way])
            lines[f"{family}{k}"] = path if family == "a" else path[:, ::-1]
    mesh = meshes.rectangle(MPI.COMM_WORLD, SIDE, SIDE, size, lines=lines)
    scene = Scene(mesh, IsotropicMembrane(E=1e6, nu=0.3, thickness=1.0, wrinkling=False))
    scene.fix(lambda x: np.full(x.shape[1], True))
    cables = []
    for name, path in lines.items():
        length, ends = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()), None
        if seed % 2:
            out = path[[0, -1]] - path[[1, -2]]
            out *= BEYOND / np.linalg.norm(out, axis=1)[:, None]
            ends, length = np.pad(path[[0, -1]] + out, ((0, 0), (0, 1))), length + 2 * BEYOND
        rope = Cable(EA=float(draw.uniform(500.0, 1500.0)))
        L0 = float(draw.uniform(0.97, 0.99)) * length
        cables.append(scene.lay_cable(rope, ends, along=name, L0=L0))
    return scene, cables


def clamped(seed: int, across: int, along: int, size: float = 1.0) -> Net:
    """The net of a seed: clamped as laid, or, to anchors, in equilibrium before these move."""
    scene, cables = rigid_sheet(seed, across, along, size)
    draw, solver, move = np.random.default_rng([seed, 1]), Solver(scene), {}
    if seed % 2:
        solver.advance()
        for cable in cables:
            for end in (cable.start, cable.end):
                if draw.random() < 0.4:
                    out = np.diff(cable.line[[1, 0] if end.which == "start" else [-2, -1]], axis=0)[
                        0
                    ]
                    aside = np.append(draw.uniform(-0.2, 0.2, 2), 0.0)
                    move[end] = tuple(out * draw.uniform(-0.3, 0.2) + aside)
    scene.clamp(*cables)
    before = np.array([clamp.place for clamp in scene.clamps])
    step = solver.advance(move=move)
    way = np.array([clamp.place for clamp in scene.clamps]) - before
    right = tensions_of_strings(scene)
    found = np.concatenate([own.part_tensions[[0, *np.searchsorted(own.contacts(), own.clamped)]]
                            for own in cables])  # fmt: skip
    assert step.verification is not None
    told = bool(step.verification.doubtful) or not step.verification.passed
    error = float(np.abs(found - right).max() / right.max())
    return Net(error, float(np.linalg.norm(way, axis=1).max()), int(np.sum(right == 0.0)), told)


def tensions_of_strings(scene: Scene) -> Floats:
    """Tensions of the parts of a scene's cables, in order, as strings over a rigid plane that meet
    at the clamps, and which run over its rim to anchors."""
    numbers = {clamp.vertex: k for k, clamp in enumerate(scene.clamps)}
    start = np.array([clamp.place[:2] for clamp in scene.clamps])
    fixed = list[Floats]()  # ends on the rim
    parts = list[tuple[int, int, float, float, float]]()
    for cable in scene.cables:
        at = {one.at[one.cables.index(cable.name)]: numbers[one.vertex]
              for one in scene.clamps if cable.name in one.cables}  # fmt: skip
        beyond = np.zeros(len(at) + 1)
        ends = list[int]()
        for k, (first, second) in ((0, cable.line[:2, :2]), (-1, cable.line[:-3:-1, :2])):
            off = np.any(np.abs(first - SIDE / 2) > SIDE / 2 + 1e-9)
            beyond[k] += np.linalg.norm(second - first) if off else 0.0
            fixed.append(second if off else first)
            ends.append(-len(fixed))
        chain = [ends[0], *(at[share] for share in sorted(at)), ends[1]]
        rows = zip(chain[:-1], chain[1:], cable.part_lengths, beyond, strict=True)
        parts += [(a, b, L, more, cable.cable.EA) for a, b, L, more in rows]
    first, second = (np.array([part[k] for part in parts]) for k in (0, 1))
    lengths, more, EA = (np.array([part[k] for part in parts]) for k in (2, 3, 4))

    def ways(x: Floats) -> Floats:
        places = np.concatenate([x.reshape(-1, 2), fixed[::-1]])
        return np.asarray(places[second] - places[first])

    def tensions(x: Floats) -> Floats:
        sizes = np.linalg.norm(ways(x), axis=1) + more
        return np.asarray(EA * np.maximum(sizes / lengths - 1, 0.0))

    def forces(x: Floats) -> Floats:
        pull, total = ways(x), np.zeros((len(start) + len(fixed), 2))
        pull *= (tensions(x) / np.linalg.norm(pull, axis=1))[:, None]
        np.add.at(total, first, pull)
        np.add.at(total, second, -pull)
        return total[: len(start)].ravel()

    least = root(forces, start.ravel(), tol=1e-13).x
    assert np.abs(forces(least)).max() < 1e-9 * tensions(least).max()
    return tensions(least)
