"""Named quantities of the membrane's cells and loads on them, for files and pictures."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from dolfinx import fem, la
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.state import SceneState
from crms_fenicsx.analysis.steps.load_cases import HasStates
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.membrane import Membrane


@dataclass(frozen=True)
class _CellTensors:
    """Tensors in the material axes of this rank's owned cells."""

    # strains, forces: (n, 2, 2) Green-Lagrange strains, second Piola-Kirchhoff section forces
    # (force per length)
    strains: Array
    forces: Array
    # frames, axes, images: (n, 2, 3) unit vectors of the material axes in the mesh, their dual
    # vectors, which give components, and the deformed unit vectors. Where the mesh is stress-free,
    # frames and axes are equal.
    frames: Array
    axes: Array
    images: Array
    state: npt.NDArray[np.int8]  # (n,) 2 taut, 1 wrinkled, 0 slack
    # (n,) whether a taut cable folds the cell; its images are those of its corner triangle
    folded: Booleans


def cell_tensors(system: System) -> _CellTensors:
    """Evaluate the cells in the scene's present state; see `membrane_results`. Collective."""
    system.update()
    scene, membrane = system.scene, system.membrane.energy
    values = membrane.cell_results()
    n = len(values)
    folded = np.zeros(n, dtype=bool)
    if system.folds is not None:
        # Evaluates the folded cells, collectively: ranks without folded cells join in.
        system.potential.sum_up()
        cells = system.folds.tables.folded.cells
        values[cells] = system.folds.energy.cell_results()
        folded[cells] = True
    E = _symmetric(values[:, 0], values[:, 1], values[:, 2] / 2)
    S = _symmetric(values[:, 3], values[:, 4], values[:, 5])

    axes = membrane.material_axes(np.arange(n, dtype=np.int32))
    frames = axes if membrane.frames is None else membrane.frames[:n]
    x = scene.mesh.mesh.geometry.x[geometry_dofmap(scene.mesh.mesh)]
    u = scene.u.x.array.reshape(-1, 3)[scene.V.dofmap.list]
    before: Array = np.asarray(x[:, 1:] - x[:, :1], dtype=np.float64)
    after = before + (u[:, 1:] - u[:, :1])
    # Columns of F are the current images of the material axes: edges = components x images.
    components = np.einsum("nki,nai->nka", before, axes)
    images = np.linalg.solve(components, after)
    state = np.rint(values[:, 6]).astype(np.int8)
    return _CellTensors(E, S, frames, axes, images, state, folded)


def _symmetric(a: Array, b: Array, c: Array) -> Array:
    """Matrices (n, 2, 2) with diagonal a, b and off-diagonal c."""
    return np.stack([np.stack([a, c], axis=-1), np.stack([c, b], axis=-1)], axis=-2)


@dataclass(frozen=True)
class _CellQuantity:
    """A scalar quantity of the cells."""

    label: str  # displayed name
    attribute: str  # attribute, column: field of `MembraneResults`; -1 for a scalar field
    column: int = -1
    unit: str = ""  # "stress" (force per length), or "" for a plain number

    def of(self, results: Any) -> Array:
        """Values from membrane results, (n,)."""
        found = getattr(results, self.attribute)
        values = np.asarray(found() if callable(found) else found, dtype=np.float64)
        return values if self.column < 0 else values[:, self.column]

    @property
    def scale(self) -> float:
        """Factor of reports, which show what has no unit in per cent."""
        return 1.0 if self.unit else 100.0


QUANTITIES = {
    "warp": _CellQuantity("section force along warp", "warp_weft", 0, "stress"),
    "weft": _CellQuantity("section force along weft", "warp_weft", 1, "stress"),
    "shear": _CellQuantity("shear of warp and weft", "warp_weft", 2, "stress"),
    "true force 1": _CellQuantity("major principal section force", "true_forces", 0, "stress"),
    "true force 2": _CellQuantity("minor principal section force", "true_forces", 1, "stress"),
    "second Piola warp": _CellQuantity(
        "second Piola-Kirchhoff force along warp", "second_piola_warp_weft", 0, "stress"
    ),
    "second Piola weft": _CellQuantity(
        "second Piola-Kirchhoff force along weft", "second_piola_warp_weft", 1, "stress"
    ),
    "second Piola shear": _CellQuantity(
        "second Piola-Kirchhoff shear", "second_piola_warp_weft", 2, "stress"
    ),
    "strain 1": _CellQuantity("major principal strain", "strains", 0),
    "strain 2": _CellQuantity("minor principal strain", "strains", 1),
    "state": _CellQuantity("0 slack, 1 wrinkled, 2 taut", "state"),
    "utilisation": _CellQuantity("utilisation", "utilisation"),
}
"""All quantities; "utilisation" needs the strengths of `Scene.set_strengths`, those along warp and
weft a material with a warp."""

