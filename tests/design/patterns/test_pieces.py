"""Pieces: areas, angles, edges and joints; cuts that make none are named."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import InputError, PathError, meshes, patterns
from crms_fenicsx.design.patterns.pattern_surface import PatternSurface
from crms_fenicsx.foundation.meshes.triangles import area_vectors, norm


def least_angle(points: np.ndarray, cells: np.ndarray) -> float:
    """Least angle of triangles (degrees)."""
    x = points[cells]
    a, b = np.roll(x, -1, axis=1) - x, np.roll(x, -2, axis=1) - x
    sine, cosine = norm(np.cross(a, b)), np.einsum("nki,nki->nk", a, b)
    return float(np.degrees(np.arctan2(sine, cosine)).min())


def random_square(comm: MPI.Intracomm) -> meshes.MembraneMesh:
    """450 cells over 6 x 6 with vertices moved at random."""
    from scipy.spatial import Delaunay

    rng, g = np.random.default_rng(3), np.linspace(-3.0, 3.0, 16)
    x = np.stack(np.meshgrid(g, g, indexing="ij"), axis=-1).reshape(-1, 2)
    inner = (np.abs(x) < 2.9).all(axis=1)
    x[inner] += rng.uniform(-0.1, 0.1, (inner.sum(), 2))
    return meshes.from_arrays(comm, x, Delaunay(x).simplices)


@pytest.mark.ranks
def test_pieces_make_up_the_surface(comm: MPI.Intracomm) -> None:
    """Their areas add up, their joints lie together, their edges go round."""
    cap = meshes.spherical_cap(comm, radius=10.0, height=8.0, size=2.0)
    seams = [
        patterns.plane_section(cap, (x, 0.0, 5.0), (1.0, 0.02 * x, 0.0), name=f"s{x}")
        for x in (-3, 0, 3)
    ]
    pieces = patterns.cut(cap, seams)
    assert [piece.name for piece in pieces.pieces] == [f"piece {k}" for k in (1, 2, 3, 4)]
    whole = comm.allreduce(norm(area_vectors(cap.mesh)).sum())
    np.testing.assert_allclose(pieces.area, whole, rtol=2e-3)  # vertices were moved on facets
    for sides, ends in zip(pieces.joints.pieces, pieces.joints.ends, strict=True):
        a, b = (pieces.pieces[k].points[e] for k, e in zip(sides, ends, strict=True))
        np.testing.assert_array_equal(a, b)
        assert sides[0] != sides[1]
    for piece in pieces.pieces:
        np.testing.assert_array_equal(np.sort(piece.vertices), np.unique(piece.vertices))
        names = [edge.name for edge in piece.edges]
        assert len(names) == 2 * sum(edge.sewn for edge in piece.edges)
        ends = [edge.vertices[-1] for edge in piece.edges]
        assert ends == [edge.vertices[0] for edge in (*piece.edges[1:], piece.edges[0])]
    assert {"s-3", "s0", "s3", "boundary"} <= set(pieces.mesh.edges)


def test_curvature_of_a_piece_of_a_sphere(comm: MPI.Intracomm) -> None:
    """With first order, as the rim's half cells are left out."""
    errors = []
    for size in (1.0, 0.5):
        cap = meshes.spherical_cap(comm, radius=10.0, height=8.0, size=size)
        seam = patterns.plane_section(cap, (0.0, 0.0, 5.0), (1.0, 0.0, 0.0), name="seam")
        curvature = patterns.cut(cap, [seam]).piece("piece 1").curvature
        errors.append(abs(curvature * 10.25**2 - 1.0))
    assert errors[1] < min(0.03, 0.7 * errors[0])


@pytest.mark.parametrize(("offset", "angle"), [(0.0, 11.0), (0.97, 8.0)])
def test_cells_beside_seams_are_no_slivers(
    comm: MPI.Intracomm, offset: float, angle: float
) -> None:
    """Without moving vertices the least angles are 1.4 and .1 degrees."""
    mesh = random_square(comm)
    seam = patterns.plane_section(mesh, (offset, 0.0, 0.0), (1.0, -0.3, 0.0), name="seam")
    pieces = patterns.cut(mesh, [seam])
    assert least_angle(pieces.surface.points, pieces.surface.cells) > angle
    np.testing.assert_allclose(pieces.area, 36.0, rtol=1e-12)
    sides = zip(pieces.joints.pieces[:, 0], pieces.joints.ends[:, 0], strict=True)
    on = [pieces.pieces[k].points[ends] for k, ends in sides]
    away = (np.concatenate(on) - (offset, 0.0, 0.0)) @ (1.0, -0.3, 0.0)
    np.testing.assert_allclose(away, 0.0, atol=1e-3)


def test_groups_are_kept(comm: MPI.Intracomm) -> None:
    """Divided where seams cross them, and points stay where they are."""
    mesh = meshes.rectangle(comm, 10.0, 6.0, 1.0)
    pieces = patterns.cut(mesh, patterns.strips(mesh, "front", "back", 1.7))
    assert {"front", "back", "left", "right"} <= set(pieces.mesh.edges)
    sides = pieces.surface.edges["left"]
    x = pieces.surface.points[np.stack([sides >> 32, sides & 0xFFFFFFFF], axis=1)]
    np.testing.assert_allclose(norm(x[:, 1] - x[:, 0]).sum(), 6.0)
    corner = pieces.surface.points[pieces.surface.point_groups["back right"]]
    np.testing.assert_array_equal(corner, [(10.0, 6.0, 0.0)])


