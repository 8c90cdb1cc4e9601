"""The search for a form: updates of the reference, then Newton's method."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from crms_fenicsx.form_finding.cables import EdgeLine
from crms_fenicsx.form_finding.film import SOFTEST, STIFFEST, Film
from crms_fenicsx.form_finding.inflation import Inflation
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.runtime.arrays import Array, Booleans
from crms_fenicsx.runtime.errors import ConvergenceError, as_text
from crms_fenicsx.runtime.progress import progress

TOLERANCE = 1e-12
"""Unbalanced force, relative to the forces in the cells, and error of what is prescribed."""
UPDATES, MOST = 3, 200
"""Updates of the reference before Newton's method is tried, and most iterations of either."""
QUICK, FALLEN, FALLING = 0.3, 0.5, 0.9
"""Largest part of the residual that an iteration of Newton's method leaves: of that of the film
alone, while vertices need not be held; of that with the elasticity that holds them, to be any good;
of the film's where a stiffer elasticity damps it."""
THINNEST = 1e-3
"""Smallest area of a cell over the square of its longest side, relative to the start mesh."""

WORKSPACE = 100
"""How much more memory MUMPS takes than it estimates, in per cent."""
STRAIGHT, JUMP = 1e-12, 5.0
"""Relative size of what is zero in the equations of the cables, and largest factor by which a
tension changes in an iteration."""


Unbalanced = tuple[Array, Array, float]
"""Unbalanced forces, (n, 3), errors of the equations of tensions and pressure, and the largest of
both relative to their size."""


