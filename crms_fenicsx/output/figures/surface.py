"""Pictures of a shape with its cables, painted from back to front."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.output.data import Line, Surface, checked_points
from crms_fenicsx.output.figures.axes3d import (
    INK,
    RIM,
    STRIPES,
    Stage,
    bounds,
    check_colours,
    check_view,
    checked_filename,
)
from crms_fenicsx.output.figures.camera import Camera, brightness, visible
from crms_fenicsx.output.figures.scales import NO_VALUE, common_value, in_words, mappable
from crms_fenicsx.runtime.errors import InputError

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

Floats = NDArray[np.float64]

_FABRIC = (0.80, 0.86, 0.93)
_CABLE = "#c8322b"
_ON_SURFACE = 0.006  # of the size: triangles that come unfolded pass over their cable
_SHORTEST = 3  # pieces of a line: less is a speck in a crease
_GHOST = (0.20, 0.33, 0.60)


def draw_shape(
    filename: str | Path,
    points: ArrayLike,
    triangles: ArrayLike,
    lines: Sequence[Line] = (),
    *,
    values: ArrayLike | None = None,
    label: str = "",
    limits: tuple[float, float] | None = None,
    colours: str = "viridis",
    line_values: str | None = None,
    line_label: str = "",
    line_limits: tuple[float, float] | None = None,
    line_colours: str = "YlOrRd",
    loose: str | None = None,
    show_names: bool = False,
    title: str = "",
    unit: str = "",
    view: tuple[float, float] = (-60.0, 30.0),
    perspective: bool = True,
    ghost: tuple[ArrayLike, ArrayLike] | None = None,
    edges: bool = True,
    hidden: ArrayLike | None = None,
    box: bool | tuple[ArrayLike, ArrayLike] = True,
    width: float = 8.0,
    dpi: int = 200,
) -> None:
    """Draw a surface and the cables on it, in a box from which its size can be read.

    Cables are seen where no part of the surface is in front of them. Not collective: call it on
    one rank, with all of the surface.

    Parameters
    ----------
    filename : str or Path
        Picture to write; its suffix (.png, .pdf, .svg ...) says the format.
    points, triangles : (n, 3) array of length, (m, 3) array of int
        The surface.
    lines : sequence of Line
        Cables.
    values : (n,) or (m,) array, optional
        Colours by value, per vertex or per triangle; NaN is grey. Without it, plain fabric.
    label : str
        Of the values' colour bar, with its unit in brackets. Values that are all the same get no
        bar: the surface is painted plainly, and a legend tells the value.
    limits : (low, high), optional
        Ends of the colours; by default those of the values, or 0 if that is near. With limits
        there is always a bar.
    colours : str
        Name of a matplotlib colour map.
    line_values : str, optional
        Name of the lines' data that colour them ("tension"), with a colour bar of its own.
    line_label, line_limits, line_colours
        As those of the surface; lines with the same value are painted in one colour.
    loose : str, optional
        Name of the lines' data that say where they are off the surface (not zero): there they are
        striped. Of data per point, segments are off if one of their ends is.
    show_names : bool
        Write each line's name beside it.
    title : str
    unit : str
        Of length, for the box.
    view : (azimuth, elevation)
        Where the viewer stands, in degrees; see `Camera`.
    perspective : bool
        Mild perspective; otherwise parallel projection.
    ghost : (points, triangles), optional
        A second shape, such as the reference, drawn faintly.
    edges : bool
        Draw the edges of the triangles where these are large enough.
    hidden : (h, 2) array of int, optional
        Pairs of vertices; edges between them are not drawn, such as those that cut a polygon
        into triangles.
    box : bool or (low, high)
        Draw the box with its ticks; or the box's lowest and highest corner, which pictures to
        compare should share. Lines end where they leave such a box.
    width : float
        The picture's, in inches; its height follows from the shape's.
    dpi : int
        Pixels per inch.

    Raises
    ------
    InputError
        For arrays that do not fit together, lines without `line_values`, or a file that cannot
        be written.
    """
    surface = Surface(points, triangles).checked()
    lines = [line.checked() for line in lines]
    faint = None if ghost is None else Surface(*ghost).checked()
    values = _per_triangle(values, surface)
    for data in (line_values, loose):
        _check_line_values(lines, data)
    for name in (colours, line_colours):
        check_colours(name)
    if len(np.asarray(surface.points)) == 0 and not lines:
        raise InputError("nothing to draw: no points and no lines; give one of them")
    check_view(view)
    corners = None if isinstance(box, bool) else _checked_box(box)
    inner = _checked_hidden(hidden, surface)
    path = checked_filename(filename)

    spatial = np.asarray(surface.points)[np.asarray(surface.triangles)]
    shapes = [spatial, *(np.asarray(line.points) for line in lines)]
    if faint is not None:
        shapes.append(np.asarray(faint.points)[np.asarray(faint.triangles)])
    low, high = bounds(shapes) if corners is None else corners
    size = float(np.linalg.norm(high - low))
    near = perspective and abs(view[1]) < 85.0  # a plan is parallel, or it cannot be measured
    camera = Camera(*view, 0.5 * (low + high), 3.5 * size if near else np.inf)

    paint, note = _paint(values, label, limits, colours, _FABRIC)
    of_lines = [np.asarray(line.data[line_values]) for line in lines] if line_values else []
    every = np.concatenate([array.ravel() for array in of_lines]) if line_values else None
    line_paint, line_note = _paint(
        every, line_label or line_values or "", line_limits, line_colours, _CABLE
    )
    bars = [(m, text) for m, text in ((paint, label), (line_paint, line_label or line_values)) if m]
    stage = Stage(camera, low, high, title, len(bars), width)
    for place, (scale, text) in enumerate(bars):
        stage.add_bar(scale, text or "", place)
    if line_note:
        line_note = f"{_called(lines)}{line_note}"
    off = [_off_segments(line, loose) for line in lines]
    striped = "off the membrane" if any(part.any() for part in off) else ""
    stage.add_legend(
        [(_FABRIC, note, "patch"), (_CABLE, line_note, "line"), (_CABLE, striped, "stripes")]
    )
    if box is not False:
        stage.draw_box(unit)

    flat = camera.project(spatial)
    face_colours = np.tile(_FABRIC, (len(flat), 1))
    if values is not None:
        face_colours[~np.isfinite(values)] = NO_VALUE
        face_colours = face_colours if paint is None else paint.to_rgba(values)[:, :3]
    shown = np.ones((len(flat), 3), dtype=bool) if edges else np.zeros((len(flat), 3), dtype=bool)
    shown &= ~_among(np.asarray(surface.triangles), inner)
    _paint_triangles(stage, spatial, flat, face_colours, faint, shown)

    tolerance = _ON_SURFACE * size
    outline = _outline(np.asarray(surface.points), np.asarray(surface.triangles))
    _paint_outline(stage, outline, flat, tolerance)
    if faint is not None:
        rim = _outline(np.asarray(faint.points), np.asarray(faint.triangles))
        _paint_outline(stage, rim, flat[:0], tolerance, colour=(*_GHOST, 0.6))
    clip = None if corners is None else (low - 1e-6 * size, high + 1e-6 * size)
    _paint_lines(stage, lines, flat, tolerance, of_lines, line_paint, off, show_names, clip)
    stage.save(path, dpi)


def _paint(
    values: Floats | None,
    label: str,
    limits: tuple[float, float] | None,
    colours: str,
    plain: Any,
) -> tuple[ScalarMappable | None, str]:
    """Return the colours of values, or else what a legend says of their common value."""
    if values is None:
        return None, ""
    same = common_value(values) if limits is None else None
    if same is not None:
        return None, in_words(label, same)
    return mappable(colours, values, limits), ""


def _called(lines: Sequence[Line]) -> str:
    if len(lines) > 1:
        return f"{len(lines)} cables: "
    return f"{lines[0].name}: " if lines[0].name else ""


def _checked_box(box: tuple[ArrayLike, ArrayLike]) -> tuple[Floats, Floats]:
    if len(box) != 2:
        raise InputError(f"box {box!r}; give True, False or its corners (low, high)")
    low, high = checked_points("box corners", np.array(box, dtype=np.float64))
    if not np.all(low < high):
        raise InputError(f"box from {low} to {high}: the first corner must be the lower one")
    return low, high


def _checked_hidden(hidden: ArrayLike | None, surface: Surface) -> NDArray[np.int64]:
    pairs = np.asarray(() if hidden is None else hidden)
    if pairs.size == 0:
        return np.empty((0, 2), dtype=np.int64)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise InputError(
            f"hidden has shape {pairs.shape} and type {pairs.dtype}; give pairs of vertices, (h, 2)"
        )
    if not 0 <= pairs.min() <= pairs.max() < len(np.asarray(surface.points)):
        raise InputError(
            f"hidden refers to vertices {pairs.min()} to {pairs.max()}, but there are "
            f"{len(np.asarray(surface.points))} points"
        )
    return pairs.astype(np.int64)


def _among(triangles: NDArray[np.int64], pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Say which sides of the triangles (corner k to k + 1) are among pairs of vertices, (m, 3)."""
    if len(triangles) == 0 or len(pairs) == 0:
        return np.zeros((len(triangles), 3), dtype=bool)
    n = int(triangles.max()) + 1 + int(pairs.max())
    sides = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    wanted = np.sort(pairs, axis=1)
    return np.isin(sides[..., 0] * n + sides[..., 1], wanted[:, 0] * n + wanted[:, 1])


