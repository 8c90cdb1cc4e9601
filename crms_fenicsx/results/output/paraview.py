"""Files for ParaView: a series of VTK XML files (.vtu), and combinations in one VTKHDF file.

Both have unstructured grids, which the first rank writes. In a .vtu file the arrays follow the XML
text in binary form ("appended raw"), each after its size in bytes. In a VTKHDF file the arrays of
all steps are concatenated; the group Steps holds their offsets (VTKHDF 2.2).
"""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.analysis.steps.load_cases import (
    Combination,
    back_to_now,
    checked_states,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import File, PerRank, collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, raised_together
from crms_fenicsx.foundation.runtime.files import (
    PARTIAL,
    absolute,
    make_writable,
    read_text,
    replaced,
)
from crms_fenicsx.results.quantities import Solved
from crms_fenicsx.results.view_data import Line, Surface, current_view, joined, whole_surface

Arrays = dict[str, NDArray[Any]]
Texts = dict[str, list[str]]

BEGIN = """<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <UnstructuredGrid>
{}    <Piece NumberOfPoints="{}" NumberOfCells="{}">
{}    </Piece>
  </UnstructuredGrid>
  <AppendedData encoding="raw">
_"""
END = b"\n  </AppendedData>\n</VTKFile>\n"


@dataclass(frozen=True)
class Grid:
    """Surface and lines of a step as one grid: triangles, then segments."""

    geometry: Arrays  # "Points", "Connectivity", "Offsets" and "Types"
    on_points: Arrays
    on_cells: Arrays
    texts: Texts  # by name, one or more each


def _grid_of(surface: Surface | None, lines: Sequence[Line] | None, texts: Texts) -> Grid:
    """A surface, lines, or both as a grid. In a grid of both, data that one of them does not have
    are NaN there, and "line" is -1 on the surface."""
    points = list[Array]()
    cells, data = list[NDArray[Any]](), list[tuple[Arrays, Arrays]]()
    if surface is not None:
        points.append(np.asarray(surface.points))
        cells.append(np.asarray(surface.triangles))
        on_points, on_cells = (
            {name: np.asarray(values) for name, values in found.items()}
            for found in (surface.point_data, surface.cell_data)
        )
        if lines is not None:
            on_cells["line"] = np.full(len(cells[0]), -1)
        data.append((on_points, on_cells))
    if lines is not None:
        places, pairs, *on_lines = joined(lines)
        cells.append(pairs + sum(map(len, points)))
        points.append(places)
        data.append((on_lines[0], on_lines[1]))
        texts = {**texts, "names": [line.name for line in lines]}
    corners = np.repeat([x.shape[1] for x in cells], [len(x) for x in cells])
    geometry: Arrays = {
        "Points": np.concatenate(points),
        "Connectivity": np.concatenate([x.ravel() for x in cells]).astype(np.int64),
        "Offsets": np.concatenate([[0], np.cumsum(corners)]),
        "Types": np.where(corners == 3, 5, 3).astype(np.uint8),  # VTK's triangle and line
    }
    on_points, on_cells = (
        _concatenated([one[k] for one in data], [len(x) for x in rows])
        for k, rows in ((0, points), (1, cells))
    )
    return Grid(geometry, on_points, on_cells, {name: some for name, some in texts.items() if some})


def _concatenated(parts: Sequence[Arrays], rows: Sequence[int]) -> Arrays:
    """Data of parts with some rows each, by name, NaN where a part does not have them."""
    like = {name: np.asarray(values) for part in reversed(parts) for name, values in part.items()}
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: np.concatenate([
            part[name] if name in part else np.full((n, *like[name].shape[1:]), np.nan)
            for part, n in zip(parts, rows, strict=True)
        ])
        for name in names
    }  # fmt: skip


