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
"""Largest residual ratio of a useful Newton iteration, undamped and damped by an elasticity."""
NEAR = 0.1
"""Largest first step, relative to the cells' sides, from a start mesh whose vertices stay."""
WEAKEST, STRONGEST = 1.0, 10.0
"""Range of the modulus that damps Newton's method, relative to the section forces."""
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
        self.support_forces: Array = np.zeros((0, 3))
        """Forces of the supports on this rank's vertices (force), (n, 3)."""
        self.freely: Figures | None = None
        """Figures of the form before its vertices were held."""
        self._damping = 0.0

    def run(self, lift: Array) -> None:
        """Find the form. Collective. Shapes and units: lift (n, 3) (length)."""
        updates = wait = UPDATES
        best, error = 1.0, self._measure()
        with progress(self.comm, -np.log10(TOLERANCE), "finding the form") as bar:
            if not self.comm.allreduce(bool(lift.any()), op=MPI.LOR) and self._stays():
                updates, error = 0, self._measure()
            while self._unbalanced > TOLERANCE or self.iterations == 0:
                if self.iterations == MOST:
                    raise ConvergenceError(
                        f"find_form: after {MOST} iterations the unbalanced force is still "
                        f"{self._unbalanced:.2g} of that in the cells; {NO_FORM}"
                    )
                before, newton = self._state(), updates == 0
                kind = "hold" if self.holding else "across" if newton else "update"
                self._step(kind, lift if self.iterations == 0 else None)
                found = self._measure() if self._check_cells(newton) else np.inf
                if __import__("os").environ.get("DBG"): print(kind, self.iterations, f"error {error:.2e} found {found:.2e} damping {self._damping} z", self.film.positions().max(0), np.hypot(*self.film.positions().T[:2]).min())
                if not newton:
                    updates -= 1
                elif found < (FALLING if self._damping else FALLEN) * error:
                    self._damping = self._damping / 10.0 if self._damping > WEAKEST else 0.0
                else:
                    updates = self._stiffen(before, wait)
                    wait = max(wait, updates)
                    found = self._measure()
                within = newton and updates == 0 and not self.holding  # the rest is found
                within = within and self._across < max(BALANCED, SMALL * self._within)
                if within:
                    self._settle()
                    error = self._hold()
                else:
                    error = found
                if error < best:
                    bar.advance(np.log10(best / max(error, TOLERANCE)), f"residual {error:.1e}")
                    best = max(error, TOLERANCE)
        for line in self._found:
            if line.tension <= 1e-9 * self._force:
                group = line.cable.group
                raise ConvergenceError(
                    f"find_form: the cable {group!r} would be slack; prescribe a smaller length."
                )

    def _stays(self) -> bool:
        """Whether the start mesh is near a form, so that its vertices are held there. Collective.
        """
        start = self._state()
        self._hold()
        self._step("hold")
        by = norm(self.film.u.x.array.reshape(-1, 3) - start[0].reshape(-1, 3))
        cells = self.membrane.V.dofmap.list
        sides = longest_sides(self.film.start[cells])
        with np.errstate(invalid="ignore"):
            stays = bool((by[cells].max(axis=1) < NEAR * sides).all())
        if self.comm.allreduce(stays, op=MPI.LAND):
            return True
        self.holding = False
        self._go_back(start)
        self._measure()
        return False

    def _settle(self) -> None:
        """Let a soft sheet move the vertices within the form, unless cells collapse. Collective."""
        self.freely, before = self.figures(), self._state()
        self._step("settle")
        if not self._check_cells(True):
            self._go_back(before)
        self._measure()

    def _hold(self) -> float:
        """Hold the vertices within the form at their places; return the residual. Collective."""
        self.holding, self._damping = True, 0.0
        return self._measure()

    def _stiffen(self, before: State, wait: int) -> int:
        """Go back and damp more strongly; once it is most, return a number of updates to make."""
        self._go_back(before)
        if not self.holding and not self.film.isotropic:
            self._measure()
            self._hold()  # with forces balanced across only, a form may not exist
            return 0
        if self._damping < STRONGEST:
            self._damping = max(10.0 * self._damping, WEAKEST)
            return 0
        self.holding, self._damping = False, 0.0
        self.film.sheet.x.array[:] = 0.0
        return 2 * wait

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
            own -= _projected(self.directions.counted, own)
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
        if kind in ("update", "across"):
            evens = [film.gathered(line.slope(n, even=True)) for line in lines]
        if kind == "update":
            self.system.assemble(exact=False)
            for line, even, slope in zip(lines, evens, pulls, strict=True):
                forces = forces + line.tension * (even - slope)
            pulls = evens
        elif kind == "settle":
            self.system.settle(inflation.pressure)
        elif kind == "hold":
            self.system.hold(inflation.pressure, self._damping)
        else:
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
        across = _projected(self.directions.counted, way) if self.holding else way
        for function, by in ((film.u, across), (film.sheet, way - across)):
            function.x.array[: by.size] += by.ravel()
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
            counted = self.directions.counted
            border = [(pull, _projected(counted, row), own) for pull, row, own in border]
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
