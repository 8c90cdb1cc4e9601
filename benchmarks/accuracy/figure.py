"""The figure of a case: errors of its two quantities over the run time, log-log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from accuracy.cases import Case
from accuracy.methods import METHODS
from accuracy.references import Reference
from accuracy.report import Row, references

LOOKS = {
    "default": ("#0b5394", "o"),
    "extrapolated": ("#00a0a0", "*"),
    "newton": ("#e69138", "s"),
    "blmvm": ("#6a329f", "^"),
    "scipy": ("#888888", "v"),
    "step": ("#38761d", "D"),
    "kratos": ("#cc0000", "P"),
}
NOTE = {"fontsize": 6.5, "textcoords": "offset points"}


def draw(path: Path, case: Case, rows: Sequence[Row]) -> None:
    """Draw a panel for each of the two quantities.

    Numbers at the points are meshes n, of the step-wise laws load steps. Grey is what the
    reference does not know. A cross is a run that did not converge, at the error of the last energy
    that it came to, or at the top where that is not known.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 5.4), layout="constrained")
    for k, axis in enumerate(figure.subplots(1, 2, sharex=True)):
        axis.set_xscale("log")
        axis.set_yscale("log")
        for method in dict.fromkeys(r.method for r in rows):
            known = references(case, method)[k]
            runs = [(r, (r.first_error, r.second_error)[k]) for r in rows if r.method == method]
            _curve(axis, method, runs, known)
        known = references(case, "default")[k]
        low, high = axis.get_ylim()
        axis.axhspan(low / 10, known.bar / abs(known.value), color="0.9", zorder=0)
        axis.set_ylim(low, high)
        axis.grid(True, which="major", color="0.88", zorder=0)
        axis.set_xlabel("time [s]")
        axis.set_ylabel(f"relative error of {case.quantities[k]}")
        axis.legend(
            fontsize=8, title="order q: error like time$^{-q}$", title_fontsize=8, ncols=2,
            frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.14),
        )  # fmt: skip
    figure.suptitle(case.title, fontsize=11)
    figure.savefig(path, dpi=110)


def _curve(axis: Any, method: str, runs: Sequence[tuple[Row, float]], known: Reference) -> None:
    """Draw the runs of a method and their errors."""
    colour, marker = LOOKS[method]
    done = [(r.seconds, error, r.steps or r.n) for r, error in runs if r.converged and error > 0]
    label = METHODS[method].title
    clear = [(s, e) for s, e, _ in done if e > 3 * known.bar / abs(known.value)]
    if len(clear) > 2 and not METHODS[method].stepwise:
        slope = np.polyfit(*np.log(np.array(clear).T), 1)[0]
        label += f": q = {-slope:.1f}"
    axis.plot(
        [s for s, _, _ in done], [e for _, e, _ in done], marker + "-", color=colour, label=label,
        markersize=5, linewidth=1.3, zorder=3 if method == "default" else 2,
    )  # fmt: skip
    for seconds, error, number in done:
        axis.annotate(str(number), (seconds, error), xytext=(4, 3), color=colour, **NOTE)
    for r, error in runs:
        if r.converged or not np.isfinite(r.seconds):
            continue
        inside = np.isfinite(error)
        place = (r.seconds, error if inside else 0.97)
        where = axis.transData if inside else axis.get_xaxis_transform()
        number = list(LOOKS).index(method)  # those at one place shall all be seen
        axis.plot(*place, "x", color=colour, markersize=14 - 2 * number, markeredgewidth=2,
                  transform=where)  # fmt: skip
        axis.annotate(f"{r.steps or r.n}: not converged", place, xycoords=where, ha="right",
                      xytext=(-9, 12 - 7 * number), color=colour, **NOTE)  # fmt: skip
