"""Stress-free places that move: all is then as in a scene on a mesh made with these places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from lined_roof import SIDE, STEEL, lined_roof, rise
from mpi4py import MPI
from same_state import assert_same_state

from crms_fenicsx import InputError, IsotropicMembrane, OrthotropicMembrane, Scene, Solver
from crms_fenicsx.analysis.scene.scene import place_stress_free
from crms_fenicsx.energy.terms.pressure import moved_volume, rim_of
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.meshes.membrane_mesh import MembraneMesh, moved
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap, with_nodes
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.results.error_estimate import ErrorEstimator

Q = 0.3
"""Pressure."""


def around(x: Array) -> Array:
    """Warp directions around a point below a corner."""
    return np.stack([-x[1] - 3.0, x[0] + 2.0, 0.0 * x[0]])


FABRIC = OrthotropicMembrane(
    E1=900.0, E2=600.0, G12=60.0, nu21=0.2, thickness=1.0, warp=around, prestress=(0.2, 0.1),
    wrinkling=True,
)  # fmt: skip
MATERIALS = {
    "tension field": FABRIC,
    "linear": IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, wrinkling=False),
    "wrinkling": IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=0.1),
}


ACROSS = "across"
"""Cable that crosses cells, and slides."""


def slid(scene: Scene, share: float = 1.0) -> Array:
    """Places of the vertices after a slide of up to .15 of a cell on the roof, none at the rim."""
    x, y, _ = scene.membrane.given.T
    inside = np.sin(np.pi * x / SIDE) * np.sin(np.pi * y / SIDE)
    x = x + share * 0.15 * inside * np.cos(1.7 * x + y)
    y = y + share * 0.15 * inside * np.sin(x - 2.1 * y)
    return np.stack([x, y, np.where(inside > 1e-9, rise(x, y), 0.0)], axis=1)


def displacement(scene: Scene) -> Array:
    """Some displacement, large enough to wrinkle and slacken cells."""
    x, y, _ = scene.membrane.given.T
    u = np.stack([0.03 * np.sin(2 * x + y), 0.02 * np.cos(x - y), 0.1 * np.sin(x) * np.cos(y)], 1)
    u[scene.held] = 0.0
    return u


def roofed(
    mesh: MembraneMesh, material: MembraneMaterial, cables: Sequence[str] = ("A1",)
) -> Solver:
    """The roof with loads by stress-free area, and cables on lines of its mesh or across cells."""
    scene = Scene(mesh, material)
    scene.fix("boundary")
    scene.put_load((0.02, -0.01, -0.05), name="weight", per="material")
    slope = np.array([[0.0], [0.0], [-0.02]])
    scene.put_load(lambda x, n: slope * x[0], name="more", per="material")
    for name in cables:
        if name == ACROSS:
            scene.lay_cable(STEEL, [(0.0, 6.3), (8.0, 6.6)], name=name)
        else:
            scene.lay_cable(STEEL, along=name, hold="pocket", name=name)
    return Solver(scene, rtol=1e-11)


def again(mesh: MembraneMesh) -> MembraneMesh:
    """The same mesh for another scene; made anew it may be distributed otherwise."""
    return replace(mesh, mesh=with_nodes(mesh.mesh, mesh.mesh.geometry.x.copy()), given=[])


def pair(
    comm: MPI.Intracomm, material: MembraneMaterial, make: Callable[..., Solver] = roofed
) -> tuple[Solver, Solver]:
    """A scene whose places are moved, and one made on a mesh with these places."""
    ours = make(lined_roof(comm), material)
    X = slid(ours.scene)
    place_stress_free(ours.scene, X)
    fresh = make(moved(ours.scene.mesh, ours.scene.V, X), material)
    np.testing.assert_array_equal(ours.scene.membrane.vertex_ids, fresh.scene.membrane.vertex_ids)
    return ours, fresh


def assert_close(found: Any, due: Any, rtol: float = 1e-12, scale: float = 0.0) -> None:
    size = max(float(np.abs(due).max(initial=0.0)), scale)
    np.testing.assert_allclose(found, due, rtol=rtol, atol=rtol * size)


@pytest.mark.ranks
@pytest.mark.parametrize("name", MATERIALS)
def test_energies_forces_and_stiffness_in_a_shape(comm: MPI.Intracomm, name: str) -> None:
    """Of all terms, at given displacements."""
    ours, fresh = pair(comm, MATERIALS[name])
    for solver in (ours, fresh):
        scene = solver.scene
        scene.remove_load("more")  # a function of places on the mesh as it was
        scene.u.x.array[:] = displacement(ours.scene).ravel()
        if scene is ours.scene:
            here = scene.membrane.at_places(prestress(scene), scene.membrane.given)
        else:
            assert np.abs(here - prestress(scene)).max(initial=1.0) > 1e-3
        scene.add_term(ResidualStress(scene.u, here))
        scene.loads.replace_each(lambda one: replace(one, factor=1.0))
        scene.air.update(pressure=Q)
        scene.cables[0].update(L0=7.9, taut=True)
        scene.versions.change_model()
    for solver in (ours, fresh):
        system = solver.system
        system.update()
        system.potential.evaluate()
    f, g = ours.system.potential, fresh.system.potential
    energies, expected = f.energies(), g.energies()
    gained = comm.allreduce(moved_volume(ours.scene.membrane, rim_of(ours.scene.membrane)))
    assert abs(gained) > 1e-3  # on these flat cells
    expected["pressure"] -= Q * gained  # the air's work counts from the first mesh
    scale = max(map(abs, expected.values()))
    assert energies.keys() == expected.keys()
    assert energies.keys() >= {"membrane", "pressure", "residual stress", "dead load", "cables"}
    for term, energy in expected.items():
        assert energies[term] == pytest.approx(energy, rel=1e-12, abs=1e-13 * scale), term
    # the pressure's part at the held rim depends on the origin of volumes
    n = f.unknowns.n_owned
    free = ~f.unknowns.held[:n]
    assert_close(f.g[:n][free], g.g[:n][free])
    assert ours.scene.volume == pytest.approx(fresh.scene.volume + gained, rel=1e-12)
    # H0 also has springs of the size of the forces at the rim
    for exact, rtol in ((True, 1e-12), (False, 1e-7)):
        found, due = (stiffness(one, exact).reshape(-1, 3)[free] for one in (ours, fresh))
        assert_close(found, due, rtol)


def prestress(scene: Scene) -> Array:
    """Section forces of this rank's cells, by their places in the mesh as given."""
    mesh = scene.mesh.mesh
    cells = scene.V.dofmap.list[: mesh.topology.index_map(2).size_local]
    number = scene.membrane.vertex_ids[cells].sum(axis=1)
    return np.einsum("n,ij->nij", 0.1 + 0.01 * (number % 7), np.diag([1.0, 2.0, 0.5]))


