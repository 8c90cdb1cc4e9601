"""Estimated errors of the energy against true ones."""

import numpy as np
import pytest
from cabled_square import advanced, clamped
from dome import HEIGHT, RADIUS, dome

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes, nets

pytestmark = pytest.mark.usefixtures("comm")

FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
CIRCLE, SQUARE = -2908.73474049, -375.64923
"""Energies in the continuum: of an ordinary differential equation, of independent programs."""


def inflated(mesh, **how):
    scene = clamped(mesh, FABRIC)
    return advanced(Solver(scene, **how), pressure=0.01)


def square(comm, cells, **how):
    return meshes.rectangle(comm, 100.0, 100.0, 100.0 / cells, structured=True, **how)


def effectivity(solver, truth):
    return solver.estimate_error().total / (solver.scene.energy - truth)


def test_circle(comm):
    """Of the true error half is that of the polygon, which an estimate on it cannot see."""
    for size in (30.0, 15.0):
        assert 0.4 < effectivity(inflated(meshes.circle(comm, 100.0, size)), CIRCLE) < 1.0


def test_square(comm):
    for cells, off in ((4, 0.3), (8, 0.1), (16, 0.03)):
        assert abs(effectivity(inflated(square(comm, cells)), SQUARE) - 1) < off


@pytest.mark.parametrize("y", [50.0, 41.0])
def test_cable_on_lines_and_across_cells(comm, y):
    """Folds and creases of the mesh under cables are no errors; W of the finest mesh, refined."""
    truth = {50.0: 8.469, 41.0: 12.371}[y]
    for cells, least in ((4, 0.35), (8, 0.6)):
        solver = inflated(square(comm, cells))
        path = [(-80.0, y, 0.0), (180.0, y, 0.0)]
        cable = solver.scene.lay_cable(Cable(EA=32000.0), path)
        solver.advance(move={cable: (0.0, 0.0, -15.0)})
        assert least < effectivity(solver, truth) < 1.2
        estimate = solver.estimate_error()
        folded = estimate.cells[solver.results().folded].sum()
        assert 0.0 < comm.allreduce(folded) < 0.3 * estimate.total


@pytest.mark.ranks
def test_cap_with_a_cable(comm):
    """The finest of its levels gives -31.102, with 0.01."""
    material = IsotropicMembrane(E=800e3, nu=0.3, thickness=1e-3)
    scene = clamped(dome(comm, 3.0), material)
    scene.lay_cable(Cable(EA=30e3), nets.great_circle(RADIUS, HEIGHT, 0.3, 0.0))
    solver = advanced(Solver(scene), pressure=0.4)
    assert 0.3 < effectivity(solver, -31.102) < 3.0


def test_states_that_a_mesh_has_exactly_have_no_error(comm):
    """A square that is stretched evenly, and one part of which is of another material."""
    x = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)]
    cells = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4)]
    stiff = IsotropicMembrane(E=900.0, nu=0.0, thickness=0.1)
    soft = IsotropicMembrane(E=300.0, nu=0.0, thickness=0.1)
    mesh = meshes.from_arrays(comm, x, cells, parts={"left": [0, 1], "right": [2, 3]})
    for materials in (soft, {"left": soft, "right": stiff}):
        scene = Scene(mesh, materials)
        scene.fix("boundary", "yz")
        scene.fix(lambda x: x[0] < 0.1, "x")
        scene.fix(lambda x: x[0] > 1.9, "x")
        scene.u.x.array[0::3] = 0.01 * scene.membrane.stress_free[:, 0]
        solver = advanced(Solver(scene))
        assert scene.energy > 0.0
        assert solver.estimate_error().total < 1e-9 * scene.energy


def test_history_has_columns_if_asked(comm):
    plain = inflated(square(comm, 4))
    assert "relative error" not in plain.history.columns
    asked = inflated(square(comm, 4), estimate=True)
    estimate = asked.estimate_error()
    assert asked.history["error of energy"][-1] == pytest.approx(estimate.total, rel=1e-12)
    assert asked.history["relative error"][-1] == pytest.approx(estimate.relative, rel=1e-12)
    strain_energy = asked.scene.energies["membrane"]
    assert estimate.relative == pytest.approx(estimate.total / strain_energy)


@pytest.mark.ranks
def test_shares_of_the_cells_do_not_depend_on_who_owns_them(comm):
    def scattered(midpoints):
        return np.random.default_rng(2).integers(0, comm.size, len(midpoints))

    totals = [
        inflated(square(comm, 5, **how), rtol=1e-10).estimate_error()
        for how in ({}, {"ranks": scattered})
    ]
    assert totals[1].total == pytest.approx(totals[0].total, rel=1e-8)
    assert comm.allreduce(totals[1].cells.sum()) == pytest.approx(totals[1].total)
    assert (totals[1].cells >= 0.0).all()
