"""The figure of the sweeps: how each point ended, and how near it came to what is allowed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure
from pictures import save

from sweeps.judge import Row

LOOKS = {
    "converged": ("#0072b2", "o"),
    "refused": ("#777777", "s"),
    "REFUSED": ("#e69f00", "D"),
    "WRONG": ("#d55e00", "X"),
    "HANG": ("#cc79a7", "P"),
}
LEAST, BESIDE = 1e-8, 1e-3
"""Smallest share that is drawn, with smaller ones; share above which the text is to the left."""


def draw(path: Path, rows: Sequence[Row]) -> None:
    """Draw the drift of each point relative to the allowed one, and its evaluations."""
    figure = Figure(figsize=(9.2, 1.2 + 0.21 * len(rows)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    for verdict, (colour, marker) in LOOKS.items():
        own = [(k, row) for k, row in enumerate(rows) if row.verdict == verdict]
        if not own:
            continue
        places = [k for k, _ in own]
        label = f"{verdict}: {len(own)}"
        left.plot([share(r) for _, r in own], places, marker, color=colour, label=label)
        right.plot([max(r.evaluations, 1) for _, r in own], places, marker, color=colour)
    for k, row in enumerate(rows):
        right_of = share(row) < BESIDE
        left.annotate(
            row.of, (share(row), k), xytext=(7 if right_of else -7, 0), fontsize=6.5,
            textcoords="offset points", ha="left" if right_of else "right", va="center",
            color="0.35",
        )  # fmt: skip
    left.axvline(1.0, color="0.2", linewidth=1.2)
    left.set_xlim(LEAST / 2, 10.0)
    left.set_xlabel("drift / allowed drift of what is written beside the point")
    right.set_xlabel("evaluations")
    left.set_yticks(range(len(rows)), [f"{row.sweep}: {row.label}" for row in rows], fontsize=7)
    left.set_ylim(len(rows) - 0.5, -0.5)
    for axis in (left, right):
        axis.set_xscale("log")
        axis.grid(True, color="0.92", zorder=0)
        axis.tick_params(axis="x", labelsize=8)
    figure.legend(loc="outside upper right", ncols=len(LOOKS), frameon=False, fontsize=8)
    save(figure, path)


def share(row: Row) -> float:
    """Drift relative to the allowed one; NaN where nothing should stay constant."""
    if not row.of:
        return float("nan")
    return max(row.drift / row.allowed if row.allowed > 0.0 else row.drift, LEAST)
