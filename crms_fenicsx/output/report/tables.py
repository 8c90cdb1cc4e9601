"""Tables of a report: rows of texts and numbers, as HTML and as CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

from crms_fenicsx.output.csv_text import escaped

Cell = str | int | float | None
"""None is an empty cell: there is no such value."""

MOST_ROWS = 600
"""Longer tables are in the CSV files only."""
SHORT = 14
"""Shorter tables stay on one page of paper."""

EMPTY = "\u2013"
"""What an empty cell shows: a dash."""

MINUS = "\u2212"
"""The minus sign, as wide as a digit."""


@dataclass(frozen=True)
class Table:
    """A table with a heading for each column."""

    caption: str  # what it is about
    columns: Sequence[str]  # headings, with units
    rows: Sequence[Sequence[Cell]]  # a cell for each column
    name: str = ""  # of the CSV file, after the report's own; "" writes none
    headings: int = 1  # how many columns name the row

    def html(self) -> str:
        """A table element; numbers have four significant digits."""
        if self.name and len(self.rows) > MOST_ROWS:
            text = f"{self.caption}: {len(self.rows)} rows, in the file ..._{self.name}.csv."
            return f"<p>{escape(text)}</p>\n"
        kinds = [' class="number"' if self._is_number(k) else "" for k in range(len(self.columns))]
        head = "".join(
            f'<th scope="col"{kind}>{escape(text)}</th>'
            for text, kind in zip(self.columns, kinds, strict=True)
        )
        bodies = "\n".join(
            "<tbody>\n" + "\n".join(self._row(row, kinds, n) for n, row in group) + "\n</tbody>"
            for group in self._groups()
        )
        kind = "grouped" if self.headings > 1 else "plain"
        kind += " short" if len(self.rows) <= SHORT else ""
        return (
            f'<div class="table"><table class="{kind}">\n'
            f"<caption>{escape(self.caption)}</caption>\n"
            f"<thead><tr>{head}</tr></thead>\n{bodies}\n</table></div>\n"
        )

    def _is_number(self, column: int) -> bool:
        """Whether a column holds numbers, which stand at its right."""
        return any(isinstance(row[column], float | int) for row in self.rows)

    def _groups(self) -> list[list[tuple[int, Sequence[Cell]]]]:
        """Rows with the same first heading; the first of them with how many they are, or 0."""
        if self.headings < 2:
            return [[(1, row) for row in self.rows]]
        groups = [list(group) for _, group in groupby(self.rows, key=lambda row: row[0])]
        return [[(0 if k else len(g), row) for k, row in enumerate(g)] for g in groups]

    def _row(self, row: Sequence[Cell], kinds: Sequence[str], span: int) -> str:
        cells = []
        for k, value in enumerate(row):
            text = escape(shown(value))
            if k == 0 and span != 1:
                if span:
                    cells.append(f'<th scope="rowgroup" rowspan="{span}">{text}</th>')
            elif k < self.headings:
                cells.append(f'<th scope="row">{text}</th>')
            else:
                cells.append(f"<td{kinds[k]}>{text}</td>")
        return f"<tr>{''.join(cells)}</tr>"

    def csv(self) -> str:
        """The table as comma-separated values, numbers with all their digits, texts as such."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(map(escaped, self.columns))
        writer.writerows(["" if x is None else escaped(x) for x in row] for row in self.rows)
        return buffer.getvalue()


def shown(value: Cell) -> str:
    """A cell as people read it."""
    if value is None:
        return EMPTY
    return number(value) if isinstance(value, float) else str(value)


def number(value: float) -> str:
    """A number with four significant digits, as 0.01234, 12.34 or 12340; beyond by powers."""
    if not math.isfinite(value):
        return EMPTY if math.isnan(value) else str(value)
    size = abs(float(f"{value:.3e}"))
    if size == 0.0:
        return "0"
    digits = math.floor(math.log10(size))
    if not -4 <= digits < 7:
        mantissa, power = f"{value:.3e}".split("e")
        return f"{mantissa}e{int(power)}".replace("-", MINUS)
    return f"{value:.{max(3 - digits, 0)}f}".replace("-", MINUS)


def per_cent(share: float) -> str:
    """A share in per cent; what is there at all is no 0 %."""
    if 0.0 < share < 5e-4:
        return "< 0.1 %"
    return f"{100 * share:.1f} %"


def place(at: Sequence[float], size: float) -> str:
    """A place to a thousandth of a size."""
    decimals = min(max(2 - math.floor(math.log10(size)), 0), 6) if size > 0.0 else 3
    numbers = (f"{x if abs(x) > 0.5 * 10**-decimals else 0.0:.{decimals}f}" for x in at)
    return "; ".join(numbers).replace("-", MINUS)
