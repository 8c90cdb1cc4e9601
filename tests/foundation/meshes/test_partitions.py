"""Meshes shared out as the caller wants: nothing that is computed depends on who owns what."""

import functools

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI

from crms_fenicsx import Cable, Friction, IsotropicMembrane, OrthotropicMembrane, Solver, meshes
from crms_fenicsx.foundation.runtime.errors import MeshError
from crms_fenicsx.results.output import draw

pytestmark = [pytest.mark.usefixtures("comm"), pytest.mark.ranks]

SIDE, CELLS = 100.0, 7
CROSSING = (40.0, 33.0)
FABRIC = IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08)

needs_three = pytest.mark.skipif(MPI.COMM_WORLD.size < 3, reason="compares partitions of 3 ranks")


def scattered(seed):
    """Each cell on any rank: cables are cut at nearly every edge."""

    def ranks(midpoints):
        return np.random.default_rng(seed).integers(0, MPI.COMM_WORLD.size, len(midpoints))

    return ranks


def without(empty):
    """All on the ranks beside one, divided along a line across the cables."""

    def ranks(midpoints):
        others = [rank for rank in range(MPI.COMM_WORLD.size) if rank != empty] or [0]
        return np.array(others)[(midpoints[:, 0] + 0.3 * midpoints[:, 1] > 60.0) % len(others)]

    return ranks


def around_the_crossing(midpoints):
    """Sectors around the place where two cables cross."""
    x, y = (midpoints[:, :2] - CROSSING).T
    turn = (np.arctan2(y, x) / (2 * np.pi)) % 1.0
    return (turn * MPI.COMM_WORLD.size).astype(int)


PARTITIONS = {
    "scattered 1": scattered(1),
    "scattered 2": scattered(2),
    "first rank empty": without(0),
    "last rank empty": without(2),
    "sectors": around_the_crossing,
}


def square(ranks, material=FABRIC):
    """The clamped, inflated square."""
    mesh = meshes.rectangle(MPI.COMM_WORLD, SIDE, SIDE, SIDE / CELLS, structured=True, ranks=ranks)
    scene = clamped(mesh, material)
    solver = advanced(Solver(scene, rtol=1e-10), pressure=0.01)
    return scene, solver


def crossed(ranks):
    """Two cables that slide and cross; then they lift off where a load pushes the sheet in."""
    scene, solver = square(ranks)
    first = scene.lay_cable(Cable(EA=32000.0), [(0.0, 30.0), (50.0, 45.0), (SIDE, 38.0)])
    second = scene.lay_cable(Cable(EA=32000.0), [(33.0, 0.0), (47.0, SIDE)])
    solver.advance(L0={first: 101.0, second: 101.0})
    touching = scene.energies, [c.tension for c in scene.cables]
    scene.put_load(lambda x, n: np.stack([0 * x[0], 0 * x[0], -0.013 * (x[0] > 50.0)]))
    solver.advance(load=1.0)
    assert first.state.lifted.any()
    return scene, solver, touching


def dragged(ranks):
    """A cable over the boundary's edges that friction holds, and lets slip."""
    scene, solver = square(ranks)
    law = Friction(0.3, static=0.4, along=0.2)
    cable = scene.lay_cable(Cable(EA=32000.0, friction=law), [(-20, 30, 0), (120, 34, 0)])
    solver.advance(move={cable: (0.0, 0.0, -8.0)})
    held = scene.energies, [cable.tension]
    solver.advance(move={cable: (0.0, 6.0, 0.0)})
    assert scene.dissipated > 0.0
    return scene, solver, held


def woven(ranks):
    """A fabric that wrinkles, its warp told by a function, under a cable in a sleeve."""
    material = OrthotropicMembrane(
        E1=1394.0, E2=140.0, G12=12.0, nu21=0.065, thickness=1.0,
        warp=lambda x: np.stack([1.0 + 0 * x[0], 0.01 * x[0], 0 * x[0]]),
    )  # fmt: skip
    scene, solver = square(ranks, material)
    cable = scene.lay_cable(Cable(EA=32000.0), [(0.0, 30.0), (SIDE, 38.0)], hold="sleeve")
    solver.advance(L0={cable: 100.3})
    before = scene.energies, [cable.tension]
    scene.floor(-20.0)
    solver.advance(move={cable.start: (0.0, 9.0, -2.0)})
    return scene, solver, before


STORIES = {"crossed": crossed, "dragged": dragged, "woven": woven}


