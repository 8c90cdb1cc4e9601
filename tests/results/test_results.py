"""Stresses, reactions, loads per area, volume, surface and turned shapes of a state, against slow
twins and exact values."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from cabled_square import advanced, clamped, sheet
from mpi4py import MPI

from crms_fenicsx import (
    Cable,
    InputError,
    IsotropicMembrane,
    OrthotropicMembrane,
    Scene,
    Solver,
    codes,
    meshes,
)
from crms_fenicsx.cabling.cables.deformed_surface import current_surface, gained_volume
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.polygons import best_fans
from crms_fenicsx.model.materials import MembraneMaterial
from crms_fenicsx.results.output.report.case import _shape_change, shape_of
from crms_fenicsx.results.quantities import load_label, load_values

pytestmark = pytest.mark.usefixtures("comm")
COMM = MPI.COMM_WORLD
FABRIC = OrthotropicMembrane(
    E1=1394.0, E2=140.0, G12=12.0, nu21=0.065, thickness=1.0, warp=(1, 0.3, 0), prestress=(2, 1)
)
FOIL = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)


def square_scene(material: MembraneMaterial = FOIL, size: float = 25.0) -> Scene:
    mesh = meshes.rectangle(COMM, 100.0, 100.0, size=size, structured=True)
    return clamped(mesh, material)


def put(scene: Scene, shape: Callable[[Array], Array]) -> None:
    """Give the vertices the displacement shape(x, y, z) -> (3, n)."""
    x = scene.V.tabulate_dof_coordinates().T
    scene.u.x.array[:] = (shape(x) - x).T.ravel()


def bent(x: Array) -> Array:
    return np.array(
        [
            1.02 * x[0] - 0.01 * x[1] + 1e-4 * x[0] * x[1],
            1.05 * x[1] - 5e-4 * x[0] ** 2,
            8 * np.sin(x[0] / 30) * np.cos(x[1] / 40),
        ]
    )


def corners(scene: Scene) -> tuple[Array, Array]:
    """Stress-free and current corners of the owned cells, (n, 3, 3)."""
    dofs = scene.V.dofmap.list[: scene.mesh.mesh.topology.index_map(2).size_local]
    return scene.V.tabulate_dof_coordinates()[dofs], scene.positions()[dofs]


def gradient(X: Array, x: Array) -> Array:
    """F (3, 3) of one cell, zero along the stress-free normal."""
    before, after = (X[1:] - X[0]).T, (x[1:] - x[0]).T
    return after @ np.linalg.pinv(before)


def test_stresses_of_plain_cells_against_tensors_in_space() -> None:
    scene = square_scene(FABRIC)
    put(scene, bent)
    results = Solver(scene).results()
    warp = np.array([1, 0.3, 0]) / np.hypot(1, 0.3)
    weft = np.cross([0, 0, 1], warp)
    before, after = corners(scene)
    for c in range(len(before)):
        X, x = before[c], after[c]
        F = gradient(X, x)
        E = (F.T @ F - np.diag([1.0, 1, 0])) / 2
        e = np.array([warp @ E @ warp, weft @ E @ weft, 2 * warp @ E @ weft])
        s = FABRIC.stiffness @ e + [2, 1, 0]
        S = s[0] * np.outer(warp, warp) + s[1] * np.outer(weft, weft)
        S += s[2] * (np.outer(warp, weft) + np.outer(weft, warp))
        normal = np.cross(x[1] - x[0], x[2] - x[0])
        area = np.linalg.norm(normal) / 2
        J = area / (np.linalg.norm(np.cross(X[1] - X[0], X[2] - X[0])) / 2)
        sigma = F @ S @ F.T / J
        for tensor, values, directions in (
            (S, results.second_piola[c], results.second_piola_directions[c]),
            (sigma, results.true_forces[c], results.true_directions[c]),
        ):
            assert values[0] >= values[1]
            for value, direction in zip(values, directions, strict=True):
                np.testing.assert_allclose(tensor @ direction, value * direction, atol=1e-10)
            np.testing.assert_allclose(directions @ directions.T, np.eye(2), atol=1e-12)
        np.testing.assert_allclose(
            np.sort(results.strains[c]), np.sort(np.linalg.eigvalsh(E[:2, :2])), atol=1e-14
        )
        np.testing.assert_allclose(results.normals[c], normal / (2 * area), atol=1e-13)
        assert results.areas[c] == pytest.approx(area, rel=1e-12)
        along = F @ warp / np.linalg.norm(F @ warp)
        across = np.cross(results.normals[c], along)
        expected = (along @ sigma @ along, across @ sigma @ across, along @ sigma @ across)
        np.testing.assert_allclose(results.warp_weft[c], expected, atol=1e-10)
        np.testing.assert_allclose(results.warp[c], along, atol=1e-13)
        np.testing.assert_allclose(results.second_piola_warp_weft[c], s, atol=1e-11)
    assert not results.folded.any()


@pytest.mark.parametrize("turned", [0.0, 30.0, 90.0])
def test_warp_and_weft_of_a_cylinder(turned: float) -> None:
    """Half a cylinder between planes of symmetry: hoop force p R, along the axis nu times that.

    The fabric is isotropic in its numbers, its warp turned from the hoop direction.
    """
    R, p, nu, n = 5.0, 0.4, 0.3, 48
    angle = np.linspace(0.0, np.pi, n + 1)
    rows = [np.column_stack([-R * np.cos(angle), 0 * angle + y, R * np.sin(angle)]) for y in (0, 1)]
    points, first = np.concatenate(rows), np.arange(n)
    cells = [(k, k + 1, k + n + 2) for k in first] + [(k, k + n + 2, k + n + 1) for k in first]
    mesh = meshes.from_arrays(COMM, points, cells)
    cos, sin = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    fabric = OrthotropicMembrane(
        E1=1e6, E2=1e6, G12=1e6 / (2 * (1 + nu)), nu21=nu, thickness=1.0, warp=(cos, sin, 0.0),
        wrinkling=False,
    )  # fmt: skip
    scene = Scene(mesh, fabric)
    scene.fix(lambda x: x[2] < 1e-9)
    scene.fix(lambda x: x[2] > -1.0, "y")
    solver = advanced(Solver(scene), pressure=p)
    results = solver.results()
    crown = np.abs(corners(scene)[0].mean(axis=1)[:, 0]) < R * np.pi / n
    hoop, axial = p * R, nu * p * R
    expected = (
        hoop * cos**2 + axial * sin**2,
        hoop * sin**2 + axial * cos**2,
        (hoop - axial) * sin * cos,
    )
    found = np.abs(results.warp_weft[crown])
    np.testing.assert_allclose(found, np.tile(expected, (len(found), 1)), atol=4e-3 * hoop)


def test_utilisation() -> None:
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]]
    cells = [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]
    mesh = meshes.from_arrays(COMM, points, cells, parts={"left": [0, 1], "right": [2, 3]})
    fabric = OrthotropicMembrane(
        E1=300.0, E2=300.0, G12=150.0, nu21=0.0, thickness=0.1, warp=(1, 0, 0), prestress=(6, 2)
    )
    scene = Scene(mesh, fabric)
    results = Solver(scene).results()
    left = corners(scene)[0][:, :, 0].max(axis=1) < 1.5
    np.testing.assert_allclose(results.utilisation((12.0, 8.0)), 0.5)
    np.testing.assert_allclose(results.utilisation((24.0, 2.0)), 1.0)
    found = results.utilisation({"left": (3.0, 8.0)})
    np.testing.assert_allclose(found, np.where(left, 2.0, np.nan))
    scene.put_load((0.0, 0.0, -1.0), name="snow")
    scene.put_pond(10.0, level=-1.0, name="water")
    longer = {"permanent": 3.0, "snow": 1.6, "water": 2.0}
    design = codes.FabricDesign((36.0, 24.0), gamma_M=1.0, duration=longer)
    scene.set_strengths(design)
    np.testing.assert_allclose(Solver(scene).results().utilisation(), 0.5)  # nothing acts
    scene.loads.replace_each(lambda load: replace(load, factor=0.1))
    results = Solver(scene).results()
    np.testing.assert_allclose(results.utilisation(), 0.5 * 1.6 / 3.0)  # the shortest of equals
    np.testing.assert_allclose(results.utilisation((12.0, 8.0)), 0.5)
    assert Solver(scene).summary().design[""].divisor == 1.6
    put(scene, lambda x: 0.5 * x)
    assert not Solver(scene).results().utilisation((12.0, 8.0)).any(), "slack"
    for bad, words in (
        ({"top": (1.0, 1.0)}, "no part 'top'.*left, right"),
        ((0.0, 1.0), "strength of the membrane"),
        ({"left": 3.0}, "strength of 'left' = 3.0; pass two"),
    ):
        with pytest.raises(InputError, match=words):
            results.utilisation(bad)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("stretches", "state", "forces"),
    [
        ((1.10, 1.05), 2, None),
        ((1.10, 0.90), 1, (24 * 0.105, 0.0)),
        ((0.97, 0.90), 0, (0.0, 0.0)),
    ],
)
def test_states_of_the_tension_field(
    stretches: tuple[float, float], state: int, forces: tuple[float, float] | None
) -> None:
    scene = square_scene()
    put(scene, lambda x: np.array([stretches[0] * x[0], stretches[1] * x[1], x[2]]))
    results = Solver(scene).results()
    taut = FOIL.stiffness[:2, :2] @ ((np.square(stretches) - 1) / 2)
    expected = taut if forces is None else np.array(forces)
    assert (results.state == state).all()
    n = len(results.state)
    np.testing.assert_allclose(results.second_piola, np.tile(expected, (n, 1)), atol=1e-12)
    # Each true force acts on what its own direction has stretched and the other one shortened.
    true = np.multiply(expected, [stretches[0] / stretches[1], stretches[1] / stretches[0]])
    np.testing.assert_allclose(results.true_forces, np.tile(true, (n, 1)), atol=1e-12)


def test_parts_have_their_own_materials() -> None:
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]]
    cells = [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]
    mesh = meshes.from_arrays(COMM, points, cells, parts={"left": [0, 1], "right": [2, 3]})
    stiff = IsotropicMembrane(E=900.0, nu=0.25, thickness=0.08)
    scene = Scene(mesh, {"left": FOIL, "right": stiff})
    put(scene, lambda x: 1.1 * x)
    results = Solver(scene).results()
    at_left = corners(scene)[0][:, :, 0].max(axis=1) < 1.5
    force = 24 / (1 - 0.25) * 0.105
    expected = np.where(at_left, force, 3 * force)
    np.testing.assert_allclose(results.true_forces, np.stack([expected, expected], 1), rtol=1e-12)


def test_folded_cells_of_a_straight_cable_are_stressed_like_plain_ones() -> None:
    scene = square_scene(FABRIC, size=100 / 7)
    put(scene, lambda x: np.array([1.02 * x[0] + 0.01 * x[1], 1.05 * x[1], x[2]]))
    solver = Solver(scene)
    plain = solver.results()
    scene.lay_cable(Cable(EA=1000.0), [(3.0, 30.0), (97.0, 71.0)], tension=5.0)
    results = solver.results()
    assert COMM.allreduce(int(results.folded.sum())) > 10
    for name in ("strains", "second_piola", "true_forces", "state", "normals", "areas"):
        np.testing.assert_allclose(
            getattr(results, name), getattr(plain, name), rtol=1e-9, atol=1e-9, err_msg=name
        )
    turned = np.abs(np.sum(results.true_directions * plain.true_directions, axis=2))
    np.testing.assert_allclose(turned, 1.0, atol=1e-9)


def at_centre(radius: Array, values: Array) -> float:
    """Value at radius 0 of the even parabola through the values near the centre."""
    r, v = (np.concatenate(COMM.allgather(part)) for part in (radius, values))
    near = r < 20
    return float(np.polyfit(r[near] ** 2, v[near], 1)[1])


def test_centre_of_an_inflated_circle() -> None:
    """Where both stretches are equal, second Piola-Kirchhoff and true forces are the same."""
    found = []
    for size in (20.0, 10.0):
        scene = clamped(meshes.circle(COMM, 100.0, size=size), FOIL)
        solver = advanced(Solver(scene), pressure=0.01)
        results = solver.results()
        radius = np.hypot(*corners(scene)[1].mean(axis=1)[:, :2].T)
        values = (results.second_piola, results.true_forces)
        found.append([at_centre(radius, v.mean(axis=1)) for v in values])
    coarse, fine = np.array(found)
    np.testing.assert_allclose(fine, 1.2908480226, rtol=0.005)
    np.testing.assert_allclose(fine + (fine - coarse) / 3, 1.2908480226, rtol=1e-3)


def loaded_solver() -> Solver:
    """An inflated square with two cables, one of which is pulled off its held edges."""
    scene = square_scene(size=100 / 7)
    solver = advanced(Solver(scene), pressure=0.01)
    first = scene.lay_cable(Cable(EA=32000.0), [(0.0, 45.0), (100.0, 52.0)])
    second = scene.lay_cable(Cable(EA=32000.0), [(0.0, 22.0), (100.0, 15.0)])
    solver.advance(L0={first: 100.8, second: 100.9})
    solver.advance(move={second.end: (1.0, 0.5, -2.0)})
    return solver


@pytest.mark.ranks
def test_folded_cells_have_the_stresses_that_their_energy_comes_from() -> None:
    solver = loaded_solver()
    results = solver.results()
    # Both tensors share their axes, and the law is of the first degree.
    densities = np.sum(results.second_piola * results.strains, axis=1) / 2
    energy = COMM.allreduce(float(densities.sum())) * (100 / 7) ** 2 / 2
    assert energy == pytest.approx(solver.scene.energies["membrane"], rel=1e-12)
    assert COMM.allreduce(int(results.folded.sum())) > 20


@pytest.mark.ranks
def test_supports_and_anchors_balance_the_pressure() -> None:
    solver = loaded_solver()
    scene = solver.scene
    first, second = scene.cables
    assert first.taut and second.taut
    ends = (first.start, first.end, second.start, second.end)
    support = solver.reactions("boundary")  # but for the end that was moved off it
    assert list(support.parts) == ["cable 1 start", "cable 1 end", "cable 2 start"]
    # The boundary is flat, so the pressure's resultant is that on the square's plan.
    balance = support.total + second.end.reaction + [0, 0, 0.01 * 100.0**2]
    np.testing.assert_allclose(balance, 0.0, atol=1e-6)
    for end in ends:
        assert np.linalg.norm(end.reaction) == pytest.approx(end.cable.tension, rel=1e-12)
    # What the solver tried last does not matter, only the scene's state.
    solver.system.potential.x *= 1.1
    again = solver.reactions("boundary")
    np.testing.assert_allclose(again.total, support.total, rtol=1e-12, atol=1e-12)
    west = solver.reactions(lambda x: x[0] < 1e-9)
    rest = solver.reactions(lambda x: x[0] >= 1e-9)
    np.testing.assert_allclose(west.total + rest.total, support.total, atol=1e-10)
    # Each side of the square is pulled inwards, and so its support pulls outwards.
    assert west.membrane[0] < -10.0
    np.testing.assert_allclose(COMM.allreduce(west.forces.sum(axis=0)), west.membrane, atol=1e-10)
    assert np.abs(west.positions[:, 0]).max(initial=0.0) < 1e-12


@pytest.mark.ranks
def test_anchor_off_the_membrane_against_the_energys_gradient() -> None:
    solver = loaded_solver()
    end = solver.scene.cables[1].end
    system = solver.system
    system.read_scene()
    system.potential.evaluate()
    assert system.cables is not None
    numbering, k = system.cables.numbering, end.cable.node_of("end")
    if numbering.owners[numbering.numbers[1, k]] == COMM.rank:
        gradient = system.potential.g[numbering.block(1, k)]
        np.testing.assert_allclose(end.reaction, gradient, rtol=1e-9)


def test_reactions_only_in_held_directions() -> None:
    mesh = meshes.rectangle(COMM, 100.0, 100.0, size=25.0, structured=True)
    scene = Scene(mesh, FOIL)
    scene.fix("left")
    scene.fix("right", directions="x")
    solver = advanced(Solver(scene), move={"left": (-1.0, 0.0, 0.0)})
    right = solver.reactions("right")
    assert (right.forces[:, 1:] == 0.0).all()
    np.testing.assert_allclose(right.total + solver.reactions("left").total, 0.0, atol=1e-6)
    assert right.total[0] == pytest.approx(24 * (1.01**2 - 1) / 2 * 1.01 * 100, rel=0.05)


def test_an_end_that_is_tied_to_the_membrane_has_no_reaction() -> None:
    scene = square_scene()
    cable = scene.lay_cable(Cable(EA=1.0), [(0.0, 40.0), (60.0, 53.0)])
    np.testing.assert_array_equal(cable.start.reaction, 0.0)
    with pytest.raises(InputError, match=r"the end of 'cable 1' is tied to the membrane"):
        _ = cable.end.reaction


def test_volume_under_a_tent() -> None:
    scene = square_scene(size=50.0)
    put(scene, lambda x: x + np.array([[0], [0], [1]]) * 30.0 * (np.hypot(*(x[:2] - 50)) < 1))
    # Only the top has moved, straight up: prisms with slanted tops.
    X, x = corners(scene)
    bases = np.linalg.norm(np.cross(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0]), axis=1) / 2
    slow = np.sum(bases * (x - X)[..., 2].mean(axis=1))
    assert gained_volume(scene.net) == pytest.approx(COMM.allreduce(float(slow)), rel=1e-13)
    assert gained_volume(scene.net) > 10000


@pytest.mark.ranks
def test_volume_with_folded_cells_is_what_the_pressure_works_on() -> None:
    solver = loaded_solver()
    scene = solver.scene
    assert scene.volume == pytest.approx(-scene.energies["pressure"] / 0.01, rel=1e-12)


@pytest.mark.ranks
def test_surface_has_the_fold_lines_and_no_gaps() -> None:
    solver = loaded_solver()
    scene = solver.scene
    surface = current_surface(scene.net)
    parts = COMM.allgather((surface.points, surface.stress_free, surface.triangles))
    points = np.concatenate([part[0] for part in parts])
    starts = np.cumsum([0] + [len(part[0]) for part in parts[:-1]])
    triangles = np.concatenate([part[2] + n for part, n in zip(parts, starts, strict=True)])
    # Fold points of several ranks are one.
    _, same = np.unique(np.round(points, 9), axis=0, return_inverse=True)
    sides = same.reshape(-1)[triangles[:, [[0, 1], [1, 2], [2, 0]]]].reshape(-1, 2)
    directed = {tuple(side) for side in sides.tolist()}
    assert len(directed) == len(sides), "neighbours are oriented differently"
    at = dict(zip(same.reshape(-1).tolist(), points, strict=True))
    for a, b in directed:
        if (b, a) not in directed:
            middle = (at[a] + at[b]) / 2
            assert np.min([middle[:2], 100 - middle[:2]]) < 1e-9, "a gap inside"
    for cable in scene.cables:
        numbers = [
            int(np.argmin(np.linalg.norm(points - p, axis=1))) for p in cable.state.positions
        ]
        places = same.reshape(-1)[numbers]
        folds = [k for k, node in enumerate(cable.state.nodes) if node.kind == "fold"]
        for k in folds[:-1]:
            np.testing.assert_allclose(points[numbers[k]], cable.state.positions[k], atol=1e-9)
            assert (places[k], places[k + 1]) in directed
    # Stress-free, the facets tile their cells.
    X = surface.stress_free[surface.triangles]
    areas = np.cross(X[:, 1] - X[:, 0], X[:, 2] - X[:, 0])[:, 2] / 2
    assert areas.min() > -1e-9
    of_cells = np.bincount(surface.parents, areas, minlength=len(corners(scene)[0]))
    np.testing.assert_allclose(of_cells, (100 / 7) ** 2 / 2, rtol=1e-12)


def test_slack_cables_fold_nothing() -> None:
    scene = square_scene()
    scene.lay_cable(Cable(EA=1000.0), [(0.0, 30.0), (100.0, 71.0)], L0=120.0)
    surface = current_surface(scene.net)
    cells = scene.V.dofmap.list[: scene.mesh.mesh.topology.index_map(2).size_local]
    np.testing.assert_array_equal(surface.triangles, cells)
    assert len(surface.points) == len(scene.positions())


def test_fans_avoid_triangles_without_area() -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], dtype=float)
    rings = [[(first + k) % 5 for k in range(5)] for first in range(5)]
    rings[1:1], rings[4:4] = [[0, 2, 4]], [[0, 2, 3, 4]]  # of other sizes between them
    starts = np.cumsum([0, *map(len, rings)])
    fans, polygons = best_fans(points, starts, np.concatenate(rings))
    assert list(np.bincount(polygons)) == [len(ring) - 2 for ring in rings]
    for number, ring in enumerate(rings):
        fan = points[fans[polygons == number]]
        areas = np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0])[:, 2] / 2
        assert areas.min() > 0.5
        assert areas.sum() == pytest.approx(2.0 if len(ring) == 3 else 4.0)


@pytest.mark.ranks
def test_loads_per_area(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 8, material=IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0), side=4.0)
    scene.put_load((0.0, 0.3, -0.4), name="snow", per="plan")
    scene.put_wind(0.5, lambda x, n: np.where(x[0] < 2.0, 0.7, -0.9))
    scene.put_pond(10.0, level=0.1, name="water")
    np.testing.assert_allclose(load_values(scene, "snow"), 0.5, rtol=1e-12)
    wind = load_values(scene, "wind")
    assert {*np.concatenate(comm.allgather(wind)).round(12)} == {0.7, -0.9}
    np.testing.assert_allclose(load_values(scene, "water"), 1.0, rtol=1e-12)
    with pytest.raises(InputError, match="'load hail' is not known"):
        Solver(scene).draw(None, colour="load hail")
    labels = [load_label(scene, name) for name in ("snow", "wind", "water")]
    assert labels == [
        ("snow per area", "pressure"), ("c_p of wind", ""), ("water per area", "pressure"),
    ]  # fmt: skip
    scene.u.x.array[2::3] = 0.01 * scene.V.tabulate_dof_coordinates()[:, 0]
    figure = Solver(scene).draw(None, colour="load wind", directions=True)
    assert (figure is not None) == (comm.rank == 0)
    if figure is not None:
        assert [axes.get_ylabel() for axes in figure.axes[1:]] == ["c_p of wind"]


def cap(comm: MPI.Intracomm, rise: float) -> Scene:
    """A paraboloid over a square, far from the origin."""
    mesh = meshes.rectangle(comm, 2.0, 2.0, 0.25, structured=True, corner=(-1.0, -1.0))
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.3, thickness=1.0))
    lift(scene, rise)
    return scene


def lift(scene: Scene, rise: float) -> None:
    x = scene.V.tabulate_dof_coordinates()
    scene.u.x.array[2::3] = rise * (1.0 - x[:, 0] ** 2) * (1.0 - x[:, 1] ** 2)


@pytest.mark.ranks
def test_volume_and_sides(comm: MPI.Intracomm) -> None:
    scene = cap(comm, 0.5)
    before = shape_of(scene)
    assert before.volume == pytest.approx(0.5 * (4.0 / 3.0) ** 2, rel=0.05)
    for rise in (0.5, 0.2, -0.5):
        lift(scene, rise)
        volume, turned, _ = _shape_change(before, scene)
        assert volume == pytest.approx(rise / 0.5)
        assert turned == 0.0
    scene.u.x.array[1::3] = -2.0 * scene.V.tabulate_dof_coordinates()[:, 1]  # mirrored
    assert _shape_change(before, scene)[1] == pytest.approx(1.0)


@pytest.mark.ranks
def test_a_flat_roof_encloses_nothing(comm: MPI.Intracomm) -> None:
    scene = cap(comm, 0.0)
    before = shape_of(scene)
    lift(scene, -0.3)
    assert _shape_change(before, scene)[0] is None
    assert np.isfinite(before.area)
