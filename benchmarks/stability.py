"""Parameter sweeps to numerical extremes: what converges, is refused, or is wrong.

    ./run python benchmarks/stability.py [SWEEP ...] [--quick] [--results FOLDER]

Each sweep takes one parameter of a small scene to its extremes, and checks every state
independently: equilibrium of a newly assembled potential, balance of all external forces and
moments, tensions that fit lengths, cables that only push. Each sweep also has a quantity that by
theory stays constant or changes by a known amount; its drift is printed with the tolerance
(`sweeps/` describes them). A point ends as

converged   with all checks passed;
refused     with an error of the package, where there may be no equilibrium;
REFUSED     the same where an equilibrium exists, or should be found;
WRONG       with a wrong result, or an error that names no remedy;
HANG        after 20 000 evaluations or a minute.

FOLDER (results/stability by default) then holds points.csv, summary.md and the picture points.png.
The exit code is 1 if a point is wrong or hangs. All sweeps take about 15 minutes of one core,
`--quick` one.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import astuple, fields
from pathlib import Path

from sweeps.figure import draw
from sweeps.judge import Row, Sweep, judged
from sweeps.register import SWEEPS

BAD = ("WRONG", "HANG")


def swept(name: str, sweep: Sweep, quick: bool) -> list[Row]:
    """The rows of a sweep, printed as they come."""
    print(f"\n{name}: {(sweep.__doc__ or '').strip()}\n", flush=True)
    head = f"{'':44} {'':9} {'iter.':>6} {'eval.':>6} {'solve':>5} {'half':>4}    drift"
    print(head, flush=True)
    rows = []
    for point in sweep():
        if point.quick or not quick:
            rows.append(judged(name, point))
            print(rows[-1].line(), flush=True)
    return rows


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write all rows."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([field.name for field in fields(Row)])
        writer.writerows(astuple(row) for row in rows)


def summary(rows: Sequence[Row]) -> str:
    """Markdown: how the points of each sweep ended, and their largest drift as part of allowed."""
    verdicts = ("converged", "refused", "REFUSED", "WRONG", "HANG")
    lines = [
        f"| sweep | points | {' | '.join(verdicts)} | most evaluations | drift / allowed | s |",
        "|---" * (len(verdicts) + 5) + "|",
    ]
    for name in dict.fromkeys(row.sweep for row in rows):
        own = [row for row in rows if row.sweep == name]
        counts = [sum(row.verdict == verdict for row in own) for verdict in verdicts]
        shares = [row.drift / row.allowed for row in own if row.allowed > 0.0]
        cells = [
            name, len(own), *(count or "" for count in counts),
            max(row.evaluations for row in own), f"{max(shares, default=0.0):.2g}",
            f"{sum(row.seconds for row in own):.0f}",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Do the sweeps asked for; returns whether something is wrong."""
    parser = argparse.ArgumentParser(description="Stability sweeps: see this file's head.")
    parser.add_argument("sweeps", nargs="*", metavar="SWEEP", help=f"of {', '.join(SWEEPS)}")
    parser.add_argument("--quick", action="store_true", help="one or two points of each sweep")
    parser.add_argument("--results", type=Path, default=Path("results/stability"))
    given = parser.parse_args()
    if set(given.sweeps) - set(SWEEPS):
        parser.error(f"there are no such sweeps: {', '.join(set(given.sweeps) - set(SWEEPS))}")
    given.results.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for name in given.sweeps or list(SWEEPS):
        rows += swept(name, SWEEPS[name], given.quick)
        write_csv(given.results / "points.csv", rows)
    draw(given.results / "points.png", rows)
    text = summary(rows)
    (given.results / "summary.md").write_text(text)
    print(f"\n{text}")
    return int(any(row.verdict in BAD for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
