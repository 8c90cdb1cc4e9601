"""Painting of cables over a surface, coloured by value."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.results.output.figures.axes3d import RIM, STRIPES, Axes3D, annotate
from crms_fenicsx.results.output.figures.picture import add_lines, subdivided, visible
from crms_fenicsx.results.view_data import Line

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

NO_VALUE = (0.784, 0.784, 0.784)


def _common_value(values: Array) -> tuple[float, float] | None:
    """Range of values that are nearly equal; None if they differ or none is finite."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0 or np.ptp(finite) > 1e-2 * np.abs(finite).max():
        return None
    return float(finite.min()), float(finite.max())


def _in_words(label: str, low: float, high: float) -> str:
    """Label with its values; a unit in brackets at the label's end is moved behind them."""
    found = re.fullmatch(r"(.*?)\s*\[(.*)\]", label)
    name, unit = found.groups() if found else (label, "")
    ends = dict.fromkeys(f"{value:.4g}" for value in (low, high))
    return " ".join(part for part in (name, " to ".join(ends), unit) if part)


def _limits_of(values: Array) -> tuple[float, float]:
    """Ends of the colour scale: those of the values and 0, from which they are counted."""
    finite = values[np.isfinite(values)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0))
    return (low, high) if low < high else (0.0, 1.0)


