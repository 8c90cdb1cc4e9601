"""Pictures: what hides what, judged by pixels, and the geometry behind it."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced
from grids import grid
from mpi4py import MPI
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.output import (
    History,
    Line,
    draw,
    draw_history,
    draw_path,
    draw_shape,
    join_pictures,
)
from crms_fenicsx.results.output.figures import draw_scene, plans
from crms_fenicsx.results.output.figures.cable_lines import (
    CABLE,
    _common_value,
    _in_words,
    _limits_of,
    line_style,
)
from crms_fenicsx.results.output.figures.draw_paths import _spaced_steps
from crms_fenicsx.results.output.figures.draw_surface import outline_of, sides_among
from crms_fenicsx.results.output.figures.picture import Camera, brightness, subdivided, visible
from crms_fenicsx.results.output.figures.plots import default_panels, units_of_results
from crms_fenicsx.results.view_data import Surface


def square(n: int, height: float = 0.0) -> tuple[Array, NDArray[np.int64]]:
    """Return a square of 100 x 100 of 2 n^2 triangles."""
    x = np.linspace(0.0, 100.0, n + 1)
    return grid(x, x, lambda x, y: np.full_like(x, height))


def pixels(path: Path) -> Array:
    from matplotlib.image import imread

    return np.asarray(imread(path), dtype=float)[..., :3]


def red(path: Path) -> int:
    """Count the pixels in the colour of a plain cable, which nothing else has."""
    r, g, b = np.moveaxis(pixels(path), -1, 0)
    return int(((r > 0.6) & (g < 0.4) & (b < 0.4)).sum())


# ---- what is seen --------------------------------------------------------------------------


@pytest.mark.parametrize("view", [(-60.0, 30.0), (20.0, 50.0), (-90.0, 90.0)])
@pytest.mark.parametrize("perspective", [True, False])
def test_a_cable_is_hidden_behind_the_surface_only(
    tmp_path: Path, view: tuple[float, float], perspective: bool
) -> None:
    points, triangles = square(8)
    file = tmp_path / "shape.png"
    count = {}
    for height in (-4.0, 0.0, 4.0):
        cable = Line([[30, 50, height], [70, 50, height]])
        draw_shape(
            file, points, triangles, [cable], view=view, perspective=perspective, dpi=60, width=5
        )
        count[height] = red(file)
    assert count[-4.0] == 0
    assert count[0.0] > 50
    assert count[4.0] > 50


def test_a_ridge_hides_the_far_part_of_a_cable(tmp_path: Path) -> None:
    """Across a ridge, seen from the front, only the near half of a cable shows."""
    points, triangles = square(20)
    points[:, 2] = 40.0 - np.abs(points[:, 1] - 50.0) * 0.8
    across = [[50, y, 40.0 - abs(y - 50.0) * 0.8] for y in (0.0, 50.0, 100.0)]
    file = tmp_path / "ridge.png"
    counts = []
    for cable in (across, across[:2], across[1:]):
        draw_shape(file, points, triangles, [Line(cable)], view=(-90, 10), dpi=60, box=False)
        counts.append(red(file))
    whole, near, far = counts
    assert near > 100
    assert far < 0.1 * near
    assert abs(whole - near) < 0.1 * near


def test_the_nearer_triangles_are_painted_last(tmp_path: Path) -> None:
    low, triangles = square(4)
    high, _ = square(4, 10.0)
    both = np.concatenate([triangles, triangles + len(low)])
    values = np.repeat([0.0, 1.0], len(triangles))
    for elevation, bright in ((90.0, True), (-90.0, False)):
        file = tmp_path / f"{elevation}.png"
        for order in (slice(None), slice(None, None, -1)):  # as they come does not matter
            draw_shape(
                file, np.concatenate([low, high]), both[order], values=values[order],
                view=(-90, elevation), dpi=60, edges=False,
            )  # fmt: skip
            image = pixels(file)
            h, w = image.shape[:2]
            middle = image[h // 3 : 2 * h // 3, w // 4 : w // 2].reshape(-1, 3).mean(axis=0)
            yellow = middle[0] > middle[2] + 0.2
            assert yellow == bright


@pytest.mark.parametrize("view", [(-60.0, 30.0), (20.0, 12.0), (-90.0, 90.0)])
@pytest.mark.parametrize("n", [8, 24])
def test_colours_are_those_of_the_bar(tmp_path: Path, n: int, view: tuple[float, float]) -> None:
    """On a curved surface of one value, whatever its slope to the viewer and the size of its cells:
    at most 5 % of the pixels, edges and outline, are more than a tenth of the scale off."""
    from matplotlib import colormaps

    points, triangles = square(n)
    x, y = points[:, 0] / 50 - 1, points[:, 1] / 50 - 1
    points[:, 2] = 40 * (x * x - y * y)
    draw_shape(
        tmp_path / "one.png", points, triangles, view=view, box=False,
        values=np.full(len(triangles), 5.0), limits=(0.0, 15.0),
    )  # fmt: skip
    image = pixels(tmp_path / "one.png")
    seen = image[:, : int(0.8 * image.shape[1]) : 2].reshape(-1, 3)  # left of the bar
    seen = seen[np.ptp(seen, axis=1) > 0.08]
    assert len(seen) > 20_000
    bar = colormaps["viridis"](np.linspace(0.0, 1.0, 256))[:, :3]
    read = 15 / 255 * cKDTree(bar).query(seen)[1]
    assert np.mean(np.abs(read - 5.0) > 1.5) < 0.05
    draw_shape(tmp_path / "plain.png", points, triangles, view=view, box=False)
    fabric = pixels(tmp_path / "plain.png").mean(axis=2)
    fabric = fabric[fabric < 0.99]
    assert view[1] == 90.0 or np.std(fabric) > 0.05  # lit


@pytest.mark.parametrize("n", [3, 12])
def test_values_at_corners_are_seen_where_they_are(tmp_path: Path, n: int) -> None:
    """A linear field, read back with the bar's colours, is off by a part of a cell at most."""
    from matplotlib import colormaps

    points, triangles = square(n)
    file = tmp_path / "linear.png"
    draw_shape(file, points, triangles, values=points[:, 0], limits=(0.0, 100.0), view=(-90, 90),
               box=False, edges=False)  # fmt: skip
    image = pixels(file)
    row = image[image.shape[0] // 2]
    inside = np.flatnonzero(np.ptp(row, axis=1) > 0.08)
    inside = inside[: int(np.argmax(np.diff(inside) > 5)) + 1]  # left of the bar
    bar = colormaps["viridis"](np.linspace(0.0, 1.0, 256))[:, :3]
    read = 100 / 255 * cKDTree(bar).query(row[inside])[1]
    place = np.linspace(0.0, 100.0, len(inside))
    assert np.median(np.abs(read - place)) < 100 / (4 * n) / 2 + 0.5
    draw_shape(file, points, triangles, values=np.full((len(triangles), 3), 7.0), label="g [kN]",
               view=(-90, 90), box=False)  # fmt: skip
    fabric = pixels(file)
    h, w = fabric.shape[:2]
    middle = fabric[h // 3 : 2 * h // 3, w // 3 : w // 2].reshape(-1, 3)
    assert np.ptp(np.median(middle, axis=0)) < 0.2, "no colour of the scale"


@pytest.mark.parametrize("wide", [10.0, 61.0, 95.0])
def test_an_edge_is_hidden_as_far_as_something_lies_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wide: float
) -> None:
    """A wall hides a part of the edge behind it, however long the edge is."""
    from matplotlib.axes import Axes

    points, triangles = square(1)
    wall = np.array([(0, -50, -40), (wide, -50, -40), (wide, -50, 90), (0, -50, 90.0)])
    both = np.concatenate([triangles, [(4, 5, 6), (4, 6, 7)]])
    drawn: list[Any] = []
    monkeypatch.setattr(Axes, "add_collection", lambda axes, one, **more: drawn.append(one))
    draw_shape(tmp_path / "wall.png", np.concatenate([points, wall]), both, view=(-90.0, 20.0),
               box=False, perspective=False)  # fmt: skip
    outline = next(one for one in drawn if type(one).__name__ == "LineCollection")
    ends = np.array(outline.get_segments())
    level = ends[..., 1].mean(axis=1)
    flat = np.ptp(ends[..., 1], axis=1) < 1e-9
    rise = 100.0 * np.sin(np.radians(20.0))  # of the back edge over the front edge
    foot = level[flat].min()  # the wall's, 50 before the front edge and 40 below it
    above = 50.0 * np.sin(np.radians(20.0)) + 40.0 * np.cos(np.radians(20.0)) + rise
    at_back = ends[flat & np.isclose(level, foot + above)]
    length = np.ptp(at_back[..., 0], axis=1).sum()
    assert length == pytest.approx(100.0 - wide, abs=4.0)


def test_pictures_show_something(tmp_path: Path) -> None:
    points, triangles = square(6)
    points[:, 2] = 10 * np.sin(np.pi * points[:, 0] / 100) * np.sin(np.pi * points[:, 1] / 100)
    cable = Line(points[:7], {"tension": np.arange(7.0), "force": np.arange(6.0)}, "cable 1")
    for number, options in enumerate(
        [
            {},
            {"values": points[:, 2], "label": "z", "line_values": "tension", "unit": "cm"},
            {"values": np.r_[np.nan, np.ones(71)], "line_values": "force", "show_names": True},
            {"ghost": square(3, 5.0), "title": "ghost", "view": (30, -40), "box": False},
        ]
    ):
        file = tmp_path / f"{number}.png"
        draw_shape(file, points, triangles, [cable], dpi=50, **options)
        image = pixels(file)
        assert image.shape[0] > 80
        assert image.shape[1] > 250
        ink = np.any(image < 0.93, axis=-1)
        assert 0.1 < ink.mean() < 0.9
        for half in (ink[:, : ink.shape[1] // 2], ink[:, ink.shape[1] // 2 :]):
            assert half.mean() > 0.03


def test_the_same_picture_in_any_unit(tmp_path: Path) -> None:
    images = []
    for number, scale in enumerate((1.0, 1e-6, 1e6)):
        points, triangles = square(5)
        points[:, 2] = 0.002 * points[:, 0] * (100 - points[:, 0])
        draw_shape(
            tmp_path / f"{number}.png", points * scale, triangles,
            [Line(scale * np.array([[0, 50, 0], [50, 50, 5.0], [100, 50, 0]]))], dpi=40, box=False,
        )  # fmt: skip
        images.append(pixels(tmp_path / f"{number}.png"))
    rows, columns = np.min([image.shape[:2] for image in images], axis=0)
    for image in images[1:]:
        # Where a margin ends on a pixel's edge, rounding decides whether that pixel is in.
        assert np.abs(np.subtract(image.shape, images[0].shape)).max() <= 1
        common = image[:rows, :columns] - images[0][:rows, :columns]
        assert np.abs(common).mean() < 2e-3


def test_a_colour_bar_where_values_differ_and_words_where_they_do_not(tmp_path: Path) -> None:
    points, triangles = square(4)
    file = tmp_path / "bars.png"

    def width(tensions: list[float], **options: Any) -> int:
        lines = [
            Line([[10, y, 1.0], [60, y, 1.0]], {"tension": tension})
            for y, tension in zip((30, 70), tensions, strict=True)
        ]
        draw_shape(
            file, points, triangles, lines, line_values="tension", width=6, dpi=50, **options
        )  # fmt: skip
        h, w = pixels(file).shape[:2]
        shade = pixels(file)[h // 4 : 3 * h // 4, -int(0.2 * w) :]
        return int((np.ptp(shade, axis=-1) > 0.4).sum())  # colourful, where bars stand

    assert width([250.0, 250.01]) == 0
    assert width([250.0, 100.0]) > 100
    assert width([250.0, 250.0], line_limits=(0.0, 300.0)) > 100


@pytest.mark.parametrize(("width", "title"), [(8.0, ""), (6.0, "A flat, wide shape")])
def test_the_legend_covers_nothing(width: float, title: str) -> None:
    """Neither the box nor colour bars nor the title, with up to five entries in one picture."""
    points, triangles = square(4)
    points *= (1.0, 0.6, 1.0)
    place = np.column_stack([np.linspace(10.0, 90.0, 4), np.full((4, 2), (30.0, 0.0))])
    lines = [Line(place, {"tension": 5.0, "lifted": np.array([0.0, 1.0, 1.0])}, name="a long name")]
    figure = draw_shape(
        None, points, triangles, lines, values=np.r_[np.arange(31.0), np.nan], title=title,
        width=width, without="reinforced corner", label="force", line_values="tension",
        loose="lifted", held=points[None, :2], supports=points[-1:],
    )  # fmt: skip
    assert figure is not None
    figure.canvas.draw()
    axes, *bars = figure.axes
    legend = axes.get_legend()
    assert legend is not None and len(legend.get_texts()) == 5
    covered = legend.get_window_extent()
    top = max(
        float(axes.transData.transform(path.vertices)[:, 1].max())
        for one in axes.collections for path in one.get_paths()
    )  # fmt: skip
    assert covered.y0 >= top - 1.0  # pixels
    others = [bar.get_window_extent() for bar in bars]
    others += [text.get_window_extent() for text in figure.texts]
    assert len(others) == 1 + bool(title)
    assert not any(covered.overlaps(other) for other in others)
    assert covered.x0 >= 0.0


def test_a_box_gives_pictures_the_same_view_and_ends_lines(tmp_path: Path) -> None:
    points, triangles = square(6)
    box = ((-10.0, -10.0, -10.0), (110.0, 110.0, 10.0))
    counts, shapes = [], []
    for reach in (10.0, 500.0):
        cable = Line([[-reach, 50, 2], [100 + reach, 50, 2]])
        for number, some in enumerate((box, True)):
            file = tmp_path / f"{number}.png"
            draw_shape(file, points, triangles, [cable], box=some, width=5, dpi=60)
            counts.append(red(file))
        shapes.append(pixels(tmp_path / "0.png"))
    assert shapes[0].shape == shapes[1].shape
    assert np.abs(shapes[0] - shapes[1]).mean() < 1e-3
    assert counts[2] == pytest.approx(counts[0], rel=0.02)  # in the box
    assert abs(counts[3] - counts[1]) > 0.05 * counts[1]  # without it, the long cable has another


def test_hidden_edges_are_not_drawn(tmp_path: Path) -> None:
    square = np.array([[0, 0, 0], [100, 0, 0], [100, 100, 0], [0, 100, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    darkest = {}
    for name, hidden in (("shown", None), ("hidden", [[2, 0]])):
        file = tmp_path / f"{name}.png"
        draw_shape(file, square, triangles, view=(-90, 90), hidden=hidden, box=False, dpi=100)
        image = pixels(file).mean(axis=-1)
        h, w = image.shape
        darkest[name] = image[int(0.4 * h) : int(0.6 * h), int(0.4 * w) : int(0.6 * w)].min()
    assert darkest["shown"] < darkest["hidden"] - 0.1


def test_joined_pictures_stand_side_by_side(tmp_path: Path) -> None:
    from matplotlib.image import imsave

    red_one, blue = np.zeros((20, 30, 3)), np.zeros((10, 40, 3))
    red_one[..., 0], blue[..., 2] = 1.0, 1.0
    names = [tmp_path / "red.png", tmp_path / "blue.png"]
    for name, image in zip(names, (red_one, blue), strict=True):
        imsave(name, image)
    join_pictures(tmp_path / "row.png", names)
    row = pixels(tmp_path / "row.png")
    assert row.shape == (20, 70, 3)
    np.testing.assert_array_equal(row[:, :30], red_one)
    np.testing.assert_array_equal(row[:10, 30:], blue)
    np.testing.assert_array_equal(row[10:, 30:], 1.0)
    join_pictures(tmp_path / "column.png", names, upright=True)
    assert pixels(tmp_path / "column.png").shape == (30, 40, 3)
    (tmp_path / "text.png").write_text("no picture")
    for pictures, message in (
        ([], "no pictures"),
        (["a.jpg"], "only .png"),
    ):
        with pytest.raises(InputError, match=message):
            join_pictures(tmp_path / "never.png", pictures)
    for broken in ("text.png", "missing.png"):
        with pytest.raises(InputError, match="cannot be read"):
            join_pictures(tmp_path / "never.png", [tmp_path / broken])


def test_vector_formats_and_folders(tmp_path: Path) -> None:
    points, triangles = square(2)
    draw_shape(tmp_path / "new" / "shape.pdf", points, triangles)
    assert (tmp_path / "new" / "shape.pdf").read_bytes().startswith(b"%PDF")
    assert [entry.name for entry in (tmp_path / "new").iterdir()] == ["shape.pdf"]


# ---- the geometry behind it ----------------------------------------------------------------


def test_the_camera_looks_where_it_says() -> None:
    plan = Camera(-90.0, 90.0, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(plan.project([2.0, 2.0, 3.0]), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(plan.project([1.0, 3.0, 3.0]), [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(plan.project([1.0, 2.0, 4.0]), [0, 0, 1], atol=1e-15)
    front = Camera(-90.0, 0.0, [0, 0, 0])
    np.testing.assert_allclose(front.project([1.0, -2.0, 3.0]), [1, 3, 2], atol=1e-15)
    np.testing.assert_allclose(
        Camera(33.0, 21.0, [0, 0, 0]).axes @ Camera(33.0, 21.0, [0, 0, 0]).axes.T, np.eye(3),
        atol=1e-15,
    )  # fmt: skip


def test_perspective_keeps_planes_plane_and_near_things_large() -> None:
    camera = Camera(-50.0, 25.0, [0, 0, 0], distance=8.0)
    rng = np.random.default_rng(2)
    corners = rng.uniform(-1, 1, (40, 3, 3))
    inside = np.einsum("mij,i->mj", corners, [0.5, 0.2, 0.3])
    a, b, c = np.moveaxis(camera.project(corners), 1, 0)
    volume = np.einsum("mi,mi->m", np.cross(b - a, c - a), camera.project(inside) - a)
    assert np.abs(volume).max() < 1e-14
    np.testing.assert_allclose(camera.place(camera.project(corners)), corners, atol=1e-14)
    towards, up = camera.axes[2], camera.axes[1]
    near, far = camera.project([towards + up, up - towards])
    assert near[1] > 1.0 > far[1]


@pytest.mark.parametrize("triangles", [1, 30, 400])
def test_visibility_against_every_triangle_in_turn(triangles: int) -> None:
    rng = np.random.default_rng(triangles)
    centres = rng.uniform(0, 10, (triangles, 1, 3))
    corners = centres + rng.normal(scale=10 / np.sqrt(triangles) / 2, size=(triangles, 3, 3))
    corners[0, 2] = corners[0, 1]  # one without an area
    samples = rng.uniform(-1, 11, (300, 3))

    def plainly(sample: Array) -> bool:
        for a, b, c in corners:
            sides = np.column_stack([b[:2] - a[:2], c[:2] - a[:2]])
            if abs(np.linalg.det(sides)) < 1e-12:
                continue
            v, w = np.linalg.solve(sides, sample[:2] - a[:2])
            if min(v, w, 1 - v - w) >= 0:
                if a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2]) > sample[2] + 0.1:
                    return False
        return True

    expected = [plainly(sample) for sample in samples]
    assert visible(samples, corners, 0.1).tolist() == expected
    assert triangles == 1 or 0.05 < np.mean(expected) < 0.95


def test_nothing_hides_where_there_is_no_surface() -> None:
    assert visible(np.zeros((3, 3)), np.empty((0, 3, 3)), 0.0).all()
    assert visible(np.empty((0, 3)), np.zeros((1, 3, 3)), 0.0).shape == (0,)


def test_both_sides_are_lit_alike() -> None:
    rng = np.random.default_rng(4)
    corners = rng.normal(size=(50, 3, 3))
    corners[0, 1] = corners[0, 0]  # no normal
    camera = Camera(-60.0, 30.0, [0, 0, 0])
    front, back = brightness(camera, corners), brightness(camera, corners[:, ::-1])
    np.testing.assert_allclose(front, back, atol=1e-14)
    assert np.isfinite(front).all()
    assert np.ptp(front[0]) > 0.5


def test_pieces_of_a_line() -> None:
    nodes = np.array([[0, 0, 0], [3, 4, 1], [3, 4, 9], [3, 5.5, 9.0]])
    pieces, segment, middle = subdivided(np.stack([nodes[:-1], nodes[1:]], axis=1), 2.0)
    # 5 long: three pieces; end-on: one; 1.5 long: one
    assert segment.tolist() == [0, 0, 0, 1, 2]
    np.testing.assert_allclose(middle, [1 / 6, 1 / 2, 5 / 6, 1 / 2, 1 / 2])
    cuts = [nodes[0], nodes[1] / 3, nodes[1] * 2 / 3, *nodes[1:]]
    np.testing.assert_allclose(pieces, np.stack([cuts[:-1], cuts[1:]], axis=1))


def test_outline_counts_vertices_at_one_place_once() -> None:
    points, triangles = square(4)
    own = points[triangles].reshape(-1, 3)  # each triangle brings its own vertices
    for p, t in ((points, triangles), (own, np.arange(len(own)).reshape(-1, 3))):
        ends = outline_of(Surface(p, t))
        assert ends.shape == (16, 2, 3)
        middles = ends.mean(axis=1)[:, :2]
        assert np.isin(middles, [0.0, 100.0]).any(axis=1).all()
        assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(400.0)


def test_which_sides_are_among_pairs() -> None:
    rng = np.random.default_rng(3)
    triangles = np.array([rng.choice(9, 3, replace=False) for _ in range(40)])
    pairs = np.array([rng.choice(9, 2, replace=False) for _ in range(6)])
    wanted = {frozenset(pair) for pair in pairs.tolist()}
    slow = [[frozenset((t[k], t[(k + 1) % 3])) in wanted for k in range(3)] for t in triangles]
    np.testing.assert_array_equal(sides_among(triangles, pairs), slow)
    assert 0.05 < np.mean(slow) < 0.5
    assert not sides_among(triangles, np.empty((0, 2), dtype=np.int64)).any()


# ---- colours and words ---------------------------------------------------------------------


def test_values_that_are_the_same_are_told_in_words() -> None:
    assert _common_value(np.array([250.0, np.nan, 250.02])) == (250.0, 250.02)
    assert _common_value(np.zeros(3)) == (0.0, 0.0)
    assert _common_value(np.array([0.010412, 0.010424])) == (0.010412, 0.010424)
    assert _common_value(np.array([1.0, 1.02])) is None
    assert _common_value(np.array([np.nan])) is None
    assert _in_words("tension [kgf]", 249.97, 250.01) == "tension 250 kgf"
    assert _in_words("weight [kN/m²]", 0.010412, 0.010424) == "weight 0.01041 to 0.01042 kN/m²"
    assert _in_words("tension", 1.0625, 1.0625) == "tension 1.062"
    assert _in_words("", 3.0, 3.0) == "3"


def test_ends_of_the_colours() -> None:
    for values, ends in (
        ([10.0, 100.0], (0.0, 100.0)),
        ([90.0, 100.0], (0.0, 100.0)),
        ([-100.0, -10.0], (-100.0, 0.0)),
        ([-5.0, 100.0], (-5.0, 100.0)),
        ([2.0, 2.0], (0.0, 2.0)),
        ([0.0, 0.0], (0.0, 1.0)),
        ([np.nan], (0.0, 1.0)),
    ):
        assert _limits_of(np.array(values)) == pytest.approx(ends)


def test_units_follow_from_those_of_length_and_force() -> None:
    both = units_of_results("cm", "kgf")
    assert both["stress"] == "kgf/cm"
    assert both["pressure"] == "kgf/cm²"
    assert both["energy"] == "kgf cm"
    lengths = {"length": "m", "L0": "m", "area": "m²", "volume": "m³"}
    assert units_of_results("m", "") == lengths
    assert units_of_results("", "") == {}


# ---- scenes ----------------------------------------------------------------------------------


def tightened(comm: MPI.Intracomm, results: Path | None = None) -> Solver:
    """Return a single triangle that a cable has folded."""
    corners = [(0.0, 0.0), (25.0, 60.0), (70.0, 0.0)]
    mesh = meshes.from_arrays(comm, corners, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]})
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("corners")
    cable = scene.lay_cable(Cable(EA=32000.0), path=[(-20.0, 30.0, 0.0), (90.0, 24.0, 0.0)])
    return advanced(Solver(scene, results=results), move={cable: (0.0, 0.0, -4.0)})


@pytest.mark.ranks
def test_a_scene_is_drawn_by_all_ranks_together(comm: MPI.Intracomm, folder: Path) -> None:
    """With more than one rank, some have no cell."""
    solver = tightened(comm, folder)
    for colour in ("height", "displacement", "stress", "stress 2", "strain", "state", None):
        file = folder / f"{colour}.png"
        draw(solver, file, colour=colour, ghost=True, unit="cm", force="kgf", width=5, dpi=40)
        if comm.rank == 0:
            assert red(file) > 30
    with pytest.raises(InputError, match="'heat' is not known; use "):
        draw(solver, folder / "never.png", colour="heat")


def test_a_quadrilateral_s_diagonal_is_no_edge(comm: MPI.Intracomm) -> None:
    surface = current_surface(tightened(comm).scene.net)
    assert comm.allreduce(len(surface.triangles)) == 3
    assert comm.allreduce(len(surface.inner)) == 1
    if len(surface.inner):
        sharing = [set(surface.inner[0]) <= set(triangle) for triangle in surface.triangles]
        assert sum(sharing) == 2
        fold = {3, 4}  # the cable's points come after the three vertices
        assert set(surface.inner[0]) != fold


# ---- plots -----------------------------------------------------------------------------------


def a_history() -> History:
    history = History(None, MPI.COMM_SELF)
    for step in range(6):
        late = {"tension cable 1": 10.0 * step, "tension cable 2": 5.0 * step} if step > 2 else {}
        history.append({"step": step, "energy": -1.5 * step, "state": "ok", **late})
    return history


def test_history_plots(tmp_path: Path) -> None:
    history = a_history()
    draw_history(history, tmp_path / "all.png", units={"tension": "kN"}, title="run", dpi=60)
    draw_history(history, tmp_path / "one.png", "energy", [["tension cable 1"]], dpi=60)
    for name in ("all", "one"):
        ink = (pixels(tmp_path / f"{name}.png") < 0.9).any(axis=-1)
        assert 0.01 < ink.mean() < 0.5
    r, g, b = np.moveaxis(pixels(tmp_path / "all.png"), -1, 0)
    assert ((r > 0.7) & (g < 0.5) & (b < 0.3)).sum() > 30  # the second cable's colour


def test_which_columns_share_a_panel_and_what_they_are_called() -> None:
    from crms_fenicsx.results.output.figures.plots import _grouped, _with_unit

    assert _grouped(a_history(), "step") == [["energy"], ["tension cable 1", "tension cable 2"]]
    assert _grouped(a_history(), "energy") == [["tension cable 1", "tension cable 2"]]
    units = {"tension": "kN", "tension cable": "N", "ten": "?"}
    assert _with_unit("T", "tension cable 1", units) == "T [N]"
    assert _with_unit("energy", "energy", units) == "energy"


def test_default_panels_show_what_changes_and_can_be_seen() -> None:
    history = History(None, MPI.COMM_SELF)
    for step in range(3):
        late = {"L0 cable 1": 7.0, "tension cable 1": 10.0 * step} if step else {}
        history.append(
            {"step": step, "pressure": 2.0, "energy": 100.0 * step, "energy penalty": 0.1 * step}
            | {"energy membrane": -50.0 * step}
            | late
        )  # fmt: skip
    assert default_panels(history) == [["tension cable 1"], ["energy", "energy membrane"]]
    single = History(None, MPI.COMM_SELF)
    single.append({"step": 1, "pressure": 2.0, "L0 a": 7.0, "energy": 0.0})
    assert default_panels(single) == [["pressure"], ["L0 a"]]


def test_what_varies_by_the_tolerance_only_is_constant() -> None:
    """Axes show values and places, not the last digits of a solver."""
    history = History(None, MPI.COMM_SELF)
    for step in range(4):
        noise = 1.0 + 3e-9 * (step % 2)
        history.append({"step": step, "pressure": 0.3 * noise, "tension": 41.0 + step, "area": 7.1})
    assert default_panels(history) == [["tension"]]
    figures = [draw_history(history, panels=[["pressure"], ["area"]])]
    still = Line(np.tile([41.0, 23.0, 0.0], (3, 1)) + np.outer([0.0, 1e-7, 3e-7], [1.0, 0.0, 0.0]))
    points, triangles = square(2)
    figures += [draw_path(None, [still], points=points, triangles=triangles, closeups={"x": [0]})]
    for figure in figures:
        assert figure is not None
        figure.canvas.draw()
        for axes in figure.axes[-2:]:
            for axis in (axes.xaxis, axes.yaxis):
                assert axis.get_offset_text().get_text() == ""
                assert all(len(label.get_text()) <= 6 for label in axis.get_ticklabels())


def test_paths_in_plan_in_space_and_closely(tmp_path: Path) -> None:
    steps = np.linspace(0, 1, 12)[:, None]
    paths = [Line([20, 40, 0] + steps * [8, 16, -6], name="fold point 2")]
    paths.append(Line([75, 33, 0] + steps * [-9, 14, 0]))
    inked = []
    choices: list[dict[str, Any]] = [
        {},
        {"view": (-60, 30)},
        {"closeups": {"first": [0], "both": [0, 1]}, "width": 8.8, "title": "near"},
    ]
    for number, options in enumerate(choices):
        file = tmp_path / f"{number}.png"
        draw_path(
            file, paths, points=[[0, 0, 0], [100, 0, 0], [40, 80, 0]], triangles=[[0, 1, 2]],
            lines=[Line([[-20, 40, -15], [120, 30, -15]])], unit="cm", dpi=100, **options,
        )  # fmt: skip
        r, g, b = np.moveaxis(pixels(file), -1, 0)
        blue = int(((r < 0.2) & (g > 0.3) & (b > 0.6)).sum())
        assert blue > 30
        assert int(((r > 0.7) & (g < 0.5) & (b < 0.2)).sum()) > 30
        inked.append(blue)
    assert inked[2] > 1.3 * inked[0]  # the close-ups repeat the paths
    assert _spaced_steps(np.array([[0.0, 0], [1, 0], [5, 0], [6, 0]]), 2.0) == [0, 3]
    for wrong in ([2], []):
        with pytest.raises(InputError, match="close-up 'x' of the paths"):
            draw_path(tmp_path / "never.png", paths, closeups={"x": wrong})


def test_named_cables_have_colours_of_their_own(tmp_path: Path) -> None:
    """Without paths too; cables of one name share a colour, and cables without name stay grey."""
    file = tmp_path / "net.png"
    rows = [Line([[0, y, 0.0], [100, y, 0.0]], name=name) for y, name in ((0, ""), (30, "A"))]
    blues, oranges = [], []
    for more in ([], [("A", 60)], [("B", 60)]):
        lines = rows + [Line([[0, y, 0.0], [100, y, 0.0]], name=name) for name, y in more]
        draw_path(file, [], lines=lines, dpi=100)
        r, g, b = np.moveaxis(pixels(file), -1, 0)
        blues.append(int(((r < 0.2) & (g > 0.3) & (b > 0.6)).sum()))
        oranges.append(int(((r > 0.7) & (g < 0.5) & (b < 0.2)).sum()))
    assert blues[0] > 300
    assert blues[1] > 1.5 * blues[0]
    assert blues[2] == pytest.approx(blues[0], rel=0.1)
    assert oranges[:2] == [0, 0]
    assert oranges[2] == pytest.approx(blues[2], rel=0.2)


def test_the_legend_of_stripes_has_their_colour() -> None:
    """Of the mean value of the segments that are off; plain lines have the cable's colour."""
    place = np.column_stack([np.arange(4.0), np.zeros(4), np.zeros(4)])
    lines = [
        Line(place, {"tension": tension, "lifted": off})
        for tension, off in ((np.array([5.0, 9.0, 7.0]), np.array([0.0, 1.0, 1.0])), (2.0, 0.0))
    ]
    style = line_style(lines, "tension", "", (0.0, 10.0), "viridis", "lifted")
    assert style.paint is not None
    np.testing.assert_allclose(style.off_colour, style.paint.to_rgba(np.array([8.0]))[0])
    plain = line_style(lines, None, "", None, "viridis", "lifted")
    assert plain.off_colour == CABLE


@pytest.mark.ranks
def test_supports_and_held_edges_are_drawn(comm: MPI.Intracomm) -> None:
    """Held edges as lines; a mast's foot and a held point off the edges as triangles."""
    mesh = meshes.rectangle(comm, 8.0, 8.0, 2.0, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=2.0))
    scene.fix("left")
    scene.fix("back right")
    scene.add_bar(Bar(EA=1e3), scene.vertex_at((4.0, 4.0, 0.0)), (4.0, 4.0, -2.0), name="mast")
    drawn: list[dict[str, Any]] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(draw_scene, "draw_shape", lambda *given, **named: drawn.append(named))
        draw(Solver(scene))
    assert len(drawn) == (comm.rank == 0)
    for options in drawn:
        np.testing.assert_allclose(options["held"][..., 0], 0.0)
        assert options["held"].shape == (4, 2, 3)
        np.testing.assert_allclose(options["supports"], [(4.0, 4.0, -2.0), (8.0, 8.0, 0.0)])


def test_feet_are_drawn_within_the_box_where_nothing_hides_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.axes import Axes

    points, triangles = square(4, 20.0)
    places = np.array([(-5.0, 50.0, 0.0), (50.0, 50.0, 0.0), (105.0, 50.0, 0.0), (200.0, 0.0, 0.0)])
    drawn: list[Any] = []
    monkeypatch.setattr(Axes, "scatter", lambda axes, x, *more, **named: drawn.append(x))
    for view, box, seen in (
        ((-90.0, 90.0), ((-10, -10, -20), (110, 110, 30)), 2),  # one is below the sheet
        ((-90.0, -60.0), ((-10, -10, -20), (110, 110, 30)), 3),
    ):
        draw_shape(tmp_path / "a.png", points, triangles, supports=places[:3],
                   view=view, box=box)  # fmt: skip
        assert len(drawn.pop()) == seen
    draw_shape(tmp_path / "a.png", points, triangles, supports=places, view=(-90.0, 90.0),
               box=((-10, -10, -20), (110, 110, 30)))  # fmt: skip
    assert len(drawn.pop()) == 2


def test_cables_off_the_membrane_are_striped(tmp_path: Path) -> None:
    """Where a segment is off, about half of the cable's colour gives way to the rim's."""
    points, triangles = square(4)
    x = np.linspace(5.0, 95.0, 10)
    place = np.column_stack([x, np.full(10, 50.0), np.full(10, 2.0)])
    file = tmp_path / "net.png"
    shown = {}
    for name, off in (("none", 0.0), ("all", 1.0), ("one point", np.eye(10)[4])):
        cable = Line(place, {"lifted": off})
        draw_shape(
            file, points, triangles, [cable], loose="lifted", box=((0, 0, 0), (100, 100, 5)),
            view=(-90, 90), dpi=200, edges=False, width=6,
        )  # fmt: skip
        image = pixels(file)
        h = image.shape[0]
        r, g, b = np.moveaxis(image[h // 3 : 2 * h // 3], -1, 0)
        shown[name] = int(((r > 0.6) & (g < 0.4) & (b < 0.4)).sum())
    assert 0.3 < shown["all"] / shown["none"] < 0.75
    lost = (shown["none"] - shown["one point"]) / (shown["none"] - shown["all"])
    assert lost == pytest.approx(2 / 9, abs=0.06), "the two segments beside the point"


# ---- bad input -------------------------------------------------------------------------------


def test_bad_input(tmp_path: Path) -> None:
    points, triangles = square(2)
    line = Line([[0, 0, 0], [1, 1, 1]], {"tension": 1.0}, "A")
    file = tmp_path / "never.png"
    for arguments, options, message in (
        ((points, triangles), {"values": np.zeros(3)}, r"values have shape \(3,\)"),
        ((points, triangles), {"line_values": "tension"}, "there are no lines"),
        ((points, triangles, [line]), {"line_values": "slip"}, "'A' has no 'slip'"),
        ((points, triangles, [line]), {"loose": "lifted"}, "'A' has no 'lifted'"),
        ((points, triangles + 1), {}, "vertices 1 to 9"),
        ((points, triangles), {"values": points[:, 0], "colours": "no"}, "no colour map 'no'"),
        ((points, triangles), {"view": (np.nan, 30)}, "view"),
        ((points[:0], triangles[:0]), {}, "nothing to draw"),
        ((points, triangles), {"box": ((0, 0, 0), (1, 1, 0))}, "must be the lower one"),
        ((points, triangles), {"hidden": [[0, 9]]}, "vertices 0 to 9"),
        ((points, triangles), {"hidden": [0, 1]}, r"shape \(2,\)"),
    ):
        with pytest.raises(InputError, match=message):
            draw_shape(file, *arguments, **options)
    with pytest.raises(InputError, match=r"suffix '\.xyz'"):
        draw_shape(tmp_path / "never.xyz", points, triangles)
    with pytest.raises(InputError, match="'state' holds text"):
        draw_history(a_history(), file, panels=[["state"]])
    with pytest.raises(InputError, match="no column 'none'"):
        draw_history(a_history(), file, panels=[["none"]])
    with pytest.raises(InputError, match="is empty"):
        draw_history(History(None, MPI.COMM_SELF), file)
    with pytest.raises(InputError, match="no paths"):
        draw_path(file, [])
    with pytest.raises(InputError, match="belong together"):
        draw_path(file, [line], points=points)
    assert list(tmp_path.iterdir()) == []


def test_drawing_works_without_pyplot_and_its_global_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import matplotlib

    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it is an error now

    before = matplotlib.rcParams.copy()
    points, triangles = square(2)
    draw_shape(tmp_path / "a.png", points, triangles, values=points[:, 0], dpi=40)
    draw_history(a_history(), tmp_path / "b.png", dpi=40)
    assert matplotlib.rcParams.copy() == before


def test_importing_loads_no_optional_package() -> None:
    code = (
        "import sys, crms_fenicsx.results.output, crms_fenicsx.foundation.runtime.progress; "
        "print([m for m in ('gmsh', 'matplotlib', 'meshio', 'tqdm') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_names_in_plans_lie_apart() -> None:
    """Eight names of one place, on its sides, cover neither each other nor the rim below them."""
    axes, _ = plans._axes(np.array([[-1.0, -1.0], [1.0, 1.0]]), "m", 6.0, 0.1)
    ways = [np.array([x, y]) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0) if x or y]
    places = [(np.array([0.3, y]), way) for y in (0.0, 0.3, -0.3) for way in ways]
    rim = np.array([[[-1.0, -0.34], [1.0, -0.34]]])
    plans._write_apart(axes, [(f"guy west {k}", places) for k in range(8)], rim)
    axes.figure.canvas.draw()
    boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) == 8
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
    level = axes.transData.transform((0.0, -0.34))[1]
    assert not any(box.y0 < level < box.y1 for box in boxes)


def test_names_of_foundations_stay_within_the_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond the highest ordinates of the rim's forces, at all its sides."""
    drawn = list[Any]()
    monkeypatch.setattr(plans, "png_of", lambda figure, dpi: drawn.append(figure) or b"")
    corners = np.array([(-18.0, -18.0, 0), (18.0, -18.0, 0), (18.0, 18.0, 0), (-18.0, 18.0, 0)])
    rim = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    force = np.tile((0.0, 0.0, 12.0), (4, 2, 1))
    sides = {f"F{k}": (one.mean(axis=0), np.array([9.0, 0.0, 138.4])) for k, one in enumerate(rim)}
    plan = plans.ForcePlan(rim, force, sides, rim, 9.0, 12.0)
    plans.draw_forces(plan, "m", "kN", 165, 4.0)
    (figure,) = drawn
    (axes,) = figure.axes
    figure.canvas.draw()
    names = [text for text in axes.texts if text.get_text().startswith("F")]
    assert len(names) == 4 and names[0].get_text() == "F0 ↑138"
    for name in names:
        box, frame = name.get_window_extent(), axes.get_window_extent()
        assert frame.x0 < box.x0 and box.x1 < frame.x1
        assert frame.y0 < box.y0 and box.y1 < frame.y1


@pytest.mark.parametrize("width", [4.6, 8.0])
def test_labels_of_colour_bars_are_not_cut_off(width: float) -> None:
    """They take as many lines as they need beside their bar."""
    points, triangles = square(4)
    figure = draw_shape(
        None, points * (1.0, 0.6, 1.0), triangles, [], values=np.arange(32.0), width=width,
        label="section force along warp [kN/m]",
    )  # fmt: skip
    assert figure is not None
    figure.canvas.draw()
    _, bar = figure.axes
    label, beside = bar.yaxis.label.get_window_extent(), bar.get_window_extent()
    assert label.height < 1.1 * beside.height
    assert label.x1 < figure.bbox.x1


def test_coincident_lines_are_drawn_in_their_order_and_clamps_are_told() -> None:
    points, triangles = square(3)
    ends = np.array([[0.0, 50.0, 0.3], [100.0, 50.0, 0.3]])
    clamped = {"tension": 2.0, "clamp": np.array([0.0, 1.0])}
    ropes = [Line(ends, {"tension": 1.0}, "belt"), Line(ends - (0, 0, 0.2), clamped, "cable 1")]
    for lines in (ropes, ropes[::-1]):
        figure = draw_shape(None, points, triangles, lines, line_values="tension",
                            line_limits=(0.0, 2.0), line_colours="gray", box=False)  # fmt: skip
        axes = figure.axes[0]  # type: ignore[union-attr]
        cores = next(one for one in axes.collections if one.get_zorder() == 4)
        last = lines[-1].data["tension"] / 2.0  # type: ignore[operator]
        assert cores.get_edgecolor()[-1][0] == pytest.approx(last, abs=0.01)
        assert [text.get_text() for text in axes.get_legend().get_texts()] == ["clamp"]
    figure = draw_shape(None, points, triangles, ropes[1:], line_values="tension")
    texts = figure.axes[0].get_legend().get_texts()  # type: ignore[union-attr]
    assert texts[0].get_text() == "cable: tension 2"
