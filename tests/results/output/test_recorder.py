"""What a run records: history, ParaView series, pictures by one call."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet, square
from mpi4py import MPI
from vtu_file import VtuFile, read_vtu

from crms_fenicsx import (
    Cable,
    ConvergenceError,
    InputError,
    OrthotropicMembrane,
    PictureWarning,
    Solver,
)
from crms_fenicsx.cabling.cables.deformed_surface import current_surface
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.results.output import History, Line, draw, draw_history, draw_paths
from crms_fenicsx.results.output.figures import draw_scene
from crms_fenicsx.results.output.figures.plots import default_panels
from crms_fenicsx.results.quantities import QUANTITY_OF
from crms_fenicsx.results.recovered_values import at_facets, recovered

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD


def run(results: Path | None) -> Solver:
    """Inflate a square in 2 steps, then tighten a cable over it in 1."""
    fabric = OrthotropicMembrane(E1=300.0, E2=270.0, G12=100.0, nu21=0.25, thickness=0.08)
    scene = clamped(square(COMM, 7, "structured"), fabric)
    scene.set_strengths((2.0, 1.0))
    solver = advanced(Solver(scene, results=results), pressure=0.01, steps=2)
    cable = scene.lay_cable(Cable(EA=32000.0), [(0.0, 45.0), (100.0, 52.0)], name="ridge")
    solver.advance(L0={cable: 100.8})
    return solver


@pytest.mark.ranks
def test_history_of_a_run() -> None:
    solver = run(None)
    scene, history = solver.scene, solver.history
    (cable,) = scene.cables
    np.testing.assert_array_equal(history["step"], [1, 2, 3])
    np.testing.assert_allclose(history["pressure"], [0.005, 0.01, 0.01])
    np.testing.assert_array_equal(history["energy"], [step.energy for step in solver.steps])
    parts = [column for column in history.columns if column.startswith("energy ")]
    assert set(parts) == {f"energy {name}" for name in scene.energies}
    np.testing.assert_allclose(
        np.nansum([history[part] for part in parts], axis=0), history["energy"], rtol=1e-12
    )
    np.testing.assert_allclose(
        history["volume"], -history["energy pressure"] / history["pressure"], rtol=1e-12
    )
    for name, value in (("tension", cable.tension), ("length", cable.length), ("L0", 100.8)):
        column = history[f"{name} ridge"]
        assert np.isnan(column[:2]).all()
        assert column[2] == value
    assert history["blocked points"][2] == len(cable.blocked)
    outcome = solver.steps[-1].outcome
    for name in ("iterations", "evaluations", "factorizations", "residual"):
        assert history[name][-1] == getattr(outcome, name)
    assert len(set(COMM.allgather(tuple(history["seconds"])))) == 1


def test_without_a_folder_nothing_is_written(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    solver = run(None)
    assert len(solver.history) == 3
    COMM.barrier()
    assert list(folder.iterdir()) == []


def read_step(folder: Path, collection: str, time: float) -> list[VtuFile]:
    COMM.barrier()
    entries = ElementTree.parse(folder / f"{collection}.pvd").getroot().iter("DataSet")
    return [
        read_vtu(folder / entry.attrib["file"])
        for entry in entries
        if float(entry.attrib["timestep"]) == time
    ]


@pytest.mark.ranks
def test_files_of_a_run(folder: Path) -> None:
    solver = run(folder / "out")
    scene = solver.scene
    results, surface = solver.results(), current_surface(scene.net)
    COMM.barrier()
    table = History.read(folder / "out" / "history.csv")
    assert table.columns == solver.history.columns
    for column in table.columns:
        np.testing.assert_array_equal(table[column], solver.history[column])

    (whole,) = read_step(folder / "out", "surface", 3.0)
    corners = np.concatenate(COMM.allgather(surface.points[surface.triangles]))
    np.testing.assert_allclose(whole.points[whole.cells], corners, rtol=1e-14, atol=1e-14)
    twice = whole.points[whole.points[:, 1] > 60.0]  # far from the cable; its points may be
    assert len(np.unique(twice, axis=0)) == len(twice), "vertices are there once"
    cells = whole.cell_data
    parents = surface.parents
    assert len(parents) > len(results.state), "the cable cuts cells"
    for name, values, tolerance in (
        ("true force 1", results.true_forces[parents, 0], {"rtol": 1e-9}),
        ("direction 1", results.true_directions[parents, 0], {"atol": 1e-6}),
        ("state", results.state[parents], {}),
        ("warp", results.warp_weft[parents, 0], {"rtol": 1e-9}),
        ("weft", results.warp_weft[parents, 1], {"rtol": 1e-9}),
        ("shear", results.warp_weft[parents, 2], {"atol": 1e-9}),
        ("utilisation", results.utilisation((2.0, 1.0))[parents], {"rtol": 1e-9}),
    ):
        everywhere = np.concatenate(COMM.allgather(values))
        np.testing.assert_allclose(cells[name], everywhere, **tolerance)
    moved = whole.points - whole.point_data["displacement"]
    before = np.concatenate(COMM.allgather(surface.stress_free[surface.triangles]))
    np.testing.assert_allclose(moved[whole.cells], before, atol=1e-12)
    assert np.abs(moved[:, 2]).max() < 1e-12, "stress-free, all of the square is flat"

    (cable,) = scene.cables
    (line,) = read_step(folder / "out", "cables", 3.0)
    np.testing.assert_array_equal(line.points, cable.line)
    np.testing.assert_array_equal(line.cell_data["tension"], cable.tension)
    assert not line.cell_data["lifted"].any()
    assert read_step(folder / "out", "cables", 2.0) == []
    (plain,) = read_step(folder / "out", "surface", 2.0)
    assert (len(plain.cells), len(plain.points)) == (2 * 7 * 7, 8 * 8)


def test_cables_lift_off_in_files_and_pictures(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cable between anchors over a square is drawn down onto it: the number of its points that
    are lifted changes from step to step."""
    solver = Solver(sheet(COMM, 7), results=folder / "out")
    scene = solver.scene
    solver.advance(pressure=0.01)
    ends = [(-80.0, 45.0, 0.0), (180.0, 52.0, 0.0)]
    cable = scene.lay_cable(Cable(EA=32000.0), ends)
    drawn: list[dict[str, object]] = []
    monkeypatch.setattr(draw_scene, "draw_shape", lambda *given, **options: drawn.append(options))
    lifted = []
    for number in (2, 3):
        solver.advance(move={cable: (0.0, 0.0, -10.0)})
        draw(solver, folder / "shape.png")
        (line,) = read_step(folder / "out", "cables", float(number))
        np.testing.assert_array_equal(line.points, cable.line)
        np.testing.assert_array_equal(line.cell_data["lifted"], cable.free_spans)
        lifted.append(int(cable.state.lifted.sum()))
    assert lifted[0] > lifted[1] >= 0
    assert [options.get("loose") for options in drawn] == (
        [] if COMM.rank else ["lifted", "lifted" if lifted[1] else None]
    )


