"""Files that are broken or hostile: a sample of benchmarks/broken_files.py, which tries thousands.

What it once found has a test of its own here, in test_meshes_files.py or in test_checkpoints.py.
"""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import broken_files
import numpy as np
import pytest

from crms_fenicsx import ConvergenceError, InputError, MeshError
from crms_fenicsx.foundation.meshes import mesh_files
from crms_fenicsx.results.output import History


def tried(read: Callable[[Path], object], path: Path) -> bool:
    """Whether a broken file is read; that it is refused is as well. All else is an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read(path)
        except (InputError, ConvergenceError) as error:  # the latter noted in a checkpoint
            assert len(str(error)) < 2000
            return False
    return True


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's folder."""
    folder = tmp_path_factory.mktemp("sound")
    broken_files.run_of_two_calls(folder / "run", False)
    return folder


def test_a_sample_of_runs(sound: Path, tmp_path: Path) -> None:
    refused = 0
    for number in range(85):
        rng = np.random.default_rng((7, number))
        folder = tmp_path / str(number)
        folder.mkdir()
        _, _, path = broken_files.spoil_run(sound / "run", folder, rng)
        refused += not tried(lambda path: broken_files.run_of_two_calls(path, True), path)
        shutil.rmtree(folder)
    assert 50 < refused < 85


def test_a_sample_of_meshes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "sound").mkdir()
    files = broken_files.mesh_files(tmp_path / "sound")
    files = [path for path in files if path.suffix not in (".h5", ".bin")]
    assert {path.suffix for path in files} == {".msh", *broken_files.SUFFIXES}
    capfd.readouterr()
    for number in range(12):
        rng = np.random.default_rng((3, number))
        folder = tmp_path / str(number)
        folder.mkdir()
        _, _, path = broken_files.spoil_mesh(files, folder, rng)
        tried(broken_files.read_mesh, path)
    assert capfd.readouterr() == ("", "")


def test_a_mesh_file_that_keeps_its_reader_busy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """meshio looks for a line with numbers of points until the end of time."""
    monkeypatch.setattr(mesh_files, "SECONDS", 1)
    path = tmp_path / "endless.off"
    path.write_text("OFF\n")
    with pytest.raises(MeshError, match=r"endless.off': it did not finish within 1 s"):
        broken_files.read_mesh(path)


def test_a_mesh_file_that_asks_for_all_memory(tmp_path: Path) -> None:
    path = tmp_path / "huge.off"
    path.write_text("OFF\n2000000000 1 0\n0 0 0\n")
    with pytest.raises(MeshError, match=r"huge.off': it asks for more memory"):
        broken_files.read_mesh(path)


def test_a_mesh_file_that_claims_to_be_huge(tmp_path: Path) -> None:
    path = tmp_path / "sparse.stl"
    with open(path, "wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(MeshError, match=r"sparse.stl' has 1099511627776 bytes, more than"):
        broken_files.read_mesh(path)


def test_a_reader_that_crashes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "crash.py"
    program.write_text("import os; os.abort()")
    monkeypatch.setattr(mesh_files.reader_process, "__file__", str(program))
    path = tmp_path / "square.vtu"
    path.touch()
    with pytest.raises(MeshError, match=r"square.vtu': it ended with the status -6"):
        broken_files.read_mesh(path)


@pytest.mark.parametrize("text", [b" $MeshFormat\n", b"$\nSystemCall", b"$Mesh", b"\n$MeshFormat"])
def test_what_gmsh_could_take_for_a_script(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "program.msh"
    path.write_bytes(text + b'\nSystemCall "touch pwned";\n')
    with pytest.raises(MeshError, match=r"does not begin with \$MeshFormat"):
        broken_files.read_mesh(path)
    assert [file.name for file in tmp_path.iterdir()] == ["program.msh"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"step\n\xff\n", "not a table"),
        (b"step\n" + b"1" * 200_000, "not a table"),
        (b"", "is empty"),
        (None, "it is not a regular file"),
    ],
)
def test_broken_histories(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "history.csv"
    if content is None:
        os.mkfifo(path)
    else:
        path.write_bytes(content)
    with pytest.raises(InputError, match=rf"history.csv.*{message}"):
        History.read(path)
