"""A script that makes the same form goes on from a checkpoint, its cables and bars laid before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from form_meshes import SIDES, sail
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, OrthotropicMembrane, Scene, Solver
from crms_fenicsx.design.form_finding import FormBar, FoundForm

FABRIC = OrthotropicMembrane(E1=1000.0, E2=700.0, G12=40.0, nu21=0.2, thickness=1.0)
STEEL, TIE = Cable(EA=5000.0), Bar(EA=1e4, tension_only=True)
RIDGE = [(2.5, 2.5), (7.5, 7.0)]
LOW = "front right"


@pytest.fixture
def form(comm: MPI.Intracomm) -> FoundForm:
    return sail(comm, 2.5, lift=3.0, tension=25.0)


def tied(form: FoundForm) -> Scene:
    """One of its low points hangs on a tie along the reaction."""
    pull = form.reactions[LOW]
    foot = np.array([10.0, 0.0, 0.0]) + pull / np.linalg.norm(pull)
    scene = form.scene(FABRIC, STEEL, bars=[FormBar(LOW, TIE, foot, "tie")])
    scene.put_load((0.0, 0.0, -0.3), name="snow", per="plan")
    return scene


def folder_of(comm: MPI.Intracomm, path: Path) -> Path:
    return Path(comm.bcast(str(path)))


@pytest.mark.ranks
def test_load(comm: MPI.Intracomm, form: FoundForm, tmp_path: Path) -> None:
    """Cables and bars of the same name stay the objects; others come from the checkpoint."""
    folder = folder_of(comm, tmp_path)
    one = Solver(tied(form))
    one.scene.lay_cable(STEEL, RIDGE, tension=2.0, name="ridge")
    one.advance(load=1.0, L0={one.scene.cable("front"): 0.99 * one.scene.cable("front").L0})
    one.save(folder / "state")
    scene = tied(form)
    front, tie = scene.cable("front"), scene.bar("tie")
    scene.lay_cable(Cable(EA=77.0), RIDGE[::-1], hold="sleeve", name="ridge")
    scene.lay_cable(STEEL, [(2.0, 4.0), (4.0, 8.0)], name="gone")
    other = Solver(scene)
    other.load(folder / "state")
    assert [cable.name for cable in scene.cables] == [*SIDES, "ridge"]
    assert front is scene.cable("front") and tie is scene.bar("tie")
    ridge = scene.cable("ridge")
    assert (ridge.cable.EA, ridge.hold) == (5000.0, "outside")
    assert np.array_equal(scene.u.x.array, one.scene.u.x.array) and scene.factors == {"snow": 1.0}
    for solver in (one, other):
        solver.advance(load=0.5, L0={solver.scene.cable("ridge"): 0.995 * ridge.L0})
    for was, now in zip(one.scene.cables, scene.cables, strict=True):
        assert now.tension == pytest.approx(was.tension, rel=1e-9)
    assert tie.force == pytest.approx(one.scene.bar("tie").force, rel=1e-9)
    assert scene.energy == pytest.approx(one.scene.energy, rel=1e-12)


def test_resume(comm: MPI.Intracomm, form: FoundForm, tmp_path: Path) -> None:
    folder = folder_of(comm, tmp_path)
    scenes, seconds = list[Scene](), list[float]()
    for resume in (False, True):
        scene = tied(form)
        tie = scene.bar("tie")
        solver = Solver(scene, results=folder / "out", resume=resume)
        solver.advance()
        ridge = scene.lay_cable(STEEL, RIDGE, tension=2.0, name="ridge")
        solver.advance(load=1.0)
        if resume:  # what was done is not computed again
            assert tie is scene.bar("tie") and ridge is scene.cable("ridge")
            assert [step.seconds for step in solver.steps] == comm.bcast(seconds)
            assert np.array_equal(scene.u.x.array, scenes[0].u.x.array)
            assert ridge.tension == scenes[0].cable("ridge").tension
        seconds = [step.seconds for step in solver.steps]
        scenes.append(scene)