def _per_triangle(values: ArrayLike | None, surface: Surface) -> Floats | None:
    """Return values per triangle; those per vertex become the mean of the triangle's corners."""
    if values is None:
        return None
    array = np.asarray(values, dtype=np.float64)
    triangles = np.asarray(surface.triangles)
    if array.shape == (len(triangles),):
        return array
    if array.shape == (len(np.asarray(surface.points)),):
        return array[triangles].mean(axis=1)
    raise InputError(
        f"values have shape {array.shape}; give one for each of the "
        f"{len(np.asarray(surface.points))} vertices or {len(triangles)} triangles"
    )


def _check_line_values(lines: Sequence[Line], name: str | None) -> None:
    if name is None:
        return
    if not lines:
        raise InputError(f"line_values {name!r}, but there are no lines; leave it out")
    for number, line in enumerate(lines):
        if name not in line.data:
            raise InputError(
                f"line {number} {line.name!r} has no {name!r}; it has "
                f"{', '.join(line.data) or 'no data'}"
            )


def _paint_triangles(
    stage: Stage,
    spatial: Floats,
    flat: Floats,
    colours: Floats,
    faint: Surface | None,
    shown: NDArray[np.bool_],
) -> None:
    """Paint the surface and the faint one; `shown` (m, 3) says which sides get an edge."""
    from matplotlib.collections import PolyCollection

    diffuse, specular = brightness(stage.camera, spatial)
    faces = colours * (0.44 + 0.62 * diffuse)[:, None] + 0.16 * specular[:, None]
    faces = np.column_stack([np.clip(faces, 0, 1), np.ones(len(faces))])
    strength = _edge_strength(stage, flat)
    dark = np.column_stack([faces[:, :3] * (1.0 - 0.45 * strength), faces[:, 3]])
    # without edges of their own, the faces' rims close the seams that antialiasing leaves
    rimmed: NDArray[np.bool_] = np.all(shown, axis=1) & (strength > 0)
    rims = np.where(rimmed[:, None], dark, faces)
    thick = 0.25 + 0.2 * strength * rimmed
    polygons = list(flat[..., :2])
    depth: Floats = np.mean(flat[..., 2], axis=1)
    # where a side has none, the others come as strokes of their own, right after the face
    some, side = np.nonzero(shown & ~rimmed[:, None] & (strength > 0))
    polygons += list(np.stack([flat[some, side, :2], flat[some, (side + 1) % 3, :2]], axis=1))
    faces, rims = np.concatenate([faces, dark[some]]), np.concatenate([rims, dark[some]])
    thick = np.concatenate([thick, np.full(len(some), 0.25 + 0.2 * strength)])
    depth = np.concatenate([depth, depth[some]])
    if faint is not None:
        extra = stage.camera.project(np.asarray(faint.points)[np.asarray(faint.triangles)])
        strength = _edge_strength(stage, extra)
        polygons += list(extra[..., :2])
        faces = np.concatenate([faces, np.tile((*_GHOST, 0.10), (len(extra), 1))])
        rims = np.concatenate([rims, np.tile((*_GHOST, 0.5 * strength), (len(extra), 1))])
        thick = np.concatenate([thick, np.full(len(extra), 0.4)])
        depth = np.concatenate([depth, extra[..., 2].mean(axis=1)])
    order = np.argsort(depth, kind="stable")
    stage.axes.add_collection(
        PolyCollection(
            [polygons[i] for i in order], facecolors=faces[order], edgecolors=rims[order],
            linewidths=thick[order], joinstyle="round", zorder=1,
        )
    )  # fmt: skip


