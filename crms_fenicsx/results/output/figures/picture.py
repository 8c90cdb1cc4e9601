"""Figures of matplotlib: created, joined, written to files or shown in notebooks."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.runtime.files import make_writable, replaced

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

SHOWN_DPI = 100
"""Pixels per inch in notebooks."""
MARGIN = 0.1
"""White margin around a picture (inches)."""


def new_figure(width: float, height: float) -> Figure:
    """A white figure of a size in inches, without pyplot's global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def checked_picture(filename: str | Path | None) -> Path | None:
    """Checked path of a picture; None for None."""
    if filename is None:
        return None
    path = checks.file("the picture's filename", filename)
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
    """Write a figure, or a region of it (inches); without a path return it for a notebook."""
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


def join_pictures(
    filename: str | Path, pictures: Sequence[str | Path], *, upright: bool = False
) -> None:
    """Join pictures side by side. Not collective.

    Parameters
    ----------
    filename : str or Path
        PNG file to write.
    pictures : sequence of str or Path
        PNG files, from left to right; smaller ones are padded with white at the right and below.
    upright : bool
        Whether to put them one below the other instead.

    Raises
    ------
    InputError
        No pictures, one that cannot be read, or a file that cannot be written.
    """
    from matplotlib.image import imread, imsave

    if not pictures:
        raise InputError("no pictures to join; give at least one")
    wrong = [str(name) for name in (filename, *pictures) if Path(name).suffix.lower() != ".png"]
    if wrong:
        raise InputError(f"{', '.join(wrong)}: only .png files can be joined")
    try:
        images = [imread(picture)[..., :3] for picture in pictures]
    except (OSError, SyntaxError) as error:  # SyntaxError: a damaged file
        raise InputError(f"a picture to join cannot be read: {error}") from None
    path = checked_picture(filename)
    assert path is not None
    across = 0 if upright else 1
    size = np.max([image.shape for image in images], axis=0)
    padded = []
    for image in images:
        missing = size - image.shape
        missing[across] = 0
        padded.append(np.pad(image, [(0, m) for m in missing], constant_values=1.0))
    with replaced(path) as partial:
        imsave(partial, np.concatenate(padded, axis=across), pil_kwargs={"optimize": True})
