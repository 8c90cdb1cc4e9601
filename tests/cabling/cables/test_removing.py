"""Cables that are taken away: the equilibrium does without them, and nothing is inherited."""

from __future__ import annotations

import shutil
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import FOIL, LINEAR, advanced, clamped, square
from mpi4py import MPI
from vtu_file import read_vtu

from crms_fenicsx import Cable, Friction, InputError, LaidCable, Scene, Solver
from crms_fenicsx.results.checkpoint.journal import Journal
from crms_fenicsx.results.output import History, draw, draw_history

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD
SMOOTH, ROUGH = Cable(EA=9000.0), Cable(EA=9000.0, friction=Friction(0.3, along=0.2))
PATHS = {
    "a": [(0.0, 33.0), (100.0, 41.0)],
    "b": [(0.0, 60.0), (100.0, 67.0)],
    "across": [(45.0, 0.0), (57.0, 100.0)],
}


def sheet(n: int = 8, **laws: Any) -> Scene:
    return clamped(square(COMM, n), LINEAR if laws else FOIL, **laws)


def lay(scene: Scene, name: str, cable: Cable = SMOOTH, **options: Any) -> LaidCable:
    return scene.lay_cable(cable, PATHS[name], tension=options.pop("tension", 20.0), name=name)


def inflated(names: str | list[str], cable: Cable = SMOOTH, **options: Any) -> Solver:
    """A square under pressure, then under tightened cables."""
    solver = advanced(Solver(sheet(), **options), pressure=0.01)
    cables = [lay(solver.scene, name, cable) for name in names]
    solver.advance(L0={cable: 0.99 * cable.L0 for cable in cables})
    return solver


def numbers(scene: Scene) -> list[float]:
    values = [scene.energy, scene.volume]
    return values + [x for cable in scene.cables for x in (cable.tension, cable.length)]


@pytest.mark.ranks
@pytest.mark.parametrize("names", [["a"], ["a", "across"], ["across", "a", "b"]])
@pytest.mark.parametrize("gone", [0, -1])
def test_as_if_it_had_never_been(names: list[str], gone: int) -> None:
    """Without friction the equilibrium knows nothing of it; the others keep their numbers."""
    solver = inflated(names)
    scene = solver.scene
    cables, cable = list(scene.cables), scene.cables[gone]
    scene.remove(cable)
    cables.remove(cable)
    assert list(scene.cables) == cables
    assert all({k.lower, k.upper} <= set(range(len(cables))) for k in scene.net.crossings)
    assert solver.results() is not None  # of a state that is no equilibrium
    solver.advance()
    never = inflated([name for name in names if name != cable.name])
    never.advance()
    np.testing.assert_allclose(numbers(scene), numbers(never.scene), rtol=1e-6)
    assert solver.steps[-1].verification.passed
    own = [k for laid in scene.cables for k in laid.state.nodes if k.crossing is not None]
    assert {node.crossing for node in own} == set(range(len(scene.net.crossings)))


def test_friction_of_a_cable_that_is_gone() -> None:
    """Its heat stays, of the others all; those go on from where they stick."""
    solver = inflated(["a", "across"], ROUGH)
    scene = solver.scene
    solver.advance(pressure=0.012)
    lost, bounds = scene.dissipated, scene.cable("a").state.law.lateral.bounds
    assert scene.cable("a").dissipated > 0.0 < scene.cable("across").dissipated
    scene.remove("across")
    assert scene.dissipated == pytest.approx(lost, rel=1e-14)
    solver.advance()
    assert scene.dissipated >= lost
    assert len(scene.cable("a").state.law.lateral.bounds) and len(bounds)
    scene.remove("a")
    solver.advance()
    np.testing.assert_allclose(solver.history["dissipated"][-1], scene.dissipated)
    flat = advanced(Solver(sheet()), pressure=0.012)
    assert scene.energy == pytest.approx(flat.scene.energy, rel=1e-7)


@pytest.mark.parametrize("laws", [{"strain": "step"}, {"pressure": "step"}])
def test_step_laws_keep_what_cells_had_when_they_were_folded(laws: dict[str, str]) -> None:
    """Their energy and volume of all steps before are those of plain cells now."""
    energies = []
    for cabled in (True, False):
        scene = sheet(4, **laws)
        solver = advanced(Solver(scene), pressure=0.005, steps=2)
        if cabled:  # on a third of the cells
            lay(scene, "a", tension=0.1)
        solver.advance(pressure=0.02, steps=6)
        if cabled:
            assert scene.cable("a").taut
            scene.remove("a")
        solver.advance()
        energies.append([scene.energies[name] for name in ("membrane", "pressure")])
    np.testing.assert_allclose(energies[0], energies[1], rtol=0.02)