def _paint_outline(
    stage: Stage, outline: Floats, flat: Floats, tolerance: float, colour: Any = INK
) -> None:
    from matplotlib.collections import LineCollection

    if len(outline):
        ends = stage.camera.project(outline)
        seen = visible(ends.mean(axis=1), flat, tolerance)
        stage.axes.add_collection(
            LineCollection(
                list(ends[seen, :, :2]), colors=[colour], linewidths=0.8, capstyle="round", zorder=2
            )
        )


def _paint_lines(
    stage: Stage,
    lines: Sequence[Line],
    flat: Floats,
    tolerance: float,
    values: Sequence[Floats],
    paint: ScalarMappable | None,
    off: Sequence[NDArray[np.bool_]],
    show_names: bool,
    clip: tuple[Floats, Floats] | None,
) -> None:
    """Paint what is seen of lines, within a box `clip` if there is one; striped where `off`."""
    from matplotlib.collections import LineCollection
    from matplotlib.patheffects import withStroke

    runs: list[Floats] = []
    run_values: list[float] = []
    run_off: list[bool] = []
    nearness: list[float] = []
    for number, line in enumerate(lines):
        nodes, segment, middle = _subdivided(stage.camera.project(line.points), 2.5 * stage.point)
        middles = 0.5 * (nodes[1:] + nodes[:-1])
        seen = visible(middles, flat, tolerance)
        if clip is not None:
            places = stage.camera.place(middles)
            seen &= np.all((places >= clip[0]) & (places <= clip[1]), axis=1)
        of_piece: Floats = np.zeros(len(segment))
        if paint is not None:
            given = values[number]
            if given.shape == (len(np.asarray(line.points)),):
                of_piece = given[segment] + middle * (given[segment + 1] - given[segment])
            else:
                of_piece = np.broadcast_to(given, len(np.asarray(line.points)) - 1)[segment]
        if len(seen) >= 2 * _SHORTEST:  # no specks of what is hidden all around
            starts = np.flatnonzero(np.r_[True, seen[1:] != seen[:-1]])
            for start, end in zip(starts, [*starts[1:], len(seen)], strict=True):
                seen[start:end] &= end - start >= _SHORTEST
        # a run: pieces that are seen, one after the other, in one colour and style
        kinds = np.column_stack([seen, of_piece, off[number][segment]])
        starts = np.flatnonzero(np.r_[True, np.any(kinds[1:] != kinds[:-1], axis=1)])
        for start, end in zip(starts, [*starts[1:], len(seen)], strict=True):
            if seen[start]:
                runs.append(nodes[start : end + 1, :2])
                run_values.append(float(of_piece[start]))
                run_off.append(bool(off[number][segment[start]]))
                nearness.append(float(nodes[start : end + 1, 2].mean()))
        if show_names and line.name and seen.any():
            right, up = nodes[np.flatnonzero(seen)[-1] + 1, :2]
            text = stage.axes.annotate(
                line.name, (right, up), (4, 4), textcoords="offset points", fontsize=8.5, color=INK,
                zorder=5,
            )  # fmt: skip
            text.set_path_effects([withStroke(linewidth=2.0, foreground="white")])
    if not runs:
        return
    order = np.argsort(nearness, kind="stable")
    paths = [runs[i] for i in order]
    cores = _CABLE if paint is None else paint.to_rgba(np.array(run_values)[order])
    styles = [STRIPES if run_off[i] else "solid" for i in order]
    for zorder, colour, thick, style in ((3, RIM, 2.9, "solid"), (4, cores, 1.7, styles)):
        stage.axes.add_collection(
            LineCollection(
                paths, colors=colour, linewidths=thick, linestyles=style, joinstyle="round",
                capstyle="butt" if style is styles and any(run_off) else "round", zorder=zorder,
            )
        )  # fmt: skip


