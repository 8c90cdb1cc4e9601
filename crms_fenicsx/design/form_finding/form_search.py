"""Search for a form: updated reference strategy, then Newton's method."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.design.form_finding.film import SOFTEST, STIFFEST, Film, Inflation
from crms_fenicsx.design.form_finding.form_cables import EdgeLine
from crms_fenicsx.design.form_finding.linear_system import Border, Directions, LinearSystem
from crms_fenicsx.foundation.meshes.triangles import double_areas, longest_sides, norm
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import ConvergenceError, as_text
from crms_fenicsx.foundation.runtime.progress import progress
from crms_fenicsx.model.membrane import Membrane

TOLERANCE = 1e-12
"""Tolerance of unbalanced forces, relative to the forces in the cells, and of other equations."""
BALANCED, SMALL = 1e-6, 0.1
"""Unbalanced force across the form at which vertices are held, relative to the forces in the cells
and to the unbalanced force within the form."""
UPDATES, MOST = 2, 200
"""Reference updates before Newton's method is tried, and the most iterations of either."""
FALLEN, FALLING = 0.5, 0.9
"""Largest residual ratio of a useful Newton iteration, undamped and damped by an elasticity."""
MUCH = 0.05
"""Section forces of the holding elasticity, relative to those prescribed, above which vertices are
released once more."""
WEAKEST, STRONGEST = 1.0, 10.0
"""Range of the modulus that damps Newton's method, relative to the section forces."""
THINNEST = 1e-3
"""Smallest ratio of a cell's area to the square of its longest side, relative to the start mesh."""
JUMP = 5.0
"""Largest factor of change of a tension in an iteration."""

State = tuple[Array, list[float], float]
"""Displacements, tensions and the pressure."""


Figures = tuple[Array, Array]
"""Area, cable lengths and tensions, and pressure of a form; forces (n, 3) of supports."""


