"""Layout of the unknowns: numbering, ghosts, tied points; the whole potential on any ranks."""

import numpy as np
import pytest
from mpi4py import MPI
from numpy.testing import assert_allclose, assert_array_equal
from petsc4py import PETSc
from table_twins import points_by_edge
from taylor import OnMesh, gradient_order, is_semidefinite, noise, stiffness_error
from term_scene import (
    FABRIC,
    ISOTROPIC,
    cable_square,
    directions,
    displaced,
    irregular_square,
    on_mesh,
)

from crms_fenicsx import Cable, EnergyTerm, Scene
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.cabling.cables.node_positions import NodePositions
from crms_fenicsx.foundation.dofs.layout import Unknowns
from crms_fenicsx.foundation.meshes import from_arrays
from crms_fenicsx.foundation.runtime.compat import geometry_dofmap
from crms_fenicsx.model.laid_cable import polyline_length

pytestmark = pytest.mark.ranks


class Springs(EnergyTerm):
    """Half the square of the distance from one place of all points, vertices only counted where
    owned: a term to watch forces on."""

    name = "springs"

    def sums(self, x, out):
        self.r = self.unknowns.X + x - (1.0, 2.0, 30.0)
        out[0] = (self.r[: self.unknowns.n_owned] ** 2).sum() / 2

    def add_gradient(self, x, sums, g):
        g[: self.unknowns.n_owned] += self.r[: self.unknowns.n_owned]


def with_points(comm, foreign=True):
    """A square's vertices and rank + 2 points on each rank, the first of every other a ghost."""
    scene = Scene(irregular_square(comm), ISOTROPIC)
    others = [r for r in range(comm.size) if r != comm.rank] if foreign else []
    unknowns = Unknowns(scene.V, comm.rank + 2, [(r, 1) for r in others])
    return scene, unknowns, others


def test_numbers_are_rank_by_rank_vertices_first(comm):
    scene, unknowns, others = with_points(comm)
    vertices = scene.V.dofmap.index_map
    sizes = comm.allgather((vertices.size_local, comm.rank + 2))
    assert unknowns.n_global == sum(a + b for a, b in sizes)
    assert unknowns.start == sum(a + b for a, b in sizes[: comm.rank])
    assert unknowns.n_owned == sum(sizes[comm.rank])
    assert unknowns.n_local == unknowns.n_owned + vertices.num_ghosts + len(others)
    groups = [
        unknowns.vertex_blocks(), unknowns.owned_point_blocks(), unknowns.ghost_point_blocks()
    ]  # fmt: skip
    assert sorted(np.concatenate(groups).tolist()) == list(range(unknowns.n_local))
    assert len(unknowns.owned_point_blocks()) == comm.rank + 2
    starts = np.cumsum([0] + [a + b for a, b in sizes])
    twin = [starts[r] + sizes[r][0] + 1 for r in others]
    assert unknowns.ghosts[vertices.num_ghosts :].tolist() == twin


def test_vertices_are_where_the_mesh_has_them(comm):
    scene, unknowns, _ = with_points(comm)
    X, mesh = unknowns.X[unknowns.vertex_blocks()], scene.V.mesh
    for dofs, nodes in zip(scene.V.dofmap.list, geometry_dofmap(mesh), strict=True):
        assert_array_equal(X[dofs], mesh.geometry.x[nodes])
    assert_allclose(X, scene.V.tabulate_dof_coordinates(), rtol=0, atol=1e-12)
    assert not unknowns.held.any()


def test_ghosts_take_their_owners_values_and_give_forces_back(comm):
    _, unknowns, others = with_points(comm)
    vector, array = unknowns.vector()
    n = unknowns.n_owned
    number = unknowns.start + np.arange(n)
    array[:n] = number[:, None] + np.array([0.1, 0.2, 0.3])
    unknowns.update_ghosts(vector)
    assert_allclose(array[n:], unknowns.ghosts[:, None] + np.array([0.1, 0.2, 0.3]), rtol=1e-15)
    array[:] = 1.0
    unknowns.add_ghosts(vector)
    # each owned point counts the ranks that hold it
    seen = np.concatenate(comm.allgather(unknowns.ghosts))
    copies = 1 + np.array([np.count_nonzero(seen == k) for k in number])
    assert_array_equal(array[:n], np.repeat(copies[:, None], 3, axis=1))
    assert comm.size == 1 or (copies > 1).any()
    assert len(others) == comm.size - 1


