"""Clamps at vertices of the mesh: lifting off, and moving onto a vertex.

A cable lifts off at its own points. At a clamp on a vertex, or on an edge that one of its cables
follows, no cable can lift off alone. So the paths are moved beside the vertex or edge: there the
clamp is a point inside a cell, held down by the surrounding contacts only.

A clamp beside a vertex that holds its cables' points may belong on the vertex: otherwise one side
of the clamp lacks a smoothed length, and short stiff parts get wrong tensions.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crms_fenicsx.cabling.contact.contact_force import pull_of
from crms_fenicsx.cabling.contact.lift_off import PULL
from crms_fenicsx.cabling.paths.held_vertices import VertexRun, clamped_together, held_vertices
from crms_fenicsx.cabling.paths.path_change import PathChange, vertices_near
from crms_fenicsx.cabling.paths.vertex_passing import pass_run
from crms_fenicsx.foundation.surface.corridor import corridor, why_invalid
from crms_fenicsx.foundation.surface.points import VertexPoint
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import PRESSED


def lift_clamps(change: PathChange) -> list[str]:
    """Move cables whose clamps pull off the membrane aside; return the changes. Collective."""
    cables = change.net.cables
    if not change.net.clamps or not any(cable.lifts_off for cable in cables):
        return []
    changes, shape = [], change.net.strip_shape()
    for held in clamped_together(cables):
        nodes = [cable.state.nodes[k] for cable, k in held]
        on = next((node.support for node in nodes if node.kind != "crossing"), None)
        if on is None or not all(cable.lifts_off for cable, _ in held):
            continue
        pulls = np.sum([pull_of(cable, k) for cable, k in held], axis=0)
        normals, _ = shape.normals_and_sizes([on])
        if pulls @ normals[0] <= PULL * sum(cable.tension for cable, _ in held):
            continue
        for cable, node in zip((cable for cable, _ in held), nodes, strict=True):
            # on an edge, the cable along it leaves the edge's ends
            run = VertexRun(on, True, 0.0, 0.0)
            if not node.slides and pass_run(change, cables.index(cable), run):
                changes.append(f"{cable.name} leaves {on} for its clamp to lift off")
    return changes


def beside_vertices(change: PathChange) -> Iterator[tuple[int, list[LaidCable]]]:
    """Vertices that hold all cables of a clamp beside them, and these cables."""
    shape = change.net.strip_shape()
    for held in clamped_together(change.net.cables):
        own = [cable for cable, _ in held]
        if not all(cable.slides_freely and not cable.keeps_line for cable in own):
            continue
        places = [set(cable.state.nodes[k].support) for cable, k in held]
        beside = set.intersection(*places, *(vertices_near(cable, PRESSED) for cable in own))
        if beside:
            holding = ({v.vertex for v in held_vertices(c, shape) if v.excess > 0.0} for c in own)
            yield from ((vertex, own) for vertex in sorted(beside.intersection(*holding)))


def put_onto(change: PathChange, cables: list[LaidCable], vertex: int) -> bool:
    """Lead cables over a vertex beside them; return whether that is possible. Collective."""
    surface, ways = change.surface([vertex]), []
    for cable in cables:
        on_path = cable.path_nodes()
        points, lifted = cable.path.points, [bool(cable.state.lifted[k]) for k in on_path]
        at = [i for i, point in enumerate(points) if vertex in point.support]
        if not at or at[0] == 0 or at[-1] == len(points) - 1 or any(lifted[at[0] : at[-1] + 1]):
            return False
        new = [*points[: at[0]], VertexPoint(vertex), *points[at[-1] + 1 :]]
        if why_invalid(corridor(new), surface.opposite_vertices):
            return False
        ways.append((cable, new, [*lifted[: at[0]], False, *lifted[at[-1] + 1 :]]))
    for cable, new, off in ways:
        change.replace(cable, new, off, surface)
    return True
