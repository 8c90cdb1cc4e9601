"""Combinations know what they are for: deflections, prestress, what is missing, service limits."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    codes,
    meshes,
)
from crms_fenicsx.design.form_finding import find_form
from crms_fenicsx.model.strengths import SETTINGS
from crms_fenicsx.results.design_checks import DesignCheck
from crms_fenicsx.results.output.report.design_tables import cable_values
from crms_fenicsx.results.summary import DesignTable

FOIL = IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=3.0)


def roof(comm: MPI.Intracomm) -> tuple[Scene, Solver]:
    """A flat square under pressure in operation, with a cable and a load."""
    scene = sheet(comm, 6, material=FOIL, side=6.0)
    scene.lay_cable(Cable(EA=2e3), [(0.0, 2.6), (6.0, 2.6)], tension=4.0, name="A5")
    scene.put_load((0.0, 0.0, -0.4), name="snow", per="plan")
    solver = Solver(scene)
    solver.advance(pressure=0.3)
    return scene, solver


@pytest.mark.ranks
def test_deflections_are_those_from_operation(comm: MPI.Intracomm) -> None:
    scene, solver = roof(comm)
    operation = scene.positions().copy()
    assert solver.summary().deflection is None  # of no combination
    found = solver.combine(
        {"calm": {}, "snow": {"snow": 1.0, "state": "characteristic"}, "U": {"snow": 1.5}}
    )
    states = {name: one.state for name, one in found.items()}
    assert states == {"calm": "ULS", "snow": "characteristic", "U": "ULS"}
    for name, one in found.items():
        solver.restore(one.snapshot)
        summary, moved = solver.summary(), np.linalg.norm(scene.positions() - operation, axis=1)
        expected = comm.allreduce(float(moved.max(initial=0.0)), op=MPI.MAX)
        assert summary.state == states[name] and summary.deflection is not None
        assert summary.deflection.value == pytest.approx(expected, rel=1e-12)
        if name == "calm":
            assert expected < 1e-6 < summary.displacement.value
    assert list(solver.history["limit state"]) == ["", "ULS", "characteristic", "ULS"]


@pytest.mark.ranks
def test_prestress_has_a_partial_factor(comm: MPI.Intracomm) -> None:
    """Of a flat sheet with a cable and a bar in it, whose forces all scale, exactly; and of an
    inflated form, whose pressure and residual stress scale too, so that it keeps its shape."""
    flat = sheet(comm, 4, material=FOIL, side=4.0)
    cable = flat.lay_cable(Cable(EA=1e3), [(0.0, 1.4), (4.0, 1.4)], tension=2.0)
    corners = [flat.vertex_at((x, 4.0, 0.0)) for x in (0.0, 4.0)]
    bar = flat.add_bar(Bar(EA=1e3), *corners, L0=4.04)
    form = find_form(
        meshes.rectangle(comm, 6.0, 4.0, size=1.0), stress=2.0, fixed=["boundary"], rise=1.5
    )
    blown = form.scene(OrthotropicMembrane(E1=400.0, E2=300.0, G12=20.0, nu21=0.2, thickness=1.0))
    assert any(term.name == "residual stress" for term in blown.terms)
    for scene in (flat, blown):
        solver = Solver(scene)
        solver.advance()
        before, pressure = solver.summary(), scene.pressure
        forces = [one.tension for one in scene.cables], [one.force for one in scene.bars]
        places = scene.positions().copy()
        found = solver.combine({"tight": {"prestress": 1.3}})["tight"]
        assert scene.pressure == pressure and [x.tension for x in scene.cables] == forces[0]
        solver.restore(found.snapshot)
        after = solver.summary()
        assert scene.pressure == pytest.approx(1.3 * pressure)
        if scene is blown:
            np.testing.assert_allclose(scene.positions(), places, atol=1e-6)
            for name in ("true force 1", "true force 2"):
                most = before.membrane.largest[name].value
                assert after.membrane.largest[name].value == pytest.approx(1.3 * most, rel=1e-5)
        else:
            assert cable.tension == pytest.approx(1.3 * forces[0][0], rel=1e-8)
            assert bar.force == pytest.approx(1.3 * forces[1][0], rel=1e-8)
            least = [x.membrane.least["true force 2"].value for x in (before, after)]
            assert least == pytest.approx([3.0, 3.9], rel=1e-8)


def test_prestress_that_cannot_be_scaled(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 2, side=2.0, material=IsotropicMembrane(E=1.0, nu=0.0, thickness=1.0))
    scene.lay_cable(Cable(EA=1e3, law="step"), [(0.0, 0.6), (2.0, 0.6)], tension=1.0)
    with pytest.raises(InputError, match=r"'P': prestress cannot be scaled: step-wise laws"):
        Solver(scene).combine({"P": {"prestress": 1.2}})


@pytest.mark.ranks
def test_a_missing_cable_is_that_removed_by_hand(comm: MPI.Intracomm) -> None:
    scene, solver = roof(comm)
    table = codes.combinations(
        codes.en1990, [], ["snow"], state="accidental", accidents={"torn": {"without": ["A5"]}}
    )
    found = solver.combine(table)
    assert [cable.name for cable in scene.cables] == ["A5"]
    by_hand, other = roof(comm)
    by_hand.remove("A5")
    other.advance(load={"snow": 0.2})
    one = found["accidental: torn + 0.2 snow"]
    assert one.state == "accidental" and one.snapshot.tensions == {}
    solver.restore(one.snapshot)
    np.testing.assert_allclose(scene.positions(), by_hand.positions(), atol=1e-7)


@pytest.mark.ranks
def test_service_has_limits_and_no_strengths(comm: MPI.Intracomm) -> None:
    scene, solver = roof(comm)
    scene.set_strengths((2.0, 2.0), cables=codes.CableDesign(breaking=30.0))
    scene.set_limits(deflection=0.02, prestress=1.0, slope=0.5, water=0.01)
    found = solver.combine({
        "U": {"snow": 1.5}, "C": {"snow": 1.0, "state": "characteristic"},
        "Q": {"state": "quasi-permanent"},
    })  # fmt: skip
    checks = {}
    for name, one in found.items():
        solver.restore(one.snapshot)
        summary = solver.summary()
        checks[name] = {check.what: check for check in summary.checks}
        assert ("utilisation" in summary.membrane.largest) == (name == "U") == bool(summary.design)
    assert checks["U"].keys() == {"fabric", "cable"}
    assert checks["C"].keys() == {"deflection", "ponding", "cable"}
    assert checks["Q"].keys() == {"deflection", "prestress", "slope", "ponding", "cable"}
    assert not checks["U"]["fabric"].passed and checks["U"]["fabric"].limit == 2.0
    assert checks["U"]["cable"].limit == pytest.approx(20.0)
    assert checks["C"]["cable"].limit == pytest.approx(13.5)
    assert not checks["C"]["deflection"].passed and checks["C"]["ponding"].effect > 0.01
    assert not checks["C"]["ponding"].passed
    assert checks["Q"]["ponding"].passed and checks["Q"]["deflection"].passed
    assert checks["Q"]["prestress"].passed
    # on some meshes water stands beside the cable, a few millimetres deep
    assert checks["Q"]["slope"].passed == (checks["Q"]["ponding"].effect == 0.0)
    table = solver.judge(found)
    assert not table.passed and table.unjudged == ()
    assert {(state, name) for state, name, _ in table.rows} == {
        ("ULS", "U"), ("characteristic", "C"), ("quasi-permanent", "Q"),
    }  # fmt: skip
    text = repr(table)
    assert text.index("ULS") < text.index("characteristic") < text.index("quasi-permanent")
    assert text.count("NOT PASSED") == sum(not check.passed for *_, check in table.rows) >= 3
    scene.set_strengths((2.0, 2.0))
    assert solver.judge(found).unjudged == ("cable A5",)


def test_guys_are_judged_as_ropes(comm: MPI.Intracomm) -> None:
    """By name, with the limit in service of EN 1993-1-11, in place of their own strength."""
    scene = sheet(comm, 6, material=FOIL, side=6.0)
    scene.lay_cable(Cable(EA=2e3), [(0.0, 2.6), (6.0, 2.6)], tension=4.0, name="A5")
    guy = Bar(EA=1e3, tension_only=True, strength=1.0)
    top = scene.vertex_at((3.0, 3.0, 0.0))
    bars = [scene.add_bar(guy, (3.0, 3.0, -2.0), top, L0=1.999, name=x) for x in ("rope", "rod")]
    solver = Solver(scene)
    solver.advance()
    with_rope = {"rope": codes.CableDesign(breaking=60.0), "A5": 9.0}
    found = solver.combine({"U": {}, "C": {"state": "characteristic"}})
    for ropes, limits in ((with_rope, {"U": 40.0, "C": 27.0}), ({}, {"U": 1.0, "C": None})):
        scene.set_strengths((20.0, 20.0), cables=ropes)
        for name, limit in limits.items():
            solver.restore(found[name].snapshot)
            checks = {one.member: one for one in solver.summary().checks}
            assert bars[0].force > 0.0
            assert ("rope" in checks) == (limit is not None)
            assert limit is None or checks["rope"].limit == pytest.approx(limit)
            assert ("rod" in checks) == (name == "U")
    assert not cable_values(scene)
    scene.set_strengths((20.0, 20.0), cables=with_rope)
    rows = {row[0]: row[-2:] for row in cable_values(scene)}
    assert rows.keys() == {"A5", "rope"} and rows["rope"] == (40.0, 27.0)


@pytest.mark.ranks
def test_limits_by_part_and_joint(comm: MPI.Intracomm) -> None:
    points = [[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1], [0.5, 0.5], [1.5, 0.5]]
    cells = [[0, 1, 6], [1, 4, 6], [4, 3, 6], [3, 0, 6], [1, 2, 7], [2, 5, 7], [5, 4, 7], [4, 1, 7]]
    mesh = meshes.from_arrays(comm, points, cells, parts={"west": range(4), "east": range(4, 8)})
    scene = Scene(mesh, FOIL)
    scene.fix("boundary")
    top = scene.add_joint((1.5, 0.5, 2.0), name="top")
    scene.add_bar(Bar(EA=50.0), (1.5, 0.5, 4.0), top)
    scene.add_bar(Bar(EA=50.0), scene.vertex_at((1.5, 0.5, 0.0)), top)
    for foot in ((3.5, 0.5, 2.0), (-0.5, 0.5, 2.0), (1.5, 2.5, 2.0), (1.5, -1.5, 2.0)):
        scene.add_bar(Bar(EA=50.0), foot, top)
    scene.put_joint_load({top: (0.0, 0.0, -1.0)}, name="lamp")
    scene.set_limits(deflection={"west": 1.0, "east": 0.001, "top": 0.5})
    solver = Solver(scene)
    solver.advance()
    found = solver.combine({"lamp": {"lamp": 1.0, "state": "frequent"}})
    rows = {check.member: check for *_, check in solver.judge(found).rows}
    solver.restore(found["lamp"].snapshot)
    assert rows["top"].effect == pytest.approx(2.0 - top.position[2]) and rows["top"].at is None
    assert rows["west"].effect == 0.0 and rows["west"].passed
    assert rows["east"].effect > 0.0 and not rows["east"].passed
    for bad in ({"north": 1.0}, {"west": 0.0}):
        with pytest.raises(InputError):
            scene.set_limits(deflection=bad)
    with pytest.raises(InputError, match="no part 'top'"):
        scene.set_limits(prestress={"top": 1.0})
    assert scene.design.limits.deflection["east"] == 0.001


@pytest.mark.parametrize(
    ("height", "slope"),
    [
        (lambda x, y: 0.1 * x, np.degrees(np.arctan(0.1))),
        # over the ridge in the middle, to both sides
        (lambda x, y: -0.2 * abs(x - 2.0), np.degrees(np.arctan(0.2))),
        (lambda x, y: (x - 2.0) ** 2 + (y - 2.0) ** 2, 0.0),  # a bowl: nothing drains
        (lambda x, y: 0.0 * x, 0.0),
    ],
)
def test_slopes_of_drainage(comm: MPI.Intracomm, height, slope: float) -> None:  # type: ignore[no-untyped-def]
    """Of planes, by hand: the steepest ways run along the edges of a structured mesh."""
    from crms_fenicsx.results.hollows import find_hollows

    mesh = meshes.rectangle(comm, 4.0, 4.0, size=0.5, structured=True)
    mesh.mesh.geometry.x[:, 2] = height(*mesh.mesh.geometry.x.T[:2])
    found = find_hollows(Scene(mesh, FOIL).net, drainage=True).least
    assert found is not None
    assert found[0] == pytest.approx(slope, abs=1e-9)


def test_shares_and_names() -> None:
    low = DesignCheck("prestress", "roof", 0.5, 1.0)
    assert (
        low.share == 2.0 and not low.passed and DesignCheck("slope", "", 0.0, 2.0).share == np.inf
    )
    assert DesignCheck("ponding", "", 0.0, 0.0).passed
    assert repr(low) == "prestress roof: 0.5 >= 1, 200.0%"
    assert DesignTable(()).passed and DesignTable(()).governing is None
    assert repr(DesignTable(())) == "no checks: set strengths or limits"
    doubtful = DesignTable((), (), (("snow", "snap-through: it turns over"),))
    assert not doubtful.passed and repr(doubtful) == "doubtful: snow: snap-through: it turns over"


@pytest.mark.parametrize("name", SETTINGS)
def test_names_of_combinations_are_no_names_of_loads(comm: MPI.Intracomm, name: str) -> None:
    with pytest.raises(InputError, match="means another thing in combinations"):
        sheet(comm, 2).put_load((0.0, 0.0, -1.0), name=name)