class FormSearch:
    """Moves a film and its cables to equilibrium, and finds the unknown tensions and pressure."""

    def __init__(
        self,
        membrane: Membrane,
        film: Film,
        lines: list[EdgeLine],
        inflation: Inflation,
        prefix: str,
    ) -> None:
        self.membrane, self.film, self.lines, self.inflation = membrane, film, lines, inflation
        self.comm = membrane.comm
        self.directions = Directions(membrane, film, lines)
        self.system = LinearSystem(film, lines, self.directions, prefix)
        self._found = [line for line in lines if line.cable.tension is None]
        self._force = film.largest * membrane.size
        self._thickness = self._shapes()
        for line in lines:  # estimate unknown tensions as for an arc of the cable's length
            line.measure(film.positions(), self.comm)
            density = line.cable.force_density or film.largest
            line.tension = line.cable.tension or line.length * density
        self.iterations = 0
        self.holding = False
        """Whether the equilibrium includes the elasticity that holds vertices."""
        self.support_forces: Array = np.zeros((0, 3))
        """Forces of the supports on this rank's vertices (force), (n, 3)."""
        self.freely: Figures | None = None
        """Figures of the form before its vertices were held."""
        self._damping = 0.0
        self._held_at = self._state()
        self._share = np.inf

    def run(self, lift: Array) -> None:
        """Find the form. Collective. Shapes and units: lift (n, 3) (length)."""
        updates = wait = UPDATES
        best, error = 1.0, self._measure()
        with progress(self.comm, -np.log10(TOLERANCE), "finding the form") as bar:
            while self._unbalanced > TOLERANCE or self.iterations == 0:
                if self.iterations == MOST:
                    raise ConvergenceError(
                        f"find_form: after {MOST} iterations the unbalanced force is still "
                        f"{self._unbalanced:.2g} of that in the cells; {NO_FORM}"
                    )
                before, newton = self._state(), updates == 0
                self._step(newton, lift if self.iterations == 0 else None)
                self.iterations += 1
                found = self._measure() if self._check_cells(newton) else np.inf
                if not newton:
                    updates -= 1
                elif found < (FALLING if self._damping else FALLEN) * error:
                    self._damping = self._damping / 10.0 if self._damping > WEAKEST else 0.0
                else:
                    updates = self._stiffen(before, wait)
                    wait = max(wait, updates)
                    found = self._measure()
                if self.holding and found <= TOLERANCE and self._can_release():
                    self.holding, self.film.modulus = False, SOFTEST
                    found = self._measure()
                within = newton and updates == 0 and not self.holding  # the rest is found
                within = within and self._across < max(BALANCED, SMALL * self._within)
                error = self._hold() if within else found
                if error < best:
                    bar.advance(np.log10(best / max(error, TOLERANCE)), f"residual {error:.1e}")
                    best = max(error, TOLERANCE)
        for line in self._found:
            if line.tension <= 1e-9 * self._force:
                group = line.cable.group
                raise ConvergenceError(
                    f"find_form: the cable {group!r} would be slack; prescribe a smaller length."
                )

    def _can_release(self) -> bool:
        """Whether releasing the held vertices once more would improve the form. Collective."""
        film = self.film
        share = film.section_forces(True) - film.section_forces(False)
        own = float(np.abs(share).max(initial=0.0)) / film.largest
        before, self._share = self._share, self.comm.allreduce(own, op=MPI.MAX)
        return film.isotropic and MUCH < self._share < FALLING * before

    def _hold(self) -> float:
        """Hold the vertices within the form at their places; return the residual. Collective."""
        self.freely = self.figures()
        self._held_at, self.holding, self._damping = self._state(), True, 0.0
        self.film.reference.x.array[:] = self.film.u.x.array
        return self._measure()

    def _stiffen(self, before: State, wait: int) -> int:
        """Go back and stiffen the elasticity; once it is stiffest, return a number of updates to
        make."""
        self._go_back(self._held_at if self.holding else before)
        if self.holding and self.film.modulus < STIFFEST:
            self.film.modulus *= 10.0
            return 0
        if not self.holding and not self.film.isotropic:
            self._measure()
            self._hold()  # with forces balanced across only, a form may not exist
            return 0
        if not self.holding and self._damping < STRONGEST:
            self._damping = max(10.0 * self._damping, WEAKEST)
            return 0
        self.holding, self.film.modulus, self._damping = False, SOFTEST, 0.0
        return 2 * wait

    def _state(self) -> State:
        tensions = [line.tension for line in self.lines]
        return self.film.u.x.array.copy(), tensions, self.inflation.pressure

    def _go_back(self, state: State) -> None:
        self.film.u.x.array[:], tensions, self.inflation.pressure = state
        for line, tension in zip(self.lines, tensions, strict=True):
            line.tension = tension

    def _measure(self) -> float:
        """Update forces and equation errors; return the residual to reduce. Collective."""
        # Until vertices are held, only the residual across the form counts.
        film, x = self.film, self.film.positions()
        self._slopes: list[Array] = []
        forces = film.forces(self.holding)
        for line in self.lines:
            line.measure(x, self.comm)
            self._slopes.append(film.gathered(line.slope(len(x))))
            forces += line.tension * self._slopes[-1]
        if self.inflation.acts:
            self.inflation.measure(x)
            forces -= self.inflation.pressure * self.inflation.growth
        free = self.directions.free
        self.support_forces = np.where(free, 0.0, forces)
        self._forces = np.where(free, forces, 0.0)
        equations = [line.equation for line in self._found]
        if self.inflation.is_found:
            equations.append((self.inflation.gap, self.inflation.size))
        self._gaps, sizes = np.array(equations).reshape(-1, 2).T
        error = float(np.max(np.abs(self._gaps) / sizes, initial=0.0))
        self._unbalanced = max(self._size(self._forces), error)
        if self.holding:
            return self._unbalanced
        self.directions.take()
        across = _projected(self.directions.across, self._forces)
        self._across = max(self._size(across), error)
        self._within = self._size(self._forces - across)
        return self._across

    def _size(self, forces: Array) -> float:
        """Norm of forces (n, 3) relative to those in the cells and cables. Collective."""
        square = self.comm.allreduce(float(np.vdot(forces, forces)))
        return float(square**0.5 / (self._force + sum(line.tension for line in self.lines)))

    def figures(self) -> Figures:
        """Figures of the current form. Collective."""
        lines = self.lines
        numbers = [self.film.area(), *(line.length for line in lines)]
        numbers += [line.tension for line in lines] + [self.inflation.pressure]
        return np.array(numbers), self.support_forces

    def _step(self, newton: bool, lift: Array | None) -> None:
        """Move by the solution of the linear system. Collective."""
        film, inflation, lines = self.film, self.inflation, self.lines
        n, pulls = len(film.start), self._slopes
        forces, growth = self._forces, inflation.growth
        if not newton or not self.holding:
            evens = [film.gathered(line.slope(n, even=True)) for line in lines]
        if not newton:
            self.system.assemble(exact=False)
            for line, even, slope in zip(lines, evens, pulls, strict=True):
                forces = forces + line.tension * (even - slope)
            pulls = evens
        elif self.holding:
            self.system.assemble(exact=True, modulus=film.modulus, pressure=inflation.pressure)
        else:
            film.reference.x.array[:] = film.u.x.array
            self.system.balance_across(inflation.pressure, self._damping)
            counted = self.directions.counted
            forces = _projected(counted, forces)
            for line, even in zip(lines, evens, strict=True):
                forces += line.tension * _projected(self.directions.along, even)
            pulls = [_projected(counted, slope) for slope in pulls]
            growth = _projected(counted, growth) if inflation.acts else growth
        start = np.zeros_like(forces)
        if lift is not None:
            start = np.where(self.directions.free, 0.0, lift[: len(start)])
            forces = forces + self.system.times(start)
        self.system.factorise()
        border = self._border(pulls, growth)
        way, ways, change = self.system.bordered(-forces, start, border, self._gaps)
        for k, line in enumerate(self._found):
            change[k] = np.clip(change[k], (1 / JUMP - 1) * line.tension, JUMP * line.tension)
            line.tension += float(change[k])
        for one, by in zip(ways, change, strict=True):
            way -= by * one
        if inflation.is_found:
            inflation.pressure += float(change[-1])
        film.u.x.array[: way.size] += way.ravel()
        film.u.x.scatter_forward()

    def _border(self, pulls: list[Array], growth: Array) -> Border:
        """Forces of the unknown tensions and pressure, and derivatives of their equations."""
        border: Border = []
        for line, pull, slope in zip(self.lines, pulls, self._slopes, strict=True):
            if (density := line.cable.force_density) is not None:
                border.append((pull, density * slope, -1.0))
            elif line.cable.length is not None:
                border.append((pull, slope, 0.0))
        if self.inflation.is_found:
            border.append((-growth, self.inflation.gap_slope, 0.0))
        return border

    def _shapes(self) -> Array:
        """Area over the square of the longest side of this rank's cells, (n,)."""
        corners = self.film.positions()[self.membrane.V.dofmap.list]
        return np.asarray(norm(double_areas(corners)) / 2 / longest_sides(corners) ** 2)

    def _check_cells(self, newton: bool) -> bool:
        """Whether no cell has collapsed; an error if updates collapse them. Collective."""
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


def _projected(directions: Array, forces: Array) -> Array:
    """Components of forces (n, 3) by projectors (n, 3, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", directions, forces))


NO_FORM = (
    "there is no such form, or none near the start mesh. Supports may be too far apart for a "
    "surface between them, cables too weak or too long for the film, or the pressure too high."
)
"""Remedy in messages about forms not found."""
