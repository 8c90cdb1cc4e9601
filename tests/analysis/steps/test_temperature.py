"""Temperature changes: closed forms, an own code of triangles and chains, every kind of member, and
what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from cabled_square import sheet
from mpi4py import MPI
from roped_drum import roped
from same_state import assert_same_state
from term_scene import irregular_square

from crms_fenicsx import (
    Bar,
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    codes,
    meshes,
)
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.model.ufl_material import UflMembrane

STEEL = 1.2e-5
FOIL = IsotropicMembrane(E=300.0, nu=0.3, thickness=0.5, prestress=3.0, expansion=1e-4)
FABRIC = OrthotropicMembrane(
    900.0, 600.0, 20.0, 0.2, 1.0, prestress=(3.0, 2.0), expansion=(6e-5, 9e-5)
)
COLD = "temperature winter"


def green(strain: float) -> float:
    """Green-Lagrange strain of a length that grows by a strain."""
    return strain + strain**2 / 2


def cooled(scene: Scene, change: Any = -30.0, factor: float = 1.0) -> Solver:
    """Its solver, after a step to the prestressed state and one to other temperatures."""
    solver = Solver(scene)
    solver.advance()
    scene.put_temperature(change, name=COLD)
    solver.advance(load={COLD: factor})
    return solver


@pytest.mark.ranks
def test_a_restrained_cable_and_bar(comm: MPI.Intracomm) -> None:
    """T = EA (l / (L0 (1 + alpha dT)) - 1), of which -EA alpha dT is the first term; and back."""
    scene = sheet(comm, 4, material=FOIL, side=4.0)
    cable = scene.lay_cable(Cable(EA=1e3, expansion=STEEL), [(0.0, 1.4), (4.0, 1.4)], tension=2.0)
    ends = [scene.vertex_at((x, 4.0, 0.0)) for x in (0.0, 4.0)]
    bar = scene.add_bar(Bar(EA=5e3, expansion=2e-5), *ends)
    solver = cooled(scene, factor=1.5)
    assert cable.tension == pytest.approx(1e3 * (1.002 / (1 - STEEL * 45) - 1), rel=1e-10)
    assert cable.tension - 2.0 == pytest.approx(1e3 * STEEL * 45, rel=4e-3)
    assert bar.force == pytest.approx(5e3 * (1 / (1 - 2e-5 * 45) - 1), rel=1e-10)
    assert pytest.approx(4.0 / 1.002 * (1 - STEEL * 45), rel=1e-14) == cable.L0
    solver.advance(load={COLD: 0.0})
    assert cable.tension == pytest.approx(2.0, rel=1e-11)
    assert bar.force == pytest.approx(0.0, abs=1e-9)


@pytest.mark.ranks
@pytest.mark.parametrize("material", [FOIL, FABRIC], ids=["isotropic", "orthotropic"])
def test_a_restrained_sheet(comm: MPI.Intracomm, material: MembraneMaterial) -> None:
    """Of the isotropic one S = S0 - E t / (1 - nu) (alpha dT + (alpha dT)^2 / 2); of fabric by
    both of its coefficients."""
    solver = cooled(sheet(comm, 4, material=material, side=4.0), factor=1.5)
    found = solver.results().second_piola
    if isinstance(material, IsotropicMembrane):
        force = 3.0 - 300.0 * 0.5 / 0.7 * green(-45e-4)
        expected = [force, force]
    else:
        warp, weft = green(-45 * 6e-5), green(-45 * 9e-5)
        q = 1 - 0.2**2 * 900.0 / 600.0
        expected = [3.0 - (900 * warp + 0.2 * 900 * weft) / q, 2.0 - (180 * warp + 600 * weft) / q]
    both = np.sort(np.broadcast_to(expected, found.shape), axis=1)
    np.testing.assert_allclose(np.sort(found, axis=1), both, rtol=1e-12)


@pytest.mark.ranks
def test_parts_and_bonded_cables(comm: MPI.Intracomm) -> None:
    """Parts have their own changes, others keep their temperature; a belt its parts' tensions."""
    scene = Scene(irregular_square(comm), {"left": FOIL, "right": replace(FOIL, E=400.0)})
    scene.fix(lambda x: x[0] > -1.0)
    belt = scene.lay_cable(
        Cable(1e3, expansion=STEEL), [(0.0, 31.0), (100.0, 52.0)], hold="bonded", tension=2.0
    )
    solver = cooled(scene, {"left": -40.0, "cables": -20.0})
    found = solver.results().second_piola
    expected = np.full(found.shape, 3.0)
    own = scene.mesh.parts["left"]
    expected[own[own < len(found)]] -= 150.0 / 0.7 * green(-4e-3)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    tension = 1e3 * (1.002 / (1 - STEEL * 20) - 1)
    np.testing.assert_allclose(belt.tensions, tension, rtol=1e-6)


