"""Section forces of a form in an analysis: those prescribed and the residual ones, in balance."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem, la
from form_meshes import cylinder
from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, OrthotropicMembrane, Solver, meshes
from crms_fenicsx.design.form_finding import FoundForm, find_form
from crms_fenicsx.results.output.report.model_tables import model_of_scene
from crms_fenicsx.results.output.report.page import Units
from crms_fenicsx.results.quantities import fields_of

pytestmark = pytest.mark.usefixtures("comm")
FOIL = IsotropicMembrane(E=1000.0, nu=0.3, thickness=1.0)
FABRIC = OrthotropicMembrane(E1=1000.0, E2=700.0, G12=40.0, nu21=0.2, thickness=1.0)


def catenoid(comm: MPI.Intracomm) -> FoundForm:
    return find_form(cylinder(comm, 16, 4, 10.0, 12.0), 2.0, fixed=["boundary"])


def dome(comm: MPI.Intracomm) -> FoundForm:
    return find_form(meshes.circle(comm, 10.0, 2.5), 2.0, fixed=["boundary"], rise=4.0)


def saddle(comm: MPI.Intracomm) -> FoundForm:
    """Warp and weft of different forces, over which a part of a per cent is residual."""
    return find_form(
        meshes.rectangle(comm, 10.0, 10.0, 2.0), (4.0, 2.0), fixed=["boundary"],
        warp=(1.0, 1.0, 0.0),
        lifted={"boundary": lambda x: np.stack([0 * x[0], 0 * x[0],
                0.08 * (x[0] - 5.0) * (x[1] - 5.0)])},
    )  # fmt: skip


def tensors(solver: Solver) -> np.ndarray:
    """True section forces of this rank's cells in space, (n, 3, 3)."""
    results = solver.results()
    d = results.true_directions
    return np.einsum("nk,nki,nkj->nij", results.true_forces, d, d)


def unbalanced(solver: Solver, forces: np.ndarray) -> float:
    """Largest force at a free vertex, of section forces (n, 3, 3) and the pressure. Collective."""
    scene = solver.scene
    dofs = scene.V.dofmap.list[: len(forces)]
    corners = scene.membrane.positions()[dofs]
    sum_of = fem.Function(scene.V)
    at = sum_of.x.array.reshape(-1, 3)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    vector = np.cross(a, b) / 2
    normal = vector / np.linalg.norm(vector, axis=1)[:, None]
    for k in range(3):
        opposite = corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3]
        slope = np.cross(normal, opposite) / 2  # gradient of the vertex's function times area
        pulled = np.einsum("nij,nj->ni", forces, slope)
        np.add.at(at, dofs[:, k], pulled - scene.pressure * vector / 3)
    sum_of.x.scatter_reverse(la.InsertMode.add)
    own = scene.V.dofmap.index_map.size_local
    free = np.where(scene.membrane.held[:own], 0.0, at[:own])
    return scene.comm.allreduce(float(np.abs(free).max(initial=0.0)), op=MPI.MAX)


@pytest.mark.ranks
@pytest.mark.parametrize(("make", "fabric"), [(catenoid, FOIL), (dome, FOIL), (saddle, FABRIC)])
def test_results_have_the_residual_section_forces(
    comm: MPI.Intracomm, make: object, fabric: object
) -> None:
    """With them the section forces balance at each vertex, without them not."""
    form = make(comm)  # type: ignore[operator]
    scene = form.scene(fabric)
    scene.set_strengths((8.0, 8.0))
    solver = Solver(scene)
    solver.advance()
    found = tensors(solver)
    n = len(found)
    prescribed = form.stress.tensors(form.mesh)[:n]
    np.testing.assert_allclose(found, prescribed + form.residual_stress[:n], atol=1e-7)
    off = comm.allreduce(float(np.abs(found - prescribed).max(initial=0.0)), op=MPI.MAX)
    largest = form.stress.cell_forces.max(initial=0.0)
    largest = comm.allreduce(float(largest), op=MPI.MAX)
    assert off == pytest.approx(form.deviation * largest, rel=1e-3)
    assert unbalanced(solver, found) < 1e-7
    assert unbalanced(solver, prescribed) > 1e-5

    results = solver.results()
    forces = results.true_forces[:, :1] if fabric is FOIL else results.warp_weft[:, :2]
    np.testing.assert_allclose(results.utilisation(), np.maximum(forces.max(axis=1), 0.0) / 8.0)
    fields = fields_of(results)
    assert ("warp" in fields) == (fabric is FABRIC)
    np.testing.assert_array_equal(fields["true force 1"], results.true_forces[:, 0])
    theory = dict(model_of_scene(scene, Units(), {}).tables["mesh"].rows)
    assert "forces below have them" in str(theory["Residual membrane forces"])


def test_they_stay_with_the_fabric_as_it_strains(comm: MPI.Intracomm) -> None:
    """Second Piola-Kirchhoff forces that are constant: also a dome blown up further balances."""
    form = dome(comm)
    solver = Solver(form.scene(IsotropicMembrane(E=20.0, nu=0.3, thickness=1.0)))
    solver.advance(pressure=1.5 * form.pressure)
    results = solver.results()
    strain = comm.allreduce(float(results.strains.max(initial=0.0)), op=MPI.MAX)
    assert strain > 0.02
    assert unbalanced(solver, tensors(solver)) < 1e-6
