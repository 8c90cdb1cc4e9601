"""Derivatives by the tangent against central differences of load steps, and lengths tuned."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet
from grids import grid
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, Solver, meshes, nets

FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0)


PATHS = {"a": [(0.0, 5.0), (10.0, 5.3)], "b": [(4.9, 0.0), (5.3, 10.0)]}


def crossed(
    comm: MPI.Intracomm, *, friction: float = 0.0, slide: bool = False, lined: bool = False
) -> Solver:
    """An inflated square under two crossing cables and snow; paths stay. `lined`: in pockets along
    lines of the mesh."""
    lines = PATHS if lined else None
    scene = clamped(meshes.rectangle(comm, 10.0, 10.0, 1.3, lines=lines), FABRIC)
    for name, path in PATHS.items():
        cable = Cable(1e3, friction=friction)
        if lined:
            scene.lay_cable(cable, along=name, hold="pocket", tension=5.0)
        else:
            scene.lay_cable(cable, path, tension=5.0, name=name)
    scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
    return Solver(scene, rtol=1e-11, slide=slide)


@pytest.mark.ranks
@pytest.mark.parametrize("clamped", [False, True])
def test_against_central_differences(comm, clamped) -> None:
    """Of membrane, folded cells, sliding and clamped cables: by all parameters."""
    solver = crossed(comm, lined=clamped)
    scene = solver.scene
    if clamped:
        scene.clamp("a", "b")
    solver.advance(pressure=2.0, load=0.1)
    a, b = scene.cables
    state, L0 = solver.snapshot(), a.L0
    vertex = scene.vertex_at((0.0, 0.0, 0.0))
    of = [a, b, "energy", a.start, "volume", (vertex, "z")]
    found = solver.sensitivities(of, [a, "pressure", "snow", ("EA", b)])
    assert found[a, "pressure"] == found.values[0, 1] > 0.0 > found[a, a]
    assert found.inexact == () and np.all(found.values[5] == 0.0)

    def change_stiffness(h: float) -> None:
        scene.set_stiffness({b: 1e3 + h})
        solver.advance()

    changes = [
        (lambda h: solver.advance(L0={a: L0 + h}), 1e-4),
        (lambda h: solver.advance(pressure=2.0 + h), 1e-3),
        (lambda h: solver.advance(load=0.1 + h), 1e-3),
        (change_stiffness, 1.0),
    ]
    for j, (change, h) in enumerate(changes):
        results = []
        for sign in (1.0, -1.0):
            solver.restore(state)
            if j == 3:
                scene.set_stiffness({b: 1e3})
            change(sign * h)
            reaction = np.linalg.norm(a.start.reaction)
            results.append([a.tension, b.tension, scene.energy, reaction, scene.volume])
        differences = (np.array(results[0]) - results[1]) / (2 * h)
        np.testing.assert_allclose(found.values[:5, j], differences, rtol=1e-6)


def test_straight_cable_in_closed_form(comm) -> None:
    """Along a ruling of a stiff, held cylinder nothing gives way: dT/dL0 = -EA L / L0^2."""
    plan, cells = grid(np.linspace(-1.0, 1.0, 9), np.linspace(0.0, 6.0, 9))
    t, y, _ = plan.T
    x = np.column_stack([5 * np.sin(t), y, 5 * np.cos(t)])
    scene = clamped(meshes.from_arrays(comm, x, cells), FABRIC)
    cable = scene.lay_cable(Cable(2e3), [(0.3, 0.0, 4.99), (0.3, 6.0, 4.99)], tension=30.0)
    solver = advanced(Solver(scene, slide=False))
    exact = -2e3 * cable.length / cable.L0**2
    found = solver.sensitivities([cable, cable.start], [cable])
    assert found[cable, cable] == pytest.approx(exact, rel=1e-6)
    assert found[cable.start, cable] == pytest.approx(exact, rel=1e-6)


def test_bars_and_their_lengths(comm) -> None:
    """Four bars that tighten each other at a joint."""
    scene = sheet(comm, 2, "unstructured", FABRIC, side=2.0)
    top = scene.add_joint((5.0, 0.0, 3.0))
    one = scene.add_bar(Bar(EA=1e4), (4.0, 0.0, 0.0), top, L0=3.1)
    two = scene.add_bar(Bar(EA=1e4), (8.0, 1.0, 0.0), top, L0=4.2)
    scene.add_bar(Bar(EA=1e4), (8.0, -1.0, 0.0), top, L0=4.2)
    scene.add_bar(Bar(EA=1e4), (5.0, 0.5, 7.0), top, L0=3.9)
    solver = advanced(Solver(scene, rtol=1e-12))
    state, h = solver.snapshot(), 1e-4
    found = solver.sensitivities([one, two], [one])
    forces = []
    for sign in (1.0, -1.0):
        solver.restore(state)
        solver.advance(L0={one: 3.1 + sign * h})
        forces.append([one.force, two.force])
    differences = (np.array(forces[0]) - forces[1]) / (2 * h)
    np.testing.assert_allclose(found.values[:, 0], differences, rtol=1e-5)


@pytest.mark.ranks
def test_lengths_for_tensions(comm) -> None:
    solver = crossed(comm, slide=True)
    solver.advance(pressure=2.0)
    scene = solver.scene
    a, b = scene.cables
    steps = len(solver.steps)
    found = nets.tune(solver, {a: 20.0, b: 35.0})
    assert len(solver.steps) - steps <= 6
    np.testing.assert_allclose([a.tension, b.tension], [20.0, 35.0], rtol=1e-4)
    assert found == {a: a.L0, b: b.L0} and a.L0 > b.L0
    before = [a.L0, b.L0, scene.energy]
    with pytest.raises(InputError, match=r"^tune: .*'a' a tension of 3e\+06; .* steps: 1") as one:
        nets.tune(solver, {a: 3e6, b: b.tension})  # a negative length comes first
    assert "advance" in str(one.value.__cause__)
    assert [a.L0, b.L0, scene.energy] == before
    with pytest.raises(InputError, match="'c' is not in tension"):
        solver.scene.lay_cable(Cable(1e3), [(0.0, 2.0), (10.0, 2.0)], L0=14.0, name="c")
        nets.tune(solver, {a: 20.0, scene.cable("c"): 1.0})
    with pytest.raises(InputError, match=r"tension of 'a' = -1\.0"):
        nets.tune(solver, {a: -1.0})
    with pytest.raises(InputError, match="'x' is not a cable"):
        nets.tune(solver, {"x": 1.0})
    assert [a.L0, b.L0, scene.energy] == before


@pytest.mark.ranks
def test_guys_are_tuned_to_tensions(comm) -> None:
    """Both at once, to lengths that give these tensions by Hooke's law."""
    scene = sheet(comm, 2, material=FABRIC, side=1.0)
    top = scene.add_joint((20.0, 0.0, 6.0))
    feet = [(20.0, 0.0, 0.0), (25.0, 0.0, 0.0), (17.0, 4.0, 0.0), (17.0, -4.0, 0.0)]
    mast, one, two, _ = (scene.add_bar(Bar(EA=1e4), foot, top) for foot in feet)
    solver = advanced(Solver(scene), L0={one: 0.99 * one.L0})
    lengths = nets.tune(solver, {one: 30.0, two: 25.0})
    assert lengths == {one: one.L0, two: two.L0}
    np.testing.assert_allclose([one.force, two.force], [30.0, 25.0], rtol=1e-4)
    assert one.length / one.L0 - 1 == pytest.approx(30.0 / 1e4, rel=1e-4)
    with pytest.raises(InputError, match="is not in tension"):
        nets.tune(solver, {mast: 1.0})