def test_a_sewn_sheet(comm: MPI.Intracomm) -> None:
    """Cells with stress-free shapes of their own: what a restrained change adds is the same."""
    mesh = meshes.rectangle(comm, 4.0, 4.0, size=1.0)
    cells = mesh.mesh.topology.index_map(2)
    frames = np.tile(1.01 * np.eye(3)[:2], (cells.size_local + cells.num_ghosts, 1, 1))
    scene = Scene(mesh, replace(FABRIC, prestress=0.0), frames=frames)
    scene.fix("boundary")
    solver = cooled(scene)
    found = solver.results().second_piola
    strains = [green(0.01) - green(-30 * alpha) for alpha in (6e-5, 9e-5)]
    expected = FABRIC.stiffness[:2, :2] @ strains
    np.testing.assert_allclose(np.sort(found), np.sort(np.tile(expected, (len(found), 1))))


@pytest.mark.ranks
def test_what_is_free_grows_without_force(comm: MPI.Intracomm) -> None:
    """A sheet on a corner, and a cable and a guy in it of the same coefficient."""
    foil = replace(FOIL, prestress=0.0, expansion=STEEL, wrinkling=False)
    scene = Scene(meshes.rectangle(comm, 4.0, 3.0, size=1.0), foil)
    scene.fix("boundary", "z")
    scene.fix(lambda x: x[0] < 1e-9, "x")
    scene.fix(lambda x: x[1] < 1e-9, "y")
    steel = Cable(EA=1e3, expansion=STEEL)
    cable = scene.lay_cable(steel, [(0.4, 1.4), (3.4, 2.2)], L0=float(np.hypot(3.0, 0.8)))
    bar = scene.add_bar(
        Bar(EA=1e3, expansion=STEEL), *(scene.vertex_at((x, 3.0, 0.0)) for x in (0.0, 4.0))
    )
    solver = cooled(scene, change=100.0)
    right = scene.vertices(lambda x: (x[0] > 3.99) & (x[1] > 2.99))
    u = comm.allreduce(scene.u.x.array.reshape(-1, 3)[right].sum(axis=0))
    owners = comm.allreduce(len(right))
    np.testing.assert_allclose(u / owners, (4.0 * 1.2e-3, 3.0 * 1.2e-3, 0.0), atol=1e-8)
    assert np.abs(solver.results().second_piola).max(initial=0.0) < 1e-6
    assert abs(bar.force) < 1e-5 and cable.tension < 1e-5


def test_heat_wrinkles_and_slackens(comm: MPI.Intracomm) -> None:
    """Stretched one way: wrinkled with E t (e - alpha dT) along it; heated more: slack."""
    foil = replace(FOIL, prestress=0.0)
    scene = sheet(comm, 4, material=foil, side=4.0)
    scene.put_temperature({"fabric": 1.0}, name="temperature summer")
    solver = Solver(scene)
    solver.advance()
    solver.advance(move={"boundary": lambda x, t: np.array([0.01 * t * x[0], 0 * x[0], 0 * x[0]])})
    solver.advance(load=50.0)
    results = solver.results()
    assert results.shares() == pytest.approx((0.0, 1.0, 0.0))
    force = 150.0 * (green(0.01) - green(5e-3))
    np.testing.assert_allclose(results.second_piola.max(axis=1), force, rtol=1e-6)
    solver.advance(load=150.0)
    assert solver.results().shares() == pytest.approx((1.0, 0.0, 0.0))