def _off_segments(line: Line, name: str | None) -> NDArray[np.bool_]:
    """Say which segments of a line are off the surface, (k - 1,)."""
    count = len(np.asarray(line.points))
    given = np.zeros(()) if name is None else np.asarray(line.data[name])
    if given.shape == (count,):
        given = np.maximum(given[1:], given[:-1])
    return np.broadcast_to(given != 0.0, count - 1)


def _subdivided(nodes: Floats, step: float) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Cut a projected polyline's segments into pieces no longer than `step`.

    Returns the nodes (s + 1, 3), each piece's segment (s,) and its middle's place along it (s,).
    """
    lengths = np.linalg.norm(np.diff(nodes[:, :2], axis=0), axis=1)
    counts = np.maximum(np.ceil(lengths / step), 1).astype(np.int64)
    segment = np.repeat(np.arange(len(counts)), counts)
    k = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts)
    start = (k / counts[segment])[:, None]
    cut = nodes[segment] + start * (nodes[segment + 1] - nodes[segment])
    return np.vstack([cut, nodes[-1:]]), segment, (k + 0.5) / counts[segment]


def _edge_strength(stage: Stage, flat: Floats) -> float:
    """Return how strongly to draw edges, 0 to 1: those of a fine mesh would be all one sees."""
    if len(flat) == 0:
        return 0.0
    sides = flat[..., :2] - np.roll(flat[..., :2], 1, axis=1)
    points = float(np.median(np.linalg.norm(sides, axis=2))) / stage.point
    return 0.0 if points < 3.0 else float(np.clip((points - 3.0) / 12.0, 0.15, 1.0))


def _outline(points: Floats, triangles: NDArray[np.int64]) -> Floats:
    """Return the ends (b, 2, 3) of the edges that belong to one triangle only.

    Vertices at the same place count as one, as the parts of folded triangles may bring their own.
    """
    if len(triangles) == 0:
        return np.empty((0, 2, 3))
    step = 1e-9 * float(np.ptp(points, axis=0).max()) or 1.0
    _, first, same = np.unique(
        np.round(points / step), axis=0, return_index=True, return_inverse=True
    )
    merged = same.reshape(-1)[triangles]
    pairs = np.sort(merged[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    pairs, counts = np.unique(pairs, axis=0, return_counts=True)
    return points[first[pairs[counts == 1]]]
