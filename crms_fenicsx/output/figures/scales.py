"""From values to colours, or to a few words where all values are the same."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from crms_fenicsx.runtime.arrays import Array

if TYPE_CHECKING:
    from matplotlib.cm import ScalarMappable

NO_VALUE = (0.784, 0.784, 0.784)
_SAME = 1e-3
"""Relative: a colour bar over less would show differences that its ticks cannot tell."""


def common_value(values: Array) -> float | None:
    """Return the value that all share to three digits; None where they differ or none is finite."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0 or np.ptp(finite) > _SAME * np.abs(finite).max():
        return None
    return float(finite.mean())


def in_words(label: str, value: float) -> str:
    """Return a label with its value; a unit in brackets at the label's end follows the value."""
    found = re.fullmatch(r"(.*?)\s*\[(.*)\]", label)
    name, unit = found.groups() if found else (label, "")
    return " ".join(part for part in (name, f"{value:.4g}", unit) if part)


def limits_of(values: Array) -> tuple[float, float]:
    """Return the ends of the values' colours: their own, or from 0 if that is not far away."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    if 0.0 < low < 0.5 * high:
        low = 0.0
    elif 0.5 * low < high < 0.0:
        high = 0.0
    if low == high:
        margin = 0.05 * abs(low) or 1.0
        low, high = low - margin, high + margin
    return low, high


def colouring(
    values: Array | None, label: str, limits: tuple[float, float] | None, colours: str
) -> tuple[ScalarMappable | None, str]:
    """Return the map from values to colours, or else what a legend says of their common value."""
    if values is None:
        return None, ""
    same = common_value(values) if limits is None else None
    if same is not None:
        return None, in_words(label, same)
    return _mappable(colours, values, limits), ""


def _mappable(colours: str, values: Array, limits: tuple[float, float] | None) -> ScalarMappable:
    """Return matplotlib's map from values to a named scale of colours, NaN in grey."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize

    # a little white leaves room for the shade, which dark colours would swallow
    shades = 0.86 * colormaps[colours](np.linspace(0.0, 1.0, 256))[:, :3] + 0.14
    colormap = ListedColormap(shades)
    colormap.set_bad(NO_VALUE)
    return ScalarMappable(Normalize(*(limits_of(values) if limits is None else limits)), colormap)