def test_a_new_cable_of_its_name_inherits_nothing() -> None:
    solver = inflated(["a", "b"])
    scene = solver.scene
    old = scene.cable("a")
    tried = solver.search.tried
    tried.refused["a"], tried.refused["b"] = {((0,),)}, {((1,),)}
    scene.remove(old)
    new = lay(scene, "a")
    assert new is not old and new.state.memory.ends_before is None
    solver._increments.forget_removed()  # as the next load step does
    assert solver.search.tried.refused == {"b": {((1,),)}}
    assert set(solver.search.tried.at) == {"b"}
    solver.advance()
    with pytest.raises(InputError, match=r"advance: .*'a'.* is not a cable or bar of this scene"):
        solver.advance(L0={old: 90.0})
    scene.remove("b")
    assert scene.lay_cable(SMOOTH, PATHS["b"]).name == "cable 4", "no name of another one"


@pytest.mark.ranks
def test_what_cannot_be_removed() -> None:
    scene, other = sheet(2), sheet(2)
    cable, theirs = lay(scene, "a"), lay(other, "a")
    for bad in (theirs, 3, None, cable.start, "b"):
        with pytest.raises(InputError, match=r"not a cable of this scene|is no cable 'b'"):
            scene.remove(bad)  # type: ignore[arg-type]
    assert list(scene.cables) == [cable]
    scene.remove(cable)
    with pytest.raises(InputError, match="is not a cable of this scene"):
        scene.remove(cable)
    if COMM.size > 1:
        lay(scene, "a")
        lay(scene, "b")
        with pytest.raises(InputError, match="remove: cable = 'a' on rank 0, but 'b' on rank"):
            scene.remove("a" if COMM.rank == 0 else "b")


def test_files_of_a_run(folder: Path) -> None:
    """Its columns stay, empty from then on; the series shows it no more."""
    solver = inflated(["a"], results=folder)
    solver.scene.remove("a")
    solver.advance()
    draw(solver, folder / "now.png", colour="stress")
    draw_history(solver.history, folder / "history.png")
    COMM.barrier()
    table = History.read(folder / "history.csv")
    assert np.isnan(table["tension a"]).tolist() == [True, False, True]
    assert table["blocked points"][-1] == 0
    entries = list(ElementTree.parse(folder / "cables.pvd").getroot().iter("DataSet"))
    assert [entry.attrib["timestep"] for entry in entries] == ["2.0", "3.0"]
    sizes = [len(read_vtu(folder / entry.attrib["file"]).points) for entry in entries]
    assert sizes[0] > 0 and sizes[1] == 0


def script(folder: Path, resume: bool) -> Solver:
    """Two crossing cables, one of which is replaced by another one of the same name."""
    scene = sheet()
    solver = Solver(scene, results=folder / "out", resume=resume)
    cables = [lay(scene, name, ROUGH) for name in ("a", "across")]
    solver.advance(pressure=0.01)
    scene.remove(cables[0])
    solver.advance(pressure=0.011, steps=2)
    lay(scene, "a")
    solver.advance(pressure=0.012)
    scene.remove("across")
    scene.remove("a")
    solver.advance(pressure=0.01)
    scene.lay_cable(SMOOTH, PATHS["b"])
    solver.advance()
    return solver


@pytest.mark.ranks
def test_resumed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After each of its load steps and after all, from what a process that was killed then left."""
    kept, keep = 0, Journal.keep

    def copied(self: Journal, *arguments: Any) -> None:
        nonlocal kept
        keep(self, *arguments)
        kept += 1
        COMM.barrier()
        if COMM.rank == 0:
            shutil.copytree(folder / "whole" / "out", folder / str(kept) / "out")
        COMM.barrier()

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "keep", copied)
        whole = script(folder / "whole", False)
    assert kept == 6
    due, names = list(whole.history["energy"]), [cable.name for cable in whole.scene.cables]
    assert names == ["cable 4"]
    for count in range(1, 7, 1 if COMM.size == 1 else 3):
        again = script(folder / str(count), True)
        np.testing.assert_allclose(again.history["energy"], due, rtol=1e-7)
        assert [cable.name for cable in again.scene.cables] == names
        # of first order in what the solver leaves over, the energy of second
        assert again.scene.dissipated == pytest.approx(whole.scene.dissipated, rel=1e-4)


@pytest.mark.ranks
def test_saved_and_loaded(folder: Path) -> None:
    solver = inflated(["a", "across", "b"], ROUGH)
    solver.scene.remove("a")
    solver.save(folder / "point")
    again = Solver(sheet())
    again.load(folder / "point")
    for one in (solver, again):
        one.advance(pressure=0.012)
    np.testing.assert_allclose(numbers(again.scene), numbers(solver.scene), rtol=1e-7)
    assert again.scene.dissipated == pytest.approx(solver.scene.dissipated, rel=1e-7)
    assert again.scene.lay_cable(SMOOTH, PATHS["a"]).name == "cable 4"
