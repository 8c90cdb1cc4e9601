"""The loop of the how-to page on coupling, against a stand-in for preCICE's Python bindings."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import dolfinx.fem
import numpy as np
import pytest
from cabled_square import advanced, sheet
from mpi4py import MPI

from crms_fenicsx import Cable, Scene, Solver

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]

PAGE = Path(__file__).parents[3] / "docs" / "how_to" / "coupling.md"
TIMES, TOLERANCE, MOST = 2, 1e-9, 30


class Participant:
    """Serial-implicit coupling with springs that press the roof up from below as it sinks.

    In each time step the snow grows; the step is repeated until the forces agree.
    """

    stiffness, snow = 2e-4, -0.05

    def __init__(self, name: str, configuration: str, rank: int, size: int) -> None:
        self.comm = MPI.COMM_WORLD
        assert (rank, size) == (self.comm.rank, self.comm.size)
        self.time, self.iteration, self.begins, self.again = 0, 0, True, False
        self.log: list[int] = []

    def set_mesh_vertices(self, mesh: str, places: Any) -> Any:
        self.forces = np.zeros_like(places)
        return np.arange(len(places))

    def initialize(self) -> None:
        pass

    def is_coupling_ongoing(self) -> bool:
        return self.time < TIMES

    def requires_writing_checkpoint(self) -> bool:
        return self.begins

    def get_max_time_step_size(self) -> float:
        return 1.0

    def read_data(self, mesh: str, name: str, ids: Any, dt: float) -> Any:
        assert name == "force"
        return self.forces[ids]

    def write_data(self, mesh: str, name: str, ids: Any, values: Any) -> None:
        assert name == "displacement" and values.shape == self.forces.shape
        self.u = values.copy()

    def advance(self, dt: float) -> None:
        answer = -self.stiffness * self.u
        answer[:, 2] += self.snow * (self.time + 1)
        change = np.abs(answer - self.forces).max(initial=0.0)
        self.forces = answer
        self.iteration += 1
        assert self.iteration < MOST
        self.again = self.comm.allreduce(change, op=MPI.MAX) > TOLERANCE
        self.begins = not self.again
        if not self.again:
            self.time += 1
            self.log.append(self.iteration)
            self.iteration = 0

    def requires_reading_checkpoint(self) -> bool:
        return self.again

    def finalize(self) -> None:
        self.log.append(-1)


def roof(comm: MPI.Intracomm) -> Solver:
    """Inflated, under a cable with friction."""
    scene = sheet(comm, 4)
    solver = advanced(Solver(scene), pressure=0.01)
    scene.lay_cable(Cable(9000.0, friction=0.3), [(0.0, 47.0), (100.0, 52.0)], name="ridge")
    solver.advance()
    return solver


def test_the_loop_for_precice(comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch) -> None:
    """It repeats time steps, and the forces at its end are those of the displacements."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (loop,) = (block for block in blocks if "precice.Participant" in block)
    solver = roof(comm)
    monkeypatch.setitem(sys.modules, "precice", SimpleNamespace(Participant=Participant))
    scene: Scene = solver.scene
    exec(loop, {"dolfinx": dolfinx, "scene": scene, "solver": solver})
    steps = len(solver.steps)
    assert steps > 2 + TIMES + 2, "time steps are repeated"
    n = 3 * scene.V.dofmap.index_map.size_local
    (load,) = scene.loads
    expected = -Participant.stiffness * scene.u.x.array[:n].reshape(-1, 3)
    expected[:, 2] += Participant.snow * TIMES
    np.testing.assert_allclose(load.forces[: n // 3], expected, atol=1e-8)
    at_once = roof(comm)  # it comes to the same but for what friction remembers
    forces = dolfinx.fem.Function(at_once.scene.V)
    forces.x.array[:n] = load.forces[: n // 3].ravel()
    at_once.scene.put_forces(forces)
    at_once.advance(load={"forces": 1.0}, steps=TIMES)
    assert at_once.scene.energies["membrane"] == pytest.approx(scene.energies["membrane"], rel=1e-3)
