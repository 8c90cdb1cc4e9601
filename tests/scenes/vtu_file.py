"""Reads .vtu files with appended raw data, as far as the package writes them."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass
class VtuFile:
    """A mesh of cells of one kind: points, corners of the cells, data by name."""

    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    cells: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    types: np.ndarray = field(default_factory=lambda: np.empty(0))
    point_data: dict[str, np.ndarray] = field(default_factory=dict)
    cell_data: dict[str, np.ndarray] = field(default_factory=dict)


def read_vtu(path: Path) -> VtuFile:
    """Read a file, and check that its arrays fill it without gaps."""
    text, rest = path.read_bytes().split(b'<AppendedData encoding="raw">\n_', 1)
    root = ElementTree.fromstring(text + b"<AppendedData/></VTKFile>")
    assert (root.attrib["byte_order"], root.attrib["header_type"]) == ("LittleEndian", "UInt64")
    (piece,) = root.iter("Piece")
    n_points, n_cells = (int(piece.attrib[f"NumberOf{what}"]) for what in ("Points", "Cells"))
    found, end = VtuFile(), 0
    arrays: dict[str, dict[str, np.ndarray]] = {section.tag: {} for section in piece}
    for section in piece:
        for tag in section:
            kind, offset = tag.attrib["type"], int(tag.attrib["offset"])
            assert (tag.attrib["format"], offset) == ("appended", end)
            (size,) = np.frombuffer(rest[offset:][:8], dtype="<u8")
            end = offset + 8 + int(size)
            values = np.frombuffer(rest[offset + 8 : end], dtype=kind.lower())
            many = int(tag.attrib.get("NumberOfComponents", 0))
            arrays[section.tag][tag.attrib["Name"]] = values.reshape(-1, many) if many else values
    assert rest[end:] == b"\n  </AppendedData>\n</VTKFile>\n"
    (found.points,) = arrays["Points"].values()
    cells = arrays["Cells"]
    assert len(found.points) == n_points and len(cells["types"]) == n_cells
    corners = int(cells["offsets"][0]) if len(cells["offsets"]) else 1
    np.testing.assert_array_equal(cells["offsets"], corners * np.arange(1, n_cells + 1))
    found.cells, found.types = cells["connectivity"].reshape(n_cells, corners), cells["types"]
    found.point_data, found.cell_data = arrays["PointData"], arrays["CellData"]
    assert all(len(values) == n_points for values in found.point_data.values())
    assert all(len(values) == n_cells for values in found.cell_data.values())
    return found
