"""Draw a surface with its cables, from back to front."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.results.output.figures.axes3d import (
    INK,
    RIM,
    Axes3D,
    bounds,
    check_view,
    foot,
)
from crms_fenicsx.results.output.figures.cable_lines import (
    CABLE,
    NO_VALUE,
    colouring,
    line_style,
    paint_lines,
)
from crms_fenicsx.results.output.figures.picture import (
    Camera,
    add_lines,
    add_polygons,
    brightness,
    checked_picture,
    subdivided,
    visible,
)
from crms_fenicsx.results.view_data import Line, Surface, checked_integers, checked_points

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

_FABRIC = (0.80, 0.86, 0.93)
_BEHIND = 5e-4  # relative to the size: depth at which edges are hidden, which no fold lies above
_GHOST = (0.20, 0.33, 0.60)


@dataclass(frozen=True, kw_only=True)
class ShapeOptions:
    """Options of `draw_shape`.

    Parameters
    ----------
    values : (n,), (m,) or (m, 3) array, optional
        Values per vertex, triangle or triangle's corner, shown as colours, between corners
        interpolated; NaN is grey. By default plain fabric.
    label : str
        Label of the values' colour bar, with the unit in brackets. Equal values get a legend
        instead of a bar, on plain fabric.
    limits : (low, high), optional
        Ends of the colour scale, which then always gets a bar, as for pictures to be compared; by
        default those of the values, and 0.
    without : str
        Legend of triangles whose value is NaN.
    supports : (k, 3) array of length, optional
        Held places, drawn as triangles on the ground.
    held : (h, 2, 3) array of length, optional
        End points of held edges, drawn as thick lines.
    colours : str
        Name of a matplotlib colour map.
    levels : int, optional
        Number of colours; by default many.
    line_values : str, optional
        Name of the lines' data that colour them ("tension"), with a separate colour bar.
    line_label, line_limits, line_colours
        As for the surface; lines of equal values get one colour.
    loose : str, optional
        Name of the lines' data that are non-zero where a line is off the surface, hence striped.
        With data per point, a segment is off if one of its ends is.
    show_names : bool
        Whether to write each line's name beside it.
    title, unit : str
        Heading; unit of length, for the box.
    view : (azimuth, elevation)
        Viewer's position in degrees; (-90, 90) is the plan with x to the right.
    perspective : bool
        Mild perspective; otherwise parallel projection.
    ghost : (points, triangles), optional
        A second shape, such as the reference, drawn faintly.
    strokes : (k, 2, 3) array of length, optional
        End points of short lines on the surface, such as principal directions.
    arrows : (k, 2, 3) array of length, optional
        Tails and tips of arrows, such as loads.
    edges : bool
        Whether to draw edges of triangles that are large enough.
    hidden : (h, 2) array of int, optional
        Vertex pairs of edges not to be drawn, such as diagonals of polygons.
    box : bool or (low, high)
        Whether to draw the box with its ticks; or the box's lowest and highest corner, for
        comparable pictures. Lines are clipped at such a box.
    width : float
        Width of the picture in inches; its height follows from the shape.
    dpi : int
        Pixels per inch of a file.
    """

    values: ArrayLike | None = None
    label: str = ""
    limits: tuple[float, float] | None = None
    without: str = ""
    supports: ArrayLike | None = None
    held: ArrayLike | None = None
    colours: str = "viridis"
    levels: int | None = None
    line_values: str | None = None
    line_label: str = ""
    line_limits: tuple[float, float] | None = None
    line_colours: str = "YlOrRd"
    loose: str | None = None
    show_names: bool = False
    title: str = ""
    unit: str = ""
    view: tuple[float, float] = (-60.0, 30.0)
    perspective: bool = True
    ghost: tuple[ArrayLike, ArrayLike] | None = None
    strokes: ArrayLike | None = None
    arrows: ArrayLike | None = None
    edges: bool = True
    hidden: ArrayLike | None = None
    box: bool | tuple[ArrayLike, ArrayLike] = True
    width: float = 8.0
    dpi: int = 200


def draw_shape(
    filename: str | Path | None, points: ArrayLike, triangles: ArrayLike,
    lines: Sequence[Line] = (), **options: Any,
) -> Figure | None:  # fmt: skip
    """Draw a surface and the cables on it, in a box from which its size can be read.

    Cables are hidden where the surface is in front of them. Not collective: call it on one rank,
    with the whole surface.

    Parameters
    ----------
    filename : str, Path or None
        Picture file (.png, .pdf, .svg ...); None returns the figure.
    points, triangles : (n, 3) array of length, (m, 3) array of int
        The surface.
    lines : sequence of Line
        Cables.
    **options
        Options of `ShapeOptions`: ``values``, ``label``, ``view``, ``title`` ...

    Returns
    -------
    matplotlib.figure.Figure
        The figure for notebooks, without a file; else None.

    Raises
    ------
    InputError
        Inconsistent arrays, lines without the data `line_values`, or a file that cannot be written.
    """
    from matplotlib import colormaps

    how = ShapeOptions(**options)
    surface = Surface(points, triangles).checked()
    lines = [line.checked() for line in lines]
    faint = None if how.ghost is None else Surface(*how.ghost).checked()
    values = _per_corner(how.values, surface)
    for name in (how.colours, how.line_colours):
        if name not in colormaps:
            raise InputError(f"no colour map {name!r}; see matplotlib.colormaps.")
    line_label = how.line_label or how.line_values or ""
    style = line_style(
        lines, how.line_values, line_label, how.line_limits, how.line_colours, how.loose
    )
    if len(np.asarray(surface.points)) == 0 and not lines:
        raise InputError("nothing to draw: no points and no lines; pass one of them.")
    check_view(how.view)
    corners = None if isinstance(how.box, bool) else _checked_box(how.box)
    inner = _checked_hidden(how.hidden, surface)
    path = checked_picture(filename)

    spatial, ghostly = _corners(surface), None if faint is None else _corners(faint)
    shapes = [spatial, *(np.asarray(line.points) for line in lines)]
    low, high = corners or bounds(shapes if ghostly is None else [*shapes, ghostly])
    size = float(np.linalg.norm(high - low))
    near = how.perspective and abs(how.view[1]) < 85.0  # parallel, so that plans can be measured
    camera = Camera(*how.view, 0.5 * (low + high), 3.5 * size if near else np.inf)

    paint, note = colouring(values, how.label, how.limits, how.colours, how.levels)
    bars = [(one, text) for one, text in ((paint, how.label), (style.paint, line_label)) if one]
    striped = "off the membrane" * any(part.any() for part in style.off)
    without = how.without if values is not None and not np.isfinite(values).all() else ""
    held = np.zeros((0, 2, 3)) if how.held is None else np.asarray(how.held, dtype=np.float64)
    feet = np.zeros((0, 3)) if how.supports is None else np.asarray(how.supports, dtype=np.float64)
    feet = feet[np.all((feet >= low - 1e-6 * size) & (feet <= high + 1e-6 * size), axis=1)]
    legend = [
        (_FABRIC, note, "patch"), (NO_VALUE, without, "patch"), (CABLE, style.note, "line"),
        (style.off_colour if striped else CABLE, striped, "stripes"),
        (RIM, "clamp" * any(map(len, style.clamps)), "clamp"),
        (INK, "held edge" * bool(len(held)), "line"), (INK, "support" * bool(len(feet)), "foot"),
    ]  # fmt: skip
    axes3d = Axes3D(camera, low, high, how.title, len(bars), how.width, legend)
    for place, (scale, text) in enumerate(bars):
        axes3d.add_bar(scale, text, place)
    if how.box is not False:
        axes3d.draw_box(how.unit)

    flat = camera.project(spatial)
    shown = np.full((len(flat), 3), how.edges) & ~sides_among(np.asarray(surface.triangles), inner)
    _paint_surface(axes3d, spatial, flat, values, paint, shown, ghostly)
    # depth of a cable below unfolded triangles
    tolerance = 0.006 * size
    _paint_seen(axes3d, outline_of(surface), flat, _BEHIND * size, INK)
    if faint is not None:
        _paint_seen(axes3d, outline_of(faint), flat[:0], tolerance, (*_GHOST, 0.6))
    _paint_seen(axes3d, held, flat, _BEHIND * size, INK, 2.4)
    _paint_feet(axes3d, camera.project(feet), flat, tolerance)
    strokes: Array = np.reshape(() if how.strokes is None else how.strokes, (-1, 2, 3))
    _paint_seen(axes3d, strokes, flat, tolerance, "white", 1.6)
    _paint_arrows(axes3d, how.arrows)
    clip = None if corners is None else (low - 1e-6 * size, high + 1e-6 * size)
    paint_lines(axes3d, lines, style, flat, tolerance, clip, how.show_names)
    return axes3d.finished(path, how.dpi)


def _paint_surface(
    axes3d: Axes3D, spatial: Array, flat: Array, values: Array | None, paint: ScalarMappable | None,
    shown: Booleans, ghostly: Array | None,
) -> None:  # fmt: skip
    """Paint triangles (m, 3, 3), projected to `flat`: in colours unlit, or else plain fabric."""
    strength, faces = _edge_strength(axes3d, flat), flat
    if paint is not None and values is not None:  # unlit: the colours are those of the bar
        if values.ndim == 2:
            # between 60 colours the eye sees no edges
            step = (np.ptp(paint.get_clim()) or 1.0) / 60.0
            faces, values, parent, side = _fine(flat, values, step, 2.5 * axes3d.point)
            shown = np.column_stack([shown, np.zeros(len(flat), dtype=bool)])
            shown, strength = shown[parent[:, None], side], strength[parent]
        colours = paint.to_rgba(values)[:, :3]
    else:
        colours = np.tile(_FABRIC, (len(flat), 1))
        if values is not None:
            colours[~np.isfinite(values.reshape(len(flat), -1)).all(axis=1)] = NO_VALUE
        diffuse, specular = brightness(axes3d.camera, spatial)
        colours = colours * (0.44 + 0.62 * diffuse)[:, None] + 0.16 * specular[:, None]
    _paint_triangles(axes3d, faces, colours, ghostly, shown, strength)


def _corners(surface: Surface) -> Array:
    """Corners of a surface's triangles, (m, 3, 3)."""
    return np.asarray(surface.points)[np.asarray(surface.triangles)]


