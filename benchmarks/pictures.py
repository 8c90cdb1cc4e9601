"""Pictures of benchmarks for the pages of the documentation: small files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

COLOURS = 64


def save(figure: Figure, path: Path) -> None:
    """Write a PNG with a palette, a third of the size of one without."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    picture = Image.open(buffer).convert("RGB")
    # the default, "median cut", replaces colours of few pixels
    picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1).save(path, optimize=True)
