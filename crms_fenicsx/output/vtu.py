"""Meshes in VTK's XML format (.vtu), written by all ranks together into one file.

The numbers follow the XML text as they are in memory ("appended raw"), array by array, each after
its size in bytes. So every rank knows where its rows go as soon as it knows all ranks' counts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.output.shared_file import Part, first_row, write_together
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.errors import InputError

CELL_TYPES = {2: 3, 3: 5}
"""VTK's number of a cell by its corners: line and triangle."""

SECTIONS = ("Points", "Cells", "PointData", "CellData")

SIZE = np.dtype("<u8")
"""Type of the number before each array."""

BEGIN = """<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <UnstructuredGrid>
    <Piece NumberOfPoints="{}" NumberOfCells="{}">
"""
MIDDLE = """    </Piece>
  </UnstructuredGrid>
  <AppendedData encoding="raw">
_"""
END = b"\n  </AppendedData>\n</VTKFile>\n"


class Column(NamedTuple):
    """What an array of the file is: its section, its name, its type and components of a row."""

    section: str
    name: str
    dtype: str
    components: int

    @property
    def on_points(self) -> bool:
        """Whether it has a row for each point, and not for each cell."""
        return self.section in ("Points", "PointData")

    @property
    def row_size(self) -> int:
        """Bytes of a row."""
        return np.dtype(self.dtype).itemsize * self.components

    def tag(self, offset: int) -> str:
        """XML element that says where the array is."""
        dtype = np.dtype(self.dtype)
        kind = {"i": "Int", "u": "UInt", "f": "Float"}[dtype.kind] + str(8 * dtype.itemsize)
        # A row of cells has all corners of one, which VTK counts one by one.
        many = self.components > 1 and self.section != "Cells"
        components = f'NumberOfComponents="{self.components}" ' if many else ""
        return (
            f'        <DataArray type="{kind}" Name={quoteattr(self.name)} {components}'
            f'format="appended" offset="{offset}"/>\n'
        )


def write_vtu(
    path: Path,
    comm: MPI.Intracomm,
    points: Array,
    cells: Integers,
    point_data: Mapping[str, NDArray[Any]],
    cell_data: Mapping[str, NDArray[Any]],
) -> None:
    """Write points, cells and data on them. Collective.

    Shapes and units: points (n, 3) (length), cells (m, 2), point_data, cell_data (m, c).
    """
    corners = cells.shape[1]
    first_point, n_points = first_row(len(points), comm)
    first_cell, n_cells = first_row(len(cells), comm)
    index = "<i4" if max(n_points, corners * n_cells) < 2**31 else "<i8"
    ends = corners * np.arange(first_cell + 1, first_cell + len(cells) + 1)
    own = {
        ("Points", "Points"): points,
        ("Cells", "connectivity"): cells.astype(index),
        ("Cells", "offsets"): ends.astype(index),
        ("Cells", "types"): np.full(len(cells), CELL_TYPES[corners], dtype=np.uint8),
    }
    own |= {("PointData", name): _plain(values) for name, values in point_data.items()}
    own |= {("CellData", name): _plain(values) for name, values in cell_data.items()}
    if not len(points) + len(cells) and n_points + n_cells:
        own = {}
    columns = _agreed([_column(*key, values) for key, values in own.items()], comm)

    rows = [n_points if column.on_points else n_cells for column in columns]
    sizes = [column.row_size * n for column, n in zip(columns, rows, strict=True)]
    offsets = [sum(sizes[:k]) + SIZE.itemsize * k for k in range(len(sizes) + 1)]
    text = BEGIN.format(n_points, n_cells)
    for section in SECTIONS:
        tags = (c.tag(at) for c, at in zip(columns, offsets, strict=False) if c.section == section)
        text += f"      <{section}>\n{''.join(tags)}      </{section}>\n"
    head = (text + MIDDLE).encode()
    starts = [len(head) + offset for offset in offsets]
    parts: list[Part] = []
    if comm.rank == 0:
        parts = [(0, _bytes(head)), (starts[-1], _bytes(END))]
        parts += [(at, np.array([n], dtype=SIZE)) for at, n in zip(starts, sizes, strict=False)]
    for column, start in zip(columns, starts, strict=False):
        if own:
            before = column.row_size * (first_point if column.on_points else first_cell)
            values = own[column.section, column.name]
            parts.append((start + SIZE.itemsize + before, values))
    write_together(path, comm, starts[-1] + len(END), parts)


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Values in a type that VTK has, little endian."""
    dtype = values.dtype
    if dtype.kind == "f" and dtype.itemsize not in (4, 8):
        dtype = np.dtype(np.float64)
    return values.astype(dtype.newbyteorder("<"), copy=False)


def _bytes(text: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(text, dtype=np.uint8)


def _column(section: str, name: str, values: NDArray[Any]) -> Column:
    return Column(section, name, values.dtype.str, int(np.prod(values.shape[1:])))


def _agreed(own: list[Column], comm: MPI.Intracomm) -> list[Column]:
    """The columns of all ranks, of which those without points and cells have none."""
    known = [(rank, part) for rank, part in enumerate(comm.allgather(own)) if part]
    first, columns = known[0]
    for rank, other in known[1:]:
        if sorted(other) != sorted(columns):
            a, b = set(columns), set(other)
            raise InputError(
                f"data differ: rank {first} has {[tuple(c) for c in sorted(a - b)]}, rank {rank} "
                f"has {[tuple(c) for c in sorted(b - a)]} instead; give the same on all ranks"
            )
    return columns
