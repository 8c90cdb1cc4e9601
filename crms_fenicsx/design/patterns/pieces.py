"""Pieces into which seams divide a surface, and their joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from mpi4py import MPI

from crms_fenicsx.design.patterns.cutting import Origin, cut_along
from crms_fenicsx.design.patterns.pattern_surface import PatternSurface
from crms_fenicsx.design.patterns.seams import Seam
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edges_of
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, distribute
from crms_fenicsx.foundation.meshes.orientation import connected_labels
from crms_fenicsx.foundation.meshes.surface import BOUNDARY, EMPTY, CheckedSurface
from crms_fenicsx.foundation.meshes.triangles import cross, double_areas, lists, norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import collective
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, ints
from crms_fenicsx.foundation.runtime.checks import counted
from crms_fenicsx.foundation.runtime.errors import InputError, PathError, as_text, raised_together
from crms_fenicsx.foundation.surface.points import Edge, edge_of

COLUMNS = 16
"""Columns of cells recommended across a piece: the energy error, 13 to 16 %, falls
quadratically."""


@dataclass(frozen=True)
class PieceEdge:
    """An edge of a piece from corner to corner.

    Attributes
    ----------
    name
        Seam, or group of boundary edges, along which it runs.
    sewn
        Whether it belongs to a seam.
    vertices
        Vertices of the piece (k,) along it, counter-clockwise seen from outside.
    """

    name: str
    sewn: bool
    vertices: Integers = field(repr=False)


@dataclass(frozen=True)
class Piece:
    """A piece of the surface in space.

    Attributes
    ----------
    name
        "piece 1", "piece 2" ..., also as a part of the cut mesh.
    cells
        Cells (m,) of the cut surface.
    triangles
        Corners of the cells as vertices of the piece, (m, 3).
    vertices
        Vertices (n,) of the cut surface; a seam inside the piece has them twice, once on each side.
    points
        Positions of the vertices (n, 3) (length).
    edges
        Edges, counter-clockwise seen from outside.
    """

    name: str
    cells: Integers = field(repr=False)
    triangles: Integers = field(repr=False)
    vertices: Integers = field(repr=False)
    points: Array = field(repr=False)
    edges: tuple[PieceEdge, ...]

    @property
    def areas(self) -> Array:
        """Areas of the cells (m,) (length squared)."""
        return np.asarray(norm(double_areas(self.points[self.triangles])) / 2)

    @property
    def area(self) -> float:
        """Area of the piece (length squared)."""
        return float(self.areas.sum())

    @property
    def outline(self) -> Integers:
        """Vertices (k,) along its rim, counter-clockwise seen from outside."""
        return np.concatenate([edge.vertices[:-1] for edge in self.edges])

    @property
    def curvature(self) -> float:
        """Mean Gaussian curvature (1 / length squared): angle defects over area."""
        x, t = self.points[self.triangles], self.triangles
        a, b = np.roll(x, -1, axis=1) - x, np.roll(x, -2, axis=1) - x
        angles = np.arctan2(norm(cross(a, b)), np.einsum("nki,nki->nk", a, b))
        missing = 2 * np.pi - np.bincount(t.ravel(), angles.ravel(), len(self.points))
        around = np.bincount(t.ravel(), np.repeat(self.areas / 3, 3), len(self.points))
        inner = np.setdiff1d(np.arange(len(self.points)), self.outline)
        return float(missing[inner].sum() / around[inner].sum()) if len(inner) else 0.0


@dataclass(frozen=True)
class Joints:
    """Seam segments, each joining two pieces."""

    seams: tuple[str, ...]  # seam name of each segment
    pieces: Integers  # (k, 2) pieces on both sides
    ends: Integers  # (k, 2, 2) end vertices on both sides, in matching order


@dataclass(frozen=True, repr=False)
class Pieces:
    """A surface that is cut into pieces.

    Attributes
    ----------
    mesh
        The surface with cells divided along the seams: groups as before, seams as groups of edges,
        pieces as parts.
    seams
        The seams.
    pieces
        The pieces, the same on all ranks.
    joints
        Pairs of edge segments that are sewn together.
    surface
        The cut surface with all groups, on all ranks.
    lines
        Vertices (k,) of the cut surface along each seam, by names.
    origin
        The mesh that was cut.
    """

    mesh: MembraneMesh
    seams: tuple[Seam, ...]
    pieces: tuple[Piece, ...]
    joints: Joints
    surface: CheckedSurface
    lines: Mapping[str, Integers]
    origin: Origin

    def __repr__(self) -> str:
        """One line; not collective."""
        seams, pieces = counted(len(self.seams), "seam"), counted(len(self.pieces), "piece")
        return f"Pieces({pieces}, {seams}, area {self.area:.6g})"

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the mesh."""
        return self.mesh.comm

    @property
    def area(self) -> float:
        """Area of all pieces in space (length squared)."""
        return sum(piece.area for piece in self.pieces)

    def piece(self, name: str) -> Piece:
        """Return the piece with a name.

        Examples
        --------
        >>> round(pieces.piece("piece 1").area, 1)
        12.1
        """
        return checks.named("piece", {piece.name: piece for piece in self.pieces}, name)