SHOWN = ("true force 1", "true force 2", "warp", "weft", "shear", "utilisation")
"""Quantities in ParaView files and pyvista, beside directions and states."""

SUMMED_UP = (*SHOWN[:-1], "strain 1", "utilisation")
"""Quantities in summaries and reports, where known."""

QUANTITY_OF = {"stress": "true force 1", "stress 2": "true force 2", "strain": "strain 1"}
QUANTITY_OF |= {name: name for name in ("warp", "weft", "shear", "state", "utilisation")}
"""Quantities by their names as colours of `draw`."""


def shown_briefly(names: Collection[str]) -> tuple[str, ...]:
    """The forces that a line of text shows: along warp and weft, or else the principal ones."""
    return ("warp", "weft", "shear") if "warp" in names else ("true force 1", "true force 2")


def names_of(membrane: Membrane) -> list[str]:
    """Names of the quantities that a membrane has."""
    lacking = set() if membrane.strengths else {"utilisation"}
    lacking |= set() if membrane.has_warp else {"warp_weft", "second_piola_warp_weft"}
    return [name for name, one in QUANTITIES.items() if one.attribute not in lacking]


def fields_of(results: Any) -> dict[str, Array]:
    """Cell data of ParaView files and pyvista, by name, (n,) or (n, 3)."""
    found = {name: results.values(name) for name in SHOWN if name in results.names}
    return {**found, "direction 1": results.true_directions[:, 0], "state": results.state}


def summed(space: fem.FunctionSpace, dofs: Integers | Indices, values: Array) -> Array:
    """Sums (n, c) at a linear space's nodes, ghosts included, of values (..., c) at the nodes
    `dofs` (...) of its cells or edges. Collective."""
    found = fem.Function(space)
    sums: Array = found.x.array.reshape(-1, space.dofmap.index_map_bs)
    np.add.at(sums, dofs, values)
    found.x.scatter_reverse(la.InsertMode.add)
    found.x.scatter_forward()
    return sums.copy()


class Solved(HasStates, Protocol):
    """Interface of `Solver`, which results must not import."""

    comm: MPI.Intracomm
    base: SceneState | None

    @property
    def system(self) -> System:
        """The scene's potential."""


def load_label(scene: Scene, name: str) -> tuple[str, str]:
    """Label of a load's values and the kind of unit."""
    if any(load.name == name and load.suction is not None for load in scene.loads):
        return f"c_p of {name}", ""
    return f"{name} per area", "pressure"


def load_values(scene: Scene, name: str) -> Array:
    """Load or pond in this rank's cells at factor 1, (m,). Collective.

    For wind the pressure coefficients, positive for pressure on the outer side; otherwise the
    magnitude of the force per area, averaged around vertices.
    """
    membrane, own = scene.membrane, scene.mesh.mesh.topology.index_map(2).size_local
    cells = membrane.V.dofmap.list[:own]
    corners = membrane.positions()[cells]
    for pond in scene.ponds:
        if pond.name == name:
            depth = np.maximum(pond.level - corners[..., 2].mean(axis=1), 0.0)
            return np.asarray(pond.weight * depth * pond.cells(membrane)[:own])
    load = checks.named("load", {one.name: one for one in scene.loads}, name)
    if load.suction is not None:
        return np.asarray(-load.suction[:own] / load.peak)
    forces = summed(membrane.V, np.arange(len(load.forces)), load.forces)
    dofs, shares = membrane.nodal_values.dofmap.list[:own], norm(double_areas(corners)) / 6
    areas = summed(membrane.nodal_values, dofs, shares[:, None, None])[:, 0]
    at = np.linalg.norm(forces, axis=1)[cells].mean(axis=1)
    around = areas[dofs].mean(axis=1)
    return np.asarray(at / around)


def load_directions(scene: Scene, name: str) -> Array:
    """Unit vectors (m, 3) of a load or pond in this rank's cells, 0 where it does not act.
    Collective."""
    membrane, own = scene.membrane, scene.mesh.mesh.topology.index_map(2).size_local
    cells = membrane.V.dofmap.list[:own]
    load = next((one for one in scene.loads if one.name == name), None)
    if load is None:
        return np.tile((0.0, 0.0, -1.0), (own, 1))
    if load.suction is not None:
        ways = load.suction[:own, None] * double_areas(membrane.positions()[cells])
    else:
        ways = summed(membrane.V, np.arange(len(load.forces)), load.forces)[cells].mean(axis=1)
    return np.asarray(ways / np.maximum(norm(ways), 1e-300)[:, None])
