"""Reactions of forms, and the masts and guys that take the place of supports."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import advanced
from form_meshes import CORNERS, order, sail
from mpi4py import MPI

from crms_fenicsx import Bar, Cable, InputError, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.design.form_finding import FormBar, FormCable, FoundForm, find_form
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap

FABRIC = OrthotropicMembrane(E1=1000.0, E2=700.0, G12=40.0, nu21=0.2, thickness=1.0)
STEEL = Cable(EA=5000.0)
MAST, GUY = Bar(EA=2e5), Bar(EA=1e4, tension_only=True)
HIGH, LOW = CORNERS[::2], CORNERS[1::2]
PLACES = dict(
    zip(CORNERS, np.array([[0, 0, 3], [10, 0, 0], [10, 10, 3], [0, 10, 0.0]]), strict=True)
)


def stayed(form: FoundForm) -> list[FormBar]:
    """A mast and two guys at each high corner, a tie along the reaction at each low one."""
    bars = []
    for corner in HIGH:
        out = np.sign(PLACES[corner][:2] - 5.0)
        mast, one, other = (
            (*(PLACES[corner][:2] + out * away), 0.0) for away in ((-0.5, -0.2), (3, 0), (0, 4))
        )
        bars += [
            FormBar(corner, MAST, mast, name=f"mast {corner}"),
            FormBar(corner, GUY, one),
            FormBar(corner, GUY, other),
        ]
    for corner in LOW:
        force = form.reactions[corner]
        bars.append(FormBar(corner, GUY, PLACES[corner] + 0.5 * force / np.linalg.norm(force)))
    return bars


def test_reactions_of_a_flat_sail(comm: MPI.Intracomm) -> None:
    """Arcs of radius T / s = 10 over chords of 10 meet the sides at 30 degrees: 2 T cos 15."""
    sizes, errors = (2.0, 1.0, 0.5), []
    for size in sizes:
        form = sail(comm, size, tension=20.0)
        for corner, force in form.reactions.items():
            out = np.sign(PLACES[corner][:2] - 5.0) / np.sqrt(2.0)
            assert force[:2] @ out == pytest.approx(np.linalg.norm(force), rel=1e-3)
        errors.append(np.linalg.norm(form.reactions["front left"]) - 40.0 * np.cos(np.pi / 12))
    assert abs(errors[-1]) < 0.02
    assert order(sizes, errors) > 1.7


@pytest.mark.ranks
def test_reactions_balance_cables_film_and_pressure(comm: MPI.Intracomm) -> None:
    """Those of a dome carry its pressure; of a tent each carries what a held scene tells."""
    dome = find_form(meshes.circle(comm, 10.0, 2.0), 2.0, fixed=["boundary"], rise=4.0)
    plan = comm.allreduce(_plan_area(dome))
    assert dome.reactions["boundary"] == pytest.approx([0, 0, -dome.pressure * plan], abs=1e-9)

    form = sail(comm, 1.0, lift=3.0, structured=False, tension=25.0)
    solver = advanced(Solver(scene := form.scene(FABRIC, STEEL)))
    for corner, place in PLACES.items():
        found = solver.reactions(corner)
        assert form.reactions[corner] == pytest.approx(found.total, abs=1e-8)
        force = found.membrane.copy()
        for cable in form.cables:
            laid = scene.cable(cable.name)
            for end, at in ((laid.start, cable.path[0]), (laid.end, cable.path[-1])):
                if np.linalg.norm(at - place) < 1e-9:
                    force += end.reaction
        assert form.reactions[corner] == pytest.approx(force, abs=1e-8)
    forces = np.array([form.reactions[corner] for corner in CORNERS])
    moment = np.cross(np.array(list(PLACES.values())), forces).sum(axis=0)
    assert np.abs(forces.sum(axis=0)).max() < 1e-9 and np.abs(moment).max() < 1e-8


def _plan_area(form: FoundForm) -> float:
    mesh = form.mesh.mesh
    n = mesh.topology.index_map(2).size_local
    x = mesh.geometry.x[geometry_dofmap(mesh)[:n]]
    return float(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])[:, 2].sum() / 2)


def test_reactions_of_a_half_in_its_plane_of_symmetry(comm: MPI.Intracomm) -> None:
    """A half of a flat sheet pulls on the plane with s times its width, along x alone."""
    half = find_form(
        meshes.rectangle(comm, 4.0, 6.0, 1.0), 2.0, fixed={"left": "xz", "right": "xyz",
        "front": "yz", "back": "yz"},
    )  # fmt: skip
    # of the first row of cells a part goes into the corners
    assert half.reactions["left"] == pytest.approx([-12.0, 0.0, 0.0], abs=1e-9)
    assert half.reactions["front"] == pytest.approx([0.0, -8.0, 0.0], abs=1e-9)


@pytest.mark.ranks
def test_the_first_step_moves_nothing(comm: MPI.Intracomm) -> None:
    form = sail(comm, 1.0, lift=3.0, structured=False, tension=25.0)
    scene = form.scene(FABRIC, STEEL, bars=stayed(form))
    assert not scene.held.any()
    solver = Solver(scene)
    step = solver.advance()
    own = float(np.abs(scene.u.x.array).max(initial=0.0))
    assert comm.allreduce(own, op=MPI.MAX) < 1e-8 * scene.membrane.size
    assert step.verification is not None and step.verification.passed
    for corner in CORNERS:
        place = PLACES[corner]
        bars = [b for b in scene.bars if np.linalg.norm(b.points[1] - place) < 1e-9]
        assert len(bars) == (3 if corner in HIGH else 1)
        pull = sum(bar.pull(bar.end) for bar in bars)
        assert pull == pytest.approx(form.reactions[corner], abs=1e-7)
    assert scene.bar("mast front left").force < -50.0
    scene.put_load((0.0, 0.0, -0.3), name="snow", per="plan")
    step = solver.advance(load={"snow": 1.0})
    assert step.verification is not None and step.verification.passed
    top = scene.bar("mast front left").points[1]
    assert 1e-4 < np.linalg.norm(top - PLACES["front left"]) < 0.5


def test_forces_can_be_given(comm: MPI.Intracomm) -> None:
    """A fourth bar has the force that is given, and the others balance the rest."""
    form = sail(comm, 2.0, lift=3.0, tension=25.0)
    more = FormBar("front left", GUY, (-2.0, -2.0, 0.0), name="more", force=30.0)
    scene = form.scene(FABRIC, STEEL, bars=[*stayed(form), more])
    assert scene.bar("more").force == pytest.approx(30.0)
    Solver(scene).advance()
    own = float(np.abs(scene.u.x.array).max(initial=0.0))
    assert comm.allreduce(own, op=MPI.MAX) < 1e-8 * scene.membrane.size


def test_bars_that_cannot_hold(comm: MPI.Intracomm) -> None:
    form = sail(comm, 2.0, lift=3.0, tension=25.0)
    corner, bars = "front left", stayed(form)
    mast, guy = bars[0], bars[1]
    foot = (-2.0, -2.0, 0.0)

    def scene(*given: object) -> Scene:
        return form.scene(FABRIC, STEEL, bars=given)  # type: ignore[arg-type]

    for call, match in (
        (lambda: scene(mast, guy), r"bars at 'front left' leave .* of its reaction"),
        (lambda: scene(*bars, FormBar(corner, GUY, foot)), "forces of 4 bars .* do not follow"),
        (lambda: scene(mast, guy, FormBar(corner, GUY, (5.0, 5.0, 0.0), "in")),
         "the force -.*, which a guy cannot have"),
        (lambda: scene(FormBar(corner, Bar(1.0), mast.foot), *bars[1:]),
         "which a bar of EA = 1 cannot have"),
        (lambda: scene(FormBar(corner, MAST, PLACES[corner])), "has its foot at"),
        (lambda: scene(FormBar("middle", MAST, foot)), "'middle', which is not a support"),
        (lambda: scene(FormBar("front", MAST, foot)), "'front', which is not a support"),
        (lambda: scene("front left"), "a bar is of type str"),
        (lambda: form.scene(FABRIC, STEEL, bars="front left"), "not a valid list; write"),
        (lambda: form.scene(FABRIC, STEEL, bars=[mast, guy, bars[2], bars[0]]), "do not follow"),
        (lambda: FormBar(corner, STEEL, foot), "bar is of type Cable"),  # type: ignore[arg-type]
        (lambda: FormBar(corner, GUY, (1.0, 2.0)), "foot of a bar of 'front left' = "),
        (lambda: FormBar(corner, GUY, foot, "g", np.inf), "force of 'g' = inf is not finite"),
        (lambda: FormBar(corner, GUY, foot, "g", -1.0), "the force -1, which a guy cannot have"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=match):
            call()


def test_points_that_other_supports_hold(comm: MPI.Intracomm) -> None:
    """Or supports of more than one vertex take no bars."""
    form = find_form(
        meshes.rectangle(comm, 6.0, 6.0, 2.0), 2.0,
        fixed=["left", "front left", "back right", "front right"],
        cables=[FormCable(side, tension=20.0) for side in ("front", "right", "back")],
    )  # fmt: skip
    for group, match in (("front left", "another support holds"), ("left", "has 4 vertices")):
        with pytest.raises(InputError, match=match):
            form.scene(FABRIC, STEEL, bars=[FormBar(group, MAST, (1.0, 2.0, -3.0))])