@collective
def cut(mesh: MembraneMesh, seams: Sequence[Seam]) -> Pieces:
    """Cut a surface along seams. Collective.

    Cells that seams cross are divided. A vertex nearer to a crossing than a fifth of the edge is
    moved there along the edge, to avoid slivers; this changes the surface by no more than its
    difference from the smooth one.

    Parameters
    ----------
    mesh
        The surface, such as `FoundForm.mesh`.
    seams
        Seams on it, none for one piece. They may meet and cross at vertices of the mesh, and at
        common points of edges.

    Returns
    -------
    Pieces
        The pieces, named "piece 1", "piece 2" ... across the roof.

    Raises
    ------
    InputError
        On all ranks: no seams, or two of one name.
    PathError
        On all ranks: seams that end inside the surface, coincide with its boundary or each other,
        or cross inside cells; a piece that is closed or has a hole.

    Examples
    --------
    >>> seams = patterns.strips(found.mesh, "front", "back", width=2.5)
    >>> pieces = patterns.cut(found.mesh, seams)
    """
    surface = PatternSurface.of(mesh)
    checks.collection("cut: seams", seams, Sequence, "[patterns.geodesic(...)]")
    for seam in seams:
        checks.of_type("cut: a seam", seam, Seam)
    names = [seam.name for seam in seams]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise InputError(f"cut: two seams have the name {twice[0]!r}.")
    with raised_together(mesh.comm):
        whole, lines, origin = cut_along(surface, mesh, seams)
        pieces, joints = _pieces(whole, lines)
    parts = whole.parts | {piece.name: piece.cells for piece in pieces}
    named = replace(whole, parts=parts)
    first = named if mesh.comm.rank == 0 else EMPTY
    return Pieces(
        distribute(mesh.comm, first, None, None), tuple(seams), pieces, joints, named, lines, origin
    )


def _seam_of(cut: CheckedSurface, lines: Mapping[str, Integers]) -> dict[Edge, str]:
    """The seam's name by edge."""
    found: dict[Edge, str] = {}
    for name, line in lines.items():
        for a, b in pairwise(ints(line)):
            if found.setdefault(edge_of(a, b), name) != name:
                raise PathError(
                    f"the seams {found[edge_of(a, b)]!r} and {name!r} run along one edge at "
                    f"{as_text(cut.points[a])}; move one of them, or end it there."
                )
    return found


