"""Plots of a run's history, and of errors over cell size."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx.foundation.runtime.arguments import collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.results.output.figures.axes3d import (
    DISTINCT,
    FLAT,
    INK,
    style_axes,
    with_unit,
)
from crms_fenicsx.results.output.figures.picture import checked_picture, finished, new_figure
from crms_fenicsx.results.output.history import History

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Series = tuple[Sequence[float], float, float, float]
"""Values of a quantity by mesh level, its limit, the limit's uncertainty, and a reference size."""


def draw_convergence(
    comm: MPI.Intracomm,
    filename: str | Path | None,
    cells: Sequence[int],
    series: Mapping[str, Series],
    *,
    title: str = "",
    width: float = 8.0,
) -> Figure | None:
    """Plot the relative distances of values from their limits. Collective."""
    with raised_together(comm):
        if comm.rank:
            return None
        path = checked_picture(filename)
        figure = new_figure(width, 0.62 * width)
        axis = figure.subplots()
        size = np.sqrt(cells[0] / np.asarray(cells, dtype=float))
        largest, colours = 0.0, cycle(DISTINCT)
        for name, (values, limit, bar, scale) in series.items():
            errors = np.abs(np.asarray(values) - limit)
            if errors.max() <= 0.0:
                continue
            there = errors > 0.0
            low = np.minimum(bar, 0.9 * errors)[there]  # a bar down to 0 has no end on a log scale
            bars = np.stack([low, np.full_like(low, bar)]) / scale
            axis.errorbar(
                size[there], errors[there] / scale, bars.tolist(),
                color=next(colours), marker="o", markersize=4, linewidth=1.4, capsize=3,
                elinewidth=0.8, label=name,
            )  # fmt: skip
            largest = max(largest, float(errors.max() / scale))
        if largest > 0.0:
            axis.plot(size, largest * size**2, "--", color=INK, linewidth=0.9, label="order 2")
            axis.set_xscale("log", base=2)
            axis.set_yscale("log")
            axis.legend(fontsize=8, frameon=False, labelcolor=INK, loc="upper left",
                        bbox_to_anchor=(1.0, 1.0))  # fmt: skip
        axis.set_xlabel("size of the cells, in parts of the first mesh's", fontsize=9, color=INK)
        axis.set_ylabel("distance from the limit, in parts of the size", fontsize=9, color=INK)
        style_axes(axis, 8)
        if title:
            figure.suptitle(title, fontsize=11, color=INK)
        figure.tight_layout()
        return finished(figure, path, 160)


@dataclass(frozen=True, kw_only=True)
class HistoryOptions:
    """Options of `draw_history`.

    Parameters
    ----------
    unit, force
        Units of length and force, for labels.
    units
        Units of other columns, by name or its beginning ("tension": "kN").
    title
        Heading of all panels.
    width, dpi
        Width in inches; pixels per inch.
    """

    unit: str = ""
    force: str = ""
    units: Mapping[str, str] | None = None
    title: str = ""
    width: float = 8.0
    dpi: int = 160


