"""Pressure on plain and folded cells: volumes by tetrahedra, nodal forces, steps, combinatorics."""

from itertools import combinations

import numpy as np
import pytest
from dolfinx import fem
from polygon_twins import facets_of, split_polygon
from taylor import OnMesh, TermOnPoints, gradient_order, noise
from term_scene import (
    ISOTROPIC,
    cable_square,
    corners,
    directions,
    displaced,
    irregular_square,
    on_mesh,
    straight,
)

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.terms.folded_pressure import Facets, FoldedFollowerPressure
from crms_fenicsx.energy.terms.paper.step_membrane import StepPressure
from crms_fenicsx.energy.terms.pressure import FollowerPressure
from crms_fenicsx.foundation.dofs.layout import Unknowns

P = 0.01


def pressure_on(comm, kind, lift=20.0, origin=(0.0, 0.0, 0.0)):
    """A pressure term on a lifted square, its scene, and positions of the owned vertices."""
    scene = Scene(irregular_square(comm, lift), ISOTROPIC)
    plain = fem.Function(fem.functionspace(scene.mesh.mesh, ("DG", 0)))
    plain.x.array[:] = 1.0
    value = fem.Constant(scene.mesh.mesh, P)
    if kind is FollowerPressure:
        term = FollowerPressure(scene.u, plain, value, np.array(origin))
    else:
        term = StepPressure(scene.u, plain, value)
    unknowns = Unknowns(scene.V)
    return scene, term, OnMesh(unknowns, scene.u, [term]), unknowns.X[: unknowns.n_owned]


def signed_volume(triangles):
    """Volume of the tetrahedra that triangles (n, 3, 3) span with the origin."""
    return sum(np.linalg.det(t) / 6 for t in triangles)


def area_forces(unknowns, triangles, blocks):
    """A third of each triangle's area vector at its corners, on the owned points, (n, 3)."""
    forces = unknowns.vector()
    for triangle, nodes in zip(triangles, blocks, strict=True):
        vector = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0]) / 2
        for node in nodes:
            forces[1][node] += vector / 3
    unknowns.add_ghosts(forces[0])
    return forces[1][: unknowns.n_owned].copy()


def cell_blocks(scene, unknowns):
    own = scene.mesh.mesh.topology.index_map(2).size_local
    return unknowns.vertex_blocks()[scene.V.dofmap.list[:own]]


def test_energy_is_pressure_times_the_volume_gained(comm):
    scene, _, f, X = pressure_on(comm, FollowerPressure)
    energy, _ = f.value(0.1 * X + 3 * noise(X, 1))
    was, now = corners(scene)
    gained = comm.allreduce(float(signed_volume(now) - signed_volume(was)))
    assert energy == pytest.approx(-P * gained, rel=1e-11)


def test_lifted_square_has_the_volume_of_its_prism(comm):
    _, _, f, X = pressure_on(comm, FollowerPressure, lift=0.0)
    # up by 5 with walls around would be 5 x 100 x 100; the walls' third is missing
    energy, _ = f.value(np.broadcast_to((0.0, 0.0, 5.0), X.shape).copy())
    assert energy == pytest.approx(-P * 5 * 100**2 / 3, rel=1e-12)


def test_origin_does_not_matter_while_the_boundary_is_held(comm):
    energies = []
    for origin in ((0.0, 0.0, 0.0), (30.0, -50.0, 80.0)):
        scene, _, f, X = pressure_on(comm, FollowerPressure, origin=origin)
        x = 3 * noise(X, 1)
        x[scene.vertices("boundary")[scene.vertices("boundary") < len(x)]] = 0.0
        energies.append(f.value(x)[0])
    assert energies[0] == pytest.approx(energies[1], rel=1e-11)
    assert energies[0] != 0.0


@pytest.mark.ranks
@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (50.0, 50.0, 0.0)])
def test_gradient_of_the_follower_pressure(comm, origin):
    _, _, f, X = pressure_on(comm, FollowerPressure, origin=origin)
    x = 0.1 * X + 3 * noise(X, 1)
    assert gradient_order(f, x, noise(X, 2)) == pytest.approx(2, abs=0.02)


def test_follower_forces_inside_are_normal_to_the_current_surface(comm):
    scene, _, f, X = pressure_on(comm, FollowerPressure)
    _, g = f.value(3 * noise(X, 1))
    twin = -P * area_forces(f.unknowns, corners(scene)[1], cell_blocks(scene, f.unknowns))
    inside = np.ones(len(X), dtype=bool)
    boundary = scene.vertices("boundary")
    inside[boundary[boundary < len(X)]] = False
    assert comm.allreduce(int(inside.sum())) == 25
    np.testing.assert_allclose(g[inside], twin[inside], atol=1e-12)


