"""Cells with stress-free shapes of their own, against the same membrane on its stress-free mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import ufl
from mpi4py import MPI
from term_scene import FABRIC

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    UflMembrane,
    meshes,
    taylor_test,
)
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.foundation.meshes.membrane_mesh import cell_vertex_ids, gathered
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

Array = np.ndarray[Any, Any]

FILM = IsotropicMembrane(E=100.0, nu=0.3, thickness=1.0)
SOFT = OrthotropicMembrane(E1=90.0, E2=60.0, G12=8.0, nu21=0.2, thickness=1.0)


def bent(X: Array) -> Array:
    """A shape of the plane, stretched by some per cent and curved (3, n)."""
    x, y, _ = X
    return np.array([1.04 * x + 0.02 * y**2, 1.03 * y, 0.3 * x * (2.0 - x) * y])


def plan(comm: MPI.Intracomm) -> meshes.MembraneMesh:
    return meshes.rectangle(comm, 2.0, 1.5, 0.3)


def twins(comm: MPI.Intracomm, material: Any) -> tuple[Scene, Scene]:
    """A scene of a flat sheet that has been bent, and one of the bent sheet with flat cells."""
    flat = plan(comm)
    one = Scene(flat, material)
    X = one.membrane.stress_free
    one.u.x.array[:] = (bent(X.T).T - X).ravel()
    surface = comm.bcast(gathered(flat)[0])
    curved = meshes.from_arrays(comm, bent(surface.points.T).T, surface.cells)
    other = Scene(curved, material, frames=frames_of(curved, surface.points))
    return one, other


def frames_of(curved: meshes.MembraneMesh, flat: Array) -> Array:
    """Images of the axes x and y in the cells of a bent mesh, whose vertices were flat."""
    X = flat[cell_vertex_ids(curved.mesh)][:, :, :2]
    x = curved.mesh.geometry.x[geometry_dofmap(curved.mesh)]
    before = np.stack([X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]], axis=1)
    after = np.stack([x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]], axis=1)
    return np.linalg.solve(before, after)


def shape(scene: Scene) -> Array:
    """Places of all vertices, by their numbers in the mesh as it was given."""
    membrane = scene.membrane
    found = np.zeros((membrane.V.dofmap.index_map.size_global, 3))
    for ids, places in scene.comm.allgather((membrane.vertex_ids, scene.positions())):
        found[ids] = places
    return found


def loaded(scene: Scene, cable: bool) -> Solver:
    """Under its weight, pressure and perhaps a cable that folds cells."""
    solver = prepared(scene, cable)
    solver.advance(pressure=0.5, load={"weight": 1.0})
    return solver


def prepared(scene: Scene, cable: bool) -> Solver:
    """Before."""
    scene.fix("boundary")
    scene.put_load((0.0, 0.0, -0.3), name="weight", per="material")
    if cable:
        ends = [(-0.2, 0.7, 0.05), (2.3, 0.8, 0.05)]
        scene.lay_cable(Cable(EA=50.0), ends, tension=0.4, hold="sleeve", measured_on="facets")
    return Solver(scene)


@pytest.mark.ranks
@pytest.mark.parametrize("cable", [False, True])
@pytest.mark.parametrize("wrinkling", [False, True])
@pytest.mark.parametrize("kind", ["isotropic", "orthotropic"])
def test_own_shapes_are_the_stress_free_mesh(
    comm: MPI.Intracomm, kind: str, wrinkling: bool, cable: bool
) -> None:
    """The same equilibrium, forces, strains, areas and estimated error."""
    material = replace(FILM if kind == "isotropic" else SOFT, wrinkling=wrinkling)
    one, other = twins(comm, material)
    solvers = [loaded(scene, cable) for scene in (one, other)]
    order = cells_in_order(solvers[0].scene), cells_in_order(solvers[1].scene)
    np.testing.assert_allclose(*(shape(s.scene) for s in solvers), atol=2e-8)
    results = [solver.results() for solver in solvers]
    for name in ("warp_weft", "second_piola_warp_weft", "strains", "areas", "stress_free_areas"):
        if kind == "isotropic" and "warp" in name:
            continue  # along the first side of each cell
        a, b = (in_order(comm, getattr(r, name), o) for r, o in zip(results, order, strict=True))
        np.testing.assert_allclose(a, b, atol=3e-6 * np.abs(a).max(), err_msg=name)
    a, b = (solver.scene.energies["membrane"] for solver in solvers)
    assert a == pytest.approx(b, rel=1e-7)
    a, b = (solver.estimate_error().total for solver in solvers)
    assert b < a < 2.0 * b  # on the bent mesh averages are those of tilted facets


@pytest.mark.ranks
def test_laws_of_ones_own(comm: MPI.Intracomm) -> None:
    """A sheet of rubber: the same equilibrium as on its stress-free mesh."""
    one, other = twins(comm, UflMembrane(neo_hookean))
    solvers = [loaded(scene, cable=False) for scene in (one, other)]
    np.testing.assert_allclose(*(shape(s.scene) for s in solvers), atol=2e-8)
    a, b = (solver.scene.energies["membrane"] for solver in solvers)
    assert a == pytest.approx(b, rel=1e-7)


def neo_hookean(E: Any) -> Any:
    """Incompressible, in plane stress."""
    C = ufl.Identity(2) + 2 * E
    return 10.0 * (ufl.tr(C) + 1 / ufl.det(C) - 3)


def cells_in_order(scene: Scene) -> Array:
    """Numbers of this rank's cells in the mesh as it was given."""
    mesh = scene.mesh.mesh
    n = mesh.topology.index_map(2).size_local
    return np.asarray(mesh.topology.original_cell_index[:n])


