"""What a series of finer meshes says about the results on them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

from crms_fenicsx.convergence.richardson import Extrapolated, extrapolated
from crms_fenicsx.output.figures.convergence import draw_convergence
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Quantity:
    """A number on several meshes, and where it goes.

    Attributes
    ----------
    values
        From the coarsest mesh to the finest.
    limit, bar
        The value extrapolated to fine meshes, and how far it may be from the truth of the model:
        the bar held it in 19 of 20 cases with a known limit.
    order
        Order of convergence that the last three levels show; NaN where they show none.
    regular
        Whether the order is one that the bar counts on; else the bar is as wide as levels scatter.
    remark
        What to know of it, in words.
    size
        Size of the numbers of its kind, as of the whole vector that it is a component of.
    """

    values: tuple[float, ...]
    limit: float
    bar: float
    order: float
    regular: bool
    remark: str
    size: float

    @classmethod
    def of(cls, values: tuple[float, ...], size: float) -> Quantity:
        """Extrapolate values; `size` as for `extrapolated`."""
        found: Extrapolated = extrapolated(values, size)
        size = max(size, abs(found.limit))
        return cls(values, found.limit, found.bar, found.order, found.regular, found.remark, size)

    @property
    def error(self) -> float:
        """How far the value on the first mesh may be from the truth."""
        return abs(self.values[0] - self.limit) + self.bar


@dataclass(frozen=True, repr=False)
class Convergence:
    """Results on finer and finer meshes; ``print`` shows the table.

    Attributes
    ----------
    cells
        Number of cells on each level.
    seconds
        Time that each level has taken, the first not counted.
    quantities
        The numbers that were compared, by their names.
    finest
        The solver of the last level.
    comm
        Ranks that have them.
    """

    cells: tuple[int, ...]
    seconds: tuple[float, ...]
    quantities: Mapping[str, Quantity]
    finest: Any
    comm: MPI.Intracomm

    def __getitem__(self, name: str) -> Quantity:
        """The quantity with a name.

        Raises
        ------
        InputError
            There is none.
        """
        return checks.named("quantity", dict(self.quantities), name)

    def table(self) -> str:
        """The values on all levels, their limits with bars, orders, and what to know of them."""
        heads = [f"{n} cells" for n in self.cells]
        rows = [["", *heads, "limit", "+-", "order", ""]]
        for name, one in self.quantities.items():
            order = "-" if math.isnan(one.order) else f"{one.order:.2f}"
            digits = _digits(one.limit, one.bar)
            numbers = [f"{value:.{digits}g}" for value in (*one.values, one.limit)]
            rows.append([name, *numbers, f"{one.bar:.2g}", order, one.remark])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = []
        for row in rows:
            cells = [row[0].ljust(widths[0])]
            cells += [text.rjust(width) for text, width in zip(row[1:-1], widths[1:], strict=False)]
            lines.append("  ".join([*cells, row[-1]]).rstrip())
        return "\n".join(lines)

    def __repr__(self) -> str:
        return self.table()

    def draw(
        self,
        filename: str | Path | None = None,
        names: Sequence[str] | None = None,
        *,
        title: str = "",
        width: float = 8.0,
    ) -> Figure | None:
        """Plot how far the levels are from the limits, over the cells' size. Collective.

        Parameters
        ----------
        filename
            Picture to write; its suffix (.png, .pdf, .svg ...) says the format. None returns it.
        names
            Of the quantities; all by default.
        title
            Of the picture.
        width
            In inches.

        Returns
        -------
        matplotlib.figure.Figure
            On the first rank, without a file; a notebook shows it. Else None.

        Raises
        ------
        InputError
            On all ranks: a file that cannot be written, or a quantity that does not exist.
        """
        series = {}
        for name in self.quantities if names is None else names:
            one = self[name]
            series[name] = (one.values, one.limit, one.bar, one.size)
        return draw_convergence(self.comm, filename, self.cells, series, title=title, width=width)


def _digits(limit: float, bar: float) -> int:
    """Digits that show a value to a tenth of its bar."""
    if bar <= 0.0 or limit == 0.0:
        return 8
    return min(max(math.ceil(math.log10(abs(limit) / bar)) + 2, 4), 10)


def checked_levels(levels: object) -> int:
    """How many levels, two or more.

    Raises
    ------
    InputError
        Another number.
    """
    if levels == 1:
        raise InputError("convergence: levels = 1 compares nothing; give 2 or more, best 3.")
    return checks.whole("convergence: levels", levels, 2)
