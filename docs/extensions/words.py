"""Words of `docs/words.txt` in the index, of which the search knows."""

from __future__ import annotations

from pathlib import Path

from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform
from sphinx.util import logging

FILE = Path(__file__).parents[1] / "words.txt"


def words() -> dict[str, list[str]]:
    """The words of each page."""
    found: dict[str, list[str]] = {}
    for line in FILE.read_text().splitlines():
        if line.endswith(":"):
            page = line.rstrip(":")
            found[page] = []
        elif not line.startswith("#"):
            found[page] += [word.strip() for word in line.split(",") if word.strip()]
    return found


class Index(SphinxTransform):
    """Puts a page's words into the index."""

    default_priority = 300

    def apply(self, **kwargs: object) -> None:
        """Add a node that shows nothing."""
        self.env.note_dependency(str(FILE))
        entries = [("single", word, "", "main", None) for word in words().get(self.env.docname, ())]
        self.document.insert(0, addnodes.index(entries=entries))


def _check(app: Sphinx, env: object) -> None:
    """Warn of pages that are gone."""
    for page in sorted(words().keys() - app.env.found_docs):
        logging.getLogger(__name__).warning("words.txt: there is no page %s", page)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension."""
    app.add_transform(Index)
    app.connect("env-updated", _check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