def chain_energy(
    x: Array, X: Array, cells: Array, row: list[int], cable: LaidCable, dT: float,
    ends: list[int], bar: Any, foot: Array,
) -> complex:  # fmt: skip
    """Energy of triangles, a chain and a bar by numpy alone, at a temperature."""

    def inner(a: Array, b: Array) -> Array:
        return np.einsum("ni,ni->n", a, b)

    A = X[cells].astype(complex)
    a, b = A[:, 1] - A[:, 0], A[:, 2] - A[:, 0]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    inverse = np.linalg.inv(np.stack([a[:, :2], b[:, :2]], axis=2))
    c = x[cells]
    F = np.einsum("nik,nkj->nij", np.stack([c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]], 2), inverse)
    warp, weft = F[:, :, 0], F[:, :, 1]
    e = [(inner(warp, warp) - 1) / 2 - green(6e-5 * dT),
         (inner(weft, weft) - 1) / 2 - green(9e-5 * dT), inner(warp, weft)]  # fmt: skip
    q = 1 - 0.2**2 * 1.5
    density = 3.0 * e[0] + 2.0 * e[1] + 10.0 * e[2] ** 2
    density += (450.0 * e[0] ** 2 + 180.0 * e[0] * e[1] + 300.0 * e[1] ** 2) / q
    total = (area * density).sum()
    steps = np.diff(x[row], axis=0)
    for points, EA, L0, alpha in (
        (steps, cable.cable.EA, 4.0 / 1.004, STEEL),
        (x[ends[0]][None] - foot, bar.bar.EA, 2.3, 2e-5),
    ):
        own = L0 * (1 + alpha * dT)
        total += EA / (2 * own) * (np.sqrt(inner(points, points)).sum() - own) ** 2
    return complex(total)


@pytest.mark.parametrize("dT", [-45.0, 60.0])
def test_a_mixed_roof_by_an_own_code(dT: float) -> None:
    """Fabric, a cable on a line of the mesh and a mast: the forces of the own code at the places
    found are in balance with the load, and are not at another temperature."""
    comm = MPI.COMM_SELF
    mesh = meshes.along(
        meshes.rectangle(comm, 4.0, 4.0, size=1.0, structured=True), {"A": [(0.0, 3.0), (4.0, 3.0)]}
    )
    scene = Scene(mesh, replace(FABRIC, wrinkling=False))
    scene.fix("boundary")
    cable = scene.lay_cable(
        Cable(EA=2e3, expansion=STEEL), along="A", hold="pocket", L0=4.0 / 1.004
    )
    X = scene.membrane.stress_free
    middle = X[np.argmin(np.linalg.norm(X - (2.0, 2.0, 0.0), axis=1))]
    foot, top = (*middle[:2], -2.0), scene.vertex_at(middle)
    bar = scene.add_bar(Bar(EA=4e3, expansion=2e-5), foot, top, L0=2.3)
    scene.put_load((0.0, 0.0, -0.2), name="snow", per="material")
    solver = Solver(scene, rtol=1e-11)
    solver.advance(load={"snow": 1.0}, steps=2)
    before = scene.positions().copy()
    scene.put_temperature(dT / 1.5, name=COLD)
    solver.advance(load={COLD: 1.5})
    membrane = scene.membrane
    at = {int(v): k for k, v in enumerate(membrane.vertex_ids)}
    row = [at[k.support[0]] for k in cable.state.nodes if k.kind == "vertex"]
    X, x = membrane.stress_free, scene.positions().astype(complex)
    load = scene.load("snow").forces

    def largest(x: Array, dT: float) -> float:
        worst = 0.0
        for k, j in np.argwhere(~membrane.held):
            moved = x.astype(complex)
            moved[k, j] += 1e-30j
            slope = chain_energy(
                moved, X, scene.V.dofmap.list, row, cable, dT, [at[top.number]], bar, foot
            ).imag / 1e-30  # fmt: skip
            worst = max(worst, abs(slope - load[k, j]))
        return worst

    assert largest(x, dT) < 1e-7
    assert largest(x, 0.0) > 1e-2
    assert largest(before, 0.0) < 1e-7
    points = x[row].real
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    expected = 2e3 * (length / (4.0 / 1.004 * (1 + STEEL * dT)) - 1)
    assert cable.tension == pytest.approx(expected, rel=1e-6)


