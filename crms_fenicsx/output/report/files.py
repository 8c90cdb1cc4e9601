"""The files of a report: a page, and tables beside it."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from crms_fenicsx.output.report.contents import Report
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.runtime.files import make_writable, replaced


def check_path(path: Path) -> None:
    """Refuse a path that no report can be written to; not collective."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"report: filename = {str(path)!r} is no page; give one with .html.")
    if path.is_dir():
        raise InputError(f"report: {path} is a folder; give the name of a file in it.")
    make_writable(path.parent)


def write(path: Path, report: Report) -> list[Path]:
    """Write a report's page and its tables; not collective.

    All of them are complete before the first takes the place of one that is there. Returns the
    files.
    """
    texts = {path: report.html()}
    for table in report.tables():
        texts[path.with_name(f"{path.stem}_{table.name}.csv")] = table.csv()
    with ExitStack() as files:
        for file, text in texts.items():
            files.enter_context(replaced(file)).write_text(text, encoding="utf-8")
    return list(texts)
