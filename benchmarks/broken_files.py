"""Damaged and hostile files: meshes, checkpoints, and the files of resumed runs.

    ./run python benchmarks/broken_files.py [MUTATIONS [SEED]]

Damages valid files of each readable format at random: cuts, flipped bits, moved and repeated
pieces, other numbers (huge, negative, not finite), other types, deep nesting, links, pipes,
folders. Each is read in a separate process, and must give valid data or `InputError`: no other
error, no crash, no output, no long wait, no large memory. Prints a table of mutations and outcomes,
and each failure, and then fails.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from crms_fenicsx import Cable, Friction, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import mesh_files as reading
from crms_fenicsx.foundation.meshes.mesh_files import SUFFIXES
from crms_fenicsx.foundation.runtime.errors import ConvergenceError
from crms_fenicsx.results.output import History

WAIT = 20
"""Seconds after which reading hangs."""
MOST = 1 << 30
"""Bytes of memory that reading may take."""
NUMBERS = ["1000000000000000", "4000000000", "9223372036854775808", "-1", "0", "nan", "inf", "-inf",
           "1e308", "1e999", "1.5", "2147483648", "9" * 400, "1_0", "0x10", ""]  # fmt: skip
WORDS = [2**63, 2**31, 10**15, 0x7FF8000000000000, 0x7FF0000000000000, 2**64 - 1, 2**32 - 1, 0]

Random = np.random.Generator
Bytes = Callable[[bytes, Random], bytes]


def cut(data: bytes, rng: Random) -> bytes:
    return data[: rng.integers(len(data))]


def flip_bits(data: bytes, rng: Random) -> bytes:
    spoilt = bytearray(data)
    for place in rng.integers(len(data), size=rng.integers(1, 9)):
        spoilt[place] ^= 1 << rng.integers(8)
    return bytes(spoilt)


def move_piece(data: bytes, rng: Random) -> bytes:
    a, b, c = np.sort(rng.integers(len(data) + 1, size=3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


def repeat_piece(data: bytes, rng: Random) -> bytes:
    a, b = np.sort(rng.integers(len(data) + 1, size=2))
    return data[:b] + data[a:b] * int(rng.integers(1, 4)) + data[b:]


def leave_out(data: bytes, rng: Random) -> bytes:
    a = rng.integers(len(data))
    return data[:a] + data[a + rng.integers(1, 200) :]


def insert_noise(data: bytes, rng: Random) -> bytes:
    a = rng.integers(len(data) + 1)
    return data[:a] + rng.bytes(rng.integers(1, 100)) + data[a:]


def other_number(data: bytes, rng: Random) -> bytes:
    """Replace a number in a text."""
    import re

    found = list(re.finditer(rb"(?<![\w.])-?\d+(\.\d*)?(e[+-]?\d+)?", data))
    if not found:
        return flip_bits(data, rng)
    one = found[
        rng.integers(len(found)) if rng.random() < 0.5 else rng.integers(min(9, len(found)))
    ]
    return data[: one.start()] + NUMBERS[rng.integers(len(NUMBERS))].encode() + data[one.end() :]


def swap_numbers(data: bytes, rng: Random) -> bytes:
    """Exchange two words of a text."""
    words = data.split(b" ")
    a, b = rng.integers(len(words), size=2)
    words[a], words[b] = words[b], words[a]
    return b" ".join(words)


def other_word(data: bytes, rng: Random) -> bytes:
    """Replace a binary number."""
    size = int(rng.choice([4, 8]))
    place = rng.integers(max(len(data) - size, 1))
    word = WORDS[rng.integers(len(WORDS))] % 2 ** (8 * size)
    return data[:place] + word.to_bytes(size, rng.choice(["little", "big"])) + data[place + size :]


def nest(data: bytes, rng: Random) -> bytes:
    """Nest something deeply, where the file is a text of that kind."""
    if data.lstrip()[:1] == b"<":
        place, n = data.find(b">", rng.integers(len(data))) + 1, int(rng.choice([100, 100_000]))
        return data[:place] + b"<a>" * n + b"</a>" * n + data[place:]
    return b"[" * 100_000 + data if rng.random() < 0.5 else data + b"{" * 100_000


def bomb(data: bytes, rng: Random) -> bytes:
    """Entities that grow without limit, where the file is XML."""
    if data.lstrip()[:1] != b"<":
        return cut(data, rng)
    entities = b'<!ENTITY a0 "' + b"lol" * 10 + b'">'
    for k in range(20):
        entities += f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">'.encode()
    place = data.find(b"?>") + 2 if data.startswith(b"<?") else 0
    inside = data.find(b"</", place)
    return (
        data[:place] + b"<!DOCTYPE bomb [" + entities + b"]>" + data[place:inside] + b"&a20;"
        + data[inside:]
    )  # fmt: skip


BYTES: list[Bytes] = [
    cut, flip_bits, move_piece, repeat_piece, leave_out, insert_noise, other_number, other_number,
    swap_numbers, other_word, nest, bomb,
]  # fmt: skip


def change_kind(path: Path, rng: Random) -> str:
    """Put something else in the place of a file."""
    kind = str(rng.choice(["empty", "missing", "folder", "loop", "lost link", "device", "pipe",
                           "sparse", "other file"]))  # fmt: skip
    path.unlink()
    if kind == "empty":
        path.touch()
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "lost link":
        path.symlink_to("/nowhere/at all")
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "sparse":
        with open(path, "wb") as file:
            file.truncate(1 << 40)
    elif kind == "other file":
        path.write_bytes(Path(__file__).read_bytes())
    return kind


VALUES: list[Any] = [None, True, "text", "", [], {}, [[]], -1, 0, 1, 10**400, 1e308, -1e308, 1e-300,
                     2**63, 10**15, [1, 2, 3], [None], {"vertex": 0}]  # fmt: skip


def other_value(data: Any, rng: Random) -> None:
    """Replace, remove or repeat something in plain data."""
    while True:
        keys: list[Any] = list(data) if isinstance(data, dict) else list(range(len(data)))
        key = keys[rng.integers(len(keys))]
        inner = data[key]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.85:
            data = inner
            continue
        kind = rng.integers(8)
        if kind == 0:
            del data[key]
        elif kind == 1 and isinstance(data, list):
            data.append(inner)
        elif kind == 2 and isinstance(inner, int | float) and not isinstance(inner, bool):
            data[key] = inner + type(inner)(rng.integers(-3, 4))
        elif kind == 3 and isinstance(inner, float):
            data[key] = float(inner * rng.choice([-1, 1e10, 1e-10, 0.5]))
        else:
            data[key] = VALUES[rng.integers(len(VALUES))]
        return


def mesh_files(folder: Path) -> list[Path]:
    """A small membrane with groups in each format that is read."""
    import gmsh

    gmsh.initialize(argv=[], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addRectangle(0, 0, 0, 2, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [1], name="roof")
    gmsh.model.addPhysicalGroup(1, [1, 2], name="rim")
    gmsh.model.addPhysicalGroup(0, [1], name="mast")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    gmsh.model.mesh.generate(2)
    for version in (2.2, 4.1):
        for binary in (0, 1):
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            gmsh.write(str(folder / f"v{version}_{binary}.msh"))
    gmsh.finalize()
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        write_by_meshio(folder)
    found = sorted(path for path in folder.iterdir())
    assert {*SUFFIXES, ".msh"} <= {path.suffix for path in found}
    return found


def write_by_meshio(folder: Path) -> None:
    """The formats that meshio reads."""
    import meshio

    points = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)])
    cells = [("triangle", np.array([(0, 1, 2), (0, 2, 3), (1, 4, 2), (4, 5, 2)])),
             ("line", np.array([(0, 1), (1, 4)]))]  # fmt: skip
    whole = meshio.Mesh(points, cells)
    marked = meshio.Mesh(
        points, cells, cell_data={"medit:ref": [np.array([1, 1, 2, 2]), np.array([3, 3])]}
    )
    surface = meshio.Mesh(points, cells[:1])
    sets = meshio.Mesh(
        points, cells, point_sets={"mast": np.array([5])},
        cell_sets={"left": [np.array([0, 1]), np.array([], dtype=int)]},
    )  # fmt: skip
    whole.write(folder / "ascii.vtu", binary=False)
    whole.write(folder / "plain.vtu", compression=None)
    whole.write(folder / "zlib.vtu")
    whole.write(folder / "lzma.vtu", compression="lzma")
    whole.write(folder / "ascii.vtk", binary=False)
    whole.write(folder / "binary.vtk")
    meshio.write(folder / "old.vtk", whole, file_format="vtk42")
    surface.write(folder / "ascii.stl")
    surface.write(folder / "binary.stl", binary=True)
    surface.write(folder / "plain.obj")
    surface.write(folder / "ascii.ply", binary=False)
    surface.write(folder / "binary.ply")
    surface.write(folder / "plain.off")
    whole.write(folder / "xml.xdmf", data_format="XML")
    whole.write(folder / "hdf.xdmf")
    whole.write(folder / "binary.xdmf", data_format="Binary")
    whole.write(folder / "plain.med")
    sets.write(folder / "plain.inp")
    marked.write(folder / "plain.mesh")
    marked.write(folder / "plain.meshb")


def run_of_two_calls(folder: Path, resume: bool) -> Solver:
    """The smallest run with all that a checkpoint can have; resumed, it solves nothing."""
    mesh = meshes.rectangle(MPI.COMM_SELF, 100.0, 100.0, size=100 / 3, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    scene.put_load((0.0, 0.0, 0.01))
    solver = Solver(scene, results=folder, resume=resume)
    solver.advance(pressure=0.01, load=1.0)
    rough = Cable(9000.0, friction=Friction(0.2, along=0.1))
    scene.lay_cable(rough, [(0, 33), (100, 41)], tension=20.0, name="rough")
    scene.lay_cable(Cable(9000.0), [(30, 0), (42, 100)], tension=20.0, name="smooth", layer=1)
    solver.advance(pressure=0.011)
    return solver


def read_mesh(path: Path) -> None:
    """Read a mesh, and look whether what has come is one."""
    mesh = meshes.from_file(MPI.COMM_SELF, path)
    assert np.isfinite(mesh.mesh.geometry.x).all()
    assert mesh.mesh.topology.index_map(2).size_global > 0


def resume(folder: Path) -> None:
    """Resume a run that was complete, and go on for a step."""
    try:
        solver = run_of_two_calls(folder, True)
        scene = solver.scene
        assert np.isfinite(scene.u.x.array).all()
        assert all(np.isfinite(cable.state.positions).all() for cable in scene.cables)
        solver.advance(pressure=0.012)
    except ConvergenceError:  # from a state that somebody has made up, or said to be noted
        return
    assert np.isfinite(scene.u.x.array).all()


def ended(read: Callable[[Path], None], path: Path) -> str:
    """How reading ends, in a process of its own: "read", "refused", or what is wrong."""
    told, tell = os.pipe()
    with tempfile.TemporaryFile() as output:
        sys.stdout.flush()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            child = os.fork()
        if child == 0:
            os.close(told)
            for stream in (1, 2):
                os.dup2(output.fileno(), stream)
            os.write(tell, guarded(read, path).encode()[:4000])
            os._exit(0)
        os.close(tell)
        deadline, status = time.monotonic() + WAIT, None
        while status is None:
            done, found = os.waitpid(child, os.WNOHANG)
            if done:
                status = found
            elif time.monotonic() > deadline:
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                os.close(told)
                return f"bad: hangs for {WAIT} s"
            else:
                time.sleep(0.002)
        with os.fdopen(told, "rb") as pipe:
            how = pipe.read().decode(errors="replace")
        output.seek(0)
        said = output.read(300)
    if status != 0:
        return f"bad: ended with the status {status}: {said.decode(errors='replace')}"
    if said and not how.startswith("bad"):
        return f"bad: says {said!r}"
    return how


def guarded(read: Callable[[Path], None], path: Path) -> str:
    """Read with limits, and say how it ends."""
    before = peak()
    limit = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() + 4 * MOST
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            read(path)
            how = "read"
        except InputError as error:
            how = "refused"
            if len(str(error)) > 2000:
                how = f"bad: a message of {len(str(error))} letters"
        except BaseException as error:
            import traceback

            last = traceback.extract_tb(error.__traceback__)[-1]
            place = f"{Path(last.filename).name}:{last.lineno}"
            how = f"bad: {type(error).__name__} at {place}: {str(error)[:300]}"
    if peak() - before > MOST:
        return f"bad: takes {(peak() - before) >> 20} MiB ({how})"
    if len(caught) > 3:
        return f"bad: {len(caught)} warnings, as {caught[0].message}"
    return how


def peak() -> int:
    """The most memory that this process and what it has started have taken (bytes)."""
    whose = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return 1024 * max(resource.getrusage(who).ru_maxrss for who in whose)


def spoil_mesh(good: list[Path], folder: Path, rng: Random) -> tuple[str, str, Path]:
    """Spoil one of the mesh files; returns what, how and where it is."""
    path = good[rng.integers(len(good))]
    twins = [twin for twin in path.parent.glob(f"{path.stem}*") if twin.suffix in (".h5", ".bin")]
    for twin in twins:
        shutil.copy(twin, folder)
    broken = folder / path.name
    shutil.copy(path, broken)
    if rng.random() < 0.06:
        return path.suffix, change_kind(broken, rng), broken
    target = (
        folder / twins[rng.integers(len(twins))].name if twins and rng.random() < 0.5 else broken
    )
    mutate = BYTES[rng.integers(len(BYTES))]
    data = target.read_bytes()
    for _ in range(rng.integers(1, 4)):
        data = mutate(data, rng) if data else data
    target.write_bytes(data)
    return path.suffix, mutate.__name__, broken


def spoil_run(good: Path, folder: Path, rng: Random) -> tuple[str, str, Path]:
    """Spoil a file of a run's folder; returns what, how and where the folder is."""
    broken = folder / "run"
    shutil.copytree(good, broken)
    names = ["history.csv", "surface.pvd", "cables.pvd"]
    names += [str(file.relative_to(good)) for file in sorted(good.glob("checkpoints/*/*"))]
    states = [name for name in names if name.endswith("json")]
    name = names[rng.integers(len(names))] if rng.random() < 0.5 else states[rng.integers(2)]
    path, what = broken / name, Path(name).name
    if rng.random() < 0.06:
        return what, change_kind(path, rng), broken
    if what == "state.json" and rng.random() < 0.75:
        data = json.loads(path.read_bytes())
        for _ in range(rng.integers(1, 3)):
            other_value(data["content"], rng)
        path.write_text(json.dumps(data))
        return what, "other_value", broken
    mutate = BYTES[rng.integers(len(BYTES))]
    path.write_bytes(mutate(path.read_bytes(), rng))
    return what, mutate.__name__, broken


