"""An error on one rank ends all ranks: of the input, of a user's function, of the package itself.

What ends the program is tried in programs of its own.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time

import numpy as np
import pytest
from cabled_square import clamped, rotated_lattice, sheet
from processes import MPIRUN, ROOT, run

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.runtime import checks, errors
from crms_fenicsx.results.output import draw

pytestmark = pytest.mark.ranks

SCENE = """
from mpi4py import MPI
from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.runtime import errors
from crms_fenicsx.energy.minimization.potential import Potential

errors.PATIENCE = 0.5
comm = MPI.COMM_WORLD
mesh = meshes.rectangle(comm, 100.0, 100.0, 25.0, structured=True)
scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
scene.fix("boundary")
solver = Solver(scene)
solver.advance(pressure=0.001)
whole = Potential.evaluate

def evaluate(self):
    if scene.pressure > 0.005 and comm.rank == comm.size - 1:
        {failure}
    return whole(self)

Potential.evaluate = evaluate
"""


def test_a_bug_on_one_rank_ends_all() -> None:
    """In the middle of a solve, called by PETSc, while the others are in a reduction."""
    script = SCENE.format(failure="raise ZeroDivisionError('a bug')")
    done = run(script + "solver.advance(pressure=0.01)", *MPIRUN)
    assert done.returncode != 0
    assert done.stderr.splitlines().count("ZeroDivisionError: a bug") == 1
    assert "Solver.advance: this was raised on rank 2 of 3" in done.stderr


def test_an_error_in_a_callback_of_petsc_keeps_its_kind() -> None:
    """And the solver goes on afterwards from the last good state."""
    script = (
        SCENE.format(failure="raise KeyboardInterrupt")
        + """
try:
    solver.advance(pressure=0.01)
except KeyboardInterrupt:
    Potential.evaluate = whole
assert scene.pressure == 0.001
solver.advance(pressure=0.01)
assert len(solver.steps) == 2
"""
    )
    done = run(script)
    assert (done.returncode, done.stderr) == (0, "")


def test_an_error_of_the_program_on_one_rank_ends_all() -> None:
    """Under `-m mpi4py`, where the others wait for it; PETSc's end must not."""
    script = SCENE.format(failure="pass") + "if comm.rank == 1: scene.pressure = 0.01\n"
    done = run(script + "solver.advance(pressure=0.01)", *MPIRUN, module=("-m", "mpi4py"))
    assert done.returncode != 0
    assert "AttributeError: Scene.pressure = 0.01: it cannot be assigned; call" in done.stderr


