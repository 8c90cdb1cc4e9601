"""Bars, joints, ponds and sealed air in summaries, reports and files of one scene; foundations that
carry several points."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from report_page import Page, read_csv

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Solver, meshes
from crms_fenicsx.results.foundations import FoundationPoint
from crms_fenicsx.results.output.report.case import case_of, shape_of
from crms_fenicsx.results.output.report.foundation_tables import _summed
from crms_fenicsx.results.output.report.results_tables import families

SNOW, LAMP, WATER = 0.2, 0.5, 10.0
SIDE = 8.0


def braced(comm: MPI.Intracomm, folder: Path | None = None) -> Solver:
    """A cushion under snow and water, with a cable from a guyed mast, and a prop below."""
    ranks = lambda x: np.full(len(x), comm.size - 1)  # noqa: E731
    mesh = meshes.rectangle(comm, SIDE, SIDE, 2.0, structured=True, ranks=ranks)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=2.0))
    scene.put_load((0.0, 0.0, -SNOW), name="snow", per="plan")
    scene.put_pond(WATER, volume=0.3, name="puddle")
    prop = scene.vertex_at((2.0, 4.0, 0.0))
    scene.add_bar(Bar(EA=1e3), prop, (2.0, 4.0, -2.0), name="prop")
    top = scene.add_joint((4.0, -2.0, 3.0), name="top")
    scene.add_bar(Bar(EA=1e4), (4.0, -2.0, 0.0), top, name="mast")
    for x in (1.0, 7.0):
        scene.add_bar(Bar(EA=2e3, tension_only=True), top, (x, -5.0, 0.0), name=f"guy {x:g}")
    scene.put_joint_load({top: (0.0, 0.0, -LAMP)}, name="lamp")
    scene.lay_cable(Cable(EA=2e3), [top, (4.0, 4.0, 0.0), (4.0, 8.0, 0.0)], name="ridge")
    scene.seal(volume=200.0)
    return advanced(
        Solver(scene, results=folder), L0={scene.cables[0]: 10.3}, load={"puddle": 0.5, "lamp": 1.0}
    )


@pytest.mark.ranks
def test_all_supports_carry_all_loads(comm: MPI.Intracomm) -> None:
    """Statics: the flat rim gives the pressure's forces, the water's amount its weight."""
    solver = braced(comm)
    scene = solver.scene
    solver.advance(load={"snow": 1.0})
    found = solver.summary()
    assert found.factors == {"snow": 1.0, "puddle": 0.5, "lamp": 1.0}
    assert found.ponds["puddle"].level == scene.ponds[0].level
    assert set(found.joints) == {"end of prop", "start of mast", "end of guy 1", "end of guy 7"}
    assert found.cables["ridge"].start is None  # the joint is no anchor
    plan = SIDE**2
    down = SNOW * plan + 0.5 * WATER * 0.3 + LAMP - scene.pressure * plan
    np.testing.assert_allclose(found.reaction, (0.0, 0.0, down), atol=1e-6 * SNOW * plan)
    # moments about the line through the feet of the guys
    _, y, z = scene.joint("top").position
    _, along, up = -scene.cables[0].start.reaction
    foot = (z * along - (y + 5.0) * (up - LAMP)) / 3.0
    assert found.joints["start of mast"][2] == pytest.approx(foot, rel=1e-6)
    assert found.bars["mast"].force < -1.0


@pytest.mark.ranks
def test_a_report_has_them_all(comm: MPI.Intracomm, folder: Path) -> None:
    solver = braced(comm)
    scene = solver.scene
    found = solver.combine({"calm": {"lamp": 1.0}, "snow": {"snow": 1.0}}, steps=2)
    solver.report(folder / "tent.html", found, unit="m", force="kN", pictures=["tension"])
    comm.barrier()
    page = Page((folder / "tent.html").read_text(encoding="utf-8"))
    assert len(page.images) == 2 + 2 + 2 + 2  # model, loads on the membrane, cases, foundations
    assert [row[0] for row in page.tables["Joints"][1:]] == ["top"]
    kinds = {row[0]: row[1] for row in page.tables["Loads at the factor 1"]}
    assert kinds["lamp"] == "on joints"
    assert kinds["puddle"].startswith("water of the weight 10")
    assert any(row[0] == "Air" for row in page.tables["Mesh and theory"])
    expected = {}
    for name, one in found.items():
        solver.restore(one.snapshot)
        expected[name] = solver.summary()
    forces = [
        (row["Bar"], row["Combination"], float(row["Force [kN]"]))
        for row in read_csv(folder / "tent_bars.csv")
    ]
    assert forces == [
        (bar.name, name, pytest.approx(expected[name].bars[bar.name].force, rel=1e-9))
        for bar in scene.bars
        for name in found
    ]
    for row in read_csv(folder / "tent_bar_envelope.csv"):
        least = min(found, key=lambda name: expected[name].bars[row["Bar"]].force)
        assert row["Governs least"] == least
    (calm, snow) = read_csv(folder / "tent_ponds.csv")
    assert float(snow["Weight with the factor [kN]"]) == pytest.approx(0.5 * WATER * 0.3)
    assert float(snow["Level z [m]"]) < float(calm["Level z [m]"])
    for row in read_csv(folder / "tent_joints.csv"):
        force = [float(row[f"R{x} [kN]"]) for x in "xyz"]
        due = expected[row["Combination"]].joints[row["Joint"]]
        np.testing.assert_allclose(force, due, atol=2e-6 * np.linalg.norm(due))
    total = [
        row
        for row in read_csv(folder / "tent_supports.csv")
        if row["Support"] == "supports, anchors and held joints"
    ]
    assert [float(row["Rz [kN]"]) for row in total] == [
        pytest.approx(expected[name].reaction[2], abs=1e-6) for name in found
    ]


def test_pictures_have_room_for_bars(comm: MPI.Intracomm) -> None:
    solver = braced(comm)
    case = case_of(solver, "now", shape_of(solver.scene))
    assert case.low[1] == pytest.approx(-5.0)
    assert case.low[2] == pytest.approx(-2.0)
    assert case.high[2] == pytest.approx(solver.scene.joint("top").position[2])


def test_many_bars_share_rows_of_a_page(comm: MPI.Intracomm, folder: Path) -> None:
    """Those of a belt by the one with the largest force; tables in files have all."""
    mesh = meshes.rectangle(comm, 10.0, 4.0, 1.0, structured=True)
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=2.0))
    row = [scene.vertex_at((float(x), 2.0, 0.0)) for x in range(11)]
    for k, (one, other) in enumerate(pairwise(row), 1):
        scene.add_bar(Bar(EA=50.0 * k), one, other, name=f"belt {k}")
    scene.add_bar(Bar(EA=1e3), row[5], (5.0, 2.0, -1.0), name="strut 1")
    scene.put_load((0.0, 0.0, -0.5), name="snow", per="plan")
    solver = Solver(scene)
    found = solver.combine({"calm": {"snow": 0.1}, "snow": {"snow": 1.0}})
    solver.report(folder / "belt.html", found, pictures=[])
    comm.barrier()
    page = Page((folder / "belt.html").read_text(encoding="utf-8"))
    belt = "belt 1 ... belt 10"
    forces = {}
    for name, one in found.items():
        solver.restore(one.snapshot)
        forces[name] = [bar.force for bar in scene.bars[:10]]
    every = read_csv(folder / "belt_bars.csv")
    assert {row["Bar"] for row in every} == {bar.name for bar in scene.bars}
    envelope = next(row for row in page.tables["Envelope of the bars' forces"] if row[0] == belt)
    assert float(envelope[1]) == pytest.approx(min(forces["calm"]), abs=6e-4)
    assert float(envelope[3]) == pytest.approx(max(forces["snow"]), rel=1e-3)
    assert envelope[4] == "snow" and max(forces["snow"]) > 2.0 * min(forces["snow"])
    assert families(["guy 1", "guy 2", "mast"]) == {n: [n] for n in ("guy 1", "guy 2", "mast")}


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
    comm: MPI.Intracomm, folder: Path, units: tuple[float, float]
) -> None:
    """One block carries mast and guys: the moment of the load at the top about its place."""
    length, force = units
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


@pytest.mark.ranks
def test_a_foundation_that_loses_a_member(comm: MPI.Intracomm, folder: Path) -> None:
    """It keeps its name where a bar is missing, and has all members in the table of points; so does
    the one that governs where others have none."""
    scene = clamped(
        meshes.rectangle(comm, 4.0, 4.0, 1.0, structured=True),
        IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0, prestress=1.0),
    )
    scene.put_load((0.0, 0.0, -0.1), name="snow")
    middle = scene.vertex_at((2.0, 2.0, 0.0))
    for name, foot in {"a": (2.0, 2.0, 3.0), "b": (2.0, 2.0, 3.0), "c": (4.0, 2.0, 3.0)}.items():
        scene.add_bar(Bar(EA=50.0, expansion=1.2e-5), foot, middle, name=name)
    solver = Solver(scene)
    given = {
        "all": {"snow": 1.0},
        "lost": {"snow": 1.0, "without": ["b"]},
        "one": {"snow": 1.0, "without": ["c"], "state": "accidental"},
    }
    solver.report(folder / "lost.html", solver.combine(given), pictures=["height"])
    comm.barrier()
    points = read_csv(folder / "lost_foundation_points.csv")
    assert sorted(one["Attached"] for one in points) == ["a, b", "c"]
    (shared,) = (one["Foundation"] for one in points if one["Attached"] == "a, b")
    rows = read_csv(folder / "lost_foundations.csv")
    assert [one["Combination"] for one in rows if one["Foundation"] == shared] == [*given]
    (left,) = (one["Foundation"] for one in rows if one["Combination"] == "one")
    most = [
        one["Governing member"] for one in read_csv(folder / "lost_governing.csv")
        if one["Limit state"] == "accidental" and one["Verification"].startswith("Foundation")
    ]  # fmt: skip
    assert left == "F2" and {*most} == {left}
    heads, *bars = Page((folder / "lost.html").read_text(encoding="utf-8")).tables["Bars"]
    assert heads[-1] == "Expansion [1/K]" and {row[-1][:5] for row in bars} == {"1.200"}