def outcome(story, ranks):
    """Numbers of two states, and how many iterations they took."""
    scene, solver, (energies, tensions) = STORIES[story](ranks)
    numbers = {f"{name} before": value for name, value in energies.items()}
    numbers |= {f"T{k} before": value for k, value in enumerate(tensions)}
    numbers |= dict(scene.energies) | {f"T{k}": c.tension for k, c in enumerate(scene.cables)}
    numbers |= {"W": scene.energy, "volume": scene.volume, "heat": scene.dissipated}
    numbers |= {"reaction": solver.reactions("boundary").total[2]}
    return numbers, sum(step.outcome.iterations for step in solver.steps)


@functools.cache
def by_default(story):
    """What DOLFINx's own partition leads to."""
    return outcome(story, None)


CASES = (
    ("crossed", "scattered 1"),
    ("crossed", "first rank empty"),
    ("crossed", "sectors"),
    ("dragged", "scattered 2"),
    ("dragged", "last rank empty"),
    ("woven", "scattered 1"),
    ("woven", "first rank empty"),
)


@needs_three
@pytest.mark.parametrize(("story", "partition"), CASES)
def test_partition_does_not_matter(story, partition):
    numbers, iterations = outcome(story, PARTITIONS[partition])
    expected, usual = by_default(story)
    assert numbers.keys() == expected.keys()
    tension = max(value for name, value in expected.items() if name[0] == "T")
    for name, value in expected.items():
        scale = tension if name[0] == "T" else max(abs(value), abs(expected["W"]))
        assert numbers[name] == pytest.approx(value, abs=1e-9 * scale), name
    assert abs(iterations - usual) <= 0.1 * usual


@needs_three
def test_everything_is_written_by_ranks_without_cells(folder):
    mesh = meshes.rectangle(MPI.COMM_WORLD, SIDE, SIDE, 25.0, structured=True, ranks=without(0))
    counts = MPI.COMM_WORLD.allgather(mesh.mesh.topology.index_map(2).size_local)
    assert counts[0] == 0 and min(counts[1:3]) > 0 and sum(counts) == 32
    scene = clamped(mesh, FABRIC)
    solver = Solver(scene, results=folder / "results")
    cable = scene.lay_cable(Cable(EA=32000.0), [(0.0, 30.0), (SIDE, 38.0)])
    solver.advance(pressure=0.01)
    draw(solver, folder / "scene.png", colour="stress", ghost=True)
    assert solver.contact_forces(cable).line.shape == (len(cable.line),)
    count = MPI.COMM_WORLD.allreduce(len(solver.results().state))
    assert count == 32
    assert (folder / "scene.png").stat().st_size > 10000
    assert {".csv", ".pvd"} <= {file.suffix for file in (folder / "results").iterdir()}


# --- what callers say ----------------------------------------------------------------------------


def test_cells_are_where_they_should_be(comm):
    points = np.array([(x, y) for y in range(4) for x in range(6)], dtype=float)
    a = np.array([6 * y + x for y in range(3) for x in range(5)])
    cells = np.concatenate([np.column_stack([a, a + 1, a + 7]), np.column_stack([a, a + 7, a + 6])])
    wanted = np.random.default_rng(3).integers(0, comm.size, len(cells))
    by_place = {tuple(points[c].mean(axis=0)): r for c, r in zip(cells, wanted, strict=True)}
    for ranks in (
        wanted,
        wanted.tolist(),
        lambda x: [by_place[tuple(place)] for place in x[:, :2]],
    ):
        mesh = meshes.from_arrays(comm, points, cells, ranks=ranks if comm.rank == 0 else None).mesh
        own = mesh.topology.original_cell_index[: mesh.topology.index_map(2).size_local]
        assert np.array_equal(np.sort(own), np.flatnonzero(wanted == comm.rank))


@pytest.mark.parametrize(
    ("ranks", "message"),
    [
        ([0], r"shape \(1,\); pass an integer for each of the 2 cells"),
        ([0.0, 0.0], "array of float64"),
        (lambda x: x, r"shape \(2, 3\)"),
        ([0, -1], "cell 1 on rank -1"),
        ([99, 0], "cell 0 on rank 99, but there are only ranks 0 to"),
    ],
)
def test_bad_ranks(comm, ranks, message):
    points, cells = [(0, 0), (1, 0), (1, 1), (0, 1)], [(0, 1, 2), (0, 2, 3)]
    with pytest.raises(MeshError, match=message):
        meshes.from_arrays(comm, points, cells, ranks=ranks)
