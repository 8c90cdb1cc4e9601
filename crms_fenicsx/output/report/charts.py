"""Charts of a report: bars from least to largest values, drawn as SVG in the page itself."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from crms_fenicsx.output.report.tables import number

WIDTH, LEFT, RIGHT, ROW, TOP = 760, 190, 140, 24, 26
"""Sizes in units of the drawing: whole width, margins, height of a row, room above."""
MOST_BARS = 40
"""More bars than these say nothing at a glance."""


def bars(caption: str, rows: Sequence[tuple[str, float, float]], limit: float | None = None) -> str:
    """A figure with a bar for each row; "" for more than `MOST_BARS` or for nothing but zeros."""
    most = max([high for _, _, high in rows] + ([limit] if limit is not None else []), default=0.0)
    if not 0 < len(rows) <= MOST_BARS or most <= 0.0:
        return ""
    scale = (WIDTH - LEFT - RIGHT) / most
    height, ranges = TOP + ROW * len(rows) + 8, any(low > 0.0 for _, low, _ in rows)
    parts = [f'<line class="axis" x1="{LEFT}" y1="{TOP - 4}" x2="{LEFT}" y2="{height - 4}"/>']
    for k, (name, low, high) in enumerate(rows):
        y = TOP + ROW * k
        bad = ' class="over"' if limit is not None and high > limit else ""
        start, end = LEFT + scale * low, LEFT + scale * high
        text = f"{number(low)} to {number(high)}" if ranges else number(high)
        parts.append(
            f'<text x="{LEFT - 8}" y="{y + 13}" text-anchor="end">{escape(name)}</text>'
            f'<rect{bad} x="{start:.1f}" y="{y + 3}" width="{max(end - start, 1.5):.1f}" '
            f'height="{ROW - 10}"/><text x="{end + 6:.1f}" y="{y + 13}">{text}</text>'
        )
    if limit is not None:
        x = LEFT + scale * limit
        parts.append(
            f'<line class="limit" x1="{x:.1f}" y1="{TOP - 6}" x2="{x:.1f}" y2="{height - 4}"/>'
            f'<text x="{x:.1f}" y="{TOP - 11}" text-anchor="middle">{number(limit)}</text>'
        )
    words = "; ".join(f"{name}: {number(low)} to {number(high)}" for name, low, high in rows)
    return (
        f'<figure class="chart"><svg viewBox="0 0 {WIDTH} {height}" role="img" '
        f'aria-label="{escape(f"{caption}. {words}")}">{"".join(parts)}</svg>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
