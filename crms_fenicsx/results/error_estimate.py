"""Discretisation error of the energy, estimated from one equilibrium.

Strains, section forces and displacement gradients are constant in each cell. Averages at the
vertices, interpolated linearly, are more accurate (O. C. Zienkiewicz and J. Z. Zhu, A simple error
estimator and adaptive procedure for practical engineering analysis, 1987), and their distance from
the cells' values estimates the error. By a second variation of the strain energy,

    W_h - W  ~  1/2 int (S* - S):(E* - E) + S : (H* - H)^T (H* - H) dA,

with the second Piola-Kirchhoff section forces S, strains E and displacement gradients H; the second
term belongs to taut curved surfaces. Folds are not errors: a cell folded by a cable has a crease
of its own, so averages exclude folded cells. These take their first term against the surrounding
averages, and the second from neighbouring cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids
from crms_fenicsx.foundation.meshes.smooth_surface import CREASE
from crms_fenicsx.foundation.meshes.triangles import cell_normals
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices
from crms_fenicsx.foundation.surface.points import VertexPoint
from crms_fenicsx.results.quantities import cell_tensors, summed

WIDTH = 6 + 6 + 9 + 3 + 3
"""Number of averaged components: E, S, H, unit normals; weight, material and its square."""
UPPER = np.triu_indices(3)


@dataclass(frozen=True, repr=False)
class ErrorEstimate:
    """Estimated error of the energy.

    Attributes
    ----------
    cells : (n,)
        Contributions of this rank's owned cells (force x length).
    total
        Error of the energy, summed over all ranks (force x length).
    relative
        `total` over the membrane's strain energy; 0 if that is zero.
    """

    cells: Array
    total: float
    relative: float

    def __repr__(self) -> str:
        """One line."""
        return f"ErrorEstimate(total {self.total:.3g}, relative {self.relative:.3g})"


class ErrorEstimator:
    """Estimates the errors of a scene's equilibria."""

    def __init__(self, scene: Scene) -> None:
        self._scene, mesh = scene, scene.mesh.mesh
        self._space = fem.functionspace(mesh, ("Lagrange", 1, (WIDTH,)))
        self._dofs: Indices = self._space.dofmap.list
        tags, n = scene.membrane.cell_tags, mesh.topology.index_map(2).size_local
        self._areas, self._normals = scene.membrane.cell_areas, cell_normals(mesh)
        self._tags = np.zeros(n) if tags is None else tags.values.astype(float)

    def of(self, system: System) -> ErrorEstimate:
        """Estimated error of the scene's present state. Collective."""
        self._areas = self._scene.membrane.cell_areas  # which may have moved
        self._normals = cell_normals(self._scene.mesh.mesh)
        tensors = cell_tensors(system)
        frames, axes, images = tensors.frames, tensors.axes, tensors.images
        folded = tensors.folded
        E = np.einsum("nab,nai,nbj->nij", tensors.strains, axes, axes)
        S = np.einsum("nab,nai,nbj->nij", tensors.forces, frames, frames)
        H = np.einsum("nai,naj->nij", images - frames, axes)
        mean, good = self._averages(E, S, H, folded)
        dE, dS = (
            np.where(good[..., None, None], _full(mean[..., k : k + 6]) - own[:, None], 0.0)
            for k, own in ((0, E), (6, S))
        )
        dH = mean[..., 12:21].reshape(*mean.shape[:2], 3, 3) - H[:, None]
        tilt = np.einsum("nvij,naj->nvia", np.where(good[..., None, None], dH, 0.0), frames)
        tangent = [
            np.einsum("nvij,nai,nbj->nvab", d, own, own) for d, own in ((dE, frames), (dS, axes))
        ]
        factor = np.einsum("nab,nvia->nvib", tensors.forces, tilt)
        known = np.maximum(good.sum(axis=1), 1) / 3  # compensates for corners without an average
        first = _integral(tangent[0], tangent[1]) * self._areas / known
        second = _integral(factor, tilt) * self._areas / known
        cells = np.maximum(first, 0.0) / 2 + np.maximum(self._spread(second, folded), 0.0) / 2
        total = self._scene.comm.allreduce(float(cells.sum()))
        strain_energy = abs(self._scene.energies.get("membrane", 0.0))
        return ErrorEstimate(cells, total, total / strain_energy if strain_energy else 0.0)

    def _averages(self, E: Array, S: Array, H: Array, folded: Booleans) -> tuple[Array, Booleans]:
        """Averages at the cells' corners, (n, 3, WIDTH), and which of them are valid, (n, 3)."""
        i, j = UPPER
        n = len(E)
        own = np.column_stack([
            E[:, i, j], S[:, i, j], H.reshape(n, 9), self._normals, np.ones(n), self._tags,
            self._tags**2,
        ])  # fmt: skip
        own *= np.where(folded, 0.0, self._areas)[:, None]
        mean = self._gathered(own)
        weight = mean[..., 24]
        mean = mean / np.where(weight > 0, weight, 1.0)[..., None]
        slope = np.einsum("nvi,ni->nv", mean[..., 21:24], self._normals)
        size = np.linalg.norm(mean[..., 21:24], axis=-1)
        one_material = mean[..., 26] - mean[..., 25] ** 2 < 1e-6
        good = (weight > 0) & one_material & (slope > CREASE * size) & ~self._under_cables()
        return mean, good

    def _gathered(self, own: Array) -> Array:
        """Sums of cell values (n, WIDTH) around each cell's corners, (n, 3, WIDTH)."""
        return summed(self._space, self._dofs.T, own)[self._dofs]

    def _spread(self, values: Array, folded: Booleans) -> Array:
        """Give folded cells (n,) the error per area of their neighbours."""
        own = np.zeros((len(values), WIDTH))
        own[~folded, 0], own[~folded, 1] = values[~folded], self._areas[~folded]
        around = self._gathered(own)[folded].sum(axis=1)
        found = values.copy()
        found[folded] = around[:, 0] / np.maximum(around[:, 1], 1e-300) * self._areas[folded]
        return found

    def _under_cables(self) -> Booleans:
        """Corners under cables that follow mesh lines, (n, 3)."""
        points = {
            node.point.vertex
            for cable in self._scene.cables
            for node, lifted in zip(cable.state.nodes, cable.state.lifted, strict=True)
            if cable.taut and not lifted and isinstance(node.point, VertexPoint)
        }
        ids = cell_vertex_ids(self._scene.mesh.mesh)
        return np.isin(ids, np.array(sorted(points), dtype=np.int64))


def _full(values: Array) -> Array:
    """Symmetric matrices (..., 3, 3) from their upper halves (..., 6)."""
    i, j = UPPER
    full = np.empty((*values.shape[:-1], 3, 3))
    full[..., i, j] = full[..., j, i] = values
    return full


def _integral(a: Array, b: Array) -> Array:
    """Mean over triangles of products of fields linear between corners, (n, 3, i, j)."""
    corners = np.einsum("nvij,nvij->n", a, b)
    return np.asarray((corners + np.einsum("nij,nij->n", a.sum(axis=1), b.sum(axis=1))) / 12)
