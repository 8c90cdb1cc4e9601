"""Pages of a report with the structure to be turned."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes


def roof(comm: MPI.Intracomm) -> Solver:
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=1.0)
    scene = Scene(meshes.rectangle(comm, 8.0, 8.0, 2.0, structured=True), foil)
    scene.fix("boundary")
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
