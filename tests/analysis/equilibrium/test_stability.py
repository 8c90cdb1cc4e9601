"""Bars, joints and ponds in equilibria that are not stable, which are told and can be refused."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from cabled_square import sheet
from mpi4py import MPI

from crms_fenicsx import (
    Bar,
    ConvergenceError,
    InstabilityWarning,
    IsotropicMembrane,
    Joint,
    PondWarning,
    Scene,
    Solver,
    Step,
)

FABRIC = IsotropicMembrane(E=1e3, nu=0.3, thickness=1.0, prestress=1.0)


def square(comm: MPI.Intracomm) -> Scene:
    return sheet(comm, 4, material=FABRIC, side=4.0)


def mast(scene: Scene, guys: int = 0, slack: float = 0.0, weight: float = 50.0) -> Joint:
    """A loaded mast, with guys around it."""
    top = scene.add_joint((20.0, 0.0, 6.0), name="top")
    scene.add_bar(Bar(1e5), (20.0, 0.0, 0.0), top, name="mast")
    for k in range(guys):
        x, y = 20.0 + 6.0 * np.cos(2 * np.pi * k / guys), 6.0 * np.sin(2 * np.pi * k / guys)
        guy = Bar(1e4, tension_only=True)
        scene.add_bar(guy, (x, y, 0.0), top, L0=72**0.5 * (1 + slack), name=f"guy {k + 1}")
    scene.put_joint_load({top: (0.0, 0.0, -weight)}, name="weight")
    return top


def advanced(solver: Solver, kind: type[Warning] = InstabilityWarning, **loads: object) -> Step:
    """The step, in which there is one warning of a kind and no other."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        step = solver.advance(**loads)  # type: ignore[arg-type]
    kinds = [one.category for one in caught]
    assert kinds == ([kind] if solver.comm.rank == 0 else [])
    assert len(step.warnings) == 1
    return step


@pytest.mark.ranks
def test_a_mast_without_guys(comm: MPI.Intracomm) -> None:
    scene = square(comm)
    mast(scene)
    solver = Solver(scene)
    assert "nothing holds 'top' in the direction" in advanced(solver, load=0.0).warnings[0].text
    step = advanced(solver, load=1.0)
    assert "'mast', under a compression of 50, gives way at 'top'" in step.warnings[0].text
    assert "add guys" in step.warnings[0].text
    assert step.verification is not None
    assert step.verification.passed
    assert step.verification.verdict == "equilibrium, but instability"
    assert scene.warnings == step.warnings


def test_masts_that_hang_or_have_guys_are_stable(comm: MPI.Intracomm) -> None:
    """Guys just taut hold, and the shortening of the mast does not matter."""
    scene = square(comm)
    mast(scene)
    solver = Solver(scene)
    solver.advance(load=-1.0)
    for guys in (3, 4, 5):
        for slack in (0.0, -1e-3):
            scene = square(comm)
            mast(scene, guys, slack, weight=10.0)
            solver = Solver(scene)
            solver.advance()
            solver.advance(load=1.0)
            assert scene.warnings == ()


def test_slack_guys_are_named(comm: MPI.Intracomm) -> None:
    scene = square(comm)
    mast(scene, 4, 1e-2)
    step = advanced(Solver(scene), load=1.0)
    assert "tighten 'guy 1', 'guy 2', 'guy 3', 'guy 4'" in step.warnings[0].text


def test_struts_in_a_line(comm: MPI.Intracomm) -> None:
    """Also where one ends at the membrane, so that all second derivatives are needed."""
    for foot in ((20.0, 0.0, 0.0), (2.0, 2.0, 0.0)):
        scene = square(comm)
        end = foot if foot[0] > 4.0 else scene.vertex_at(foot)
        joint = scene.add_joint((foot[0], foot[1], 2.0), name="knee")
        bars = [
            scene.add_bar(Bar(1e4), end, joint),
            scene.add_bar(Bar(1e4), joint, (*foot[:2], 4.0)),
        ]
        step = advanced(Solver(scene), L0={bar: 2.05 for bar in bars})
        assert "gives way at 'knee'" in step.warnings[0].text


def test_refused_or_ignored(comm: MPI.Intracomm) -> None:
    scene = square(comm)
    mast(scene)
    solver = Solver(scene, stability="refuse")
    with pytest.raises(ConvergenceError, match=r"'mast', under a compression of .*, gives way"):
        solver.advance(load=1.0)
    assert scene.factors["weight"] == 0.0
    solver.advance(load=-1.0)
    Solver(scene, stability="ignore").advance(load=1.0)


@pytest.mark.ranks
def test_a_prop_under_a_sheet(comm: MPI.Intracomm) -> None:
    """It stands while the sheet holds its head: N / l is less than the stiffness sideways."""
    soft = IsotropicMembrane(E=1e-3, nu=0.3, thickness=1.0, prestress=1.0, wrinkling=False)
    scene = sheet(comm, 4, material=soft, side=4.0)
    scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
    head = scene.vertex_at((2.0, 2.0, 0.0))
    prop = scene.add_bar(Bar(1e5), (2.0, 2.0, -1.0), head, name="prop")
    solver = Solver(scene)
    solver.advance(load=0.1)
    assert -1.0 < prop.force < 0.0
    step = advanced(solver, load=5.0)
    assert "'prop', under a compression of" in step.warnings[0].text
    assert "the vertex at (2, 2, 0)" in step.warnings[0].text


@pytest.mark.ranks
def test_water_at_the_level_of_a_flat_roof(comm: MPI.Intracomm) -> None:
    """Dry, but the least sag draws water; a hair below the roof it does not."""
    for level, kind in ((0.0, PondWarning), (-1e-3, None)):
        scene = square(comm)
        scene.put_pond(10.0, level=level, name="puddle")
        solver = Solver(scene)
        if kind is None:
            solver.advance(load=1.0)
        else:
            step = advanced(solver, kind, load=1.0)
            assert "the equilibrium under 'puddle' is not stable" in step.warnings[0].text
        assert scene.ponds[0].level == level
        assert scene.ponds[0].volume == 0.0


def test_scenes_without_bars_and_ponds_are_not_looked_at(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor are frames without compression factorised."""
    monkeypatch.setattr("crms_fenicsx.analysis.equilibrium.instability.ExactTangent", None)
    scene = square(comm)
    solver = Solver(scene)
    solver.advance(pressure=0.1)
    top = scene.add_joint((2.0, 2.0, 3.0))
    corner = scene.vertex_at((0.0, 0.0, 0.0))
    scene.add_bar(Bar(1e3, tension_only=True), corner, top, L0=5.0)
    for x, y in ((0.0, 0.0), (4.0, 0.0), (2.0, 4.0)):
        scene.add_bar(Bar(1e3, tension_only=True), (x, y, 6.0), top)
    scene.put_joint_load({top: (0.0, 0.0, -1.0)})
    solver.advance(load=1.0)