def _checked_box(box: tuple[ArrayLike, ArrayLike]) -> tuple[Array, Array]:
    if len(box) != 2:
        raise InputError(f"box {box!r}; pass True, False or its corners (low, high).")
    low, high = checked_points("box corners", np.array(box, dtype=np.float64))
    if not np.all(low < high):
        raise InputError(f"box from {low} to {high}: the first corner must be the lower one.")
    return low, high


def _checked_hidden(hidden: ArrayLike | None, surface: Surface) -> Integers:
    pairs = checked_integers("hidden", () if hidden is None else hidden, 2)
    if pairs.size and not 0 <= pairs.min() <= pairs.max() < len(np.asarray(surface.points)):
        raise InputError(
            f"hidden refers to vertices {pairs.min()} to {pairs.max()}, but there are "
            f"{len(np.asarray(surface.points))} points."
        )
    return pairs


def sides_among(triangles: Integers, pairs: Integers) -> Booleans:
    """Whether the triangles' sides (corner k to k + 1) are among pairs of vertices, (m, 3)."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1)
    return np.isin(edge_keys(sides), edge_keys(pairs)).reshape(-1, 3)


def _per_corner(values: ArrayLike | None, surface: Surface) -> Array | None:
    """Values (m, 3) at the corners of triangles, or (m,) of triangles."""
    if values is None:
        return None
    array = np.asarray(values, dtype=np.float64)
    triangles = np.asarray(surface.triangles)
    if array.shape in {(len(triangles),), (len(triangles), 3)}:
        return array
    if array.shape == (len(np.asarray(surface.points)),):
        return array[triangles]
    raise InputError(
        f"values have shape {array.shape}; pass one for each of the "
        f"{len(np.asarray(surface.points))} vertices, {len(triangles)} triangles or their corners."
    )


def _fine(flat: Array, values: Array, step: float, length: float) -> tuple[Array, ...]:
    """Parts of triangles (m, 3, 3) for values (m, 3) between their corners: so many on each side
    that they differ by up to `step` or are up to `length` long in the picture, but not above 4.

    Returns the corners of the parts (p, 3, 3), their values (p,), the triangle of each (p,), and of
    which side (3: none) of it each part's sides are (p, 3).
    """
    longest = np.linalg.norm((flat - np.roll(flat, 1, axis=1))[..., :2], axis=2).max(axis=1)
    wanted = np.fmin(np.ptp(values, axis=1) / step, longest / length)
    counts, found = np.clip(np.ceil(wanted), 1, 4), []
    for n in np.unique(counts).astype(int):
        own, parts, sides = np.flatnonzero(counts == n), [], []
        for i in range(n):
            for j in range(n - i):
                # weights of the second and third corner, in units of 1 / n
                parts.append(((i, j), (i + 1, j), (i, j + 1)))
                sides.append((0 if j == 0 else 3, 1 if i + j == n - 1 else 3, 2 if i == 0 else 3))
                if i + j < n - 1:
                    parts.append(((i + 1, j), (i + 1, j + 1), (i, j + 1)))
                    sides.append((3, 3, 3))
        share = np.array(parts, dtype=np.float64) / n
        weights = np.concatenate([1.0 - share.sum(axis=2, keepdims=True), share], axis=2)
        corners = np.einsum("pkv,mvi->mpki", weights, flat[own]).reshape(-1, 3, 3)
        middles = np.einsum("pv,mv->mp", weights.mean(axis=1), values[own]).ravel()
        found.append((corners, middles, np.repeat(own, n * n), np.tile(sides, (len(own), 1))))
    return tuple(np.concatenate(one) for one in zip(*found, strict=True))


def _paint_triangles(
    axes3d: Axes3D,
    flat: Array,
    colours: Array,
    faint: Array | None,
    shown: Booleans,
    strength: Array,
) -> None:
    """Paint the surface and the `faint` triangles; `shown` (m, 3) tells which sides get an edge of
    which strength (m,)."""
    faces = np.column_stack([np.clip(colours, 0, 1), np.ones(len(colours))])
    dark = np.column_stack([faces[:, :3] * (1.0 - 0.35 * strength)[:, None], faces[:, 3]])
    # faces without edges get rims of their colour, to close the gaps left by antialiasing
    rimmed: Booleans = np.all(shown, axis=1) & (strength > 0)
    rims = np.where(rimmed[:, None], dark, faces)
    thick = 0.25 + 0.2 * strength * rimmed
    polygons = flat[..., :2]
    depth: Array = np.mean(flat[..., 2], axis=1)
    # where only some sides have edges, these are separate strokes right after the face
    some, side = np.nonzero(shown & (~rimmed & (strength > 0))[:, None])
    ends = flat[some, side, :2], flat[some, (side + 1) % 3, :2]
    polygons = np.concatenate([polygons, np.stack([*ends, ends[1]], axis=1)])
    faces, rims = np.concatenate([faces, dark[some]]), np.concatenate([rims, dark[some]])
    thick = np.concatenate([thick, 0.25 + 0.2 * strength[some]])
    depth = np.concatenate([depth, depth[some]])
    if faint is not None:
        extra = axes3d.camera.project(faint)
        strength = _edge_strength(axes3d, extra)
        polygons = np.concatenate([polygons, extra[..., :2]])
        faces = np.concatenate([faces, np.tile((*_GHOST, 0.10), (len(extra), 1))])
        lines = np.column_stack([np.tile(_GHOST, (len(extra), 1)), 0.5 * strength])
        rims = np.concatenate([rims, lines])
        thick = np.concatenate([thick, np.full(len(extra), 0.4)])
        depth = np.concatenate([depth, extra[..., 2].mean(axis=1)])
    order = np.argsort(depth, kind="stable")
    add_polygons(
        axes3d.axes, polygons[order], facecolors=faces[order],
        edgecolors=rims[order], linewidths=thick[order], joinstyle="round", zorder=1,
    )  # fmt: skip


def _paint_seen(
    axes3d: Axes3D, strokes: Array, flat: Array, tolerance: float, colour: Any, thick: float = 0.8
) -> None:
    """Paint the parts of strokes (k, 2, 3) that no triangle hides."""
    if len(strokes):
        pieces, _, _ = subdivided(axes3d.camera.project(strokes), 6.0 * axes3d.point)
        seen = visible(pieces.mean(axis=1), flat, tolerance)
        add_lines(axes3d.axes, pieces[seen, :, :2], colors=[colour], linewidths=thick,
                  capstyle="round", zorder=2)  # fmt: skip


def _paint_arrows(axes3d: Axes3D, given: ArrayLike | None) -> None:
    """Paint arrows (k, 2, 3), tail and tip."""
    if given is None or not np.size(given):
        return
    arrows = axes3d.camera.project(np.asarray(given))
    tails, ways = arrows[:, 0, :2], (arrows[:, 1] - arrows[:, 0])[:, :2]
    axes3d.axes.quiver(
        *tails.T, *ways.T, angles="xy", scale_units="xy", scale=1.0, units="dots", width=1.6,
        headwidth=4.5, headlength=5.5, headaxislength=5.0, color=INK, zorder=4.2,
    )  # fmt: skip


def _paint_feet(axes3d: Axes3D, places: Array, flat: Array, tolerance: float) -> None:
    """Paint supports at projected places (k, 3), each a triangle on a piece of ground."""
    if len(places) == 0:
        return
    ground = places - (0.0, 8.0 * axes3d.point, 0.0)
    at = places[visible(places, flat, tolerance) & visible(ground, flat, tolerance)]
    axes3d.axes.scatter(
        at[:, 0], at[:, 1], s=110.0, marker=foot(), facecolors="white", edgecolors=INK,
        linewidths=1.0, zorder=4.5,
    )  # fmt: skip


def _edge_strength(axes3d: Axes3D, flat: Array) -> Array:
    """Strength of triangles' edges, 0 to 1, low for narrow ones, which edges would darken."""
    sides = flat[..., :2] - np.roll(flat[..., :2], 1, axis=1)
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    areas = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    points = areas / np.maximum(longest, 1e-300) / axes3d.point  # heights
    return np.where(points < 3.0, 0.0, np.clip((points - 3.0) / 12.0, 0.15, 1.0))


def outline_of(surface: Surface) -> Array:
    """End points (b, 2, 3) of edges with one triangle; coincident vertices count as one."""
    points, triangles = np.asarray(surface.points), np.asarray(surface.triangles)
    if len(triangles) == 0:
        return np.empty((0, 2, 3))
    step = 1e-9 * float(np.ptp(points, axis=0).max()) or 1.0
    _, first, same = np.unique(
        np.round(points / step), axis=0, return_index=True, return_inverse=True
    )
    table = EdgeTable.of(same.reshape(-1)[triangles])
    return points[first[table.vertices[table.counts == 1]]]
