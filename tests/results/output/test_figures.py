"""Pictures without a file are returned, and show in a notebook what a file would; pages of a report
with the structure to be turned."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cabled_square import CABLE, advanced, sheet
from matplotlib.figure import Figure
from matplotlib.image import imread
from mpi4py import MPI

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Solver
from crms_fenicsx.results.output import Line, draw, draw_history, draw_path, draw_paths, draw_shape
from crms_fenicsx.results.output.report.pictures import _Scale, _with_scales

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD
WAY = Line([[0.0, 0.0, 0.0], [9.0, 9.0, 0.0]])
CORNERS, TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]], [[0, 1, 2]]


@cache
def tightened() -> Solver:
    scene = sheet(COMM, 4)
    scene.lay_cable(CABLE, [(0.0, 45.0), (100.0, 52.0)], name="ridge", L0=99.5)
    return advanced(Solver(scene), pressure=0.01)


Draw = Callable[..., Figure | None]
DRAWN: dict[str, Draw] = {
    "method": lambda *file, **dpi: tightened().draw(*file, colour="stress", unit="cm", **dpi),
    "scene": lambda *file, **dpi: draw(tightened(), *file, ghost=True, **dpi),
    "paths": lambda *file, **dpi: draw_paths(tightened().scene, *(file or [None]), [WAY], **dpi),
    "history": lambda *file, **dpi: draw_history(tightened().history, *file, **dpi),
}
ON_ONE_RANK: dict[str, Draw] = {
    "shape": lambda *file, **dpi: draw_shape(*(file or [None]), CORNERS, TRIANGLE, **dpi),
    "path": lambda *file, **dpi: draw_path(*(file or [None]), [WAY], **dpi),
}


@pytest.mark.ranks
@pytest.mark.parametrize("name", [*DRAWN, *ON_ONE_RANK])
def test_a_figure_shows_what_a_file_has(folder: Path, name: str) -> None:
    file = folder / "drawn.png"
    if name in ON_ONE_RANK and COMM.rank > 0:
        return
    call = {**DRAWN, **ON_ONE_RANK}[name]
    assert call(file, dpi=100) is None
    figure = call()
    assert (figure is None) == (COMM.rank > 0)
    if figure is not None:
        assert isinstance(figure, Figure)
        shown = imread(io.BytesIO(figure._repr_png_()))  # type: ignore[attr-defined]
        np.testing.assert_array_equal(shown, imread(file))


def test_pictures_of_a_notebook_leave_no_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    tightened().draw()
    COMM.barrier()
    assert list(folder.iterdir()) == []
    with pytest.raises(InputError, match="filename = 3 is not a path"):
        tightened().draw(3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="colour = 'heat' is not known"):
        tightened().draw(colour="heat")


def roof(comm: MPI.Intracomm) -> Solver:
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=1.0)
    scene = sheet(comm, 4, material=foil, side=8.0)
    scene.put_load((0.0, 0.0, -0.05), name="snow")
    solver = Solver(scene)
    scene.lay_cable(Cable(1e4), [(0.0, 3.3), (8.0, 4.2)], tension=1.0, name="ridge")
    solver.advance(pressure=0.1)
    return solver


@pytest.mark.ranks
def test_without_pyvista_nothing_is_written(
    comm: MPI.Intracomm, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(ImportError, match=r'pip install "pyvista\[jupyter\]"'):
        roof(comm).report(folder / "roof.html", interactive=True)
    assert not list(folder.iterdir())


def test_a_page_of_each_combination(comm: MPI.Intracomm, tmp_path: Path) -> None:
    """Which loads nothing from elsewhere; the report leads to them."""
    pytest.importorskip("pyvista")
    pytest.importorskip("trame_vtk")
    solver = roof(comm)
    found = solver.combine({"snow": {"snow": 1.0}, "calm": {"snow": 0.0}})
    solver.report(tmp_path / "roof.html", found, pictures=["displacement"], interactive=True)
    page = (tmp_path / "roof.html").read_text()
    for k in (1, 2):
        name = f"roof_view_{k}.html"
        assert f'href="{name}"' in page
        text = (tmp_path / name).read_text()
        assert len(text) > 1e5
        assert 'src="http' not in text
        assert ("<title>snow</title>", "<title>calm</title>")[k - 1] in text


def test_scales_stand_beside_the_view() -> None:
    """One below the other, with the page's name."""
    scales = [_Scale("force [kN/m]", "viridis", (0.0, 8.0)), _Scale("axial", "YlOrRd", (-1.0, 1.0))]
    empty = "<html><head><title>VTK.js</title></head><body class='x'><p></p></body></html>"
    page = _with_scales(empty, "snow & wind", scales)
    assert "<title>snow &amp; wind</title>" in page and "VTK.js" not in page
    assert page.index("<body class='x'>") < page.index("force [kN/m]") < page.index("axial")
    assert page.count("linear-gradient(to right, #") == 2
    assert '<div class="content"' in page  # else vtk.js empties the body
    assert [f"<span>{x}</span>" in page for x in ("0", "2", "4", "6", "8", "-0.5")] == 6 * [True]
