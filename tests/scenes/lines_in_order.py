"""Roofs under random nets of cables along lines of the mesh; and who lies on whom, found from the
final polylines and the final surface alone."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from contact_checks import all_cells
from grids import Floats, alternating, grid
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, LaidCable, Scene, Solver, meshes
from crms_fenicsx.design.form_finding import find_form

SIDE = 12.0
SAME = 5e-5
"""Distance, relative to the membrane's size, of points between which lengths are smoothed."""


def heights(kind: str, x: Floats, y: Floats) -> Floats:
    """A dome, a barrel, a saddle, or hills over the plan."""
    a, b = np.pi * x / SIDE, np.pi * y / SIDE
    if kind == "dome":
        return np.asarray(2.4 * np.sin(a) * np.sin(b))
    if kind == "barrel":
        return np.asarray(2.5 * np.sin(a) + 0.0 * y)
    if kind == "saddle":
        return np.asarray(1.2 * ((2 * x / SIDE - 1) ** 2 - (2 * y / SIDE - 1) ** 2))
    return np.asarray(1.5 * np.sin(a) * np.sin(b) + 0.5 * np.sin(3 * a) * np.sin(2 * b))


def random_net(
    seed: int,
    cells: int,
    comm: MPI.Intracomm,
    unit: float = 1.0,
    origin: Sequence[float] = (0.0,) * 3,
) -> tuple[Scene, list[tuple[str, int]]]:
    """A roof cut along two or three families of lines at random angles and offsets; their names in
    a random order, with random layers. In metres and kN, or in a length unit of which `unit` are a
    metre and in a force unit of which as many are a kN; the origin is given in metres."""
    draws = np.random.default_rng(seed)
    kind = ("dome", "barrel", "saddle", "hills")[seed % 4]
    at = np.linspace(0.0, SIDE, cells + 1)
    points, triangles = grid(at, at, lambda x, y: heights(kind, x, y), alternating(cells, cells))
    lines, names = _random_lines(draws, unit, origin)
    mesh = meshes.from_arrays(comm, unit * (points + origin), triangles)
    prestress = 4.0 if kind == "saddle" else 0.0
    scene = Scene(meshes.along(mesh, lines), _fabric(prestress))
    scene.fix("boundary")
    return scene, names


def net_on_a_form(
    seed: int,
    cells: int,
    comm: MPI.Intracomm,
    unit: float = 1.0,
    origin: Sequence[float] = (0.0,) * 2,
) -> tuple[Scene, list[tuple[str, int]]]:
    """A random net on the saddle that a form search finds, cut along its lines."""
    draws = np.random.default_rng(seed)
    side, corner = SIDE * unit, (unit * origin[0], unit * origin[1])
    mesh = meshes.rectangle(comm, side, side, side / cells, corner=corner, structured=True)

    def lifted(x: Floats) -> Floats:
        plan = (x[:2] - np.array(corner)[:, None]) / unit
        return np.stack([0 * x[0], 0 * x[0], unit * heights("saddle", *plan)])

    lines, names = _random_lines(draws, unit, origin)
    form = find_form(mesh, stress=4.0, fixed=["boundary"], lifted={"boundary": lifted})
    return form.along(lines).scene(_fabric(4.0)), names


def _fabric(prestress: float) -> IsotropicMembrane:
    return IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=prestress)


def _random_lines(
    draws: np.random.Generator, unit: float, origin: Sequence[float]
) -> tuple[dict[str, Floats], list[tuple[str, int]]]:
    lines, families = {}, int(draws.integers(2, 4))
    for f in range(families):
        angle = np.pi * (f + draws.uniform(-0.3, 0.3)) / families
        way = np.array([np.cos(angle), np.sin(angle)])
        offsets = np.linspace(-3.2, 3.2, draws.integers(2, 4))
        for k, offset in enumerate(offsets + draws.uniform(-0.6, 0.6)):
            middle = SIDE / 2 + offset * np.array([-way[1], way[0]])
            cuts = np.sort(np.concatenate([-middle / way, (SIDE - middle) / way]))[1:3]
            places = np.clip(middle + cuts[:, None] * way, 0.0, SIDE)
            lines[f"{'ABC'[f]}{k}"] = unit * (places + origin[:2])
    names = list(lines)
    draws.shuffle(names)
    return lines, [(name, int(draws.integers(0, 2))) for name in names]


def tightened(
    scene: Scene,
    net: Sequence[tuple[str, int]],
    wind: float,
    unit: float = 1.0,
    slide: bool = True,
) -> tuple[Solver, list[LaidCable]]:
    """The net over the roof under pressure, then in a wind along x, `wind` times the pressure."""
    solver = Solver(scene, slide=slide)
    law = Cable(EA=2e4 * unit)
    cables = [scene.lay_cable(law, along=name, layer=layer) for name, layer in net]
    flat = scene.materials[next(iter(scene.materials))].prestress_vector.max() > 0.0
    pressure = (0.2 if flat else 1.0) / unit
    solver.advance(pressure=pressure, L0={cable: 0.995 * cable.L0 for cable in cables})
    scene.put_wind(1.0, lambda points, normals: np.interp(normals[0], [-0.5, 0.5], [0.8, -1.0]))
    solver.advance(pressure=pressure, load={"wind": wind * pressure})
    return solver, cables


