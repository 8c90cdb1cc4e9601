"""Flat pieces: developable surfaces, gores of a sphere, both sides of seams."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from pattern_surfaces import FABRIC, cone, grid, half_cylinder, hypar, pieces_of, two_gores

from crms_fenicsx import (
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    PatternWarning,
    patterns,
)
from crms_fenicsx.design.patterns.flattening import (
    FlatProblem,
    conformal,
    divided,
    fine_energies,
)

FILM = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)


@pytest.mark.ranks
@pytest.mark.parametrize("material", [FILM, FABRIC])
def test_half_cylinder_unrolls(comm: MPI.Intracomm, material: IsotropicMembrane) -> None:
    """Strips are as wide as the polygon's sides, without any strain."""
    pattern = patterns.flatten(pieces_of(half_cylinder(comm, 4, 3, 8)), material)
    assert len(pattern.flat) == 4
    for one in pattern.flat:
        assert one.width == pytest.approx(3 * 10.0 * np.sin(np.pi / 24), rel=1e-10)
        assert one.length == pytest.approx(8.0, rel=1e-10)
        assert one.energy < 1e-20 and one.distortion < 1e-10
    assert pattern.area == pytest.approx(pattern.pieces.area, rel=1e-12)


def test_meshes_beside_the_rulings_converge(comm: MPI.Intracomm) -> None:
    """Vertices at random are strained by the facets' curvature: the energy falls with order 4."""
    found = []
    for columns in (4, 16):
        mesh = half_cylinder(comm, 4, columns, 2 * columns, jitter=0.25)
        found.append(patterns.flatten(pieces_of(mesh), FABRIC).flat[0].energy)
    assert np.log2(found[0] / found[1]) / 2 > 2.5
    assert found[1] < 1e-4


@pytest.mark.parametrize("half_angle", [20.0, 50.0])
def test_cone_unrolls_to_a_sector(comm: MPI.Intracomm, half_angle: float) -> None:
    """Of the angle 2 pi sin a for a whole turn, inscribed as the facets are."""
    a = np.radians(half_angle)
    pattern = patterns.flatten(pieces_of(cone(comm, a, 12, 6)), FILM, warp="seams")
    for one in pattern.flat:
        assert one.energy < 1e-20
        radii = [one.shape[edge.vertices] for edge in one.piece.edges if len(edge.vertices) == 7]
        along = [radius[-1] - radius[0] for radius in radii]
        angles = [np.arctan2(v[1], v[0]) % np.pi for v in along]
        facet = 2 * np.arcsin(np.sin(a) * np.sin(1.5 * np.pi / 48))
        turn = abs(angles[0] - angles[-1]) if len(angles) > 1 else np.nan
        if np.isfinite(turn):
            assert min(turn, np.pi - turn) == pytest.approx(12 * facet % np.pi, rel=1e-9)


