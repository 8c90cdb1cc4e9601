"""Cables along free edges of the membrane: they are part of these edges."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import Cable, IsotropicMembrane, Scene, Solver, meshes

CORNERS = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]


def sail(comm: MPI.Intracomm, lift: float = 0.0, structured: bool = True) -> Scene:
    """A prestressed square whose corners are held, two of them lifted: a hypar."""
    mesh = meshes.rectangle(comm, 10.0, 10.0, 1.0, structured=structured)
    scene = Scene(mesh, IsotropicMembrane(E=50.0, nu=0.3, thickness=1.0, prestress=1.0))
    x, y, _ = scene.V.tabulate_dof_coordinates().T
    scene.u.x.array.reshape(-1, 3)[:, 2] = lift * (x * (10 - y) + y * (10 - x)) / 100
    scene.fix(lambda x: (np.abs(x[0] - 5) > 4.999) & (np.abs(x[1] - 5) > 4.999))
    return scene


def with_edge_cables(scene: Scene, **given: bool) -> Solver:
    for k in range(4):
        path = [CORNERS[k], CORNERS[(k + 1) % 4]]
        scene.lay_cable(Cable(1000.0), path, tension=12.0, name=f"edge {k}", **given)
    return Solver(scene)


@pytest.mark.parametrize("structured", [True, False])
def test_an_edge_cable_needs_no_word(comm: MPI.Intracomm, structured: bool) -> None:
    """The hypar under snow is the same as with sleeves, and cables stay on the edges."""
    found = []
    for given in ({}, {"hold": "sleeve"}):
        scene = sail(comm, 3.0, structured)
        solver = with_edge_cables(scene, **given)
        solver.advance()
        scene.put_load((0.0, 0.0, -0.1), name="snow", per="plan")
        solver.advance(load={"snow": 1.0})
        assert all(cable.hold == "pocket" for cable in scene.cables)
        for cable in scene.cables:
            before = cable.state.reference_positions
            before = before[np.isfinite(before[:, 0])]
            assert len(before) >= 11
            on_edge = [np.abs(before[:, i] - side).max() for i in (0, 1) for side in (0.0, 10.0)]
            assert min(on_edge) < 1e-9
            assert not cable.state.lifted.any()
        found.append([scene.energy, *(cable.tension for cable in scene.cables)])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)
    assert min(found[0][1:]) > 12.0


def test_other_cables_can_lift_off(comm: MPI.Intracomm) -> None:
    """Across the membrane, on a line of its mesh, on a held edge, and partly on a free one."""
    scene = sail(comm)
    scene.fix("left")
    paths = {
        "across": [(0.0, 3.3), (10.0, 4.4)],
        "inner line": [(0.0, 5.0), (10.0, 5.0)],
        "held": [(0.0, 0.0), (0.0, 10.0)],
        "leaves": [(0.0, 0.0), (5.0, 0.0), (10.0, 3.3)],
    }
    for name, path in paths.items():
        assert scene.lay_cable(Cable(1000.0), path, name=name).hold == "outside", name
    assert scene.lay_cable(Cable(1000.0), [(0.0, 0.0), (10.0, 0.0)], name="free").hold == "pocket"


@pytest.mark.ranks
def test_an_edge_cable_to_masts(comm: MPI.Intracomm) -> None:
    """Its anchors lie beyond the corners; the sail's corners hang on cables alone."""
    scene = Scene(
        meshes.rectangle(comm, 10.0, 10.0, 1.0, structured=True),
        IsotropicMembrane(E=50.0, nu=0.3, thickness=1.0, prestress=1.0),
    )
    scene.fix("left")
    scene.fix("right")
    cable = scene.lay_cable(
        Cable(1000.0), [(-2.0, -0.5, 0.0), (0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (12.0, -0.5, 0.0)],
        tension=12.0,
    )  # fmt: skip
    assert cable.hold == "pocket"
    Solver(scene).advance()
    middle = cable.line[np.argmin(np.abs(cable.line[:, 0] - 5.0))]
    assert 0.05 < middle[1] < 5.0, "the prestress pulls the edge in"
