"""Stresses and strains of the membrane in an equilibrium, cell by cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.runtime import checks
from crms_fenicsx.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.runtime.compat import geometry_dofmap
from crms_fenicsx.runtime.errors import InputError
from crms_fenicsx.scene import Scene

Strengths = tuple[float, float]
"""In warp and weft (force per length)."""

FLAT = 1e-12
"""Smallest squared stretch that a cell is taken to have, so that a collapsed one has directions."""


@dataclass(frozen=True)
class MembraneResults:
    """Values in this rank's owned cells, by local cell number.

    Principal values are (n, 2), the larger first, and their directions unit vectors in space,
    (n, 2, 3). Where both values are equal, as in a slack cell, the directions are any. A folded
    cell has the values of the triangle that it unfolds to; its directions and its normal are those
    of the triangle of its three corners.

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
        Current unit directions of the warp, of isotropic membranes of their first material axis.
    warp_weft : (n, 3)
        True section forces along the warp and across it, and their shear (force per length).
    second_piola_warp_weft : (n, 3)
        Second Piola-Kirchhoff section forces in the material axes: warp, weft and shear (force per
        length).
    state : (n,) int
        2 taut, 1 wrinkled, 0 slack.
    normals : (n, 3)
        Current unit normals.
    areas : (n,)
        Current areas (length squared).
    folded : (n,) bool
        Whether a cable in tension folds the cell.
    parts
        This rank's owned cells of the mesh's parts, by their names.
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
    parts: Mapping[str, Indices]

    def utilisation(self, strengths: Strengths | Mapping[str, Strengths]) -> Array:
        """True section forces over strengths, the larger ratio of warp and weft.

        Parameters
        ----------
        strengths
            Of the fabric in warp and weft, divided by the partial factors (force per length); one
            pair, or one of each part by its name.

        Returns
        -------
        (n,)
            0 where the cell is slack; NaN in cells of parts that are not named.

        Raises
        ------
        InputError
            A part that does not exist, or strengths that are not positive.

        Examples
        --------
        >>> worst = solver.results().utilisation({"roof": (84.0, 80.0)}).max()
        """
        found = np.full(len(self.state), np.nan)
        if not isinstance(strengths, Mapping):
            return self._ratios("the membrane", strengths, np.arange(len(found), dtype=np.int32))
        for part, pair in strengths.items():
            if part not in self.parts:
                known = ", ".join(sorted(self.parts)) or "(none)"
                raise InputError(
                    f"utilisation: the mesh has no part {part!r}; it has the parts {known}."
                )
            found[self.parts[part]] = self._ratios(repr(part), pair, self.parts[part])
        return found

    def _ratios(self, part: str, strengths: Strengths, cells: Indices) -> Array:
        if np.shape(strengths) != (2,):
            raise InputError(
                f"utilisation: strengths of {part} = {strengths!r}; give two, of warp and weft."
            )
        least = [checks.positive(f"utilisation: strength of {part}", x) for x in strengths]
        return np.asarray(np.maximum(self.warp_weft[cells, :2] / least, 0.0).max(axis=1))


@dataclass(frozen=True)
class CellTensors:
    """Tensors in the material axes of this rank's owned cells.

    Attributes
    ----------
    strains, forces : (n, 2, 2)
        Green-Lagrange strains, second Piola-Kirchhoff section forces (force per length).
    axes, images : (n, 2, 3)
        The material axes, unit vectors, and what they have become.
    sides : (n, 2, 3)
        Two stress-free sides of each cell (length).
    state : (n,)
        2 taut, 1 wrinkled, 0 slack.
    folded : (n,)
        Whether a cable in tension folds the cell; its images are those of its three corners.
    """

    strains: Array
    forces: Array
    axes: Array
    images: Array
    sides: Array
    state: npt.NDArray[np.int8]
    folded: Booleans