@pytest.mark.parametrize(
    ("gores", "columns", "energy"),
    [(16, 8, 6.94e-3), (16, 16, 6.94e-3), (32, 8, 4.389e-4), (64, 8, 2.7505e-5),
     pytest.param(32, 16, 4.389e-4, marks=pytest.mark.slow),
     pytest.param(64, 16, 2.7505e-5, marks=pytest.mark.slow)],
)  # fmt: skip
def test_gores_of_a_sphere(comm: MPI.Intracomm, gores: int, columns: int, energy: float) -> None:
    """Energy per area, extrapolated by itself; it falls with the width's fourth power."""
    pieces = pieces_of(two_gores(comm, gores, columns, columns * gores // 4))
    found = patterns.flatten(pieces, FILM).flat[0].energy
    assert found == pytest.approx(energy, rel=1e-2)
    width = 2 * np.pi * 10.0 / gores
    assert found == pytest.approx(8 / 15 * 800.0 * 1e-4 * width**4 / 1440, rel=0.03)


def test_outline_of_gores(comm: MPI.Intracomm) -> None:
    """Against series for narrow gores: the middle is K W^2 / 48 shorter than the meridian, edges
    are twice as much longer, the width is that on the sphere. 2e-5 are .6 mm of 31 m."""
    width = 2 * np.pi * 10.0 / 32
    for columns, error in ((8, 2e-5), (16, 4e-6)):
        pieces = pieces_of(two_gores(comm, 32, columns, 8 * columns))
        one = patterns.flatten(pieces, FILM).flat[0]
        (seam,) = (edge for edge in one.piece.edges if edge.sewn)
        sides = one.piece.points[seam.vertices]
        meridian = np.linalg.norm(np.diff(sides, axis=0), axis=1).sum()
        part = width**2 / 100.0 / 48
        edge = np.linalg.norm(np.diff(one.shape[seam.vertices], axis=0), axis=1).sum()
        found = np.array([one.length, edge]) / meridian
        np.testing.assert_allclose(found, (1 - part, 1 + 2 * part), rtol=error)
        assert one.width == pytest.approx(width, rel=1.5e-4 * (8 / columns) ** 1.5)


def test_strains_across_a_gore(comm: MPI.Intracomm) -> None:
    """Along the warp K (W^2/24 - y^2/2): a dome's pieces are tighter in the middle, a saddle's at
    the seams."""
    pieces = pieces_of(two_gores(comm, 32, 16, 128))
    one = patterns.flatten(pieces, FILM).flat[0]
    corners = one.shape[one.piece.triangles] - [one.length / 2, one.width / 2]
    near, width = np.abs(corners[:, :, 0]).max(axis=1) < 0.5, 2 * np.pi * 10.0 / 32
    y = np.median(corners[near, :, 1], axis=1)  # of the side along the warp
    exact = 0.01 * (width**2 / 24 - y**2 / 2)
    np.testing.assert_allclose(one.strains[near, 0], exact, atol=0.02 * exact.max())
    saddle = patterns.flatten(pieces_of(hypar(comm, 8)), FABRIC).flat[1]
    centres = saddle.shape[saddle.piece.triangles].mean(axis=1)
    x, y = np.abs(centres - np.ptp(saddle.shape, axis=0) / 2).T
    assert saddle.strains[(x < 1) & (y > 0.8), 0].min() > 0.0
    assert saddle.strains[(x < 1) & (y < 0.2), 0].max() < 0.0


def test_energies_on_finer_cells_fall_with_second_order(comm: MPI.Intracomm) -> None:
    """Of a gore on its cells, and on those divided, whose facets stay: from there on vertices
    that gather the curvature take a little off."""
    pieces = pieces_of(two_gores(comm, 32, 8, 64))
    one = patterns.flatten(pieces, FILM).flat[0]
    found = np.array(fine_energies(one.piece, one.shape, one.problem_of))
    assert len(found) == 3 and (np.diff(found) < 0.0).all()
    exact = 4.389e-4 * one.piece.area
    orders = np.log2((found[:-1] - exact) / (found[1:] - exact))
    np.testing.assert_allclose(orders, [1.75, 1.75], atol=0.1)


def test_divided_pieces_are_the_same_surface(comm: MPI.Intracomm) -> None:
    """With their edges, in the same sense."""
    piece = pieces_of(hypar(comm, 4)).pieces[1]
    finer, ends = divided(piece)
    assert finer.area == pytest.approx(piece.area, rel=1e-12)
    assert len(finer.cells) == 4 * len(piece.cells) and len(finer.points) == len(ends) + len(
        piece.points
    )
    for coarse, fine in zip(piece.edges, finer.edges, strict=True):
        a, b = piece.points[coarse.vertices], finer.points[fine.vertices]
        np.testing.assert_allclose(b[::2], a)
        np.testing.assert_allclose(b[1::2], (a[1:] + a[:-1]) / 2)
    normals = [np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
               for x in (piece.points[piece.triangles], finer.points[finer.triangles])]  # fmt: skip
    np.testing.assert_allclose(4 * normals[1], np.tile(normals[0], (4, 1)), atol=1e-12)


@pytest.mark.ranks
def test_estimates_tell_beforehand(comm: MPI.Intracomm) -> None:
    """Strains and energies of gores, as the flattening finds them later."""
    pieces = pieces_of(two_gores(comm, 32, 8, 64))
    one = patterns.estimates(pieces, FILM)["piece 1"]
    assert one.width == pytest.approx(2 * np.pi * 10.0 / 32, rel=0.01)
    assert one.strain == pytest.approx(3.2e-3, rel=0.02)
    assert one.energy == pytest.approx(4.404e-4, rel=0.03)
    gore = patterns.flatten(pieces, FILM).flat[0]
    assert gore.largest_width(1.5) == pytest.approx(1.5, rel=0.02)
    assert patterns.largest_width(FILM, 1.5, 0.01) == pytest.approx(1.5)
    flat = patterns.estimates(pieces_of(half_cylinder(comm, 4, 3, 8)), FABRIC)["piece 2"]
    assert flat.width == pytest.approx(30 * np.sin(np.pi / 24)) and abs(flat.strain) < 1e-10


def test_few_columns_are_told(comm: MPI.Intracomm) -> None:
    with pytest.warns(PatternWarning, match="refine the mesh"):
        patterns.flatten(pieces_of(two_gores(comm, 8, 6, 12)), FILM)


@pytest.mark.ranks
def test_both_sides_of_seams_are_equally_long(comm: MPI.Intracomm) -> None:
    """Though the pieces' compensations differ; it costs hardly any energy."""
    pieces = pieces_of(hypar(comm, 8))
    shrink = {"piece 1": patterns.Shrink(0.002, 0.001), "piece 2": patterns.Shrink(0.001, 0.003)}
    free = patterns.flatten(pieces, FABRIC, shrink=shrink, equal=False)
    equal = patterns.flatten(pieces, FABRIC, shrink=shrink)
    for seam, lengths in equal.seam_lengths().items():
        np.testing.assert_allclose(lengths[:, 0], lengths[:, 1], rtol=1e-9)
        assert np.abs(np.diff(free.seam_lengths()[seam], axis=1)).max() > 1e-5
    plain = [patterns.flatten(pieces, FABRIC, equal=equal) for equal in (False, True)]
    energies = [sum(one.energy * one.piece.area for one in pattern.flat) for pattern in plain]
    assert energies[0] <= energies[1] < 1.001 * energies[0]


def test_hypar_is_strained_as_measured(comm: MPI.Intracomm) -> None:
    """Along warp, weft and in shear; free seams differ by .27 mm."""
    pattern = patterns.flatten(pieces_of(hypar(comm, 8)), FABRIC, equal=False)
    strains = np.abs(np.concatenate([one.strains for one in pattern.flat])).max(axis=0)
    np.testing.assert_allclose(strains, [0.0029, 0.0020, 0.0102], rtol=0.1)
    for lengths in pattern.seam_lengths().values():
        assert abs(np.diff(lengths.sum(axis=0))) == pytest.approx(2.7e-4, rel=0.1)


def test_gradient_is_that_of_the_energy() -> None:
    """Taylor test: what the gradient leaves of a change falls with the square of the step."""
    rng = np.random.default_rng(0)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(4.0), np.arange(5.0), indexing="ij"))
    points, cells = np.stack([x, y, 0.05 * x * y], axis=1), grid(3, 4)
    stiffness = np.tile(FABRIC.stiffness, (len(cells), 1, 1))
    wanted = rng.uniform(-0.02, 0.02, (len(cells), 3))
    problem = FlatProblem("piece", points, cells, stiffness, wanted, np.array([0, 1, 7]))
    flat = conformal(points, cells) + rng.uniform(-0.05, 0.05, (20, 2))
    _, g = problem.linearised(flat)
    step = rng.uniform(-1.0, 1.0, len(g))
    left = [
        abs(problem.energy(problem.moved(flat, h * step)) - problem.energy(flat) - h * g @ step)
        for h in (1e-3, 1e-4)
    ]
    assert np.log10(left[0] / left[1]) > 1.95