def test_no_pressure_has_no_energy_and_no_forces(comm):
    _, term, f, X = pressure_on(comm, FollowerPressure)
    term.pressure.value = 0.0
    energy, g = f.value(3 * noise(X, 1))
    assert energy == 0.0
    assert not np.any(g)


def test_step_pressure_keeps_the_forces_of_the_steps_start(comm):
    scene, _, f, X = pressure_on(comm, StepPressure)
    start = 3 * noise(X, 1)
    f.value(start)
    f.potential.begin_step()
    twin = -P * area_forces(f.unknowns, corners(scene)[1], cell_blocks(scene, f.unknowns))
    energy, g = f.value(start)
    assert energy == 0.0
    np.testing.assert_allclose(g, twin, atol=1e-12)
    d = 5 * noise(X, 2)
    energy, g = f.value(start + d)
    np.testing.assert_allclose(g, twin, atol=1e-12)
    assert energy == pytest.approx(f.dot(twin, d), rel=1e-12)


def test_step_pressure_sums_up_its_steps(comm):
    """Steps add up, and more of them come closer to the exact work, with order 1."""
    errors = []
    for steps in (4, 8, 16, 32):
        scene, _, f, X = pressure_on(comm, StepPressure, lift=20.0)
        boundary = scene.vertices("boundary")
        d = 20 * noise(X, 1)
        d[boundary[boundary < len(d)]] = 0.0
        f.value(0 * d)
        for k in range(steps):
            f.potential.begin_step()
            energy, _ = f.value((k + 1) / steps * d)
            f.potential.commit()
        was, now = corners(scene)
        exact = -P * comm.allreduce(float(signed_volume(now) - signed_volume(was)))
        errors.append(abs(energy - exact))
    order = np.polyfit(np.log([4, 8, 16, 32]), np.log(errors), 1)[0]
    assert order == pytest.approx(-1, abs=0.1)


# Folded cells


def reversed_twice(facets):
    """Weights of directed sides of facets, opposite ones subtracted."""
    sides = {}
    for corners_, weight in zip(*facets, strict=True):
        for k in range(3):
            a, b = corners_[k], corners_[(k + 1) % 3]
            sides[a, b] = sides.get((a, b), 0.0) + weight
            sides[b, a] = sides.get((b, a), 0.0) - weight
    return sides


@pytest.mark.parametrize("n", [3, 4, 5, 7])
def test_fans_cover_a_polygon_once(n):
    polygon = [11, 5, 8, 2, 31, 17, 4][:n]
    facets = facets_of([polygon])
    assert len({tuple(sorted(f)) for f in facets[0]}) == len(facets[0]), "no facet twice"
    border = set(zip(polygon, polygon[1:] + polygon[:1], strict=True))
    for side, weight in reversed_twice(facets).items():
        back = side[::-1] in border
        assert weight == pytest.approx(1 if side in border else (-1 if back else 0), abs=1e-14)
    assert facets[1].sum() == pytest.approx(n - 2)


def fan_volume(polygon, points):
    """Mean of the volumes under the fans from every corner of a polygon."""
    n = len(polygon)
    total = 0.0
    for first in range(n):
        fan = [points[polygon[(first + k) % n]] for k in range(n)]
        total += signed_volume([(fan[0], fan[k], fan[k + 1]) for k in range(1, n - 1)]) / n
    return total


@pytest.mark.parametrize("n", [3, 4, 5, 7])
def test_volume_under_a_bent_polygon(n):
    rng = np.random.default_rng(n)
    X = rng.normal(size=(n + 2, 3))
    polygon = rng.permutation(n + 2)[:n].tolist()
    f = folded_pressure(X, facets_of([polygon]), np.zeros((0, 3), dtype=np.int32))
    x = rng.normal(size=X.shape)
    volume = -f.value(x)[0] / P
    assert volume == pytest.approx(fan_volume(polygon, X + x), rel=1e-12)


def test_mirrored_polygons_have_mirrored_volumes():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(6, 3))
    mirror = points * (1, -1, 1)
    polygon = [0, 1, 2, 3, 4, 5]
    none = np.zeros((0, 3), dtype=np.int32)
    there = folded_pressure(points, facets_of([polygon]), none).value(0 * points)
    back = folded_pressure(mirror, facets_of([polygon[::-1]]), none).value(0 * points)
    assert there[0] == pytest.approx(back[0], rel=1e-12)
    np.testing.assert_allclose(there[1], back[1] * (1, -1, 1), atol=1e-14)


