"""Stresses and strains of the membrane in an equilibrium, cell by cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from numpy.typing import ArrayLike

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.cabling.cables.deformed_surface import CurrentSurface, current_surface
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arguments import Name, collective
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.foundation.runtime.checks import counted, span
from crms_fenicsx.foundation.runtime.errors import InputError
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.strengths import (
    ALL,
    LIMIT_STATES,
    DesignStrength,
    Strengths,
    checked_strengths,
)
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.results.places import PlaceResults, find_places
from crms_fenicsx.results.quantities import (
    QUANTITIES,
    cell_tensors,
    names_of,
    shown_briefly,
    summed,
)


def nodal_means(membrane: Membrane, name: str, values: Array, areas: Array) -> fem.Function:
    """A linear function with the means of adjacent cells' values (n,) at the vertices.
    Collective."""
    V = membrane.nodal_values
    found, known = fem.Function(V, name=name), np.isfinite(values)
    weight, sums = (
        summed(V, V.dofmap.list[known], amount[known, None, None])
        for amount in (areas, areas * values)
    )
    with np.errstate(invalid="ignore"):
        found.x.array[:] = (sums / weight).ravel()
    return found


@dataclass(frozen=True, repr=False)
class MembraneResults:
    """Results in this rank's owned cells, by local cell number.

    Principal values are (n, 2), the larger first, and their directions unit vectors in space, (n,
    2, 3), arbitrary if both values are equal. A folded cell has the values of the triangle it
    unfolds to; its directions and normal are those of the triangle of its corners. Section forces
    include those of added energy terms, such as the residual ones of a found form. Values along
    warp and weft are NaN in cells of isotropic materials, which have neither, unless the cells have
    shapes of their own (`patterns.sew`), whose first axis is the warp.

    Attributes
    ----------
    strains
        Principal Green-Lagrange strains.
    second_piola, second_piola_directions
        Second Piola-Kirchhoff section forces (force per length); directions in the stress-free
        surface.
    true_forces, true_directions
        True (Cauchy) section forces, per current length, ``F S F^T / J`` with J the ratio of the
        areas (force per length); directions in the current surface.
    warp : (n, 3)
        Current unit directions of the warp.
    warp_weft, second_piola_warp_weft : (n, 3)
        True section forces along the warp, across it, and shear (force per length); second
        Piola-Kirchhoff section forces in the material axes.
    state : (n,) int
        2 taut, 1 wrinkled, 0 slack.
    normals : (n, 3)
        Current unit normals.
    areas, stress_free_areas : (n,)
        Current and stress-free areas (length squared).
    folded : (n,) bool
        Whether a cable in tension folds the cell.
    parts
        This rank's owned cells of each part of the mesh, by name.
    surface
        This rank's part of the current surface, with the facets of folded cells.
    membrane
        The membrane of these results.
    in_equilibrium
        Whether the scene was unchanged since its last load step.
    design
        Design strengths of `Scene.set_strengths` under the present loads, by part; none in
        serviceability limit states.
    """

    strains: Array
    second_piola: Array
    second_piola_directions: Array
    true_forces: Array
    true_directions: Array
    warp: Array
    warp_weft: Array
    second_piola_warp_weft: Array
    state: npt.NDArray[np.int8]
    normals: Array
    areas: Array
    folded: Booleans
    stress_free_areas: Array
    parts: Mapping[str, Indices]
    surface: CurrentSurface
    membrane: Membrane
    in_equilibrium: bool
    design: Mapping[str, DesignStrength]

    def __repr__(self) -> str:
        """One line, for this rank's cells; not collective."""
        words = [counted(len(self.state), "cell")]
        words += [f"{name} {span(self.values(name))}" for name in shown_briefly(self.names)]
        words += [
            f"{np.count_nonzero(self.state == k)} {word}"
            for k, word in enumerate(("slack", "wrinkled", "taut"))
        ]
        words += [] if self.in_equilibrium else [UNBALANCED]
        return f"MembraneResults({', '.join(words)})"

    def utilisation(self, strengths: Strengths | Mapping[str, Strengths] | None = None) -> Array:
        """Ratio of true section force to strength, the larger of warp and weft.

        In isotropic material it is the ratio of the major principal force to the strength.

        Parameters
        ----------
        strengths
            Design strengths in warp and weft (force per length); one pair, or one per part by name.
            Of two for isotropic material the smaller one counts. By default those of
            `Scene.set_strengths` under the present loads.

        Returns
        -------
        (n,)
            0 in slack cells; NaN in cells of parts without strengths, and everywhere in a
            serviceability limit state, which strengths do not judge.

        Raises
        ------
        InputError
            A part that does not exist, overlapping parts, strengths that are not positive, or no
            strengths.

        Examples
        --------
        >>> worst = solver.results().utilisation((84.0, 80.0)).max()
        """
        given = self.design
        if strengths is not None:
            checked = checked_strengths("utilisation", strengths, self.membrane.mesh)
            given = {part: one.of(LIMIT_STATES[0], ()) for part, one in checked.items()}
        elif not self.membrane.strengths:
            raise InputError(
                "utilisation: there are no strengths; pass them, or call "
                "scene.set_strengths((warp, weft)) first."
            )
        found = np.full(len(self.state), np.nan)
        for part, one in given.items():
            cells = slice(None) if part == ALL else self.parts[part]
            ratios = (self.warp_weft[cells, :2] / one.design).max(axis=1)
            principal = self.true_forces[cells, 0] / min(one.design)
            ratios = np.where(self.membrane.isotropic[cells], principal, ratios)
            found[cells] = np.maximum(ratios, 0.0)
        return found

    @property
    def names(self) -> list[str]:
        """Names of the cells' values, for `function` and ``at(...)[name]``."""
        return names_of(self.membrane)

    def values(self, name: str) -> Array:
        """Values of this rank's cells by name, (n,): "warp", "weft", "shear" ...

        Raises
        ------
        InputError
            An unknown name; the message lists the known ones. Names of values along warp and weft
            where all materials are isotropic.

        Examples
        --------
        >>> float(solver.results().values("true force 1").max().round(1))
        6.6
        """
        if name in QUANTITIES and name not in self.names and name != "utilisation":
            raise InputError(
                f"there is no {name!r}: the membrane is isotropic and has no warp; use principal "
                'forces, "true force 1" and "true force 2", or an OrthotropicMembrane with a warp.'
            )
        return checks.named("result", {one: QUANTITIES[one] for one in self.names}, name).of(self)

    @collective
    def shares(self, part: str | None = None) -> tuple[float, float, float]:
        """Slack, wrinkled and taut shares of the stress-free area. Collective.

        Parameters
        ----------
        part
            Name of a part of the mesh; None: the whole membrane.

        Raises
        ------
        InputError
            On all ranks: an unknown part.

        Examples
        --------
        >>> slack, wrinkled, taut = solver.results().shares()
        """
        cells: Indices = np.arange(len(self.state), dtype=np.int32)
        if part is not None:
            cells = checks.named("part", self.parts, part)
        areas = self.comm.allreduce(
            np.bincount(self.state[cells], self.stress_free_areas[cells], minlength=3)
        )
        slack, wrinkled, taut = (areas / areas.sum()).tolist()
        return slack, wrinkled, taut

    @property
    def comm(self) -> MPI.Intracomm:
        """Communicator of the membrane."""
        return self.membrane.comm

    @collective
    def function(self, name: Name, *, smooth: bool = False) -> fem.Function:
        """Values as a DOLFINx function on the stress-free mesh. Collective.

        Parameters
        ----------
        name
            One of `names`, or "displacement", the vertices' displacement vector (length). For
            points in folded cells use `at`.
        smooth
            False: constant in each cell (DG0). True: linear (P1), at each vertex the mean of the
            adjacent cells, weighted by stress-free area, which also smooths across borders of parts
            and folds. Displacements are always linear.

        Raises
        ------
        InputError
            On all ranks: an unknown name.

        Examples
        --------
        >>> force = solver.results().function("true force 1", smooth=True)
        >>> float(force.x.array.max().round(1))
        6.2
        """
        if name == "displacement":
            found = fem.Function(self.membrane.V, name=name)
            n = len(found.x.array) // 3
            moved = self.surface.points[:n] - self.surface.stress_free[:n]
            found.x.array[:] = moved.ravel()
            return found
        values = self.values(name)
        if smooth:
            return nodal_means(self.membrane, name, values, self.stress_free_areas)
        found = fem.Function(self.membrane.cell_values, name=name)
        found.x.array[found.function_space.dofmap.list[:, 0]] = values
        found.x.scatter_forward()
        return found

    @collective
    def at(
        self,
        points: ArrayLike,
        *,
        on: Literal["current", "stress-free"] = "current",
        smooth: bool = False,
    ) -> PlaceResults:
        """Results at points of the surface, folded cells included. Collective.

        Parameters
        ----------
        points
            Points in plan, (k, 2), on the uppermost sheet, or in space, (k, 3), projected to the
            nearest place (length); the same on all ranks.
        on
            Shape that the points refer to. "stress-free" follows the same point of the fabric
            through all load cases.
        smooth
            Whether values are interpolated between vertex means, as in `function`, or taken from
            the cell (on an edge, from one of its cells).

        Returns
        -------
        PlaceResults
            The same on all ranks: places, displacements, and values by name,
            ``results.at([(3.0, 4.0)])["warp"]``.

        Raises
        ------
        InputError
            On all ranks: no points, or a point off the surface; in plan by more than 5 % of the
            local cell size, in space by more than 10 %.

        Examples
        --------
        >>> middle = solver.results().at([(2.0, 1.0)])
        >>> float(middle["true force 1"][0].round(1)), middle.displacement[0].round(2)
        (5.4, array([ 0.  , -0.  ,  0.15]))
        """
        places = find_places(self.comm, self.surface, points, on)
        values = {}
        for name in self.names:
            if smooth:
                values[name] = places.interpolated(self.function(name, smooth=True))
            else:
                values[name] = places.of_cells(self.values(name))
        return PlaceResults(places.positions, places.stress_free, values)


