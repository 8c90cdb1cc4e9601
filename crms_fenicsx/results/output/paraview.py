"""Time series for ParaView: `surface.pvd` and `cables.pvd` list meshes in VTK XML files (.vtu).

The arrays follow the XML text in binary form ("appended raw"), each after its size in bytes. So
every rank knows its offsets in the file from all ranks' counts.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Integers
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import (
    PARTIAL,
    absolute,
    make_writable,
    read_text,
    replaced,
)
from crms_fenicsx.results.output.shared_file import Part, first_row, write_together
from crms_fenicsx.results.views.view_data import Line, Surface, joined

CELL_TYPES = {2: 3, 3: 5}
"""VTK cell types by number of corners: line and triangle."""

SECTIONS = ("Points", "Cells", "PointData", "CellData")

SIZE = np.dtype("<u8")
"""Type of the size before each array."""

BEGIN = """<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <UnstructuredGrid>
{}    <Piece NumberOfPoints="{}" NumberOfCells="{}">
"""
MIDDLE = """    </Piece>
  </UnstructuredGrid>
  <AppendedData encoding="raw">
_"""
END = b"\n  </AppendedData>\n</VTKFile>\n"


class Column(NamedTuple):
    """An array of the file: its section, name, type and components per row."""

    section: str
    name: str
    dtype: str
    components: int

    @property
    def on_points(self) -> bool:
        """Whether it has a row per point, rather than per cell."""
        return self.section in ("Points", "PointData")

    @property
    def row_size(self) -> int:
        """Bytes per row."""
        return np.dtype(self.dtype).itemsize * self.components

    def tag(self, offset: int) -> str:
        """XML element with the array's offset."""
        dtype = np.dtype(self.dtype)
        kind = {"i": "Int", "u": "UInt", "f": "Float"}[dtype.kind] + str(8 * dtype.itemsize)
        # VTK counts the corners of cells one by one, although a row holds all corners of a cell.
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
    texts: Mapping[str, Sequence[str]] | None = None,
) -> None:
    """Write points (n, 3), cells (m, corners), data on both, and named texts. Collective."""
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
    columns = [
        Column(*key, values.dtype.str, int(np.prod(values.shape[1:])))
        for key, values in own.items()
    ]
    columns = _agreed(columns, comm)

    rows = [n_points if column.on_points else n_cells for column in columns]
    sizes = [column.row_size * n for column, n in zip(columns, rows, strict=True)]
    offsets = [sum(sizes[:k]) + SIZE.itemsize * k for k in range(len(sizes) + 1)]
    text = BEGIN.format(_field_data(texts or {}), n_points, n_cells)
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


