"""What the page of a report is made of: sections with texts, figures, charts and tables."""

from __future__ import annotations

import base64
import csv
import io
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import ClassVar, Protocol

from crms_fenicsx.output.history import escaped

Cell = str | int | float | None
"""None is an empty cell: there is no such value."""

MOST_ROWS = 600
"""Longer tables are in the CSV files only."""
SHORT = 8
"""Shorter tables stay on one page of paper."""

EMPTY = "\u2013"
"""What an empty cell shows: a dash."""

MINUS = "\u2212"
"""The minus sign, as wide as a digit."""

LARGEST = 4_900_000
"""Bytes of a page that pictures may fill."""


class PagePart(Protocol):
    """A part of a section; its kind is the template's macro that writes it."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Paragraph:
    """A plain text."""

    text: str
    look: str = ""  # a class of the style sheet
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Notes:
    """Texts in small print."""

    texts: Sequence[str]
    kind: ClassVar[str] = "notes"


@dataclass(frozen=True)
class Link:
    """The name of a file beside the page, and what it shows."""

    text: str
    file: str
    kind: ClassVar[str] = "link"


@dataclass(frozen=True)
class Verdict:
    """What the page says first of a structure, and why."""

    text: str
    reasons: Sequence[str] = ()
    look: str = ""  # "doubtful", "failed" or "" of a good one
    kind: ClassVar[str] = "verdict"


@dataclass(frozen=True)
class KeyFigures:
    """The most important results."""

    rows: Sequence[tuple[str, str, str]]  # what, its value, and where it comes from
    kind: ClassVar[str] = "cards"


@dataclass(frozen=True)
class Figure:
    """A picture in the page itself; its caption tells those who do not see it what it shows."""

    png: bytes
    caption: str
    look: str = "result"  # a class of the style sheet
    kind: ClassVar[str] = "figure"

    @property
    def base64(self) -> str:
        """Its data as text."""
        return base64.b64encode(self.png).decode("ascii")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, out of the file's header."""
        width, height = struct.unpack(">II", self.png[16:24])
        return width, height


@dataclass(frozen=True)
class Figures:
    """Figures beside each other, as many as there is room for."""

    figures: Sequence[Figure]
    kind: ClassVar[str] = "figures"


@dataclass(frozen=True)
class BarChart:
    """A bar for each row, which has its name and where the bar begins and ends."""

    caption: str
    rows: Sequence[tuple[str, float, float]]
    limit: float | None = None
    kind: ClassVar[str] = "chart"
    WIDE: ClassVar[float] = 760.0  # units of the drawing; beside the longest bar: its values
    BESIDE: ClassVar[float] = 140.0
    LETTER: ClassVar[float] = 6.6  # of a name, on the mean
    MOST: ClassVar[int] = 40  # more bars than these say nothing at a glance

    @property
    def is_empty(self) -> bool:
        """Whether there are too many bars or nothing but zeros."""
        return not 0 < len(self.rows) <= self.MOST or self._most <= 0.0

    @property
    def _most(self) -> float:
        return max([high for *_, high in self.rows] + [self.limit or 0.0], default=0.0)

    @property
    def left(self) -> float:
        """Where bars begin, right of the longest name, in units of the drawing."""
        longest = max(len(name) for name, *_ in self.rows)
        return min(max(self.LETTER * longest + 16.0, 120.0), 0.6 * self.WIDE)

    @property
    def scale(self) -> float:
        """Units of the drawing for a value of one."""
        return (self.WIDE - self.BESIDE - self.left) / self._most

    @property
    def drawn(self) -> list[tuple[str, float, float, str, bool]]:
        """Name, start and width of each bar, the text beside it, and whether it is too long."""
        ranges, found = any(low > 0.0 for _, low, _ in self.rows), []
        for name, low, high in self.rows:
            text = f"{number(low)} to {number(high)}" if ranges else number(high)
            width = max(self.scale * (high - low), 1.5)
            over = self.limit is not None and high > self.limit
            found.append((name, self.scale * low, width, text, over))
        return found

    @property
    def words(self) -> str:
        """All that it shows."""
        every = (f"{name}: {number(low)} to {number(high)}" for name, low, high in self.rows)
        return f"{self.caption}. {'; '.join(every)}"


