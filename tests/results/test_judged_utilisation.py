"""The utilisation that is judged: recovered at vertices, outside of reinforced corners; principal
forces of isotropic material."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI
from report_page import read_csv

from crms_fenicsx import (
    Bar,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    meshes,
)
from crms_fenicsx.foundation.meshes import MembraneMesh
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.results.recovered_values import at_facets, judged_utilisation, patches, recovered

UNITS = pytest.mark.parametrize("units", [(1.0, 1.0), (1000.0, 1e-3)], ids=["m, kN", "mm, MN"])
STRAIN = 1e-6
"""So small that Green-Lagrange strains are linear in the displacements to six digits."""


Where = Callable[[float, float], bool]


def of_squares(
    comm: MPI.Intracomm,
    there: Where,
    weak: Where = lambda x, y: True,
    tip: tuple[float, float] = (0.0, 0.0),
) -> MembraneMesh:
    """Halved squares of 1/4, those of [0, 2]^2 that are `there`, in parts "weak" and "strong"."""
    squares = [(i, j) for i in range(8) for j in range(8) if there((i + 0.5) / 4, (j + 0.5) / 4)]
    corners = [((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)) for i, j in squares]
    number = {place: n for n, place in enumerate(dict.fromkeys(chain.from_iterable(corners)))}
    cells = [[number[one[k]] for k in half] for one in corners for half in ((0, 1, 2), (0, 2, 3))]
    soft = np.repeat([weak((i + 0.5) / 4, (j + 0.5) / 4) for i, j in squares], 2)
    parts = {"weak": soft, "strong": ~soft}
    return meshes.from_arrays(
        comm, np.array([(i / 4, j / 4, 0.0) for i, j in number]), cells,
        parts={name: np.flatnonzero(own) for name, own in parts.items() if own.any()},
        point_groups={"tip": [number[round(4 * tip[0]), round(4 * tip[1])]]},
    )  # fmt: skip


def stretched(
    mesh: MembraneMesh, length: float, stiffness: float, slope: float
) -> tuple[Solver, float]:
    """A sheet with the strain STRAIN (1 + slope x / length) along x, and its largest utilisation.

    Without lateral contraction the section force is the stiffness times the strain.
    """
    scene = Scene(mesh, IsotropicMembrane(E=stiffness, nu=0.0, thickness=1.0))
    x = scene.V.tabulate_dof_coordinates()[:, 0]
    scene.u.x.array.reshape(-1, 3)[:, 0] = STRAIN * (x + slope * x**2 / (2 * length))
    strength = 2 * STRAIN * stiffness
    scene.set_strengths((strength, strength))
    return Solver(scene), 0.5 * (1.0 + slope)


@pytest.mark.ranks
@UNITS
@pytest.mark.parametrize("structured", [True, False])
def test_uniform_field_is_exact(
    comm: MPI.Intracomm, structured: bool, units: tuple[float, float]
) -> None:
    length, force = units
    mesh = meshes.rectangle(comm, 4 * length, 2 * length, 0.5 * length, structured=structured)
    solver, exact = stretched(mesh, 4 * length, 900.0 * force / length, 0.0)
    found = solver.summary()
    for values in (found.membrane.least, found.membrane.largest):
        assert values["utilisation"].value == pytest.approx(exact, rel=1e-5)
    assert found.membrane.change == pytest.approx(0.0, abs=1e-6)
    assert not found.patches


@pytest.mark.ranks
@UNITS
@pytest.mark.parametrize("structured", [True, False])
def test_linear_field_converges_with_the_cells(
    comm: MPI.Intracomm, structured: bool, units: tuple[float, float]
) -> None:
    """Exact within a regular mesh; at edges in the first order, and within the change told."""
    length, force = units
    errors = []
    for size in (0.5, 0.25, 0.125):
        mesh = meshes.rectangle(comm, 4 * length, 2 * length, size * length, structured=structured)
        solver, exact = stretched(mesh, 4 * length, 900.0 * force / length, 1.0)
        part = solver.summary().membrane
        used = part.largest["utilisation"]
        errors.append(abs(used.value - exact))
        assert used.at[0] == pytest.approx(4 * length, rel=1e-5)
        assert part.change is not None and errors[-1] <= part.change * used.value
        results = solver.results()
        if structured:
            dofs = solver.scene.V.dofmap.list[: len(results.state)]
            x, y, _ = solver.scene.membrane.stress_free[dofs].transpose(2, 0, 1) / length
            inner = (x > 1e-9) & (x < 4 - 1e-9) & (y > 1e-9) & (y < 2 - 1e-9)
            off = recovered(results, "utilisation") - 0.5 * (1.0 + x / 4)
            assert np.abs(off[inner]).max(initial=0.0) < 1e-5
    assert errors[2] < 0.4 * errors[0], errors
    assert errors[2] == pytest.approx(errors[0] / 4, rel=0.35)


@pytest.mark.ranks
def test_parts_keep_their_own_values(comm: MPI.Intracomm) -> None:
    """Vertices between strengths are not averaged over the border."""
    mesh = of_squares(comm, lambda x, y: y < 1.0, weak=lambda x, y: x < 1.0)
    solver, exact = stretched(mesh, 2.0, 900.0, 0.0)
    strength = 900.0 * 2 * STRAIN
    solver.scene.set_strengths({"weak": (strength, strength), "strong": (4 * strength,) * 2})
    parts = solver.summary().parts
    for name, value in (("weak", exact), ("strong", exact / 4)):
        for found in (parts[name].least, parts[name].largest):
            assert found["utilisation"].value == pytest.approx(value, rel=1e-5)
        assert parts[name].change == pytest.approx(0.0, abs=1e-6)


def propped(comm: MPI.Intracomm, cells: int, units: tuple[float, float] = (1.0, 1.0)) -> Solver:
    """A prestressed square, 8 m, held all around, lifted in its middle by a prop."""
    length, force = units
    mesh = meshes.rectangle(comm, 8 * length, 8 * length, 8 * length / cells, structured=True)
    stress = force / length
    scene = clamped(
        mesh, IsotropicMembrane(E=300.0 * stress, nu=0.3, thickness=1.0, prestress=2.0 * stress)
    )
    middle = scene.vertex_at((4 * length, 4 * length, 0.0))
    prop = Bar(EA=1e3 * force)
    scene.add_bar(prop, middle, (4 * length, 4 * length, -2 * length), L0=2.4 * length, name="prop")
    scene.set_strengths((40.0 * stress, 40.0 * stress), patches=1.0 * length)
    return advanced(Solver(scene))


@pytest.mark.ranks
@UNITS
def test_one_verdict_on_all_meshes(comm: MPI.Intracomm, units: tuple[float, float]) -> None:
    """At a mast's head the cells' largest value grows as they become finer, the judged one not."""
    single, judged = [], []
    for cells in (8, 16, 32):
        solver = propped(comm, cells, units)
        own = float(solver.results().utilisation().max(initial=0.0))
        single.append(comm.allreduce(own, op=MPI.MAX))
        found = solver.summary()
        judged.append(found.membrane.largest["utilisation"].value)
        (patch,) = found.patches.values()
        assert patch.patch.reason == "bar" and patch.utilisation > judged[-1]
        np.testing.assert_allclose(patch.patch.at[:2], 4.0 * units[0], rtol=1e-9)
    assert single[2] > 1.3 * single[1] > 1.69 * single[0], single
    assert max(judged) < 1.15 * min(judged), judged


@pytest.mark.ranks
def test_pictures_show_what_is_judged(comm: MPI.Intracomm) -> None:
    """No value in the middle of the mast's patch, and the summary's largest one outside of it."""
    solver = propped(comm, 32)
    results, scene = solver.results(), solver.scene
    shown = judged_utilisation(results, patches(scene)).shown
    dofs = scene.V.dofmap.list[: len(shown)]
    away = np.linalg.norm(scene.membrane.stress_free[dofs] - (4.0, 4.0, 0.0), axis=2)
    np.testing.assert_array_equal(np.isnan(shown).any(axis=1), (away <= 1.0).all(axis=1))
    most = comm.allreduce(float(np.nanmax(shown, initial=0.0)), op=MPI.MAX)
    assert most == solver.summary().membrane.largest["utilisation"].value
    facets = at_facets(results, shown)
    np.testing.assert_allclose(facets, shown[results.surface.parents], atol=1e-9)


def found_at(scene: Scene) -> set[tuple[float, float, str]]:
    return {(round(x.at[0], 6), round(x.at[1], 6), x.reason) for x in patches(scene).values()}


@pytest.mark.ranks
def test_corners(comm: MPI.Intracomm) -> None:
    """Ends of held edges, point supports and named points; none at free or held corners."""
    mesh = meshes.rectangle(comm, 4.0, 2.0, 0.5)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    assert not patches(scene)
    scene.fix("left")
    assert found_at(scene) == {(0.0, 0.0, "end of a held edge"), (0.0, 2.0, "end of a held edge")}
    assert {round(x.radius, 12) for x in patches(scene).values()} == {0.1}
    scene.fix(lambda x: np.isclose(x[0], 4.0) & np.isclose(x[1], 2.0))
    found = found_at(scene)
    assert (4.0, 2.0, "support") in found and len(found) == 3
    scene.fix("boundary")
    assert not patches(scene)


@pytest.mark.ranks
def test_reentrant_corner_and_radii(comm: MPI.Intracomm) -> None:
    """An L has one corner that turns inward; radii may be given for all and by name."""
    mesh = of_squares(comm, lambda x, y: min(x, y) < 1.0, tip=(2.0, 0.0))
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    assert found_at(scene) == {(1.0, 1.0, "re-entrant")}
    scene.set_strengths((1.0, 1.0), patches={"tip": 0.3})
    found = patches(scene)
    assert found_at(scene) == {(1.0, 1.0, "re-entrant"), (2.0, 0.0, "named")}
    assert found["tip"].radius == 0.3 and found["tip"].given
    other = found["corner 1"]
    assert other.radius == pytest.approx(0.05 * np.sqrt(2.0)) and not other.given
    scene.set_strengths((1.0, 1.0), patches=0.0)
    assert not Solver(scene).summary().patches
    for bad in (-1.0, {"nose": 0.2}, {"tip": np.nan}):
        with pytest.raises(InputError, match=r"patches|group of points"):
            scene.set_strengths((1.0, 1.0), patches=bad)


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


def vertex_means(solver: Solver, column: int) -> Array:
    """Means of the cells' forces along warp (0) or weft (1) at all vertices, from raw values."""
    results, membrane = solver.results(), solver.scene.membrane
    dofs = solver.scene.V.dofmap.list[: len(results.state)]
    own = membrane.vertex_ids[dofs], results.warp_weft[:, column], results.stress_free_areas
    ids, forces, areas = map(np.concatenate, zip(*membrane.comm.allgather(own), strict=True))
    weights = np.bincount(ids.ravel(), np.repeat(areas, 3))
    sums = np.bincount(ids.ravel(), np.repeat(areas * forces, 3))
    return np.asarray(sums[weights > 0.0] / weights[weights > 0.0])


