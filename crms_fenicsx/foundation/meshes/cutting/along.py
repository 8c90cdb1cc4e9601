"""Meshes cut along lines, so that cables can be laid on their edges."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.cutting.chord_crossings import meet
from crms_fenicsx.foundation.meshes.cutting.collapsing import collapse
from crms_fenicsx.foundation.meshes.cutting.cut_mesh import LEAST, CutMesh, Row
from crms_fenicsx.foundation.meshes.cutting.division import CutNodes, chords_of, course, divided
from crms_fenicsx.foundation.meshes.cutting.feature_edges import FeatureEdges
from crms_fenicsx.foundation.meshes.cutting.flipping import flip, halve_corners
from crms_fenicsx.foundation.meshes.cutting.spreading import Spreading, raise_vertices
from crms_fenicsx.foundation.meshes.cutting.traced_lines import (
    TracedLine,
    Tracer,
    check_apart,
    with_merged_ends,
)
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, distribute, gathered
from crms_fenicsx.foundation.meshes.plan_lines import TURN
from crms_fenicsx.foundation.meshes.surface import EMPTY
from crms_fenicsx.foundation.meshes.triangles import (
    arc_lengths,
    norm,
    shapes,
    side_turns,
    vertex_normals,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import collective
from crms_fenicsx.foundation.runtime.arrays import Array, ints
from crms_fenicsx.foundation.runtime.errors import (
    InputError,
    PathError,
    PathWarning,
    as_text,
    garbage_kept,
    raised_together,
)
from crms_fenicsx.foundation.surface.closest_point import SNAP
from crms_fenicsx.foundation.surface.trace import checked_route

logger = logging.getLogger("crms_fenicsx")


@collective
def along(mesh: MembraneMesh, lines: Mapping[str, ArrayLike]) -> MembraneMesh:
    """Cut a mesh along lines, which become named groups of its edges. Collective.

    A cable laid along such a line has the mesh's vertices as its points. Where lines cross they
    share a vertex. Vertices of the mesh near a line are merged with the line's or moved away from
    it along the surface, so that cells keep their shape; all others stay where they are. Where one
    cell fills a corner of more than 75 degrees beside a line, as at crossings, a vertex is added.
    The vertices of a line lie on its route, on the facets of the given mesh. Where the mesh knows
    the surface that it approximates, as those of the built-in shapes do, all new and moved vertices
    are moved to that and to its rim, as by `refine`.

    Parameters
    ----------
    mesh
        Any mesh; it is not changed.
    lines
        For each line its name and its route, as the path of a cable: two or more points in space
        (k, 3), or in plan (k, 2) (length). It must end at a rim or seam, at a named edge or point
        of the mesh, or at another of the lines; ends that miss these by less than a fifth of a cell
        are moved there.

    Returns
    -------
    MembraneMesh
        The mesh with a group of edges for each line, and with all groups of the given mesh.

    Raises
    ------
    InputError
        On all ranks: no lines, or names that exist already.
    PathError
        On all ranks, with the line's name: a route that is not a list of finite points, that leaves
        the surface, ends inside it, crosses itself or runs back; or lines side by side, closer than
        a fiftieth of a cell.

    Warns
    -----
    PathWarning
        Cells with small angles, as near lines closer than three cells.

    Examples
    --------
    >>> flat = meshes.rectangle(MPI.COMM_WORLD, 4.0, 3.0, size=0.5)
    >>> cut = meshes.along(flat, {"A": [(0.0, 1.0), (4.0, 2.0)], "B": [(1.0, 0.0), (2.0, 3.0)]})
    >>> sorted(cut.edges)
    ['A', 'B', 'back', 'boundary', 'front', 'left', 'right']
    """
    routes = _checked(mesh, lines)
    comm, found = mesh.comm, EMPTY
    turned: list[str] = []
    poor: list[str] = []
    tracer = Tracer(comm.bcast(gathered(mesh)[0]))
    with garbage_kept():
        with raised_together(comm):  # each rank traces its share of the lines
            own = tracer.lines(list(routes.items())[comm.rank :: comm.size])
        parts = comm.gather(own)
        with raised_together(comm):
            if parts is not None:
                traced = {line.name: line for part in parts for line in part}
                work = cut(tracer, [traced[name] for name in routes])
                improve(work)
                if mesh.project is not None:
                    raise_vertices(work, mesh.project)
                found, turned, poor = work.finished(), _turned(work), _poor(work)
    for text in turned:  # on rank 0
        logger.info(text)
    for text in comm.bcast(poor):
        warnings.warn(text, PathWarning, stacklevel=3)
    return distribute(comm, found, None, mesh.project)


def _checked(mesh: MembraneMesh, lines: Mapping[str, ArrayLike]) -> dict[str, Array]:
    """The routes by name."""
    if not isinstance(lines, Mapping) or not lines:
        raise InputError(
            f"along: lines = {lines!r}; pass a mapping of names to routes, with one line or more."
        )
    routes = {}
    for name, route in lines.items():
        checks.text("along: the name of a line", name)
        if name in mesh.edges:
            raise InputError(
                f"along: the mesh has a group of edges {name!r} already; choose another name for "
                "the line."
            )
        try:
            routes[name] = checked_route(route)
        except PathError as error:
            raise PathError(f"along: the line {name!r}: {error}") from None
    return routes


def cut(tracer: Tracer, traced: Sequence[TracedLine]) -> CutMesh:
    """The surface of a tracer divided along lines."""
    surface = tracer.surface
    features = FeatureEdges(surface)
    lines = with_merged_ends(tracer, features, traced)
    nodes = CutNodes(surface.points, surface.points, SNAP)
    legs = nodes.legs({line.name: line.points for line in lines})
    check_apart(nodes, legs)
    chords = chords_of(legs)
    meet(nodes, chords)
    # from one side, whichever is outside, so that equally good divisions do not depend on it
    a, b, c = surface.cells.T
    turned = ((a > b) ^ (b > c) ^ (a > c)).astype(bool)
    cells, parents = divided(np.sort(surface.cells, axis=1), nodes, chords)
    cells[turned[parents]] = cells[turned[parents]][:, ::-1]
    points = np.array(nodes.places)
    features.divide(nodes)
    corners = surface.points[surface.cells]
    size = norm(corners[:, [1, 2, 0]] - corners).mean(axis=1)[parents]
    count, total = (
        np.bincount(cells.ravel(), weights, len(points)) for weights in (None, np.repeat(size, 3))
    )
    normals = vertex_normals(points, cells)
    rows = {}
    for line in lines:
        vertices = course(legs[line.name])
        if len(np.unique(vertices)) < len(vertices):
            again = np.sort(vertices)
            place = points[again[:-1][again[1:] == again[:-1]][0]]
            raise PathError(
                f"along: the line {line.name!r} comes back to {as_text(place)}; cut along two "
                "lines that end there."
            )
        features.add(pairwise(ints(vertices)), line.name)
        places = points[vertices]
        turns = np.abs(side_turns(places, normals[vertices]))
        rows[line.name] = Row(vertices, places, turns, arc_lengths(places), turns > TURN)
    return CutMesh(
        surface, points, cells, parents, features, rows, total / count, np.arange(len(points))
    )


def improve(mesh: CutMesh) -> None:
    """Merge, halve, flip and spread what lies near the rows."""
    collapse(mesh)
    flip(mesh, mesh.band(3))
    for _ in range(3):
        halve_corners(mesh)
        near = mesh.band(3)
        flip(mesh, near)
        spreading = Spreading(mesh)
        for step in range(3):
            spreading.step(last=step == 2)
        flip(mesh, near)


def _turned(mesh: CutMesh) -> list[str]:
    """Sentences on rows that turn sideways more than their routes."""
    told = []
    normals = vertex_normals(mesh.points, mesh.cells)
    for name, row in mesh.rows.items():
        own = np.abs(side_turns(mesh.points[row.vertices], normals[row.vertices]))
        known = arc_lengths(row.places)
        summed = np.concatenate([[0.0], np.cumsum(row.turns)])
        margin = 1e-9 * known[-1]
        first = summed[np.searchsorted(known, row.at[:-2] + margin)]
        last = summed[np.searchsorted(known, row.at[2:] - margin)]
        own[1:-1] -= last - first
        worst = int(np.argmax(own))
        if own[worst] > TURN:
            told.append(
                f"along: the row of {name!r} turns sideways by {np.degrees(own[worst]):.2g} "
                f"degrees more than its route at {as_text(mesh.points[row.vertices[worst]])}."
            )
    return told


def _poor(mesh: CutMesh) -> list[str]:
    """Sentences on small angles, if those of the given mesh are larger."""
    given = mesh.surface
    new = np.arcsin(shapes(mesh.points[mesh.cells])[1])
    old = np.arcsin(shapes(given.points[given.cells])[1])
    least, most = np.radians(LEAST)
    low = np.quantile(new, 0.01)
    if new.min() >= min(least, old.min()) and low >= min(most, np.quantile(old, 0.01)):
        return []
    place = mesh.points[mesh.cells[int(np.argmin(new))]].mean(axis=0)
    return [
        f"along: the smallest angle of the cells is {np.degrees(new.min()):.2g} degrees, at "
        f"{as_text(place)}, and one in a hundred has less than {np.degrees(low):.2g}; use cells "
        "of a third of the distance of lines and of what lies beside them, or move a line."
    ]
