"""Elements of a report page: sections of texts, figures, charts and tables; units; printing."""

from __future__ import annotations

import base64
import math
import re
import struct
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.results.output.figures.plots import units_of_results
from crms_fenicsx.results.output.history import csv_line

Item = TypeVar("Item")
Cell = str | int | float | None
"""None is an empty cell: no value."""

SHORT = 12
"""Number of rows up to which a table is kept on one printed page."""

WHOLE = "whole membrane"
"""Name of all parts."""

EMPTY = "\u2013"
"""Dash shown in an empty cell."""

MINUS = "\u2212"
"""Minus sign, as wide as a digit."""

PAGE = "report.html"
"""The package's template of a page, which others extend."""

MACROS = "parts.html"
"""Template of tables and figures, which a file beside the user's template replaces."""

DECIMALS = {"mm": 0, "cm": 1, "in": 2}
"""Decimals of lengths to the millimetre, by unit; 3 of metres, feet and unknown ones."""

LARGEST = 4_900_000
"""Largest size of a page with pictures (bytes)."""


class Measured(float):
    """A number with fixed decimals on the page, and with all digits in CSV files."""

    decimals: int

    def __new__(cls, value: float, decimals: int) -> Measured:
        """The number with its decimals."""
        new = super().__new__(cls, value)
        new.decimals = decimals
        return new


class PagePart(Protocol):
    """Part of a section; `kind` is the template macro that writes it."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Paragraph:
    """Plain text."""

    text: str
    look: str = ""  # style class
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Notes:
    """Texts in small print."""

    texts: Sequence[str]
    kind: ClassVar[str] = "notes"


@dataclass(frozen=True)
class Link:
    """Link to a file beside the page."""

    text: str
    file: str
    kind: ClassVar[str] = "link"


@dataclass(frozen=True)
class Verdict:
    """Verdict on a structure, with reasons."""

    text: str
    reasons: Sequence[str] = ()
    look: str = ""  # "doubtful", "failed", or "" if good
    kind: ClassVar[str] = "verdict"


@dataclass(frozen=True)
class Signatures:
    """Lines to be signed."""

    rows: Sequence[tuple[str, str, str]]  # role, name and date, or "" to be filled in by hand
    kind: ClassVar[str] = "signatures"


@dataclass(frozen=True)
class Figure:
    """Picture embedded in the page; the caption is also its alternative text."""

    png: bytes
    caption: str
    look: str = "result"  # style class
    kind: ClassVar[str] = "figure"

    @property
    def base64(self) -> str:
        """Base64 text of the PNG."""
        return base64.b64encode(self.png).decode("ascii")

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, from the PNG header."""
        width, height = struct.unpack(">II", self.png[16:24])
        return width, height


@dataclass(frozen=True)
class Figures:
    """Figures side by side, as space permits."""

    figures: Sequence[Figure]
    kind: ClassVar[str] = "figures"


@dataclass(frozen=True)
class BarChart:
    """Bar chart; rows are (name, start, end)."""

    caption: str
    rows: Sequence[tuple[str, float, float]]
    limit: float | None = None
    kind: ClassVar[str] = "chart"
    MOST: ClassVar[int] = 24  # largest number of bars; more are read in a table

    @property
    def is_empty(self) -> bool:
        """Whether there are no bars, too many, or only zeros."""
        return not 0 < len(self.rows) <= self.MOST or self.most <= 0.0

    @property
    def most(self) -> float:
        """The largest value, which spans the chart's width."""
        return max([high for *_, high in self.rows] + [self.limit or 0.0], default=0.0)

    @property
    def drawn(self) -> list[tuple[str, float, float, str, bool]]:
        """Name, start, width (per cent) and text of each bar, and whether it exceeds the limit."""
        ranges, per = any(low > 0.0 for _, low, _ in self.rows), 100.0 / self.most
        return [
            (
                name, per * low, per * (high - low),
                " to ".join(dict.fromkeys(
                    shown(even(x, self.most)) for x in (low, high)[0 if ranges else 1 :]
                )),
                self.limit is not None and high > self.limit,
            )
            for name, low, high in self.rows
        ]  # fmt: skip


