"""Printing of a report to PDF by a headless browser."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from crms_fenicsx.foundation.runtime.errors import InputError

BROWSERS = (
    "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome",
    "microsoft-edge", "msedge",
)  # fmt: skip
"""Browsers, in the order of search."""
PATIENCE = 120
"""Time limit of the browser (seconds)."""


def browser() -> str:
    """Path of the browser: from the variable CRMS_BROWSER, or the first one found."""
    own = os.environ.get("CRMS_BROWSER")
    names = [own] if own else BROWSERS
    found = next((path for name in names if (path := shutil.which(name))), "")
    if not found:
        raise InputError(
            f"report: pdf=True needs a browser that prints, and there is no {own or BROWSERS[0]}; "
            "install one (apt install chromium) or name one in the variable CRMS_BROWSER. Without "
            "pdf=True open the page in any browser, and print it to a file on A4."
        )
    return found


def print_page(html: str, path: Path) -> None:
    """Print an HTML page to PDF on A4."""
    with tempfile.TemporaryDirectory() as folder:
        page, pdf = Path(folder) / "page.html", Path(folder) / "page.pdf"
        page.write_text(html, encoding="utf-8")
        command = [
            browser(), "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer",
            f"--user-data-dir={folder}/profile", f"--print-to-pdf={pdf}", page.as_uri(),
        ]  # fmt: skip
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
            trouble = done.stderr.strip().splitlines()[-1:] if done.returncode else []
        except subprocess.TimeoutExpired:
            trouble = [f"it took more than {PATIENCE} s"]
        if not pdf.exists():
            raise InputError(f"report: {command[0]} printed no PDF; {''.join(trouble)}")
        path.write_bytes(pdf.read_bytes())
