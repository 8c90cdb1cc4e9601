"""Other numbers of materials, cables and bars, for studies of parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import dolfinx.fem
import numpy as np
import pytest
from cabled_square import FOIL, LINEAR, advanced, clamped, sheet
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    UflMembrane,
    meshes,
)
from crms_fenicsx.model.materials import MembraneMaterial

FABRIC = OrthotropicMembrane(E1=300.0, E2=200.0, G12=20.0, nu21=0.2, thickness=0.08)
KINDS = {
    "wrinkling": FOIL,
    "raw": LINEAR,
    "fabric": FABRIC,
    "woven": replace(FABRIC, wrinkling=False),
}
CABLE = Cable(EA=9000.0)


def scene_of(comm: MPI.Intracomm, material: Any) -> Scene:
    return sheet(comm, 4, material=material)


def roof(comm: MPI.Intracomm, material: MembraneMaterial, cable: Cable = CABLE) -> Solver:
    """Inflated under a cable of a given length."""
    scene = scene_of(comm, material)
    solver = advanced(Solver(scene), pressure=0.01)
    scene.lay_cable(cable, [(0.0, 47.0), (100.0, 52.0)], L0=101.0, name="ridge")
    solver.advance()
    return solver


def softer(material: Any) -> Any:
    moduli = {name: 0.7 * getattr(material, name) for name in ("E", "E1", "E2", "G12")
              if hasattr(material, name)}  # fmt: skip
    return replace(material, **moduli, prestress=0.1)


@pytest.mark.ranks
@pytest.mark.parametrize("kind", KINDS)
def test_leads_to_where_it_would_have_been_from_the_beginning(
    comm: MPI.Intracomm, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In plain and in folded cells, without a form that is made anew."""
    first, other = KINDS[kind], softer(KINDS[kind])
    solver, twin = roof(comm, first), roof(comm, other)
    before = solver.scene.energy

    def compiled(*arguments: Any, **options: Any) -> None:
        raise AssertionError("a form is made")

    with monkeypatch.context() as patch:
        patch.setattr(dolfinx.fem, "form", compiled)
        solver.scene.set_material(other)
        step = solver.advance()
    assert step.verification is not None and step.verification.passed
    assert abs(solver.scene.energy - before) > 1e-3 * abs(before)
    assert solver.scene.energy == pytest.approx(twin.scene.energy, rel=1e-7)
    np.testing.assert_allclose(
        solver.scene.cable("ridge").tension, twin.scene.cable("ridge").tension, rtol=1e-5
    )
    forces, expected = (one.results().true_forces for one in (solver, twin))
    np.testing.assert_allclose(forces, expected, rtol=1e-4, atol=1e-4)


def test_of_some_parts(comm: MPI.Intracomm) -> None:
    """The others keep theirs."""
    wall = IsotropicMembrane(E=500.0, nu=0.3, thickness=0.08)

    def build(roof: MembraneMaterial) -> Solver:
        points = np.array([(x, y, 0.0) for y in (0, 1, 2) for x in (0, 1, 2)], dtype=float)
        cells = np.array(
            [(i, i + 1, i + 4) for i in (0, 1, 3, 4)] + [(i, i + 4, i + 3) for i in (0, 1, 3, 4)]
        )
        parts = {"roof": [0, 1, 4, 5], "wall": [2, 3, 6, 7]}
        mesh = meshes.from_arrays(comm, points, cells, parts=parts)
        scene = clamped(mesh, {"roof": roof, "wall": wall})
        return Solver(scene)

    solver, twin = build(FOIL), build(softer(FOIL))
    for one in (solver, twin):
        one.advance(pressure=1.0)
    solver.scene.set_material({"roof": softer(FOIL)})
    assert solver.scene.materials == twin.scene.materials
    solver.advance()
    assert solver.scene.energy == pytest.approx(twin.scene.energy, rel=1e-9)


@pytest.mark.parametrize("what", ["cable", "bar"])
def test_stiffness_of_cables_and_bars(comm: MPI.Intracomm, what: str) -> None:
    def build(EA: float) -> tuple[Solver, Any]:
        if what == "cable":
            solver = roof(comm, FOIL, Cable(EA=EA))
            return solver, solver.scene.cable("ridge")
        scene = scene_of(comm, FOIL)
        bar = scene.add_bar(Bar(EA=EA), (50.0, 50.0, -20.0), scene.vertex_at((50.0, 50.0, 0.0)))
        solver = advanced(Solver(scene), pressure=0.01)
        return solver, bar

    (solver, one), (twin, other) = build(9000.0), build(500.0)
    solver.scene.set_stiffness({one: 500.0})
    solver.advance()
    assert solver.scene.energy == pytest.approx(twin.scene.energy, rel=1e-8)
    a, b = ((x.tension if what == "cable" else x.force) for x in (one, other))
    assert a == pytest.approx(b, rel=1e-6) and a > 0.1


def test_friction_along_a_cable_knows_its_stiffness(comm: MPI.Intracomm) -> None:
    """Its parts keep their unstressed lengths, and the step verifies."""
    from crms_fenicsx import Friction

    solver = roof(comm, FOIL, Cable(EA=9000.0, friction=Friction(0.3, along=0.2)))
    ridge = solver.scene.cable("ridge")
    before = ridge.tension
    solver.scene.set_stiffness({ridge: 4500.0})
    step = solver.advance()
    assert step.verification is not None and step.verification.passed
    assert 0.5 * before < ridge.tension < before