def _pieces(cut: CheckedSurface, lines: Mapping[str, Integers]) -> tuple[tuple[Piece, ...], Joints]:
    """The pieces of a cut surface and their joints."""
    points, cells, seam_of = cut.points, cut.cells, _seam_of(cut, lines)
    table = EdgeTable.of(cells)
    edges = [(a, b) for a, b in lists(table.vertices)]
    sewn = np.array([edge in seam_of for edge in edges])
    for k in np.flatnonzero(sewn & (table.counts < 2)):
        raise PathError(
            f"the seam {seam_of[edges[k]]!r} does not cut the surface: it runs along its boundary "
            f"at {as_text(points[edges[k][0]])}; lead it over the inside."
        )
    joined = (table.counts == 2) & ~sewn
    s, t = table.linked_sides(joined)
    labels = connected_labels(len(cells), s // 3, t // 3)
    # corners at one vertex of a piece: both ends of sides that are not cut
    following = np.arange(cells.size).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    corner = connected_labels(
        cells.size, np.concatenate([s, following[s]]), np.concatenate([following[t], t])
    )
    rim_sides = np.setdiff1d(np.arange(cells.size), np.concatenate([s, t]))
    number = np.empty(cells.size, dtype=np.int64)  # of each corner's vertex in its piece
    edge_of_side = np.empty(cells.size, dtype=np.int64)
    edge_of_side[table.order] = np.repeat(np.arange(len(edges)), table.counts)
    groups = sorted(cut.edges.items(), key=lambda one: one[0] != BOUNDARY)  # the boundary gives way
    names = {edge: name for name, keys in groups for edge in edges_of(keys)} | seam_of
    found, labels = [], np.argsort(_in_order(cut, lines, labels))[labels]
    for k in range(labels.max() + 1):
        own = np.flatnonzero(labels == k)
        corners = (3 * own[:, None] + np.arange(3)).ravel()
        _, first, local = np.unique(corner[corners], return_index=True, return_inverse=True)
        number[corners] = local
        vertices = cells.ravel()[corners[first]]
        sides = rim_sides[np.isin(rim_sides // 3, own)]
        euler = len(vertices) - (len(corners) + len(sides)) // 2 + len(own)
        rim = {int(number[side]): side for side in sides}
        loop = _loop(rim, number[following])
        if euler != 1 or len(loop) != len(sides):
            raise PathError(
                f"the piece around {as_text(points[vertices].mean(axis=0))} cannot lie flat: it "
                f"{'is closed' if not len(sides) else 'has a hole'}; add a seam that cuts it open."
            )
        on = [edges[edge_of_side[side]] for side in loop]
        rims = _stretches(number[loop], [(names[e], e in seam_of) for e in on])
        found.append(
            Piece(f"piece {k + 1}", own, local.reshape(-1, 3), vertices, points[vertices], rims)
        )
    s, t = table.linked_sides(sewn & (table.counts == 2))
    one, other = (np.stack([sides, following[sides]], axis=1) for sides in (s, t))
    alike = cells.ravel()[s] == cells.ravel()[t]
    other = np.where(alike[:, None], other, other[:, ::-1])
    joints = Joints(
        tuple(seam_of[edge_of(a, b)] for a, b in lists(cells.ravel()[one])),
        np.stack([labels[s // 3], labels[t // 3]], axis=1),
        np.stack([number[one], number[other]], axis=1),
    )
    return tuple(found), joints


def _in_order(cut: CheckedSurface, lines: Mapping[str, Integers], labels: Integers) -> Integers:
    """Piece labels in order across the surface, in the seams' sense."""
    points, cells = cut.points, cut.cells
    area = norm(double_areas(points[cells]))
    centres = (
        np.stack([np.bincount(labels, area * x) for x in points[cells].mean(axis=1).T], axis=1)
        / np.bincount(labels, area)[:, None]
    )
    away = centres - centres.mean(axis=0)
    _, _, axes = np.linalg.svd(away, full_matrices=False)
    axis = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]) > 1e-6)])
    of_seams = [float(points[line].mean(axis=0) @ axis) for line in lines.values()]
    size = np.abs(away).max() or 1.0
    if of_seams and of_seams[-1] < of_seams[0] - 1e-6 * size:
        axis = -axis
    return np.lexsort((*np.round(centres.T / size, 6), np.round(away @ axis / size, 6)))


def _loop(rim: dict[int, int], end_of: Integers) -> list[int]:
    """The sides around a piece, starting at its lowest vertex."""
    if not rim:
        return []
    start = min(rim)
    loop = [rim[start]]
    while (vertex := int(end_of[loop[-1]])) != start and len(loop) <= len(rim):
        loop.append(rim[vertex])
    return loop


def _stretches(starts: Integers, kinds: list[tuple[str, bool]]) -> tuple[PieceEdge, ...]:
    """The edges of a piece: runs of equal kind, from the start vertices of its sides."""
    n = len(starts)
    breaks = [k for k in range(n) if kinds[k] != kinds[k - 1]] or [0]
    ring = np.concatenate([starts, starts, starts[:1]])
    ends = [*breaks[1:], breaks[0] + n]
    return tuple(PieceEdge(*kinds[a], ring[a : b + 1]) for a, b in zip(breaks, ends, strict=True))