def stiffness(solver: Solver, exact: bool) -> Array:
    """H0 or the second derivatives times a vector, of this rank's blocks."""
    from crms_fenicsx.foundation.dofs.block_patterns import StiffnessMatrix

    potential = solver.system.potential
    matrix = StiffnessMatrix(potential.unknowns, potential.patterns())
    potential.add_stiffness(matrix, exact)
    matrix.assemble()
    x, y = matrix.petsc.createVecs()
    n = potential.unknowns.n_owned
    x.array[:] = np.sin(3.0 * potential.unknowns.X[:n]).ravel()
    matrix.petsc.mult(x, y)
    found = y.array.copy()
    matrix.destroy()
    return found


def steps(solver: Solver) -> None:
    """Inflate the roof and tighten its cables."""
    solver.advance(pressure=Q, load={"weight": 1.0})
    solver.advance(L0={cable: 0.998 * cable.L0 for cable in solver.scene.cables})


@pytest.mark.ranks
@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("cables", [("A1", "B1"), ("A1", ACROSS)], ids=["on lines", "across cells"])
def test_results_of_a_state(comm: MPI.Intracomm, name: str, cables: Sequence[str]) -> None:
    """Moved between two load steps, the scene finds a state that is one of the other mesh, too,
    with the same results."""
    first = roofed(lined_roof(comm), MATERIALS[name], cables)
    first.advance(pressure=0.5 * Q)
    estimator = ErrorEstimator(first.scene)
    place_stress_free(first.scene, slid(first.scene))
    steps(first)
    assert estimator.of(first.system).total == first.estimate_error().total
    scene = first.scene
    mesh = moved(scene.mesh, scene.V, scene.membrane.stress_free)
    other = roofed(mesh, MATERIALS[name], cables)
    take_over(other.scene, scene)
    other.system.update()
    other.system.write_scene()
    other.scene.versions.settle(other.scene.membrane.owned_u, None)
    assert_same_results(first, other)


