"""Cables along lines of the mesh: as the same cables laid by path and held sideways, in all that
is made of them."""

from __future__ import annotations

import logging
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
from walled_roof import walled_roof

from crms_fenicsx import (
    Cable,
    Friction,
    InputError,
    LaidCable,
    Scene,
    Solver,
    meshes,
    nets,
    output,
    study,
)
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch
from crms_fenicsx.cabling.paths.geodesic_sliding import GeodesicSliding
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.model.cable import HOLDS, Hold, Net, NetLine
from crms_fenicsx.results.foundations import foundations

pytestmark = pytest.mark.filterwarnings("ignore::crms_fenicsx.PathWarning")


def without_lines(scene: Scene) -> None:
    """Forget on which lines the cables lie, and where those cross that may lift off."""
    scene.net.crossings = ()
    for cable in scene.cables:
        cable.update(line=None, hold="pocket" if HOLDS[cable.hold].along else "bonded")


@pytest.mark.ranks
@pytest.mark.parametrize("hold", HOLDS)
def test_a_cable_along_a_line_is_that_laid_by_path_and_held(
    comm: MPI.Intracomm, hold: Hold
) -> None:
    mesh, scenes = lined_roof(comm), []
    for on_lines in (True, False):
        held = hold if on_lines or hold == "bonded" else "pocket"
        scene, _ = lined_scene(mesh, on_lines, hold=held)
        solver = Solver(scene, slide=False)
        solver.advance(pressure=4.0)
        solver.advance(pressure=6.0)
        scenes.append(scene)
    assert [cable.state.laid.line for cable in scenes[0].cables] == list(LINES)
    without_lines(scenes[0])
    assert_same_state(scenes[0].state, scenes[1].state, rtol=1e-10)


@pytest.mark.ranks
def test_all_lines_of_a_net_are_laid_at_once(comm: MPI.Intracomm) -> None:
    mesh = lined_roof(comm)
    one, single = lined_scene(mesh, True)
    other = bare_scene(mesh)
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
    path = path_along("A1") + np.array([0.1, 0.0, 0.0])
    net = Net((NetLine("C1", path, SIDE),), ())
    with caplog.at_level(logging.INFO, logger="crms_fenicsx"):
        (cable,) = scene.lay_net(net, STEEL)
    assert cable.state.laid.line is None and cable.state.nodes[3].kind == "fold"
    assert ("meshes.along(mesh, net.paths)" in caplog.text) == (comm.rank == 0)
    assert [*net.paths] == ["C1"] and net.paths["C1"] is path


def loaded(mesh: MembraneMesh, on_lines: bool, folder: Path) -> dict[str, Any]:
    """What users ask of a scene with cables that rub along their axes, under many loads."""
    cable = Cable(EA=2e3, friction=Friction(0.3, along=0.2))
    scene, cables = lined_scene(mesh, on_lines, cable)
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
    found["verified"] = [check.name for check in verification(solver).checks]
    found["history"] = [solver.history[f"tension {name}"] for name in LINES]
    return found


def verification(solver: Solver) -> Any:
    """The last step's verification, which it has passed."""
    found = solver.steps[-1].verification
    assert found is not None and found.passed
    return found


def test_all_results_are_those_of_cables_laid_by_path(comm: MPI.Intracomm, folder: Path) -> None:
    mesh = lined_roof(comm)
    along, by_path = (loaded(mesh, on_lines, folder) for on_lines in (True, False))
    assert np.ptp(along["tensions"][0]) > 1e-3 * along["tensions"][0].max()  # capstan friction
    for name, value in along.items():
        assert_same(value, by_path[name], name, 1e-10)


def test_lengths_are_tuned_by_exact_slopes(comm: MPI.Intracomm) -> None:
    mesh, found = lined_roof(comm), []
    for on_lines in (True, False):
        scene, cables = lined_scene(mesh, on_lines)
        solver = Solver(scene)
        solver.advance(pressure=4.0)
        slopes = solver.sensitivities([*cables, "energy"], [*cables, "pressure"])
        lengths = nets.tune(solver, dict.fromkeys(cables, 20.0))
        assert [cable.tension for cable in cables] == pytest.approx([20.0] * 3, rel=1e-4)
        found.append((slopes.values, [*lengths.values()]))
    assert_same(*found, "slopes and lengths", 1e-9)