def in_order(comm: MPI.Intracomm, values: Array, ids: Array) -> Array:
    """Values of all ranks' cells in the order of the given mesh."""
    parts = comm.allgather((ids, values))
    found = np.zeros((sum(len(i) for i, _ in parts), *values.shape[1:]))
    for i, v in parts:
        found[i] = v
    return found


@pytest.mark.ranks
@pytest.mark.parametrize("material", [FILM, SOFT, FABRIC])
def test_taylor_expansions(comm: MPI.Intracomm, material: Any) -> None:
    """Cells that are pulled by a third on the mean, each by its own strain, stay taut."""
    mesh = plan(comm)
    rng = np.random.default_rng(comm.rank)
    u = Scene(mesh, material).u
    n = len(geometry_dofmap(mesh.mesh))
    frames = rng.uniform(-0.05, 0.05, (n, 2, 3)) + 1.35 * np.eye(3)[:2]
    frames[:, :, 2] = 0.0
    rates = taylor_test(MembraneEnergy(u, {0: material}, None, frames), u)
    assert rates.gradient > 1.9 and rates.stiffness is not None and rates.stiffness > 2.9


@pytest.mark.ranks
def test_what_knows_the_mesh_only_is_refused(comm: MPI.Intracomm) -> None:
    mesh = plan(comm)
    n = len(geometry_dofmap(mesh.mesh))
    axes = np.tile(np.eye(3)[:2], (n, 1, 1))
    with pytest.raises(InputError, match="total"):
        Scene(mesh, IsotropicMembrane(1.0, 0.3, 1.0, wrinkling=False), strain="step", frames=axes)
    for wrong in (axes[:, ::-1], axes[:, :1], axes * np.nan, np.roll(axes, 1, axis=2)):
        with pytest.raises(InputError, match="frames"):
            Scene(mesh, FILM, frames=wrong)


@pytest.mark.ranks
def test_checkpoints_know_the_shapes(comm: MPI.Intracomm, tmp_path_factory: Any) -> None:
    """A scene whose cells have other shapes is another one."""
    folder = comm.bcast(tmp_path_factory.mktemp("shapes") if comm.rank == 0 else None)
    _, scene = twins(comm, FILM)
    solver = loaded(scene, cable=False)
    solver.save(folder / "one")
    _, again = twins(comm, FILM)
    prepared(again, cable=False).load(folder / "one")
    assert again.membrane.frames is not None
    other = Scene(again.mesh, FILM, frames=1.001 * again.membrane.frames)
    with pytest.raises(InputError, match="shapes"):
        prepared(other, cable=False).load(folder / "one")
