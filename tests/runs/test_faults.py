"""Full disks, folders that go away, a rank that dies: what was complete stays, and runs go on."""

from __future__ import annotations

import errno
import io
import os
import shutil
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI
from processes import MPIRUN, run
from vtu_file import read_vtu

from crms_fenicsx import Cable, InputError, Solver
from crms_fenicsx.foundation.runtime import files
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.checkpoint import checkpoint_files
from crms_fenicsx.results.checkpoint.checkpoint_files import complete
from crms_fenicsx.results.output import History, paraview

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]

COMM = MPI.COMM_WORLD


def script(folder: Path, resume: bool) -> Solver:
    """Two calls, three load steps and a cable."""
    scene = sheet(COMM, 3)
    solver = advanced(Solver(scene, results=folder, resume=resume), pressure=0.01)
    scene.lay_cable(Cable(9000.0), [(0, 33), (100, 41)], tension=20.0)
    solver.advance(pressure=0.012, steps=2)
    return solver


def assert_whole(folder: Path) -> None:
    """All files that have their names can be read."""
    if COMM.rank > 0:
        return
    if (folder / "history.csv").exists():
        assert np.isfinite(History.read(folder / "history.csv")["energy"]).all()
    for series in folder.glob("*.pvd"):
        for entry in ElementTree.parse(series).getroot().iter("DataSet"):
            read_vtu(folder / entry.attrib["file"])
    for step in folder.glob("steps/[sc]*.vtu"):
        read_vtu(step)
    for call in ("0001", "0002"):
        place = complete(folder / "checkpoints" / call)
        if place.exists():
            Solver(sheet(MPI.COMM_SELF, 3)).load(place)


def full_at(count: int, whole: Callable[..., Any]) -> Callable[..., Any]:
    """Let the system refuse a call, the first time that it has been called so often."""
    left = count

    def refused(*arguments: Any, **options: Any) -> Any:
        nonlocal left
        left -= 1
        if left == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return whole(*arguments, **options)

    return refused


@pytest.fixture(scope="module")
def due(tmp_path_factory: pytest.TempPathFactory) -> Array:
    """Energies of the run to which nothing happens."""
    folder = Path(COMM.bcast(str(tmp_path_factory.mktemp("due"))))
    return script(folder, False).history["energy"]


@pytest.mark.parametrize("call", ["flush", "replace", "write"])
def test_a_disk_that_is_full_at_some_write(
    folder: Path, monkeypatch: pytest.MonkeyPatch, due: Array, call: str
) -> None:
    """On rank 0, which writes all files."""
    refusals = 0
    for count in (1, 2, 4, 7, 12, 18, 30) if COMM.size == 1 else (4, 12):
        place = folder / f"{count}"
        with monkeypatch.context() as patch:
            if call == "flush":
                for module in (files, checkpoint_files):
                    patch.setattr(module, "flush", full_at(count, files.flush))
            elif call == "replace":
                patch.setattr(os, "replace", full_at(count, os.replace))
            elif COMM.rank == 0:
                full = type("Full", (io.FileIO,), {"write": full_at(count, io.FileIO.write)})
                patch.setattr(paraview, "open", full, raising=False)
            try:
                script(place, False)
            except InputError as error:
                assert "cannot be written (No space left on device); free some space" in str(error)
                refusals += 1
        COMM.barrier()
        assert_whole(place)
        COMM.barrier()
        np.testing.assert_allclose(script(place, True).history["energy"], due, rtol=1e-7)
    assert refusals >= (3 if COMM.size == 1 else 2)


def test_a_folder_that_goes_away(folder: Path) -> None:
    """In the middle of the run a file is where the folder was; the scene is as it was computed."""
    scene = sheet(COMM, 3)
    solver = advanced(Solver(scene, results=folder / "out", resume=False), pressure=0.01)
    COMM.barrier()
    if COMM.rank == 0:
        shutil.move(folder / "out", folder / "moved")
        (folder / "out").write_text("something else")
    COMM.barrier()
    with pytest.raises(InputError, match=r"out.* cannot be written .*; (free some|use another)"):
        solver.advance(pressure=0.011)
    assert scene.pressure == 0.011 and np.isfinite(scene.energy)
    assert_whole(folder / "moved")
    if COMM.rank == 0:
        assert (folder / "out").read_text() == "something else"
        (folder / "out").unlink()
        shutil.move(folder / "moved", folder / "out")
    del solver
    COMM.barrier()
    again = advanced(Solver(sheet(COMM, 3), results=folder / "out", resume=True), pressure=0.01)
    again.advance(pressure=0.011)
    assert again.scene.energy == pytest.approx(scene.energy, rel=1e-9)


DYING = """
import os, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from test_faults import COMM, script
from crms_fenicsx.results.output import paraview

whole, left = paraview.whole_surface, {count}

def gathered(*arguments):
    global left
    left -= 1
    if left == 0 and COMM.rank == 1:
        os._exit(9)
    return whole(*arguments)

paraview.whole_surface = gathered
script(Path({folder!r}), {resume})
"""


def test_a_rank_that_dies(tmp_path: Path, due: Array) -> None:
    """In the middle of writing: the others end too, and the run can be resumed."""
    if COMM.size > 1:
        pytest.skip("it starts its own processes")
    text = {"tests": str(Path(__file__).parent), "folder": str(tmp_path / "out")}
    died = run(DYING.format(count=3, resume=False, **text), *MPIRUN)
    assert died.returncode != 0
    assert list((tmp_path / "out" / "checkpoints").iterdir()), "it died after its first steps"
    assert_whole(tmp_path / "out")
    np.testing.assert_allclose(script(tmp_path / "out", True).history["energy"], due, rtol=1e-7)