def test_seams_may_cross_at_vertices(comm: MPI.Intracomm) -> None:
    """Gores of a dome meet at its apex."""
    cap = meshes.spherical_cap(comm, radius=10.0, height=10.0, size=2.0)
    x = comm.bcast(cap.mesh.geometry.x)
    apex = x[np.argmax(x[:, 2])][:2]
    ends = [9.8 * np.array([np.cos(a), np.sin(a)]) for a in (0.3, 1.3, 2.3)]
    seams = [
        patterns.plane_section(cap, (*apex, 10.0), (-end[1], end[0], 0.0), name=f"meridian {k}")
        for k, end in enumerate(ends)
    ]
    pieces = patterns.cut(cap, seams)
    assert len(pieces.pieces) == 6
    assert all(len(piece.edges) == 3 for piece in pieces.pieces)


def test_a_surface_may_be_one_piece_and_be_cut_again(comm: MPI.Intracomm) -> None:
    mesh = meshes.rectangle(comm, 10.0, 6.0, 1.0)
    whole = patterns.cut(mesh, patterns.strips(mesh, "front", "back", 7.0))
    (piece,) = whole.pieces
    assert piece.area == pytest.approx(60.0) and len(whole.joints.seams) == 0
    again = patterns.cut(whole.mesh, patterns.strips(whole.mesh, "front", "back", 3.5))
    assert [one.area for one in again.pieces] == pytest.approx([30.0, 30.0], rel=1e-3)
    assert again.mesh.parts["piece 1"].size < len(again.surface.cells)


def test_pieces_lie_between_their_seams(comm: MPI.Intracomm) -> None:
    """Piece k + 1 follows seam k, whichever end of the roof these begin at."""
    mesh = meshes.rectangle(comm, 10.0, 6.0, 1.0)
    for sides in (("front", "back"), ("back", "front")):
        pieces = patterns.cut(mesh, patterns.strips(mesh, *sides, 1.7))
        for k, piece in enumerate(pieces.pieces):
            sewn = {edge.name for edge in piece.edges if edge.sewn}
            assert sewn == {f"seam {k}", f"seam {k + 1}"} - {"seam 0", "seam 4"}


def annulus(comm: MPI.Intracomm) -> meshes.MembraneMesh:
    """A flat ring with 24 cells around it."""
    a = np.linspace(0.0, 2 * np.pi, 13)[:-1]
    x = np.concatenate([r * np.stack([np.cos(a), np.sin(a)], axis=1) for r in (2.0, 4.0)])
    k, n = np.arange(12), (np.arange(12) + 1) % 12
    cells = np.concatenate([np.stack([k, k + 12, n + 12], 1), np.stack([k, n + 12, n], 1)])
    return meshes.from_arrays(comm, x, cells, edges={"spoke": [(0, 12)]})


def test_a_ring_cut_open_has_both_sides_of_its_seam(comm: MPI.Intracomm) -> None:
    pieces = patterns.cut(annulus(comm), [patterns.edge_line(annulus(comm), "spoke")])
    (piece,) = pieces.pieces
    assert [edge.name for edge in piece.edges].count("spoke") == 2
    assert pieces.joints.pieces.tolist() == [[0, 0]]
    assert len(piece.points) == 26


@pytest.mark.ranks
@pytest.mark.parametrize(
    "case", ["inside", "boundary", "hole", "crossing", "twice", "none", "same"]
)
def test_cuts_that_make_no_pieces_are_named(comm: MPI.Intracomm, case: str) -> None:
    square = random_square(comm)

    def line(y: float, slope: float = 0.0, name: str = "a") -> patterns.Seam:
        return patterns.plane_section(square, (0.0, y, 0.0), (slope, 1.0, 0.0), name=name)

    short = patterns.geodesic(square, [(-3.0, 0.31), (1.0, 0.3)], name="short")
    cone = _cone(meshes.circle(comm, radius=4.0, size=1.0))
    ring = patterns.plane_section(cone, (0.0, 0.0, 1.0), (0.0, 0.0, 1.0), name="ring")
    text, seams, error = {
        "hole": ("has a hole", [ring], PathError),
        "inside": ("'short' does not cut the surface: it ends inside", [short], PathError),
        "boundary": ("'boundary' does not", [patterns.edge_line(square, "boundary")], PathError),
        "crossing": ("crosses another one", [line(0.11), line(0.13, 0.31, "b")], PathError),
        "twice": ("two seams have the name 'a'", [line(0.1), line(1.1)], InputError),
        "none": ("is not a valid list", line(0.1), InputError),
        "same": ("along one edge", [line(0.1), line(0.1, name="b")], PathError),
    }[case]  # fmt: skip
    with pytest.raises(error, match=text):
        patterns.cut(cone if case == "hole" else square, seams)


def _cone(disc: meshes.MembraneMesh) -> meshes.MembraneMesh:
    """A disc of radius 4 raised to a cone."""
    surface = PatternSurface.of(disc)
    height = 4.0 - np.hypot(*surface.points[:, :2].T)
    return meshes.from_arrays(
        disc.comm, surface.points + height[:, None] * (0.0, 0.0, 0.5), surface.cells
    )