@pytest.mark.ranks
def test_a_folder_that_cannot_be_written_is_refused_at_once(folder: Path) -> None:
    if COMM.rank == 0:
        (folder / "taken").write_text("a file")
    COMM.barrier()
    with pytest.raises(InputError, match="taken"):
        Solver(sheet(COMM, 7), results=folder / "taken")


def test_names_that_make_no_column_are_refused_at_laying() -> None:
    scene = sheet(COMM, 7)
    for name in ("", "ridge ", "\n"):
        with pytest.raises(InputError, match="without blanks"):
            scene.lay_cable(Cable(EA=1.0), [(0.0, 45.0), (100.0, 52.0)], name=name)
    assert not scene.cables


def test_a_failed_step_is_not_recorded_and_the_run_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = sheet(COMM, 7)
    solver = advanced(Solver(scene, max_halvings=0), pressure=0.01)
    cable = scene.lay_cable(Cable(EA=32000.0), [(0.0, 45.0), (100.0, 52.0)], L0=110.0)
    solver.advance()
    slack = scene.energy

    failure = Outcome(False, "made to fail", 1.0, 0.0, 0, 0, 0)
    with monkeypatch.context() as patch:
        patch.setattr(Minimizer, "solve", lambda *arguments: failure)
        with pytest.raises(ConvergenceError, match="made to fail"):
            solver.advance(L0={cable: 100.8})
    assert len(solver.history) == 2
    assert (cable.L0, cable.taut) == (110.0, False)
    solver.advance()
    assert scene.energy == pytest.approx(slack, rel=1e-10)
    np.testing.assert_array_equal(solver.history["step"], [1, 2, 3])


