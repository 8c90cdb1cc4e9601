"""Pages of a report with the structure to be turned."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Solver
from crms_fenicsx.results.output.report.pictures import _Scale, _with_scales


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
    comm: MPI.Intracomm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    folder = comm.bcast(tmp_path)
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
