"""Plots of errors over the cells' size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from crms_fenicsx.output.figures.axes3d import (
    DISTINCT,
    INK,
    style_axes,
)
from crms_fenicsx.output.figures.picture import checked_picture, finished, given_file, new_figure
from crms_fenicsx.runtime.errors import raised_together

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Series = tuple[Sequence[float], float, float, float]
"""Values of a quantity on the levels, its limit, how far that may be wrong, and its size."""


def draw_convergence(
    comm: MPI.Intracomm,
    filename: str | Path | None,
    cells: Sequence[int],
    series: Mapping[str, Series],
    *,
    title: str = "",
    width: float = 8.0,
) -> Figure | None:
    """Plot how far values are from their limits, in parts of their sizes. Collective."""
    file = given_file("draw", filename)
    with raised_together(comm):
        if comm.rank == 0:
            return _draw(checked_picture(file), cells, series, title, width)
    return None


def _draw(
    path: Path | None,
    cells: Sequence[int],
    series: Mapping[str, Series],
    title: str,
    width: float,
) -> Figure | None:
    figure = new_figure(width, 0.62 * width)
    axis = figure.subplots()
    size = np.sqrt(cells[0] / np.asarray(cells, dtype=float))
    largest, colours = 0.0, cycle(DISTINCT)
    for name, (values, limit, bar, scale) in series.items():
        errors = np.abs(np.asarray(values) - limit)
        if errors.max() <= 0.0:
            continue
        there = errors > 0.0
        low = np.minimum(bar, 0.9 * errors)[there]  # a bar to 0 has no end on this scale
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
