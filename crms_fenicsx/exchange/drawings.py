"""Read outlines and points from DXF drawings."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError

UNITS = {1: 0.0254, 2: 0.3048, 4: 1e-3, 5: 1e-2, 6: 1.0}
"""Lengths (m) of DXF unit codes."""

CHORD = 1e-3
"""Largest distance of a curve from its chords, relative to the drawing's size."""


@dataclass(frozen=True)
class Lines:
    """Contents of a drawing's layer.

    Attributes
    ----------
    outlines
        Closed lines, (n, 3) each (length), without repeating the first corner.
    lines
        Open lines, (n, 3) each (length).
    points
        Points, (n, 3) (length).
    """

    outlines: list[Array] = field(default_factory=list)
    lines: list[Array] = field(default_factory=list)
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))


def read_dxf(path: str | Path, *, unit: float | None = None) -> dict[str, Lines]:
    """Read outlines, lines and points of a DXF drawing, by layer.

    Lines, polylines, circles, arcs, ellipses, splines and points of the model space are read, but
    not blocks, texts and hatches. The call is not collective: read on one rank and broadcast, or
    read on all.

    Parameters
    ----------
    path
        The file. Requires ezdxf.
    unit
        Length of the drawing's unit; by default in m, from the file's unit, or 1 if the file names
        none.

    Returns
    -------
    dict
        `Lines` by layer name.

    Raises
    ------
    InputError
        The file does not exist or is no DXF, or the unit is not positive.
    ImportError
        ezdxf is missing.

    Examples
    --------
    >>> outline = read_dxf("site.dxf")["ROOF"].outlines[0]
    >>> mesh = meshes.polygon(MPI.COMM_WORLD, outline[:, :2], size=0.5)
    """
    file = checks.file("read_dxf: path", path)
    if unit is not None:
        checks.positive("read_dxf: unit", unit)
    try:
        import ezdxf
        from ezdxf import path as paths
    except ImportError:
        raise ImportError(
            "read_dxf needs ezdxf: install it (pip install ezdxf; Debian: python3-ezdxf)."
        ) from None
    if not file.is_file():
        raise InputError(f"read_dxf: there is no file '{file}' (in {Path.cwd()}); check the path.")
    try:
        document = ezdxf.readfile(file)
    except (OSError, ezdxf.DXFError, UnicodeError, ValueError) as error:
        raise InputError(f"read_dxf: '{file}' cannot be read as DXF: {error}") from None
    scale = UNITS.get(int(document.units), 1.0) if unit is None else unit
    found: dict[str, Lines] = {}
    points: dict[str, list[Any]] = {}
    curves = []
    for entity in document.modelspace():
        if entity.dxftype() == "POINT":
            points.setdefault(entity.dxf.layer, []).append(tuple(entity.dxf.location))
            continue
        try:
            curves.append((entity.dxf.layer, paths.make_path(entity)))
        except TypeError:  # not a curve
            continue
    ends = [tuple(one.start) for _, one in curves] + [tuple(one.end) for _, one in curves]
    size = float(np.linalg.norm(np.ptp(np.array(ends), axis=0))) if ends else 0.0
    for layer, curve in curves:
        steps = curve.flattening(CHORD * (size or 1.0))
        line = scale * np.array([tuple(place) for place in steps])
        if len(line) < 2:
            continue
        of_layer = found.setdefault(layer, Lines())
        if len(line) > 3 and np.linalg.norm(line[0] - line[-1]) <= 1e-9 * np.abs(line).max():
            of_layer.outlines.append(line[:-1])
        else:
            of_layer.lines.append(line)
    for layer, places in points.items():
        known = found.get(layer, Lines())
        found[layer] = Lines(known.outlines, known.lines, scale * np.array(places, dtype=float))
    return found
