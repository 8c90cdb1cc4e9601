"""Texts in CSV files, which spreadsheets shall take for texts and not for formulas."""

from __future__ import annotations

MARK = "'"
"""What comes before a text that spreadsheets would calculate, or that begins with it itself."""
CALCULATED = ("=", "+", "-", "@", "\t", "\r", "\n", MARK)


def escaped(cell: object) -> object:
    """A cell for a file; numbers stay as they are."""
    return MARK + cell if isinstance(cell, str) and cell.startswith(CALCULATED) else cell


def unescaped(text: str) -> str:
    """The text that a file has for a cell."""
    return text.removeprefix(MARK)