def test_conformal_map_keeps_angles_of_a_sphere() -> None:
    """A cap's is the stereographic projection, up to its scale."""
    a = np.linspace(0.0, 2 * np.pi, 49)[:-1]
    r = np.linspace(0.05, 0.6, 12)
    b, c = (one.ravel() for one in np.meshgrid(r, a, indexing="ij"))
    points = np.stack([np.sin(b) * np.cos(c), np.sin(b) * np.sin(c), np.cos(b)], axis=1)
    from scipy.spatial import Delaunay

    plane = np.tan(b / 2)[:, None] * np.stack([np.cos(c), np.sin(c)], axis=1)
    cells = Delaunay(plane).simplices
    found = conformal(points, cells) @ (1.0, 1j)
    exact = plane @ (1.0, 1j)
    A = np.stack([exact, np.ones(len(exact))], axis=1)
    if np.linalg.det(np.diff(plane[cells[0]], axis=0)) < 0:
        found = found.conj()
    fitted, *_ = np.linalg.lstsq(A, found, rcond=None)
    assert np.abs(A @ fitted - found).max() < 0.01 * np.abs(found).max()


def test_warp_lies_along_x(comm: MPI.Intracomm) -> None:
    """That of the fabric, of a function, or that along the seams."""
    pieces = pieces_of(half_cylinder(comm, 4, 3, 8))
    turned = OrthotropicMembrane(900.0, 700.0, 30.0, 0.2, 1.0, warp=(0.0, 0.0, 1.0))
    first = patterns.flatten(pieces, turned).flat[0]
    np.testing.assert_allclose([first.width, first.length], [8.0, 30 * np.sin(np.pi / 24)])
    for warp in ("seams", lambda x: np.array([0 * x[0], 1 + 0 * x[0], 0 * x[0]])):
        assert patterns.flatten(pieces, turned, warp=warp).flat[0].length == pytest.approx(8.0)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"limit": 1e-3}, r"piece 1 \(.* wide\) by 0.011: cut it into 4 strips"),
        ({"shrink": {"nowhere": patterns.Shrink()}}, "no piece or part"),
        ({"shrink": 0.01}, "shrink is of type float"),
        ({"edges": {"nowhere": patterns.EdgeShrink()}}, "nowhere"),
        ({"edges": {"boundary": 0.0}}, "EdgeShrink"),
        ({"warp": (0.0, 0.0, 0.0)}, "warp"),
        ({"warp": lambda x: x[:2]}, "must return directions"),
        ({"limit": -1.0}, "limit"),
    ],
)
def test_bad_options_are_named(options, text, comm: MPI.Intracomm) -> None:  # type: ignore[no-untyped-def]
    pieces = pieces_of(hypar(comm, 4))
    with pytest.raises(InputError, match=text):
        patterns.flatten(pieces, FABRIC, **options)


