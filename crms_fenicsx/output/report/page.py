"""The page of a report: sections, figures and style, all in one file of HTML."""

from __future__ import annotations

import base64
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from crms_fenicsx.output.report.style import STYLE
from crms_fenicsx.output.report.tables import Table

LARGEST = 4_900_000
"""Bytes of a page that pictures may fill."""


@dataclass(frozen=True)
class Section:
    """A section with a heading."""

    title: str  # its heading
    body: Sequence[str | Table]  # what is below, as HTML or tables
    level: int = 2  # 2, or 3 of one inside another


def page(title: str, about: Sequence[tuple[str, str]], sections: Sequence[Section]) -> str:
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