def main(count: int = 200, seed: int = 0) -> int:
    """Spoil that many files; returns how many ended badly."""
    warnings.simplefilter("ignore")
    reading.SECONDS = WAIT // 4
    outcomes: dict[str, Counter[str]] = {"file": Counter(), "mutation": Counter()}
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        top = Path(name)
        for part in ("meshes", "broken"):
            (top / part).mkdir()
        sound = mesh_files(top / "meshes")
        files = [path for path in sound if path.suffix not in (".h5", ".bin")]
        for path in files:
            read_mesh(path)
        run_of_two_calls(top / "run", False)
        resume_in_place(top / "run")
        assert len(History.read(top / "run" / "history.csv")) == 2
        for number in range(count):
            rng = np.random.default_rng((seed, number))
            shutil.rmtree(top / "broken")
            (top / "broken").mkdir()
            if number % 3 == 0:
                (what, how, path), read = spoil_mesh(files, top / "broken", rng), read_mesh
            else:
                (what, how, path), read = spoil_run(top / "run", top / "broken", rng), resume
            found = ended(read, path)
            kind = found.split(":")[0]
            outcomes["file"][what, kind] += 1
            outcomes["mutation"][how, kind] += 1
            if kind == "bad":
                wrong += 1
                print(f"{number}: {what}, {how}: {found}", flush=True)
    for title, table in outcomes.items():
        print(f"\n{title:16}{'all':>8}{'read':>8}{'refused':>8}{'bad':>8}")
        for name in sorted({name for name, _ in table}):
            numbers = [table[name, kind] for kind in ("read", "refused", "bad")]
            print(f"{name:16}{sum(numbers):8}" + "".join(f"{n:8}" for n in numbers))
    print(f"\n{count} broken files, {wrong} of them ended badly")
    return wrong


def resume_in_place(folder: Path) -> None:
    """The sound files are read, and nothing is computed anew."""
    before = (folder / "history.csv").read_bytes()
    run_of_two_calls(folder, True)
    assert (folder / "history.csv").read_bytes() == before


if __name__ == "__main__":
    raise SystemExit(main(*map(int, sys.argv[1:])) > 0)
