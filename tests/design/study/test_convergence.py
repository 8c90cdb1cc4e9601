"""Studies of convergence of cases with known limits."""

from functools import partial

import numpy as np
import pytest
from cabled_square import advanced, clamped

from crms_fenicsx import (
    Cable,
    Friction,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.design.form_finding import FormCable, find_form
from crms_fenicsx.design.study import convergence
from crms_fenicsx.design.study.values import displacements

pytestmark = pytest.mark.usefixtures("comm")

SIDE = 100.0
FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)


def grid(comm, cells, **how):
    return meshes.rectangle(comm, SIDE, SIDE, SIDE / cells, structured=True, **how)


def square(mesh):
    """The clamped square under pressure."""
    scene = clamped(mesh, FABRIC)
    return advanced(Solver(scene, rtol=1e-10), pressure=0.01)


def test_square_of_which_the_energy_is_known(comm):
    """W = -375.649 and w = 10.1845 of independent programs, from 4 to 16 cells a side."""
    first = square(grid(comm, 4)).scene.energy
    study = convergence(square, grid(comm, 4), points={"middle": (50.0, 50.0, 0.0)})
    energy, w = study["energy"], study["displacement middle z"]
    assert study.cells == (32, 128, 512)
    assert energy.regular
    assert energy.order == pytest.approx(2.0, abs=0.15)
    for found, truth in ((energy, -375.64923), (w, 10.184544)):
        assert abs(found.limit - truth) <= found.bar
        assert found.bar < 0.12 * abs(found.values[0] - truth)
        assert abs(found.limit - truth) < 0.2 * abs(found.values[-1] - truth)
    assert energy.error >= abs(energy.values[0] + 375.64923)
    assert abs(study["displacement middle x"].limit) < 1e-6
    assert study.finest.scene.energy == energy.values[-1]
    assert first == pytest.approx(energy.values[0], rel=1e-12)
    assert len(study.seconds) == 3


def model_2(mesh):
    """A cable over the inflated square, just taut, that anchors beyond it pull down."""
    solver = square(mesh)
    path = [(-80.0, 50.0, 0.0), (180.0, 50.0, 0.0)]
    cable = solver.scene.lay_cable(Cable(EA=32000.0), path, name="ridge")
    solver.advance(move={cable: (0.0, 0.0, -15.0)})
    return solver


def test_cable_of_which_the_tension_is_known(comm):
    """The paper's model 2, T = 252.9913: lengths are measured on each level."""
    study = convergence(model_2, grid(comm, 5), reactions=["boundary"], quantities={"L0": length})
    tension = study["tension ridge"]
    assert abs(tension.limit - 252.9913) <= tension.bar
    assert tension.bar < 1.0
    text = study.table()
    assert text == repr(study)
    for word in ("tension ridge", "reaction boundary z", "L0", "800 cells"):
        assert word in text


def sail(mesh, tension):
    """A flat sail between four corners, found on the mesh itself."""
    corners = ["front left", "front right", "back right", "back left"]
    sides = ("front", "right", "back", "left")
    form = find_form(mesh, stress=2.0, fixed=corners,
                     cables=[FormCable(side, tension=tension) for side in sides])  # fmt: skip
    fabric = OrthotropicMembrane(E1=900.0, E2=600.0, G12=30.0, nu21=0.2, thickness=1.0)
    return advanced(Solver(form.scene(fabric, Cable(EA=8000.0))))


@pytest.mark.ranks
@pytest.mark.parametrize("tension", [25.0, 15.0])
def test_found_form_is_found_on_each_mesh(comm, tension):
    """Edges of a flat sail are arcs of radius T / s, with corners of 43 and 6 degrees here."""
    square10 = meshes.rectangle(comm, 10.0, 10.0, 1.25, structured=True)
    study = convergence(partial(sail, tension=tension), square10, quantities={"area": area})
    R, p = tension / 2.0, np.arcsin(10.0 / tension)
    exact = 100.0 - 2 * R**2 * (2 * p - np.sin(2 * p))
    found = study["area"]
    assert abs(found.limit - exact) <= found.bar
    assert found.bar < 5e-3 * exact
    assert abs(found.limit - exact) < 0.2 * abs(found.values[-1] - exact)


def area(solver):
    return solver.comm.allreduce(float(solver.results().areas.sum()))


def rubbed(mesh):
    """A cable that sticks to the square, and is let out in two steps: friction has a history."""
    solver = square(mesh)
    cable = solver.scene.lay_cable(
        Cable(EA=32000.0, friction=Friction(0.3, along=0.3)), [(0.0, 30.0), (SIDE, 30.0)],
        L0=100.5, name="ridge",
    )  # fmt: skip
    solver.advance()
    solver.advance(L0={cable: 101.0}, steps=2)
    return solver


@pytest.mark.ranks
def test_friction_has_its_history_on_each_mesh(comm):
    """The finer level is what a script finds that builds the same on the finer mesh."""
    study = convergence(rubbed, grid(comm, 4), 2)
    alone = rubbed(grid(comm, 8))
    assert study["energy"].values[1] == pytest.approx(alone.scene.energy, rel=1e-6)
    tensions = [solver.scene.cable("ridge").tensions for solver in (study.finest, alone)]
    assert np.allclose(tensions[0].mean(), tensions[1].mean(), rtol=1e-4)


def length(solver):
    return solver.scene.cable("ridge").L0


