"""Routes traced on the membrane, and over its holes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import count, pairwise

import numpy as np

from crms_fenicsx.cabling.cables.strip import EMPTY, Strip, StripShape, cells_at, cells_near, grown
from crms_fenicsx.cabling.paths.creased_surface import NO_FOLDS, CreasedSurface
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import PathError
from crms_fenicsx.foundation.surface.corridor import cell_between
from crms_fenicsx.foundation.surface.flip_geodesic import shorten
from crms_fenicsx.foundation.surface.holes import covers
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.foundation.surface.points import SurfacePoint
from crms_fenicsx.foundation.surface.trace import IndirectLeg, trace
from crms_fenicsx.foundation.surface.vertex_flip import MissingCells
from crms_fenicsx.model.membrane import Membrane

NO_COVERS = EMPTY.cells


def traced(membrane: Membrane, route: Array, known: Mapping[int, SurfacePoint]) -> Path:
    """Trace a route on the cells along it, or on the whole mesh if these do not suffice."""
    for along_legs in (True, False):
        near = cells_near(membrane, route, along_legs)
        shape = StripShape.of(membrane, near)
        rows = np.searchsorted(near.vertices, near.cells)
        with suppress(IndirectLeg):
            return trace(
                near.vertices, shape.current, rows, route, known=known, along_legs=along_legs
            )
    raise AssertionError("the whole mesh is enough")


def traced_over_holes(
    membrane: Membrane, route: Array, known: Mapping[int, SurfacePoint], slides: bool
) -> tuple[Path, Integers]:
    """Trace a route, that of a cable that slides sideways if need be over the covers of holes,
    which are returned, (m, 3) vertex ids. Collective."""
    try:
        return traced(membrane, route, known), NO_COVERS
    except PathError:
        if not slides:
            raise
        lids = covers_of(membrane)
        if not lids:
            raise
        found = _over(membrane, route, known, lids)
        if found is None:
            raise
        return found


def _over(
    membrane: Membrane, route: Array, known: Mapping[int, SurfacePoint], lids: Sequence[Integers]
) -> tuple[Path, Integers] | None:
    """Trace a route over the covers of holes, and return those of the holes that it crosses; None
    if it is not possible, or not with ends on the membrane. Collective."""
    covers = np.concatenate(lids)
    near = cells_near(membrane, route, along_legs=False).merged(cells_at(membrane, covers.ravel()))
    shape = StripShape.of(membrane, near)
    outer = np.searchsorted(near.vertices, near.outer_cells)
    lid = np.searchsorted(near.vertices, covers)
    with suppress(PathError):
        path = trace(near.vertices, shape.current, outer, route, known=known, covers=lid)
        strip = near.with_covers(covers)
        links = [cell_between(a.support, b.support) for a, b in pairwise(path.points)]
        crossed = {v for link in links if strip.over_hole(link) for v in link}
        used = [one for one in lids if not crossed.isdisjoint(one.ravel().tolist())]
        ends = [set(point.support) for point in (path.points[0], path.points[-1])]
        rims = [set(one.ravel().tolist()) for one in used]
        anchored = [a is not None for a in (path.start_anchor, path.end_anchor)]
        # An end in the air is joined to the boundary, which is none any more below a cover.
        if any(
            strip.over_hole(tuple(end)) or (off and any(end <= rim for rim in rims))
            for end, off in zip(ends, anchored, strict=True)
        ):
            return None
        return path, np.concatenate(used)
    return None


def covers_of(membrane: Membrane) -> list[Integers]:
    """Covers of each hole of the membrane, and of each concave part of its outer boundary, (m, 3)
    vertex ids, from its stress-free shape: the same for all cables. Collective."""
    mesh = membrane.mesh.mesh
    owned = np.setdiff1d(np.arange(mesh.topology.index_map(2).size_local), membrane.mesh.hidden)
    ids = cell_vertex_ids(mesh)
    edges = mesh.topology.connectivity(2, 1).array.reshape(-1, 3)[owned]
    at, k = np.nonzero(np.isin(edges, membrane.mesh.edges["boundary"]))  # k: the third vertex
    cells, dofs = ids[owned[at]], membrane.V.dofmap.list[owned[at]]
    every, turned = np.arange(len(at)), np.stack([k, (k + 1) % 3, (k + 2) % 3], axis=1)
    corners = cells[every[:, None], turned]
    places = membrane.stress_free[dofs[every[:, None], turned]]
    parts = membrane.comm.allgather((corners, places))
    corners, places = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
    vertices, first = np.unique(corners, return_index=True)
    points = places.reshape(-1, 3)[first]
    order = np.lexsort(corners.T)
    return covers(corners[order, 1:], corners[order, 0], vertices, points)


def cells_below(membrane: Membrane, path: Path, covers: Integers) -> Strip:
    """Cells around a path, with the covers of the holes that it crosses. Collective."""
    vertices = [v for point in path.points for v in point.support]
    return cells_at(membrane, [*vertices, *covers.ravel()]).with_covers(covers)


def shortened(membrane: Membrane, path: Path, covers: Integers = NO_COVERS) -> Path:
    """Shortest nearby path between the same ends, pulled taut over vertices. Collective."""
    strip = cells_below(membrane, path, covers)
    for rings in count(1):
        try:
            found = shorten(path.points, CreasedSurface(StripShape.of(membrane, strip), NO_FOLDS))
            break
        except MissingCells as missing:
            strip = grown(membrane, strip, missing.vertices, rings)
    return replace(path, points=found.points)
