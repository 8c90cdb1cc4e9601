"""Draw the plots of tables on pages: ./run python docs/draw_plots.py

A plot shows the last table above it, as a comment between them, hidden from readers, says:

    <!-- plot
    x: h
    y: area | length
    log: xy
    -->

    ![What the plot shows](../plots/name.svg)

draws columns of the table over the column `x`. With `rows`, rows of the table are drawn over the
numbers in its header, or over those of the row named `x`: `rows: T | W`, each the beginning of a
row, optionally renamed after "=". `split` makes a series of the rows with one word in that column;
`log` names the logarithmic axes (both, if it is not given), `from` the start of a linear axis, and
`slope` draws a line of that order. `<!-- bars` draws the columns `y` as bars, a group for each row.
Each picture holds the numbers that it shows, which `tests/test_figures.py` compares with the table.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator
from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

DOCS = Path(__file__).parent
PLOT = re.compile(r"^<!-- (plot|bars)\n(.*?)^-->\n\n!\[[^\]]*\]\((\S+)\)", re.DOTALL | re.MULTILINE)
STYLE = {"font.size": 12, "svg.fonttype": "path", "svg.hashsalt": "plots"}
Series = tuple[str, list[float], list[float]]


class Plot(NamedTuple):
    """A plot of a table."""

    path: Path
    kind: str
    options: dict[str, Any]
    lines: list[Series]

    @property
    def content(self) -> str:
        """All that it shows, as the file's description."""
        return json.dumps([self.kind, self.options, self.lines])


def plots() -> Iterator[Plot]:
    """The plots on all pages, in their order."""
    for page in sorted(DOCS.rglob("*.md")):
        source = page.read_text()
        for found in PLOT.finditer(source):
            kind, text, path = found.groups()
            table = table_above(source[: found.start()])
            given = dict(line.split(":", 1) for line in text.splitlines())
            options: dict[str, Any] = {"log": "xy", "x": "", "split": ""}
            options |= {name: value.strip() for name, value in given.items()}
            names = options.get("rows", options.get("y", "")).split("|")
            if kind == "bars":
                lines = list(bars_of(table, names))
                options["bars"] = [row[0] for row in table[1:]]
            elif "rows" in options:
                lines = list(rows_of(table, options["x"], names))
            else:
                lines = list(columns(table, options["x"], names, options["split"]))
            yield Plot(page.parent / path, kind, options, lines)


def number(cell: str) -> float | None:
    """The number at the beginning of a cell, if any: 10 092, 0.63 to 0.70, -2e-5, 1.4 s."""
    found = re.match(r"(-?(?:\d{1,3}(?: \d{3})+|\d*\.?\d+)(?:e[+-]?\d+)?)", cell.strip())
    return float(found[1].replace(" ", "")) if found else None


def table_above(source: str) -> list[list[str]]:
    """Cells of the last table of a text; the first row is its header."""
    rows: list[list[str]] = []
    for text in reversed(source.splitlines()):
        if text.lstrip().startswith("|"):
            rows.insert(0, [cell.strip() for cell in text.strip().strip("|").split("|")])
        elif rows:
            break
    return [row for row in rows if not set("".join(row)) <= set("-: ")]


def columns(table: list[list[str]], x: str, ys: list[str], split: str) -> Iterator[Series]:
    """Columns over a column, one series for each word in the column `split`."""
    head, *rows = table
    rows = filled(rows)
    kinds = list(dict.fromkeys(row[head.index(split)] for row in rows)) if split else [""]
    for kind in kinds:
        own = [row for row in rows if not split or row[head.index(split)] == kind]
        for name, label in map(named, ys):
            i, j = head.index(x), head.index(name)
            said = [kind.replace("`", "")] if kind else []
            if number(kind) is not None:
                said = [f"{split} {kind}"]
            if len(ys) > 1 or not kind:
                said.append(label)
            yield series(", ".join(said), [(row[i], row[j]) for row in own])


def filled(rows: list[list[str]]) -> list[list[str]]:
    """Rows whose empty first cells repeat the cell above."""
    found: list[list[str]] = []
    for row in rows:
        above = found[-1] if found and not row[0] else row
        found.append([above[0], *row[1:]])
    return found


