"""What was found is in equilibrium as a scene: the first load step moves nothing; section forces
are those prescribed and the residual ones."""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import advanced
from dolfinx import fem, la
from form_meshes import CORNERS, SIDES, cylinder, nodes, order, sail
from grids import grid
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
from crms_fenicsx.model.cable import HOLDS, Hold
from crms_fenicsx.results.output.report.model_tables import model_of_scene
from crms_fenicsx.results.output.report.page import Units
from crms_fenicsx.results.quantities import fields_of

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


def ridge(comm: MPI.Intracomm, hold: Hold = "sleeve", way: float = 1.0) -> FoundForm:
    """A cable inside, between two points of the rim that are lifted with it, or lowered as those of
    a valley."""
    points, cells = grid(np.arange(13.0), np.arange(13.0), by_rows=True)
    middle = np.flatnonzero(points[:, 1] == 6.0)
    edges = {"ridge": np.stack([middle[:-1], middle[1:]], 1)}
    mesh = meshes.from_arrays(comm, points, cells, edges=edges)
    return find_form(
        mesh, 2.0, fixed=["boundary"], cables=[FormCable("ridge", length=12.1, hold=hold)],
        lifted={"boundary": lambda x: np.stack([0 * x[0], 0 * x[0],
                way * np.maximum(0.0, 3.0 - 0.5 * np.abs(x[1] - 6.0))])},
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
        assert form.deviation < 2.5e-3 * size
    assert 1e-8 < moves[-1] < 1e-3
    assert order(sizes, moves) > 0.8


@pytest.mark.ranks
@pytest.mark.parametrize("hold", HOLDS)
def test_cables_inside_are_attached_as_their_form_says(comm: MPI.Intracomm, hold: Hold) -> None:
    """The valley moves nothing; a load on one side of it pushes it aside over the fabric unless it
    is in a pocket or bonded, and its tension is one unless it is bonded. In a pocket it is that of
    the polyline of its vertices."""
    form = ridge(comm, hold, -1.0)
    (found,) = form.cables
    (cable,) = (scene := form.scene(FOIL, STEEL)).cables
    assert (found.hold, cable.hold) == (hold, hold)
    solver = advanced(Solver(scene))
    moved = comm.allreduce(float(np.abs(scene.u.x.array).max(initial=0.0)), op=MPI.MAX)
    assert moved < 1e-7 and cable.tension == pytest.approx(found.tension)
    scene.put_load(lambda x, n: np.stack([0 * x[0], 0 * x[0], -0.5 * (x[1] > 6.0)]), name="snow")
    solver.advance(load={"snow": 1.0})
    on = cable.reference_positions[np.isfinite(cable.reference_positions).all(axis=1)]
    x, y, _ = found.path[found.path[:, 0].argsort()].T
    aside = np.abs(on[:, 1] - np.interp(on[:, 0], x, y)).max()
    assert aside > 5e-3 if HOLDS[hold].sideways else aside < 1e-9
    assert np.ptp(cable.tensions) > 0.1 if hold == "bonded" else np.ptp(cable.tensions) < 1e-9
    if hold == "pocket":
        dofs = scene.vertices("ridge")
        dofs = dofs[dofs < scene.V.dofmap.index_map.size_local]
        row = np.concatenate(comm.allgather(scene.positions()[dofs]))
        row = row[row[:, 0].argsort()]
        length = np.linalg.norm(np.diff(row, axis=0), axis=1).sum()
        assert cable.tension == pytest.approx(STEEL.EA * (length / cable.L0 - 1.0), rel=1e-6)


@pytest.mark.ranks
def test_fabric_that_pulls_away_is_named(comm: MPI.Intracomm) -> None:
    """A ridge on the outer side; along another line it keeps its attachment."""
    with pytest.raises(InputError, match=r"'ridge' lies on the outer side.*\"pocket\""):
        ridge(comm, "outside").scene(FOIL, STEEL)
    form = ridge(comm, "pocket").along({"other": [(0.0, 3.0), (12.0, 3.0)]})
    assert [cable.hold for cable in form.cables] == ["pocket"]
    with pytest.raises(InputError, match="hold of 'ridge' = 'glued' is not known; use 'outside'"):
        FormCable("ridge", length=12.1, hold="glued")  # type: ignore[arg-type]


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


def catenoid(comm: MPI.Intracomm) -> FoundForm:
    return find_form(cylinder(comm, 16, 4, 10.0, 12.0), 2.0, fixed=["boundary"])


def coarse_dome(comm: MPI.Intracomm) -> FoundForm:
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
@pytest.mark.parametrize(
    ("make", "fabric"), [(catenoid, FOIL), (coarse_dome, FOIL), (saddle, FABRIC)]
)
def test_results_have_the_residual_section_forces(
    comm: MPI.Intracomm, make: object, fabric: object
) -> None:
    """With them the section forces balance at each vertex, without them not."""
    form = make(comm)  # type: ignore[operator]
    scene = form.scene(fabric)
    scene.set_strengths((8.0, 8.0))
    solver = advanced(Solver(scene))
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
    theory = dict(model_of_scene(scene, Units()).tables["mesh"].rows)
    assert "forces below include them" in str(theory["Residual section forces"])


def test_they_stay_with_the_fabric_as_it_strains(comm: MPI.Intracomm) -> None:
    """Second Piola-Kirchhoff forces that are constant: also a dome blown up further balances."""
    form = coarse_dome(comm)
    solver = advanced(
        Solver(form.scene(IsotropicMembrane(E=20.0, nu=0.3, thickness=1.0))),
        pressure=1.5 * form.pressure,
    )
    results = solver.results()
    strain = comm.allreduce(float(results.strains.max(initial=0.0)), op=MPI.MAX)
    assert strain > 0.02
    assert unbalanced(solver, tensors(solver)) < 1e-6