def cell_tensors(system: System) -> CellTensors:
    """Evaluate the cells at the scene's current state; see `membrane_results`. Collective."""
    system.update()
    scene, membrane = system.scene, system.membrane.energy
    values = membrane.cell_results()
    n = len(values)
    folded = np.zeros(n, dtype=bool)
    if system.cables is not None and system.cables.tables is not None:
        # It leaves the folded cells' values behind, and is collective: ranks without any join in.
        system.potential.sum_up()
        cells = system.cables.tables.folded.cells
        if len(cells):
            values[cells] = system.cables.folds.energy.cell_results()
            folded[cells] = True
    E = _symmetric(values[:, 0], values[:, 1], values[:, 2] / 2)
    S = _symmetric(values[:, 3], values[:, 4], values[:, 5])

    axes = membrane.material_axes(np.arange(n, dtype=np.int32))
    before, after = _edge_vectors(scene)
    # Columns of F are the current images of the material axes: edges = components x images.
    components = np.einsum("nki,nai->nka", before, axes)
    images = np.linalg.solve(components, after)
    state = np.rint(values[:, 6]).astype(np.int8)
    return CellTensors(E, S, axes, images, before, state, folded)


def membrane_results(system: System) -> MembraneResults:
    """Evaluate the membrane at the scene's current state. Collective.

    Parameters
    ----------
    system
        The scene's potential; it is brought to the scene's state.
    """
    cells = cell_tensors(system)
    E, S, axes, images = cells.strains, cells.forces, cells.axes, cells.images
    n, before = len(E), cells.sides
    normal: Array = np.asarray(np.cross(images[:, 0], images[:, 1]), dtype=np.float64)
    normal /= np.linalg.norm(normal, axis=1)[:, None]

    # With U the root of C = F^T F, F S F^T = R (U S U) R^T: one symmetric problem in the plane.
    squared, Q = np.linalg.eigh(np.eye(2) + 2 * E)
    stretch = np.sqrt(np.maximum(squared, FLAT))
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

    second_piola, directions = _principal(S)
    return MembraneResults(
        strains=_principal(E)[0],
        second_piola=second_piola,
        second_piola_directions=np.einsum("nka,nai->nki", directions, axes),
        true_forces=true_forces,
        true_directions=np.stack([first, np.cross(normal, first)], axis=1),
        warp=warp,
        warp_weft=np.stack([along, across, (larger - smaller) * sin * cos], axis=1),
        second_piola_warp_weft=S[:, [0, 1, 0], [0, 1, 1]],
        state=cells.state,
        normals=normal,
        areas=J * np.linalg.norm(np.cross(before[:, 0], before[:, 1]), axis=1) / 2,
        folded=cells.folded,
        parts={name: own[own < n] for name, own in system.scene.mesh.parts.items()},
    )


def _symmetric(a: Array, b: Array, c: Array) -> Array:
    """Matrices (n, 2, 2) with diagonal a, b and c off it."""
    return np.stack([np.stack([a, c], axis=-1), np.stack([c, b], axis=-1)], axis=-2)


def _principal(tensors: Array) -> tuple[Array, Array]:
    """Principal values (n, 2), larger first, and their directions as rows, (n, 2, 2)."""
    ascending, columns = np.linalg.eigh(tensors)
    values: Array = ascending[:, ::-1]
    return values, np.swapaxes(columns, 1, 2)[:, ::-1]


def _edge_vectors(scene: Scene) -> tuple[Array, Array]:
    """Two sides of the owned cells, stress-free and current, (n, 2, 3) each."""
    mesh = scene.mesh.mesh
    owned = mesh.topology.index_map(2).size_local
    x = mesh.geometry.x[geometry_dofmap(mesh)[:owned]]
    u = scene.u.x.array.reshape(-1, 3)[scene.V.dofmap.list[:owned]]
    before: Array = np.asarray(x[:, 1:] - x[:, :1], dtype=np.float64)
    return before, before + (u[:, 1:] - u[:, :1])