def test_layout_without_points_is_the_vertices(comm):
    scene = Scene(irregular_square(comm), ISOTROPIC)
    unknowns = Unknowns(scene.V)
    assert unknowns.n_global == scene.V.dofmap.index_map.size_global
    assert_array_equal(unknowns.vertex_blocks(), np.arange(unknowns.n_local))


def ridden(comm):
    """Two points on each rank ride on vertices, ghosts among them where there are any."""
    scene = Scene(irregular_square(comm), ISOTROPIC)
    unknowns = Unknowns(scene.V, 3)
    first, second, free = unknowns.owned_point_blocks()
    rng = np.random.default_rng(comm.rank)
    unknowns.X[[first, second, free]] = rng.uniform(0, 50, (3, 3))
    interpolation = unknowns.vertex_blocks()[[-1, -2, 0, 1, -3, -3]].reshape(2, 3)
    weights = np.array([(0.2, 0.3, 0.5), (0.6, 0.4, 0.0)])
    unknowns.set_tied_points(np.array([first, second], dtype=np.int32), interpolation, weights)
    return scene, unknowns, (first, second, free)


def test_products_of_vectors_do_not_depend_on_where_they_lie(comm):
    """Evenly in memory or not: PETSc's updates of the Hessian have the same bits."""
    mesh = from_arrays(comm, [(0, 0), (1, 0), (0, 1)], [(0, 1, 2)])
    unknowns = Unknowns(Scene(mesh, ISOTROPIC).V, 1000)
    x, array = unknowns.vector()
    array[:] = noise(array, 1)
    n, twins = array.size, []
    for step in (n, 2 * n + 10):
        places, at, others = np.zeros(40 * n), 0, []
        for k in range(7):
            values = places[at : at + n]
            values[:] = noise(array, 2 + k).ravel()
            size = (3 * unknowns.n_owned, 3 * unknowns.n_global)
            others.append(
                PETSc.Vec().createGhostWithArray(
                    unknowns.ghosts, values, size=size, bsize=3, comm=comm
                )
            )
            at += n if step == n else step + 100 * k % 300
        twins.append(x.mDot(others))
    assert_array_equal(*twins)


def test_tied_points_are_at_the_weighted_mean_of_their_vertices(comm):
    scene, unknowns, (first, second, free) = ridden(comm)
    f = OnMesh(unknowns, scene.u, [Springs()])
    x = noise(unknowns.X[: unknowns.n_owned], 1)
    f.value(x)
    places = unknowns.X + f.potential.x
    for tied_point, interpolation, weights in zip(
        (first, second), unknowns.interpolation, unknowns.weights, strict=True
    ):
        assert_allclose(places[tied_point], weights @ places[interpolation], atol=1e-12)
    assert_array_equal(f.potential.x[free], x[free])
    assert unknowns.held[[first, second]].all()
    assert not unknowns.held[free].any()


def test_idle_tied_points_are_placed_on_demand(comm):
    scene, unknowns, (first, second, _) = ridden(comm)
    parts = unknowns.tied_points, unknowns.interpolation, unknowns.weights
    unknowns.set_tied_points(*parts, n_loaded=1)
    f = OnMesh(unknowns, scene.u, [Springs()])
    x = noise(unknowns.X[: unknowns.n_owned], 1)
    f.value(x)
    expected = np.einsum("nk,nki->ni", parts[2], (unknowns.X + f.potential.x)[parts[1]])
    places = (unknowns.X + f.potential.x)[[first, second]]
    assert_allclose(places[0], expected[0], atol=1e-12)
    assert np.abs(places[1] - expected[1]).max() > 1e-3
    unknowns.place_idle_tied_points(f.potential.x)
    places = (unknowns.X + f.potential.x)[[first, second]]
    assert_allclose(places, expected, atol=1e-12)