def test_random_bad_input() -> None:
    """See `bad_calls.py` and the program, which makes as many calls as one wants."""
    done = subprocess.run(
        [*MPIRUN, sys.executable, ROOT / "benchmarks" / "bad_input.py", "200"],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.stdout == "200 bad calls on 3 ranks, 0 of them ended badly\n", done.stderr
    assert done.returncode == 0


@pytest.fixture
def scene(comm) -> Scene:
    return sheet(comm, 4)


def test_arguments_that_differ_between_ranks(scene: Scene) -> None:
    """Each rank is told both values, and nothing has happened."""
    comm, solver = scene.comm, Solver(scene)
    last = comm.size - 1
    if last == 0:
        pytest.skip("needs two ranks")
    own = float(comm.rank == last)
    path = np.array([(0.0, 47.0), (100.0, 52.0 + 1e-13 * own)])
    calls = {
        "advance: pressure = 0.0 on rank 0, but 1.0": lambda: solver.advance(pressure=own),
        "advance: steps": lambda: solver.advance(pressure=0.01, steps=1 + int(own)),
        "floor: z": lambda: scene.floor(-1.0 - own),
        "fix: where": lambda: scene.fix("left" if own else "right"),
        "lay_cable: path": lambda: scene.lay_cable(Cable(EA=1.0), path),
        "lay_cable: cable": lambda: scene.lay_cable(Cable(EA=1.0 + own), path[:, :1] * [1.0, 0.5]),
        "Solver: rtol": lambda: Solver(scene, rtol=1e-9 * (1 + own)),
        "rectangle: size": lambda: meshes.rectangle(comm, 100.0, 100.0, 25.0 + own),
        "spherical_cap: height": lambda: meshes.spherical_cap(comm, 10.0, 3.0 + own, 2.0),
        "polygon: corners": lambda: meshes.polygon(comm, [(0, 0), (9 + own, 0), (0, 9)], 3.0),
        "draw: view = nothing": lambda: draw(solver, "a.png", **({"view": (0, 90)} if own else {})),
    }
    for words, call in calls.items():
        with pytest.raises(InputError) as caught:
            call()
        assert words in str(caught.value) and f"on rank {last}" in str(caught.value)
        assert len(set(comm.allgather(str(caught.value)))) == 1
    assert scene.floor_level is None and not scene.cables and not solver.steps


def test_values_without_their_addresses(comm) -> None:
    """Functions and other objects of one kind count as the same, wherever a process has them."""
    objects = [object() for _ in range(comm.rank + 1)]
    checks.same(comm, "call", function=lambda x: x, thing=objects[-1], number=np.float64(0.1))
    checks.same(comm, "call", array=np.linspace(0, 1, 2000), nan=float("nan"))


def test_what_differs_is_shown(comm) -> None:
    """However far behind the beginning it is."""
    if comm.size == 1:
        pytest.skip("needs two ranks")
    own = comm.rank == comm.size - 1
    for values in ({k: 0.0 for k in range(999)} | {777: 1.0 * own}, "x" * 500 + "y" * own):
        with pytest.raises(InputError) as caught:
            checks.same(comm, "call", values=values)
        shown = re.fullmatch(
            r"call: values = (.*) on rank 0, but (.*) on rank.*", str(caught.value)
        )
        assert shown is not None and shown[1] != shown[2] and len(shown[2]) < 210


def test_the_order_of_keys_does_not_count(comm) -> None:
    """Dicts that are made from sets have another one on each rank. Loads are applied alike, too."""
    energies = []
    for turned in (True, False):  # on the last rank
        own = turned and comm.rank == comm.size - 1
        points, cells = rotated_lattice(4)
        parts = {"a": range(9), "b": range(9, len(cells))}
        mesh = meshes.from_arrays(comm, points, cells, parts=parts, edges={"rim": [(0, 1)]})
        foil = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
        stiffer = IsotropicMembrane(E=400.0, nu=0.25, thickness=0.08)
        scene = clamped(mesh, ordered({"a": foil, "b": stiffer}, own))
        cables = [
            scene.lay_cable(Cable(EA=32000.0), [(0.0, y), (100.0, y + 5.0)]) for y in (30.0, 47.0)
        ]
        L0 = {cable: 0.99 * cable.L0 for cable in cables}
        keys = (*cables, cables[1].end, "rim", "boundary")
        move = {key: (0.0, 0.0, z) for key, z in zip(keys, (1.0, 0.1, 0.7, 0.1, 0.7), strict=True)}
        Solver(scene).advance(pressure=0.01, move=ordered(move, own), L0=ordered(L0, own))
        energies.append(scene.energy)
    assert energies[0] == pytest.approx(energies[1], rel=1e-12)


def ordered(values: dict, turned: bool) -> dict:
    return dict(reversed(values.items())) if turned else values


def test_a_rank_that_is_late_with_its_error(scene: Scene, monkeypatch) -> None:
    """Ranks wait for each other: the same error does not come at the same time everywhere."""
    monkeypatch.setattr(errors, "PATIENCE", 20.0)

    def marker(x: np.ndarray) -> np.ndarray:
        raise ValueError("of the user's own")

    if scene.comm.rank == 0:
        time.sleep(0.2)
    with pytest.raises(ValueError, match="of the user's own"):
        scene.fix(marker)
    with pytest.raises(InputError):  # no message is left over
        scene.fix("rim")


def test_warnings_are_shown_though_ffcx_logs_them():
    """Unless somebody reads that log. FFCx does so up to 0.10; here the program does, before."""
    capture = "import logging, warnings; logging.captureWarnings(True); "
    show = capture + "import crms_fenicsx; warnings.warn('look here')"
    read = "import logging; logging.basicConfig(format='LOG %(message)s'); " + show
    for program, log in ((show, False), (read, True)):
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True
        )
        assert "look here" in done.stderr
        assert ("LOG" in done.stderr) == log
