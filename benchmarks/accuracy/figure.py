"""The figure of a case: errors of its two quantities over the run time, log-log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from pictures import save

from accuracy.cases import Case
from accuracy.methods import METHODS
from accuracy.references import Reference
from accuracy.report import LEVELS, Row, references

NAMES = {
    "W": "the energy", "w": "the height", "V": "the volume", "T": "the tension",
    "z": "the cable's height", "y": "the cable's place",
}  # fmt: skip
"""What the quantities are called."""

LOOKS = {
    "default": ("#0072b2", "o", "-"),
    "extrapolated": ("#56b4e9", "*", "-"),
    "newton": ("#e69f00", "s", "--"),
    "blmvm": ("#cc79a7", "^", "-."),
    "scipy": ("#777777", "v", ":"),
    "step": ("#009e73", "D", ":"),
    "kratos": ("#d55e00", "P", "--"),
}
"""Colours that differ for the colour-blind, too, markers and lines."""


def draw(path: Path, case: Case, rows: Sequence[Row]) -> None:
    """Draw a panel for each of the two quantities.

    Numbers at the default's points are meshes n. Grey is what the reference does not know. A cross
    is a run that did not converge, at its time and the error of the method's last mesh.
    """
    figure = Figure(figsize=(8.6, 3.6), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True)
    for k, axis in enumerate(axes):
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.margins(x=0.1)
        for method in dict.fromkeys(r.method for r in rows):
            known = references(case, method)[k]
            runs = [(r, (r.first_error, r.second_error)[k]) for r in rows if r.method == method]
            _curve(axis, method, runs, known, labelled=k == 0)
        known = references(case, "default")[k]
        low, high = axis.get_ylim()
        axis.axhspan(low / 10, known.bar / abs(known.value), color="0.9", zorder=0)
        for level in LEVELS:
            axis.axhline(level, color="0.6", linewidth=0.7, linestyle=(0, (1, 2)), zorder=1)
        axis.set_ylim(low, high)
        for scale, (least, most), text in (
            (axis.xaxis, axis.get_xlim(), lambda value, _: f"{value:g}"),
            (axis.yaxis, (low, high), lambda value, _: f"{100 * value:g} %"),
        ):
            scale.set_major_locator(
                LogLocator(subs=(1.0, 2.0, 5.0) if most < 20 * least else (1.0,))
            )
            scale.set_major_formatter(text)
            scale.set_minor_formatter(NullFormatter())
        axis.grid(True, which="major", color="0.92", zorder=0)
        axis.set_xlabel("processor time [s]")
        axis.set_ylabel(f"error of {NAMES[case.quantities[k]]}")
    figure.legend(
        loc="outside right center", frameon=False, fontsize=8,
        title="q: error like time$^{-q}$", title_fontsize=8,
    )  # fmt: skip
    figure.suptitle(case.title, fontsize=10)
    save(figure, path)


def _curve(
    axis: Any, method: str, runs: Sequence[tuple[Row, float]], known: Reference, labelled: bool
) -> None:
    """Draw the runs of a method and their errors."""
    colour, marker, line = LOOKS[method]
    done = [(r.seconds, error, r.n) for r, error in runs if r.converged and error > 0]
    label = METHODS[method].title
    clear = [(s, e) for s, e, _ in done if e > 3 * known.bar / abs(known.value)]
    if len(clear) > 2 and not METHODS[method].stepwise:
        slope = np.polyfit(*np.log(np.array(clear).T), 1)[0]
        label += f": q = {-slope:.1f}"
    axis.plot(
        [s for s, _, _ in done], [e for _, e, _ in done], marker + line, color=colour,
        label=label if labelled else None, markersize=5, linewidth=1.4,
        zorder=4 if method == "default" else 3,
    )  # fmt: skip
    for seconds, error, number in done if method == "default" else []:
        axis.annotate(str(number), (seconds, error), xytext=(-4, -4), color=colour, fontsize=7,
                      textcoords="offset points", ha="right", va="top")  # fmt: skip
    for r, _ in runs:
        if not r.converged and np.isfinite(r.seconds) and done:
            place = (r.seconds, done[-1][1])
            axis.plot(*place, "x", color=colour, markersize=8, markeredgewidth=2, zorder=5)
            axis.plot([done[-1][0], r.seconds], [done[-1][1]] * 2, ":", color=colour, linewidth=1)
