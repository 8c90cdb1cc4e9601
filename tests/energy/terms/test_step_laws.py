"""The paper's step-wise laws against the total ones: the same answer as steps and strains shrink.

Pressure of constant direction in a step is exact in the limit of small steps. The incremental
strain and the cable's (2.2-2) tend to laws in logarithmic strain instead, which differ from the
total ones by the order of the strain: there the limit is taken in the strain too.
"""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import CABLE, LINEAR, advanced, clamped, square

from crms_fenicsx import Cable, LaidCable, OrthotropicMembrane, Scene, Solver

FABRIC = OrthotropicMembrane(
    E1=400.0, E2=200.0, G12=90.0, nu21=0.2, thickness=0.08, warp=(1.0, 0.4, 0.0), wrinkling=False
)
MATERIALS = [LINEAR, FABRIC]
ACROSS = ((0, 50), (100, 50))


def inflated(comm, steps: int, pressure: float = 0.01, material=LINEAR, **laws: str) -> float:
    """Energy of the square inflated in steps."""
    scene = clamped(square(comm, 8), material, **laws)
    Solver(scene).advance(pressure=pressure, steps=steps)
    return scene.energy


def tightened(
    scene: Scene, steps: int, pressure: float, drop: float, path=ACROSS
) -> tuple[Solver, LaidCable]:
    """Inflate a scene in steps, and pull the ends of a cable across it down in as many."""
    solver = advanced(Solver(scene), pressure=pressure, steps=steps)
    cable = scene.lay_cable(CABLE, path)
    solver.advance(move={cable: (0.0, 0.0, -drop)}, steps=steps)
    return solver, cable


def test_lagged_pressure_converges_with_order_one(comm) -> None:

    def tension(steps: int, law: str) -> float:
        scene = clamped(square(comm, 9), LINEAR, pressure=law)
        return tightened(scene, steps, 0.01, 0.5)[1].tension

    exact = tension(4, "total")
    errors = [tension(n, "lagged") / exact - 1 for n in (5, 10, 20, 40)]
    rate = np.polyfit(np.log([5, 10, 20, 40]), np.log(np.abs(errors)), 1)[0]
    assert rate == pytest.approx(-1.0, abs=0.15)
    assert abs(errors[-1]) < 5e-3


@pytest.mark.parametrize("material", MATERIALS)
def test_step_strain_converges_with_the_strain(comm, material) -> None:
    """The strain of the inflated square grows with p^(2/3); so does the laws' difference."""
    pressures = [1e-2, 1e-3, 1e-4]
    differences = [
        inflated(comm, 20, p, material, strain="step") / inflated(comm, 1, p, material) - 1
        for p in pressures
    ]
    rate = np.polyfit(np.log(pressures), np.log(np.abs(differences)), 1)[0]
    assert rate == pytest.approx(2 / 3, abs=0.1)
    assert abs(differences[-1]) < 1e-3


@pytest.mark.ranks
def test_step_strain_in_folded_cells_converges_with_the_strain(comm) -> None:
    """Small loads, so that only the difference of the laws in folded cells could remain."""
    tensions = []
    for law in ("total", "step"):
        scene = clamped(square(comm, 9), LINEAR, strain=law)
        _, cable = tightened(scene, 4, 1e-5, 0.01)
        assert any(node.kind == "fold" for node in cable.state.nodes)
        tensions.append(cable.tension)
    assert tensions[1] == pytest.approx(tensions[0], rel=1e-3)


def test_step_cable_tends_to_the_logarithm_of_its_length(comm) -> None:
    """With l_n in the place of L0 the tension is EA ln(L/L0) as the steps get small."""
    scene = clamped(square(comm, 9), LINEAR)
    solver = advanced(Solver(scene), pressure=0.01)
    cable = scene.lay_cable(Cable(EA=32000.0, law="step"), ACROSS)
    start = cable.length
    errors = []
    for _ in range(40):
        solver.advance(move={cable: (0.0, 0.0, -0.05)})
        errors.append(cable.tension - 32000.0 * np.log(cable.length / start))
    strain = np.log(cable.length / start)
    assert abs(errors[-1]) < 32000.0 * strain**2 / 40


@pytest.mark.parametrize("material", MATERIALS)
def test_stresses_of_the_step_law_tend_to_those_of_the_total_law(comm, material) -> None:
    """At small strain, in plain and in folded cells alike."""
    found = []
    for law in ("total", "step"):
        scene = clamped(square(comm, 7), material, strain=law)
        solver, _ = tightened(scene, 4, 1e-5, 0.1, [(0, 47), (100, 52)])
        results = solver.results()
        assert comm.allreduce(int(results.folded.sum())) > 7
        found.append(results)
    total, step = found
    size = max(comm.allgather(np.abs(total.second_piola).max(initial=0.0)))
    for name in ("second_piola", "true_forces"):
        difference = getattr(step, name) - getattr(total, name)
        assert np.abs(difference).max(initial=0.0) < 5e-3 * size


TOTAL = {"strain": "total", "pressure": "total", "cable": "total"}


@pytest.mark.ranks
@pytest.mark.parametrize("laws", [
    {}, {"strain": "step"}, {"pressure": "step"}, {"strain": "step", "pressure": "step"},
    {"cable": "step"}, {"strain": "step", "pressure": "step", "cable": "step"},
])  # fmt: skip
def test_solvers_by_turns(comm, laws: dict[str, str]) -> None:
    """What happened in load steps before belongs to the scene, whichever solver made them."""
    laws = TOTAL | laws
    found = []
    for turns in (1, 2, 9):  # one solver, two by turns, one for each step
        strain, pressure = laws["strain"], laws["pressure"]
        scene = clamped(square(comm, 4), LINEAR, strain=strain, pressure=pressure)
        solvers = [Solver(scene) for _ in range(turns)]
        for k, solver in enumerate(solvers):
            assert k > 1 or solver.results() is not None  # which makes its tables
        for k in range(6):
            if k == 2:
                for path in ([(0, 47), (100, 52)], [(63, 0), (69, 100)]):
                    scene.lay_cable(Cable(EA=32000.0, law=laws["cable"]), path, tension=20.0)
            move = {cable: (0.0, 0.0, -0.3) for cable in scene.cables}
            solvers[k % turns].advance(pressure=0.0025 * (k + 1), move=move)
        looks = solvers[(k + 1) % turns]
        square_sum = comm.allreduce(float((looks.results().true_forces ** 2).sum()))
        tensions = [cable.tension for cable in scene.cables]
        found.append([scene.energy, scene.volume, square_sum, *tensions])
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-7)


@pytest.mark.parametrize("pressure", [1e-5, 1e-6])
def test_small_pressures_in_many_steps(comm, pressure: float) -> None:
    """Forces of increments of lengths round as at a strain of 1: solves end above that."""
    energies = []
    for law in ("total", "step"):
        scene = clamped(square(comm, 17), LINEAR, strain=law)
        solver = advanced(Solver(scene), pressure=pressure, steps=20)
        assert all(step.halvings == 0 for step in solver.steps)
        energies.append(scene.energy)
    assert energies[1] == pytest.approx(energies[0], rel=1e-3)
