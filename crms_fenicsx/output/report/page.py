"""The page of a report: style, tables and sections in one file of HTML."""

from __future__ import annotations

import base64
import csv
import io
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

from crms_fenicsx.output.history import escaped

STYLE = """
:root { --ink: #1b2733; --faint: #5b6876; --rule: #c9d1d9; --tint: #f3f6f9; --accent: #1f5a8c; }
* { box-sizing: border-box; }
body { font: 15px/1.5 "Helvetica Neue", Arial, "Liberation Sans", sans-serif; color: var(--ink);
  background: #fff; max-width: 68rem; margin: 0 auto; padding: 2rem 1.5rem 4rem; }
header { border-bottom: 3px solid var(--accent); margin-bottom: 1.5rem; padding-bottom: 1rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .6rem; padding-bottom: .25rem;
  border-bottom: 1px solid var(--rule); color: var(--accent); }
h3 { font-size: 1.05rem; margin: 1.8rem 0 .4rem; }
p { max-width: 48rem; margin: .4rem 0 .8rem; }
dl.about { display: grid; grid-template-columns: max-content 1fr; gap: .1rem 1.2rem;
  margin: .8rem 0 0; }
dl.about dt { color: var(--faint); } dl.about dd { margin: 0; }
nav ol { columns: 2; margin: 0; padding-left: 1.3rem; } nav a { color: var(--accent); }
p.verdict { max-width: none; }
.verdict { border-left: 5px solid #2d7d46; background: #eef7f0; padding: .6rem .9rem;
  margin: 1rem 0; }
.verdict.doubtful { border-color: #b7791f; background: #fdf6e8; }
.verdict.failed { border-color: #b3261e; background: #fdeeed; }
.key { display: grid; grid-template-columns: repeat(3, 1fr); gap: .7rem;
  margin: 1rem 0; }
.key div { border: 1px solid var(--rule);
  border-top: 3px solid var(--accent); padding: .5rem .7rem; }
.key .value { font-size: 1.35rem; font-weight: 600; font-variant-numeric: tabular-nums;
  display: block; }
.key .what, .key .case { color: var(--faint); font-size: .84rem; display: block; }
.table { overflow-x: auto; margin: .8rem 0 1.3rem; }
table { border-collapse: collapse; font-size: .86rem; min-width: 50%;
  border-top: 1.5px solid var(--ink); border-bottom: 1.5px solid var(--ink); }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; font-size: .9rem; }
th, td { padding: .22rem .6rem; text-align: left; vertical-align: baseline; }
thead th { border-bottom: 1px solid var(--ink); vertical-align: bottom; }
tbody th { font-weight: 500; }
table.plain tbody tr:nth-child(even) { background: var(--tint); }
table.grouped tbody { border-top: 1px solid var(--rule); }
th[scope="rowgroup"] { font-weight: 600; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
thead th.number { white-space: normal; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(24rem, 1fr)); gap: 1rem;
  align-items: end; }
figure { margin: .4rem 0; } figure img { width: 100%; height: auto; display: block; }
figure.model { max-width: 44rem; }
figure.chart { max-width: 44rem; } .chart svg { width: 100%; height: auto; display: block; }
.chart text { font-size: 12.5px; fill: var(--ink); } .chart rect { fill: var(--accent); }
.chart rect.over { fill: #b3261e; } .chart .axis { stroke: var(--ink); }
.chart .limit { stroke: #b3261e; stroke-dasharray: 4 3; }
figcaption { font-size: .84rem; color: var(--faint); }
footer { margin-top: 3rem;
  border-top: 1px solid var(--rule); color: var(--faint); font-size: .84rem; }
@media (max-width: 45rem) {
  .key, .figures { grid-template-columns: 1fr; } nav ol { columns: 1; }
}
@media print {
  @page { size: A4; margin: 16mm 14mm 18mm; }
  body { font-size: 9.5pt; max-width: none; padding: 0; }
  h2, h3, caption { break-after: avoid; }
  tr, figure, table.short, .key div, .verdict { break-inside: avoid; }
  thead { display: table-header-group; break-after: avoid; }
  tbody:first-of-type tr:first-child { break-before: avoid; break-after: avoid; }
  .table { overflow: visible; } table { font-size: 7.6pt; min-width: 0; }
  th, td { padding: .12rem .35rem; }
  figure.model, figure.chart { max-width: 13cm; } footer { display: none; }
  .figures { grid-template-columns: 1fr 1fr; gap: .6rem; }
  nav a { color: inherit; text-decoration: none; }
  .verdict, tbody tr, .key div, .chart rect { print-color-adjust: exact;
    -webkit-print-color-adjust: exact; }
}
""".strip()


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
        numeric = [
            any(isinstance(row[k], float | int) for row in self.rows)
            for k in range(len(self.columns))
        ]
        kinds = [' class="number"' if number else "" for number in numeric]
        head = "".join(
            f'<th scope="col"{kind}>{escape(text)}</th>'
            for text, kind in zip(self.columns, kinds, strict=True)
        )
        grouped = self.headings > 1
        groups = [list(group) for _, group in groupby(self.rows, key=lambda row: row[0])]
        bodies = ""
        for group in groups if grouped else [list(self.rows)]:
            spans = [len(group), *[0] * (len(group) - 1)] if grouped else [1] * len(group)
            rows = (self._row(row, kinds, n) for row, n in zip(group, spans, strict=True))
            bodies += "<tbody>\n" + "\n".join(rows) + "\n</tbody>\n"
        kind = "grouped" if grouped else "plain"
        kind += " short" if len(self.rows) <= SHORT else ""
        return (
            f'<div class="table"><table class="{kind}">\n'
            f"<caption>{escape(self.caption)}</caption>\n"
            f"<thead><tr>{head}</tr></thead>\n{bodies}</table></div>\n"
        )

    def _row(self, row: Sequence[Cell], kinds: Sequence[str], span: int) -> str:
        """A row whose first heading spans some rows, 0 if it is within the span of another."""
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