def take_over(scene: Scene, of: Scene) -> None:
    """Bring a scene to the shape, loads and cables of another one."""
    scene.u.x.array[:] = of.u.x.array
    scene.air.update(pressure=of.pressure)
    scene.loads.replace_each(lambda one: replace(one, factor=of.factors[one.name]))
    states = dict(zip(scene.cables, (cable.state for cable in of.cables), strict=True))
    scene.net.state = replace(of.net.state, cables=states)
    scene.versions.change_model()


def assert_same_results(ours: Solver, fresh: Solver) -> None:
    """Energies, tables, reactions, tensions, contact forces and error estimate."""
    a, b = ours.scene, fresh.scene
    n = a.V.dofmap.index_map.size_local
    assert_close(a.positions(), b.positions())
    assert_close([cable.tension for cable in a.cables], [cable.tension for cable in b.cables])
    scale = max(map(abs, b.energies.values()))
    for name in b.energies:
        if name != "pressure":
            assert a.energies[name] == pytest.approx(b.energies[name], abs=1e-12 * scale), name
    one, other = ours.results(), fresh.results()
    values = [(one.values(name), other.values(name)) for name in other.names]
    values += [(one.stress_free_areas, other.stress_free_areas), (one.areas, other.areas)]
    for smooth in (False, True):
        here, there = (found.at([(2.1, 3.3), (5.2, 4.4)], smooth=smooth) for found in (one, other))
        values += [(here[name], there[name]) for name in other.names]
        values.append((here.stress_free, there.stress_free))
    for found, due in values:
        assert_close(np.nan_to_num(found), np.nan_to_num(due), 1e-10, 1.0)
    assert one.shares() == pytest.approx(other.shares(), abs=1e-12)
    estimate, due_estimate = ours.estimate_error(), fresh.estimate_error()
    assert estimate.total == pytest.approx(due_estimate.total, rel=1e-10)
    assert_close(estimate.cells, due_estimate.cells, 1e-10)
    assert_close(ours.summary().reaction, fresh.summary().reaction, 1e-12, 1.0)
    assert_close(
        ours.residual().membrane.x.array[: 3 * n],
        fresh.residual().membrane.x.array[: 3 * n],
        1e-12,
        1.0,
    )
    for cable, twin in zip(a.cables, b.cables, strict=True):
        forces, expected = ours.contact_forces(cable), fresh.contact_forces(twin)
        for name in ("normal", "lateral", "bearing", "line"):
            one_of, due_of = getattr(forces, name), getattr(expected, name)
            assert_close(np.nan_to_num(one_of), np.nan_to_num(due_of), 1e-11, twin.tension)


@pytest.mark.ranks
def test_loads_by_stress_free_area_follow(comm: MPI.Intracomm) -> None:
    """Also those of a function, whose values are those of the places that cells come to, and those
    per current area; those on vertices stay as they are."""
    scene = roofed(lined_roof(comm), FABRIC).scene
    scene.put_load((0.0, 0.0, -0.1), name="snow", per="plan")
    forces = fem.Function(scene.V)
    forces.x.array[:] = 0.1
    scene.put_forces(forces)
    areas, before = scene.membrane.cell_areas, {load.name: load for load in scene.loads}
    place_stress_free(scene, slid(scene))
    fresh = roofed(moved(scene.mesh, scene.V, scene.membrane.stress_free), FABRIC).scene
    assert_close(scene.load("weight").forces, fresh.load("weight").forces)
    assert np.abs(scene.load("weight").forces - before["weight"].forces).max(initial=1.0) > 1e-3
    assert scene.load("forces") is before["forces"]
    assert not np.allclose(areas, scene.membrane.cell_areas) or len(areas) == 0
    fresh.put_load((0.0, 0.0, -0.1), name="snow", per="plan")
    for name, rel in (("more", 2e-3), ("snow", 2e-2)):
        found, due = scene.load(name), fresh.load(name)
        first = before[name]
        assert found.put is first and found.material is not None and first.material is not None
        assert due.material is not None
        assert_close(found.material, due.material, rel)
        if name == "more":
            away = float(np.abs(first.material - due.material).max(initial=0.0))
            assert comm.allreduce(away, op=MPI.MAX) > 5 * rel * 0.02 * SIDE
        total = comm.allreduce((scene.membrane.cell_areas[:, None] * found.material).sum(axis=0))
        assert_close(comm.allreduce(found.forces.sum(axis=0)), total)
    place_stress_free(scene, scene.membrane.given)
    for name in ("weight", "more", "snow"):
        assert_close(scene.load(name).forces, before[name].forces)


