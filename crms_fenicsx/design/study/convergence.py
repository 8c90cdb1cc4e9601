"""Error bars by mesh refinement: results on successively finer meshes, and their limits."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.other_states import SCATTER_CHECK
from crms_fenicsx.analysis.steps.load_step import Step
from crms_fenicsx.design.study.build import Build, built, comm_of
from crms_fenicsx.design.study.values import Quantities, Quantity, extrapolated
from crms_fenicsx.foundation.meshes.cell_division import refine
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import DoubtWarning, InputError
from crms_fenicsx.results.output.figures.plots import draw_convergence
from crms_fenicsx.solver import Solver

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Convergence:
    """Results on finer and finer meshes; ``print`` shows the table.

    Attributes
    ----------
    cells
        Number of cells of each level.
    seconds
        Wall time of each level.
    quantities
        Compared numbers, by names.
    finest
        Solver of the last level.
    comm
        Ranks of the mesh.
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
        """Values of all levels, limits with bars, orders and remarks, as text."""
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
        """Plot differences from the limits over the size of cells. Collective.

        Parameters
        ----------
        filename
            Picture to write, in the format of its suffix (.png, .pdf, .svg ...); None returns it.
        names
            Quantities; all by default.
        title
            Title of the picture.
        width
            Width in inches.

        Returns
        -------
        matplotlib.figure.Figure
            On the first rank, without a file, for notebooks; else None.

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


def _may_scatter(step: Step) -> bool:
    """Whether the membrane was so wrinkled that other equilibria were looked for."""
    checks = () if step.verification is None else step.verification.checks
    return any(check.name == SCATTER_CHECK for check in checks)


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
    """Solve a roof on finer and finer meshes; limits of its results, with error bars. Collective.

    The user's function builds and solves each level anew, on the mesh of the level before with each
    cell divided into four, including form finding, the history of friction, step-wise laws and
    added terms. A level takes about four times as long as the one before. Two levels give an
    estimate, a third shows whether to trust it. Energy and tensions are always compared. The bars
    are for the error of the mesh, not of the model.

    Parameters
    ----------
    build
        Function of a mesh that makes scene and solver, applies the loads, and returns the solver.
        Cables laid just taut get their lengths from each mesh. Give the solver no folder for
        results, as all levels would write into it.
    mesh
        The coarsest mesh.
    levels
        Number of meshes, this one included.
    points
        Stress-free places (3,), by names, for displacements (length).
    reactions
        Groups of held vertices, for total reactions (force).
    stresses
        Parts of the mesh, or "membrane" for all of it, for the mean and the largest true section
        force (force per length). The largest one may have no limit at re-entrant corners and ends
        of supports; the table then says that differences grow.
    quantities
        Functions of a solver that return further numbers, by names.
    project
        Projection of new vertices, as for `meshes.refine`.

    Returns
    -------
    Convergence
        The results, with a table (``print``) and a plot.

    Raises
    ------
    InputError
        On all ranks: no such function, fewer than 2 levels, or an invalid point, group, part or
        function; the last three after the coarsest level.
    ConvergenceError, PathError
        From `build` on one of the meshes.

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
    rows, cells, seconds, scattered = [], [], [], False
    for level in range(levels):
        began = time.perf_counter()
        mesh = refine(mesh, project=project) if level else mesh
        with warnings.catch_warnings():
            if level < levels - 1:  # coarse meshes are made to tell what they leave uncertain
                warnings.simplefilter("ignore", DoubtWarning)
            solver = built("convergence", build, mesh)
        if level == 0:
            wanted = Quantities.checked(solver.scene, points, reactions, stresses, quantities)
        rows.append(wanted.of(solver))
        scattered |= bool(solver.steps) and _may_scatter(solver.steps[-1])
        cells.append(mesh.mesh.topology.index_map(2).size_global)
        seconds.append(comm.bcast(time.perf_counter() - began))
    found = {
        name: extrapolated([row[name][0] for row in rows], rows[-1][name][1], scattered)
        for name in rows[0]
    }
    return Convergence(tuple(cells), tuple(seconds), found, solver, comm)
