"""Isotropic material has no warp: its strength is compared with principal forces."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import InputError, IsotropicMembrane, OrthotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.foundation.meshes import MembraneMesh

STRETCH, NU = 1.05, 0.3


def pulled(mesh: MembraneMesh, material: IsotropicMembrane, angle: float) -> Scene:
    """The sheet stretched in one direction, the other lengths kept."""
    scene = Scene(mesh, material)
    way = np.array([np.cos(angle), np.sin(angle), 0.0])
    x = scene.V.tabulate_dof_coordinates()
    scene.u.x.array[:] = ((STRETCH - 1.0) * np.outer(x @ way, way)).ravel()
    return scene


@pytest.mark.ranks
@pytest.mark.parametrize("units", [(1.0, 1.0), (1000.0, 1e-3)], ids=["m, kN", "mm, MN"])
def test_strength_is_compared_with_the_principal_force(
    comm: MPI.Intracomm, units: tuple[float, float]
) -> None:
    """Stretched in any direction: E t / (1 - nu^2) stretch (stretch^2 - 1) / 2 in every cell."""
    length, force = units
    Et = 900.0 * force / length
    exact = Et / (1 - NU**2) * STRETCH * (STRETCH**2 - 1) / 2
    for size in (1.0, 0.5, 0.3):
        mesh = meshes.rectangle(comm, 4.0 * length, 1.0 * length, size * length)
        for angle in (0.0, 0.7, 1.9):
            scene = pulled(mesh, IsotropicMembrane(E=Et, nu=NU, thickness=1.0), angle)
            results = Solver(scene).results()
            for pair in ((2 * exact, 2 * exact), (3 * exact, 2 * exact), (2 * exact, 5 * exact)):
                np.testing.assert_allclose(results.utilisation(pair), 0.5, rtol=1e-10)


def test_principal_strength_is_that_of_any_warp() -> None:
    """Of a fabric of isotropic numbers, the worst warp has the utilisation of foil."""
    mesh = meshes.rectangle(MPI.COMM_SELF, 4.0, 1.0, 0.5)
    foil = IsotropicMembrane(E=900.0, nu=NU, thickness=1.0)
    largest = []
    for warp in np.linspace(0.0, np.pi / 2, 31):
        fabric = OrthotropicMembrane(
            E1=900.0, E2=900.0, G12=450.0 / (1 + NU), nu21=NU, thickness=1.0,
            warp=(np.cos(warp), np.sin(warp), 0.0),
        )  # fmt: skip
        scene = Scene(mesh, fabric)
        scene.u.x.array[:] = pulled(mesh, foil, np.pi / 6).u.x.array
        largest.append(Solver(scene).results().utilisation((20.0, 20.0)).max())
    used = Solver(pulled(mesh, foil, np.pi / 6)).results().utilisation((20.0, 20.0))
    np.testing.assert_allclose(used, max(largest), rtol=1e-6)  # the warp at 30 degrees is tried
    assert min(largest) < 0.9 * max(largest)


@pytest.mark.parametrize("name", ["warp", "weft", "shear"])
def test_names_along_warp_are_refused(name: str, tmp_path: Path) -> None:
    mesh = meshes.rectangle(MPI.COMM_SELF, 4.0, 1.0, 0.5)
    solver = Solver(pulled(mesh, IsotropicMembrane(E=900.0, nu=NU, thickness=1.0), 0.4))
    results = solver.results()
    assert not {name, f"second Piola {name}"} & {*results.names}
    assert name not in results.at([(2.0, 0.5)]).values
    assert name not in solver.summary().membrane.largest
    calls: list[Callable[[], object]] = [
        lambda: results.values(name),
        lambda: results.function(name, smooth=True),
        lambda: solver.draw(tmp_path / "a.png", colour=name),
        lambda: solver.report(tmp_path / "a.html", pictures=[name]),
    ]
    for call in calls:
        with pytest.raises(InputError, match=f"{name}.* isotropic"):
            call()
    assert not [*tmp_path.iterdir()]


@pytest.mark.ranks
def test_parts_of_foil_and_fabric(comm: MPI.Intracomm) -> None:
    """Values along the warp only where there is one; both have a utilisation."""
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]]
    cells = [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]
    parts = {"foil": [0, 1], "fabric": [2, 3]}
    given = (points, cells) if comm.rank == 0 else (np.zeros((0, 3)), np.zeros((0, 3), int))
    mesh = meshes.from_arrays(comm, *given, parts=parts if comm.rank == 0 else {})
    materials = {
        "foil": IsotropicMembrane(E=300.0, nu=0.0, thickness=1.0, prestress=4.0),
        "fabric": OrthotropicMembrane(
            E1=300.0, E2=300.0, G12=150.0, nu21=0.0, thickness=1.0, prestress=(6.0, 2.0)
        ),
    }
    scene = Scene(mesh, materials)
    scene.set_strengths({"foil": (8.0, 16.0), "fabric": (24.0, 2.0)})
    solver = Solver(scene)
    results = solver.results()
    own = len(results.state)
    foil, fabric = (np.array(mesh.parts[name], int) for name in parts)
    foil, fabric = foil[foil < own], fabric[fabric < own]
    for name, value in (("warp", 6.0), ("weft", 2.0), ("shear", 0.0), ("second Piola warp", 6.0)):
        values = results.values(name)
        np.testing.assert_allclose(values[fabric], value, atol=1e-12)
        assert np.isnan(values[foil]).all()
    assert np.isnan(results.warp[foil]).all()
    used = results.utilisation()
    np.testing.assert_allclose(used[foil], 0.5)
    np.testing.assert_allclose(used[fabric], 1.0)
    summary = solver.summary()
    assert "warp" not in summary.parts["foil"].largest
    assert summary.parts["fabric"].largest["warp"].value == pytest.approx(6.0)
    assert "true force 1 4" in repr(summary)
