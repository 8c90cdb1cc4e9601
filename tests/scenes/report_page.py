"""Reads what a report has written."""

from __future__ import annotations

import csv
from html.parser import HTMLParser
from pathlib import Path


class Page(HTMLParser):
    """Reads a page: its tables by caption, and that all elements are closed."""

    VOID = ("meta", "img")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.words: list[str] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.images: list[dict[str, str | None]] = []
        self.rows: list[list[str]] = []
        self.caption = ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        if tag == "table":
            self.rows, self.caption = [], ""
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            if tag == "th":
                assert dict(attrs)["scope"] in ("col", "row", "rowgroup")
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag
        if tag == "caption":
            self.tables[self.caption] = self.rows

    def handle_data(self, data: str) -> None:
        self.words.append(data)
        inside = [tag for tag in self.open if tag != "span"][-1:]
        if inside in (["td"], ["th"]):
            self.rows[-1][-1] += data
        elif inside == ["caption"]:
            self.caption += data


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
