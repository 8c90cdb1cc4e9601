"""Wind on what cables fold: Taylor tests, closed cells, and the volume of the facets."""

from dataclasses import replace

import numpy as np
import pytest
from taylor import gradient_order, stiffness_error
from term_scene import cable_square, corners, directions, displaced, on_mesh

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.energy.minimization.taylor import TermsWithDyads

Q, FACTOR = 0.02, 0.7


def gusty(points, normals):
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
    system = windy_square(comm, gusty)
    f = on_mesh(system, "FoldedWind")
    x = displaced(f.unknowns, 2.0)
    exact = TermsWithDyads(system.unknowns, system.scene.u, f.potential.terms, exact=True)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, 0.1 * d) == pytest.approx(2, abs=0.03), name
        assert stiffness_error(exact, x, d, h=1e-5) < 2e-6, name


@pytest.mark.ranks
def test_facets_of_each_cell_close(comm):
    """So its forces balance each other, and the volume is the same from anywhere."""
    system = windy_square(comm, gusty)
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
    system = windy_square(comm, gusty)
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
