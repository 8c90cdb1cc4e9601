"""The figure of a case: errors of its two quantities over the run time, log-log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from accuracy.cases import Case
from accuracy.methods import METHODS
from accuracy.report import Row, references

LOOKS = {
    "default": ("#0b5394", "o"),
    "newton": ("#e69138", "s"),
    "blmvm": ("#6a329f", "^"),
    "scipy": ("#999999", "v"),
    "step": ("#38761d", "D"),
    "kratos": ("#cc0000", "P"),
}


def order(seconds: Sequence[float], errors: Sequence[float]) -> float:
    """Fitted exponent of the error in the time."""
    return float(-np.polyfit(np.log(seconds), np.log(errors), 1)[0])


def draw(path: Path, case: Case, rows: Sequence[Row]) -> None:
    """Draw a panel for each of the two quantities.

    Numbers at the points are meshes n, of the step-wise laws load steps. Grey is what the
    reference does not know. A cross is a run that did not converge, at the error of the last energy
    that it came to; where that is not known it is at the top.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True)
    for k, (axis, quantity) in enumerate(zip(axes, case.quantities, strict=True)):
        labels = {}
        for method in dict.fromkeys(r.method for r in rows):
            own = [r for r in rows if r.method == method]
            error = {id(r): (r.first_error, r.second_error)[k] for r in own}
            done = [r for r in own if r.converged and error[id(r)] > 0]
            lost = [r for r in own if not r.converged and np.isfinite(r.seconds)]
            colour, marker = LOOKS[method]
            label = METHODS[method].title
            x, y = [r.seconds for r in done], [error[id(r)] for r in done]
            known = references(case, method)[k]
            clear = [r for r in done if error[id(r)] > 3 * known.bar / abs(known.value)]
            if len(clear) > 2 and not METHODS[method].stepwise:
                fit = order([r.seconds for r in clear], [error[id(r)] for r in clear])
                label += f": order {fit:.1f}"
            axis.plot(x, y, marker + "-", color=colour, label=label, markersize=5, linewidth=1.3,
                      zorder=3 if method == "default" else 2)  # fmt: skip
            for r in done:
                axis.annotate(str(r.steps or r.n), (r.seconds, error[id(r)]), color=colour,
                              xytext=(4, 3), textcoords="offset points", fontsize=6.5)  # fmt: skip
            for r in lost:
                at = error[id(r)] if np.isfinite(error[id(r)]) else np.nan
                labels[method] = (r, at, colour)
        known = references(case, "default")[k]
        axis.set_xscale("log")
        axis.set_yscale("log")
        low, high = axis.get_ylim()
        bar = known.bar / abs(known.value)
        if bar > low / 3:
            axis.axhspan(low / 3, bar, color="0.9", zorder=0)
        for r, at, colour in labels.values():
            place = at if np.isfinite(at) else high
            axis.plot([r.seconds], [place], "x", color=colour, markersize=9, markeredgewidth=2)
            axis.annotate(f"n = {r.n}: not converged", (r.seconds, place), color=colour,
                          xytext=(-6, 4), textcoords="offset points", fontsize=6.5,
                          ha="right")  # fmt: skip
        axis.set_ylim(min(low, axis.get_ylim()[0]), None)
        axis.grid(True, which="major", color="0.88", zorder=0)
        axis.set_xlabel("time [s]")
        axis.set_ylabel(f"relative error of {quantity}")
        axis.legend(fontsize=7.5, framealpha=0.9, loc="best")
    figure.suptitle(case.title, fontsize=11)
    figure.savefig(path, dpi=110)
