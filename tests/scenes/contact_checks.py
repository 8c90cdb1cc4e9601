"""Slow checks of contact from the outside: does a cable pull on the membrane, or run through it?

For membranes over which every plumb line passes once. They use vertices, cells and the cables'
polylines, nothing of how contacts are found.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx import LaidCable, Scene
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.foundation.surface.points import EdgePoint

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def all_cells(scene: Scene) -> tuple[Ints, Floats]:
    """Vertex ids (m, 3) and current corners (m, 3, 3) of the cells of all ranks."""
    mesh = scene.mesh.mesh
    owned = mesh.topology.index_map(2).size_local
    ids = np.asarray(mesh.geometry.input_global_indices)[geometry_dofmap(mesh)[:owned]]
    own = ids, scene.positions()[scene.V.dofmap.list[:owned]]
    given = scene.comm.allgather(own)
    return np.concatenate([a for a, _ in given]), np.concatenate([b for _, b in given])


def fold_points(scene: Scene) -> dict[tuple[int, int], list[tuple[float, Floats]]]:
    """Where cables in tension touch each edge (a, b), a < b: fractions and positions."""
    found: dict[tuple[int, int], list[tuple[float, Floats]]] = {}
    for cable in scene.cables:
        for k in cable.contacts() if cable.taut else []:
            point = cable.state.nodes[k].point
            if cable.state.nodes[k].kind == "fold" and isinstance(point, EdgePoint):
                entry = (float(cable.state.fractions[k]), cable.state.positions[k])
                found.setdefault(point.edge, []).append(entry)
    return found


def edge_parts(scene: Scene) -> Floats:
    """The straight parts (m, 2, 3) of all edges, between vertices and points where cables touch."""
    ids, x = all_cells(scene)
    folds = fold_points(scene)
    parts = {}
    for cell, corners in zip(ids.tolist(), x, strict=True):
        for i, j in ((0, 1), (1, 2), (2, 0)):
            i, j = (i, j) if cell[i] < cell[j] else (j, i)
            points = sorted(folds.get((cell[i], cell[j]), []), key=lambda entry: entry[0])
            line = [corners[i], *(place for _, place in points), corners[j]]
            parts[cell[i], cell[j]] = list(pairwise(line))
    return np.array([part for edge in sorted(parts) for part in parts[edge]])


def normal_at(cells: Floats, place: Floats) -> tuple[Floats, float]:
    """Mean upward normal, and mean size, of the cells over which a place lies."""
    normals = np.cross(cells[:, 1] - cells[:, 0], cells[:, 2] - cells[:, 0])
    turn = np.sign(normals[:, 2])
    normals *= turn[:, None]
    inside = np.full(len(cells), np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        # Folded edges are not straight in plan: what reaches to 1 % of a cell counts.
        a, b = cells[:, i, :2], cells[:, j, :2]
        side, way = b - a, place[:2] - a
        area = side[:, 0] * way[:, 1] - side[:, 1] * way[:, 0]
        inside = np.minimum(inside, turn * area / normals[:, 2])
    near = inside > min(-0.01, inside.max() - 0.01)
    normal = normals[near].sum(axis=0)
    return normal / np.linalg.norm(normal), float(np.sqrt(normals[near, 2].mean() / 2))


def strongest_pull(scene: Scene, cable: LaidCable) -> float:
    """Largest force, relative to the tension, with which a cable pulls the membrane outward.

    Between chords one cell long: the noise of points close together is no pull.
    """
    _, cells = all_cells(scene)
    contacts = cable.contacts()
    x = cable.state.positions[contacts]
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    worst = 0.0
    for i, k in enumerate(contacts[1:-1], 1):
        if cable.state.nodes[k].kind not in ("fold", "vertex"):
            continue
        normal, h = normal_at(cells, x[i])
        stations = [max(run[i] - h, 0.0), min(run[i] + h, run[-1])]
        if min(run[i] - stations[0], stations[1] - run[i]) < 1e-6 * h:
            continue
        ends = np.stack([np.interp(stations, run, x[:, m]) for m in range(3)], axis=1) - x[i]
        force = np.sum(ends / np.linalg.norm(ends, axis=1)[:, None], axis=0)
        worst = max(worst, float(force @ normal))
    return worst


def deepest(scene: Scene, cable: LaidCable) -> float:
    """How far a cable's free spans run below the membrane, relative to the size of the cells.

    Spans are straight and cells are flat: a span is deepest where it passes an edge.
    """
    _, cells = all_cells(scene)
    areas = np.linalg.norm(np.cross(cells[:, 1] - cells[:, 0], cells[:, 2] - cells[:, 0]), axis=1)
    parts = edge_parts(scene)
    p, u = parts[:, 0], parts[:, 1] - parts[:, 0]
    worst = 0.0
    for a, b in pairwise(cable.contacts()):
        if b - a == 1 and "anchor" not in (cable.state.nodes[a].kind, cable.state.nodes[b].kind):
            continue
        way, w = cable.state.positions[b] - cable.state.positions[a], cable.state.positions[a] - p
        cross = u[:, 0] * way[1] - u[:, 1] * way[0]
        cross[np.abs(cross) < 1e-12] = np.nan
        on_edge = (w[:, 0] * way[1] - w[:, 1] * way[0]) / cross
        on_span = (w[:, 0] * u[:, 1] - w[:, 1] * u[:, 0]) / cross
        hit = (np.abs(on_edge - 0.5) < 0.5) & (np.abs(on_span - 0.5) < 0.5 - 1e-6)
        gaps = w[hit, 2] + on_span[hit] * way[2] - on_edge[hit] * u[hit, 2]
        worst = max(worst, -float(gaps.min(initial=0.0)))
    return worst / float(np.sqrt(areas.mean() / 2))