@pytest.mark.ranks
def test_levels_do_not_depend_on_who_owns_what(comm):
    def scattered(midpoints):
        return np.random.default_rng(7).integers(0, comm.size, len(midpoints))

    one, two = (
        convergence(square, grid(comm, 4, **how), 2, points={"p": (33.0, 41.0, 0.0)})
        for how in ({}, {"ranks": scattered})
    )
    for name, quantity in one.quantities.items():
        scale = abs(one["displacement p z"].limit)
        assert np.allclose(two[name].values, quantity.values, rtol=1e-8, atol=1e-8 * scale)
    assert two["energy"].remark == "two levels show no order: 2 assumed"


@pytest.mark.ranks
def test_quantities_go_in_the_order_of_the_first_rank(comm):
    names = {"a": lambda solver: 1.0, "b": lambda solver: solver.scene.volume}
    last = comm.rank == comm.size - 1
    given = dict(reversed(names.items())) if last else names
    study = convergence(square, grid(comm, 2), 2, quantities=given)
    assert study["a"].values == (1.0, 1.0)


def test_stresses_of_parts(comm):
    solver = square(grid(comm, 4))
    study = convergence(square, grid(comm, 4), 2, stresses=["membrane"])
    forces, areas = solver.results().true_forces[:, 0], solver.results().areas
    total, area = comm.allreduce(np.array([forces @ areas, areas.sum()]))
    assert study["mean section force membrane"].values[0] == pytest.approx(total / area)
    mean, most = (study[f"{kind} section force membrane"].limit for kind in ("mean", "greatest"))
    assert most > mean > 0.0


def test_displacement_between_vertices(comm):
    """It is linear in the cells."""
    scene = square(grid(comm, 4)).scene
    ends = displacements(scene, np.array([(x, 50.0, 0.0) for x in (25.0, 50.0, 35.0)]))
    assert np.allclose(ends[2], 0.6 * ends[0] + 0.4 * ends[1])
    assert np.linalg.norm(ends[1]) > 1.0


def under_cable(mesh):
    """A cable of a given length over the middle of the square."""
    scene = clamped(mesh, FABRIC)
    scene.lay_cable(Cable(EA=32000.0), [(0.0, 50.0, 0.0), (SIDE, 50.0, 0.0)], L0=100.6)
    return advanced(Solver(scene), pressure=0.01)


def test_displacement_under_a_cable(comm):
    """It is the cable's, z = 5.539 in the middle (by meshes that have lines under the cable)."""
    mesh = meshes.rectangle(comm, SIDE, SIDE, 16.0)
    cable = under_cable(mesh).scene.cables[0]
    k = len(cable.state.positions) // 2
    place = cable.state.reference_positions[k]
    points = {"middle": (50.0, 50.0, 0.0), "on it": tuple(place)}
    study = convergence(under_cable, mesh, points=points)
    first = [study[f"displacement on it {axis}"].values[0] for axis in "xyz"]
    assert first == pytest.approx(cable.state.positions[k] - place, rel=1e-9, abs=1e-9)
    middle = study["displacement middle z"]
    assert abs(middle.limit - 5.539) <= middle.bar + 0.002
    assert middle.bar < 0.05
    assert middle.values == pytest.approx([5.539] * 3, rel=2e-2)


def test_plot(comm, tmp_path_factory):
    folder = comm.bcast(tmp_path_factory.mktemp("plots"))
    study = convergence(square, grid(comm, 2), 2, points={"middle": (50.0, 50.0, 0.0)})
    study.draw(folder / "levels.png", ["energy", "displacement middle z"], title="Levels")
    assert (folder / "levels.png").stat().st_size > 5000
    assert (study.draw() is None) == (comm.rank > 0)
    with pytest.raises(InputError, match="there is no quantity 'energie'"):
        study.draw(folder / "levels.png", ["energie"])


REFUSED = {
    "levels": ({"levels": 1}, "levels = 1 must be a whole number, 2 or more"),
    "whole": ({"levels": 2.5}, "must be a whole number"),
    "points": ({"points": [(0, 0, 0)]}, "points = .* is not a valid mapping"),
    "point": ({"points": {"top": (0.0, 1.0)}}, "the point 'top' = .*three finite numbers"),
    "place": (
        {"points": {"top": (50.0, 50.0, 30.0)}},
        "point 'top' at .* is 30 off the stress-free",
    ),
    "reactions": ({"reactions": "boundary"}, r"write reactions="),
    "group": ({"reactions": ["rim"]}, "no group of edges or points 'rim'"),
    "part": ({"stresses": ["roof"]}, "there is no part 'roof'"),
    "function": ({"quantities": {"a": 3.0}}, "the quantity 'a' is 3.0, expected a function"),
    "value": (
        {"quantities": {"a": lambda solver: None}},
        "convergence: 'a' = None is not a number",
    ),
}


@pytest.mark.ranks
@pytest.mark.parametrize("name", REFUSED)
def test_bad_input_is_refused(comm, name):
    given, message = REFUSED[name]
    with pytest.raises(InputError, match=message):
        convergence(square, grid(comm, 2), **given)


BUILDS = {
    "no function": (3.0, "build = 3.0 is not a function"),
    "nothing": (lambda mesh: None, "build returned None, expected a Solver"),
    "no step": (lambda mesh: Solver(Scene(mesh, FABRIC)), "no load step has found an equilibrium"),
}


@pytest.mark.ranks
@pytest.mark.parametrize("name", BUILDS)
def test_functions_that_build_nothing_are_refused(comm, name):
    build, message = BUILDS[name]
    with pytest.raises(InputError, match=message):
        convergence(build, grid(comm, 2))