class FormSearch:
    """Moves a film and its cables to equilibrium.

    The unknown tensions and the pressure are found with the shape: each has an equation, and a
    column of forces. The linear systems with them are solved by block elimination.

    Parameters
    ----------
    membrane
        The start mesh with its supports.
    film, lines, inflation
        What bears forces.
    prefix
        Of PETSc's options for the linear solver.
    """

    def __init__(
        self,
        membrane: Membrane,
        film: Film,
        lines: list[EdgeLine],
        inflation: Inflation,
        prefix: str,
    ) -> None:
        self.membrane, self.film, self.lines, self.inflation = membrane, film, lines, inflation
        self.comm, n = membrane.comm, membrane.V.dofmap.index_map.size_local
        self.held: Booleans = membrane.held[:n]
        first = membrane.V.dofmap.index_map.local_range[0]
        self._rows = (np.flatnonzero(self.held) + 3 * first).astype(PETSc.IntType)
        self._found = [line for line in lines if line.cable.tension is None]
        self._vector = film.matrix.createVecLeft()
        self._way = self._vector.duplicate()
        self._pc = PETSc.PC().create(self.comm)
        self._pc.setOptionsPrefix(prefix)
        self._pc.setOperators(film.matrix)
        self._pc.setType(PETSc.PC.Type.CHOLESKY if film.isotropic else PETSc.PC.Type.LU)
        self._pc.setFactorSolverType("mumps")
        self._pc.setFromOptions()
        film.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        if self._pc.getFactorSolverType() == "mumps":  # its estimate may be too small
            self._pc.setFactorSetUpSolverType()
            self._pc.getFactorMatrix().setMumpsIcntl(14, WORKSPACE)
        self._force = film.largest * membrane.size
        self._thickness = self._shapes()
        for line in lines:
            self._begin(line)
        self.iterations = 0
        self.holding = False
        """Whether the elasticity that holds vertices is part of the equilibrium found."""
        self.support_forces: Array = np.zeros((0, 3))
        """Forces of the supports on this rank's vertices (force), (n, 3)."""

    def _begin(self, line: EdgeLine) -> None:
        """Give a cable a tension to begin with: what is not known for an arc of its length."""
        length = self.comm.allreduce(line.length_and_slope(self.membrane.positions())[0])
        cable = line.cable
        if cable.tension is not None:
            line.tension = cable.tension
        else:
            line.tension = length * (cable.force_density or self.film.largest)

    def destroy(self) -> None:
        """Free the PETSc objects."""
        for own in (self._pc, self._vector, self._way, self.film.matrix):
            own.destroy()

    def run(self, lift: Array) -> None:
        """Find the form. Collective.

        Parameters
        ----------
        lift
            Movement of the held vertices from the start mesh, (n, 3) with ghosts (length).

        Raises
        ------
        ConvergenceError
            There is none near, as cells collapse or the residual stays.
        """
        film = self.film
        residual, gaps, error = self._unbalanced()
        updates = wait = UPDATES
        best, left = 1.0, np.inf
        with progress(self.comm, -np.log10(TOLERANCE), "finding the form") as bar:
            while error > TOLERANCE or self.iterations == 0:
                if self.iterations == MOST:
                    raise ConvergenceError(
                        f"find_form: after {MOST} iterations the unbalanced force is still "
                        f"{error:.2g} of that in the cells; {NO_FORM}"
                    )
                before = self._state()
                newton = updates == 0
                if newton and not self.holding:
                    film.reference.x.array[:] = film.u.x.array
                    left = error
                self._step(residual, gaps, newton, lift if self.iterations == 0 else None)
                self.iterations += 1
                sound = self._check_cells(newton)
                found = self._unbalanced() if sound else (residual, gaps, np.inf)
                damped = film.isotropic and film.modulus > SOFTEST
                needed = FALLING if damped else FALLEN
                if newton and not self.holding and not found[2] < QUICK * error and sound:
                    self.holding = not damped
                    found = self._unbalanced()
                if not newton:
                    updates -= 1
                elif damped and found[2] < FALLING * error:
                    film.modulus /= 10.0
                elif not found[2] < needed * error:
                    self._go_back(before)
                    updates, wait = self._hold_more(wait)
                    found = self._unbalanced()
                elif self.holding and found[2] <= TOLERANCE:
                    found = self._moved_on(left)
                residual, gaps, error = found
                if error < best:
                    bar.advance(np.log10(best / max(error, TOLERANCE)), f"residual {error:.1e}")
                    best = max(error, TOLERANCE)
        self._check_tensions()

    def _hold_more(self, wait: int) -> tuple[int, int]:
        """Stiffen what holds vertices; return updates to make next, and when that fails too."""
        self.holding, film = False, self.film
        if film.modulus < STIFFEST:
            film.modulus *= 10.0
            return 0, wait
        film.modulus = SOFTEST
        return 2 * wait, 2 * wait

    def _moved_on(self, left: float) -> Unbalanced:
        """Go on without holding where that has come nearer to a film's equilibrium. Collective."""
        self.holding = False
        alone = self._unbalanced()
        if alone[2] < QUICK * left:
            return alone
        self.holding = True
        return self._unbalanced()

    def _state(self) -> tuple[Array, list[float], float]:
        tensions = [line.tension for line in self.lines]
        return self.film.u.x.array.copy(), tensions, self.inflation.pressure

    def _go_back(self, state: tuple[Array, list[float], float]) -> None:
        self.film.u.x.array[:], tensions, self.inflation.pressure = state
        for line, tension in zip(self.lines, tensions, strict=True):
            line.tension = tension

    def _unbalanced(self) -> Unbalanced:
        """Unbalanced forces, (n, 3), errors of the equations, and the residual. Collective."""
        x = self.membrane.positions()
        self._slopes: list[Array] = []
        forces = self.film.forces(self.holding)
        self.lengths: list[float] = []
        for line in self.lines:
            length, slope = line.length_and_slope(x)
            self.lengths.append(self.comm.allreduce(length))
            self._slopes.append(self.film.gathered(slope))
            forces += line.tension * self._slopes[-1]
        if self.inflation.acts:
            self.inflation.measure(x)
            forces -= self.inflation.pressure * self.inflation.growth
        self.support_forces = np.where(self.held, forces, 0.0)
        forces[self.held] = 0.0
        gaps, sizes = [], []
        for line, length in zip(self.lines, self.lengths, strict=True):
            cable = line.cable
            if cable.length is not None:
                gaps.append(length - cable.length)
                sizes.append(cable.length)
            elif cable.force_density is not None:
                gaps.append(cable.force_density * length - line.tension)
                sizes.append(cable.force_density * length)
        if self.inflation.is_found:
            gaps.append(self.inflation.gap)
            sizes.append(self.inflation.size)
        square = self.comm.allreduce(float(np.vdot(forces, forces)))
        errors = np.abs(gaps) / np.array(sizes)
        return forces, np.array(gaps), float(np.max([square**0.5 / self._scale(), *errors]))

    def _scale(self) -> float:
        """Norm of the forces in the cells and cables (force)."""
        return self._force + sum(line.tension for line in self.lines)

    def _step(self, residual: Array, gaps: Array, exact: bool, lift: Array | None) -> None:
        """Move by the solution of the linear equations."""
        film, inflation = self.film, self.inflation
        film.assemble(exact, inflation.pressure)
        for line in self.lines:
            line.add_stiffness(film.matrix, exact)
        film.matrix.assemble()
        start = np.zeros_like(residual)
        if lift is not None:
            start[self.held] = lift[: len(start)][self.held]
            self._way.array[:] = start.ravel()
            film.matrix.mult(self._way, self._vector)
            residual = residual + self._vector.array.reshape(-1, 3)
        film.matrix.zeroRowsColumns(self._rows, diag=1.0)
        self._pc.setOperators(film.matrix)
        self._pc.setUp()
        way = start + self._solved(-residual)
        columns, rows, diagonal = self._border()
        if columns:
            ways = [self._solved(column) for column in columns]
            matrix = [[np.vdot(row, way) for way in ways] for row in rows]
            local = np.column_stack([matrix, [np.vdot(row, way) for row in rows]])
            total = self.comm.allreduce(local)
            system = np.diag(diagonal) - total[:, :-1]
            change = np.zeros(len(gaps))
            if np.isfinite(total).all():  # else cells have collapsed, which is seen below
                # singular where cables are straight
                change = np.linalg.lstsq(system, -gaps - total[:, -1], rcond=STRAIGHT)[0]
            for k, line in enumerate(self._found):
                change[k] = np.clip(change[k], (1 / JUMP - 1) * line.tension, JUMP * line.tension)
                line.tension += float(change[k])
            for one, by in zip(ways, change, strict=True):
                way -= by * one
            if inflation.is_found:
                inflation.pressure += float(change[-1])
        film.u.x.array[: way.size] += way.ravel()
        film.u.x.scatter_forward()

    def _solved(self, forces: Array) -> Array:
        self._vector.array[:] = np.where(self.held, 0.0, forces).ravel()
        self._pc.apply(self._vector, self._way)
        return self._way.array.reshape(-1, 3).copy()

    def _border(self) -> tuple[list[Array], list[Array], list[float]]:
        """Forces of the unknown tensions and pressure, and derivatives of their equations."""
        columns, rows, diagonal = [], [], []
        for line, slope in zip(self.lines, self._slopes, strict=True):
            density = line.cable.force_density
            if line.cable.tension is None:
                columns.append(slope)
                rows.append(slope if density is None else density * slope)
                diagonal.append(0.0 if density is None else -1.0)
        if self.inflation.is_found:
            columns.append(-self.inflation.growth)
            rows.append(self.inflation.gap_slope)
            diagonal.append(0.0)
        return columns, rows, diagonal

    def _shapes(self) -> Array:
        """Area over the square of the longest side of this rank's cells, (n,)."""
        corners = self.membrane.positions()[self.membrane.V.dofmap.list]
        sides = np.roll(corners, -1, axis=1) - corners
        areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
        return np.asarray(areas / np.einsum("nij,nij->ni", sides, sides).max(axis=1, initial=0.0))

    def _check_cells(self, newton: bool) -> bool:
        """Whether no cell has collapsed; an error where not even updates keep them. Collective."""
        with np.errstate(invalid="ignore", divide="ignore"):
            shares = self._shapes() / self._thickness
        worst = float(np.min(np.nan_to_num(shares, nan=0.0), initial=np.inf))
        least, rank = self.comm.allreduce((worst, self.comm.rank), op=MPI.MINLOC)
        if least > THINNEST or newton:
            return least > THINNEST
        place = np.zeros(3)
        if self.comm.rank == rank:
            cell = int(np.argmin(np.nan_to_num(shares, nan=0.0)))
            place = self.membrane.positions()[self.membrane.V.dofmap.list[cell]].mean(axis=0)
        place = self.comm.bcast(place, root=rank)
        raise ConvergenceError(f"find_form: cells collapse near {as_text(place)}; {NO_FORM}")

    def _check_tensions(self) -> None:
        for line in self._found:
            if line.tension <= 1e-9 * self._force:
                raise ConvergenceError(
                    f"find_form: the cable {line.cable.group!r} would be slack; give it less "
                    "length."
                )


NO_FORM = (
    "there is no such form, or none near the start mesh. Supports may be too far apart for a "
    "surface between them, cables too weak or too long for the film, or the pressure too high."
)
"""What a message says of forms that are not found."""
