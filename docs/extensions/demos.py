"""Links to demos lead to their tutorials on the site, and to the scripts on Git hosts."""

from __future__ import annotations

import re

from sphinx.application import Sphinx


def _lead(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the demos in the links of a page."""
    source[0] = re.sub(r"\]\((?:\.\./)+demos/(\w+)\.py\)", r"](/tutorials/\1.rst)", source[0])
    source[0] = re.sub(
        r"\]\((?:\.\./)+demos(/README\.rst|/?)\)", "](/tutorials/index.rst)", source[0]
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.connect("source-read", _lead)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