@dataclass(frozen=True)
class Table:
    """A table with a heading for each column."""

    caption: str  # what it is about
    columns: Sequence[str]  # headings, with units
    rows: Sequence[Sequence[Cell]]  # a cell for each column
    name: str = ""  # of the CSV file, after the report's own; "" writes none
    headings: int = 1  # how many columns name the row
    kind: ClassVar[str] = "table"

    @property
    def is_long(self) -> bool:
        """Whether it is in the CSV files only."""
        return bool(self.name) and len(self.rows) > MOST_ROWS

    @property
    def is_short(self) -> bool:
        """Whether it stays on one page of paper."""
        return len(self.rows) <= SHORT

    @property
    def shown(self) -> Table:
        """The table without columns that have no values."""
        kept = [
            k for k in range(len(self.columns))
            if k < self.headings or any(row[k] not in (None, "") for row in self.rows)
        ]  # fmt: skip
        rows = [[row[k] for k in kept] for row in self.rows]
        return replace(self, columns=[self.columns[k] for k in kept], rows=rows)

    @property
    def numeric(self) -> list[bool]:
        """Which columns have numbers."""
        each = range(len(self.columns))
        return [any(isinstance(row[k], float | int) for row in self.rows) for k in each]

    @property
    def groups(self) -> list[list[Sequence[Cell]]]:
        """Rows that share their first heading, at most `SHORT` of them, as they stay on one page;
        all in one if they have one heading only."""
        if self.headings == 1:
            return [list(self.rows)]
        every = (list(group) for _, group in groupby(self.rows, key=lambda row: row[0]))
        parts = ((group, math.ceil(len(group) / SHORT)) for group in every)
        return [
            group[k * len(group) // n : (k + 1) * len(group) // n]
            for group, n in parts for k in range(n)
        ]  # fmt: skip

    def csv(self) -> str:
        """The table as comma-separated values, numbers with all their digits, texts as such."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(map(escaped, self.columns))
        writer.writerows(["" if x is None else escaped(x) for x in row] for row in self.rows)
        return buffer.getvalue()


@dataclass(frozen=True)
class PageSection:
    """A section with a heading."""

    title: str  # its heading
    body: Sequence[PagePart]  # what is below
    level: int = 2  # 2, or 3 of one inside another
    number: str = ""  # which `page` gives

    @property
    def parts(self) -> list[PagePart]:
        """What is below, without charts and figures of nothing."""
        return [
            one.shown if isinstance(one, Table) else one for one in self.body
            if not (isinstance(one, BarChart) and one.is_empty)
            and not (isinstance(one, Figures) and not one.figures)
        ]  # fmt: skip


def page(
    title: str, about: Sequence[tuple[str, str]], sections: Sequence[PageSection],
    template: Path | None = None,
) -> str:  # fmt: skip
    """The whole page, by the package's template or another one."""
    from jinja2 import ChoiceLoader, Environment, FileSystemLoader, StrictUndefined

    folders = [Path(__file__).parent / "templates"]
    loaders = [FileSystemLoader(x) for x in ([template.parent] if template else []) + folders]
    jinja = Environment(
        loader=ChoiceLoader(loaders), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=StrictUndefined,
    )  # fmt: skip
    jinja.filters["cell"] = shown
    numbered, chapter, below = [], 0, 0
    for one in sections:
        chapter, below = (chapter + 1, 0) if one.level == 2 else (chapter, below + 1)
        text = f"{chapter}" if one.level == 2 else f"{chapter}.{below}"
        numbered.append(PageSection(one.title, one.body, one.level, text))
    name = template.name if template else "report.html"
    return jinja.get_template(name).render(title=title, about=about, sections=numbered)


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
