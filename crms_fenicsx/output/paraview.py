"""Time series that ParaView opens: `surface.pvd` and `cables.pvd`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from crms_fenicsx.errors import InputError, raised_together
from crms_fenicsx.output.files import PARTIAL, make_writable, replaced
from crms_fenicsx.output.shapes import Line, Surface

if TYPE_CHECKING:
    import meshio

_OURS = re.compile(rf"(?:{re.escape(PARTIAL)})?(?:surface_\d{{6,}}_\d{{4,}}|cables_\d{{6,}})\.vtu")


class Series:
    """Steps of a surface and of the lines on it, written as the run goes.

    The folder then holds ::

        surface.pvd  cables.pvd         the collections, to be opened in ParaView
        steps/surface_000000_0000.vtu   step, rank: each rank's piece of the surface
        steps/cables_000000.vtu         all lines of a step, from rank 0

    Compressed binary VTK XML, double precision. A collection is replaced, in one go, when the
    step's files are complete, so what it lists can always be read.

    Parameters
    ----------
    folder : str or Path
        Created where it is missing. The first step that is written replaces an older series in
        it; no other file is touched.
    comm : MPI communicator
        Its ranks write together.

    Raises
    ------
    InputError
        On all ranks, when the folder cannot be written.
    """

    def __init__(self, folder: str | Path, comm: MPI.Intracomm) -> None:
        self.folder = Path(folder)
        self.comm = comm
        self.times: list[float] = []
        self._entries: dict[str, list[str]] = {"surface": [], "cables": []}
        with raised_together(comm):
            if comm.rank == 0:
                make_writable(self.folder)

    def write(self, time: float, surface: Surface, lines: Sequence[Line] = ()) -> None:
        """Add a step. Collective.

        Parameters
        ----------
        time : float
            Time or load factor; more than the step's before.
        surface : Surface
            This rank's piece; it may be empty. All pieces have data of the same names.
        lines : sequence of Line
            All lines, on rank 0; those of other ranks are not looked at. Their data become
            arrays with NaN where a line has none; the array "line" counts the lines from 0.

        Raises
        ------
        InputError
            On all ranks: shapes that disagree, times that do not grow, pieces with different
            data, no triangle on any rank, or files that cannot be written.
        """
        import meshio

        with raised_together(self.comm):
            surface = surface.checked()
            lines = [line.checked() for line in lines] if self.comm.rank == 0 else []
            if not np.isfinite(time) or (self.times and time <= self.times[-1]):
                raise InputError(f"time {time} after times {self.times[-3:]}; times must grow")
        sizes = self.comm.allgather(len(surface.triangles))  # type: ignore[arg-type]
        names = self.comm.allgather((sorted(surface.point_data), sorted(surface.cell_data)))
        pieces = [rank for rank, size in enumerate(sizes) if size > 0]
        if not pieces:
            raise InputError(f"no triangle on any rank at time {time}; give the surface")
        for rank in pieces:
            if names[rank] != names[pieces[0]]:
                raise InputError(
                    f"surface data differ: rank {pieces[0]} has {names[pieces[0]]}, rank {rank} "
                    f"has {names[rank]}; give the same names on all ranks"
                )

        step = len(self.times)
        steps = self.folder / "steps"
        if step == 0:
            with raised_together(self.comm):
                if self.comm.rank == 0:
                    self._clear(steps)
        with raised_together(self.comm):
            if self.comm.rank in pieces:
                with replaced(steps / f"surface_{step:06d}_{self.comm.rank:04d}.vtu") as partial:
                    meshio.write(
                        partial,
                        meshio.Mesh(
                            surface.points,
                            [("triangle", surface.triangles)],
                            point_data=dict(surface.point_data),
                            cell_data={name: [data] for name, data in surface.cell_data.items()},
                        ),
                    )
            if lines:
                with replaced(steps / f"cables_{step:06d}.vtu") as partial:
                    meshio.write(partial, _joined(lines))
        with raised_together(self.comm):
            if self.comm.rank == 0:
                self._list("surface", time, [f"surface_{step:06d}_{r:04d}.vtu" for r in pieces])
                if lines:
                    self._list("cables", time, [f"cables_{step:06d}.vtu"])
        self.times.append(float(time))

    def _clear(self, steps: Path) -> None:
        make_writable(steps)
        # the collections first, so that none ever lists a file that is gone
        for collection in self._entries:
            (self.folder / f"{collection}.pvd").unlink(missing_ok=True)
        for path in steps.iterdir():
            if _OURS.fullmatch(path.name):
                path.unlink()

    def _list(self, collection: str, time: float, files: Sequence[str]) -> None:
        entries = self._entries[collection]
        for part, name in enumerate(files):
            entries.append(
                f'    <DataSet timestep="{float(time)!r}" part="{part}" '
                f"file={quoteattr('steps/' + name)}/>\n"
            )
        with replaced(self.folder / f"{collection}.pvd") as partial:
            partial.write_text(
                '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1">\n'
                f"  <Collection>\n{''.join(entries)}  </Collection>\n</VTKFile>\n"
            )


def _joined(lines: Sequence[Line]) -> meshio.Mesh:
    """Return the lines as one meshio mesh of two-point segments."""
    import meshio

    counts = np.array([len(line.points) for line in lines])  # type: ignore[arg-type]
    starts = np.concatenate([[0], np.cumsum(counts)])
    last = np.zeros(starts[-1], dtype=bool)
    last[starts[1:] - 1] = True
    first = np.flatnonzero(~last)
    on_points: dict[str, NDArray[Any]] = {}
    on_segments: dict[str, NDArray[Any]] = {"line": np.repeat(np.arange(len(lines)), counts - 1)}
    for index, line in enumerate(lines):
        for name, values in line.data.items():
            array = np.asarray(values)
            per_point = array.shape == (counts[index],)
            target = on_points if per_point else on_segments
            start = starts[index] if per_point else starts[index] - index
            whole = target.setdefault(
                name, np.full(starts[-1] if per_point else len(first), np.nan)
            )
            whole[start : start + counts[index] - (not per_point)] = array
    return meshio.Mesh(
        np.concatenate([line.points for line in lines]),
        [("line", np.column_stack([first, first + 1]))],
        point_data=on_points,
        cell_data={name: [values] for name, values in on_segments.items()},
    )