def _field_data(texts: Mapping[str, Sequence[str]]) -> str:
    """XML element of texts, which VTK stores as byte values, each text ending in zero."""
    arrays = [
        f'      <DataArray type="String" Name={quoteattr(name)} NumberOfTuples="{len(some)}" '
        f'format="ascii">{" ".join(str(k) for text in some for k in (*text.encode(), 0))}'
        "</DataArray>\n"
        for name, some in texts.items() if some
    ]  # fmt: skip
    return f"    <FieldData>\n{''.join(arrays)}    </FieldData>\n" if arrays else ""


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Values in a type known to VTK, little endian."""
    dtype = values.dtype
    if dtype.kind == "f" and dtype.itemsize not in (4, 8):
        dtype = np.dtype(np.float64)
    return values.astype(dtype.newbyteorder("<"), copy=False)


def _bytes(text: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(text, dtype=np.uint8)


def _agreed(own: list[Column], comm: MPI.Intracomm) -> list[Column]:
    """The columns common to all ranks that have points or cells."""
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


_OURS = re.compile(rf"(?:{re.escape(PARTIAL)})?(?:surface|cables)_\d{{6,}}\.vtu")


class Series:
    """Steps of a surface and its lines, written during the run.

    The folder then holds ::

        surface.pvd  cables.pvd     the collections, to be opened in ParaView
        steps/surface_000000.vtu    the surface of a step, written by all ranks together
        steps/cables_000000.vtu     all lines of a step, from rank 0

    Binary VTK XML, double precision. A collection is replaced at once when the step's files are
    complete, so that all it lists can be read.

    Parameters
    ----------
    folder : str or Path
        Folder, created if missing. The first step replaces an older series in it, and no other
        file.
    comm : MPI communicator
        Ranks that write together.

    Raises
    ------
    InputError
        On all ranks: a folder that cannot be written.
    """

    def __init__(self, folder: str | Path, comm: MPI.Intracomm) -> None:
        self.folder = absolute(folder, comm)
        self.comm = comm
        self.times: list[float] = []
        self._entries: dict[str, list[str]] = {"surface": [], "cables": []}
        self._begun = False
        checks.from_first(comm, lambda: make_writable(self.folder))

    def write(
        self, time: float, surface: Surface, lines: Sequence[Line] = (), case: str = ""
    ) -> None:
        """Add a step. Collective.

        Parameters
        ----------
        time : float
            Time or load factor, larger than in the step before.
        surface : Surface
            This rank's piece, which may be empty, with data of the same names on all ranks. Points
            are written by the ranks they belong to (`Surface.homes`), once.
        lines : sequence of Line
            All lines, on rank 0; those of other ranks are ignored. The file has them joined, with
            their names as texts "names"; without lines it is empty.
        case : str
            Load case of the step, a text in both files.

        Raises
        ------
        InputError
            On all ranks: shapes that disagree, times that do not grow, pieces with different data,
            no triangle on any rank, points without a rank, or files that cannot be written.
        """
        with raised_together(self.comm):
            surface = surface.checked()
            lines = [line.checked() for line in lines] if self.comm.rank == 0 else []
            if not np.isfinite(time) or (self.times and time <= self.times[-1]):
                raise InputError(f"time {time} after times {self.times[-3:]}; times must grow")
        if self.comm.allreduce(len(surface.triangles)) == 0:  # type: ignore[arg-type]
            raise InputError(f"no triangle on any rank at time {time}; give the surface")
        own, rows = self._rows(surface)

        step, steps = len(self.times), self.folder / "steps"
        texts = {"case": [case] if case else []}
        if not self._begun:
            checks.from_first(self.comm, lambda: self._begin(steps))
        self._begun = True
        write_vtu(
            steps / f"surface_{step:06d}.vtu",
            self.comm,
            np.asarray(surface.points)[own],
            rows[np.asarray(surface.triangles)],
            {name: np.asarray(values)[own] for name, values in surface.point_data.items()},
            {name: np.asarray(values) for name, values in surface.cell_data.items()},
            texts,
        )
        with raised_together(self.comm):
            if self.comm.rank == 0:
                # without a new file, ParaView would keep showing the last lines
                some = lines or self._entries["cables"]
                names = {"names": [line.name for line in lines]}
                if some:
                    write_vtu(
                        steps / f"cables_{step:06d}.vtu",
                        MPI.COMM_SELF,
                        *joined(lines),
                        texts | names,
                    )
                self._list("surface", time, f"surface_{step:06d}.vtu")
                if some:
                    self._list("cables", time, f"cables_{step:06d}.vtu")
        self.times.append(float(time))

    def _rows(self, surface: Surface) -> tuple[Integers, Integers]:
        """Indices of the points that this rank writes, and the file row of each of its points."""
        n = len(surface.points)  # type: ignore[arg-type]
        homes = np.stack([np.full(n, self.comm.rank), np.arange(n)], axis=1)
        if surface.homes is not None:
            homes = np.asarray(surface.homes, dtype=np.int64)
        own = np.flatnonzero(homes[:, 0] == self.comm.rank)
        own = own[np.argsort(homes[own, 1])]
        counts = np.array(self.comm.allgather(len(own)))
        with raised_together(self.comm):
            ranks, numbers = homes.T
            lost = (ranks < 0) | (ranks >= len(counts)) | (numbers < 0)
            lost |= numbers >= counts[np.where(lost, 0, ranks)]
            if lost.any() or not np.array_equal(numbers[own], np.arange(len(own))):
                raise InputError(
                    f"homes: rank {self.comm.rank} has points number {numbers[own].tolist()[:9]} "
                    f"of its own and, of others, {homes[lost].tolist()[:3]}, where the ranks have "
                    f"{counts.tolist()}; number each rank's from 0"
                )
        return own, np.concatenate([[0], np.cumsum(counts)])[homes[:, 0]] + homes[:, 1]

    def resume(self, times: Sequence[float]) -> None:
        """Continue the series in the folder. Collective.

        Its later steps stay until the next one is written.

        Parameters
        ----------
        times
            Times of the steps to keep; none are kept if the series does not begin with them.

        Raises
        ------
        InputError
            On all ranks: a series that cannot be read.
        """
        kept = checks.from_first(
            self.comm, lambda: {name: self._listed(name, times) for name in self._entries}
        )
        same = len(kept["surface"]) == len(times)
        self.times = [float(time) for time in times] if same else []
        self._entries = kept if same else {name: [] for name in kept}
        self._begun = False

    def _listed(self, collection: str, times: Sequence[float]) -> list[str]:
        """Entries of a collection's file at given times."""
        path = self.folder / f"{collection}.pvd"
        if not path.exists():
            return []
        try:
            found = [
                (float(tag.attrib["timestep"]), Path(tag.attrib["file"]).name)
                for tag in ElementTree.fromstring(read_text(path)).iter("DataSet")
            ]
        except (OSError, LookupError, ValueError, ElementTree.ParseError) as error:
            raise InputError(f"{path} cannot be read ({error}); give another folder") from None
        return [_entry(time, name) for time, name in found if time in times]

    def _begin(self, steps: Path) -> None:
        """Remove an older series except for the steps to keep."""
        make_writable(steps)
        # collections first, so that none ever lists a removed file
        for collection, entries in self._entries.items():
            if entries:
                self._write(collection, entries)
            else:
                (self.folder / f"{collection}.pvd").unlink(missing_ok=True)
        kept = "".join(entry for entries in self._entries.values() for entry in entries)
        for path in steps.iterdir():
            if _OURS.fullmatch(path.name) and quoteattr(f"steps/{path.name}") not in kept:
                path.unlink()

    def _list(self, collection: str, time: float, name: str) -> None:
        entries = [*self._entries[collection], _entry(time, name)]
        self._write(collection, entries)
        self._entries[collection] = entries

    def _write(self, collection: str, entries: Sequence[str]) -> None:
        with replaced(self.folder / f"{collection}.pvd") as partial:
            partial.write_text(
                '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n'
                f"  <Collection>\n{''.join(entries)}  </Collection>\n"
                "</VTKFile>\n"
            )


def _entry(time: float, name: str) -> str:
    file = quoteattr(f"steps/{name}")
    return f'    <DataSet timestep="{float(time)!r}" part="0" file={file}/>\n'