def _write_vtu(path: Path, grid: Grid) -> None:
    """Write a grid to a .vtu file."""
    geometry = grid.geometry
    wide = max(len(geometry["Points"]), len(geometry["Connectivity"])) >= 2**31
    sections: dict[str, Arrays] = {
        "Points": {"Points": geometry["Points"]},
        "Cells": {
            "connectivity": geometry["Connectivity"].astype("<i8" if wide else "<i4"),
            "offsets": geometry["Offsets"][1:].astype("<i8" if wide else "<i4"),
            "types": geometry["Types"],
        },
        "PointData": grid.on_points,
        "CellData": grid.on_cells,
    }
    tags, offset = "", 0
    for section, arrays in sections.items():
        tags += f"      <{section}>\n"
        for name, values in arrays.items():
            arrays[name] = values = _plain(values)
            kind = {"i": "Int", "u": "UInt", "f": "Float"}[values.dtype.kind]
            many = int(np.prod(values.shape[1:]))
            components = f'NumberOfComponents="{many}" ' if many > 1 else ""
            tags += (
                f'        <DataArray type="{kind}{8 * values.itemsize}" Name={quoteattr(name)} '
                f'{components}format="appended" offset="{offset}"/>\n'
            )
            offset += 8 + values.nbytes  # the size itself takes eight
        tags += f"      </{section}>\n"
    cells = len(geometry["Types"])
    head = BEGIN.format(_field_data(grid.texts), len(geometry["Points"]), cells, tags)
    with replaced(path) as partial, open(partial, "wb") as file:
        file.write(head.encode())
        for values in (x for arrays in sections.values() for x in arrays.values()):
            file.write(np.array([values.nbytes], dtype="<u8").tobytes() + values.tobytes())
        file.write(END)


def _field_data(texts: Texts) -> str:
    """XML element of texts, which VTK stores as byte values, each text ending in zero."""
    arrays = [
        f'      <DataArray type="String" Name={quoteattr(name)} NumberOfTuples="{len(some)}" '
        f'format="ascii">{" ".join(str(k) for text in some for k in (*text.encode(), 0))}'
        "</DataArray>\n"
        for name, some in texts.items()
    ]
    return f"    <FieldData>\n{''.join(arrays)}    </FieldData>\n" if arrays else ""


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """Values in a type known to VTK, little endian."""
    dtype = values.dtype
    if dtype.kind == "f" and dtype.itemsize not in (4, 8):
        dtype = np.dtype(np.float64)
    return values.astype(dtype.newbyteorder("<"), copy=False)


_OURS = re.compile(rf"(?:{re.escape(PARTIAL)})?(?:surface|cables)_\d{{6,}}\.vtu")


