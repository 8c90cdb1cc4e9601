"""A square with cables on an irregular mesh: the scene that the terms are tested on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from grids import numbered, triangles
from mpi4py import MPI
from taylor import OnMesh, noise

from crms_fenicsx import Cable, Scene
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes import MembraneMesh, from_arrays
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.materials import IsotropicMembrane, MembraneMaterial, OrthotropicMembrane

Array = npt.NDArray[Any]

SIDE, N = 100.0, 6
ISOTROPIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
STIFF = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, wrinkling=False)
FABRIC = OrthotropicMembrane(
    E1=1394.0, E2=140.0, G12=12.0, nu21=0.065, thickness=1.0, warp=(1.0, 0.4, 0.3)
)
STIFF_FABRIC = replace(FABRIC, wrinkling=False)
TENSED = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=0.7)
TENSED_FABRIC = OrthotropicMembrane(
    1394.0, 140.0, 12.0, 0.065, 1.0, warp=(1.0, 0.4, 0.3), prestress=(2.0, 1.0)
)
WARM = replace(TENSED, expansion=1e-3, dT=60.0)
"""Heated: wrinkled or slack where it is not stretched by 6 % more than its prestress."""
WARM_FABRIC = replace(TENSED_FABRIC, expansion=(8e-4, -3e-4), dT=50.0)
MATERIALS = {
    "relaxed": ISOTROPIC,
    "relaxed, prestressed": TENSED,
    "relaxed, warm": WARM,
    "orthotropic, warm": WARM_FABRIC,
    "raw": STIFF,
    "orthotropic": FABRIC,
    "orthotropic, prestressed": TENSED_FABRIC,
    "orthotropic, raw": STIFF_FABRIC,
}
every_material = pytest.mark.parametrize("material", MATERIALS.values(), ids=MATERIALS.keys())

TRIANGLE = np.array([(1.0, 2.0, 0.5), (9.0, 1.0, 1.0), (6.0, 8.0, -1.0)])
"""An acute triangle in space."""


def grid_points() -> Array:
    """Vertices (N + 1, N + 1, 2) by column and row, those inside shifted at random."""
    line = np.linspace(0, SIDE, N + 1)
    points = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)
    shift = np.random.default_rng(5).uniform(-0.25, 0.25, (N - 1, N - 1, 2))
    points[1:-1, 1:-1] += shift * SIDE / N
    return points


def irregular_square(comm: MPI.Intracomm, lift: float = 0.0, ranks: Any = None) -> MembraneMesh:
    """A square with parts "left" and "right", lifted like a dome."""
    turned = np.random.default_rng(6).random((N, N)) < 0.5
    cells = triangles(numbered(N + 1, N + 1), turned)
    points = grid_points().reshape(-1, 2)
    x, y = points.T / SIDE
    height = lift * 16 * x * (1 - x) * y * (1 - y)
    half = len(cells) // 2
    parts = {"left": np.arange(half), "right": np.arange(half, len(cells))}
    return from_arrays(comm, np.column_stack([points, height]), cells, parts=parts, ranks=ranks)


def cable_square(
    comm: MPI.Intracomm,
    material: MembraneMaterial = ISOTROPIC,
    *,
    taut: bool = True,
    ranks: Any = None,
    **choices: object,
) -> System:
    """The square with an oblique cable, one beside it on the same edges that ends on the membrane,
    and one through vertices, partly along an edge."""
    scene = Scene(irregular_square(comm, ranks=ranks), material, **choices)  # type: ignore[arg-type]
    scene.fix("boundary")
    tension = 20.0 if taut else None
    points = grid_points()
    scene.lay_cable(Cable(32000.0), [(0, 31), (SIDE, 52)], tension=tension)
    scene.lay_cable(Cable(20000.0), [(22, 42), (78, 52)], tension=tension)
    through = [points[1, 5], points[2, 5], points[4, 5], (SIDE, 93)]
    scene.lay_cable(Cable(10000.0), through, tension=tension)
    scene.air.update(pressure=0.01)
    system = System(scene, "crms_test_", 1e-8)
    system.read_scene()
    return system


def on_mesh(system: System, *names: str) -> OnMesh:
    """The system's terms of these class names, all if none is given."""
    terms = system.potential.terms
    chosen = [term for term in terms if not names or type(term).__name__ in names]
    assert len(chosen) >= len(names), f"{names} not all in {terms}"
    return OnMesh(system.unknowns, system.scene.u, chosen)


def corners(scene: Scene) -> tuple[Array, Array]:
    """Stress-free and current corners of this rank's cells, each (n, 3, 3)."""
    mesh = scene.mesh.mesh
    own = mesh.topology.index_map(2).size_local
    dofs = scene.V.dofmap.list[:own]
    return mesh.geometry.x[geometry_dofmap(mesh)[:own]], scene.positions()[dofs]


def displaced(unknowns: Unknowns, size: float, stretch: float = 1.05, seed: int = 0) -> Array:
    """Displacements (n, 3) of the owned points: stretched about the corner, then shaken.

    Held cable points are pulled off, as an anchor on its vertex has no direction to it.
    """
    X = unknowns.X[: unknowns.n_owned]
    x = (stretch - 1) * X + size * noise(X, seed)
    cable = np.arange(unknowns.n_owned) >= unknowns.n_vertices
    x[cable & unknowns.held[: unknowns.n_owned].all(axis=1)] += (-4.0, 3.0, 5.0)
    return x


def straight(system: System) -> Array:
    """Displacements of a bent surface whose fold points stay on the straight sides."""
    unknowns, numbering = system.unknowns, system.cables.numbering
    x = unknowns.vector()[1]
    vertices = unknowns.vertex_blocks()
    x[vertices] = 3 * noise(unknowns.X[vertices], 1)
    for (c, k), number in numbering.numbers.items():
        block, cable = numbering.blocks[number], system.scene.cables[c]
        if block >= 0 and cable.state.nodes[k].kind == "fold":
            (a, b), (wa, wb) = cable.state.nodes[k].interpolation()
            x[block] = wa * x[numbering.vertex(a)] + wb * x[numbering.vertex(b)]
    owned: Array = x[: unknowns.n_owned].copy()
    return owned


def directions(unknowns: Unknowns) -> dict[str, Array]:
    """Random directions (n, 3) of all points, of the vertices and of the cables' points."""
    d = noise(unknowns.X[: unknowns.n_owned], seed=99)
    vertices, points = d.copy(), d.copy()
    vertices[unknowns.n_vertices :] = 0.0
    points[: unknowns.n_vertices] = 0.0
    return {"all": d, "vertices": vertices, "points": points}


def rotation() -> Array:
    """Some rotation in space, (3, 3)."""
    q, r = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    proper: Array = q * np.sign(np.linalg.det(q))
    return proper


def moved(unknowns: Unknowns, x: Array) -> Array:
    """Displacements after a rigid motion of the shape with displacements x."""
    X = unknowns.X[: unknowns.n_owned]
    places: Array = (X + x) @ rotation().T + (7.0, -3.0, 11.0)
    return places - X