def test_a_branch_takes_it_back(comm: MPI.Intracomm) -> None:
    solver = roof(comm, FOIL)
    scene, energy = solver.scene, solver.scene.energy
    ridge = scene.cable("ridge")
    with solver.branch("soft"):
        scene.set_material(softer(FOIL))
        scene.set_stiffness({ridge: 100.0})
        solver.advance()
        soft = solver.snapshot()
        assert abs(scene.energy - energy) > 1e-3 * abs(energy)
    assert scene.materials == {0: FOIL} and ridge.cable.EA == 9000.0
    solver.advance()
    assert scene.energy == pytest.approx(energy, rel=1e-8)
    solver.restore(soft)
    assert scene.materials == {0: softer(FOIL)} and ridge.cable.EA == 100.0
    assert scene.energy == sum(soft.energies.values())


@pytest.mark.ranks
def test_in_checkpoints(comm: MPI.Intracomm, folder: Path) -> None:
    """A script that builds the scene as at first goes on with the materials of the checkpoint."""
    solver = roof(comm, FABRIC)
    solver.scene.set_material(softer(FABRIC))
    solver.scene.set_stiffness({solver.scene.cable("ridge"): 500.0})
    solver.advance()
    solver.save(folder)
    again = Solver(scene_of(comm, FABRIC))
    again.load(folder)
    assert again.scene.materials == {0: softer(FABRIC)}
    assert again.scene.cable("ridge").cable.EA == 500.0
    for one in (solver, again):
        one.advance(pressure=0.012)
    assert again.scene.energy == pytest.approx(solver.scene.energy, rel=1e-9)
    with pytest.raises(InputError, match="materials"):
        Solver(scene_of(comm, softer(FABRIC))).load(folder)


def test_a_resumed_script_must_change_it_alike(comm: MPI.Intracomm, folder: Path) -> None:

    def script(E: float, resume: bool) -> Solver:
        solver = advanced(
            Solver(scene_of(comm, FOIL), results=folder, resume=resume), pressure=0.01
        )
        solver.scene.set_material(replace(FOIL, E=E))
        solver.advance()
        return solver

    done = script(200.0, False).scene.energy
    assert script(200.0, True).scene.energy == done
    with pytest.raises(InputError, match=r"materials = .*and now"):
        script(250.0, True)


@pytest.mark.ranks
def test_what_differs_by_more_than_numbers_is_refused(comm: MPI.Intracomm) -> None:
    scene = scene_of(comm, FABRIC)

    def refused(call: Callable[[], None], message: str) -> None:
        before, changes = dict(scene.materials), scene.versions.model_version
        with pytest.raises(InputError, match=message):
            call()
        assert scene.materials == before and scene.versions.model_version == changes

    refused(lambda: scene.set_material({"roof": FABRIC}), "part 'roof'; there are none")
    refused(lambda: scene.set_material({}), "not a valid mapping")
    refused(lambda: scene.set_material(FOIL), "same class, OrthotropicMembrane")
    refused(lambda: scene.set_material(3.0), "3.0 of the membrane is not of the same class")  # type: ignore[arg-type]
    refused(lambda: scene.set_material(replace(FABRIC, wrinkling=False)), "wrinkling=False")
    refused(lambda: scene.set_material(replace(FABRIC, warp=(0.0, 1.0, 0.0))), "warp")
    refused(lambda: scene.set_stiffness({}), "write {cable: EA")
    refused(lambda: scene.set_stiffness({"ridge": 3.0}), "'ridge' is not a cable or bar")  # type: ignore[dict-item]
    scene.set_material(replace(FABRIC, warp=[1.0, 0.0, 0.0]))  # type: ignore[arg-type]
    scene = scene_of(comm, UflMembrane(lambda E: E[0, 0] ** 2 + E[1, 1] ** 2 + E[0, 1] ** 2))
    refused(
        lambda: scene.set_material(
            UflMembrane(lambda E: E[0, 0] ** 2 + E[1, 1] ** 2 + E[0, 1] ** 2)
        ),
        "density of your own",
    )
    scene = Scene(scene.mesh, LINEAR, strain="step")
    refused(lambda: scene.set_material(LINEAR), 'strain="step"')
    solver = roof(comm, FOIL)
    scene, ridge = solver.scene, solver.scene.cable("ridge")
    refused(lambda: scene.set_stiffness({ridge: 0.0}), "EA of 'ridge' = 0.0 is not positive")
    assert ridge.cable == CABLE


@pytest.mark.ranks
def test_of_a_part_inside_another(comm: MPI.Intracomm) -> None:
    """The one that is named, whatever the order of names: "patch" lies inside of "roof", and is
    numbered after it, though it comes before it in the alphabet."""
    points, cells = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)], [(0, 1, 3), (1, 4, 3)]
    cells += [(1, 2, 4), (2, 5, 4)]
    parts = {"roof": [0, 1, 2, 3], "patch": [2, 3]}
    mesh = meshes.from_arrays(comm, np.array(points, dtype=float), cells, parts=parts)
    scene = Scene(mesh, {"roof": FOIL, "patch": LINEAR})
    scene.set_material({"patch": replace(LINEAR, E=70.0)})
    assert [own.E for own in scene.materials.values()] == [FOIL.E, 70.0]  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="of part 'patch' has wrinkling"):
        scene.set_material({"patch": FOIL})