@pytest.mark.ranks
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_folded_cables_are_shorter(comm: MPI.Intracomm, friction: float) -> None:
    """On an inflated sheet whose cells a cable crosses and folds: the same as a cable of the
    shorter length and a fabric of the larger prestress."""
    found = []
    for by_temperature in (True, False):
        material = replace(FOIL, expansion=2e-5)
        scene = sheet(comm, 6, material=material, side=6.0)
        cable = scene.lay_cable(
            Cable(EA=2e3, expansion=STEEL, friction=friction), [(0.0, 2.3), (6.0, 3.4)], tension=4.0
        )
        solver = Solver(scene)
        solver.advance(pressure=0.2)
        assert cable.folds_cells
        if by_temperature:
            scene.put_temperature(-40.0, name=COLD)
            solver.advance(load=1.0)
        else:
            more = -150.0 / 0.7 * green(-8e-4)
            scene.set_material(replace(material, prestress=3.0 + more))
            solver.advance(L0={cable: cable.L0 * (1 - STEEL * 40)})
        height = float(comm.allreduce(scene.positions()[:, 2].max(initial=0.0), op=MPI.MAX))
        found.append((cable.tension, height, scene.energy))
    assert found[0] == pytest.approx(found[1], rel=1e-8)
    assert found[0][0] > 4.0


@pytest.mark.ranks
def test_friction_along_keeps_even_tensions_even(comm: MPI.Intracomm) -> None:
    """A rope that sticks on a rigid drum: all parts cool alike, where a shorter rope is pulled in
    at its end."""
    scene, cable = roped(comm, 12, 0.4, tension=5.0)
    cable.update(cable=replace(cable.cable, expansion=STEEL))
    solver = Solver(scene)
    solver.advance()
    first = cable.tensions.copy()
    scene.put_temperature({"cables": -50.0}, name=COLD)
    solver.advance(load=1.0)
    expected = 1e3 * ((1 + first / 1e3) / (1 - STEEL * 50) - 1)
    np.testing.assert_allclose(cable.tensions, expected, rtol=2e-3)
    assert cable.tensions.min() > first.max() + 0.5
    shorter, other = roped(comm, 12, 0.4, tension=5.0)
    pulled = Solver(shorter)
    pulled.advance()
    pulled.advance(L0={other: other.L0 * (1 - STEEL * 50)})
    assert np.ptp(other.tensions) > 10 * np.ptp(cable.tensions)


def roof(comm: MPI.Intracomm) -> tuple[Scene, Solver]:
    """An inflated sheet with cables that slide along lines of the mesh and are clamped, and one
    that folds cells; in the cold."""
    lines = {"A": [(0.0, 2.0), (6.0, 2.4)], "B": [(3.0, 0.0), (2.6, 6.0)]}
    mesh = meshes.along(meshes.rectangle(comm, 6.0, 6.0, size=1.0), lines)
    scene = Scene(mesh, FABRIC)
    scene.fix("boundary")
    steel = Cable(EA=2e3, expansion=STEEL)
    for name in lines:
        scene.lay_cable(steel, along=name, tension=3.0)
    scene.lay_cable(steel, [(0.0, 4.2), (6.0, 4.6)], tension=2.0, name="C")
    scene.clamp("A", "B")
    scene.put_temperature({"fabric": -30.0, "cables": -20.0, "C": 10.0}, name=COLD)
    return scene, Solver(scene)


@pytest.mark.ranks
def test_snapshots_and_checkpoints(comm: MPI.Intracomm, folder: Path) -> None:
    """Lines that slide, clamps and folds: a state comes back, and a run goes on from a file."""
    scene, solver = roof(comm)
    solver.advance(pressure=0.2)
    calm, before = solver.snapshot(), scene.cable("A").tension
    solver.advance(load={COLD: 1.0})
    cold = scene.cable("A").tension
    assert abs(cold - before) > 0.1 and scene.materials[0].dT == -30.0
    solver.save(folder / "cold")
    solver.restore(calm)
    assert scene.materials[0].dT == 0.0 and scene.cable("A").tension == before
    solver.advance(load={COLD: 1.0})
    assert scene.cable("A").tension == pytest.approx(cold, rel=1e-8)
    other, resumed = roof(comm)
    resumed.load(folder / "cold")
    assert other.materials[0].dT == -30.0 and other.factors == {COLD: 1.0}
    assert other.cable("C").L0 == pytest.approx(scene.cable("C").L0, rel=1e-12)
    for one in (solver, resumed):
        one.advance(load={COLD: -0.5}, pressure=0.25)
    assert_same_state(other.state, scene.state, but=("warnings", "net", "membrane"), rtol=1e-6)
    assert other.cable("A").tension == pytest.approx(scene.cable("A").tension, rel=1e-6)