@pytest.mark.ranks
@pytest.mark.parametrize(
    "colour", [None, "stress", "stress 2", "warp", "strain", "state", "displacement", "utilisation"]
)
def test_pictures_get_the_whole_surface(
    folder: Path, monkeypatch: pytest.MonkeyPatch, colour: str | None
) -> None:
    solver = run(None)
    drawn = []
    monkeypatch.setattr(
        draw_scene, "draw_shape", lambda *given, **options: drawn.append((given, options))
    )
    draw(solver, folder / "shape.png", colour=colour, view=(0.0, 20.0))
    surface, results = current_surface(solver.scene.net), solver.results()
    moved = np.linalg.norm(surface.points - surface.stress_free, axis=1)
    values = np.zeros(0)
    if colour == "displacement":
        values = moved[surface.triangles].mean(axis=1)
    elif colour is not None:
        name = QUANTITY_OF[colour]
        if colour == "utilisation":  # by the strengths of `run`
            corners = np.maximum(recovered(results, "warp") / 2.0, recovered(results, "weft"))
        else:
            corners = (
                np.repeat(results.values(name)[:, None], 3, axis=1)
                if colour == "state" else recovered(results, name)
            )  # fmt: skip
        values = at_facets(results, corners).mean(axis=1)
    corners = np.concatenate(COMM.allgather(surface.points[surface.triangles]))
    everywhere = np.concatenate(COMM.allgather(values))
    assert len(drawn) == (COMM.rank == 0)
    for (filename, points, triangles, lines), options in drawn:
        assert filename == folder / "shape.png"
        np.testing.assert_array_equal(points[triangles], corners)
        assert [line.name for line in lines] == ["ridge"]
        assert (options["line_values"], options["view"]) == ("tension", (0.0, 20.0))
        if colour is None:
            assert options["values"] is None
        else:
            given = options["values"]
            given = (given if len(given) == len(triangles) else given[triangles]).mean(axis=1)
            np.testing.assert_allclose(given, everywhere, rtol=1e-9, atol=1e-12)
            assert options["label"]


@pytest.mark.ranks
def test_paths_are_drawn_over_the_whole_stress_free_mesh(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    solver = run(None)
    drawn = []
    monkeypatch.setattr(
        draw_scene, "draw_path", lambda *given, **options: drawn.append((given, options))
    )
    line = Line(solver.scene.cables[0].state.positions)
    draw_paths(solver.scene, folder / "paths.png", [line], unit="cm")
    assert len(drawn) == (COMM.rank == 0)
    for (filename, paths), options in drawn:
        assert (filename, paths) == (folder / "paths.png", ())
        assert (options["lines"], options["unit"]) == ([line], "cm")
        a, b, c = np.moveaxis(options["points"][options["triangles"]], 1, 0)
        areas = np.cross(b - a, c - a) / 2
        assert len(areas) == 2 * 7 * 7
        np.testing.assert_allclose(areas.sum(axis=0), [0.0, 0.0, 1e4], atol=1e-9)


def test_drawing_needs_nothing_but_the_scene(folder: Path) -> None:
    solver = Solver(sheet(COMM, 7))
    draw(solver, folder / "flat.png")
    with pytest.raises(InputError, match="history is empty"):
        draw_history(solver.history, folder / "history.png")
    solver.advance(pressure=0.01)
    draw_history(solver.history, folder / "history.png")
    COMM.barrier()
    for name in ("flat.png", "history.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")


def test_meshes_too_large_for_a_picture(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    solver = Solver(sheet(COMM, 7))
    monkeypatch.setattr(draw_scene, "MOST_CELLS", 2 * 7 * 7)
    draw(solver, folder / "drawn.png")
    monkeypatch.setattr(draw_scene, "MOST_CELLS", 2 * 7 * 7 - 1)
    for call, message in (
        (lambda: draw(solver, folder / "not.png"), "not drawn: the mesh has 98 cells.*ParaView"),
        (
            lambda: draw_paths(solver.scene, folder / "path.png", [Line([[0, 0, 0], [9, 9, 0]])]),
            "without the mesh",
        ),
    ):
        if COMM.rank == 0:  # whose caller it is told
            with pytest.warns(PictureWarning, match=message) as told:
                call()
            assert told[0].filename == __file__
        else:
            call()
    COMM.barrier()
    assert {path.name for path in folder.iterdir()} == {"drawn.png", "path.png"}


@pytest.mark.ranks
def test_what_cannot_be_drawn_is_said_on_all_ranks(folder: Path) -> None:
    solver = Solver(sheet(COMM, 7))
    with pytest.raises(InputError, match="colour = 'blue' is not known"):
        draw(solver, folder / "shape.png", colour="blue")
    with pytest.raises(InputError, match="come from the scene"):
        draw(solver, folder / "shape.png", lines=[])
    with pytest.raises(InputError, match="come from the scene"):
        draw_paths(solver.scene, folder / "paths.png", points=[])
    with pytest.raises(InputError, match="nothing to draw"):
        draw_paths(solver.scene, folder / "paths.png")
    if COMM.rank == 0:
        (folder / "taken").write_text("a file")
    with pytest.raises(InputError, match="taken"):
        draw(solver, folder / "taken" / "shape.png")


def test_default_panels_show_what_there_is() -> None:
    history = run(None).history
    panels = default_panels(history)
    assert panels[:2] == [["pressure"], ["volume"]]  # one value each of L0 and tension: no curve
    assert panels[2][0] == "energy"
    assert len(panels) == 3
    bare = History(None, COMM)
    bare.append({"step": 1, "pressure": 0.0, "energy": 2.0, "seconds": 1.0})
    assert default_panels(bare) == [["energy"]]
