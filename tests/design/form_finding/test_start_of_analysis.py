"""What was found is in equilibrium as a scene: the first load step moves nothing."""

from __future__ import annotations

import numpy as np
import pytest
from form_meshes import CORNERS, SIDES, cylinder, nodes, order, sail
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    UflMembrane,
    meshes,
)
from crms_fenicsx.design.form_finding import FormCable, FoundForm, find_form

FOIL = IsotropicMembrane(E=1000.0, nu=0.3, thickness=1.0)
FABRIC = OrthotropicMembrane(E1=1000.0, E2=700.0, G12=40.0, nu21=0.2, thickness=1.0)
STEEL = Cable(EA=5000.0)


def fabric_saddle(comm: MPI.Intracomm, ranks: object = None) -> FoundForm:
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.0, ranks=ranks)  # type: ignore[arg-type]
    return find_form(
        mesh, (4.0, 2.0), fixed=["boundary"], warp=(1.0, 1.0, 0.0),
        lifted={"boundary": lambda x: np.stack([0 * x[0], 0 * x[0],
                0.08 * (x[0] - 5.0) * (x[1] - 5.0)])},
    )  # fmt: skip


def dome(comm: MPI.Intracomm) -> FoundForm:
    return find_form(meshes.circle(comm, 10.0, 1.5), 2.0, fixed=["boundary"], rise=4.0)


def ridge(comm: MPI.Intracomm) -> FoundForm:
    """A cable inside, between two points of the rim that are lifted with it."""
    n = 12
    grid = np.linspace(0.0, 12.0, n + 1)
    points = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    a = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = np.stack([np.stack([a, a + 1, a + n + 2], 1), np.stack([a, a + n + 2, a + n + 1], 1)])
    middle = np.flatnonzero(points[:, 1] == 6.0)
    mesh = meshes.from_arrays(
        comm, points, cells.reshape(-1, 3), edges={"ridge": np.stack([middle[:-1], middle[1:]], 1)}
    )
    return find_form(
        mesh, 2.0, fixed=["boundary"], cables=[FormCable("ridge", length=12.1)],
        lifted={"boundary": lambda x: np.stack([0 * x[0], 0 * x[0],
                np.maximum(0.0, 3.0 - 0.5 * np.abs(x[1] - 6.0))])},
    )  # fmt: skip


FORMS = {
    "catenoid": lambda comm: find_form(cylinder(comm, 24, 6, 10.0, 12.0), 2.0, fixed=["boundary"]),
    "hypar": lambda comm: sail(comm, 1.0, lift=3.0, structured=False, tension=25.0),
    "fabric": fabric_saddle,
    "dome": dome,
    "ridge": ridge,
}


@pytest.mark.ranks
@pytest.mark.parametrize("name", FORMS)
def test_the_first_step_moves_nothing(comm: MPI.Intracomm, name: str) -> None:
    """And a load on it is carried, also on a membrane that is no stiffer than its prestress."""
    form = FORMS[name](comm)
    for material in (FABRIC, OrthotropicMembrane(2.0, 2.0, 1.0, 0.0, 1.0)):
        scene = form.scene(material, STEEL if form.cables else None)
        solver = Solver(scene)
        step = solver.advance()
        moved = comm.allreduce(float(np.abs(scene.u.x.array).max(initial=0.0)), op=MPI.MAX)
        assert moved < 1e-8 * scene.membrane.size
        assert step.verification is not None and step.verification.passed
        for cable in scene.cables:
            assert cable.hold == ("sleeve" if cable.name == "ridge" else "pocket")
            assert cable.tension == pytest.approx(form.tensions[cable.name], rel=1e-9)
        assert scene.pressure == form.pressure
    scene = form.scene(FABRIC, STEEL if form.cables else None)
    scene.put_load((0.0, 0.0, -0.05), name="snow", per="plan")
    solver = Solver(scene)
    step = solver.advance(load={"snow": 1.0})
    assert step.verification is not None and step.verification.passed


def test_the_stresses_are_those_prescribed(comm: MPI.Intracomm) -> None:
    """With the residual ones they balance; alone they leave a part that falls with the mesh."""
    sizes, moves = (2.0, 1.0), []
    for size in sizes:
        form = sail(comm, size, lift=3.0, tension=25.0)
        scene = Scene(form.mesh, IsotropicMembrane(E=1000.0, nu=0.3, thickness=1.0, prestress=2.0))
        for corner in CORNERS:
            scene.fix(corner)
        for cable in form.cables:
            scene.lay_cable(STEEL, cable.path, tension=cable.tension, measured_on="facets")
        Solver(scene).advance()
        own = float(np.abs(scene.u.x.array).max(initial=0.0))
        moves.append(comm.allreduce(own, op=MPI.MAX))
        assert form.deviation < 2e-3 * size
    assert 1e-8 < moves[-1] < 1e-3
    assert order(sizes, moves) > 0.8


@pytest.mark.ranks
def test_forms_do_not_depend_on_the_ranks(comm: MPI.Intracomm) -> None:
    """Also where some have no cell; groups are those of the start mesh."""

    def alone(x: np.ndarray) -> np.ndarray:
        return np.full(len(x), comm.size - 1)

    form, other = fabric_saddle(comm), fabric_saddle(comm, alone)
    assert other.area == pytest.approx(form.area, rel=1e-12)
    assert other.deviation == pytest.approx(form.deviation, rel=1e-6)
    assert form.iterations == other.iterations
    assert {*form.mesh.edges} == {"boundary", *SIDES}
    assert {*form.mesh.points} == {*CORNERS}
    x = nodes(form)
    start = np.concatenate(comm.allgather(
        meshes.rectangle(comm, 10.0, 10.0, 1.0).mesh.geometry.x
    ))  # fmt: skip
    assert np.abs(start[:, 2]).max() == 0.0 and np.abs(x[:, 2]).max() == pytest.approx(2.0)
    Solver(other.scene(FABRIC)).advance()


def test_materials_that_do_not_fit(comm: MPI.Intracomm) -> None:
    saddle, hypar = fabric_saddle(comm), sail(comm, 2.0, tension=25.0)
    for call, match in (
        (lambda: saddle.scene(FOIL), "isotropic, but has the section forces"),
        (lambda: saddle.scene(UflMembrane(lambda E: E[0, 0] ** 2 + E[1, 1] ** 2 + E[0, 1] ** 2)),
         "prestress cannot be set"),
        (lambda: saddle.scene({"roof": FABRIC}), "no part 'roof'"),
        (lambda: hypar.scene(FOIL), r"cable 'front' is of type NoneType"),
        (lambda: hypar.scene(FOIL, {"front": STEEL}), "cable 'right' has no Cable"),
        (lambda: hypar.scene(FOIL, {"top": STEEL}), "no cable 'top'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=match):
            call()
