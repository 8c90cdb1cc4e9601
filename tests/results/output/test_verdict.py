"""The verdict of a report: red with its reasons, or green."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.analysis.verification.report import Check
from crms_fenicsx.model.versions import StateWarning
from crms_fenicsx.results.design_checks import DesignCheck, Extreme
from crms_fenicsx.results.output.report.case import Case, case_of, in_order, shape_of, with_codes
from crms_fenicsx.results.output.report.page import Table, Units, Verdict
from crms_fenicsx.results.output.report.results_tables import ResultTables
from crms_fenicsx.results.output.report.verdict import governing, verdict_on
from crms_fenicsx.results.output.report.verdict import judged as judged_in
from crms_fenicsx.results.summary import Summary


@pytest.fixture(scope="module")
def case(comm: MPI.Intracomm) -> Case:
    """A square under snow with a cable and a prop, both known by their strengths."""
    scene = sheet(
        comm, 4, material=IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0, prestress=2.0), side=8.0
    )
    scene.lay_cable(Cable(EA=2e3), [(0.0, 3.0), (8.0, 4.0)], tension=3.0, name="ridge")
    prop = Bar(EA=1e3, EI=1.0, strength=50.0, curve="a")
    scene.add_bar(prop, scene.vertex_at((4.0, 6.0, 0.0)), (4.0, 6.0, -2.0), name="prop")
    scene.put_load((0.0, 0.0, -0.5), name="snow", per="plan")
    scene.set_strengths((40.0, 40.0), cables=25.0)
    solver = Solver(scene)
    before = shape_of(scene)
    solver.advance(load=1.0)
    return case_of(solver, "snow", before)


def without_bars(summary: Summary, **changed: Any) -> Summary:
    """A summary without the prop, whose strength is not enough, and without rain."""
    checks = tuple(one for one in summary.checks if one.what.startswith("fabric"))
    return replace(summary, **{"bars": {}, "hollows": (), "checks": checks} | changed)


def judged(cases: Sequence[Case], strain: float = 0.1) -> Verdict:
    return verdict_on(cases, 8.0, strain, Units("m", "kN"))


def reasons(case: Case, **limits: Any) -> str:
    verdict = judged([case], **limits)
    return " ".join(verdict.reasons)


def test_reasons_in_plain_words(case: Case) -> None:
    assert case.summary.bars["prop"].force < 0.0
    good = replace(case, summary=without_bars(case.summary))
    verdict = judged([good])
    assert verdict.look == ""
    assert [text.split(":")[0].split(" (")[0] for text in verdict.reasons] == [
        "snow", "Corners to be reinforced"
    ]  # fmt: skip
    assert verdict.text.startswith("Verified: the state passed all checks")
    one, first = replace(good, state="accidental"), replace(good, state="erection", stage=1)
    for cases, words in (
        ([good, one, one], "all 2 combinations and the base state"),
        ([one, first], "1 combination and 1 stage"),
        ([good, one, one, first, first], "all 2 combinations, 2 stages and the base state"),
    ):
        assert judged(cases).text.startswith(f"Verified: {words} passed")
    for changed, words in (
        (replace(good, volume=-0.9), "turned inside out"),
        (replace(good, volume=0.3), "collapsed: 30.0 % of its inner volume"),
        (replace(good, volume=None, turned=0.2), "20.0 % of the membrane has turned over"),
        (case, "Bar in compression beyond the limit: prop"),
    ):
        assert words in reasons(changed)
    assert "Membrane, strain beyond the limit: whole membrane" in reasons(good, strain=1e-3)


@pytest.mark.parametrize(("held", "pressure", "encloses"), [
    ("boundary", 0.0, True), ("some", 0.0, False), ("some", 0.1, True)
])  # fmt: skip
def test_a_sail_has_no_inner_volume(
    comm: MPI.Intracomm, held: str, pressure: float, encloses: bool
) -> None:
    """Nothing is closed off below a roof whose rim is free in part, unless air carries it."""
    cap = meshes.spherical_cap(comm, radius=5.0, height=2.0, size=1.5)
    scene = Scene(cap, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0), pressure="lagged")
    scene.fix("boundary" if held == "boundary" else lambda x: (x[2] < 0.1) & (x[0] < 4.5))
    if pressure:
        Solver(scene).advance(pressure=pressure)
    assert shape_of(scene).encloses == encloses


def test_what_is_not_judged_is_named(case: Case) -> None:
    """Never a green verdict without a word on members that have no design value."""
    summary = without_bars(case.summary)
    ridge = replace(summary.cables["ridge"], strength=None)
    bar = replace(case.summary.bars["prop"], utilisation=None)
    for changed, words in (
        ({"cables": {"ridge": ridge}}, "without a design value: cable ridge."),
        ({"cables": {x: replace(ridge, name=x) for x in ("A1", "A2")}}, "value: cables A1, A2."),
        ({"bars": {"prop": bar}}, "without a design value: bar prop. A bar in compression needs"),
        ({"parts": {"": replace(summary.membrane, largest={
            "strain 1": summary.membrane.largest["strain 1"]})}}, "value: the membrane."),
    ):  # fmt: skip
        one = replace(case, summary=replace(summary, **changed))
        verdict = judged([one])
        assert verdict.look == "doubtful"
        assert verdict.text.startswith("Verified, but not everything is judged: the state passed")
        assert words in " ".join(verdict.reasons), words
        red = judged([one], strain=1e-3)
        assert red.look == "failed" and words in " ".join(red.reasons)
        # strengths do not judge serviceability; without limits nothing does
        service = replace(one, state="frequent", summary=replace(one.summary, state="frequent"))
        text = " ".join(judged([service]).reasons)
        assert "design value" not in text
        bare = replace(service, summary=replace(service.summary, checks=()))
        assert "Serviceability is not judged" in " ".join(judged([bare]).reasons)


def test_rain_that_would_stand(case: Case) -> None:
    """The square sags under its snow: it holds water, which is to be checked and no failure."""
    wet = replace(case, summary=without_bars(case.summary, hollows=case.summary.hollows))
    dry = replace(wet, name="dry", summary=replace(wet.summary, hollows=()))
    verdict = judged([dry, wet])
    assert verdict.look == "doubtful"
    reason = verdict.reasons[-1]
    deepest = wet.summary.hollows[0]
    assert reason.startswith(
        f"Rain would stand in 1 of 2 states, up to {deepest.depth:.3f} m deep at"
    )
    assert "(snow)" in reason
    assert "check the roof for ponding" in reason
    red = judged([wet], strain=1e-3)
    assert red.look == "failed" and "Rain would stand in 1 of 1" in red.reasons[-1]
    unknown = judged([replace(wet, verification=None)])
    assert "Rain would stand" in " ".join(unknown.reasons)


def test_utilisation_and_what_finer_cells_change(case: Case) -> None:
    """Red above the strength; not verified where finer cells may bring it above."""
    membrane = case.summary.membrane
    used = membrane.largest["utilisation"]
    for value, change, look in ((1.2, 0.1, "failed"), (0.95, 0.1, "doubtful"), (0.95, 0.04, "")):
        largest = {**membrane.largest, "utilisation": replace(used, value=value)}
        part = replace(membrane, largest=largest, change=change)
        (check,) = without_bars(case.summary).checks
        check = replace(check, effect=value * check.limit)
        summary = without_bars(case.summary, parts={"": part}, checks=(check,))
        verdict = judged([replace(case, summary=summary)])
        text = " ".join(verdict.reasons)
        assert verdict.look == look
        assert f"the membrane is loaded to {100 * value:.1f} % of its strength" in text
        assert f"{100 * change:.1f} %" in text
        assert ("refine the mesh there" in text) == (look == "doubtful")


def test_reinforced_corners_are_told(case: Case) -> None:
    """The prop's head: its place on the plain fabric, and whether the radius was given."""
    ((name, one),) = case.summary.patches.items()
    assert (name, one.patch.reason, one.patch.at) == ("corner 1", "bar", (4.0, 6.0, 0.0))
    bare = without_bars(case.summary)
    text = " ".join(judged([replace(case, summary=bare)]).reasons)
    assert "Corners to be reinforced (corner 1): within a radius of 0.4" in text
    assert "depends on the mesh" in text and "not given" in text
    given = replace(bare, patches={name: replace(one, patch=replace(one.patch, given=True))})
    text = " ".join(judged([replace(case, summary=given)]).reasons)
    assert "Corners to be reinforced" in text and "not given" not in text
    (row,) = ResultTables([case], Units(), 8.0).patches().rows
    assert row[:2] == ("corner 1", "bar")


