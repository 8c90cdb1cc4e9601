"""Forms that are compiled once in a process, on one mesh after the other, and assembled in one pass
over the cells."""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from grids import grid
from mpi4py import MPI
from term_scene import FABRIC, ISOTROPIC, cable_square, displaced, on_mesh

from crms_fenicsx import IsotropicMembrane, OrthotropicMembrane, Scene, meshes
from crms_fenicsx.design.form_finding import film, find_form
from crms_fenicsx.energy.terms import integral, membrane_energy
from crms_fenicsx.energy.terms.integral import FusedAssembly
from crms_fenicsx.energy.terms.membrane_energy import MembraneEnergy
from crms_fenicsx.energy.terms.pressure import FollowerPressure
from crms_fenicsx.model.materials import MembraneMaterial

FILM = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)
STIFF = IsotropicMembrane(E=500.0, nu=0.3, thickness=0.08, wrinkling=False)
CLOTH = OrthotropicMembrane(1394.0, 140.0, 12.0, 0.065, 1.0, warp=(0.0, 1.0, 0.0))
MATERIALS: dict[str, Any] = {
    "isotropic": FILM, "stiff": STIFF, "fabric": FABRIC, "cloth": CLOTH,
    "parts": {"left": FILM, "right": CLOTH},
}  # fmt: skip