@pytest.mark.ranks
def test_warp_and_weft_govern_by_themselves(comm: MPI.Intracomm, folder: Path) -> None:
    """Each in its own combination and place, also where the other one is larger."""
    mesh = meshes.rectangle(comm, 6.0, 4.0, 1.0)
    fabric = OrthotropicMembrane(
        E1=500.0, E2=400.0, G12=20.0, nu21=0.2, thickness=1.0, prestress=(3.0, 1.0)
    )
    scene = Scene(mesh, fabric)
    scene.fix("boundary")
    scene.put_load((0.0, 0.0, -1.0), name="snow", per="plan")
    scene.put_load(lambda x, n: np.stack([0 * x[0], 0 * x[0], 1.0 * x[0]]), name="lift", per="plan")
    scene.set_strengths((10.0, 20.0))
    solver = advanced(Solver(scene))
    found = solver.combine({"calm": {}, "snow": {"snow": 1.0}, "lift": {"lift": 1.0}})
    limits = {"fabric warp": 10.0, "fabric weft": 20.0}
    largest = {what: dict[str, float]() for what in limits}
    for name, one in found.items():
        solver.restore(one.snapshot)
        checks = {check.what: check for check in solver.summary().checks}
        for column, what in enumerate(largest):
            most = float(vertex_means(solver, column).max())
            largest[what][name] = most
            assert checks[what].effect == pytest.approx(most, rel=1e-9), (name, what)
            assert checks[what].limit == limits[what]
        used = solver.summary().membrane.largest["utilisation"].value
        assert used == pytest.approx(checks["fabric warp"].share)
        assert used > checks["fabric weft"].share  # which would not be told otherwise
    rows = {check.what: (name, check) for _, name, check in solver.judge(found).rows}
    solver.report(folder / "page.html", found, pictures=[])
    comm.barrier()
    printed = {row["Verification"]: row for row in read_csv(folder / "page_governing.csv")}
    for what, sizes in largest.items():
        case = max(sizes, key=lambda name, of=sizes: of[name])
        assert rows[what][0] == case and rows[what][1].effect == pytest.approx(sizes[case])
        row = printed[f"Membrane, {what.split()[1]}"]
        share = sizes[case] / limits[what]
        assert row["Combination"] == case and row["Utilisation"] == f"{100 * share:.1f} %"
    assert largest["fabric weft"]["lift"] > largest["fabric weft"]["calm"]