def test_doubtful_and_failed_checks(case: Case) -> None:
    assert case.verification is not None
    good = replace(case, summary=without_bars(case.summary))
    bad = replace(case.verification, checks=(Check("lean", 2.0, 1.0, "A1"),))
    text = reasons(replace(good, verification=bad))
    assert "no verified equilibrium: the check of lean at A1 is 2, its limit 1" in text
    doubt = StateWarning("doubtful", "the tension of 'A1' is between 1 and 2")
    told = replace(good, summary=replace(good.summary, warnings=(doubt,)))
    assert "doubtful: the tension of 'A1' is between 1 and 2." in reasons(told)
    moved = replace(good, summary=replace(good.summary, in_equilibrium=False))
    assert "changed since its last load step" in reasons(moved)
    unknown = judged([replace(good, verification=None)])
    assert (unknown.look, unknown.text) == ("doubtful", "Not verified in this run: snow")
    assert any("finer cells may change" in one for one in unknown.reasons)


def test_long_names_give_way_to_codes(case: Case) -> None:
    """In all cases together, in the order of the codes; short ones stay."""
    long = replace(case, name="ULS: 1.35 weight + 1.5 snow + 0.9 wind")
    factors = Table("F", ("Case", "Combination"), [("LC1", case.name), ("LC2", long.name)])
    for cases in ([case, long], [long, case]):
        found = with_codes(in_order(cases, factors), factors)
        assert [one.name for one in found] == ["LC1", "LC2"]
    assert with_codes([case], factors) == [case]


