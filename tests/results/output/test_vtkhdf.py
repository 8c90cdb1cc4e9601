"""Combinations as a VTKHDF file: what its steps have, read by h5py and by VTK, and bad input."""

from __future__ import annotations

import resource
import signal
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, Solver
from crms_fenicsx.results.output import write_vtkhdf

NAMES = ["ridge/1", "mast"]
TABLE = {"heavy snow": {"snow": 1.0}, "Sturm ü": {"wind": 1.0}}


def roof(comm: MPI.Intracomm) -> Solver:
    foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08, prestress=1.0)
    scene = sheet(comm, 4, material=foil, side=8.0)
    scene.add_bar(Bar(EA=1e4), (9.0, 0.0, 0.0), (9.0, 0.0, 4.0), name="mast")
    for name, sign in {"snow": -0.05, "wind": 0.05}.items():
        scene.put_load((0.0, 0.0, sign), name=name)
    solver = advanced(Solver(scene), pressure=0.1)
    scene.lay_cable(Cable(1e4), [(0.0, 3.3), (8.0, 4.2)], tension=1.0, name="ridge/1")
    return solver


@pytest.mark.ranks
def test_each_combination_is_a_step(comm: MPI.Intracomm, folder: Path) -> None:
    """With shapes, section forces and tensions as in the states, which stay as they were."""
    h5py = pytest.importorskip("h5py")
    path, solver = folder / "roof.vtkhdf", roof(comm)
    found = solver.combine(TABLE)
    u = solver.scene.u.x.array.copy()
    write_vtkhdf(solver, path, found)
    np.testing.assert_array_equal(solver.scene.u.x.array, u)
    expected = []
    for one in found.values():
        solver.restore(one.snapshot)
        force = np.concatenate(comm.allgather(solver.results().values("true force 1")))
        area = solver.results().surface
        corners = area.points[area.triangles]
        sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        total = comm.allreduce(float(np.linalg.norm(sides, axis=1).sum() / 2))
        expected.append((force.max(), total, solver.scene.cable("ridge/1").tension))
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        steps, data = root["Steps"], root["CellData"]
        assert steps.attrs["NSteps"] == 2
        assert root.attrs["Type"] == b"UnstructuredGrid"
        for k, (force_most, total, tension) in enumerate(expected):
            cells = slice(steps["CellOffsets"][k, 0], None)
            cells = slice(cells.start, cells.start + root["NumberOfCells"][k])
            start = steps["PointOffsets"][k]
            points = root["Points"][start : start + root["NumberOfPoints"][k]]
            types = root["Types"][cells]
            first = steps["ConnectivityIdOffsets"][k, 0]
            n = int((types == 5).sum())
            corners = points[root["Connectivity"][first : first + 3 * n].reshape(n, 3)]
            sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            assert np.linalg.norm(sides, axis=1).sum() / 2 == pytest.approx(total, rel=1e-12)
            offsets = root["Offsets"][cells.start + k : cells.stop + k + 1]
            np.testing.assert_array_equal(np.diff(offsets), np.where(types == 5, 3, 2))
            forces = data["true force 1"][cells]
            assert np.nanmax(forces) == pytest.approx(force_most, rel=1e-12)
            assert np.isnan(forces[n:]).all()
            assert np.isnan(data["tension"][cells][:n]).all()
            lines = data["line"][cells]
            assert set(lines[:n]) == {-1}
            assert set(lines[n:]) == {0, 1}
            np.testing.assert_allclose(data["tension"][cells][lines == 0], tension)
            at = root["FieldData"]
            case = at["case"][steps["FieldDataOffsets/case"][k]]
            assert case.decode() == list(found)[k]
            first, (_, many) = steps["FieldDataOffsets/names"][k], steps["FieldDataSizes/names"][k]
            assert [x.decode() for x in at["names"][first : first + many]] == NAMES


def test_vtk_reads_it(comm: MPI.Intracomm, tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    from vtkmodules.vtkCommonCore import vtkVersion
    from vtkmodules.vtkIOHDF import vtkHDFReader

    solver = roof(comm)
    write_vtkhdf(solver, tmp_path / "roof.vtkhdf", solver.combine(TABLE))
    reader = vtkHDFReader()
    reader.SetFileName(str(tmp_path / "roof.vtkhdf"))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 2
    for k, name in enumerate(TABLE):
        reader.SetStep(k)
        reader.Update()
        mesh = pyvista.wrap(reader.GetOutput())
        if vtkVersion().GetVTKMinorVersion() > 4:  # VTK 9.3 reads the first step's strings only
            assert list(mesh.field_data["case"]) == [name]
            assert list(mesh.field_data["names"]) == NAMES
        assert mesh.bounds[1] == pytest.approx(9.0)  # the mast


@pytest.mark.ranks
def test_bad_input(comm: MPI.Intracomm, tmp_path: Path) -> None:
    solver, folder = roof(comm), comm.bcast(tmp_path)
    for filename, states, message in (
        (folder / "a.vtk", None, "the suffix = '.vtk' is not known"),
        (folder / "a.vtkhdf", {}, "write_vtkhdf: combinations"),
        (folder / "a.vtkhdf", {"snow": 1.0}, "of type float"),
        (folder / "a.vtkhdf", roof(comm).combine(TABLE), "is of another scene"),
    ):
        with pytest.raises(InputError, match=message):
            write_vtkhdf(solver, filename, states)  # type: ignore[arg-type]
    assert not list(folder.iterdir())


@pytest.mark.ranks
@pytest.mark.parametrize("room", [0, 4096, 32768])
def test_a_full_disk(comm: MPI.Intracomm, folder: Path, room: int) -> None:
    """An error on all ranks that names the file; the file of before stays, and the run goes on."""
    pytest.importorskip("h5py")
    path, solver = folder / "roof.vtkhdf", roof(comm)
    write_vtkhdf(solver, path)
    before = path.read_bytes()
    assert len(before) > room
    comm.barrier()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
        with pytest.raises(InputError, match=r"roof\.vtkhdf cannot be written \(File too large"):
            write_vtkhdf(solver, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    assert path.read_bytes() == before
    solver.advance(pressure=0.11)
    write_vtkhdf(solver, path)
    assert path.read_bytes() != before