class Found(NamedTuple):
    """What lies where, for all pairs of cables at a common vertex."""

    on_sheet: int
    in_air: int
    apart: int
    depth: float  # of an upper cable below a lower one, relative to the cells
    below: float  # of a cable below a vertex of its line
    pull: float  # outward on the membrane, relative to the tension
    unbalanced: float  # force at free points, relative to the largest of a cable there


def who_lies_on_whom(scene: Scene, cables: Sequence[LaidCable]) -> Found:
    """Heights and forces of the cables in tension by plain geometry. The order: layer, then order
    of laying."""
    x, normals, sizes = _surface(scene)
    order = {cable: (cable.layer, k) for k, cable in enumerate(scene.cables)}
    rows = {
        cable: [node.support[0] for node in cable.state.nodes[1:-1] if node.kind == "vertex"]
        for cable in cables
        if cable.taut
    }
    at: dict[int, list[LaidCable]] = {}
    for cable in sorted(rows, key=lambda cable: order[cable]):
        for v in rows[cable]:
            at.setdefault(v, []).append(cable)
    counts, depth, below, pull = [0, 0, 0], 0.0, 0.0, 0.0
    same = SAME * scene.membrane.size
    for v, own in at.items():
        for cable in own:
            height = (_nearest(cable.line, x[v]) - x[v]) @ normals[v]
            below = max(below, -float(height) / sizes[v])
        total, largest = 0.0, 0.0
        for cable in own[::-1]:
            for turn in _turns(cable, x[v], same):
                total, largest = total + float(turn @ normals[v]), max(largest, cable.tension)
            pull = max(pull, total / max(largest, 1e-300))
        for lower, upper in combinations(own, 2):
            gap, high = _gap(lower.line, upper.line, x[v], normals[v], 3 * sizes[v])
            depth = max(depth, -gap / sizes[v])
            counts[2 if gap > 1e-5 * sizes[v] else int(high > 1e-4 * sizes[v])] += 1
    free = [
        cable.state.positions[k]
        for cable in rows
        for k in cable.line_nodes()
        if cable.state.nodes[k].kind == "crossing"
    ]
    unbalanced = 0.0
    for place in free:  # of several at one place the cables' forces balance together
        turns = [turn for cable in rows for turn in _turns(cable, place, same)]
        error = np.linalg.norm(np.sum(turns, axis=0)) / max(np.linalg.norm(turns, axis=1))
        unbalanced = max(unbalanced, float(error))
    return Found(*counts, depth, below, pull, unbalanced)


def _surface(scene: Scene) -> tuple[Floats, Floats, Floats]:
    """Current vertices (n, 3), unit normals there (n, 3) and cell sizes (n,)."""
    ids, corners = all_cells(scene)
    x, normals = np.zeros((2, ids.max() + 1, 3))
    x[ids] = corners
    ways = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.add.at(normals, ids, ways[:, None])
    areas = np.linalg.norm(normals, axis=1)
    return x, normals / areas[:, None], np.sqrt(areas / np.bincount(ids.ravel()))


def _nearest(line: Floats, place: Floats) -> Floats:
    """The point of a polyline nearest to a place."""
    start, way = line[:-1], np.diff(line, axis=0)
    t = np.clip(np.sum((place - start) * way, axis=1) / np.sum(way**2, axis=1), 0.0, 1.0)
    points = start + t[:, None] * way
    found: Floats = points[np.linalg.norm(points - place, axis=1).argmin()]
    return found


def _turns(cable: LaidCable, place: Floats, same: float) -> list[Floats]:
    """Force of the cable on what bears it at a place of its line, or nothing; not at its ends."""
    away = np.linalg.norm(cable.line - place, axis=1)
    here = np.flatnonzero(away < same)
    if not len(here) or here[0] == 0 or here[-1] == len(away) - 1:
        return []
    ways = cable.line[[here[0] - 1, here[-1] + 1]] - place
    turn: Floats = (ways / np.linalg.norm(ways, axis=1)[:, None]).sum(axis=0)
    return [cable.tension * turn]


def _gap(
    lower: Floats, upper: Floats, place: Floats, normal: Floats, near: float
) -> tuple[float, float]:
    """Least gap where two polylines cross near a place, seen along its normal, and the height of
    the lower one there; infinite if they do not cross."""
    along = np.array([1.0, 0.0, 0.0]) if abs(normal[0]) < 0.7 else np.array([0.0, 1.0, 0.0])
    across = np.cross(normal, along)
    axes = np.stack([np.cross(across, normal), across, normal])
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    a, b = ((line - place) @ axes.T for line in (lower, upper))
    found, high = np.inf, np.inf
    for p, q in pairwise(a):
        for r, s in pairwise(b):
            sides = np.stack([(q - p)[:2], (r - s)[:2]], axis=1)
            if abs(np.linalg.det(sides)) < 1e-14:
                continue
            t, w = np.linalg.solve(sides, (r - p)[:2])
            at = p + t * (q - p)
            inside = -1e-9 <= t <= 1 + 1e-9 and -1e-9 <= w <= 1 + 1e-9
            if inside and np.linalg.norm(at[:2]) < near:
                gap = float(r[2] + w * (s[2] - r[2]) - at[2])
                if gap < found:
                    found, high = gap, float(at[2])
    return found, high
