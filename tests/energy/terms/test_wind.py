"""Wind: forces cell by cell, the exact follower pressure, its own fixed point, folded cells, bad
input."""

from dataclasses import replace

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from taylor import gradient_order, noise, stiffness_error
from term_scene import (
    ISOTROPIC,
    SIDE,
    cable_square,
    corners,
    directions,
    displaced,
    irregular_square,
    on_mesh,
)

from crms_fenicsx import Cable, InputError, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads
from crms_fenicsx.model.membrane_load import wind_load


def gusty(points, normals):
    return 0.3 - np.sin(points[0] / 30) * normals[2]


def forces_one_by_one(scene, pressure, coefficients):
    """The slow twin of `wind_load`: cell after cell; a positive coefficient presses inwards."""
    forces = np.zeros((len(scene.held), 3))
    _, now = corners(scene)
    for dofs, (a, b, c), cp in zip(scene.V.dofmap.list, now, coefficients, strict=False):
        for dof in dofs:
            forces[dof] -= pressure * cp * np.cross(b - a, c - a) / 6
    return forces


def test_forces_turn_with_the_cells(comm):
    """Coefficients are those of the shape at first, normals and areas of that which comes."""
    scene = clamped(irregular_square(comm, 20.0))
    X = scene.V.tabulate_dof_coordinates()
    scene.u.x.array[:] = 3.0 * noise(X, 4).ravel()
    load = wind_load(scene.membrane, 0.7, gusty)
    _, now = corners(scene)
    vectors = np.cross(now[:, 1] - now[:, 0], now[:, 2] - now[:, 0])
    normals = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    cp = gusty(now.mean(axis=1).T, normals.T)
    np.testing.assert_allclose(load.forces, forces_one_by_one(scene, 0.7, cp), atol=1e-10)
    scene.u.x.array[:] = 5.0 * noise(X, 7).ravel()
    assert load.with_current_normals(scene.membrane) is load, "wind that does not blow"
    turned = replace(load, factor=2.0).with_current_normals(scene.membrane)
    np.testing.assert_allclose(turned.forces, forces_one_by_one(scene, 0.7, cp), atol=1e-10)


def under_suction(comm, size, cable, **loads):
    """The top, and the cable's tension if there is one."""
    scene = clamped(meshes.rectangle(comm, SIDE, SIDE, size))
    scene.put_wind(0.01, -1.0)
    solver = advanced(Solver(scene), pressure=0.004)
    if cable:
        scene.lay_cable(Cable(32000.0), [(0, 31), (SIDE, 52)], L0=1.02 * SIDE, name="rope")
    solver.advance(**loads, steps=2)
    top = comm.allreduce(float(scene.positions()[:, 2].max()), MPI.MAX)
    return np.array([top, scene.cable("rope").tension if cable else 1.0])


def test_uniform_suction_is_the_pressure(comm):
    """Its exact forces are known: the same shape to the solver's tolerance."""
    found = under_suction(comm, 10.0, False, load=0.6)
    exact = under_suction(comm, 10.0, False, pressure=0.01)
    np.testing.assert_allclose(found, exact, rtol=1e-8)


@pytest.mark.ranks
def test_uniform_suction_under_a_cable_is_the_pressure(comm):
    """It acts on the facets of folded cells, and on the points between them."""
    found = under_suction(comm, 12.0, True, load=0.6)
    exact = under_suction(comm, 12.0, True, pressure=0.01)
    np.testing.assert_allclose(found, exact, rtol=1e-7)


def test_parts_have_coefficients_of_their_own(comm):
    """A hall's walls and roof: the resultant is that of the known areas and normals."""
    points = [(0, 0, 0), (4, 0, 0), (4, 6, 0), (0, 6, 0), (0, 0, 3), (0, 6, 3)]
    cells = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (0, 5, 4)]
    mesh = meshes.from_arrays(comm, points, cells, parts={"floor": [0, 1], "wall": [2, 3]})
    scene = Scene(mesh, ISOTROPIC)
    scene.put_wind(0.5, {"floor": -0.8, "wall": 0.6})
    total = comm.allreduce(scene.load("wind").forces.sum(axis=0))
    _, now = corners(scene)
    n = np.cross(now[:, 1] - now[:, 0], now[:, 2] - now[:, 0]).sum(axis=0)
    n = comm.allreduce(n)  # 48 along z, 36 along x, with the sign of the mesh's outer side
    np.testing.assert_allclose(np.abs(n), [36.0, 0.0, 48.0], atol=1e-9)
    expected = [-0.5 * 0.6 * n[0] / 2, 0.0, 0.5 * 0.8 * n[2] / 2]
    np.testing.assert_allclose(total, expected, atol=1e-9)


