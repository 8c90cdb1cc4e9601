"""Which vertices of rows shift, and in which directions."""

from __future__ import annotations

import numpy as np
import pytest
from grids import alternating, grid, numbered
from lined_roof import CELLS, LINES, SIDE, STEEL, bare_scene, lined_roof, lined_scene
from mpi4py import MPI

from crms_fenicsx import IsotropicMembrane, Scene, meshes
from crms_fenicsx.analysis.equilibrium.shift_contribution import kept_vertices
from crms_fenicsx.cabling.cables.points_on_edges import NodeTable
from crms_fenicsx.cabling.cables.row_shifts import RowShifts, fixed_vertices
from crms_fenicsx.foundation.runtime.arrays import Array

H = SIDE / CELLS


def shifts(scene: Scene) -> tuple[RowShifts, Array]:
    """Those of a scene and the places of their vertices in its plan, in cells."""
    net = scene.net
    found = RowShifts.of(
        net.cables, net.nodes, net.strip_shape(), scene.membrane, kept_vertices(scene)
    )
    assert isinstance(net.nodes, NodeTable)
    ids, X = scene.membrane.vertex_ids, scene.membrane.stress_free
    table = {}
    for part in scene.comm.allgather(dict(zip(ids.tolist(), X[:, :2].tolist(), strict=True))):
        table |= part
    return found, np.array([table[v] for v in found.vertices.tolist()]).reshape(-1, 2) / H


def taut(scene: Scene) -> None:
    for cable in scene.cables:
        cable.update(taut=True)


@pytest.mark.ranks
def test_vertices_between_ends_shift_across_their_row(comm: MPI.Intracomm) -> None:
    """Within the surface; where two rows cross in all its directions, and the same on all ranks."""
    scene, _ = lined_scene(lined_roof(comm), True, hold="outside")
    taut(scene)
    found, places = shifts(scene)
    expected = {(k, j) for family, k in LINES.values() if family == 0 for j in range(1, CELLS)}
    expected |= {(i, k) for family, k in LINES.values() if family == 1 for i in range(1, CELLS)}
    assert {tuple(round(v) for v in p) for p in places} in (
        expected, {(j, i) for i, j in expected},
    )  # fmt: skip
    assert len(found.vertices) == 3 * (CELLS - 1) - 2
    assert np.all(np.diff(found.vertices) > 0) and not found.held.any()
    for P, p in zip(found.projectors, places, strict=True):
        np.testing.assert_allclose(P @ P, P, atol=1e-14)
        x, y = np.pi * p / CELLS
        slope = 1.2 * np.pi / SIDE * np.array([np.cos(x) * np.sin(y), np.sin(x) * np.cos(y)])
        normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope @ slope)
        crossing = round(np.trace(P)) == 2
        assert np.linalg.norm(P @ normal) < 0.06  # normals of facets of a cell of an eighth
        families = [family for family, k in LINES.values() if round(p[family]) == k]
        assert len(families) == 1 + crossing
        if not crossing:
            along = np.zeros(3)
            along[1 - families[0]] = 1.0
            along[2] = slope[1 - families[0]]
            assert np.linalg.norm(P @ along) < 0.06 * np.linalg.norm(along)
    assert np.all((found.sizes > 0.4 * H) & (found.sizes < 2 * H))
    every = comm.allgather((found.vertices, found.projectors))
    assert all(np.array_equal(a, b) for one in every for a, b in zip(one, every[0], strict=True))


def test_slack_cables_pockets_and_bonds_do_not_slide(comm: MPI.Intracomm) -> None:
    """One that is slack or in a pocket leaves the vertex at a crossing one direction, along its
    row in a pocket; a bond or two pockets leave none."""
    scene = bare_scene(lined_roof(comm))
    a = scene.lay_cable(STEEL, along="A1", hold="outside", tension=2.0)
    assert len(shifts(scene)[0].vertices) == CELLS - 1
    a.update(taut=False)
    assert len(shifts(scene)[0].vertices) == 0
    a.update(taut=True)
    b = scene.lay_cable(STEEL, along="B1", hold="outside", tension=2.0)
    b.update(taut=False)
    found, places = shifts(scene)
    assert len(found.vertices) == CELLS - 1
    np.testing.assert_allclose(np.trace(found.projectors, axis1=1, axis2=2), 1.0)
    b.update(taut=True, hold="pocket")
    found, places = shifts(scene)
    assert len(found.vertices) == CELLS - 1
    (family, k), (other, j) = LINES["A1"], LINES["B1"]
    at = np.flatnonzero((np.round(places[:, family]) == k) & (np.round(places[:, other]) == j))
    row = np.zeros(3)
    row[1 - other] = 1.0
    assert np.linalg.norm(found.projectors[at[0]] @ row) > 0.95
    b.update(hold="bonded")
    assert len(shifts(scene)[0].vertices) == CELLS - 2
    b.update(hold="pocket")
    a.update(hold="pocket")
    assert len(shifts(scene)[0].vertices) == 0