def test_a_run_goes_on(comm: MPI.Intracomm, folder: Path) -> None:
    """When the script runs again, each call is restored, with its temperature."""
    found = []
    for resume in (False, True):
        scene, _ = roof(comm)
        solver = Solver(scene, results=folder, resume=resume)
        solver.advance(pressure=0.2)
        solver.advance(load={COLD: 1.0}, steps=2)
        found.append((scene.energy, scene.cable("B").tension, scene.materials[0].dT))
        del solver
    assert found[0] == found[1]


@pytest.mark.ranks
def test_in_combinations(comm: MPI.Intracomm) -> None:
    """A variable action of EN 1990 beside others, beside a prestress factor, and in states that
    start warm; lengths to order are those of the model's temperature."""
    scene = sheet(comm, 4, material=FOIL, side=4.0)
    cable = scene.lay_cable(
        Cable(EA=1e3, expansion=STEEL), [(0.0, 1.4), (4.0, 1.4)], tension=2.0, name="A"
    )
    for name, change in ((COLD, -30.0), ("temperature summer", 25.0)):
        scene.put_temperature(change, name=name)
    scene.put_load((0.0, 0.0, 0.0), name="snow")
    table = codes.combinations(codes.en1990, [], ["snow", COLD, "temperature summer"])
    assert not any(one[COLD] and one["temperature summer"] for one in table.values())
    assert table[f"ULS: 1.5 snow + 0.9 {COLD}"]["state"] == "ULS"
    solver = Solver(scene)
    solver.advance()
    first = cable.L0
    found = solver.combine(
        {name: table[name] for name in table if "snow +" in name or "no load" in name}
        | {"tight": {COLD: 1.5, "prestress": 1.2}}
    )
    tension = {name: one.snapshot.tensions["A"] for name, one in found.items()}
    by_hand = 1e3 * (1.002 / (1 - STEEL * 27) - 1)
    assert tension[f"ULS: 1.5 snow + 0.9 {COLD}"] == pytest.approx(by_hand, rel=1e-9)
    by_hand = 1e3 * (1.002 / (1 + STEEL * 22.5) - 1)
    assert tension["ULS: 1.5 snow + 0.9 temperature summer"] == pytest.approx(by_hand, rel=1e-9)
    assert tension["ULS: no load"] == pytest.approx(2.0, rel=1e-12)
    by_hand = 1e3 * (1.0024 / (1 - STEEL * 45) - 1)
    assert tension["tight"] == pytest.approx(by_hand, rel=1e-9)
    assert cable.L0 == first and scene.materials[0].dT == 0.0
    solver.advance(load={COLD: 1.0})
    base = solver.combine({"back": {COLD: 0.0}, "same": {}})
    assert base["back"].snapshot.tensions["A"] == pytest.approx(2.0, rel=1e-10)
    assert base["same"].snapshot.tensions["A"] == pytest.approx(cable.tension, rel=1e-12)
    from crms_fenicsx import nets

    assert nets.lengths_to_order(scene).cables["A"].L0 == pytest.approx(first, rel=1e-14)


def test_scenes_without_pay_nothing(comm: MPI.Intracomm) -> None:
    """Not a digit, nor an evaluation, from coefficients and a load without a factor."""
    found = []
    for alpha in (None, 1e-4):
        scene = sheet(comm, 4, material=replace(FOIL, expansion=alpha), side=4.0)
        cable = scene.lay_cable(
            Cable(EA=1e3, expansion=alpha), [(0.0, 1.4), (4.0, 2.2)], tension=2.0
        )
        if alpha is not None:
            scene.put_temperature(20.0, name=COLD)
        solver = Solver(scene)
        step = solver.advance(pressure=0.2, L0={cable: 0.999 * cable.L0})
        found.append((scene.energy, cable.tension, cable.L0, step.outcome.evaluations))
    assert found[0] == found[1]