class TestCompensation:
    """Stretches by the fabric's law, parts by hand, edges of their own."""

    def test_forces_are_those_of_the_law(self) -> None:
        """Per current length, for small forces and for large ones."""
        for forces in ((2.0, 2.0), (20.0, 10.0), (0.0, 3.0)):
            shrink = patterns.shrink_for(FABRIC, forces)
            l1, l2 = 1 / (1 - shrink.at(np.zeros(1))[0])
            S = FABRIC.stiffness[:2, :2] @ ((l1**2 - 1) / 2, (l2**2 - 1) / 2)
            np.testing.assert_allclose([l1 / l2 * S[0], l2 / l1 * S[1]], forces, atol=1e-10)

    def test_cut_widths_are_shrunk(self, comm: MPI.Intracomm) -> None:
        """Piece by piece, all of a developable surface."""
        pieces = pieces_of(half_cylinder(comm, 4, 3, 8))
        shrink = {"piece 2": patterns.Shrink(0.01, 0.02)}
        plain, cut = (
            patterns.flatten(pieces, FABRIC, shrink=s, equal=False) for s in (None, shrink)
        )
        for one, other in zip(plain.flat, cut.flat, strict=True):
            part = np.array([0.01, 0.02]) if one.name == "piece 2" else np.zeros(2)
            np.testing.assert_allclose(other.shape, one.shape * (1.0 - part), atol=1e-9)
            np.testing.assert_allclose(other.shrink, part, atol=1e-12)

    def test_sections_along_a_piece(self, comm: MPI.Intracomm) -> None:
        """Weft shrunk linearly from one end to the other makes a trapezium."""
        pieces = pieces_of(half_cylinder(comm, 4, 3, 32))
        shrink = patterns.Shrink(weft=[(0.0, 0.0), (1.0, 0.02)])
        one = patterns.flatten(pieces, FABRIC, shrink=shrink, equal=False).flat[0]
        full = 30 * np.sin(np.pi / 24)
        widths = [np.ptp(one.shape[np.abs(one.shape[:, 0] - x) < 0.05, 1]) for x in (0.0, 4.0, 8.0)]
        np.testing.assert_allclose(widths, [full, 0.99 * full, 0.98 * full], rtol=1e-3)

    def test_edges_keep_their_own(self, comm: MPI.Intracomm) -> None:
        """A clamped end is as wide as the form, the middle is compensated."""
        pieces = pieces_of(half_cylinder(comm, 4, 6, 48))
        shrink = patterns.Shrink(0.0, 0.02)
        edges = {"boundary": patterns.EdgeShrink(0.0, band=1.0)}
        one = patterns.flatten(pieces, FABRIC, shrink=shrink, edges=edges, equal=False).flat[1]
        full = 60 * np.sin(np.pi / 48)
        ends = one.shape[next(edge.vertices for edge in one.piece.edges if not edge.sewn)]
        middle = one.shape[np.abs(one.shape[:, 0] - 4.0) < 0.05]
        assert np.ptp(ends[:, 1]) == pytest.approx(full, rel=4e-3)
        assert np.ptp(middle[:, 1]) == pytest.approx(0.98 * full, rel=2e-3)

    @pytest.mark.parametrize(
        ("make", "text"),
        [
            (lambda: patterns.Shrink(1.0, 0.0), "100% shorter"),
            (lambda: patterns.Shrink(weft=[(0.0, 0.1), (0.0, 0.2)]), "ascend"),
            (lambda: patterns.Shrink("much"), "number"),
            (lambda: patterns.EdgeShrink(0.0, band=0.0), "band"),
            (lambda: patterns.EdgeShrink(1.0), "shorter"),
            (lambda: patterns.shrink_for(FILM, (-1.0, 2.0)), "compressive"),
            (lambda: patterns.shrink_for(FILM, 1e6), "use smaller ones"),
            (lambda: patterns.shrink_for(None, 1.0), "no linear law"),  # type: ignore[arg-type]
        ],
    )
    def test_bad_compensation_is_named(self, make, text: str) -> None:  # type: ignore[no-untyped-def]
        with pytest.raises(InputError, match=text):
            make()