@collective
def draw_history(
    history: History,
    filename: str | Path | None = None,
    x: str = "step",
    panels: Sequence[Sequence[str]] | None = None,
    **options: Any,
) -> Figure | None:
    """Plot columns of a history, in panels. Collective on the history's ranks.

    Parameters
    ----------
    history
        The history, such as ``solver.history``.
    filename
        Picture file (.png, .pdf, .svg ...); None returns the figure.
    x
        Column of the horizontal axis.
    panels
        Columns of each panel. By default those of `default_panels`; if there are none, all numeric
        columns, with those that differ in a final number ("slip 1", "slip 2") in one panel.
    **options
        Options of `HistoryOptions`: ``unit``, ``force``, ``units``, ``title`` ...

    Returns
    -------
    matplotlib.figure.Figure
        The figure for notebooks, on the first rank and without a file; else None.

    Raises
    ------
    InputError
        On all ranks: an empty history, a missing or non-numeric column, or a file that cannot be
        written.

    Examples
    --------
    >>> output.draw_history(solver.history, "history.png", x="pressure", force="kN")
    """
    how = HistoryOptions(**options)
    if len(history) == 0:
        raise InputError("the history is empty; draw it after the first step.")
    if panels is None:
        panels = default_panels(history) or _grouped(history, x)
    if not panels or not all(panels):
        raise InputError(f"panels {panels!r}: nothing to plot over {x!r}; name columns in each.")
    for column in [x, *(column for panel in panels for column in panel)]:
        if history[column].dtype.kind not in "if":
            raise InputError(f"column {column!r} holds text; plot columns of numbers.")
    with raised_together(history.comm):
        if history.comm.rank:
            return None
        path = checked_picture(filename)
        units = units_of_results(how.unit, how.force) | dict(how.units or {})
        across = 1 if len(panels) == 1 else 2
        down = -(-len(panels) // across)
        figure = new_figure(how.width, 2.5 * down + (0.4 if how.title else 0.0))
        axes = figure.subplots(down, across, squeeze=False)
        for axis, panel in zip(axes.flat, panels, strict=False):
            _plot(axis, history, x, panel, units)
        for axis in axes.flat[len(panels) :]:
            axis.remove()
        if how.title:
            figure.suptitle(how.title, fontsize=11, color=INK)
        figure.tight_layout(w_pad=2.0, h_pad=1.2)
        return finished(figure, path, how.dpi)


def units_of_results(length: str, force: str) -> dict[str, str]:
    """Units of result quantities that follow from the units of length and force."""
    found = dict.fromkeys(("length", "L0"), length)
    found |= dict.fromkeys(("force", "tension", "residual"), force)
    if length:
        found |= {"area": f"{length}²", "volume": f"{length}³"}
    if length and force:
        found |= {
            "stress": f"{force}/{length}",
            "pressure": f"{force}/{length}²",
            "energy": f"{force} {length}",
            "bending": f"{force} {length}²",
        }
    return {name: unit for name, unit in found.items() if unit}


def default_panels(history: History) -> list[list[str]]:
    """Columns that vary: pressure, load, L0, volume, tension, and energies large enough to show."""
    groups = [
        [column for column in history.columns if column == name or column.startswith(f"{name} ")]
        for name in ("pressure", "load", "L0", "volume", "tension", "energy")
    ]
    shown = [  # constant but for the solver's tolerance
        [c for c in group if np.ptp(_extent([history[c]])) > FLAT * _size(history[c])]
        for group in groups
    ]
    if not any(shown):  # such as a single step
        shown = [[c for c in group if np.any(history[c] != 0.0)] for group in groups]
    largest = [max((_size(history[c]) for c in group), default=0.0) for group in shown]
    seen = [
        [c for c in group if _size(history[c]) >= 0.01 * size]
        for group, size in zip(shown, largest, strict=True)
    ]
    return [group for group in seen if group]


def _size(values: Array) -> float:
    return float(np.nanmax(np.abs(values)))


def _grouped(history: History, x: str) -> list[list[str]]:
    groups: dict[str, list[str]] = {}
    for column in history.columns:
        if column != x and column != "step" and history[column].dtype.kind in "if":
            groups.setdefault(_family(column), []).append(column)
    return list(groups.values())


def _family(column: str) -> str:
    return re.sub(r"\s*\d+$", "", column) or column


def _common(panel: Sequence[str]) -> str:
    """Words common to the beginnings of all columns, or else the columns' families."""
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
    label = panel[0] if len(panel) == 1 else _common(panel)
    low, high = _extent([history[column] for column in panel])
    if low < 0.0 < high:
        axis.axhline(0.0, color="#9aa1ab", linewidth=0.8, zorder=1)
    colours = cycle(DISTINCT)
    for column in panel:
        whole = len(panel) > 1 and column == label  # such as "energy", the sum of the others
        axis.plot(
            history[x], history[column], color=INK if whole else next(colours),
            label=column.removeprefix(f"{label} "), linewidth=2.2 if whole else 1.4,
            marker=marker, markersize=3.5,
        )  # fmt: skip
    axis.set_ylabel(_with_unit(label, panel[0], units), fontsize=9, color=INK)
    axis.set_xlabel(_with_unit(x, x, units), fontsize=9, color=INK)
    style_axes(axis, 8)
    if history[x].dtype.kind == "i":
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    if all(history[column].dtype.kind == "i" for column in panel):
        axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    axis.ticklabel_format(axis="y", useOffset=False)
    if high - low <= FLAT * max(abs(low), abs(high)):  # not the solver's tolerance, enlarged
        air = 0.05 * max(abs(low), abs(high)) or 0.5
        axis.set_ylim(low - air, high + air)
    # equal ranges in all panels, even where a column starts late
    low, high = _extent([history[x]])
    air = 0.03 * (high - low) or 0.5
    axis.set_xlim(low - air, high + air)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    if len(panel) > 1:
        axis.legend(  # above the panel, where it covers no curve
            fontsize=8, frameon=False, labelcolor=INK, ncols=min(len(panel), 4),
            loc="lower left", bbox_to_anchor=(-0.02, 1.0), borderaxespad=0.0,
            columnspacing=1.2, handlelength=1.4,
        )  # fmt: skip


def _extent(arrays: Sequence[Any]) -> tuple[float, float]:
    return min(float(np.nanmin(a)) for a in arrays), max(float(np.nanmax(a)) for a in arrays)


def _with_unit(label: str, column: str, units: Mapping[str, str]) -> str:
    fitting = [key for key in units if column == key or column.startswith(key + " ")]
    return with_unit(label, units[max(fitting, key=len)] if fitting else "")