@pytest.mark.ranks
def test_supports_carry_the_wind_of_the_shape_that_it_leads_to(comm):
    """Reactions against the integral over the final shape, in one step and in three."""
    tops = []
    for steps in (1, 3):
        scene = clamped(irregular_square(comm, 20.0))
        solver = advanced(Solver(scene), pressure=0.005)
        scene.put_wind(0.003, gusty, name="gust")
        cp = -scene.load("gust").suction / 0.003
        solver.advance(load={"gust": 1.5}, steps=steps)
        _, now = corners(scene)
        vectors = np.cross(now[:, 1] - now[:, 0], now[:, 2] - now[:, 0])[: len(cp)] / 2
        blown = ((0.005 - 0.0045 * cp)[:, None] * vectors).sum(axis=0)
        reaction = solver.reactions("boundary").total
        np.testing.assert_allclose(reaction, -comm.allreduce(blown), atol=1e-6)
        assert solver.steps[-1].verification.passed
        tops.append(comm.allreduce(float(scene.positions()[:, 2].max()), MPI.MAX))
    assert tops[0] == pytest.approx(tops[1], rel=1e-8)


def test_wind_needs_the_exact_pressure(comm):
    scene = clamped(irregular_square(comm, 20.0), ISOTROPIC, pressure="step")
    scene.put_wind(0.01, -1.0)
    solver = Solver(scene)
    with pytest.raises(InputError, match=r"'wind' = 0.5.*pressure=\"total\""):
        solver.advance(load=0.5)
    solver.advance(pressure=0.005)


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("pressure", "coefficient", "message"),
    [
        (0.5, np.nan, "coefficient = nan is not finite"),
        (0.5, {"roof": 1.0}, "part 'roof'"),
        (0.5, {}, "name all parts"),
        (0.5, lambda x, n: n, r"shape \(3, "),
        (0.5, lambda x, n: np.where(x[0] > 70, np.inf, 1.0), "finite numbers"),
    ],
)
def test_bad_wind(comm, pressure, coefficient, message):
    scene = clamped(irregular_square(comm, 20.0))
    with pytest.raises(InputError, match=message):
        scene.put_wind(pressure, coefficient)
    assert len(scene.loads) == 0


Q, FACTOR = 0.02, 0.7


def gusts(points, normals):
    return 0.3 - np.sin(points[0] / 30)


def windy_square(comm, coefficient):
    """The square with three taut cables, in the wind."""
    scene = cable_square(comm).scene
    scene.put_wind(Q, coefficient)
    scene.loads.replace_each(lambda load: replace(load, factor=FACTOR))
    system = System(scene, "crms_wind_", 1e-8)
    system.read_scene()
    return system


def volume(points):
    """Volume under triangles (n, 3, 3), seen from the origin."""
    return np.einsum("ni,ni", points[:, 0], np.cross(points[:, 1], points[:, 2])) / 6


@pytest.mark.ranks
def test_derivatives(comm):
    system = windy_square(comm, gusts)
    f = on_mesh(system, "FoldedWind")
    x = displaced(f.unknowns, 2.0)
    exact = TermsWithDyads(system.unknowns, system.scene.u, f.potential.terms, exact=True)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, 0.1 * d) == pytest.approx(2, abs=0.03), name
        assert stiffness_error(exact, x, d, h=1e-5) < 2e-6, name


@pytest.mark.ranks
def test_facets_of_each_cell_close(comm):
    """So its forces balance each other, and the volume is the same from anywhere."""
    system = windy_square(comm, gusts)
    (term,) = (t for t in system.potential.terms if t.name == "wind")
    unknowns = system.unknowns
    x = np.random.default_rng(comm.rank).normal(size=unknowns.X.shape)
    places = (unknowns.X + 3.0 * x)[term.table.corners]
    vectors = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    cells = np.unique(term._cells)
    for cell in cells:
        own = term._cells == cell
        open_ = term._shares[own] @ vectors[own]
        np.testing.assert_allclose(open_, 0.0, atol=1e-11 * np.abs(vectors[own]).sum())
    assert comm.allreduce(len(cells)) > 20


def test_pressure_of_each_cell(comm):
    """It is the wind's at the load's factor."""
    system = windy_square(comm, gusts)
    (term,) = (t for t in system.potential.terms if t.name == "wind")
    load = system.scene.load("wind")
    expected = term._shares * FACTOR * load.suction[term._cells]
    np.testing.assert_allclose(term.table.weights, expected, rtol=1e-14)


def test_uniform_suction_has_the_volume_of_the_facets(comm):
    """With the triangles it is what pressure has, plain cells and folded ones."""
    system = windy_square(comm, -1.0)
    pressure = on_mesh(system, "FollowerPressure", "FoldedFollowerPressure")
    wind = on_mesh(system, "FoldedWind")
    x = displaced(wind.unknowns, 2.0)
    under = -pressure.value(x)[0] / system.scene.pressure
    depth = -wind.value(x)[0] / (Q * FACTOR)
    was, now = (places - system.scene.membrane.centre for places in corners(system.scene))
    triangles = comm.allreduce(float(volume(now) - volume(was)))
    assert abs(depth) > 1e-3 * abs(under)
    assert under == pytest.approx(triangles + depth, rel=1e-10)
