"""Error bars by mesh refinement: results on successively finer meshes, and their limits."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from crms_fenicsx.meshes.cell_division import refine
from crms_fenicsx.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.output.figures.plots import draw_convergence
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.solver import Solver
from crms_fenicsx.study.build import Build, built, comm_of
from crms_fenicsx.study.values import Quantities, Quantity, extrapolated

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Convergence:
    """Results on successively finer meshes; ``print`` shows the table.

    Attributes
    ----------
    cells
        Number of cells on each level.
    seconds
        Computing time of each level (s).
    quantities
        The compared quantities, by name.
    finest
        Solver of the last level.
    comm
        Communicator of the mesh.
    """

    cells: tuple[int, ...]
    seconds: tuple[float, ...]
    quantities: Mapping[str, Quantity]
    finest: Solver
    comm: MPI.Intracomm

    def __getitem__(self, name: str) -> Quantity:
        """The quantity with a name."""
        return checks.named("quantity", dict(self.quantities), name)

    def table(self) -> str:
        """Table of values on all levels, limits with error bars, orders and remarks."""
        heads = [f"{n} cells" for n in self.cells]
        rows = [["", *heads, "limit", "+-", "order", ""]]
        for name, one in self.quantities.items():
            order = "-" if math.isnan(one.order) else f"{one.order:.2f}"
            digits = _digits(one.limit, one.bar)
            numbers = [f"{value:.{digits}g}" for value in (*one.values, one.limit)]
            rows.append([name, *numbers, f"{one.bar:.2g}", order, one.remark])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = []
        for row in rows:
            cells = [row[0].ljust(widths[0])]
            cells += [text.rjust(width) for text, width in zip(row[1:-1], widths[1:], strict=False)]
            lines.append("  ".join([*cells, row[-1]]).rstrip())
        return "\n".join(lines)

    def __repr__(self) -> str:
        return self.table()

    def draw(
        self,
        filename: str | Path | None = None,
        names: Sequence[str] | None = None,
        *,
        title: str = "",
        width: float = 8.0,
    ) -> Figure | None:
        """Plot the distances from the limits over the cell size. Collective.

        Parameters
        ----------
        filename
            Picture file; its suffix (.png, .pdf, .svg ...) gives the format. None returns the
            figure.
        names
            Names of the quantities; all by default.
        title
            Heading of the picture.
        width
            Width of the picture (inches).

        Returns
        -------
        matplotlib.figure.Figure
            The figure for notebooks, on the first rank and without a file; else None.

        Raises
        ------
        InputError
            On all ranks: a file that cannot be written, or an unknown quantity.
        """
        series = {}
        for name in self.quantities if names is None else names:
            one = self[name]
            series[name] = (one.values, one.limit, one.bar, one.size)
        return draw_convergence(self.comm, filename, self.cells, series, title=title, width=width)


def _digits(limit: float, bar: float) -> int:
    """Number of digits that shows a value to a tenth of its error bar."""
    if bar <= 0.0 or limit == 0.0:
        return 8
    return min(max(math.ceil(math.log10(abs(limit) / bar)) + 2, 4), 10)


def convergence(
    build: Build,
    mesh: MembraneMesh,
    levels: int = 3,
    *,
    points: Mapping[str, Sequence[float]] | None = None,
    reactions: Sequence[str] = (),
    stresses: Sequence[str] = (),
    quantities: Mapping[str, Callable[[Solver], float]] | None = None,
    project: Callable[[Array], Array] | None = None,
) -> Convergence:
    """Extrapolate a roof's results from successively finer meshes, with error bars. Collective.

    Each level is built by the user's function on the previous mesh with each cell divided into
    four, so everything is solved again: form finding, friction with its history, step-wise laws,
    added terms. A level takes about four times as long as the previous one. Two levels give an
    estimate; the third shows whether it is reliable. Energy and cable tensions are always compared.
    The error is that of discretisation, not of the model.

    Parameters
    ----------
    build
        Function of a mesh that makes scene and solver on it, applies the loads and returns the
        solver. A cable's length that follows from the mesh, such as that of one laid just taut,
        then differs between meshes. Give the solver no results folder: all levels would write into
        it.
    mesh
        The coarsest mesh.
    levels
        Number of meshes, including this one.
    points
        Named points (3,) on the stress-free surface whose displacements are compared (length).
    reactions
        Groups of held vertices whose total reactions are compared (force).
    stresses
        Parts of the mesh, or "membrane" for the whole, whose mean and largest true section forces
        are compared (force per length). At re-entrant corners and ends of supports the largest may
        have no limit: its differences grow.
    quantities
        Other quantities: functions of a solver, by name.
    project
        Projection of new vertices, as for `meshes.refine`.

    Returns
    -------
    Convergence
        Results with a table (``print`` it) and a plot.

    Raises
    ------
    InputError
        On all ranks: an invalid `build`, fewer than 2 levels, or an invalid point, group, part or
        function; the last three are checked on the coarsest level.
    ConvergenceError, PathError
        As raised by `build` on one of the meshes.

    Examples
    --------
    >>> def build(mesh):
    ...     scene = Scene(mesh, IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3))
    ...     scene.fix("boundary")
    ...     solver = Solver(scene)
    ...     solver.advance(pressure=0.3)
    ...     scene.lay_cable(Cable(EA=20e3), [(-20.0, 0.0), (20.0, 0.0)], name="ridge")
    ...     solver.advance(pressure=0.5)
    ...     return solver
    >>> study = convergence(build, meshes.spherical_cap(comm, 20.0, 10.0, size=4.0))
    >>> study["tension ridge"].limit, study["tension ridge"].bar
    """
    comm = comm_of("convergence", mesh)
    checks.same(
        comm, "convergence", levels=levels, points=points, reactions=reactions, stresses=stresses,
        quantities=quantities, project=project,
    )  # fmt: skip
    if levels == 1:
        raise InputError("convergence: levels = 1 compares nothing; give 2 or more, best 3.")
    levels = checks.whole("convergence: levels", levels, 2)
    if isinstance(points, Mapping):
        points = checks.in_one_order(comm, points)
    if isinstance(quantities, Mapping):
        quantities = checks.in_one_order(comm, quantities)
    rows, cells, seconds = [], [], []
    for level in range(levels):
        began = time.perf_counter()
        mesh = refine(mesh, project=project) if level else mesh
        solver = built("convergence", build, mesh)
        if level == 0:
            wanted = Quantities.checked(solver.scene, points, reactions, stresses, quantities)
        rows.append(wanted.of(solver))
        cells.append(mesh.mesh.topology.index_map(2).size_global)
        seconds.append(comm.bcast(time.perf_counter() - began))
    found = {
        name: extrapolated([row[name][0] for row in rows], rows[-1][name][1]) for name in rows[0]
    }
    return Convergence(tuple(cells), tuple(seconds), found, solver, comm)