LARGEST = 4_900_000
"""Bytes of a page that pictures may fill."""


@dataclass(frozen=True)
class PageSection:
    """A section with a heading."""

    title: str  # its heading
    body: Sequence[str | Table]  # what is below, as HTML or tables
    level: int = 2  # 2, or 3 of one inside another


def page(title: str, about: Sequence[tuple[str, str]], sections: Sequence[PageSection]) -> str:
    """The whole page."""
    chapters = [one.title for one in sections if one.level == 2]
    entries = "".join(
        f'<li><a href="#s{k}">{escape(text)}</a></li>' for k, text in enumerate(chapters, 1)
    )
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>" for name, text in about)
    body, number, below = [], 0, 0
    for one in sections:
        below = below + 1 if one.level == 3 else 0
        number += one.level == 2
        if one.level == 2:
            body.append(f'<h2 id="s{number}">{number} {escape(one.title)}</h2>\n')
        else:
            body.append(f"<h3>{number}.{below} {escape(one.title)}</h3>\n")
        body += [part.html() if isinstance(part, Table) else f"{part}\n" for part in one.body]
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>
{STYLE}
</style>
</head>
<body>
<header>
<h1>{escape(title)}</h1>
<dl class="about">{facts}</dl>
</header>
<nav aria-label="Contents"><ol>{entries}</ol></nav>
<main>
{"".join(body)}</main>
<footer>
<p>Computed with crms_fenicsx, foldable finite elements after Sakai and Tachibana.</p>
</footer>
</body>
</html>
"""


def paragraph(text: str, kind: str = "") -> str:
    """A paragraph of plain text, of a class of the style sheet."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def figure(png: bytes, caption: str, kind: str = "result") -> str:
    """A picture in the page itself; its caption tells those who do not see it what it shows."""
    data = base64.b64encode(png).decode("ascii")
    width, height = struct.unpack(">II", png[16:24])  # of the file's header
    text = escape(caption)
    return (
        f'<figure class="{kind}"><img alt="{text}" width="{width}" height="{height}" '
        f'src="data:image/png;base64,{data}">'
        f"<figcaption>{text}</figcaption></figure>"
    )


def figures(all_of_them: Sequence[str]) -> str:
    """Figures beside each other, as many as there is room for."""
    return f'<div class="figures">{"".join(all_of_them)}</div>' if all_of_them else ""


def key_figures(cards: Sequence[tuple[str, str, str]]) -> str:
    """The most important results: what, its value, and where it comes from."""
    found = "".join(
        f'<div><span class="what">{escape(what)}</span>'
        f'<span class="value">{escape(value)}</span>'
        f'<span class="case">{escape(source)}</span></div>'
        for what, value, source in cards
    )
    return f'<div class="key">{found}</div>'


WIDTH, LEFT, RIGHT, ROW, TOP = 760, 190, 140, 24, 26
"""Sizes of a chart, in units of the drawing: whole width, margins, height of a row, room above."""
MOST_BARS = 40
"""A chart with more bars than these says nothing at a glance."""


def bars(caption: str, rows: Sequence[tuple[str, float, float]], limit: float | None = None) -> str:
    """A figure with a bar for each row; "" for more than `MOST_BARS` or for nothing but zeros."""
    most = max([high for _, _, high in rows] + ([limit] if limit is not None else []), default=0.0)
    if not 0 < len(rows) <= MOST_BARS or most <= 0.0:
        return ""
    scale = (WIDTH - LEFT - RIGHT) / most
    height, ranges = TOP + ROW * len(rows) + 8, any(low > 0.0 for _, low, _ in rows)
    parts = [f'<line class="axis" x1="{LEFT}" y1="{TOP - 4}" x2="{LEFT}" y2="{height - 4}"/>']
    for k, (name, low, high) in enumerate(rows):
        y = TOP + ROW * k
        bad = ' class="over"' if limit is not None and high > limit else ""
        start, end = LEFT + scale * low, LEFT + scale * high
        text = f"{number(low)} to {number(high)}" if ranges else number(high)
        parts.append(
            f'<text x="{LEFT - 8}" y="{y + 13}" text-anchor="end">{escape(name)}</text>'
            f'<rect{bad} x="{start:.1f}" y="{y + 3}" width="{max(end - start, 1.5):.1f}" '
            f'height="{ROW - 10}"/><text x="{end + 6:.1f}" y="{y + 13}">{text}</text>'
        )
    if limit is not None:
        x = LEFT + scale * limit
        parts.append(
            f'<line class="limit" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 4}"/>'
            f'<text x="{x:.1f}" y="{TOP - 11}" text-anchor="middle">{number(limit)}</text>'
        )
    words = "; ".join(f"{name}: {number(low)} to {number(high)}" for name, low, high in rows)
    return (
        f'<figure class="chart"><svg viewBox="0 0 {WIDTH} {height}" role="img" '
        f'aria-label="{escape(f"{caption}. {words}")}">{"".join(parts)}</svg>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
