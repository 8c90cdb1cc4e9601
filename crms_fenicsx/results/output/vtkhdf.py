"""States of a structure in one VTKHDF file, one step per combination.

The file is an unstructured grid: surface triangles, then segments of cables and bars. The arrays of
all steps are concatenated; the group Steps holds their offsets (VTKHDF 2.2).
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.steps.load_cases import (
    Combination,
    HasStates,
    back_to_now,
    checked_states,
)
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.errors import InputError, collective, raised_together
from crms_fenicsx.foundation.runtime.files import absolute, make_writable, replaced
from crms_fenicsx.results.membrane_results import membrane_results
from crms_fenicsx.results.quantities import fields_of
from crms_fenicsx.results.views.view_data import (
    Line,
    Surface,
    bar_lines,
    cable_lines,
    joined,
    surface_piece,
    whole_surface,
)

TRIANGLE, SEGMENT = 5, 3
"""VTK cell types."""

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Grid:
    """A step: surface and lines as one grid."""

    name: str  # of the combination
    geometry: Arrays  # "Points", "Connectivity", "Offsets" and "Types"
    on_points: Arrays
    on_cells: Arrays
    lines: list[str]  # line names


class Solved(HasStates, Protocol):
    """Protocol of `Solver`, which is in a higher layer."""

    comm: MPI.Intracomm

    @property
    def system(self) -> System:
        """The scene's potential."""


@collective
def write_vtkhdf(
    solver: Solved, filename: str | Path, combinations: Mapping[str, Combination] | None = None
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
    >>> write_vtkhdf(solver, "results/roof.vtkhdf", solver.combine({"snow": {"snow": 1.5}}))
    """
    comm, scene = solver.comm, solver.scene
    states = checked_states("write_vtkhdf", scene, combinations)
    checks.same(comm, "write_vtkhdf", filename=filename)
    path = absolute(checks.file("write_vtkhdf: filename", filename), comm)
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
            results = membrane_results(solver.system)
            piece = surface_piece(scene.membrane, results.surface, fields_of(results))
            whole = whole_surface(comm, piece)
            lines = [*cable_lines(scene.net), *bar_lines(scene.bars)]
            if whole is not None:
                grids.append(_grid(name, whole, lines))
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
            "write_vtkhdf needs h5py: install it (pip install h5py; Debian: python3-h5py)."
        ) from None
    return h5py


def _grid(name: str, surface: Surface, lines: list[Line]) -> Grid:
    points, pairs, on_points, on_segments = joined([line.checked() for line in lines])
    triangles, n = np.asarray(surface.triangles), len(np.asarray(surface.points))
    counts = np.repeat([3, 2], [len(triangles), len(pairs)])
    geometry: Arrays = {
        "Points": np.concatenate([np.asarray(surface.points), points]),
        "Connectivity": np.concatenate([triangles.ravel(), (pairs + n).ravel()]).astype(np.int64),
        "Offsets": np.concatenate([[0], np.cumsum(counts)]),
        "Types": np.where(counts == 3, TRIANGLE, SEGMENT).astype(np.uint8),
    }
    own = {**surface.cell_data, "line": np.full(len(triangles), -1)}
    return Grid(
        name, geometry, _together(surface.point_data, on_points, n, len(points)),
        _together(own, on_segments, len(triangles), len(pairs)), [line.name for line in lines],
    )  # fmt: skip


def _together(first: Mapping[str, Any], second: Mapping[str, Any], n: int, m: int) -> Arrays:
    """Data of two meshes with n and m rows concatenated, NaN where undefined."""
    found: Arrays = {}
    for name in dict.fromkeys((*first, *second)):
        lacking = np.shape(first[name] if name in first else second[name])[1:]
        found[name] = np.concatenate([
            np.asarray(data[name]) if name in data else np.full((rows, *lacking), np.nan)
            for data, rows in ((first, n), (second, m))
        ])  # fmt: skip
    return found


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
    for kind, data, rows in (
        ("Point", [grid.on_points for grid in grids], root["NumberOfPoints"][:]),
        ("Cell", [grid.on_cells for grid in grids], root["NumberOfCells"][:]),
    ):
        for name, like in {key: one[key] for one in data for key in one}.items():
            lacking = like.shape[1:]
            root[f"{kind}Data/{name}"] = np.concatenate([
                one[name] if name in one else np.full((n, *lacking), np.nan)
                for one, n in zip(data, rows, strict=True)
            ])  # fmt: skip
            steps[f"{kind}DataOffsets/{name}"] = starts[kind]
    _write_texts(root, "case", [[grid.name] if grid.name else [] for grid in grids])
    _write_texts(root, "names", [grid.lines for grid in grids])


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