def membrane_results(system: System) -> MembraneResults:
    """Evaluate the membrane in the scene's present state. Collective."""
    scene, cells = system.scene, cell_tensors(system)
    E, axes, images = cells.strains, cells.axes, cells.images
    S = cells.forces.copy()
    for term in scene.terms:
        if term.present_forces is not None:
            S += np.einsum("nai,nij,nbj->nab", axes, term.present_forces, axes)
    normal: Array = np.asarray(np.cross(images[:, 0], images[:, 1]), dtype=np.float64)
    normal /= np.linalg.norm(normal, axis=1)[:, None]

    # With U the root of C = F^T F, F S F^T = R (U S U) R^T: one symmetric problem in the plane.
    squared, Q = np.linalg.eigh(np.eye(2) + 2 * E)
    # a collapsed cell still has directions
    stretch = np.sqrt(np.maximum(squared, 1e-12))
    J = stretch.prod(axis=1)
    U = np.einsum("nij,nj,nkj->nik", Q, stretch, Q)
    true_forces, turned = _principal(U @ S @ U / J[:, None, None])
    unturned = np.linalg.solve(U, np.swapaxes(turned, 1, 2))  # columns: eigenvectors of S C / J
    first = np.einsum("na,nai->ni", unturned[:, :, 0], images)
    first /= np.linalg.norm(first, axis=1)[:, None]

    warp = images[:, 0] / np.linalg.norm(images[:, 0], axis=1)[:, None]
    cos = np.einsum("ni,ni->n", first, warp)
    sin = np.einsum("ni,ni->n", first, np.cross(normal, warp))
    larger, smaller = true_forces.T
    along = larger * cos**2 + smaller * sin**2
    across = larger * sin**2 + smaller * cos**2

    stress_free = scene.membrane.cell_areas
    second_piola, directions = _principal(S)
    directions = np.einsum("nka,nai->nki", directions, cells.frames)
    along_axes = np.stack([along, across, (larger - smaller) * sin * cos], axis=1)
    second_along_axes = S[:, [0, 1, 0], [0, 1, 1]]
    if scene.membrane.frames is None:
        for values in (warp, along_axes, second_along_axes):
            values[scene.membrane.isotropic] = np.nan
    return MembraneResults(
        strains=_principal(E)[0],
        second_piola=second_piola,
        second_piola_directions=directions / np.linalg.norm(directions, axis=2)[..., None],
        true_forces=true_forces,
        true_directions=np.stack([first, np.cross(normal, first)], axis=1),
        warp=warp,
        warp_weft=along_axes,
        second_piola_warp_weft=second_along_axes,
        state=cells.state,
        normals=normal,
        areas=J * stress_free,
        folded=cells.folded,
        stress_free_areas=stress_free,
        parts=scene.mesh.parts,
        surface=current_surface(scene.net),
        membrane=scene.membrane,
        in_equilibrium=scene.in_equilibrium(),
        design=scene.design.of_fabric(scene.case.state, scene.factors),
    )


def _principal(tensors: Array) -> tuple[Array, Array]:
    """Principal values (n, 2), larger first, and their directions as rows, (n, 2, 2)."""
    ascending, columns = np.linalg.eigh(tensors)
    values: Array = ascending[:, ::-1]
    return values, np.swapaxes(columns, 1, 2)[:, ::-1]