@pytest.mark.ranks
@pytest.mark.parametrize("change", [-20.0, {"cables": -20.0, "strut": 15.0}])
def test_temperatures_against_central_differences(
    comm: MPI.Intracomm, change: float | dict[str, float]
) -> None:
    """Of fabric, a cable in a pocket and a bar; the exact growth of lengths and strains."""
    material = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0, expansion=4e-5)
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.3, lines={"a": PATHS["a"]})
    scene = clamped(mesh, material)
    rope = Cable(1e3, expansion=1.2e-5)
    scene.lay_cable(rope, along="a", hold="pocket", tension=5.0)
    middle = scene.vertex_at(scene.cables[0].line[len(scene.cables[0].line) // 2])
    strut = scene.add_bar(Bar(EA=500.0, expansion=2e-5), middle, (5.0, 5.0, -6.0), name="strut")
    scene.put_temperature(change, name="temperature winter")
    solver = Solver(scene, rtol=1e-11)
    solver.advance(pressure=1.0, load={"temperature winter": 0.5})
    (a,), state = scene.cables, solver.snapshot()
    of = [a, strut, "energy", "volume", a.start]
    found = solver.sensitivities(of, ["temperature winter"])
    assert scene.in_equilibrium()
    results = []
    for sign in (1.0, -1.0):
        solver.restore(state)
        solver.advance(load={"temperature winter": 0.5 + sign * 1e-2})
        reaction = np.linalg.norm(a.start.reaction)
        results.append([a.tension, strut.force, scene.energy, scene.volume, reaction])
    differences = (np.array(results[0]) - results[1]) / 2e-2
    np.testing.assert_allclose(found.values[:, 0], differences, rtol=2e-6)


@pytest.mark.ranks
def test_temperature_of_folded_fabric_is_refused(comm: MPI.Intracomm) -> None:
    solver = crossed(comm)
    warm = IsotropicMembrane(E=300.0, nu=0.25, thickness=1.0, prestress=1.0, expansion=4e-5)
    solver.scene.set_material(warm)
    solver.scene.put_temperature({"fabric": 20.0}, name="temperature summer")
    solver.advance(pressure=1.0)
    with pytest.raises(InputError, match="of fabric that cables fold"):
        solver.sensitivities(["energy"], ["temperature summer"])


@pytest.mark.ranks
def test_bad_sensitivities_are_refused(comm) -> None:
    solver = crossed(comm)
    with pytest.raises(InputError, match=r"sensitivities: .*advance"):
        solver.sensitivities(["energy"], ["pressure"])
    solver.advance(pressure=1.0)
    for of, by, message in (
        (["stress"], ["pressure"], "of has 'stress'; pass cables"),
        (["energy"], ["wind"], "by has 'wind'; pass cables"),
    ):
        with pytest.raises(InputError, match=message):
            solver.sensitivities(of, by)
    rubbed = crossed(comm, friction=0.3)
    rubbed.advance(pressure=1.0)
    with pytest.raises(InputError, match="friction makes the state path-dependent"):
        rubbed.sensitivities(["energy"], ["pressure"])
