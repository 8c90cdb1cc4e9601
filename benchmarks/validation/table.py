"""Rows of the table of published figures, and the style of the pictures beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from mpi4py import MPI
from numpy.typing import NDArray

COMM = MPI.COMM_SELF
FOLDER = Path(__file__).parents[2] / "docs" / "benchmarks" / "validation"
OURS, PUBLISHED, THIRD = "#0072B2", "#D55E00", "#009E73"
"""Colours that colour-blind readers can tell apart (M. Okabe and K. Ito)."""


@dataclass(frozen=True)
class Row:
    """A published figure beside ours.

    Attributes
    ----------
    quantity
        What it is, with its unit.
    published, ours
        The figures.
    bar
        How far ours may be from the limit of fine meshes; 0 where both programs use one mesh.
    remark
        How sure the published figure is, and the reason of a difference that is larger than `bar`.
    zero
        What a difference is divided by where the published figure is zero.
    """

    quantity: str
    published: float
    ours: float
    bar: float
    remark: str
    zero: float = 0.0

    @property
    def difference(self) -> float:
        """Ours over the published figure, minus 1."""
        return (self.ours - self.published) / abs(self.published or self.zero)


def report(source: str, rows: Sequence[Row]) -> None:
    """Print the rows as a table of the documentation."""
    print(f"| {source} | published | ours | +- | difference | how sure, and why |")
    print("|---|---|---|---|---|---|")
    for row in rows:
        digits = decimals(row)
        bar = f"{row.bar:.1g}" if row.bar else "same mesh"
        print(f"| {row.quantity} | {row.published:.10g} | {row.ours:.{digits}f} | {bar} "
              f"| {percent(row.difference)} | {row.remark} |")  # fmt: skip


def decimals(row: Row) -> int:
    """Decimals that show ours to its error bar, or as far as the published figure goes."""
    size = row.bar or abs(row.published) * 1e-9
    return max(0, 1 - math.floor(math.log10(size or 1.0)))


def percent(difference: float) -> str:
    """A relative difference in per cent, with two digits."""
    value = 100 * difference
    if abs(value) < 1e-5:
        return "< 1e-5 %"
    return f"{value:+.2g} %" if abs(value) < 10 else f"{value:+.0f} %"


def panels(count: int = 2) -> tuple[Figure, list[Axes]]:
    """A figure of some panels side by side."""
    figure = Figure(figsize=(7.2, 2.9), layout="constrained")
    found = [figure.add_subplot(1, count, k + 1) for k in range(count)]
    for axes in found:
        axes.tick_params(labelsize=8)
        axes.grid(color="0.9", linewidth=0.6)
        axes.set_axisbelow(True)
    return figure, found


def labels(axes: Axes, x: str, y: str, title: str = "", legend: bool = True) -> None:
    """Name axes, and the lines in them."""
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.set_title(title, fontsize=9)
    if legend:
        axes.legend(fontsize=8, frameon=False)


def save(figure: Figure, name: str) -> None:
    """Write a picture of the page."""
    FOLDER.mkdir(exist_ok=True)
    figure.savefig(FOLDER / f"{name}.png", dpi=110, pil_kwargs={"optimize": True})


def over_sizes(axes: Axes, sizes: Sequence[float] | NDArray[Any]) -> None:
    """Logarithmic axes whose lower one names the sizes and nothing else."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(sizes, [f"{size:.2g}" for size in sizes], fontsize=8)
    axes.xaxis.set_minor_locator(NullLocator())