def test_ends_lifted_vertices_and_supports_stay(comm: MPI.Intracomm) -> None:
    scene = bare_scene(lined_roof(comm))
    a = scene.lay_cable(STEEL, along="A1", hold="outside", tension=2.0)
    lifted = a.state.lifted.copy()
    lifted[3:5] = True
    a.update(lifted=lifted)
    assert len(shifts(scene)[0].vertices) == CELLS - 3
    a.update(lifted=np.zeros(len(lifted), dtype=bool))
    family, k = LINES["A1"]
    scene = bare_scene(lined_roof(comm))
    scene.fix(lambda x: abs(x[family] - k * H) + abs(x[1 - family] - 4 * H) < 0.1, "z")
    scene.lay_cable(STEEL, along="A1", hold="outside", tension=2.0)
    assert len(shifts(scene)[0].vertices) == CELLS - 2
    assert fixed_vertices(scene.membrane, kept_vertices(scene)).any()


def test_vertices_of_a_rigid_sheet_are_held_there(comm: MPI.Intracomm) -> None:
    """They go with their stress-free places."""
    scene = bare_scene(lined_roof(comm))
    scene.fix(lambda x: x[0] > -1.0)
    scene.lay_cable(STEEL, along="A1", hold="outside", tension=2.0)
    found, _ = shifts(scene)
    assert len(found.vertices) == CELLS - 1 and found.held.all()


def test_borders_of_materials_stay(comm: MPI.Intracomm) -> None:
    """A cable does not slide from one fabric into another, nor along a border."""
    at, numbers = np.linspace(0.0, SIDE, CELLS + 1), numbered(CELLS + 1, CELLS + 1)
    points, cells = grid(at, at, other=alternating(CELLS, CELLS))
    left = points[cells, 0].mean(axis=1) < SIDE / 2
    row = numbers[:, 3]
    mesh = meshes.from_arrays(
        comm, points, cells, edges={"A": np.stack([row[:-1], row[1:]], axis=1)},
        parts={"left": np.flatnonzero(left), "right": np.flatnonzero(~left)},
    )  # fmt: skip
    fabric = IsotropicMembrane(E=800.0, nu=0.3, thickness=1.0)
    scene = Scene(mesh, {"left": fabric, "right": fabric})
    scene.fix("boundary")
    scene.lay_cable(STEEL, along="A", tension=2.0)
    _, places = shifts(scene)
    assert sorted(np.round(places[:, 0]).astype(int)) == [1, 2, 3, 5, 6, 7]


def test_renewed_directions_keep_the_vertices(comm: MPI.Intracomm) -> None:
    """Also of one that has none now."""
    scene, _ = lined_scene(lined_roof(comm), True, hold="outside")
    taut(scene)
    found, _ = shifts(scene)
    n = len(found.vertices)
    fewer = RowShifts(
        found.nodes[1:], found.vertices[1:], 0.5 * found.projectors[1:], found.held[1:],
        2 * found.sizes[1:],
    )  # fmt: skip
    for other, here in ((fewer, n - 1), (RowShifts.none(), 0)):
        new = found.renewed(other)
        np.testing.assert_array_equal(new.vertices, found.vertices)
        np.testing.assert_array_equal(new.projectors[: n - here], found.projectors[: n - here])
        np.testing.assert_array_equal(new.sizes[n - here :], 2 * found.sizes[n - here :])
        np.testing.assert_array_equal(
            new.projectors[n - here :], 0.5 * found.projectors[n - here :]
        )
