"""A solver on a mesh that is finer where the estimated error is."""

import numpy as np
import pytest
from mpi4py import MPI

from crms_fenicsx import Cable, InputError, IsotropicMembrane, Scene, Solver, meshes
from crms_fenicsx.convergence.marking import SAME, marked_cells

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


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("name", SHARES)
def test_marked_cells(comm, name, share):
    """Also where the last rank has none."""
    shares = SHARES[name]
    ranks = np.random.default_rng(4).integers(0, max(comm.size - 1, 1), len(shares))
    mine = np.flatnonzero(ranks == comm.rank)
    found = mine[marked_cells(comm, shares[mine], share)]
    every = np.sort(np.concatenate(comm.allgather(found))).tolist()
    assert every == fewest(shares.tolist(), share)
    assert shares[every].sum() >= (1 - 2 * SAME) * share * shares.sum()


def model_2(comm, cells=6, **how):
    """A cable over the inflated square, just taut, that anchors beyond it pull down."""
    mesh = meshes.rectangle(comm, SIDE, SIDE, SIDE / cells, structured=True, **how)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    scene.fix("boundary")
    scene.put_load((0.0, 0.0, -0.001), name="snow")
    solver = Solver(scene, rtol=1e-9)
    solver.advance(pressure=0.01)
    cable = scene.lay_cable(
        Cable(EA=32000.0), [(-80.0, 41.0, 0.0), (180.0, 41.0, 0.0)], name="ridge"
    )
    solver.advance(move={cable: (0.0, 0.0, -15.0)}, load=1.0)
    return solver


def count(solver):
    return solver.scene.mesh.mesh.topology.index_map(2).size_global


def test_adapted_meshes_and_answers_are_the_same_on_any_number_of_processes(comm):
    """And however cells are shared out, also with a rank that has none; as on one process."""
    first = model_2(MPI.COMM_SELF)
    alone = first.adapt(0.4)
    again = alone.adapt()
    errors = [solver.estimate_error().total for solver in (first, alone, again)]
    assert errors[2] < 0.7 * errors[1] < 0.7**2 * errors[0]

    def scattered(midpoints):
        return np.random.default_rng(3).integers(0, max(comm.size - 1, 1), len(midpoints))

    for how in ({}, {"ranks": scattered}):
        once = model_2(comm, **how).adapt(0.4)
        twice = once.adapt()
        assert (count(once), count(twice)) == (count(alone), count(again))
        assert twice.scene.energy == pytest.approx(again.scene.energy, rel=1e-8)
        tensions = [solver.scene.cable("ridge").tension for solver in (twice, again)]
        assert tensions[0] == pytest.approx(tensions[1], rel=1e-8)


def test_answer_comes_near_that_of_the_refined_mesh_with_fewer_cells(comm):
    """Cables and loads are carried over, and the length is measured again as by `refine`."""
    solver = model_2(comm, 8)
    refined, adapted = solver.refine(), solver.adapt(0.9)
    assert count(adapted) < count(refined)
    cables = [s.scene.cable("ridge") for s in (solver, adapted, refined)]
    assert abs(cables[1].tension / cables[2].tension - 1) < 2e-3
    assert abs(cables[1].L0 / cables[2].L0 - 1) < 0.5 * abs(cables[0].L0 / cables[2].L0 - 1)
    energies = [s.scene.energy for s in (solver, adapted, refined)]
    assert abs(energies[1] - energies[2]) < 0.3 * abs(energies[0] - energies[2])
    assert adapted.scene.loads[0].factor == 1.0
    assert adapted.steps[-1].verification is not None
    adapted.advance(load=0.5)  # it goes on like any other


def test_cable_along_edges_that_are_not_divided(comm):
    """It lies in the sleeve of a free edge, of which few edges are divided."""
    mesh = meshes.rectangle(comm, SIDE, SIDE, SIDE / 6, structured=True)
    scene = Scene(mesh, IsotropicMembrane(E=300.0, nu=0.25, thickness=0.08))
    for name in ("left", "right", "front"):
        scene.fix(name)
    scene.put_load((0.0, 0.0, -0.002), name="weight", per="material")
    scene.lay_cable(Cable(EA=3e3), [(0.0, SIDE), (SIDE, SIDE)], L0=100.0)
    solver = Solver(scene, rtol=1e-9)
    solver.advance(load=1.0)
    coarse, adapted, refined = (
        one.scene.cables[0] for one in (solver, solver.adapt(0.2), solver.refine())
    )
    assert adapted.in_edge
    assert {node.kind for node in adapted.nodes} == {"anchor", "vertex"}
    assert 9 == len(coarse.nodes) < len(adapted.nodes) < len(refined.nodes) == 15
    assert refined.tension < adapted.tension < coarse.tension


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"share": 0.0}, "adapt: share"),
        ({"share": 1.5}, "adapt: share = 1.5 is more than all"),
        ({"share": "half"}, "adapt: share"),
        ({"share": np.nan}, "adapt: share"),
        ({"project": lambda x: x[:2]}, "project returned an array of shape"),
    ],
)
def test_bad_arguments_are_refused(comm, how, message):
    solver = model_2(comm, 4)
    energy = solver.scene.energy
    with pytest.raises(InputError, match=message):
        solver.adapt(**how)
    assert solver.scene.energy == energy


def test_scene_without_load_has_nothing_to_adapt(comm):
    scene = Scene(meshes.rectangle(comm, 1.0, 1.0, 0.5), IsotropicMembrane(300.0, 0.25, 0.08))
    scene.fix("boundary")
    solver = Solver(scene)
    solver.advance()
    with pytest.raises(InputError, match="the estimate sees no error; load the scene"):
        solver.adapt()
