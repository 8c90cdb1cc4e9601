"""All laws of the paper at once, on meshes: against its equations, written by hand in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from written_paper import WrittenPaper, isotropic, orthotropic

from crms_fenicsx import (
    Cable,
    Friction,
    IsotropicMembrane,
    LaidCable,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)

MU = 5.0
THICKNESS = 0.08
ISOTROPIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=THICKNESS, wrinkling=False)
FABRIC = OrthotropicMembrane(
    E1=400.0, E2=200.0, G12=90.0, nu21=0.2, thickness=THICKNESS, warp=(1.0, 0.4, 0.0),
    wrinkling=False,
)  # fmt: skip
MODEL_3 = OrthotropicMembrane(
    E1=1394.0, E2=140.0, G12=12.0, nu21=0.065, thickness=1.0, warp=(0.0, 1.0, 0.0), wrinkling=False
)
LAWS = {
    ISOTROPIC: (THICKNESS * isotropic(300.0, 0.25), None),
    FABRIC: (THICKNESS * orthotropic(400.0, 200.0, 90.0, 0.2), (1.0, 0.4)),
    MODEL_3: (orthotropic(1394.0, 140.0, 12.0, 0.065), (0.0, 1.0)),
}
EXACT = 1e-7
"""Of the largest force of a node."""

pytestmark = pytest.mark.filterwarnings("ignore::crms_fenicsx.FrictionWarning")
"""Of points that friction holds: the written-out paper has none."""


def built(mesh: meshes.MembraneMesh, material, friction: float, path, EA: float, fixed, **options):
    """A scene, its cable and its hand-written twin."""
    scene = Scene(mesh, material, strain="step", pressure="step", literal_penalty=MU)
    for name in fixed:
        scene.fix(name)
    rubs = Friction(friction, law="step", tolerance=1e-3) if friction else 0.0
    cable = scene.lay_cable(Cable(EA, law="step", friction=rubs), path, **options)
    D, warp = LAWS[material]
    return scene, cable, WrittenPaper(scene, cable, D, mu=MU, friction=friction, warp=warp)


def path_of(cable: LaidCable) -> list[object]:
    """What its nodes lie on."""
    return [node.point and node.point.support for node in cable.state.nodes]


def held(cable: LaidCable) -> list[int]:
    """Nodes that friction held in the last step."""
    grip = cable.state.law.lateral
    if grip is None:
        return []
    still = dict(zip(grip.supports, (grip.moving == 0.0) & (grip.bounds > 0.0), strict=True))
    return [k for k, support in enumerate(path_of(cable)) if still.get(support)]


def check(cable: LaidCable, twin: WrittenPaper, pressure: float = 0.0) -> None:
    """The package's state is the paper's."""
    left, size = twin.end_step(pressure, held(cable))
    assert cable.tension == pytest.approx(twin.tension, rel=1e-9)
    assert np.abs(left).max() < EXACT * size


@pytest.mark.ranks
@pytest.mark.parametrize("friction", [0.0, 0.7])
@pytest.mark.parametrize("pressure", [0.0, 0.004])
@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC], ids=["isotropic", "fabric"])
def test_five_cells_a_side(comm: MPI.Intracomm, material, pressure: float, friction: float) -> None:
    """Ends that go down and then aside; with pressure, the cable is laid with a tension, too."""
    mesh = meshes.rectangle(comm, 100.0, 100.0, 20.0, structured=True)
    laid = {"tension": 20.0} if pressure else {}
    scene, cable, twin = built(
        mesh, material, friction, [(-10, 47, 0), (110, 52, 0)], 32000.0, ("front", "back"), **laid
    )
    solver, path = Solver(scene, rtol=1e-11), path_of(cable)
    for step in range(5):
        now = pressure * (step + 1) / 5
        solver.advance(pressure=now, move={cable: (0.0, 0.3 * (step > 1), -2.0)})
        assert path_of(cable) == path
        check(cable, twin, now)
    assert not friction or 0 < len(held(cable)) < 8  # of eleven


@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC], ids=["isotropic", "fabric"])
@pytest.mark.parametrize("lift", [2.0, -2.0])
def test_model_1(comm: MPI.Intracomm, material, lift: float) -> None:
    """One element in six steps, with pressure in the last three."""
    corners = [(0.0, 0.0), (25.0, 60.0), (70.0, 0.0)]
    mesh = meshes.from_arrays(comm, corners, [(0, 1, 2)], point_groups={"corners": [0, 1, 2]})
    path = [(-20.0, 30.0, 0.0), (90.0, 24.0, 0.0)]
    scene, cable, twin = built(mesh, material, 0.0, path, 32000.0, ("corners",), hold="sleeve")
    solver = Solver(scene, rtol=1e-11)
    for step in range(6):
        pressure = 0.01 * max(step - 2, 0)
        solver.advance(pressure=pressure, move={cable: (0.0, 0.0, lift)})
        check(cable, twin, pressure)


@pytest.mark.ranks
@pytest.mark.parametrize("friction", [0.0, 0.7])
def test_model_3(comm: MPI.Intracomm, friction: float) -> None:
    """On coarse cells: pressed down in five steps, dragged to the side as far as its path stays."""
    mesh = meshes.rectangle(comm, 100.0, 100.0, 100.0 / 7, structured=True)
    scene, cable, twin = built(
        mesh, MODEL_3, friction, [(-10.0, 50.0, 0.0), (110.0, 50.0, 0.0)], 47638.0,
        ("front", "back"),
    )  # fmt: skip
    solver, path, still = Solver(scene, rtol=1e-11), path_of(cable), []
    for step in range(10):
        solver.advance(move={cable: (0.0, 0.0, -2.0) if step < 5 else (0.0, 1.0, 0.0)})
        assert path_of(cable) == path
        check(cable, twin)
        still.append(len(held(cable)))
    assert not friction or still[-1] < still[5]  # it slips from its ends inwards
