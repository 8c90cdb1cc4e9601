"""Search for a form: updated reference strategy, then Newton's method."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from crms_fenicsx.design.form_finding.film import Film, Inflation
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
"""Largest residual ratio of a useful Newton iteration, undamped and damped by the sheet."""
NEAR = 0.1
"""Largest first step, relative to the cells' sides, from a start mesh whose vertices stay."""
SOFT = 0.1
"""Share of the elastic sheet's stiffness with which vertices settle within the form."""
WEAKEST, STRONGEST = 1.0, 10.0
"""Range of the share of the sheet's stiffness that damps Newton's method."""
THINNEST = 1e-3
"""Smallest ratio of a cell's area to the square of its longest side, relative to the start mesh."""
JUMP = 5.0
"""Largest factor of change of a tension in an iteration."""

State = tuple[Array, Array, list[float], float]
"""Displacements of film and sheet, tensions and the pressure."""

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
        """Whether the elastic sheet holds the vertices within the form."""
        self._bar, self._best = progress(self.comm, -np.log10(TOLERANCE), "finding the form"), 1.0
        self.support_forces: Array = np.zeros((0, 3))
        """Forces of the supports on this rank's vertices (force), (n, 3)."""
        self.freely: Figures | None = None
        """Figures of the form before its vertices were held."""
        self._damping = 0.0
        self._brace = 0.0  # share of displacements across the form that strain the sheet as well

    def run(self, lift: Array | None) -> None:
        """Find the form, near the start mesh if no lift is given. Collective. Shapes and units:
        lift (n, 3) (length)."""
        with self._bar:
            if lift is None:
                if not self._stays(np.inf):
                    raise ConvergenceError(
                        "FoundForm.along: there is no form near this one on the mesh cut along the "
                        "lines; find it on smaller cells first."
                    )
            elif self.comm.allreduce(bool(lift.any()), op=MPI.LOR) or not self._stays(NEAR):
                self._search(lift)
        for line in self._found:
            if line.tension <= 1e-9 * self._force:
                group = line.cable.group
                raise ConvergenceError(
                    f"find_form: the cable {group!r} would be slack; prescribe a smaller length."
                )

    def _search(self, lift: Array) -> None:
        """Find a form from afar, and hold its vertices. Collective."""
        updates, wait, error = UPDATES, UPDATES, self._measure()
        while True:
            if self.iterations >= MOST:
                raise ConvergenceError(
                    f"find_form: after {MOST} iterations the unbalanced force is still "
                    f"{self._unbalanced:.2g} of that in the cells; {NO_FORM}"
                )
            before, newton = self._state(), updates == 0
            self._step("across" if newton else "update", lift)
            lift = 0.0 * lift
            found = self._measure() if self._check_cells(newton) else np.inf
            if not newton:
                updates -= 1
            elif found < (FALLING if self._damping else FALLEN) * error:
                self._damping = self._damping / 10.0 if self._damping > WEAKEST else 0.0
            else:
                self._go_back(before)
                found = self._measure()
                if not self.film.isotropic:  # balanced across only, forms may not exist
                    self.freely, self._damping = self.figures(), STRONGEST
                    if self._hold():
                        return
                updates = self._stiffen(wait)
                wait = max(wait, updates)
            self._tell(found)
            error = found
            if newton and updates == 0 and self._across < max(BALANCED, SMALL * self._within):
                self._settle()
                if self._hold():
                    return
                updates = wait = 2 * wait

    def _stiffen(self, wait: int) -> int:
        """Damp more strongly; once it is most, return a number of updates to make."""
        if self._damping < STRONGEST:
            self._damping = max(10.0 * self._damping, WEAKEST)
            return 0
        self._damping = 0.0
        return 2 * wait

    def _stays(self, reach: float) -> bool:
        """Hold the vertices of the start mesh at once; whether there is such a form, not further
        than `reach` in cells' sides. Collective."""
        if not self._hold(reach):
            return False
        held, brace = self._state(), self._brace
        self._let_go()
        self._step("across")
        self._measure()
        self.freely = self.figures()
        self._go_back(held)
        self.holding, self._brace = True, brace
        self._measure()
        return True

    def _settle(self) -> None:
        """Let a soft sheet move the vertices within the form, if that balances the forces better.
        Collective."""
        self.freely, before, unbalanced = self.figures(), self._state(), self._unbalanced
        self._step("settle")
        if self._check_cells(True):
            self._measure()
            if self._unbalanced < unbalanced:
                return
        self._go_back(before)

    def _hold(self, reach: float = np.inf) -> bool:
        """Hold the vertices within the form, and balance all forces if possible. Collective."""
        start = self._state()
        self.holding = True
        for self._brace in (0.0, 1.0)[: 1 if np.isfinite(reach) else 2]:
            if self._balance(reach):
                break
            self._go_back(start)
        else:
            self._let_go()
            return False
        if self._brace:  # from here also without
            start, self._brace = self._state(), 0.0
            self.film.sheet.x.array[:] = 0.0
            if not self._balance():
                self._go_back(start)
                self._brace = 1.0
                self._measure()
        return True

    def _balance(self, reach: float = np.inf) -> bool:
        """Balance all forces by Newton's method; whether it converges, by a first step not longer
        than `reach` in cells' sides. Collective."""
        error, before, cells = self._measure(), self.film.positions(), self.membrane.V.dofmap.list
        while self._unbalanced > TOLERANCE:
            self._step("hold")
            ways = norm(self.film.positions() - before)
            near = bool((ways[cells].max(axis=1) <= reach * longest_sides(before[cells])).all())
            if not self.comm.allreduce(near, op=MPI.LAND):
                return False
            reach = np.inf
            found = self._measure() if self._check_cells(True) else np.inf
            if not found < FALLEN * error:
                return found <= 10.0 * TOLERANCE  # rounding
            self._tell(found)
            error = found
        return True

    def _let_go(self) -> None:
        """Remove the sheet. Collective."""
        self.holding, self._brace = False, 0.0
        self.film.sheet.x.array[:] = 0.0
        self._measure()

    def _tell(self, error: float) -> None:
        """Report progress."""
        if error < self._best:
            least = max(error, TOLERANCE)
            self._bar.advance(np.log10(self._best / least), f"residual {error:.1e}")
            self._best = least

    def _state(self) -> State:
        tensions = [line.tension for line in self.lines]
        film = self.film
        return film.u.x.array.copy(), film.sheet.x.array.copy(), tensions, self.inflation.pressure

    def _go_back(self, state: State) -> None:
        film = self.film
        film.u.x.array[:], film.sheet.x.array[:], tensions, self.inflation.pressure = state
        for line, tension in zip(self.lines, tensions, strict=True):
            line.tension = tension

    def _measure(self) -> float:
        """Update forces and equation errors; return the residual to reduce. Collective."""
        # Until vertices are held, only the residual across the form counts.
        film, x = self.film, self.film.positions()
        for line in self.lines:
            line.measure(x, self.comm)
        self.directions.take()
        if self.holding:
            own = film.sheet.x.array[: self.directions.free.size].reshape(-1, 3)
            own -= _projected((1.0 - self._brace) * self.directions.moving, own)
            film.sheet.x.scatter_forward()
        self._slopes = [film.gathered(line.slope(len(x))) for line in self.lines]
        forces = film.forces()
        for line, slope in zip(self.lines, self._slopes, strict=True):
            forces += line.tension * slope
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

    def _step(self, kind: str, lift: Array | None = None) -> None:
        """Move by the solution of the linear system. Collective."""
        film, inflation, lines = self.film, self.inflation, self.lines
        n, pulls = len(film.start), self._slopes
        forces, growth = self._forces, inflation.growth
        if kind == "hold":
            self.system.hold(inflation.pressure, self._brace)
        else:
            evens = [film.gathered(line.slope(n, even=True)) for line in lines]
        if kind == "update":
            self.system.assemble(exact=False)
            for line, even, slope in zip(lines, evens, pulls, strict=True):
                forces = forces + line.tension * (even - slope)
            pulls = evens
        elif kind != "hold":
            at = self.directions
            counted, placed, share = at.counted, at.within, self._damping
            if kind == "settle":
                counted, placed, share = np.eye(3) - at.along, at.along, SOFT
            self.system.balance(counted, placed, inflation.pressure, share)
            forces = _projected(counted, forces)
            for line, even in zip(lines, evens, strict=True):
                forces += line.tension * _projected(at.along, even)
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
        across = _projected(self.directions.moving, way) if self.holding else way
        within = way - across + self._brace * across
        for function, moved in ((film.u, across), (film.sheet, within)):
            function.x.array[: moved.size] += moved.ravel()
            function.x.scatter_forward()
        self.iterations += 1

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
        if self.holding:  # displacements of the sheet move nothing
            moving = self.directions.moving
            border = [(pull, _projected(moving, row), own) for pull, row, own in border]
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
    "surface between them, cables too weak or too long for the film, or the pressure too high: "
    "p R < 2 s for a dome of radius R, and give rise= instead to have the pressure found."
)
"""Remedy in messages about forms not found."""