def folded_pressure(X, facets, plain, origin=(0.0, 0.0, 0.0)):
    class Value:
        value = P

    table = Facets(
        *facets,
        np.asarray(plain, dtype=np.int32).reshape(-1, 3),
    )
    return TermOnPoints(FoldedFollowerPressure(table, Value(), np.array(origin)), X)


def test_split_without_chords():
    assert split_polygon([4, 7, 9], []) == [[4, 7, 9]]


def test_split_keeps_orientation_and_shares_chords():
    """Every side of the polygon is in one part, every chord in two, once in each direction."""
    polygon = [0, 10, 1, 11, 12, 2, 13, 14]
    chords = [(10, 14), (11, 13), (1, 13)]
    parts = split_polygon(polygon, chords)
    assert sorted(map(len, parts)) == [3, 3, 4, 4]
    sides = [side for part in parts for side in zip(part, part[1:] + part[:1], strict=True)]
    assert len(sides) == len(set(sides))
    border = set(zip(polygon, polygon[1:] + polygon[:1], strict=True))
    assert set(sides) == border | set(chords) | {(b, a) for a, b in chords}


def test_chords_along_a_side_or_to_other_places_split_nothing():
    polygon = [0, 10, 1, 2]
    for chord in ((0, 10), (2, 0), (1, 99)):
        assert split_polygon(polygon, [chord]) == [polygon]


def test_split_areas_add_up():
    rng = np.random.default_rng(4)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
    ring = np.column_stack([np.cos(angles), np.sin(angles)])

    def area(part):
        x, y = ring[part].T
        return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2

    parts = split_polygon(list(range(9)), [(1, 6), (2, 5), (7, 0)])
    assert len(parts) == 4
    assert all(area(part) > 0 for part in parts)
    assert sum(map(area, parts)) == pytest.approx(area(list(range(9))))


@pytest.mark.parametrize("seed", range(6))
def test_split_along_chords_that_cross(seed):
    """Five random chords of a polygon: each part lies on one side of each chord."""
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi * (np.arange(10) + rng.uniform(-0.4, 0.4, 10)) / 10
    places = list(np.column_stack([np.cos(angles), np.sin(angles)]))
    ends = rng.permutation(10).reshape(5, 2).tolist()
    along = {chord: [(0.0, a), (1.0, b)] for chord, (a, b) in enumerate(ends)}
    for one, other in combinations(along, 2):
        a, b, p, q = (places[k] for k in (*ends[one], *ends[other]))
        s, t = np.linalg.solve(np.column_stack([b - a, p - q]), p - a)
        if 0 < s < 1 and 0 < t < 1:
            along[one].append((s, len(places)))
            along[other].append((t, len(places)))
            places.append(a + s * (b - a))
    crossings, x = len(places) - 10, np.array(places)
    assert crossings > 0

    parts = split_polygon(list(range(10)), [[k for _, k in sorted(c)] for c in along.values()])
    inner = sum(abs(a - b) not in (1, 9) for a, b in ends)  # not along a side
    assert len(parts) == 1 + inner + crossings

    def turn(u, v):
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    def area(part):
        return turn(x[part], np.roll(x[part], -1, axis=0)).sum() / 2

    assert min(map(area, parts)) > 0
    assert sum(map(area, parts)) == pytest.approx(area(list(range(10))), rel=1e-12)
    for part in parts:
        for a, b in ends:
            sides = turn(x[b] - x[a], x[part] - x[a])
            assert sides.min() > -1e-12 or sides.max() < 1e-12


def test_a_chord_that_ends_inside_cuts_only_from_shared_point_to_shared_point():
    """As that of a cable whose end is tied inside the cell, beyond another cable."""
    polygon, across = [0, 10, 1, 2, 11], [10, 20, 11]
    assert split_polygon(polygon, [[99, 98]]) == [polygon]
    parts = split_polygon(polygon, [across, [99, 20, 2]])
    assert sorted(sorted(part) for part in parts) == [
        [0, 10, 11, 20],
        [1, 2, 10, 20],
        [2, 11, 20],
    ]


def folded_cell(turn):
    """A cell with fold points 3 and 4 on two sides; facets, plain corners."""
    polygon, chord = [0, 3, 1, 4, 2], (3, 4)
    parts = split_polygon(polygon[:: -1 if turn else 1], [chord])
    return facets_of(parts), [(0, 1, 2)]


