"""The part of a solver that goes to finer meshes, to tell how right its results are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array
from crms_fenicsx.runtime.errors import collective
from crms_fenicsx.scene import Scene
from crms_fenicsx.steps.load_cases import LoadCases
from crms_fenicsx.steps.options import Options

Own = TypeVar("Own", bound="FinerMeshes")


class FinerMeshes(LoadCases):
    """The part of a solver that makes others on finer meshes."""

    _options: Options

    @collective
    def refine(self: Own, project: Callable[[Array], Array] | None = None) -> Own:
        """Divide each cell into four, and find the equilibrium at the same loads there. Collective.

        Supports, materials, parts and groups, pressure, named loads, floor and cables with all
        their data are carried over. Cables and loads go through the states in which they were put
        on the scene, so that their lengths and forces have no error of this mesh: a cable that was
        laid just taut on the inflated membrane is so on the finer one. A cable with friction lies
        where it does here, and friction holds it there anew. The new solver writes no results.

        Parameters
        ----------
        project
            Where new vertices belong: a function of points (3, n) near the stress-free surface that
            returns points (3, n) in it. By default they go to the surface that the mesh's generator
            knows (the circle, ellipse, spherical cap and air hall); on other meshes, of arrays and
            files, to the smooth surface behind the facets, plane where they are, while edges of
            the boundary, seams and ridges stay straight. Finer meshes of the finer one take the
            same.

        Returns
        -------
        Solver
            Of a new scene, with this one's options.

        Raises
        ------
        InputError
            On all ranks and before anything is computed: something that cannot be carried over;
            it names what.
        PathError
            A cable has no such path on the finer mesh.
        ConvergenceError
            The finer mesh has no equilibrium at one of the states.

        Examples
        --------
        >>> finer = solver.refine()
        >>> finer.scene.cable("ridge").tension - solver.scene.cable("ridge").tension
        """
        from crms_fenicsx.convergence.finer_scene import finer_scene

        checks.same(self._scene.comm, "refine", project=project)

        another: Any = type(self)
        given = {name: getattr(self._options, name) for name in CARRIED}

        def solve(scene: Scene) -> None:
            solver = another(scene, **given)
            solver.advance()
            solver._increments.release()

        finer: Own = another(finer_scene(self._scene, project, solve), **given)
        finer.advance()
        return finer


CARRIED = ("prefix", "rtol", "max_halvings", "slide", "verify")
"""Options of a solver that those on finer meshes have, too."""