@dataclass(frozen=True)
class Table:
    """Table with a heading for each column."""

    caption: str  # subject
    columns: Sequence[str]  # headings, with units
    rows: Sequence[Sequence[Cell]]  # one cell per column
    name: str = ""  # suffix of the CSV file's name; "" writes none
    headings: int = 1  # number of columns that name the row
    small: bool = False  # whether many columns need small print
    even: bool = False  # whether numbers of one unit have the decimals of the largest one
    kind: ClassVar[str] = "table"

    @property
    def is_long(self) -> bool:
        """Whether it is in the CSV file only."""
        return bool(self.name) and len(self.rows) > 600

    @property
    def is_short(self) -> bool:
        """Whether it is kept on one printed page."""
        return len(self.rows) <= SHORT

    @property
    def shown(self) -> Table:
        """The table without empty columns."""
        kept = [
            k for k in range(len(self.columns))
            if k < self.headings or any(row[k] not in (None, "") for row in self.rows)
        ]  # fmt: skip
        rows = [[row[k] for k in kept] for row in (self._evened if self.even else self.rows)]
        return replace(self, columns=[self.columns[k] for k in kept], rows=rows)

    @property
    def _evened(self) -> list[list[Cell]]:
        """The rows, with as many decimals for all numbers of a unit as for its largest one."""
        unit = re.compile(r"\[.*\]").search
        kinds = [found.group() if (found := unit(one) or unit(self.caption)) else one
                 for one in self.columns]  # fmt: skip
        most = dict[str, float]()
        for row in self.rows:
            for kind, x in zip(kinds, row, strict=True):
                if isinstance(x, float):
                    most[kind] = max(abs(x), most.get(kind, 0.0))
        return [[even(x, most.get(kind, 0.0)) for kind, x in zip(kinds, row, strict=True)]
                for row in self.rows]  # fmt: skip

    @property
    def numeric(self) -> list[bool]:
        """Whether each column has numbers."""
        each = range(len(self.columns))
        return [any(isinstance(row[k], float | int) for row in self.rows) for k in each]

    @property
    def groups(self) -> list[list[Sequence[Cell]]]:
        """Rows grouped by their first heading, up to `SHORT` per group, kept on one printed page;
        one group if there is one heading column."""
        if self.headings == 1:
            return [list(self.rows)]
        every = (list(group) for _, group in groupby(self.rows, key=lambda row: row[0]))
        return [part for group in every for part in in_parts(group, SHORT)]

    def csv(self) -> str:
        """The table as CSV text, numbers with all digits, texts escaped."""
        return "".join(map(csv_line, (self.columns, *self.rows)))


@dataclass(frozen=True)
class PageSection:
    """A section with a heading."""

    title: str  # heading
    body: Sequence[PagePart]  # contents
    level: int = 2  # 2, or 3 for a subsection
    number: str = ""  # set by `page`

    @property
    def parts(self) -> list[PagePart]:
        """The contents without empty charts and figures."""
        return [
            one.shown if isinstance(one, Table) else one for one in self.body
            if not (isinstance(one, BarChart) and one.is_empty)
            and not (isinstance(one, Figures) and not one.figures)
        ]  # fmt: skip


PARTS: tuple[type[PagePart], ...] = (
    Paragraph, Notes, Link, Verdict, Signatures, Figure, Figures, BarChart, Table,
)  # fmt: skip
"""All parts of sections; `parts.html` has a macro for the kind of each."""


def check_template(template: Path) -> None:
    """Raise `InputError` if a user's template, or the macros beside it, cannot write a report."""
    from jinja2 import TemplateError

    title, kinds = "6e3c", [one.kind for one in PARTS]
    try:
        macros = environment(template).get_template(MACROS)
        missing = [kind for kind in kinds if not hasattr(macros.module, kind)]
        if missing:
            raise InputError(
                f"report: {macros.filename} lacks the macros {', '.join(missing)}, as those of an "
                "earlier version; add them as in the package's parts.html, or remove the file."
            )
        text = page("", [], [PageSection(title, [])], template)
    except TemplateError as error:
        raise InputError(f"report: the template {str(template)!r} fails: {error}") from None
    if title not in text:
        raise InputError(
            f"report: the template {str(template)!r} leaves out the report's sections; begin it "
            'with {% extends "report.html" %}, or write `sections` as the package\'s template does.'
        )


