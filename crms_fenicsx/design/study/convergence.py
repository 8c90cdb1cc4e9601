"""Error bars by mesh refinement: results on successively finer meshes, and their limits.

Errors fall with the square of the cell size where the mesh resolves the solution. Halving the cells
then leaves a third of the last difference d (L. F. Richardson, 1911). The order of the last two
differences shows whether this holds. The error bar is P. J. Roache's (Perspective: a method for
uniform reporting of grid refinement studies, 1994) with the factors of safety of L. Eca and M.
Hoekstra (A procedure for the estimation of the numerical uncertainty of CFD calculations based on
grid refinement studies, 2014): the error at the observed order, times 1.25 if that is near the
expected order, else times 3. As differences may be consistent, or small, by chance, values without
an order, or that changed direction, get three times the largest error of all differences, each
reduced to the finest level with order 2. `docs/benchmarks/cable_accuracy.md` tells how often bars
contain known limits.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.other_states import SCATTER_CHECK
from crms_fenicsx.design.study.values import Build, Quantities, built
from crms_fenicsx.foundation.meshes.cell_division import refine
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import collective
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import DoubtWarning
from crms_fenicsx.model.tolerances import SAME_VALUE
from crms_fenicsx.results.output.figures.plots import draw_convergence
from crms_fenicsx.solver import Solver

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ORDER = 2.0
REGULAR = (1.2, 3.0)
"""Observed orders at which the levels are taken to converge with order 2."""
NEAR, SAFE, SAFER = 0.3, 1.25, 3.0
"""Distance from order 2 up to which the first of the two safety factors applies."""
FAR = 0.3
"""Relative difference above which the first level is too coarse."""

SCATTER = 3.0
"""Error bar of scattered values relative to their range: with it, a fourth value of a normal
distribution lies in the bar about one of three with 95 %."""


@dataclass(frozen=True)
class Quantity:
    """A number on several meshes and its limit.

    Attributes
    ----------
    values
        Values from the coarsest mesh to the finest.
    limit, bar
        Value extrapolated to fine meshes, and its error bar: it held the exact value in 19 of 20
        cases with a known limit.
    order
        Order of convergence on the last three levels; NaN without one.
    regular
        Whether the bar relies on the order; else it is as wide as the levels scatter.
    remark
        Remark for the table.
    size
        Scale of the number, such as the length of the vector that it is a component of.
    """

    values: tuple[float, ...]
    limit: float
    bar: float
    order: float
    regular: bool
    remark: str
    size: float

    @property
    def error(self) -> float:
        """Bound of the error on the first mesh."""
        return abs(self.values[0] - self.limit) + self.bar


def extrapolated(values: Sequence[float], size: float = 0.0, scattered: bool = False) -> Quantity:
    """Extrapolate values on two or more levels, each with half the previous cell size; `scattered`:
    of states that may be one of several equilibria."""

    def found(limit: float, bar: float, order: float, regular: bool, remark: str) -> Quantity:
        whole = max(size, abs(limit))
        return Quantity(tuple(values), limit, bar, order, regular, remark, whole)

    differences = [b - a for a, b in pairwise(values)]
    d, finest, scale = differences[-1], values[-1], max(size, *map(abs, values))
    least = SAME_VALUE * scale
    if max(map(abs, differences)) <= least:
        return found(finest, least, math.nan, True, "the same on all levels")
    limit = finest + d / (2**ORDER - 1)
    if len(differences) == 1:
        return found(limit, abs(d), math.nan, False, "two levels show no order: 2 assumed")
    errors = [abs(x) / (2**ORDER - 1) / 2 ** (k * ORDER) for k, x in enumerate(differences[::-1])]
    widest, before = max(SAFER * max(errors), least), differences[-2]
    if scattered and (before * d <= 0.0 or abs(d) >= abs(before)):
        widest = max(widest, SCATTER * (max(values) - min(values)))
        remark = "no order: mostly wrinkled, with several equilibria"
        return found(finest, widest, math.nan, False, remark)
    if before * d <= 0.0:
        remark = "no order: the levels oscillate"
        return found(finest, widest, math.nan, False, remark)
    order, remark = math.log2(before / d), ""
    if order <= 0.0:
        remark, widest = "no order: differences grow", max(widest, abs(d) + abs(before))
    elif order < REGULAR[0]:
        remark = "low order"
    elif order > REGULAR[1]:
        remark = "order too high: the coarsest is too coarse"
    elif abs(before) > FAR * scale:
        remark = "the coarsest is too coarse"
    elif any(a * b < 0.0 for a, b in pairwise(differences)):
        remark = "no order: coarser levels oscillate"
    if remark:
        return found(limit, widest, order, False, remark)
    error = abs(d) / (2 ** min(order, ORDER) - 1)
    bar = (SAFE if abs(order - ORDER) < NEAR else SAFER) * error
    return found(limit, max(bar, least), order, True, "")


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
            digits = 8
            if one.bar > 0.0 and one.limit != 0.0:  # to a tenth of the bar
                digits = min(max(math.ceil(math.log10(abs(one.limit) / one.bar)) + 2, 4), 10)
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


@collective
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
    >>> cap = meshes.spherical_cap(MPI.COMM_WORLD, 20.0, 10.0, size=4.0)
    >>> found = study.convergence(build, cap)
    >>> found["tension ridge"].limit, found["tension ridge"].bar
    """
    comm, levels = mesh.comm, checks.whole("convergence: levels", levels, 2)
    rows, cells, seconds, scattered = [], [], [], False
    for level in range(levels):
        began = time.perf_counter()
        mesh = refine(mesh, project=project) if level else mesh
        with warnings.catch_warnings():
            if level < levels - 1:  # coarse meshes are made to tell what they leave uncertain
                warnings.simplefilter("ignore", DoubtWarning)
            solver = built("convergence", build, mesh)
        if level == 0:
            wanted = Quantities(solver.scene, points, reactions, stresses, quantities)
        rows.append(wanted.of(solver))
        verification = solver.steps[-1].verification if solver.steps else None
        if verification is not None:  # so wrinkled that other equilibria were looked for
            scattered |= any(check.name == SCATTER_CHECK for check in verification.checks)
        cells.append(mesh.mesh.topology.index_map(2).size_global)
        seconds.append(comm.bcast(time.perf_counter() - began))
    found = {
        name: extrapolated([row[name][0] for row in rows], rows[-1][name][1], scattered)
        for name in rows[0]
    }
    return Convergence(tuple(cells), tuple(seconds), found, solver, comm)
