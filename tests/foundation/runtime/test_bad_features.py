"""Bad loads, air, water, bars and load cases: refused on all ranks alike, with nothing changed."""

from __future__ import annotations

import re

import pytest
from bad_calls import ACROSS, FOIL, scenes, snapshot
from bad_feature_calls import features
from mpi4py import MPI

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.analysis.equilibrium.search import EquilibriumSearch

pytestmark = pytest.mark.ranks


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("where", ["all ranks", "the last rank"])
def test_bad_values_of_all_arguments(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch, where: str
) -> None:
    """The error is the package's own; nothing is computed."""

    def solve(*arguments: object) -> None:
        raise AssertionError("a solve was begun")

    monkeypatch.setattr(EquilibriumSearch, "find", solve)
    mesh = meshes.rectangle(comm, 100.0, 100.0, 25.0, structured=True)
    scene, other = (Scene(mesh, IsotropicMembrane(**FOIL)) for _ in range(2))
    scene.fix("boundary")
    solver, cable = Solver(scene), scene.lay_cable(Cable(32000.0), ACROSS)
    scenes(scene, other, solver, cable)  # puts a joint on the other scene
    calls = features(scene, other, solver)
    before, wrong = [snapshot(one) for one in (scene, other)], []
    for call in calls:
        if where != "all ranks" and not call.together:
            continue
        for name, values in call.bad.items():
            for value in values[:: comm.size]:  # all of them on one rank
                mine = where == "all ranks" or comm.rank == comm.size - 1
                arguments = {**call.good, name: value} if mine else call.good
                try:
                    call.function(**arguments)
                    text = "no error"
                except InputError as error:
                    text = re.sub(" at 0x[0-9a-f]+", "", str(error))
                texts = comm.allgather(text)
                same = [snapshot(one) for one in (scene, other)] == before
                if "no error" in texts or len(set(texts)) > 1 or not comm.allreduce(same, MPI.MIN):
                    wrong.append((call.name, name, repr(value), texts))
    assert not wrong