def in_parts(items: list[Item], most: int) -> list[list[Item]]:
    """Items in parts of up to `most`, of nearly the same length."""
    n = math.ceil(len(items) / most)
    return [items[k * len(items) // n : (k + 1) * len(items) // n] for k in range(n)]


def page(
    title: str, about: Sequence[tuple[str, str]], sections: Sequence[PageSection],
    template: Path | None = None,
) -> str:  # fmt: skip
    """The HTML page, from the package's template or the user's."""
    numbered, chapter, below = [], 0, 0
    for one in sections:
        chapter, below = (chapter + 1, 0) if one.level == 2 else (chapter, below + 1)
        text = f"{chapter}" if one.level == 2 else f"{chapter}.{below}"
        numbered.append(PageSection(one.title, one.body, one.level, text))
    return rendered(PAGE, template, title=title, about=about, sections=numbered)


def environment(template: Path | None) -> Any:
    """The jinja2 environment of the package's templates, or of a user's and files beside it."""
    from jinja2 import ChoiceLoader, DictLoader, Environment, FileSystemLoader, StrictUndefined

    own = Path(__file__).parent / "templates"
    # never beside the user's template, where it is a page written before
    extended = DictLoader({PAGE: (own / PAGE).read_text(encoding="utf-8")})
    folders = [template.parent, own] if template else [own]
    jinja = Environment(
        loader=ChoiceLoader([extended, FileSystemLoader(folders)]),
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined,
    )  # fmt: skip
    jinja.filters |= {"cell": shown, "whole": whole}
    return jinja


def rendered(name: str, template: Path | None = None, **values: Any) -> str:
    """A template of the package, or the user's, with values."""
    jinja = environment(template)
    if template is None:
        return str(jinja.get_template(name).render(**values))
    return str(jinja.from_string(template.read_text(encoding="utf-8")).render(**values))


def shown(value: Cell) -> str:
    """Display text of a cell."""
    if value is None:
        return EMPTY
    if isinstance(value, Measured):
        return f"{round(value, value.decimals) + 0.0:.{value.decimals}f}".replace("-", MINUS)
    return number(value) if isinstance(value, float) else str(value)


def whole(text: str) -> Any:
    """A text as HTML in which no unit, such as kN/m, is broken over two lines."""
    from markupsafe import Markup, escape

    return Markup(re.sub(r"\S+/\S+", r'<span class="unit">\g<0></span>', str(escape(text))))


def number(value: float) -> str:
    """A number with four significant digits: 0.01234, 12.34, 12340; else with an exponent."""
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
    """A fraction in per cent; small non-zero ones are shown as "< 0.1 %", 10 and more as
    "> 1000 %"."""
    if 0.0 < share < 5e-4:
        return "< 0.1 %"
    return f"{100 * share:.1f} %" if share < 10.0 else "> 1000 %"


def even(value: Cell, most: float) -> Cell:
    """A number with as many decimals as a larger one has by `number`; others as they are."""
    size = 0.0 if not math.isfinite(most) else abs(float(f"{most:.3e}"))
    if type(value) is not float or value == 0.0 or not 1e-4 <= size < 1e7:
        return value
    return Measured(value, max(3 - math.floor(math.log10(size)), 0))


def place(at: Sequence[float], size: float) -> str:
    """Coordinates to a thousandth of `size`."""
    decimals = min(max(2 - math.floor(math.log10(size)), 0), 6) if size > 0.0 else 3
    numbers = (f"{x if abs(x) > 0.5 * 10**-decimals else 0.0:.{decimals}f}" for x in at)
    return "; ".join(numbers).replace("-", MINUS)


@dataclass(frozen=True)
class Units:
    """Units of length and force, as in headings."""

    length: str = ""  # such as "m" and "kN"; "" if unknown
    force: str = ""

    def __getitem__(self, kind: str) -> str:
        """Unit of a kind of quantity as " [m]"; "" if unknown."""
        unit = units_of_results(self.length, self.force).get(kind)
        return f" [{unit}]" if unit else ""

    def plain(self, kind: str) -> str:
        """Unit of a kind of quantity as " m", without brackets."""
        return self[kind].replace("[", "").replace("]", "")

    def exact(self, length: float) -> Measured:
        """A length to the millimetre."""
        return Measured(length, DECIMALS.get(self.length, 3))

    def headings(self, text: str) -> list[str]:
        """Headings from a text such as "Length{length}|State", with units."""
        return text.format_map(self).split("|")


INSTALL = (
    "report: pdf=True needs WeasyPrint, which is missing or lacks its libraries ({}): on Debian "
    "apt install weasyprint, elsewhere pip install weasyprint or conda install weasyprint. Without "
    "pdf=True open the page in any browser, and print it to a file on A4."
)


def check_printing() -> None:
    """Raise `InputError` if WeasyPrint cannot be imported."""
    try:
        import weasyprint  # noqa: F401
    except (ImportError, OSError) as error:  # OSError: Pango is missing
        raise InputError(INSTALL.format(error)) from None


def print_page(html: str, path: Path) -> None:
    """Print an HTML page to a tagged PDF on A4."""
    from weasyprint import HTML

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # its own, of the library below it
        HTML(string=html).write_pdf(path, pdf_variant="pdf/ua-1")
