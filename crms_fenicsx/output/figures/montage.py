"""Pictures side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crms_fenicsx.output.figures.picture import checked_filename
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.runtime.files import replaced


def join_pictures(
    filename: str | Path, pictures: Sequence[str | Path], *, upright: bool = False
) -> None:
    """Put pictures side by side into one. Not collective.

    Parameters
    ----------
    filename : str or Path
        PNG file to write.
    pictures : sequence of str or Path
        PNG files, from left to right; smaller ones get a white margin at the right and below.
    upright : bool
        One below the other instead.

    Raises
    ------
    InputError
        Without pictures, for one that cannot be read, or a file that cannot be written.
    """
    from matplotlib.image import imread, imsave

    if not pictures:
        raise InputError("no pictures to join; give at least one")
    wrong = [str(name) for name in (filename, *pictures) if Path(name).suffix.lower() != ".png"]
    if wrong:
        raise InputError(f"{', '.join(wrong)}: only .png files can be joined")
    try:
        images = [imread(picture)[..., :3] for picture in pictures]
    except (OSError, SyntaxError) as error:  # the latter is what a damaged file gives
        raise InputError(f"a picture to join cannot be read: {error}") from None
    path = checked_filename(filename)
    across = 0 if upright else 1
    size = np.max([image.shape for image in images], axis=0)
    padded = []
    for image in images:
        missing = size - image.shape
        missing[across] = 0
        padded.append(np.pad(image, [(0, m) for m in missing], constant_values=1.0))
    with replaced(path) as partial:
        imsave(partial, np.concatenate(padded, axis=across), pil_kwargs={"optimize": True})
