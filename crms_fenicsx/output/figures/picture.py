"""Figures of matplotlib that are written to files, or returned to be shown in a notebook."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.runtime.files import make_writable, replaced

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

SHOWN_DPI = 100
"""Pixels per inch in a notebook."""
MARGIN = 0.1
"""White around a picture, in inches."""


def new_figure(width: float, height: float) -> Figure:
    """Return a white figure of a size in inches, without pyplot and its global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def given_file(call: str, filename: object) -> Path | None:
    """Return the path of a picture, or None for none; raise `InputError` if it is no path."""
    return None if filename is None else checks.file(f"{call}: filename", filename)


def checked_picture(filename: str | Path | None) -> Path | None:
    """As `checked_filename`; None for a picture that is returned."""
    return None if filename is None else checked_filename(filename)


def checked_filename(filename: str | Path) -> Path:
    """Return the path of a picture that can be written, or raise `InputError`."""
    path = Path(filename)
    kinds = new_figure(1.0, 1.0).canvas.get_supported_filetypes()
    if path.suffix[1:].lower() not in kinds:
        raise InputError(
            f"the picture {path} has the suffix {path.suffix!r}; use one of {', '.join(kinds)}"
        )
    make_writable(path.parent)
    return path


def finished(
    figure: Figure, path: Path | None, dpi: int, region: Bbox | str = "tight"
) -> Figure | None:
    """Write a figure, or a region of it in inches, in place of a picture that was there.

    Without a path the figure is returned, which then shows itself in a notebook, in the same
    region; without pyplot nothing else would show it.
    """
    if path is not None:
        with replaced(path) as partial:
            figure.savefig(partial, dpi=dpi, bbox_inches=region, pad_inches=MARGIN)
        return None

    def png() -> bytes:
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=SHOWN_DPI, bbox_inches=region, pad_inches=MARGIN)
        return buffer.getvalue()

    figure._repr_png_ = png  # type: ignore[attr-defined]
    return figure