def test_the_sentence_on_the_mesh_names_the_case_that_governs(case: Case) -> None:
    """As tables do, also where the change in another case is larger, unless that one may exceed the
    strength; of equal cases the first in the report's order."""

    def used(name: str, value: float, change: float) -> Case:
        part = case.summary.parts[""]
        largest = {**part.largest, "utilisation": Extreme(value, (0.0, 0.0, 0.0))}
        parts = {"": replace(part, largest=largest, change=change)}
        return replace(case, name=name, summary=replace(case.summary, parts=parts))

    for cases, name in (
        ([used("A", 0.5381, 0.07), used("B", 0.5378, 0.09)], "A"),
        ([used("B", 0.5, 0.0), used("A", 0.5 + 1e-10, 0.0)], "B"),
        ([used("A", 0.95, 0.01), used("B", 0.9, 0.2)], "B"),
    ):
        (text,) = [one for one in judged(cases).reasons if "finer cells" in one]
        assert text.startswith(f"{name}: the membrane is loaded to")


def test_reasons_are_grouped_by_limit_state_and_member(case: Case) -> None:
    """One sentence for what is beyond its limit in many combinations, the worst first."""
    ridge = case.summary.cables["ridge"]
    cables = {f"A{k}": replace(ridge, name=f"A{k}", largest=1.0 * k) for k in range(1, 11)}

    def loaded(name: str, state: str, factor: float) -> Case:
        own = {k: replace(one, largest=factor * one.largest) for k, one in cables.items()}
        checks = [DesignCheck("cable", name, one.largest, 8.0) for name, one in own.items()]
        checks = (*without_bars(case.summary).checks, *checks) if state == "ULS" else ()
        summary = without_bars(case.summary, cables=own, checks=checks)
        return replace(case, name=name, state=state, summary=summary)

    every = [loaded("LC1", "ULS", 1.0), loaded("LC2", "ULS", 1.2), loaded("LC3", "frequent", 9.0)]
    verdict = judged(every)
    (sentence,) = (text for text in verdict.reasons if "Cable tension" in text)
    assert sentence == (
        "ULS: Cable tension, 4 of 10 beyond the limit: A10 150.0 % (LC2), A9 135.0 % (LC2), "
        "A8 120.0 % (LC2), A7 105.0 % (LC2) of its strength; 12.00 kN, limit 8.000 kN."
    )
    rows = governing(judged_in(every, 0.1))
    assert [(one.state, one.what, one.member) for one in rows] == [
        ("ULS", "fabric", ""), ("ULS", "strain", ""), ("ULS", "cable", "A10"),
        ("frequent", "strain", ""),
    ]  # fmt: skip
    assert rows[2].share == pytest.approx(1.5) and rows[2].case == "LC2"


def test_limits_in_service_are_part_of_the_verdict(case: Case) -> None:
    """Least values are below their limit, however far, and told with their place."""
    limits = (
        DesignCheck("deflection", "", 0.8, 0.4),
        DesignCheck("slope", "", 0.0, 2.0, (1.0, 2.0, 0.5)),
        DesignCheck("ponding", "", 0.0, 0.1),
    )
    summary = without_bars(case.summary, checks=limits)
    text = " ".join(judged([replace(case, state="quasi-permanent", summary=summary)]).reasons)
    assert (
        "quasi-permanent: Deflection beyond the limit: whole membrane 200.0 % (snow) of the limit; "
        "0.8000 m, limit 0.4000 m."
    ) in text
    assert (
        "Least slope below the limit: whole membrane (snow); 0° at x; y; z = 1.00; 2.00; 0.50, "
        "limit 2.000°."
    ) in text
    assert "Ponding" not in text
