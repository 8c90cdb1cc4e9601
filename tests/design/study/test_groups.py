"""Combinations that groups of processes share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI

from crms_fenicsx import Cable, ConvergenceError, InputError, Solver, meshes
from crms_fenicsx.design.study import combine_in_groups
from crms_fenicsx.energy.minimization.minimizer import Minimizer
from crms_fenicsx.energy.minimization.outcome import Outcome
from crms_fenicsx.foundation.meshes import MembraneMesh

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]

TABLE = {
    "snow": {"snow": 1.0},
    "drift": {"snow": 0.5, "pressure": 0.012},
    "calm": {"pressure": 0.011},
    "both": {"snow": 0.3},
}


def square(comm: MPI.Intracomm) -> MembraneMesh:
    return meshes.rectangle(comm, 100.0, 100.0, 25.0)


def build(mesh: MembraneMesh) -> Solver:
    scene = clamped(mesh)
    scene.put_load((0.0, 0.0, -2e-3), name="snow", per="plan")
    solver = advanced(Solver(scene), pressure=0.01)
    scene.lay_cable(Cable(32000.0), [(0.0, 47.0), (100.0, 52.0)], tension=20.0, name="ridge")
    solver.advance()
    return solver


def test_groups_find_what_one_solver_finds(comm: MPI.Intracomm, folder: Path) -> None:
    page = folder / "report.html"
    groups = min(2, comm.size)
    found = combine_in_groups(
        build,
        square(comm),
        TABLE,
        groups=groups,
        report=page,
        pictures=["stress"],
        force="kgf",
        unit="cm",
    )
    assert list(found) == list(TABLE)
    solver = build(square(comm))
    for name, one in solver.combine(TABLE).items():
        solver.restore(one.snapshot)
        own, theirs = solver.summary(), found[name].summary
        assert theirs.pressure == own.pressure
        assert theirs.energy == pytest.approx(own.energy, rel=1e-8)
        ours = own.cables["ridge"].mean
        assert theirs.cables["ridge"].mean == pytest.approx(ours, rel=1e-5)
        for stress in ("true force 2", "true force 1"):
            largest = theirs.membrane.largest[stress].value
            assert largest == pytest.approx(own.membrane.largest[stress].value, rel=1e-5)
        verification = found[name].verification
        assert verification is not None
        assert verification.passed
    every = comm.allgather([one.summary for one in found.values()])
    assert all(one == every[0] for one in every)
    comm.barrier()
    text = page.read_text(encoding="utf-8")
    shown = [text.count(f'alt="{name}: major principal section force') for name in TABLE]
    assert shown == [1] * len(TABLE), "a picture of each, and of nothing twice"
    tensions = (folder / "report_cables.csv").read_text().splitlines()[1:]
    assert [line.split(",")[1] for line in tensions] == ["LC0", *TABLE]
    np.testing.assert_allclose(
        [float(line.split(",")[3]) for line in tensions[1:]],
        [one.summary.cables["ridge"].mean for one in found.values()],
    )


def test_more_groups_than_combinations(comm: MPI.Intracomm) -> None:
    found = combine_in_groups(build, square(comm), {"snow": {"snow": 1.0}}, groups=comm.size)
    assert list(found) == ["snow"]


def test_bad_groups(comm: MPI.Intracomm, folder: Path) -> None:
    with pytest.raises(InputError, match=f"groups = {comm.size + 1} is more than the {comm.size}"):
        combine_in_groups(build, square(comm), TABLE, groups=comm.size + 1)
    with pytest.raises(InputError, match=r"'storm'.*no load 'wind'"):
        combine_in_groups(build, square(comm), TABLE | {"storm": {"wind": 1.0}}, groups=comm.size)
    with pytest.raises(InputError, match=r"build returned None, expected a Solver"):
        combine_in_groups(lambda mesh: None, square(comm), TABLE, groups=1)  # type: ignore[arg-type, return-value]
    with pytest.raises(InputError, match=r"\['title'\] are options of a report"):
        combine_in_groups(build, square(comm), TABLE, groups=1, title="Roof")
    with pytest.raises(InputError, match=r"pass a name with \.html"):
        combine_in_groups(build, square(comm), TABLE, groups=1, report=folder / "a.pdf")


def test_groups_must_build_the_same(comm: MPI.Intracomm) -> None:
    if comm.size == 1:
        pytest.skip("there is one group only")

    def differing(mesh: MembraneMesh) -> Solver:
        solver = build(mesh)
        if MPI.COMM_WORLD.rank >= comm.size // 2:
            solver.scene.remove("ridge")
            solver.advance()
        return solver

    with pytest.raises(InputError, match="combine_in_groups: build: cables"):
        combine_in_groups(differing, square(comm), TABLE, groups=comm.size)


def test_a_combination_without_equilibrium_ends_all_groups(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    def weak(mesh: MembraneMesh) -> Solver:
        solver = build(mesh)
        monkeypatch.setattr(
            Minimizer, "solve", lambda self, *_: Outcome(False, "no", 1.0, 0.0, 1, 1, 1)
        )
        return solver

    with pytest.raises(ConvergenceError, match="combination 'snow'"):
        combine_in_groups(weak, square(comm), TABLE, groups=comm.size)


def test_groups_know_the_surface_of_the_mesh(comm: MPI.Intracomm) -> None:
    """New vertices lie on the sphere of the generator, on the copy of each group."""
    from crms_fenicsx.foundation.meshes.membrane_mesh import redistributed

    mesh = meshes.spherical_cap(comm, 4.0, 2.0, 1.5)
    own = comm.Split(comm.rank % 2, comm.rank)
    copy = redistributed(mesh, own)
    cells = [one.mesh.topology.index_map(2).size_global for one in (copy, mesh)]
    assert cells[0] == cells[1]
    x = meshes.refine(copy).mesh.geometry.x
    assert np.abs(np.linalg.norm(x - (0.0, 0.0, -3.0), axis=1) - 5.0).max(initial=0.0) < 1e-12
    del copy
    own.Free()