def test_tied_points_hand_on_their_forces_by_virtual_work(comm):
    """Force on tied points times their motion is that on their vertices times theirs."""
    scene, unknowns, (first, second, _) = ridden(comm)
    f = OnMesh(unknowns, scene.u, [Springs()])
    n = unknowns.n_owned
    x, d = noise(unknowns.X[:n], 1), noise(unknowns.X[:n], 2)
    f.value(x + d)
    motion = f.potential.x.copy()
    _, g = f.value(x)
    motion -= f.potential.x
    raw = (unknowns.X + f.potential.x - (1.0, 2.0, 30.0))[:n]
    work = comm.allreduce(float(np.vdot(raw, motion[:n])))
    assert f.dot(g, d) == pytest.approx(work, rel=1e-12)
    assert not np.any(g[[first, second]])
    assert gradient_order(f, x, d) == pytest.approx(2, abs=0.01)


def test_spread_hands_stiffness_on_to_vertices(comm):
    """Against the dense transformation P^T K P of all local blocks."""
    _, unknowns, _ = ridden(comm)
    n = unknowns.n_local
    rng = np.random.default_rng(0)
    rows, cols = rng.integers(0, n, (2, 60)).astype(np.int32)
    rows[:6] = np.repeat(unknowns.tied_points, 3)
    cols[:6] = np.tile(unknowns.tied_points, 3)
    values = rng.normal(size=(60, 3, 3))

    def dense(rows, cols, values):
        K = np.zeros((n, n, 3, 3))
        for i, j, v in zip(rows, cols, values, strict=True):
            K[i, j] += v
        return K

    P = np.eye(n)
    P[unknowns.tied_points] = 0.0
    for tied_point, interpolation, weights in zip(
        unknowns.tied_points, unknowns.interpolation, unknowns.weights, strict=True
    ):
        for master, weight in zip(interpolation, weights, strict=True):
            P[tied_point, master] += weight
    twin = np.einsum("ia,ijkl,jb->abkl", P, dense(rows, cols, values), P)
    places, sources, weights = unknowns.spread(rows, cols)
    spread = dense(*places, weights[:, None, None] * values[sources])
    assert_allclose(spread, twin, atol=1e-12)


# The whole potential

SHAKEN = pytest.mark.parametrize("size", [0.3, 1.0])
CHOICES = {
    "isotropic": (ISOTROPIC, {}),
    "fabric": (FABRIC, {}),
    "literal penalty": (ISOTROPIC, {"literal_penalty": 30.0}),
}
every_choice = pytest.mark.parametrize("choice", CHOICES.values(), ids=CHOICES.keys())


def test_the_scene_has_everything(comm):
    system = cable_square(comm)
    kinds = {node.kind for cable in system.scene.cables for node in cable.state.nodes}
    assert kinds == {"anchor", "tied", "fold", "vertex"}
    names = {type(term).__name__ for term in system.potential.terms}
    assert names == {
        "MembraneEnergy", "FollowerPressure", "CableTension", "FoldedMembraneEnergy", "FoldPenalty",
        "FoldedFollowerPressure",
    }  # fmt: skip
    shared = points_by_edge(system.scene.cables).values()
    assert max(len({c for _, c, _ in points}) for points in shared) == 2, "cables share an edge"


@every_choice
@SHAKEN
def test_gradient_of_the_whole_potential(comm, choice, size):
    material, choices = choice
    f = on_mesh(cable_square(comm, material, **choices))
    x = displaced(f.unknowns, size)
    for name, d in directions(f.unknowns).items():
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.05), name


def test_gradient_with_slack_cables(comm):
    """Their points ride, and the membrane is plain."""
    system = cable_square(comm, taut=False)
    assert system.unknowns.n_owned - system.unknowns.n_vertices <= system.unknowns.held.sum()
    f = on_mesh(system)
    x = displaced(f.unknowns, 1.0)
    assert gradient_order(f, x, directions(f.unknowns)["all"]) == pytest.approx(2, abs=0.02)
    assert f.value(x)[0] != 0.0


