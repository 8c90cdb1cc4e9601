"""Check which page the search of the built site ranks first, in an offline browser.

    ./run docs --quick && python3 docs/check_search.py

It requires Chromium or Chrome; the variable CRMS_BROWSER may name it.
"""

from __future__ import annotations

import html
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

SITE = Path(__file__).resolve().parents[1] / "build" / "docs"
FIRST = {
    "abaqus": "state_of_the_field",
    "boundary condition": "how_to/supports",
    "buckling": "how_to/bars",
    "checkpoint": "how_to/restart",
    "cite": "index",
    "conda": "how_to/dolfinx",
    "contributing": "contributing",
    "cutting pattern": "how_to/patterns",
    "did not converge": "how_to/not_converged",
    "docker": "how_to/dolfinx",
    "dynamic": "not_there",
    "edge cable": "how_to/edges",
    "erection": "how_to/erection",
    "error": "how_to/error",
    "eurocode": "how_to/codes",
    "export dxf": "how_to/files",
    "find_form": "api/form_finding",
    "friction": "theory/friction",
    "geodesic": "how_to/nets",
    "glossary": "glossary",
    "gmsh": "how_to/mesh",
    "install": "start",
    "jupyter": "how_to/pictures",
    "kratos": "benchmarks/time_against_error",
    "lay_cable": "api/scene",
    "licence": "index",
    "load combination": "how_to/loads",
    "macos": "start",
    "mast": "how_to/bars",
    "mpi": "how_to/parallel",
    "orthotropic": "how_to/fabric",
    "paraview": "how_to/pictures",
    "ponding": "how_to/rain",
    "prestress": "how_to/form_finding",
    "reactions": "how_to/results",
    "references": "bibliography",
    "report": "how_to/results",
    "rhino": "how_to/files",
    "ridge cable": "how_to/tents",
    "sag": "how_to/tents",
    "section force": "how_to/results",
    "snow": "how_to/codes",
    "supports": "how_to/supports",
    "units": "start",
    "utilization": "how_to/results",
    "validation": "benchmarks/validation",
    "warp": "how_to/fabric",
    "wind load": "how_to/loads",
    "windows": "start",
    "wrinkling": "theory/membrane",
    "young's modulus": "how_to/fabric",
}
"""What engineers search for, and the page that should come first."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SCRIPT = """
const found = {};
for (const words of WORDS) {
    history.replaceState(null, "", "?q=" + encodeURIComponent(words));  // where scorer.js looks
    const results = Search._performSearch(...Search._parseQuery(words));
    found[words] = results.reverse().map((result) => result[0]);
}
document.body.textContent = JSON.stringify(found);
"""


def found(browser: str) -> dict[str, list[str]]:
    """Pages that the search finds for each of the words, best first."""
    page = (SITE / "search.html").read_text()
    scripts = re.findall(r'<script[^>]* src="(?!https?:|_static/scripts)[^"]+"></script>', page)
    script = SCRIPT.replace("WORDS", json.dumps(list(FIRST)))
    own = SITE / "check_search.html"
    own.write_text(
        f'<html data-content_root="./"><body><p id="search-progress"></p>{"".join(scripts)}'
        f"<script>{script}</script></body></html>"
    )
    call = [browser, "--headless", "--no-sandbox", "--host-resolver-rules=MAP * ~NOTFOUND",
            "--virtual-time-budget=10000", "--dump-dom", own.as_uri()]  # fmt: skip
    try:
        shown = subprocess.run(call, capture_output=True, text=True, timeout=60, check=True).stdout
    finally:
        own.unlink()
    body = re.search(r"<body[^>]*>(.*?)</body>", shown, re.DOTALL)
    answer: dict[str, list[str]] = json.loads(html.unescape(body[1])) if body else {}
    return answer


def main() -> None:
    """Search for all words, and fail if another page ranks first for more than a tenth of them."""
    browser = os.environ.get("CRMS_BROWSER") or next(filter(shutil.which, BROWSERS), None)
    if browser is None:
        sys.exit("There is no Chromium or Chrome; name a browser in CRMS_BROWSER.")
    pages = found(browser)
    right = 0
    for words, page in FIRST.items():
        few = list(dict.fromkeys(pages[words]))[:3]
        right += few[:1] == [page]
        print(f"{'ok   ' if few[:1] == [page] else 'WRONG'} {words}: {', '.join(few) or 'nothing'}")
    print(f"{right} of {len(FIRST)} searches have the right page first")
    sys.exit(right < 0.9 * len(FIRST))


if __name__ == "__main__":
    main()
