"""Offline formulas: copy Debian's MathJax into the site's static files."""

from __future__ import annotations

import shutil
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

DEBIAN = Path("/usr/share/javascript/mathjax")
NEEDED = [
    "MathJax.js",
    "config/TeX-AMS_SVG.js",
    "extensions",
    "jax/element/mml",
    "jax/input/TeX",
    "jax/output/SVG",
    "localization/en",
]
"""Files of MathJax 2.7 needed to render TeX formulas as SVG."""


def _choose(app: Sphinx, config: object) -> None:
    """Use MathJax from Debian's package if installed, else from the web, as Sphinx does."""
    if DEBIAN.is_dir():
        app.config.mathjax_path = "mathjax.js"
        app.config.myst_update_mathjax = False
    else:
        message = "There is no %s (Debian: libjs-mathjax): formulas will need a network."
        logging.getLogger(__name__).info(message, DEBIAN)


def _copy(app: Sphinx, error: Exception | None) -> None:
    """Copy the needed files of MathJax, with its licence."""
    if error or app.builder.format != "html" or not DEBIAN.is_dir():
        return
    folder = Path(app.outdir, "_static", "mathjax")
    for name in NEEDED:
        source, target = DEBIAN / name, folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, dirs_exist_ok=True)
        else:
            shutil.copy(source, target)
    text = (
        "MathJax 2.7, https://www.mathjax.org, Apache License 2.0, from Debian's libjs-mathjax.\n"
    )
    (folder / "LICENSE.txt").write_text(text + "https://www.apache.org/licenses/LICENSE-2.0\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("config-inited", _choose, priority=100)
    app.connect("build-finished", _copy)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