def test_volume_under_a_folded_cell():
    """The tip j-p-q, and the rest by both of its diagonals, as signed tetrahedra."""
    i, j, k, p, q = points = np.random.default_rng(2).normal(size=(5, 3))
    one = signed_volume([(p, j, q), (i, p, q), (i, q, k)])
    other = signed_volume([(p, j, q), (i, p, k), (p, q, k)])
    assert abs(one - other) > 1e-2, "the rest is not plane"
    origin = np.array([0.3, -0.2, 0.1])
    facets, plain = folded_cell(False)
    free = folded_pressure(points, facets, plain)
    gained = (one + other) / 2 - signed_volume([(i, j, k)])
    assert free.value(0 * points)[0] == pytest.approx(-P * gained, rel=1e-12)
    # another origin changes it by that of a shifted cell
    away = folded_pressure(points + origin, facets, plain, origin)
    assert away.value(0 * points)[0] == pytest.approx(-P * gained, rel=1e-12)


def test_mirrored_folded_cells_have_mirrored_forces():
    points = np.random.default_rng(2).normal(size=(5, 3))
    there = folded_pressure(points, *folded_cell(False)).value(0 * points)[1]
    facets, _ = folded_cell(True)
    back = folded_pressure(points * (1, -1, 1), facets, [(2, 1, 0)]).value(0 * points)[1]
    np.testing.assert_allclose(there, back * (1, -1, 1), atol=1e-15)


@pytest.mark.ranks
@pytest.mark.parametrize("size", [0.3, 3.0])
def test_gradient_on_folded_cells(comm, size):
    system = cable_square(comm)
    f = on_mesh(system, "FoldedFollowerPressure")
    x = displaced(f.unknowns, size)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.03), name


def test_straight_folds_have_the_volume_of_plain_cells(comm):
    system = cable_square(comm)
    x = straight(system)
    energy, _ = on_mesh(system, "FollowerPressure", "FoldedFollowerPressure").value(x)
    was, now = (places - system.scene.membrane.centre for places in corners(system.scene))
    gained = comm.allreduce(float(signed_volume(now) - signed_volume(was)))
    assert energy == pytest.approx(-P * gained, rel=1e-10)
    assert comm.allreduce(int(np.sum(system.membrane.energy.plain.x.array == 0))) > 20


@pytest.mark.ranks
def test_folded_lagged_pressure(comm):
    """Linear in a step with the forces of the step's start, which are a third of each facet's
    area vector; steps add up."""
    system = cable_square(comm, pressure="lagged")
    f = on_mesh(system, "FoldedLaggedPressure")
    unknowns, facets = f.unknowns, system.cables.tables.facets
    start, d = displaced(unknowns, 2.0), noise(unknowns.X[: unknowns.n_owned], 8)
    before = f.value(start)[0]
    f.potential.begin_step()
    energy, g = f.value(start)
    assert energy == pytest.approx(0.0, abs=1e-12)
    assert before == 0.0, "no step has begun"
    now = (unknowns.X + f.potential.x)[facets.corners]
    scaled = now - now.mean(axis=1, keepdims=True)
    scaled *= np.sqrt(facets.weights)[:, None, None]  # the area vector grows with the square
    # tied points hand their forces on, so compare by the work along a displacement that they follow
    f.value(start + d)
    moved = f.potential.x.copy()
    f.value(start)
    step = moved - f.potential.x
    vectors = np.cross(scaled[:, 1] - scaled[:, 0], scaled[:, 2] - scaled[:, 0]) / 2
    work = np.einsum("ni,nki->", vectors / 3, step[facets.corners])
    expected = -P * comm.allreduce(float(work))
    assert f.dot(g, d) == pytest.approx(expected, rel=1e-11)
    energy, again = f.value(start + d)
    assert energy == pytest.approx(expected, rel=1e-11)
    np.testing.assert_allclose(again, g, atol=1e-13)
    f.potential.commit()
    f.potential.begin_step()
    energy, g = f.value(start + 2 * d)
    assert energy == pytest.approx(expected + f.dot(g, d), rel=1e-11)


def test_step_forces_on_plain_and_folded_cells_add_up(comm):
    """With straight folds all nodal forces balance those of plain cells."""
    system = cable_square(comm, pressure="lagged")
    f = on_mesh(system, "StepPressure", "FoldedLaggedPressure")
    f.value(straight(system))
    f.potential.begin_step()
    _, g = f.value(straight(system))
    _, now = corners(system.scene)
    total = sum((np.cross(t[1] - t[0], t[2] - t[0]) / 2 for t in now), np.zeros(3))
    np.testing.assert_allclose(
        comm.allreduce(g.sum(axis=0)), -P * comm.allreduce(total), atol=1e-10
    )