def rows_of(table: list[list[str]], x: str, ys: list[str]) -> Iterator[Series]:
    """Rows over the header or over the row `x`, selected by their beginnings."""
    known = {" ".join(cell for cell in row if cell): row for row in filled(table)}
    over = next((row for key, row in known.items() if x and key.startswith(x)), table[0])
    for name, label in map(named, ys):
        row = next((row for key, row in known.items() if key.startswith(name)), None)
        if row is None:
            raise ValueError(f"no row {name!r} in {list(known)}")
        yield series(label, list(zip(over, row, strict=True))[1:])


def named(word: str) -> tuple[str, str]:
    """Name and label of a row or column, from "name" or "name = label"."""
    name, equals, label = word.rpartition(" = ")
    return (name.strip(), label.strip()) if equals else (word.strip(), word.strip())


def series(name: str, pairs: list[tuple[str, str]]) -> Series:
    """A series of those pairs of cells in which both are numbers."""
    numbers = [(number(a), number(b)) for a, b in pairs]
    kept = [(a, abs(b)) for a, b in numbers if a is not None and b is not None]
    return name.strip(), [a for a, _ in kept], [b for _, b in kept]


def bars_of(table: list[list[str]], ys: list[str]) -> Iterator[Series]:
    """Columns over the row numbers; `draw_bars` has the row names."""
    head, *rows = table
    for y in ys:
        j = head.index(y.strip())
        yield series(y, [(str(k), row[j]) for k, row in enumerate(rows)])


def ticks(axis: Any, values: list[float], named: bool) -> None:
    """Label a logarithmic axis with the values if few and well apart, else with 1, 2, 5."""
    pairs = itertools.pairwise(values)
    if named and len(values) <= 8 and all(b > 1.15 * a for a, b in pairs):
        axis.set_ticks(values, [f"{value:g}" for value in values])
        axis.set_ticks([], minor=True)
        return
    few = values[-1] < 100 * values[0]
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def draw(plot: Plot, axes: Axes) -> None:
    """Draw series."""
    options = plot.options
    styles = zip("o s ^ D v P X * < >".split(), "0173824659", strict=True)
    for (label, x, y), (marker, colour) in zip(plot.lines, styles, strict=False):
        axes.plot(x, y, marker=marker, color=f"C{colour}", label=label, linewidth=1.2, markersize=6)
    for axis, along in ((axes.xaxis, "x"), (axes.yaxis, "y")):
        if along in options["log"]:
            values = {value for _, x, y in plot.lines for value in (x if along == "x" else y)}
            getattr(axes, f"set_{along}scale")("log")
            ticks(axis, sorted(values), named=along == "x")
        elif along == "y":
            axes.set_ylim(bottom=float(options.get("from", 0.0)))
    if "slope" in options:
        _, x, y = plot.lines[0]
        order = float(options["slope"])
        ends = [min(x), max(x)]
        top = 0.6 * y[x.index(ends[0])]
        line = [top, top * (ends[1] / ends[0]) ** order]
        axes.plot(ends, line, "--", color="0.4", linewidth=1, label=f"order {abs(order):g}")
    axes.set_xlabel(options.get("xlabel", options["x"]))
    axes.set_ylabel(options.get("ylabel", ""))
    axes.grid(True, alpha=0.3)


def draw_bars(plot: Plot, axes: Axes) -> None:
    """Draw bars, a group for each row."""
    rows, width = plot.options["bars"], 0.8 / len(plot.lines)
    for k, (label, x, y) in enumerate(plot.lines):
        axes.barh([at + (k + 0.5) * width - 0.4 for at in x], y, width, label=label)
    axes.set_yticks(range(len(rows)), [fill(row, 26) for row in rows])
    axes.invert_yaxis()
    axes.set_xlabel(plot.options["xlabel"])
    axes.grid(True, axis="x", alpha=0.3)


def write(plot: Plot) -> None:
    """Write the picture of a plot."""
    with matplotlib.rc_context(STYLE):
        rows = len(plot.options.get("bars", ()))
        figure = Figure(figsize=(7.0, 1.2 + 0.55 * rows if rows else 4.2), layout="constrained")
        axes = figure.add_subplot()
        (draw_bars if rows else draw)(plot, axes)
        figure.legend(loc="outside upper left", frameon=False, ncols=2)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        plot.path.parent.mkdir(exist_ok=True)
        said = {"Date": None, "Description": plot.content}
        FigureCanvasSVG(figure).print_svg(plot.path, metadata=said)


def main() -> None:
    """Draw all plots."""
    for plot in plots():
        write(plot)


if __name__ == "__main__":
    main()