def fingerprint(comm, choice, size):
    """Numbers that tell one potential from another: energies, gradient, stiffness, scale."""
    material, choices = choice
    system = cable_square(comm, material, **choices)
    f = on_mesh(system)
    x, d = displaced(f.unknowns, size), directions(f.unknowns)
    energy, g = f.value(x)
    terms = system.potential.terms
    single = [OnMesh(f.unknowns, system.scene.u, [term]).value(x)[1] for term in terms]
    NodePositions(system.cables.numbering, f.unknowns).gather(f.potential.x)
    cables = system.scene.cables
    lengths = [polyline_length(cable.state.positions[cable.contacts()]) for cable in cables]
    return np.array(
        [
            energy,
            f.dot(g, g),
            *(f.dot(g, direction) for direction in d.values()),
            *(f.dot(one, one) for one in single),
            *(f.dot(d[name], f.times(x, d[name])) for name in d),
            f.potential.evaluate_terms()[1],
            *lengths,
        ]
    )


@every_choice
def test_potential_does_not_depend_on_the_number_of_ranks(comm, choice):
    together = fingerprint(comm, choice, 1.0)
    alone = fingerprint(MPI.COMM_SELF, choice, 1.0)
    assert_allclose(together, alone, rtol=1e-10)


@every_choice
def test_stiffness_of_the_whole_potential_is_semidefinite(comm, choice):
    material, choices = choice
    f = on_mesh(cable_square(comm, material, **choices))
    assert is_semidefinite(f.matrix(displaced(f.unknowns, 1.0)))


def test_single_terms_add_up(comm):
    system = cable_square(comm)
    f = on_mesh(system)
    x = displaced(f.unknowns, 1.0)
    energy, g = f.value(x)
    named = f.potential.energies()
    assert set(named) == {"membrane", "pressure", "cables", "penalty"}
    assert sum(named.values()) == pytest.approx(energy, rel=1e-13)
    parts = [OnMesh(f.unknowns, system.scene.u, [t]).value(x) for t in system.potential.terms]
    assert sum(w for w, _ in parts) == pytest.approx(energy, rel=1e-13)
    assert_allclose(sum(g for _, g in parts), g, atol=1e-9)
    largest = max(np.sqrt(f.dot(*2 * [np.where(held(f), 0, g)])) for _, g in parts)
    assert f.potential.evaluate_terms()[1] == pytest.approx(largest, rel=1e-12)


def held(f):
    return f.unknowns.held[: f.unknowns.n_owned]


def test_minimiser_gets_no_force_on_held_components(comm):
    f = on_mesh(cable_square(comm))
    x = displaced(f.unknowns, 1.0)
    energy, g = f.value(x)
    assert np.any(comm.allreduce(int(np.count_nonzero(g[held(f)]))))
    X = f.potential.x_vector.duplicate()
    G = f.potential.g_vector.duplicate()
    X.setArray(x.ravel())
    assert f.potential.objective_gradient(None, X, G) == pytest.approx(energy, rel=1e-14)
    assert_allclose(G.getArray().reshape(-1, 3), np.where(held(f), 0.0, g), rtol=1e-12, atol=1e-9)
    X.destroy()
    G.destroy()


def equilateral(comm):
    """A parallelogram of equilateral triangles of side 10, and a cable that ends inside it."""
    n = 6
    numbers = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]
    cells = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, d), (b, c, d))])
    i, j = np.divmod(np.arange(numbers.size), n + 1)
    points = 10.0 * np.column_stack([i + j / 2, np.sqrt(3) / 2 * j])
    scene = Scene(from_arrays(comm, points, cells), ISOTROPIC)
    scene.lay_cable(Cable(1000.0), [(22, 11), (66, 43)], tension=5.0)
    scene.lay_cable(Cable(1000.0), [(33, 9), (70, 33)], tension=5.0)
    return System(scene, "crms_test_", 1e-8)


def test_stiffness_with_tied_points_and_folded_cells_is_exact_under_tension(comm):
    """Stretched alike in all directions, every side of an equilateral triangle pulls."""
    system = equilateral(comm)
    system.membrane.energy.stiffening.floor.value = 0.0
    f = on_mesh(system, "MembraneEnergy", "FoldedMembraneEnergy")
    x = displaced(f.unknowns, 0.05, stretch=1.3)
    f.value(x)
    assert system.folds.energy.forces.min(initial=1.0) > 0
    assert comm.allreduce(len(system.folds.energy.forces)) > 50
    assert comm.allreduce(f.unknowns.n_tied_points) >= 4
    for name, d in directions(f.unknowns).items():
        assert stiffness_error(f, x, d) < 1e-7, name
