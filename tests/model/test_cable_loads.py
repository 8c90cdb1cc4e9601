"""Loads along cables, such as their weight: sums by hand, on fabric and joints."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, InputError, IsotropicMembrane, Solver, codes

FOIL = IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=3.0)


@pytest.mark.ranks
def test_the_weight_of_cables_reaches_supports(comm: MPI.Intracomm) -> None:
    """All of it but for the halves of the spans to anchors; where it acts, the fabric sinks."""
    scene = sheet(comm, 6, material=FOIL, side=6.0)
    inner = scene.lay_cable(Cable(EA=1e3), [(1.2, 2.6), (4.8, 2.6)], tension=1.0, name="inner")
    top = scene.add_joint((3.0, 9.0, 0.5), held="xyz")
    path = [(3.3, 3.2, 0.0), top]
    guy = scene.lay_cable(Cable(EA=1e3), path, tension=1.0, name="guy")
    solver = Solver(scene)
    solver.advance()
    scene.put_cable_load((0.0, 0.0, -0.05), [inner, guy], name="weight")
    load = scene.load("weight")
    on_fabric = comm.allreduce(load.forces.sum(axis=0))
    on_joint = np.array(load.joints.get(top.name, (0.0, 0.0, 0.0)))
    lengths = inner.length + guy.length
    np.testing.assert_allclose(on_fabric + on_joint, (0.0, 0.0, -0.05 * lengths), atol=1e-12)
    assert on_joint[2] < 0.0
    before = solver.summary().reaction[2]
    solver.advance(load={"weight": 1.0})
    found = solver.summary()
    assert found.reaction[2] - before == pytest.approx(0.05 * lengths, rel=1e-6)
    assert found.lowest.value < -0.01


@pytest.mark.ranks
def test_combinations_scale_them(comm: MPI.Intracomm, folder: Path) -> None:
    """By hand: 1.35 times the weight of all cables in the reactions and the balance; the report's
    table has the sum on fabric and joints."""
    scene = sheet(comm, 6, material=FOIL, side=6.0)
    scene.lay_cable(Cable(EA=1e3), [(1.2, 2.6), (4.8, 2.6)], tension=1.0, name="inner")
    top = scene.add_joint((3.0, 9.0, 0.5), held="xyz")
    scene.lay_cable(Cable(EA=1e3), [(3.3, 3.2, 0.0), top], tension=1.0, name="guy")
    scene.put_load((0.0, 0.0, -0.01), name="weight", per="material")
    solver = Solver(scene)
    solver.advance()
    scene.put_cable_load((0.0, 0.0, -0.05), scene.cables, name="cable weight")
    weight = 0.05 * sum(cable.length for cable in scene.cables)
    table = codes.combinations(codes.en1990, ["weight", "cable weight"], [], state="ULS")
    found = solver.combine(table)
    for name, factor in (("ULS: 1.35 weight + 1.35 cable weight", 1.35),
                         ("ULS: 1 weight + 1 cable weight", 1.0)):  # fmt: skip
        solver.restore(found[name].snapshot)
        summary = solver.summary()
        assert summary.reaction[2] == pytest.approx(factor * (weight + 0.36), rel=1e-6)
    solver.report(folder / "r.html", found, pictures=[])
    if comm.rank == 0:
        page = re.sub(r"<[^>]+>", " ", (folder / "r.html").read_text())
        kind = "fixed direction, also on joints"
        row = re.search(rf"cable weight +{kind} +\S+ +\S+ +0 +0 +(\S+)", page)
        assert row and float(row[1].replace("\u2212", "-")) == pytest.approx(-weight, rel=1e-3)


@pytest.mark.ranks
def test_shares_of_anchors_go_into_the_ground(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 6, material=FOIL, side=6.0)
    cable = scene.lay_cable(Cable(EA=1e3), [(-2.0, 2.6, 0.0), (8.0, 2.6, 0.0)], tension=1.0)
    Solver(scene).advance()
    scene.put_cable_load((0.0, 0.3, 0.0), scene.cables, name="wind on cables")
    load = scene.load("wind on cables")
    total = comm.allreduce(load.forces.sum(axis=0))
    # from the middle of one free span to that of the other
    np.testing.assert_allclose(total, (0.0, 0.3 * 8.0, 0.0), atol=1e-9)
    assert not load.joints and cable.length == pytest.approx(10.0)


def test_bad_loads_along_cables(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 4, material=FOIL, side=4.0)
    cable = scene.lay_cable(Cable(EA=1e3), [(0.0, 1.4), (4.0, 1.4)])
    bar = scene.add_bar(Bar(EA=1.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    for given, words in (
        (((0.0, 0.0, -1.0), []), "cables"),
        (((0.0, 0.0, -1.0), [bar]), "a cable is of type PlacedBar"),
        (((0.0, 0.0), [cable]), "force"),
        (((0.0, 0.0, np.nan), [cable]), "force"),
    ):
        with pytest.raises(InputError, match=words):
            scene.put_cable_load(*given)  # type: ignore[arg-type]
    assert not len(scene.loads)
