"""Plots of a run's history, and of the paths of single points."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from crms_fenicsx.errors import InputError
from crms_fenicsx.output.camera import Camera
from crms_fenicsx.output.history import History
from crms_fenicsx.output.shapes import Line, Surface
from crms_fenicsx.output.stage import (
    INK,
    Stage,
    bounds,
    check_view,
    checked_filename,
    new_figure,
    save,
)

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # tell them apart


def draw_history(
    filename: str | Path,
    history: History,
    x: str = "step",
    panels: Sequence[Sequence[str]] | None = None,
    *,
    units: Mapping[str, str] | None = None,
    title: str = "",
    width: float = 8.0,
    dpi: int = 160,
) -> None:
    """Plot columns of a history, in panels. Not collective.

    Parameters
    ----------
    filename : str or Path
        Picture to write; its suffix says the format.
    history : History
    x : str
        Column of the horizontal axis.
    panels : sequence of sequences of str, optional
        Columns that share a panel. By default every column of numbers is there, those that
        differ in a last number only ("tension cable 1", "tension cable 2") in one panel.
    units : dict, optional
        Units by column, or by the beginning of its name ("tension": "kN").
    title : str
    width, dpi : float, int
        Width in inches; pixels per inch.

    Raises
    ------
    InputError
        For a column that does not exist or holds text, an empty history, or a file that cannot
        be written.
    """
    if len(history) == 0:
        raise InputError("the history is empty; draw it after the first step")
    if panels is None:
        panels = _grouped(history, x)
    if not panels or not all(panels):
        raise InputError(f"panels {panels!r}: nothing to plot over {x!r}; name columns in each")
    for column in [x, *(column for panel in panels for column in panel)]:
        if history[column].dtype.kind not in "if":
            raise InputError(f"column {column!r} holds text; plot columns of numbers")
    path = checked_filename(filename)

    across = 1 if len(panels) == 1 else 2
    down = -(-len(panels) // across)
    figure = new_figure(width, 2.5 * down + (0.4 if title else 0.0))
    axes = figure.subplots(down, across, squeeze=False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        _plot(axis, history, x, panel, units or {})
    for axis in axes.flat[len(panels) :]:
        axis.remove()
    if title:
        figure.suptitle(title, fontsize=11, color=INK)
    figure.tight_layout(w_pad=2.0, h_pad=1.2)
    save(figure, path, dpi)


def _grouped(history: History, x: str) -> list[list[str]]:
    groups: dict[str, list[str]] = {}
    for column in history.columns:
        if column != x and column != "step" and history[column].dtype.kind in "if":
            groups.setdefault(_family(column), []).append(column)
    return list(groups.values())


def _family(column: str) -> str:
    return re.sub(r"\s*\d+$", "", column) or column


def _common(panel: Sequence[str]) -> str:
    """Return the words that all columns begin with, or else all their families."""
    words = [column.split() for column in panel]
    same = [step[0] for step in zip(*words, strict=False) if len(set(step)) == 1]
    begins = " ".join(same)
    if same and all(f"{column} ".startswith(f"{begins} ") for column in panel):
        return begins
    return ", ".join(dict.fromkeys(_family(column) for column in panel))


def _plot(
    axis: Any, history: History, x: str, panel: Sequence[str], units: Mapping[str, str]
) -> None:
    from matplotlib.ticker import MaxNLocator

    marker = "o" if len(history) <= 40 else ""
    for number, column in enumerate(panel):
        axis.plot(
            history[x], history[column], color=_COLOURS[number % len(_COLOURS)], label=column,
            linewidth=1.4, marker=marker, markersize=3.5,
        )  # fmt: skip
    label = panel[0] if len(panel) == 1 else _common(panel)
    axis.set_ylabel(_with_unit(label, panel[0], units), fontsize=9, color=INK)
    axis.set_xlabel(_with_unit(x, x, units), fontsize=9, color=INK)
    axis.tick_params(labelsize=8, colors=INK, width=0.7, length=3)
    if history[x].dtype.kind == "i":
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    if all(history[column].dtype.kind == "i" for column in panel):
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    # the same range in all panels, also where a column starts late
    low, high = np.nanmin(history[x]), np.nanmax(history[x])
    air = 0.03 * (high - low) or 0.5
    axis.set_xlim(low - air, high + air)
    axis.grid(color="#e3e6ea", linewidth=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    if len(panel) > 1:
        axis.legend(fontsize=8, frameon=False, labelcolor=INK)


def _with_unit(label: str, column: str, units: Mapping[str, str]) -> str:
    fitting = [key for key in units if column == key or column.startswith(key + " ")]
    return f"{label} [{units[max(fitting, key=len)]}]" if fitting else label


def draw_path(
    filename: str | Path,
    paths: Sequence[Line],
    *,
    points: ArrayLike | None = None,
    triangles: ArrayLike | None = None,
    lines: Sequence[Line] = (),
    view: tuple[float, float] = (-90.0, 90.0),
    zoom: bool = False,
    unit: str = "",
    title: str = "",
    width: float = 6.5,
    dpi: int = 180,
) -> None:
    """Draw the ways that points have gone, with a marker and a number for each step.

    Made for models of a few triangles: nothing hides anything. Not collective.

    Parameters
    ----------
    filename : str or Path
        Picture to write; its suffix says the format.
    paths : sequence of Line
        The positions of a point, step 0 first; the lines' names go into a legend.
    points, triangles : (n, 3) array of length, (m, 3) array of int, optional
        Triangles below the paths.
    lines : sequence of Line
        Cables, drawn plainly.
    view : (azimuth, elevation)
        In degrees; by default the plan.
    zoom : bool
        Fill the picture with the paths, and cut off triangles and cables around them.
    unit : str
        Of length.
    title : str
    width, dpi : float, int
        Width in inches; pixels per inch.

    Raises
    ------
    InputError
        Without paths, for arrays that do not fit together, or a file that cannot be written.
    """
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patheffects import withStroke
    from matplotlib.transforms import TransformedBbox

    if not paths:
        raise InputError("no paths to draw; give at least one line of positions")
    if (points is None) != (triangles is None):
        raise InputError("points and triangles belong together; give both or neither")
    ways = [np.asarray(path.checked().points) for path in paths]
    cables = [np.asarray(line.checked().points) for line in lines]
    corners = np.empty((0, 3, 3))
    if points is not None and triangles is not None:
        surface = Surface(points, triangles).checked()
        corners = np.asarray(surface.points)[np.asarray(surface.triangles)]
    check_view(view)
    file = checked_filename(filename)

    low, high = bounds(ways if zoom else [corners, *ways, *cables])
    size = float(np.linalg.norm(high - low))
    plan = abs(view[1]) >= 85.0
    camera = Camera(*view, 0.5 * (low + high), np.inf if plan else 3.5 * size)
    stage = Stage(camera, low, high, title, 0, width)
    stage.draw_box(unit)
    axes = stage.axes
    flat = camera.project(corners)
    below = [
        PolyCollection(
            list(flat[np.argsort(flat[..., 2].mean(axis=1)), :, :2]),
            facecolors=(0.80, 0.86, 0.93, 0.55), edgecolors="#5f6b7a", linewidths=0.9, zorder=1,
        ),
        LineCollection(
            [camera.project(cable)[:, :2] for cable in cables], colors="#8a8f98", linewidths=1.6,
            capstyle="round", zorder=2,
        ),
    ]  # fmt: skip
    for collection in below:
        axes.add_collection(collection)
        if zoom:
            collection.set_clip_box(TransformedBbox(stage.frame(), axes.transData))
    for number, (path, way) in enumerate(zip(paths, ways, strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        at = camera.project(way)[:, :2]
        axes.plot(
            *at.T, color=colour, linewidth=1.4, marker="o", markersize=4.5, zorder=3,
            markeredgecolor="white", markeredgewidth=0.6, label=path.name or f"path {number + 1}",
        )  # fmt: skip
        for step in _told_apart(at, 14.0 * stage.point):
            text = axes.annotate(
                str(step), at[step], (4, 4), textcoords="offset points", fontsize=7.5, color=colour,
                zorder=4,
            )  # fmt: skip
            text.set_path_effects([withStroke(linewidth=1.8, foreground="white")])
    if len(paths) > 1 or paths[0].name:
        axes.legend(
            loc="upper right", bbox_to_anchor=stage.frame(),
            bbox_transform=axes.transData, fontsize=8, labelcolor=INK, framealpha=0.85,
            edgecolor="none",
        )  # fmt: skip
    stage.save(file, dpi)


def _told_apart(at: NDArray[np.float64], apart: float) -> list[int]:
    """Return the steps whose numbers have room, the first and the last before the others."""
    steps: list[int] = []
    for step in [0, len(at) - 1, *range(1, len(at) - 1)]:
        if all(np.linalg.norm(at[step] - at[other]) >= apart for other in steps):
            steps.append(step)
    return steps