@pytest.mark.ranks
def test_air_keeps_its_volume(comm: MPI.Intracomm) -> None:
    """Where only stress-free places move, in the same shape, its volume and energy stay: volumes
    count from the mesh as given. So does the pressure of sealed air."""
    solver = roofed(lined_roof(comm), MATERIALS["linear"], (ACROSS,))
    scene = solver.scene
    solver.advance(pressure=Q, L0={scene.cables[0]: 8.1})
    scene.seal(volume=60.0, atmosphere=100.0)
    solver.advance()
    found: list[tuple[float, float, float]] = []
    for move in (False, True):
        if move:
            x, X = scene.positions(), slid(scene)
            place_stress_free(scene, X)
            assert abs(scene.volume - found[0][0]) > 1e-3
            scene.u.x.array[:] = (x - scene.membrane.stress_free).ravel()
        system = solver.system
        system.update()
        system.write_scene()
        found.append((scene.volume, scene.energies["pressure"], scene.pressure))
    assert scene.membrane.moved is not None and scene.cables[0].taut
    assert found[1] == pytest.approx(found[0], rel=1e-12)


@pytest.mark.ranks
def test_water_wind_and_floor_find_the_other_mesh(comm: MPI.Intracomm) -> None:
    """Load steps after the move end where those of a scene on the other mesh do."""
    ends = []
    mesh = lined_roof(comm)
    for move in (True, False):
        solver = roofed(mesh, MATERIALS["linear"], ())
        scene = solver.scene
        scene.put_pond(1.0, level=0.3)
        scene.floor(-0.02)
        if move:
            X = slid(scene)
            place_stress_free(scene, X)
            mesh = moved(scene.mesh, scene.V, X)
        scene.put_wind(0.2, -0.8)
        solver.advance(pressure=Q, load={"wind": 1.0, "pond": 1.0, "weight": 1.0})
        energies = [energy for name, energy in scene.energies.items() if name != "pressure"]
        ends.append((scene.positions(), energies, scene.ponds[0].volume))
    for found, due in zip(*ends, strict=True):
        assert_close(found, due, 1e-8)