def colouring(
    values: Array | None,
    label: str,
    limits: tuple[float, float] | None,
    colours: str,
    levels: int | None = None,
) -> tuple[ScalarMappable | None, str]:
    """Colour scale of values, NaN in grey, or the legend text of a common value."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    if values is None:
        return None, ""
    same = _common_value(values) if limits is None else None
    if same is not None:
        return None, _in_words(label, *same)
    colormap = colormaps[colours].resampled(levels) if levels else colormaps[colours]
    colormap = colormap.with_extremes(bad=NO_VALUE)
    scale = Normalize(*(_limits_of(values) if limits is None else limits))
    return ScalarMappable(scale, colormap), ""


CABLE = "#c8322b"


@dataclass(frozen=True)
class _LineStyle:
    """Colours and visibility of lines."""

    # values of each line for its colours: one, one per point or one per segment
    values: list[Array]
    # colour scale; None: plain cable colour
    paint: ScalarMappable | None
    note: str  # legend text of a value common to all lines, or ""
    off: list[Booleans]  # whether each line's segments are off the surface
    clamps: list[Array]  # (k, 3) clamps of each line

    @property
    def off_colour(self) -> Any:
        """Colour of the segments off the surface, of their mean value."""
        if self.paint is None:
            return CABLE
        values = [
            _interpolated(values, np.flatnonzero(off), np.array(0.5), len(off) + 1)
            for values, off in zip(self.values, self.off, strict=True)
        ]
        return self.paint.to_rgba(np.concatenate(values).mean(keepdims=True))[0]


def line_style(
    lines: Sequence[Line],
    name: str | None,
    label: str,
    limits: tuple[float, float] | None,
    colours: str,
    loose: str | None,
) -> _LineStyle:
    """Style of lines; arguments as for `draw_shape`."""
    if name is not None and not lines:
        raise InputError(f"line_values {name!r}, but there are no lines; leave it out.")
    for line in lines:
        for data in (name, loose):
            if data is not None and data not in line.data:
                known = ", ".join(line.data) or "no data"
                raise InputError(f"the line {line.name!r} has no {data!r}; it has {known}.")
    off = [_off_segments(line, loose) for line in lines]
    clamps = [np.asarray(line.points)[np.asarray(line.data["clamp"]) > 0.0] for line in lines
              if "clamp" in line.data]  # fmt: skip
    if name is None:
        return _LineStyle([], None, "", off, clamps)
    values = [np.asarray(line.data[name]) for line in lines]
    paint, note = colouring(np.concatenate([v.ravel() for v in values]), label, limits, colours)
    if note and len(lines) > 1:
        note = f"{len(lines)} cables: {note}"
    elif note and lines[0].name:
        note = f"{re.sub(r'^cable 1$', 'cable', lines[0].name)}: {note}"
    return _LineStyle(values, paint, note, off, clamps)


def _off_segments(line: Line, name: str | None) -> Booleans:
    """Whether each segment of a line is off the surface, (k - 1,)."""
    count = len(np.asarray(line.points))
    given = np.zeros(()) if name is None else np.asarray(line.data[name])
    if given.shape == (count,):
        given = np.maximum(given[1:], given[:-1])
    return np.broadcast_to(given != 0.0, count - 1)


def paint_lines(
    axes3d: Axes3D,
    lines: Sequence[Line],
    style: _LineStyle,
    triangles: Array,
    tolerance: float,
    clip: tuple[Array, Array] | None,
    show_names: bool,
) -> None:
    """Paint the parts of lines not hidden by triangles (m, 3, 3), of coincident lines the last."""
    runs: list[Array] = []
    run_values: list[float] = []
    run_off: list[bool] = []
    depths: list[float] = []
    for number, line in enumerate(lines):
        flat = axes3d.camera.project(line.points)
        ends = np.stack([flat[:-1], flat[1:]], axis=1)
        pieces, segment, middle = subdivided(ends, 2.5 * axes3d.point)
        nodes = np.concatenate([pieces[:, 0], flat[-1:]])
        seen = _seen(axes3d, 0.5 * (nodes[1:] + nodes[:-1]), triangles, tolerance, clip)
        values: Array = np.zeros(len(segment))
        if style.paint is not None:
            values = _interpolated(style.values[number], segment, middle, segment[-1] + 2)
        off = style.off[number][segment]
        # a run: successive visible pieces of one colour and style
        for start, end in _runs(np.column_stack([seen, values, off])):
            if seen[start]:
                runs.append(nodes[start : end + 1])
                depths.append(runs[-1][:, 2].mean() + tolerance * number / len(lines))
                run_values.append(float(values[start]))
                run_off.append(bool(off[start]))
        if show_names and line.name and seen.any():
            annotate(axes3d.axes, line.name, nodes[np.flatnonzero(seen)[-1] + 1, :2], (4, 4), 8.5)
    if not runs:
        return
    order = np.argsort(depths, kind="stable")
    paths = [runs[i][:, :2] for i in order]
    cores = CABLE if style.paint is None else style.paint.to_rgba(np.array(run_values)[order])
    styles = [STRIPES if run_off[i] else "solid" for i in order]
    for zorder, colour, thick, dashes in ((3, RIM, 2.9, "solid"), (4, cores, 1.7, styles)):
        add_lines(
            axes3d.axes, paths, colors=colour, linewidths=thick, linestyles=dashes,
            joinstyle="round", zorder=zorder,
            capstyle="butt" if dashes is styles and any(run_off) else "round",
        )  # fmt: skip
    for clamps in style.clamps:
        at = axes3d.camera.project(clamps)
        at = at[visible(at, triangles, tolerance)]
        axes3d.axes.scatter(at[:, 0], at[:, 1], s=12.0, c="white", edgecolors=RIM, zorder=5)


def _seen(
    axes3d: Axes3D,
    middles: Array,
    triangles: Array,
    tolerance: float,
    clip: tuple[Array, Array] | None,
) -> Booleans:
    """Whether pieces of a line are visible at their midpoints, without short runs."""
    seen = visible(middles, triangles, tolerance)
    if clip is not None:
        places = axes3d.camera.place(middles)
        seen &= np.all((places >= clip[0]) & (places <= clip[1]), axis=1)
    if len(seen) >= 6:  # runs of one or two pieces are specks in a crease
        for start, end in _runs(seen[:, None]):
            seen[start:end] &= end - start > 2
    return seen


def _runs(kinds: NDArray[np.generic]) -> list[tuple[int, int]]:
    """Start row and end of each run of equal rows."""
    starts = np.flatnonzero(np.r_[True, np.any(kinds[1:] != kinds[:-1], axis=1)])
    return list(zip(starts, [*starts[1:], len(kinds)], strict=True))


def _interpolated(given: Array, segment: Integers, middle: Array, count: int) -> Array:
    """Values at the middles, 0 to 1, of segments of a line with `count` points."""
    if given.shape == (count,):
        return given[segment] + middle * (given[segment + 1] - given[segment])
    return np.broadcast_to(given, count - 1)[segment]
