"""Scenes as meshes of pyvista, against what ParaView gets, and pictures of them."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import CABLE, advanced, sheet
from mpi4py import MPI
from vtu_file import VtuFile, read_vtu

from crms_fenicsx import Bar, InputError, Solver

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]
COMM = MPI.COMM_WORLD


@pytest.fixture(scope="module")
def pyvista() -> Any:
    return pytest.importorskip("pyvista")


def crossed(results: Path | None = None) -> Solver:
    """A blown square with strengths, under two cables that cross, one of them slack."""
    scene = sheet(COMM, 7)
    scene.set_strengths((2.0, 1.0))
    scene.lay_cable(CABLE, [(0.0, 45.0), (100.0, 52.0)], name="ridge", L0=99.5)
    scene.lay_cable(CABLE, [(45.0, 0.0), (52.0, 100.0)], name="loose", L0=140.0)
    return advanced(Solver(scene, results=results), pressure=0.01)


def corners(block: Any, of: str, n: int) -> np.ndarray:
    """The cells of a block, (m, n), whose lines or faces all have n corners."""
    padded = np.asarray(getattr(block, of)).reshape(-1, n + 1)
    assert (padded[:, 0] == n).all()
    return padded[:, 1:]


def same(block: Any, of: str, file: VtuFile) -> None:
    """What is in a block is what is in a file, but for rounding and directions' signs."""
    np.testing.assert_array_equal(block.points, file.points)
    np.testing.assert_array_equal(corners(block, of, file.cells.shape[1]), file.cells)
    for has, wanted in ((block.point_data, file.point_data), (block.cell_data, file.cell_data)):
        assert set(has.keys()) == set(wanted)
        for name, values in wanted.items():
            np.testing.assert_allclose(has[name], values, rtol=1e-12, atol=1e-12, err_msg=name)


def test_blocks_have_what_paraview_gets(pyvista: Any, folder: Path) -> None:
    solver = crossed(folder)
    blocks = solver.to_pyvista(radius=0.0)
    assert (blocks is None) == (COMM.rank > 0)
    if blocks is None:
        return
    assert blocks.keys() == ["membrane", "cables", "supports"]
    assert "utilisation" in blocks["membrane"].cell_data
    same(blocks["membrane"], "faces", read_vtu(folder / "steps" / "surface_000000.vtu"))
    same(blocks["cables"], "lines", read_vtu(folder / "steps" / "cables_000000.vtu"))
    assert list(blocks["cables"].field_data["names"]) == ["ridge", "loose"]
    supports = blocks["supports"]
    assert supports.n_points == 4 * 7
    assert (supports.point_data["held"] == 1).all()
    assert np.isin(supports.points[:, :2], (0.0, 100.0)).any(axis=1).all()


def test_tubes_are_around_the_lines(pyvista: Any) -> None:
    solver = crossed()
    scene = solver.scene
    lines, tubes = solver.to_pyvista(radius=0.0), solver.to_pyvista(radius=0.5)
    if lines is None:
        return
    segments, tube = lines["cables"], tubes["cables"]
    assert set(segments.cell_data.keys()) == set(tube.cell_data.keys())
    ridge = tube.cell_data["line"] == 0
    assert ridge.any() and not ridge.all()
    for of, tension in ((ridge, scene.cable("ridge").tension), (~ridge, 0.0)):
        assert set(tube.cell_data["tension"][of]) == {tension}
    ends = segments.points[corners(segments, "lines", 2)]
    ways = ends[:, 1] - ends[:, 0]
    to = tube.points[:, None] - ends[:, 0]
    t = np.clip(np.einsum("psi,si->ps", to, ways) / np.einsum("si,si->s", ways, ways), 0, 1)
    away = np.linalg.norm(to - t[..., None] * ways, axis=2)
    np.testing.assert_allclose(np.abs(away - 0.5).min(axis=1), 0.0, atol=1e-4)


def test_a_scene_before_its_first_load_step_has_its_shape_and_bars(pyvista: Any) -> None:
    scene = sheet(COMM, 2)
    top = scene.add_joint((50.0, 50.0, 20.0), name="top")
    scene.add_bar(Bar(1e3), (50.0, 50.0, 60.0), top, name="hanger")
    scene.add_bar(Bar(1e3), top, scene.vertex_at((50.0, 50.0, 0.0)), name="post")
    blocks = Solver(scene).to_pyvista()
    if blocks is None:
        return
    assert blocks.keys() == ["membrane", "bars", "supports", "joints"]
    membrane, bars, joints = (blocks[name] for name in ("membrane", "bars", "joints"))
    assert (membrane.n_points, membrane.n_cells) == (9, 8)
    assert membrane.area == pytest.approx(1e4)
    assert not membrane.point_data["displacement"].any()
    assert list(bars.field_data["names"]) == ["hanger", "post"]
    assert set(bars.cell_data["line"]) == {0, 1}
    assert bars.bounds[5] == pytest.approx(60.0, abs=1e-5)
    assert "top" in list(joints.field_data["names"])
    held = {tuple(p): tuple(h) for p, h in zip(joints.points, joints["held"], strict=True)}
    assert held == {(50.0, 50.0, 20.0): (0, 0, 0), (50.0, 50.0, 60.0): (1, 1, 1)}


def test_a_picture_off_screen(pyvista: Any, tmp_path: Path) -> None:
    if not os.environ.get("DISPLAY"):
        pytest.skip("there is no screen, not even one in memory: use `./run plot pytest`")
    solver = crossed()
    blocks = solver.to_pyvista()
    if blocks is None:
        return
    plotter = pyvista.Plotter(off_screen=True, window_size=(300, 200))
    plotter.set_background("white")
    plotter.add_mesh(blocks["membrane"], scalars="true force 1", show_scalar_bar=False)
    plotter.add_mesh(blocks["cables"], color="red", lighting=False)
    image = np.asarray(plotter.screenshot(tmp_path / "scene.png"), dtype=np.int64)
    plotter.close()
    assert (tmp_path / "scene.png").stat().st_size > 1000
    red = (image[..., 0] > 200) & (image[..., 1:].max(axis=2) < 60)
    assert 30 < red.sum() < 3000


def test_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = Solver(sheet(COMM, 2))
    for radius, words in ((-1.0, "radius = -1.0 is negative"), (np.nan, "radius"), ("a", "radius")):
        with pytest.raises(InputError, match=words):
            solver.to_pyvista(radius=radius)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r"needs pyvista.*install it"):
        solver.to_pyvista()
