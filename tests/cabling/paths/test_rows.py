"""Cables along lines of the mesh: as the same cables laid by path and held sideways, in all that
is made of them."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lined_roof import (
    CELLS,
    LINES,
    SIDE,
    STEEL,
    bare_scene,
    lined_roof,
    lined_scene,
    net_of_lines,
    path_along,
    rise,
)
from mpi4py import MPI
from same_state import assert_same, assert_same_state

from crms_fenicsx import (
    Cable,
    Friction,
    InputError,
    LaidCable,
    PathError,
    PathWarning,
    Scene,
    Solver,
    meshes,
    nets,
    output,
    study,
)
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.model.cable import HOLDS, Hold, Net, NetLine
from crms_fenicsx.results.foundations import foundations

pytestmark = pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")


def without_lines(scene: Scene) -> None:
    """Forget on which lines the cables lie, and compare their states with others."""
    for cable in scene.cables:
        cable.update(line=None, hold="pocket" if HOLDS[cable.hold].along else "bonded")


@pytest.mark.ranks
@pytest.mark.parametrize("hold", HOLDS)
def test_a_cable_along_a_line_is_that_laid_by_path_and_held(
    comm: MPI.Intracomm, hold: Hold
) -> None:
    scenes = []
    for on_lines in (True, False):
        held = hold if on_lines or hold == "bonded" else "pocket"
        scene, _ = lined_scene(comm, on_lines, hold=held)
        solver = Solver(scene)
        solver.advance(pressure=4.0)
        solver.advance(pressure=6.0)
        scenes.append(scene)
    assert [cable.state.laid.line for cable in scenes[0].cables] == list(LINES)
    without_lines(scenes[0])
    assert_same_state(scenes[0].state, scenes[1].state)


@pytest.mark.ranks
def test_all_lines_of_a_net_are_laid_at_once(comm: MPI.Intracomm) -> None:
    one, single = lined_scene(comm, True)
    other = bare_scene(lined_roof(comm))
    together = other.lay_net(net_of_lines(), STEEL, tension=2.0, hold="pocket")
    assert [cable.name for cable in together] == list(LINES)
    assert_same([a.state for a in single], [b.state for b in together], "cables")
    assert one.net.strip is not None and other.net.strip is not None
    assert np.array_equal(one.net.strip.cells, other.net.strip.cells)


@pytest.mark.ranks
def test_a_net_on_other_meshes_folds_their_cells(
    comm: MPI.Intracomm, caplog: pytest.LogCaptureFixture
) -> None:
    scene = bare_scene(lined_roof(comm))
    path = path_along("A1") + (0.1, 0.0, 0.0)
    net = Net((NetLine("C1", path, SIDE),), ())
    with caplog.at_level(logging.INFO, logger="crms_fenicsx"):
        (cable,) = scene.lay_net(net, STEEL)
    assert cable.state.laid.line is None and cable.state.nodes[3].kind == "fold"
    assert ("meshes.along(mesh, net.paths)" in caplog.text) == (comm.rank == 0)
    assert [*net.paths] == ["C1"] and net.paths["C1"] is path


def loaded(comm: MPI.Intracomm, on_lines: bool, folder: Path) -> dict[str, Any]:
    """What users ask of a scene with cables that rub along their axes, under many loads."""
    cable = Cable(EA=2e3, friction=Friction(0.3, along=0.2))
    scene, cables = lined_scene(comm, on_lines, cable)
    scene.put_load((0.0, 0.0, -1.0), name="snow")
    scene.put_line_load((0.0, 0.0, -3.0), "A1", name="gutter")
    solver = Solver(scene, results=folder / f"{on_lines}")
    solver.advance(pressure=5.0)
    found: dict[str, Any] = {"tensions": [one.tensions for one in cables]}
    cases = {"snow": {"snow": 1.5, "pressure": 5.0}, "gutter": {"gutter": 1.0, "pressure": 5.0}}
    found["cases"] = [one.snapshot.tensions for one in solver.combine(cases).values()]
    first = cables[0]
    solver.advance(L0={first: 0.998 * first.L0}, load={"gutter": 1.0})
    found["contact"] = solver.contact_forces(first).normal
    found["cables"] = [vars(one) for one in solver.cable_forces().values()]
    places = path_along("B1")[1:-1, :2]
    found["places"] = solver.results().at(places).displacement
    found["reactions"] = solver.reactions("boundary").total
    found["foundations"] = [line.force for line in foundations(solver.system).lines]
    found["summary"] = [vars(one) for one in solver.summary().cables.values()]
    found["error"] = solver.estimate_error().relative
    order = nets.lengths_to_order(scene, tension=5.0)
    found["order"] = [one.cut for one in order.cables.values()]
    found["verified"] = [check.value for check in verification(solver).checks]
    found["history"] = [solver.history[f"tension {name}"] for name in LINES]
    return found


def verification(solver: Solver) -> Any:
    """The last step's verification, which it has passed."""
    found = solver.steps[-1].verification
    assert found is not None and found.passed
    return found


def test_all_results_are_those_of_cables_laid_by_path(comm: MPI.Intracomm, folder: Path) -> None:
    along, by_path = (loaded(comm, on_lines, folder) for on_lines in (True, False))
    assert np.ptp(along["tensions"][0]) > 1e-3 * along["tensions"][0].max()  # capstan friction
    for name, value in along.items():
        assert_same(value, by_path[name], name)


def test_lengths_are_tuned_by_exact_slopes(comm: MPI.Intracomm) -> None:
    found = []
    for on_lines in (True, False):
        scene, cables = lined_scene(comm, on_lines)
        solver = Solver(scene)
        solver.advance(pressure=4.0)
        slopes = solver.sensitivities([*cables, "energy"], [*cables, "pressure"])
        lengths = nets.tune(solver, dict.fromkeys(cables, 20.0))
        assert [cable.tension for cable in cables] == pytest.approx([20.0] * 3, rel=1e-4)
        found.append((slopes.values, [*lengths.values()]))
    assert_same(*found, "slopes and lengths")


def test_saved_loaded_and_resumed(comm: MPI.Intracomm, folder: Path) -> None:
    scene, _ = lined_scene(comm, True, hold="outside")
    solver = Solver(scene)
    solver.advance(pressure=4.0)
    solver.save(folder / "checkpoint")
    other = bare_scene(scene.mesh)
    again = Solver(other)
    again.load(folder / "checkpoint")
    assert other.cable("B1").state.laid.line == "B1" and other.cable("B1").keeps_line
    assert_same_state(scene.state, other.state)
    again.advance(pressure=6.0)
    solver.advance(pressure=6.0)
    assert other.cable("B1").tension == pytest.approx(scene.cable("B1").tension, rel=1e-9)