class Series:
    """Steps of a surface and its lines, written during the run.

    The folder then holds ::

        surface.pvd  cables.pvd     the collections, to be opened in ParaView
        steps/surface_000000.vtu    the surface of a step
        steps/cables_000000.vtu     all lines of a step

    Binary VTK XML, double precision. A collection is replaced at once when the step's files are
    complete, so that all it lists can be read.

    Parameters
    ----------
    folder : str or Path
        Folder, created if missing. The first step replaces an older series in it, and no other
        file.
    comm : MPI communicator
        Ranks with pieces of the surface; the first one writes.

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
            are taken from the ranks they belong to (`Surface.homes`), once.
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
                raise InputError(f"time {time} after times {self.times[-3:]}; times must grow.")
        if self.comm.allreduce(len(np.asarray(surface.triangles))) == 0:
            raise InputError(f"no triangle on any rank at time {time}; pass the surface.")
        whole = whole_surface(self.comm, surface)
        with raised_together(self.comm):
            if whole is not None:
                self._write_step(time, whole, lines, {"case": [case] if case else []})
        self._begun = True
        self.times.append(float(time))

    def _write_step(
        self, time: float, surface: Surface, lines: Sequence[Line], texts: Texts
    ) -> None:
        """Write the files of a step, then list them."""
        if not self._begun:
            self._begin()
        name, grids = f"_{len(self.times):06d}.vtu", {"surface": _grid_of(surface, None, texts)}
        # without a new file, ParaView would keep showing the last lines
        if lines or self._entries["cables"]:
            grids["cables"] = _grid_of(None, lines, texts)
        for kind, grid in grids.items():
            _write_vtu(self.folder / "steps" / f"{kind}{name}", grid)
        for kind in grids:
            entries = [*self._entries[kind], _entry(time, f"{kind}{name}")]
            self._write(kind, entries)
            self._entries[kind] = entries

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
            raise InputError(f"{path} cannot be read ({error}); use another folder.") from None
        return [_entry(time, name) for time, name in found if time in times]

    def _begin(self) -> None:
        """Remove an older series except for the steps to keep."""
        steps = self.folder / "steps"
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


@collective
def write_vtkhdf(
    solver: Solved,
    filename: File,
    combinations: PerRank[Mapping[str, Combination] | None] = None,
) -> None:
    """Write combinations, or the current state, as a VTKHDF file for ParaView. Collective.

    Each combination is a step with the surface, cables and bars and the arrays of
    `Solver.to_pyvista`, NaN on cells that do not have them. "line" is -1 on the surface, else the
    number of the cable or bar; texts of a step are "case", the name of the combination, and
    "names" of cables and bars in the order of "line".

    Parameters
    ----------
    solver
        Solver of the scene, whose state is restored.
    filename
        File ending in .vtkhdf; an existing one is replaced once the new one is complete.
    combinations
        Combinations from `Solver.combine`; by default the current state alone.

    Raises
    ------
    InputError
        On all ranks, with nothing written: another suffix, no combinations of this solver, or a
        file that cannot be written.
    ImportError
        On all ranks: h5py is not installed.

    Examples
    --------
    >>> cases = solver.combine({"snow": {"snow": 1.5}})
    >>> output.write_vtkhdf(solver, "roof.vtkhdf", cases)
    """
    comm, scene = solver.comm, solver.scene
    states = checked_states("write_vtkhdf", scene, combinations)
    path = absolute(filename, comm)
    checks.one_of("write_vtkhdf: the suffix", path.suffix.lower(), (".vtkhdf",))
    with raised_together(comm):
        if comm.rank == 0:
            _h5py()
            make_writable(path.parent)
            if path.is_dir():
                raise InputError(f"write_vtkhdf: {path} is a folder; name a file in it.")
    grids = list[Grid]()
    with back_to_now(solver):
        for name in states or [""]:
            if states:
                solver.restore(states[name].snapshot)
            piece, lines = current_view(solver.system)
            whole = whole_surface(comm, piece)
            if whole is not None:
                grids.append(_grid_of(whole, lines, {"case": [name] if name else []}))
    with raised_together(comm):
        if grids:
            # in memory at first: HDF5 ends the process if the disk is full while it closes a file
            content = io.BytesIO()
            with _h5py().File(content, "w") as file:
                _write(file.create_group("VTKHDF"), grids)
            with replaced(path) as partial:
                partial.write_bytes(content.getvalue())


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise ImportError(
            "write_vtkhdf needs h5py; install it (pip install h5py; Debian: python3-h5py)."
        ) from None
    return h5py


def _write(root: Any, grids: Sequence[Grid]) -> None:
    """Write the steps into the file's group."""
    root.attrs["Version"] = np.array([2, 2], dtype=np.int64)
    root.attrs["Type"] = np.bytes_("UnstructuredGrid")
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(len(grids))
    steps["Values"] = np.arange(1.0, len(grids) + 1.0)
    steps["PartOffsets"], steps["NumberOfParts"] = np.arange(len(grids)), np.ones(len(grids), int)
    starts = {}
    for of, kind, array in (
        ("Points", "Point", "Points"), ("Cells", "Cell", "Types"),
        ("ConnectivityIds", "ConnectivityId", "Connectivity"),
    ):  # fmt: skip
        counts = np.array([len(grid.geometry[array]) for grid in grids])
        root[f"NumberOf{of}"] = counts
        starts[kind] = np.cumsum(counts) - counts
        steps[f"{kind}Offsets"] = starts[kind] if kind == "Point" else starts[kind][:, None]
    for name in grids[0].geometry:
        root[name] = np.concatenate([grid.geometry[name] for grid in grids])
    for kind, data in (
        ("Point", [grid.on_points for grid in grids]), ("Cell", [grid.on_cells for grid in grids]),
    ):  # fmt: skip
        for name, values in _concatenated(data, root[f"NumberOf{kind}s"][:].tolist()).items():
            root[f"{kind}Data/{name}"] = values
            steps[f"{kind}DataOffsets/{name}"] = starts[kind]
    for name in ("case", "names"):
        _write_texts(root, name, [grid.texts.get(name, []) for grid in grids])


def _write_texts(root: Any, name: str, of_steps: Sequence[Sequence[str]]) -> None:
    """Write texts of each step as field data."""
    counts = np.array([len(some) for some in of_steps])
    if counts.any():
        texts = [text.encode() for some in of_steps for text in some]
        # VTK accepts only strings marked ASCII, but reads them as UTF-8
        kind = _h5py().string_dtype("ascii")
        root.create_dataset(f"FieldData/{name}", data=texts, dtype=kind)
        root[f"Steps/FieldDataOffsets/{name}"] = np.cumsum(counts) - counts
        root[f"Steps/FieldDataSizes/{name}"] = np.column_stack([np.ones_like(counts), counts])
