"""Foundations that carry several points: their forces and moments balance the loads."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cabled_square import clamped
from mpi4py import MPI
from report_page import read_csv

from crms_fenicsx import Bar, IsotropicMembrane, Solver, meshes
from crms_fenicsx.results.foundations import FoundationPoint
from crms_fenicsx.results.output.report.foundation_tables import _summed


def test_a_couple() -> None:
    """Opposite forces: no force, and the moment of the couple about any point."""
    for place in ((0.0, 0.0, 0.0), (7.0, -3.0, 2.0)):
        ends = [np.add(place, (sign, 0.0, 0.0)) for sign in (1.5, -1.5)]
        points = [
            FoundationPoint((name,), tuple(end.tolist()), (0.0, 0.0, force))
            for name, end, force in zip("ab", ends, (4.0, -4.0), strict=True)
        ]
        found = _summed(points)
        assert found.force == (0.0, 0.0, 0.0)
        np.testing.assert_allclose(found.moment, (0.0, -12.0, 0.0), atol=1e-12)
    assert _summed(points[:1]).moment == (0.0, 0.0, 0.0)


@pytest.mark.ranks
@pytest.mark.parametrize("units", [(1.0, 1.0), (1000.0, 1e-3)], ids=["m, kN", "mm, MN"])
def test_moment_of_a_braced_mast(
    comm: MPI.Intracomm, tmp_path: Path, units: tuple[float, float]
) -> None:
    """One block carries mast and guys: the moment of the load at the top about its place."""
    length, force = units
    folder = Path(comm.bcast(str(tmp_path)))
    mesh = meshes.rectangle(comm, 4.0 * length, 4.0 * length, 2.0 * length)
    foil = IsotropicMembrane(
        E=800.0 * force / length, nu=0.3, thickness=1.0, prestress=force / length
    )
    scene = clamped(mesh, foil)
    top = scene.add_joint((10.0 * length, 0.0, 5.0 * length), name="top")
    feet = {"mast": (10.0, 0.5, 0.0), "guy a": (13.0, 2.0, 0.0), "guy b": (13.0, -2.0, 1.0)}
    for name, foot in feet.items():
        bar = Bar(EA=1e5 * force, tension_only=name != "mast")
        scene.add_bar(bar, tuple(x * length for x in foot), top, name=name)
    load = np.array([-40.0, 3.0, -20.0]) * force
    scene.put_joint_load({top: tuple(load.tolist())}, name="pull")
    solver = Solver(scene)
    found = solver.combine({"pull": {"pull": 1.0}})
    block = {"Block": [f"start of {name}" for name in feet]}
    solver.report(folder / "a.html", found, pictures=["height"], foundations=block)
    solver.report(folder / "b.html", found, pictures=["height"])
    comm.barrier()
    solver.restore(found["pull"].snapshot)
    (row,) = read_csv(folder / "a_foundations.csv")
    np.testing.assert_allclose([float(row[f"F{x}"]) for x in "xyz"], load, rtol=1e-7)
    due = np.cross(top.position - np.mean([*feet.values()], axis=0) * length, load)
    moment = [float(row[f"M{x}"]) for x in "xyz"]
    np.testing.assert_allclose(moment, due, atol=1e-6 * np.linalg.norm(due))
    assert "Mx" not in read_csv(folder / "b_foundations.csv")[0]