def bad_scene(comm: MPI.Intracomm, **given: Any) -> tuple[Scene, Solver]:
    """A sheet of a material and a cable; `given`: their data."""
    material = given.get("material", FOIL)
    laws = {"strain": "step"} if given.get("step") else {}
    scene = sheet(comm, 4, material=material, side=4.0, **laws)
    if not isinstance(material, UflMembrane):
        scene.lay_cable(given.get("cable", Cable(1e3, expansion=STEEL)), [(0.0, 1.4), (4.0, 1.4)])
    ends = [scene.vertex_at((x, 4.0, 0.0)) for x in (0.0, 4.0)]
    scene.add_bar(given.get("bar", Bar(1e3, expansion=STEEL)), *ends, name="strut")
    scene.put_temperature(30.0, name=COLD)
    return scene, Solver(scene)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"cable": Cable(1e3)}, "the cable 'cable 1', whose thermal expansion is unknown"),
        ({"bar": Bar(1e3)}, "the bar 'strut', whose thermal expansion is unknown"),
        ({"material": replace(FOIL, expansion=None)}, "the membrane, whose thermal expansion"),
        ({"cable": Cable(1e3, law="step")}, "'cable 1', which has the step-wise law"),
        ({"material": UflMembrane(lambda E: 300.0 * ufl.inner(E, E))}, "with a UflMembrane"),
        ({"material": replace(FOIL, wrinkling=False), "step": True}, 'with strain="step"'),
    ],
)
def test_members_that_cannot(comm: MPI.Intracomm, given: dict[str, Any], words: str) -> None:
    """Refused by name before anything is computed; and not where they are left out."""
    scene, solver = bad_scene(comm, **given)
    with pytest.raises(InputError, match=words):
        solver.advance(load={COLD: 1.0})
    with pytest.raises(InputError, match=f"combine: 'C': .*{words}"):
        solver.combine({"C": {COLD: 1.0}})
    assert not solver.steps
    solver.advance(load={COLD: 0.0})
    left_out = {"cable": "cables", "bar": "bars", "material": "fabric"}[next(iter(given))]
    rest = {"cables": 30.0, "bars": 30.0, "fabric": 30.0} | {left_out: 0.0}
    scene.put_temperature(rest, name="temperature of the rest")
    if "step" not in given:
        solver.advance(load={"temperature of the rest": 1.0})


def test_bad_input(comm: MPI.Intracomm) -> None:
    scene, solver = bad_scene(comm)
    for change, name, words in (
        (293.0, "t", "change = 293.0; pass the difference"),
        (float("nan"), "t", "change = nan"),
        ({"roof": 3.0}, "t", "no fabric, cable or bar 'roof'.* 'cables', 'bars', 'cable 1'"),
        (3.0, "temperature", "another thing in combinations.*'temperature summer'"),
        (3.0, COLD, "there is a load 'temperature winter' already"),
    ):
        with pytest.raises(InputError, match=words):
            scene.put_temperature(change, name=name)  # type: ignore[arg-type]
    for factor in (30.0, -7.0):  # kelvins as a factor, or a sum that is too large
        with pytest.raises(InputError, match=r"changes by .* K, the sum of factors times changes"):
            solver.advance(load={COLD: factor})
        with pytest.raises(InputError, match=r"combine: 'C': advance: the temperature of"):
            solver.combine({"C": {COLD: factor}})
    scene.lay_cable(Cable(1e3), [(0.0, 2.4), (4.0, 2.4)], name="strut")
    with pytest.raises(InputError, match="'strut' is the name of several things"):
        scene.put_temperature({"strut": 3.0}, name="t")
    scene.remove("strut")
    solver.advance(load={COLD: 1.0})
    with pytest.raises(InputError, match=r"remove_load: .* acts by the factor 1"):
        scene.remove_load(COLD)
    scene.set_material(replace(FOIL, E=310.0))
    assert scene.materials[0].dT == 30.0
    solver.advance(load={COLD: 0.0})
    scene.remove_load(COLD)
    for bad in (0.012, "steel", float("inf")):
        for kind in (Cable, Bar):
            with pytest.raises(InputError, match=f"{kind.__name__}: expansion"):
                kind(1e3, expansion=bad)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="IsotropicMembrane: expansion"):
        replace(FOIL, expansion=(1e-5, 1e-5))  # type: ignore[arg-type]
    assert codes.steel_bar("CHS 168.3x8", 235e3).expansion == STEEL