def square(comm: MPI.Intracomm, n: int, material: Any) -> meshes.MembraneMesh:
    """A unit square of n x n squares of two cells, with its halves as parts where these differ."""
    line = np.linspace(0.0, 1.0, n + 1)
    points, cells = grid(line, line, by_rows=True)
    left = points[cells, 0].mean(axis=1) < (n // 2) / n
    halves = {"left": np.flatnonzero(left), "right": np.flatnonzero(~left)}
    parts = halves if isinstance(material, Mapping) else {}
    return meshes.from_arrays(comm, points, cells, parts=parts)


def assembled(comm: MPI.Intracomm, n: int, material: MembraneMaterial) -> list[Any]:
    """Values and gradients of membrane and pressure, and the membrane's stiffness, when bent."""
    scene = Scene(square(comm, n, material), material)
    x, y, _ = scene.membrane.stress_free.T
    scene.u.x.array[:] = np.stack([0.02 * x * y, -0.01 * y, 0.3 * x * y * (1 - y)], 1).ravel()
    cells = fem.Function(fem.functionspace(scene.mesh.mesh, ("DG", 0)))
    one = fem.Constant(scene.mesh.mesh, 0.7)
    cells.x.array[:] = 1.0
    volume = FollowerPressure(scene.u, cells, one, np.array([0.1, 0.2, 0.3]))
    energy = MembraneEnergy(scene.u, scene.materials, scene.membrane.cell_tags)
    both = [energy.integral, volume.integral]
    FusedAssembly.of(both).assemble()
    found = [np.array(value) for part in both for value in (part.value, part.gradient)]
    stiffness = fem.assemble_matrix(energy._pattern.form).data  # type: ignore[arg-type]
    return [*found, np.array(stiffness)]


def by_signature(inputs: Any, spaces: Any, write: Callable[[], Any], tags: Any = None) -> fem.Form:
    """The form as DOLFINx makes it."""
    return fem.form(write())


@pytest.mark.ranks
@pytest.mark.parametrize("name", MATERIALS)
def test_a_form_on_another_mesh_is_that_of_its_signature(
    comm: MPI.Intracomm, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(integral, "COMPILED", {})
    for material in MATERIALS.values():
        assembled(comm, 4, material)
    with monkeypatch.context() as unable:
        unable.delattr(fem, "compile_form")
        unable.delattr(fem, "form")
        found = assembled(comm, 6, MATERIALS[name])
    for module in (membrane_energy, integral):
        monkeypatch.setattr(module, "compiled_form", by_signature)
    monkeypatch.setattr(integral, "ALL", "everywhere")
    for one, other in zip(found, assembled(comm, 6, MATERIALS[name]), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.ranks
@pytest.mark.parametrize("name", ["isotropic", "parts"])
def test_cells_without_a_factor_are_left_out(comm: MPI.Intracomm, name: str) -> None:
    scene = Scene(square(comm, 4, MATERIALS[name]), MATERIALS[name])
    scene.u.x.array[:] = 0.1 * scene.membrane.stress_free.ravel()
    term = MembraneEnergy(scene.u, scene.materials, scene.membrane.cell_tags)

    def energy() -> float:
        FusedAssembly.of([term.integral]).assemble()
        return float(comm.allreduce(term.integral.value))

    whole, every = energy(), term.plain.x.array.copy()
    term.plain.x.array[::2] = 0.0
    part = energy()
    assert 0.0 < part < whole
    form = term.integral.passes[term.integral,]
    term.plain.x.array[:] = every
    form.assemble()
    assert comm.allreduce(term.integral.value) == pytest.approx(part, rel=1e-14)
    assert energy() == whole


@pytest.mark.ranks
def test_ranks_that_have_compiled_a_form_wait_for_those_that_have_not(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(integral, "COMPILED", {})
    if comm.rank == 0:
        assembled(MPI.COMM_SELF, 4, FILM)
    value = assembled(comm, 4, FILM)[0]
    np.testing.assert_allclose(
        comm.allreduce(float(value)), assembled(MPI.COMM_SELF, 4, FILM)[0], rtol=1e-12
    )


def test_a_compiled_form_keeps_no_mesh_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integral, "COMPILED", {})
    scene = Scene(square(MPI.COMM_SELF, 4, FILM), FILM)
    MembraneEnergy(scene.u, scene.materials)
    gone = weakref.ref(scene.u)
    del scene
    gc.collect()
    assert integral.COMPILED and gone() is None


@pytest.mark.parametrize("stress", [2.0, (3.0, 1.0)])
def test_a_form_is_found_on_another_mesh_without_compiling(
    stress: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: Any = {"fixed": ["boundary"], "warp": (1.0, 0.0, 0.0), "pressure": 0.5}
    given = given if isinstance(stress, tuple) else {"fixed": ["boundary"], "pressure": 0.5}
    find_form(square(MPI.COMM_SELF, 4, FILM), stress, **given)
    with monkeypatch.context() as unable:
        unable.delattr(fem, "compile_form")
        found = find_form(square(MPI.COMM_SELF, 6, FILM), stress, **given)
    monkeypatch.setattr(film, "compiled_form", by_signature)
    other = find_form(square(MPI.COMM_SELF, 6, FILM), stress, **given)
    np.testing.assert_array_equal(found.mesh.mesh.geometry.x, other.mesh.mesh.geometry.x)


BOTH = "MembraneEnergy", "FollowerPressure"


@pytest.mark.ranks
@pytest.mark.parametrize("material", [ISOTROPIC, FABRIC])
def test_terms_together_are_those_alone(comm: MPI.Intracomm, material: MembraneMaterial) -> None:
    system = cable_square(comm, material)
    x = displaced(system.unknowns, 2.0)
    energies, gradients = zip(*(on_mesh(system, name).value(x) for name in BOTH), strict=True)
    energy, gradient = on_mesh(system, *BOTH).value(x)
    assert energy == pytest.approx(sum(energies), rel=1e-12)
    size = comm.allreduce(max(np.abs(g).max() for g in gradients), op=MPI.MAX)
    np.testing.assert_allclose(gradient, sum(gradients), rtol=0, atol=1e-12 * size)


def test_a_new_layout_of_the_unknowns_compiles_nothing(
    comm: MPI.Intracomm, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = cable_square(comm)
    system.potential.evaluate()
    energies = system.potential.energies()
    monkeypatch.delattr(fem, "form")
    monkeypatch.delattr(fem, "compile_form")
    system.rebuild()
    system.read_scene()
    system.potential.evaluate()
    assert system.potential.energies() == pytest.approx(energies, rel=1e-12)
