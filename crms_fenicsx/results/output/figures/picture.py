"""Figures of matplotlib: created, written, shown in notebooks, joined; camera and visibility."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.meshes.triangles import cross_in_plane
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.foundation.runtime.files import make_writable, replaced

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

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
            f"the picture {path} has the suffix {path.suffix!r}; use one of {', '.join(kinds)}."
        )
    make_writable(path.parent)
    return path


def add_lines(axes: Axes, lines: Iterable[ArrayLike], **look: Any) -> None:
    """Draw polylines, (k, 2) each, in one style or a style each."""
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection([np.asarray(line) for line in lines], **look), autolim=False)


def add_polygons(axes: Axes, polygons: Array, **look: Any) -> None:
    """Draw polygons (n, k, 2) in one style or a style each."""
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(polygons, **look), autolim=False)  # type: ignore[arg-type]  # an array is fast


def png_of(figure: Figure, dpi: int, region: Bbox | str = "tight", packing: int = 6) -> bytes:
    """A figure, or a region of it (inches), as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches=region, pad_inches=MARGIN,
                   pil_kwargs={"compress_level": packing})  # fmt: skip
    return buffer.getvalue()


def finished(
    figure: Figure, path: Path | None, dpi: int, region: Bbox | str = "tight"
) -> Figure | None:
    """Write a figure, or a region of it (inches); without a path return it for a notebook."""
    if path is not None:
        with replaced(path) as partial:
            figure.savefig(partial, dpi=dpi, bbox_inches=region, pad_inches=MARGIN)
        return None
    figure._repr_png_ = lambda dpi=100: png_of(figure, dpi, region, 1)  # type: ignore[attr-defined]
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

    Examples
    --------
    >>> output.draw_history(solver.history, "history.png")
    >>> output.draw(solver, "stress.png", colour="stress")
    >>> output.join_pictures("both.png", ["stress.png", "history.png"])
    """
    from matplotlib.image import imread, imsave

    if not pictures:
        raise InputError("no pictures to join; pass at least one.")
    wrong = [str(name) for name in (filename, *pictures) if Path(name).suffix.lower() != ".png"]
    if wrong:
        raise InputError(f"{', '.join(wrong)}: only .png files can be joined.")
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


@dataclass(frozen=True)
class Camera:
    """A viewer looking at a point."""

    # viewer's position in degrees: azimuth counter-clockwise from the x axis, elevation above the
    # horizontal plane; (-90, 90) is the plan with x to the right
    azimuth: float
    elevation: float
    centre: ArrayLike  # (3,) point in the picture's centre (length)
    distance: float = np.inf  # from viewer to centre; infinite: parallel projection

    @property
    def axes(self) -> Array:
        """Unit vectors to the right, upwards and towards the viewer, as rows (3, 3)."""
        a, e = np.radians([self.azimuth, self.elevation])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        return np.array([right, np.cross(towards, right), towards])

    def project(self, points: ArrayLike) -> Array:
        """Projections (..., 3), right, up and towards the viewer; straight lines stay straight."""
        seen = (np.asarray(points, dtype=np.float64) - np.asarray(self.centre)) @ self.axes.T
        return seen / (1.0 - seen[..., 2:] / self.distance)

    def place(self, seen: Array) -> Array:
        """Points (..., 3) of given projections: the inverse of `project`."""
        return seen / (1.0 + seen[..., 2:] / self.distance) @ self.axes + np.asarray(self.centre)


def brightness(camera: Camera, corners: Array) -> tuple[Array, Array]:
    """Diffuse and specular light, 0 to 1, on triangles (m, 3, 3) lit from both sides."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, sizes, out=np.zeros_like(normals), where=sizes > 0) @ camera.axes.T
    normals[normals[:, 2] < 0] *= -1.0
    light = np.array([-0.70, 0.45, 0.56])
    light /= np.linalg.norm(light)
    halfway = light + np.array([0.0, 0.0, 1.0])
    halfway /= np.linalg.norm(halfway)
    return np.clip(normals @ light, 0.0, 1.0), np.clip(normals @ halfway, 0.0, 1.0) ** 24


def visible(samples: Array, corners: Array, tolerance: float) -> Booleans:
    """Whether points (s, 3) are hidden by no triangle of (m, 3, 3), (s,)."""
    seen = np.ones(len(samples), dtype=bool)
    if len(corners) == 0 or len(samples) == 0:
        return seen
    sample, triangle = _candidates(samples, corners)
    a, b, c = (corners[triangle, i] for i in range(3))
    p = samples[sample]
    area = cross_in_plane(b - a, c - a)
    edge_on = np.abs(area) <= 1e-14 * np.ptp(corners[..., :2]) ** 2
    area[edge_on] = np.inf
    v = cross_in_plane(p - a, c - a) / area
    w = cross_in_plane(b - a, p - a) / area
    inside = (v >= 0) & (w >= 0) & (v + w <= 1) & ~edge_on
    nearness = a[:, 2] + v * (b[:, 2] - a[:, 2]) + w * (c[:, 2] - a[:, 2])
    seen[sample[inside & (nearness > p[:, 2] + tolerance)]] = False
    return seen


def _candidates(samples: Array, corners: Array) -> tuple[Integers, Integers]:
    """Pairs (sample, triangle) that share a bin of a grid over the picture."""
    bins = int(np.clip(np.sqrt(len(corners)), 1, 256))
    low = corners[..., :2].min(axis=(0, 1))
    cell = np.maximum(np.ptp(corners[..., :2], axis=(0, 1)), 1e-300) / bins

    def bin_of(xy: Array) -> Integers:
        return np.clip(np.floor((xy - low) / cell), 0, bins - 1).astype(np.int64)

    first, last = bin_of(corners[..., :2].min(axis=1)), bin_of(corners[..., :2].max(axis=1))
    across, upright = (last - first + 1).T
    triangle, k = _offsets_within(across * upright)
    in_bin = (first[triangle, 0] + k % across[triangle]) * bins + (
        first[triangle, 1] + k // across[triangle]
    )
    triangle = triangle[np.argsort(in_bin, kind="stable")]
    starts = np.concatenate([[0], np.cumsum(np.bincount(in_bin, minlength=bins * bins))])

    column, row = bin_of(samples[:, :2]).T
    home = column * bins + row
    sample, k = _offsets_within(starts[home + 1] - starts[home])
    return sample, triangle[starts[home[sample]] + k]


def _offsets_within(counts: Integers) -> tuple[Integers, Integers]:
    """Each index i `counts[i]` times, and a counter 0, 1, ... of the repetitions."""
    index = np.repeat(np.arange(len(counts)), counts)
    return index, np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)


def subdivided(ends: Array, step: float) -> tuple[Array, Integers, Array]:
    """Pieces (s, 2, 3) of segments (k, 2, 3), each up to `step` long in the picture, the segment of
    each piece, and where along it the piece has its middle, 0 to 1, (s,)."""
    lengths = np.linalg.norm(ends[:, 1, :2] - ends[:, 0, :2], axis=1)
    counts = np.maximum(np.ceil(lengths / step), 1).astype(np.int64)
    segment, k = _offsets_within(counts)
    share = np.stack([k, k + 1], axis=1) / counts[segment, None]
    way = ends[segment, 1] - ends[segment, 0]
    pieces = ends[segment, :1] + share[..., None] * way[:, None]
    return pieces, segment, (k + 0.5) / counts[segment]
