"""Meshes that are finer where the estimated error is."""

import numpy as np
import pytest
from cabled_square import advanced, clamped
from mpi4py import MPI

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Solver, meshes
from crms_fenicsx.design.study import adapt, marked_cells
from crms_fenicsx.design.study.adaptivity import SAME, _fewest

pytestmark = pytest.mark.usefixtures("comm")

SIDE = 100.0


def fewest(shares, share):
    """The cells marked, one after the other: the slow twin."""
    marked, have = [], 0.0
    for cell in sorted(range(len(shares)), key=lambda cell: -shares[cell]):
        if have < (1 - SAME) * share * sum(shares):
            last = shares[cell]
        elif shares[cell] < (1 - SAME) * last:
            break
        marked.append(cell)
        have += shares[cell]
    return sorted(marked)


SHARES = {
    "random": np.random.default_rng(2).exponential(size=60) ** 3,
    "same": np.ones(60),
    "ties": np.repeat([5.0, 3.0, 1.0, 0.0], 15) * (1 + 1e-7 * np.cos(np.arange(60))),
    "one": np.eye(60)[7],
}


@pytest.mark.ranks
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("name", SHARES)
def test_marked_cells(comm, name, share):
    """Also where the last rank has none."""
    shares = SHARES[name]
    ranks = np.random.default_rng(4).integers(0, max(comm.size - 1, 1), len(shares))
    mine = np.flatnonzero(ranks == comm.rank)
    found = mine[_fewest(comm, shares[mine], share)]
    every = np.sort(np.concatenate(comm.allgather(found))).tolist()
    assert every == fewest(shares.tolist(), share)
    assert shares[every].sum() >= (1 - 2 * SAME) * share * shares.sum()


def grid(comm, cells, **how):
    return meshes.rectangle(comm, SIDE, SIDE, SIDE / cells, structured=True, **how)


def model_2(mesh):
    """A cable over the inflated square, just taut, that anchors beyond it pull down."""
    scene = clamped(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.put_load((0.0, 0.0, -0.001), name="snow")
    solver = advanced(Solver(scene, rtol=1e-9), pressure=0.01)
    cable = scene.lay_cable(
        Cable(EA=32000.0), [(-80.0, 41.0, 0.0), (180.0, 41.0, 0.0)], name="ridge"
    )
    solver.advance(move={cable: (0.0, 0.0, -15.0)}, load=1.0)
    return solver


def count(solver):
    return solver.scene.mesh.mesh.topology.index_map(2).size_global


@pytest.mark.ranks
def test_adapted_meshes_and_answers_are_the_same_on_any_number_of_processes(comm):
    """And however cells are shared out, also with a rank that has none; as on one process."""
    alone = [adapt(model_2, grid(MPI.COMM_SELF, 6), levels=n, share=0.4) for n in (1, 2, 3)]
    errors = [solver.estimate_error().total for solver in alone]
    assert errors[2] < 0.7 * errors[1] < 0.7**2 * errors[0]

    def scattered(midpoints):
        return np.random.default_rng(3).integers(0, max(comm.size - 1, 1), len(midpoints))

    for how in ({}, {"ranks": scattered}):
        found = adapt(model_2, grid(comm, 6, **how), levels=3, share=0.4)
        assert count(found) == count(alone[2])
        assert found.scene.energy == pytest.approx(alone[2].scene.energy, rel=1e-8)
        tensions = [solver.scene.cable("ridge").tension for solver in (found, alone[2])]
        assert tensions[0] == pytest.approx(tensions[1], rel=1e-8)


def test_answer_comes_near_that_of_the_divided_mesh_with_fewer_cells(comm):
    mesh = grid(comm, 8)
    adapted, divided = adapt(model_2, mesh, levels=2, share=0.9), model_2(meshes.refine(mesh))
    first = model_2(mesh)
    assert count(first) < count(adapted) < count(divided)
    tensions = [s.scene.cable("ridge").tension for s in (first, adapted, divided)]
    assert abs(tensions[1] / tensions[2] - 1) < 2e-3
    energies = [s.scene.energy for s in (first, adapted, divided)]
    assert abs(energies[1] - energies[2]) < 0.3 * abs(energies[0] - energies[2])


def test_refinement_stops_at_the_tolerance(comm):
    first = model_2(grid(comm, 6)).estimate_error().relative
    found = adapt(model_2, grid(comm, 6), tolerance=0.5 * first)
    assert 0.2 * first < found.estimate_error().relative <= 0.5 * first
    assert count(adapt(model_2, grid(comm, 6), tolerance=2 * first)) == 72


@pytest.mark.ranks
@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"share": 0.0}, "share"),
        ({"share": 1.5}, "share = 1.5 is more than 1"),
        ({"share": "half"}, "share"),
        ({"tolerance": -1.0}, "adapt: tolerance"),
        ({"levels": 0}, "adapt: levels"),
        ({"project": lambda x: x[:2]}, "project returned an array of shape"),
    ],
)
def test_bad_arguments_are_refused(comm, how, message):
    with pytest.raises(InputError, match=message):
        adapt(model_2, grid(comm, 4), **{"tolerance": 1e-6, **how})


def test_build_must_use_the_mesh(comm):
    with pytest.raises(InputError, match="a scene of 72 cells on a mesh of 32; use the mesh"):
        adapt(lambda mesh: model_2(grid(comm, 6)), grid(comm, 4), tolerance=1e-6)


def test_scene_without_load_has_nothing_to_adapt(comm):
    scene = clamped(grid(comm, 2), IsotropicMembrane(300.0, 0.25, 0.08))
    solver = advanced(Solver(scene))
    with pytest.raises(InputError, match="the estimated error is zero; load the scene"):
        marked_cells(solver)
