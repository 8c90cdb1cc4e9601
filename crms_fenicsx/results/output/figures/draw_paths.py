"""Pictures of the paths of points, step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.results.output.figures.axes3d import (
    DISTINCT,
    FLAT,
    INK,
    Axes3D,
    annotate,
    bounds,
    check_view,
    style_axes,
    with_unit,
)
from crms_fenicsx.results.output.figures.picture import (
    Camera,
    add_lines,
    add_polygons,
    checked_picture,
)
from crms_fenicsx.results.view_data import Line, Surface

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CLOSEUP = 2.3  # inches, with labels
_CABLE = "#8a8f98"


@dataclass(frozen=True, kw_only=True)
class PathOptions:
    """Options of `draw_path`.

    Parameters
    ----------
    points, triangles : (n, 3) array of length, (m, 3) array of int, optional
        Triangles drawn below the paths.
    lines : sequence of Line
        Cables: grey if unnamed, otherwise one colour and legend entry per name.
    view : (azimuth, elevation)
        Viewer's position in degrees; by default the plan.
    closeups : dict of numbers of paths by title, optional
        Panels beside the picture with close-ups in plan of these paths and nearby cables, all at
        one scale. Where paths coincide, later ones have smaller markers.
    unit, title : str
        Unit of length; heading.
    width, dpi : float, int
        Width in inches; pixels per inch.
    """

    points: ArrayLike | None = None
    triangles: ArrayLike | None = None
    lines: Sequence[Line] = ()
    view: tuple[float, float] = (-90.0, 90.0)
    closeups: Mapping[str, Sequence[int]] | None = None
    unit: str = ""
    title: str = ""
    width: float = 6.5
    dpi: int = 180


def draw_path(filename: str | Path | None, paths: Sequence[Line], **options: Any) -> Figure | None:
    """Draw paths of points, with a numbered marker for each step, and cables.

    Meant for models of a few triangles: hidden parts are drawn, too. Not collective.

    Parameters
    ----------
    filename : str, Path or None
        Picture file (.png, .pdf, .svg ...); None returns the figure.
    paths : sequence of Line
        Positions of one point each, step 0 first; the names go into the legend. May be empty if
        there are ``lines``.
    **options
        Options of `PathOptions`: ``points``, ``triangles``, ``lines``, ``closeups`` ...

    Returns
    -------
    matplotlib.figure.Figure
        The figure for notebooks, without a file; else None.

    Raises
    ------
    InputError
        Neither paths nor cables, inconsistent arrays, or a file that cannot be written.
    """
    how = PathOptions(**options)
    lines, closeups = how.lines, how.closeups or {}
    if not paths and not lines:
        raise InputError("nothing to draw: no paths and no lines; pass one of them.")
    if (how.points is None) != (how.triangles is None):
        raise InputError("points and triangles belong together; pass both or neither.")
    ways = [np.asarray(path.checked().points) for path in paths]
    cables = [np.asarray(line.checked().points) for line in lines]
    corners = np.empty((0, 3, 3))
    if how.points is not None and how.triangles is not None:
        surface = Surface(how.points, how.triangles).checked()
        corners = np.asarray(surface.points)[np.asarray(surface.triangles)]
    for name, numbers in closeups.items():
        if len(numbers) == 0 or not all(0 <= number < len(paths) for number in numbers):
            raise InputError(
                f"close-up {name!r} of the paths {list(numbers)}; pass numbers from 0 to "
                f"{len(paths) - 1}."
            )
    check_view(how.view)
    file = checked_picture(filename)

    low, high = bounds([corners, *ways, *cables])
    size = float(np.linalg.norm(high - low))
    plan = abs(how.view[1]) >= 85.0
    camera = Camera(*how.view, 0.5 * (low + high), np.inf if plan else 3.5 * size)
    room = (_CLOSEUP, 0.3 + _CLOSEUP * len(closeups)) if closeups else (0.0, 2.6)
    names = dict.fromkeys(line.name for line in lines if line.name)
    colours = {name: DISTINCT[(len(ways) + k) % len(DISTINCT)] for k, name in enumerate(names)}
    legend = [
        (DISTINCT[number % len(DISTINCT)], path.name or f"path {number + 1}", "line")
        for number, path in enumerate(paths)
        if len(paths) > 1 or path.name
    ] + [(colour, name, "line") for name, colour in colours.items()]
    axes3d = Axes3D(camera, low, high, how.title, 0, how.width, legend, room)
    axes3d.draw_box(how.unit)
    flat = camera.project(corners)
    of_lines = [colours.get(line.name, _CABLE) for line in lines]
    _draw_below(
        axes3d.axes,
        flat[np.argsort(flat[..., 2].mean(axis=1)), :, :2],
        [camera.project(cable)[:, :2] for cable in cables],
        of_lines,
        axes3d.point,
    )
    for number, way in enumerate(ways):
        at = camera.project(way)[:, :2]
        steps = [] if closeups else _spaced_steps(at, 14.0 * axes3d.point)
        _draw_point_path(axes3d.axes, at, number, 4.5 if len(at) < 20 else 2.5, steps)
    if closeups:
        below = [cable[:, :2] for cable in cables], of_lines
        _add_closeups(axes3d, ways, closeups, corners[..., :2], below, how.unit)
    return axes3d.finished(file, how.dpi)


def _add_closeups(
    axes3d: Axes3D,
    ways: Sequence[Array],
    closeups: Mapping[str, Sequence[int]],
    corners: Array,
    cables: tuple[Sequence[Array], Sequence[str]],
    unit: str,
) -> None:
    """Draw a close-up in plan for each group of paths, one below the other, all at one scale."""
    groups = [[ways[number][:, :2] for number in numbers] for numbers in closeups.values()]
    lows = np.array([np.min([way.min(axis=0) for way in group], axis=0) for group in groups])
    highs = np.array([np.max([way.max(axis=0) for way in group], axis=0) for group in groups])
    size = float((axes3d.high - axes3d.low).max())
    extent = float((highs - lows).max())
    # points that stand still but for the solver's tolerance are no paths to be enlarged
    half = 0.66 * extent if extent > FLAT * size else 0.05 * size
    width, height = axes3d.figure.get_size_inches()
    side = _CLOSEUP - 0.75
    for row, (title, numbers) in enumerate(closeups.items()):
        middle = 0.5 * (lows[row] + highs[row])
        bottom = height - 0.1 - _CLOSEUP * (row + 1) + 0.5
        axis = axes3d.figure.add_axes(
            ((width - 0.15 - side) / width, bottom / height, side / width, side / height)
        )
        axis.set_xlim(middle[0] - half, middle[0] + half)
        axis.set_ylim(middle[1] - half, middle[1] + half)
        axis.set_title(title, fontsize=9, color=INK, pad=4)
        for name, label in (("x", axis.set_xlabel), ("y", axis.set_ylabel)):
            label(with_unit(name, unit), fontsize=8, color=INK, labelpad=2)
        style_axes(axis, 7.5)
        axis.locator_params(nbins=4)
        axis.ticklabel_format(useOffset=False)
        point = 2.0 * half / side / 72.0
        _draw_below(axis, corners, *cables, point)
        for place, number in enumerate(numbers):
            at = ways[number][:, :2]
            steps = _spaced_steps(at, 9.0 * point) if place == 0 else []
            _draw_point_path(axis, at, number, max(6.5 - 3.0 * place, 2.0), steps)


def _draw_below(
    axes: Any, triangles: Array, cables: Sequence[Array], colours: Sequence[str], point: float
) -> None:
    """Draw triangles and the cables on them; `point` is the length shown by a typographic point."""
    # the edges of a fine mesh would dominate the picture
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
    fine = len(sides) > 0 and float(np.median(sides)) < 30.0 * point
    add_polygons(
        axes, triangles, facecolors=(0.80, 0.86, 0.93, 0.55),
        edgecolors="#a9b2be" if fine else "#5f6b7a", linewidths=0.4 if fine else 0.9, zorder=1,
    )  # fmt: skip
    add_lines(axes, cables, colors=list(colours), linewidths=1.6, capstyle="round", zorder=2)


def _draw_point_path(axes: Any, at: Array, number: int, size: float, steps: Sequence[int]) -> None:
    colour = DISTINCT[number % len(DISTINCT)]
    axes.plot(
        *at.T, color=colour, linewidth=1.4, marker="o", markersize=size, zorder=3,
        markeredgecolor="white", markeredgewidth=0.6,
    )  # fmt: skip
    for step in steps:
        annotate(axes, str(step), at[step], (5, 3), 7.5)


def _spaced_steps(at: Array, apart: float) -> list[int]:
    """Steps whose numbers have room, the first and last step before the others."""
    steps: list[int] = []
    for step in [0, len(at) - 1, *range(len(at) - 2, 0, -1)]:
        if all(np.linalg.norm(at[step] - at[other]) >= apart for other in steps):
            steps.append(step)
    return steps