@pytest.mark.ranks
def test_scales_and_origins_are_those_of_the_mesh_as_given(comm: MPI.Intracomm) -> None:
    mesh = lined_roof(comm)
    scene, same = (roofed(again(mesh), FABRIC).scene for _ in range(2))
    given, before = scene.membrane.given.copy(), scene.mesh.mesh.geometry.x.copy()
    assert scene.membrane.state.moved is None and scene.membrane.placement == 0
    X, strip = slid(scene), scene.net.strip_shape()
    place_stress_free(scene, X)
    assert np.abs(scene.net.strip_shape().stress_free - strip.stress_free).max() > 0.01
    membrane = scene.membrane
    np.testing.assert_allclose(membrane.stress_free, X, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(membrane.given, given)
    assert membrane.size == same.membrane.size
    np.testing.assert_array_equal(membrane.centre, same.membrane.centre)
    nodes = scene.mesh.mesh.geometry.x[geometry_dofmap(scene.mesh.mesh)]
    np.testing.assert_array_equal(nodes, membrane.stress_free[scene.V.dofmap.list])
    assert np.abs(scene.mesh.mesh.geometry.x - before).max() > 0.1


@pytest.mark.ranks
def test_snapshots_restore_the_places(comm: MPI.Intracomm) -> None:
    """Back and forth between states whose places are those given, moved, and moved farther; load
    steps from there are the same."""
    solver = roofed(lined_roof(comm), FABRIC, ("A1", "B1"))
    scene = solver.scene
    geometry = scene.mesh.mesh.geometry.x
    kept, rows, ends = [], [], []
    for share in (0.0, 0.6, 1.0):
        if share:
            place_stress_free(scene, slid(scene, share))
        solver.advance(pressure=Q, load={"weight": 1.0})
        kept.append(solver.snapshot())
        rows.append((geometry.copy(), scene.membrane.stress_free, scene.membrane.cell_areas))
        solver.advance(pressure=0.8 * Q)
        ends.append(scene.state)
        solver.restore(kept[-1])
    assert kept[0].membrane.moved is None
    for k in (0, 2, 1, 0, 2):
        solver.restore(kept[k])
        assert_same_state(scene.state, kept[k])
        for found, due in zip(
            (geometry, scene.membrane.stress_free, scene.membrane.cell_areas), rows[k], strict=True
        ):
            np.testing.assert_array_equal(found, due)
        solver.advance(pressure=0.8 * Q)
        assert_same_state(scene.state, ends[k], rtol=1e-8)
    with solver.branch("farther"):
        place_stress_free(scene, slid(scene, 0.3))
        solver.advance(pressure=Q)
    np.testing.assert_array_equal(geometry, rows[2][0])


def assert_same_but_shares(one: Scene, other: Scene, rtol: float = 0.0) -> None:
    """Equal states; of loads, which files keep in sums over the ranks, the same sums."""
    assert_same_state(one.state, other.state, but=("loads",), rtol=rtol)
    for load, twin in zip(one.loads, other.loads, strict=True):
        found, due = (one.comm.allreduce(some.forces.sum(axis=0)) for some in (load, twin))
        assert_close(found, due)
        assert load.material is not None and twin.material is not None
        np.testing.assert_array_equal(load.material, twin.material)


@pytest.mark.ranks
def test_checkpoints_keep_the_places(comm: MPI.Intracomm, folder: Path) -> None:
    """They are read into a scene on the mesh as given, and the run goes on."""
    mesh = lined_roof(comm)
    solver = roofed(again(mesh), FABRIC, ("A1", ACROSS))
    scene = solver.scene
    solver.advance(pressure=0.5 * Q)
    place_stress_free(scene, slid(scene))
    solver.advance(pressure=Q, load={"weight": 1.0, "more": 0.5})
    solver.save(folder / "moved")
    other = roofed(mesh, FABRIC, ("A1", ACROSS))
    other.load(folder / "moved")
    assert_same_but_shares(other.scene, scene)
    read, due = (one.mesh.mesh.geometry.x for one in (other.scene, scene))
    np.testing.assert_array_equal(read, due)
    for one in (solver, other):
        one.advance(load={"weight": 2.0})
    assert_same_but_shares(other.scene, scene, 1e-8)
    on_moved = moved(scene.mesh, scene.V, scene.membrane.stress_free)
    with pytest.raises(InputError, match=r"of another (mesh|scene: warp)"):
        roofed(on_moved, FABRIC, ("A1", ACROSS)).load(folder / "moved")


@pytest.mark.ranks
def test_calls_are_restored_with_the_places(comm: MPI.Intracomm, folder: Path) -> None:
    """The second run restores them all, from the journal."""
    mesh, kept = lined_roof(comm), []
    for resume in (False, True):
        scene = roofed(again(mesh), FABRIC).scene
        solver = Solver(scene, rtol=1e-11, results=folder / "out", resume=resume)
        solver.advance(pressure=0.5 * Q)
        place_stress_free(scene, slid(scene))
        solver.advance(pressure=Q)
        kept.append(scene)
    assert_same_but_shares(kept[0], kept[1])
    first, second = (scene.mesh.mesh.geometry.x for scene in kept)
    np.testing.assert_array_equal(first, second)


def test_what_cannot_be_moved() -> None:
    """Named, with what to do instead; nothing has moved then."""
    stepwise = Scene(lined_roof(MPI.COMM_SELF), MATERIALS["linear"], strain="step")
    with pytest.raises(InputError, match="step-wise laws"):
        place_stress_free(stepwise, slid(stepwise))
    assert stepwise.membrane.moved is None


def test_scenes_of_one_mesh_move_apart(comm: MPI.Intracomm) -> None:
    """Each has the places as given until it moves its own."""
    mesh, linear = lined_roof(comm), MATERIALS["linear"]
    first, second = Scene(mesh, linear), Scene(mesh, linear)
    for moves, other in ((first, second), (second, first)):
        before = other.mesh.mesh.geometry.x.copy()
        place_stress_free(moves, slid(moves))
        np.testing.assert_array_equal(other.mesh.mesh.geometry.x, before)
        third = Scene(mesh, linear)
        np.testing.assert_array_equal(third.membrane.stress_free, first.membrane.given)
    np.testing.assert_array_equal(first.membrane.moved, second.membrane.moved)