def test_saved_loaded_and_resumed(comm: MPI.Intracomm, folder: Path) -> None:
    scene, _ = lined_scene(lined_roof(comm), True, hold="outside")
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


@pytest.mark.ranks
def test_the_script_goes_on_after_a_kill(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = lined_roof(comm)

    def script(name: str, resume: bool) -> Scene:
        scene = bare_scene(mesh)
        scene.lay_net(net_of_lines(), STEEL, tension=2.0)
        solver = Solver(scene, results=folder / name, resume=resume)
        solver.advance(pressure=3.0)
        solver.advance(L0={scene.cables[0]: 0.99 * scene.cables[0].L0}, pressure=6.0, steps=2)
        return scene

    whole = script("whole", False)
    find = EquilibriumSearch.find

    def killed(self: EquilibriumSearch, *arguments: Any, **options: Any) -> Any:
        if self.scene.pressure == 6.0:
            raise KeyboardInterrupt
        return find(self, *arguments, **options)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(EquilibriumSearch, "find", killed)
        script("broken", False)
    resumed = script("broken", True)
    for scene in (whole, resumed):
        scene.net.arrange_crossings()  # those at vertices keep the places where they were found
    assert_same_state(whole.state, resumed.state, rtol=1e-10)


@pytest.mark.ranks
def test_combinations_of_loads_go_on_after_a_kill(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With cables that lift off and cross; as on one process, and nothing is computed twice."""
    cases = {
        "pressure": {"pressure": 6.0},
        "storm": {"pressure": 5.0, "wind": 12.0},
        "snow": {"pressure": 4.0, "snow": 1.0},
    }
    solved: list[float] = []
    find = EquilibriumSearch.find

    def script(name: str, resume: bool, comm: MPI.Intracomm, until: str = "") -> list[list[float]]:
        def seen(self: EquilibriumSearch, *arguments: Any, **options: Any) -> Any:
            if solver.case and solver.case == until:
                raise KeyboardInterrupt
            solved.append(scene.pressure)
            return find(self, *arguments, **options)

        scene = bare_scene(lined_roof(comm))
        scene.lay_net(net_of_lines(), STEEL, hold="outside", tension=2.0)
        scene.put_load((0.0, 0.0, -1.0), name="snow")
        scene.put_wind(1.0, lambda points, normals: np.interp(normals[0], [-0.5, 0.5], [0.8, -1.0]))
        solver = Solver(scene, results=folder / name, resume=resume)
        with monkeypatch.context() as patch:
            patch.setattr(EquilibriumSearch, "find", seen)
            solver.advance(pressure=3.0, L0={cable: 0.995 * cable.L0 for cable in scene.cables})
            found = solver.combine(cases)
        solver.restore(found["storm"].snapshot)
        assert any(cable.state.lifted.any() for cable in scene.cables)
        assert all(cable.state.laid.line and cable.keeps_line for cable in scene.cables)
        return [[*one.snapshot.tensions.values()] for one in found.values()]

    whole = script("whole", False, comm)
    steps = len(solved)
    with pytest.raises(KeyboardInterrupt):
        script("broken", False, comm, "snow")
    solved.clear()
    assert_same(script("broken", True, comm), whole, "resumed", 1e-10)
    assert 0 < len(solved) < steps
    if comm.rank == 0:
        # the storm releases contacts one by one, in an order that hangs on rounding
        assert_same(script("alone", False, MPI.COMM_SELF), whole, "alone", 5e-6)


def test_files_pictures_and_reports_show_them(comm: MPI.Intracomm, folder: Path) -> None:
    scene = bare_scene(lined_roof(comm))
    cables = scene.lay_net(net_of_lines(), STEEL, tension=2.0)
    solver = Solver(scene, results=folder)
    solver.advance(pressure=4.0)
    output.draw_paths(scene, folder / "paths.png", [output.Line(cables[0].line, name="A1")])
    solver.draw(folder / "roof.png")
    solver.report(folder / "report.html", unit="m", force="kN")
    if comm.rank == 0:
        page = (folder / "report.html").read_text()
        assert all(name in page for name in LINES) and page.count("on a mesh line") == len(LINES)
        assert (folder / "paths.png").stat().st_size > 0 < (folder / "roof.png").stat().st_size
        assert list(folder.glob("**/*cables*"))
    assert all(f"tension {cable.name}" in solver.history.columns for cable in cables)


def test_finer_meshes_have_the_finer_lines(comm: MPI.Intracomm) -> None:
    def build(mesh: MembraneMesh) -> Solver:
        scene = bare_scene(mesh)
        scene.lay_net(net_of_lines(), STEEL, tension=2.0, hold="pocket")
        solver = Solver(scene)
        solver.advance(pressure=4.0)
        return solver

    found = study.convergence(build, lined_roof(comm), levels=2)
    fine = build(meshes.refine(lined_roof(comm)))
    for cable in fine.scene.cables:
        assert len(cable.line) == 2 * CELLS + 1
        assert found[f"tension {cable.name}"].limit == pytest.approx(cable.tension, rel=0.2)
        # between the given vertices the finer rows run on the smooth surface, not beside it
        family, k = LINES[cable.name]
        aside = cable.reference_positions[1:-1, family] - k * SIDE / CELLS
        assert np.abs(aside).max() < 0.02


def test_cables_along_lines_are_not_searched_for(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*arguments: object) -> None:
        raise AssertionError("a search")

    slid: list[str] = []
    slide = GeodesicSliding._slide

    def seen(self: GeodesicSliding, cables: Any, *arguments: Any, **options: Any) -> int:
        slid.extend(cable.name for cable in cables)
        return slide(self, cables, *arguments, **options)

    scene, _ = lined_scene(lined_roof(comm), True, hold="outside")
    with monkeypatch.context() as patch:
        for name in ("traced_over_holes", "shortened", "cells_below"):
            patch.setattr(f"crms_fenicsx.cabling.paths.laying.{name}", refuse)
        patch.setattr(GeodesicSliding, "__init__", refuse)
        solver = Solver(scene)
        solver.advance(pressure=4.0)
    held = scene.cable("B1").path
    scene.lay_cable(STEEL, [(0.0, 4.6), (8.0, 6.7)], name="free", tension=2.0)
    monkeypatch.setattr(GeodesicSliding, "_slide", seen)
    solver.advance(pressure=6.0)
    assert set(slid) == {"free"}
    assert scene.cable("B1").path == held and not scene.cable("free").keeps_line


@pytest.mark.parametrize("hold", ["outside", "pocket"])
def test_friction_acts_where_a_cable_may_slide(comm: MPI.Intracomm, hold: Hold) -> None:
    scene = bare_scene(lined_roof(comm))
    cable = Cable(EA=2e3, friction=Friction(0.3, along=0.2))
    kept = scene.lay_cable(cable, along="A1", hold=hold).cable
    assert (kept.sideways is None) == (hold == "pocket") and kept.along == 0.2
    smooth = scene.lay_cable(Cable(EA=2e3, friction=0.3), along="B1", hold=hold).cable
    assert (smooth.sideways is None) == (hold == "pocket") and smooth.along == 0.0


def test_ends_directions_and_anchors(comm: MPI.Intracomm) -> None:
    scene = bare_scene(lined_roof(comm))
    path = path_along("B1")

    def ends(*args: Any, along: str = "B1") -> Any:
        cable = scene.lay_cable(STEEL, *args, along=along, hold="pocket", name="one")
        line, nodes = cable.line, [cable.state.nodes[k].kind for k in (0, -1)]
        scene.remove(cable)
        return line[0], line[-1], nodes

    held = ["anchor", "anchor"]
    assert_same(ends(), (path[0], path[-1], held), "from smaller to larger x")
    assert_same(ends(path[::-1]), (path[-1], path[0], held), "as the path")
    assert_same(ends(path[[-1, 0], :2]), (path[-1], path[0], held), "as the path in plan")
    stay = np.array([[-1.0, 2.0, -0.5], *path, [8.0, 2.0, 0.0]])
    assert_same(ends(stay), (stay[0], path[-1], held), "from an anchor")
    assert_same(ends([stay[-1], stay[0]]), (path[-1], stay[0], held), "to an anchor")
    joint = scene.add_joint((9.0, 2.0, 1.0), held="xyz")
    found = scene.lay_cable(STEEL, [path[0], joint], along="B1", hold="pocket")
    assert found.state.laid.joints == (None, joint.name)
    assert_same(found.line[-1], np.array(joint.position), "joint")


@pytest.mark.ranks
def test_ends_move_with_their_edge_but_not_along_it(comm: MPI.Intracomm) -> None:
    mesh, found = lined_roof(comm), []
    for on_lines in (True, False):
        scene, cables = lined_scene(mesh, on_lines, hold="sleeve" if on_lines else "pocket")
        solver = Solver(scene, slide=False)
        solver.advance(pressure=4.0)
        solver.advance(move={"boundary": lambda x, t: 0.02 * t * np.sin(x)})
        solver.advance(move={cables[0].start: (0.0, -0.2, 0.1)})
        found.append([(one.tension, one.line) for one in cables])
    assert_same(*found, "cables", 1e-9)
    scene, cables = lined_scene(mesh, True)
    solver = Solver(scene)
    solver.advance(pressure=4.0)
    for move in ((0.6, 0.0, 0.0), (1.0, 0.0, 0.0)):
        moved = {cables[0].start: move}
        refused(scene, lambda moved=moved: solver.advance(move=moved), "'A1'", "edge", "its path")


def test_lines_are_found_far_away_and_in_other_units(comm: MPI.Intracomm) -> None:
    scale, origin = 1e3, np.array([3e6, -2e6, 1e5])
    near, far = bare_scene(lined_roof(comm)), bare_scene(lined_roof(comm, {}, scale, origin))
    lines = [NetLine(one.name, scale * one.path + origin, SIDE) for one in net_of_lines().lines]
    stay = np.array([[8.0, 2.0, 0.0], [-1.0, 2.0, -0.5]])
    for scene, layout in ((near, net_of_lines()), (far, Net(tuple(lines), ()))):
        scene.lay_net(layout, STEEL)
        scene.lay_cable(STEEL, along="B1", name="plain")
    near.lay_cable(STEEL, stay, along="B1", name="stayed")
    far.lay_cable(STEEL, scale * stay + origin, along="B1", name="stayed")
    for one, other in zip(near.cables, far.cables, strict=True):
        assert other.L0 == pytest.approx(scale * one.L0, rel=1e-9)
        assert np.abs((other.line - origin) / scale - one.line).max() < 1e-8
        assert [node.kind for node in one.state.nodes] == [node.kind for node in other.state.nodes]


def test_a_line_along_the_free_rim_is_a_pocket(comm: MPI.Intracomm) -> None:
    rim = [(k, k + 1) for k in range(CELLS)]
    scene = Scene(lined_roof(comm, {"edge": rim}), bare_scene(lined_roof(comm)).materials[0])
    scene.fix(lambda x: x[0] > 7.9)
    cable = scene.lay_cable(STEEL, along="edge")
    assert cable.hold == "pocket"
    assert_same([one.kind for one in cable.state.nodes], ["vertex"] * (CELLS + 1), "nodes")


def refused(scene: Scene, call: Callable[[], object], *words: str) -> None:
    """A call is refused on all ranks with these words, and changes nothing."""
    before = scene.state
    with pytest.raises(InputError) as found:
        call()
    assert all(word in str(found.value) for word in words), found.value
    assert_same_state(before, scene.state)


@pytest.mark.ranks
def test_lines_that_are_none_are_refused(comm: MPI.Intracomm) -> None:
    n = CELLS + 1
    fork = [(30, 31), (31, 32), (31, 31 + n)]
    loop = [(30, 31), (31, 31 + n), (30 + n, 31 + n), (30, 30 + n)]
    gap = [(30, 31), (33, 34)]
    mesh = lined_roof(comm, {"fork": fork, "loop": loop, "gap": gap})
    scene = bare_scene(mesh)

    def lay(*args: Any, **options: Any) -> Callable[[], LaidCable]:
        return lambda: scene.lay_cable(STEEL, *args, **options)

    refused(scene, lay(along="A9"), "'A9'", "'A1'", "'B1'")
    refused(scene, lay(along=3), "3", "'A1'")
    refused(scene, lay(along="fork"), "'fork'", "branches", "3 ends", "open line")
    refused(scene, lay(along="gap"), "'gap'", "4 ends")
    refused(scene, lay(along="loop"), "'loop'", "closed", "open line")
    refused(scene, lay(along="boundary"), "'boundary'", "closed")
    refused(scene, lay(along="A1", shortest=True), "'A1'", "shortest")
    refused(scene, lay(), "neither path nor along")
    refused(scene, lay([(0.0, 2.0), (8.0, 2.0)], along="A1"), "'A1'", "same end")
    refused(scene, lay([(3.0, 0.0), (3.0, 6.0)], along="A1"), "(3, 6, 0)", "2 from the end", "'A1'")
    inside = (3.0, 6.0, float(rise(np.array(3.0), np.array(6.0))))
    refused(scene, lay([(3.0, 0.0, 0.0), inside], along="A1"), "from the end", "anchor")
    refused(scene, lay(along="A1", L0=3.0, tension=1.0), "both L0 and tension")
    refused(scene, lay(along="A1", tension=-1.0), "tension", "-1")
    refused(scene, lay(along="A1", hold="bonded", name=" "), "name")
    scene.lay_cable(STEEL, along="A1")
    refused(scene, lay(along="A1"), "'A1'", "another name")
    assert scene.lay_cable(STEEL, along="A1", name="second").state.laid.line == "A1"


@pytest.mark.ranks
def test_nets_of_other_meshes_are_refused(comm: MPI.Intracomm) -> None:
    scene = bare_scene(lined_roof(comm))
    some = Net((*net_of_lines().lines, NetLine("A3", path_along("A1"), SIDE)), ())
    refused(scene, lambda: scene.lay_net(some, STEEL), "not A3", "meshes.along(mesh, net.paths)")
    swapped = Net(
        (NetLine("A1", path_along("A2"), SIDE), NetLine("A2", path_along("A1"), SIDE)), ()
    )
    refused(scene, lambda: scene.lay_net(swapped, STEEL), "'A1'", "2 from that of the mesh")
    half = bare_scene(lined_roof(comm, {"half": [(40, 41), (41, 42), (42, 43)]}))
    path = [(4.0, y, float(rise(np.array(4.0), np.array(y)))) for y in (4.0, 5.0, 6.0, 7.0, 8.0)]
    longer = Net((NetLine("half", np.array(path), SIDE),), ())
    refused(half, lambda: half.lay_net(longer, STEEL), "'half'", "from that of the mesh")
    scene.lay_cable(STEEL, along="A2")
    refused(scene, lambda: scene.lay_net(net_of_lines(), STEEL), "'A2'", "another name")


@pytest.mark.ranks
def test_a_line_on_a_seam_lies_on_the_roof_but_none_behind_it(comm: MPI.Intracomm) -> None:
    points, cells, parts = walled_roof(n=4, size=8.0, walls=(0.5,), height=2.0, rise=0.5)
    seam = np.array([2, 7, 12, 17, 22])
    behind = np.arange(30, 35)
    edges = {
        name: np.stack([row[:-1], row[1:]], axis=1)
        for name, row in (("seam", seam), ("low", behind))
    }
    outside = {"wall": (1.0, 0.0, 0.0)}
    mesh = meshes.from_arrays(comm, points, cells, edges=edges, parts=parts, outside=outside)
    found = []
    for on_lines in (True, False):
        scene = bare_scene(mesh)
        given = {"along": "seam"} if on_lines else {"path": points[seam], "name": "seam"}
        scene.lay_cable(STEEL, hold="pocket", tension=1.0, **given)
        scene.put_load((0.0, 0.0, 1.0), name="lift")
        Solver(scene).advance(load={"lift": 1.0})
        without_lines(scene)
        found.append(scene)
        refused(
            scene, lambda scene=scene: scene.lay_cable(STEEL, along="low"), "'low'", "behind a seam"
        )
    assert_same_state(found[0].state, found[1].state, rtol=1e-10)
