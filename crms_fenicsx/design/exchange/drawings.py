"""Read outlines and points from DXF drawings."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError

SURVEY_FOOT = 1200 / 3937
"""US survey foot (m)."""

UNITS = {
    0: 1.0, 1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8,
    9: 2.54e-5, 10: 0.9144, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 21: SURVEY_FOOT,
    22: SURVEY_FOOT / 12, 23: 3 * SURVEY_FOOT, 24: 5280 * SURVEY_FOOT,
}  # fmt: skip
"""Lengths (m) of DXF unit codes ($INSUNITS); 0 is a drawing without a unit."""

CHORD = 1e-3
"""Largest distance of a curve from its chords, relative to the curve's size."""

MEETING = 1e-6
"""Largest distance of ends that are one point, relative to the curve's size."""


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
    not blocks, texts and hatches. Lines of one layer that together enclose an area, with exactly
    two ends at each corner, become one outline. The call is not collective: read on one rank and
    broadcast, or read on all.

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
        The file does not exist, is no DXF or was cut short; coordinates are not finite; the file's
        unit is unknown or from astronomy or optics, or `unit` is not positive.
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
    except ImportError:
        raise ImportError(
            "read_dxf needs ezdxf: install it (pip install ezdxf; Debian: python3-ezdxf)."
        ) from None
    if not file.is_file():
        raise InputError(f"read_dxf: there is no file '{file}' (in {Path.cwd()}); check the path.")
    try:
        # ezdxf would read a file that was cut between two entities, without those that are missing
        if not file.read_bytes().rstrip(b"\0\x1a \r\n\t").endswith(b"EOF"):
            raise ValueError("its last line is not EOF, so it is another file or was cut short")
        document = ezdxf.readfile(file)
        curves, points = _contents(document)
    except Exception as error:  # ezdxf raises whatever a broken file makes its parser meet
        why = str(error) or type(error).__name__
        raise InputError(f"read_dxf: '{file}' cannot be read as DXF: {why}") from None
    if unit is None:
        if document.units not in UNITS:
            raise InputError(
                f"read_dxf: '{file}' has the unit code $INSUNITS = {document.units}, which is not "
                "a unit of drawings of structures; pass unit = its length in m."
            )
        unit = UNITS[document.units]
    return {
        layer: Lines(
            *_contours([unit * line for line in curves.get(layer, [])]),
            unit * np.array(points.get(layer, []), dtype=float).reshape(-1, 3),
        )
        for layer in dict.fromkeys((*curves, *points))
    }


def _contents(document: Any) -> tuple[dict[str, list[Array]], dict[str, list[Any]]]:
    """Lines (n, 3) and points (3,) by layer, in the drawing's unit."""
    from ezdxf import path as paths
    from ezdxf.math import Matrix44

    curves: dict[str, list[Array]] = {}
    points: dict[str, list[Any]] = {}
    for entity in document.modelspace():
        layer, kind = entity.dxf.layer, entity.dxftype()
        if kind in ("HATCH", "MPOLYGON"):
            continue
        if kind == "POINT":
            corners = np.array([tuple(entity.dxf.location)])
        else:
            try:
                curve = paths.make_path(entity)
            except TypeError:  # not a curve
                continue
            corners = np.array([tuple(corner) for corner in curve.control_vertices()])
        if not np.isfinite(corners).all():
            raise ValueError(f"{entity} on the layer '{layer}' has coordinates that are not finite")
        if kind == "POINT":
            points.setdefault(layer, []).append(corners[0])
        elif len(corners) and (size := _size(corners)) > 0:
            # far from the origin, rounding could exceed the distance wanted: chords would not end
            moved = curve.transform(Matrix44.translate(*-corners[0]))
            places = list[Any]()
            for place in moved.flattening(CHORD * size):
                # rounding makes two corners where the arcs of a circle meet
                if not places or place.distance(places[-1]) > MEETING * size:
                    places.append(place)
            line = corners[0] + np.array([tuple(place) for place in places])
            curves.setdefault(layer, []).append(line)
    return curves, points


def _size(corners: Array) -> float:
    """Diagonal of the box around points (n, 3)."""
    return float(np.linalg.norm(np.ptp(corners, axis=0)))


def _contours(lines: list[Array]) -> tuple[list[Array], list[Array]]:
    """Closed lines, also those put together from lines whose ends meet in pairs, and open ones."""
    closed = [
        len(a) > 3 and bool(np.linalg.norm(a[0] - a[-1]) <= MEETING * _size(a)) for a in lines
    ]
    outlines = [line[:-1] for line, is_closed in zip(lines, closed, strict=True) if is_closed]
    lines = [line for line, is_closed in zip(lines, closed, strict=True) if not is_closed]
    if not lines:
        return outlines, []
    ends = np.array([line[k] for line in lines for k in (0, -1)])  # 2 i and 2 i + 1 of line i
    reach = MEETING * np.repeat([_size(line) for line in lines], 2)
    meeting = cKDTree(ends).query_ball_point(ends, reach)
    other = {k: sum(found) - k for k, found in enumerate(meeting) if len(found) == 2}
    left, done = list[int](), set[int]()
    for first in range(0, len(ends), 2):
        chain, here = list[int](), first
        while here >= 0 and here // 2 not in done:
            done.add(here // 2)
            chain.append(here)
            there = other.get(here ^ 1, -1)
            here = there if other.get(there) == here ^ 1 else -1
        parts = [lines[k // 2][:: -1 if k % 2 else 1][:-1] for k in chain]
        if here == first and sum(map(len, parts)) > 2:
            outlines.append(np.concatenate(parts))
        else:
            left += [k // 2 for k in chain]
    return outlines, [lines[i] for i in sorted(left)]
