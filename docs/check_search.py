"""Check which page the search of the built site ranks first, in an offline browser.

    ./run docs --quick && python3 docs/check_search.py

It requires Chromium or Chrome; the variable CRMS_BROWSER may name it.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import quote

SITE = Path(__file__).resolve().parents[1] / "build" / "docs"
FIRST = {
    "edge cable": "how_to/edges.html",
    "edge cables": "how_to/edges.html",
    "ridge cable": "how_to/tents.html",
    "sag": "how_to/tents.html",
    "warp": "how_to/fabric.html",
    "snow": "how_to/codes.html",
    "report": "how_to/results.html",
    "mast": "how_to/bars.html",
    "error": "how_to/error.html",
    "find_form": "api/form_finding.html",
    "lay_cable": "api/scene.html",
}
BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def found(browser: str, words: str) -> list[str]:
    """Pages that the search finds, best first."""
    url = f"{(SITE / 'search.html').as_uri()}?q={quote(words)}"
    call = [browser, "--headless", "--no-sandbox", "--host-resolver-rules=MAP * ~NOTFOUND",
            "--virtual-time-budget=10000", "--dump-dom", url]  # fmt: skip
    page = subprocess.run(call, capture_output=True, text=True, timeout=60, check=True).stdout
    return re.findall(r'<a href="([^"#?]+\.html)[^"]*" data-score', page)


def main() -> None:
    """Search for all words, and fail if another page ranks first."""
    browser = os.environ.get("CRMS_BROWSER") or next(filter(shutil.which, BROWSERS), None)
    if browser is None:
        sys.exit("There is no Chromium or Chrome; name a browser in CRMS_BROWSER.")
    wrong = 0
    for words, page in FIRST.items():
        first = next(iter(found(browser, words)), "nothing")
        wrong += first != page
        print(f"{'ok ' if first == page else 'WRONG'} {words}: {first}")
    sys.exit(wrong)


if __name__ == "__main__":
    main()
