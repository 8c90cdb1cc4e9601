"""The part of a solver that goes to finer meshes, to tell how right its results are."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from crms_fenicsx.results.solver_results import SolverResults
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import collective
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.load_cases import LoadCases
from crms_fenicsx.steps.options import Options

if TYPE_CHECKING:
    from crms_fenicsx.convergence.finer_scene import Terms
    from crms_fenicsx.convergence.study import Convergence
    from crms_fenicsx.meshes.membrane_mesh import MembraneMesh
    from crms_fenicsx.surface.mesh_refinement import MeshRefinement

Own = TypeVar("Own", bound="FinerMeshes")


class FinerMeshes(LoadCases, SolverResults):
    """The part of a solver that makes others on finer meshes."""

    _options: Options

    @collective
    def refine(
        self: Own,
        project: Callable[[Array], Array] | None = None,
        *,
        terms: Terms | None = None,
    ) -> Own:
        """Divide each cell into four, and find the equilibrium at the same loads there. Collective.

        Everything of the scene is carried over: supports, materials and strengths, parts and
        groups, pressure, named loads, floor, cables, bars and joints, ponds and sealed air. What
        got its size from this mesh gets it from the finer one again, in the state in which it was
        put on the scene: a cable that was laid just taut on the inflated membrane is so on the
        finer one, as is a bar that was placed without a length, and the gas law counts from the
        volume that the finer mesh has at sealing. Friction along a cable goes on from where the
        cable rested on the membrane; friction sideways holds it anew where it lies here. Where the
        loads lead to no equilibrium at once they are brought on again from the state before, in 1,
        4 or 16 increments, which is logged as a warning. The new solver writes no results.

        Parameters
        ----------
        project
            Where new vertices belong: a function of points (3, n) near the stress-free surface that
            returns points (3, n) in it. By default they go to the surface that the mesh's generator
            knows (the circle, ellipse, spherical cap and air hall); on other meshes, of arrays and
            files, to the smooth surface behind the facets, plane where they are, while edges of
            the boundary, seams and ridges stay straight. Finer meshes of the finer one take the
            same.
        terms
            Makes the terms that `Scene.add_term` has added for another scene: a function of that
            scene, of which only mesh and supports are there, that returns them in their order.

        Returns
        -------
        Solver
            Of a new scene, with this one's options.

        Raises
        ------
        InputError
            On all ranks and before anything is computed: something that cannot be carried over; it
            names what. That is what depends on the steps taken, the paper's step-wise laws (but for
            its pressure where edges are free); added terms without `terms`; and loads of which the
            forces on this mesh alone are known, as by `Scene.put_forces`.
        PathError
            A cable has no such path on the finer mesh.
        ConvergenceError
            No equilibrium was found on the finer mesh at one of the states, by increments neither.

        Examples
        --------
        >>> finer = solver.refine()
        >>> finer.scene.cable("ridge").tension - solver.scene.cable("ridge").tension
        >>> solver.refine(terms=lambda scene: Springs(scene, stiffness=2.0))
        """
        checks.same(self._scene.comm, "refine", project=project, terms=terms)
        return self._divided(project, terms, "refine")

    def _divided(
        self: Own,
        project: Callable[[Array], Array] | None,
        terms: Terms | None,
        method: str,
    ) -> Own:
        """A solver on the mesh with each cell divided into four, for a method. Collective."""
        from crms_fenicsx.surface.uniform_refinement import UniformRefinement

        return self._finer(lambda mesh: UniformRefinement.of(mesh, project), terms, method)

    @collective
    def adapt(
        self: Own,
        share: float = 0.5,
        project: Callable[[Array], Array] | None = None,
        *,
        terms: Terms | None = None,
    ) -> Own:
        """Divide the cells with most of the estimated error, and find the equilibrium. Collective.

        Cells are marked in the order of their shares in `estimate_error` until the marked ones have
        a given part of it (W. Doerfler, A convergent adaptive algorithm for Poisson's equation,
        1996); cells with the same share are marked together. DOLFINx bisects them, and those beside
        them so that the mesh fits together: no angle becomes less than half the least one that was
        there, but for what moving new vertices to the surface changes. All else is as for `refine`.

        Parameters
        ----------
        share
            What part of the estimated error the marked cells have, more than 0 and up to 1. With 1
            nearly all cells that have an error are divided.
        project, terms
            As for `refine`.

        Returns
        -------
        Solver
            Of a new scene, with this one's options.

        Raises
        ------
        InputError
            On all ranks: as `refine`, another share, an estimate of no error at all, or a scene
            that has been changed since its last load step.
        PathError, ConvergenceError
            As `refine`.

        Examples
        --------
        >>> for _ in range(4):
        ...     solver = solver.adapt()
        >>> solver.estimate_error().relative
        """
        from crms_fenicsx.convergence.marking import checked_share, marked_cells
        from crms_fenicsx.surface.adaptive_refinement import AdaptiveRefinement

        comm = self._scene.comm
        checks.same(comm, "adapt", share=share, project=project, terms=terms)
        share = checked_share(share)
        self._scene.require_equilibrium("adapt")
        cells = marked_cells(comm, self.estimate_error().cells, share)
        return self._finer(lambda mesh: AdaptiveRefinement.of(mesh, cells, project), terms, "adapt")

    def _finer(
        self: Own,
        divide: Callable[[MembraneMesh], MeshRefinement],
        terms: Terms | None,
        method: str,
    ) -> Own:
        """A solver of the scene on a finer mesh, in equilibrium, for a method. Collective."""
        from crms_fenicsx.convergence.finer_scene import finer_scene

        another: Any = type(self)
        given = {name: getattr(self._options, name) for name in CARRIED}
        made: list[Own] = []

        def solve(scene: Scene) -> None:
            for earlier in made:
                earlier._increments.release()
            made[:] = [another(scene, **given, max_halvings=0)]  # all loads are on: none to halve
            made[0].advance()

        finer_scene(self._scene, divide, solve, terms, method)
        options = made[0]._options
        made[0]._options = replace(options, max_halvings=self._options.max_halvings)
        return made[0]

    @collective
    def convergence(
        self,
        levels: int = 3,
        *,
        points: Mapping[str, Sequence[float]] | None = None,
        reactions: Sequence[str] = (),
        stresses: Sequence[str] = (),
        quantities: Mapping[str, Callable[[Any], float]] | None = None,
        project: Callable[[Array], Array] | None = None,
        terms: Terms | None = None,
    ) -> Convergence:
        """Say how right the current results are, by those on finer meshes. Collective.

        Each level has four times the cells of the one before and takes that much longer at least;
        the second one is enough for an estimate, and the third shows whether it can be trusted.
        The energy and the cables' tensions are compared always. The error that is told is that of
        the mesh: not that of the model, and not that of friction's memory, see `refine`.

        Parameters
        ----------
        levels
            Number of meshes, this one included.
        points
            Stress-free places (3,) by names, whose displacements are compared (length): those of
            the surface with its folds, as by `MembraneResults.at`.
        reactions
            Groups of held vertices, of whose reactions the sums are compared.
        stresses
            Parts of the mesh, or "membrane" for all of it, of which the mean and the greatest true
            section force are compared. At re-entrant corners and ends of supports greatest ones may
            have no limit; then the table says that differences grow.
        quantities
            Other numbers, functions of a solver, by names.
        project, terms
            As for `refine`.

        Returns
        -------
        Convergence
            With a table (``print`` it) and a plot.

        Raises
        ------
        InputError
            On all ranks and before anything is computed: as `refine`, a scene that has been changed
            since its last load step, or a point, group, part or function that cannot be used.
        PathError, ConvergenceError
            As `refine`.

        Examples
        --------
        >>> study = solver.convergence(points={"top": (0.0, 0.0, 10.0)})
        >>> study
        >>> study["tension ridge"].limit, study["tension ridge"].bar
        """
        from crms_fenicsx.convergence.quantities import Quantities
        from crms_fenicsx.convergence.refusals import refuse
        from crms_fenicsx.convergence.study import Convergence, Quantity, checked_levels

        checks.same(
            self._scene.comm, "convergence", levels=levels, points=points, reactions=reactions,
            stresses=stresses, quantities=quantities, project=project, terms=terms,
        )  # fmt: skip
        levels = checked_levels(levels)
        refuse(self._scene, terms, "convergence")
        self._scene.require_equilibrium("convergence")
        if isinstance(points, Mapping):
            points = checks.in_one_order(self._scene.comm, points)
        if isinstance(quantities, Mapping):
            quantities = checks.in_one_order(self._scene.comm, quantities)
        wanted = Quantities.checked(self._scene, points, reactions, stresses, quantities)
        solver, rows, cells, seconds = self, [wanted.of(self)], [_cells(self._scene)], [0.0]
        for _ in range(levels - 1):
            began, last = time.perf_counter(), solver
            solver = last._divided(project, terms, "convergence")
            if last is not self:
                last._increments.release()
            rows.append(wanted.of(solver))
            cells.append(_cells(solver._scene))
            seconds.append(self._scene.comm.bcast(time.perf_counter() - began))
        found = {
            name: Quantity.of(tuple(row[name][0] for row in rows), rows[-1][name][1])
            for name in rows[0]
        }
        return Convergence(tuple(cells), tuple(seconds), found, solver, self._scene.comm)


def _cells(scene: Scene) -> int:
    return int(scene.mesh.mesh.topology.index_map(2).size_global)


CARRIED = ("prefix", "rtol", "slide", "verify", "estimate", "stability")
"""Options of a solver that those on finer meshes have from the beginning."""
