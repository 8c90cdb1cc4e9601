"""Terms of the energy that a user adds to a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from cabled_square import CABLE, advanced, sheet
from mpi4py import MPI

from crms_fenicsx import EnergyTerm, InputError, Scene, Solver, taylor_test
from crms_fenicsx.energy.terms.integral import Integral
from crms_fenicsx.foundation.dofs.block_patterns import ElementPattern


class Springs(EnergyTerm):
    """Energy ``k/2 |u|^2 + c/4 |u|^4 - f . u`` of each vertex."""

    name = "springs"

    def __init__(self, k: float = 0.02, c: float = 0.0, f: tuple[float, ...] = (0, 0, 0)) -> None:
        self.k, self.c, self.f = k, c, np.array(f, dtype=float)

    def sums(self, x: Any, out: Any) -> None:
        own = x[: self.unknowns.n_vertices]
        squares = np.einsum("ni,ni->n", own, own)
        energies = self.k / 2 * squares + self.c / 4 * squares**2 - own @ self.f
        out[0] = energies.sum()

    def add_gradient(self, x: Any, sums: Any, g: Any) -> None:
        n = self.unknowns.n_vertices
        squares = np.einsum("ni,ni->n", x[:n], x[:n])
        g[:n] += (self.k + self.c * squares)[:, None] * x[:n] - self.f


class StiffSprings(Springs):
    """The same with its stiffness."""

    def attach(self, unknowns: Any) -> None:
        super().attach(unknowns)
        n = unknowns.n_vertices
        self.pattern = ElementPattern(np.arange(n + 1), np.arange(n))
        self.patterns = (self.pattern,)

    def add_stiffness(self, x: Any, sums: Any, A: Any) -> None:
        own = x[: self.unknowns.n_vertices]
        squares = np.einsum("ni,ni->n", own, own)[:, None, None]
        dyads = own[:, :, None] * own[:, None, :]
        self.pattern.values[:] = (self.k + self.c * squares) * np.eye(3) + 2 * self.c * dyads
        self.pattern.add(A)


class Foundation(EnergyTerm):
    """Energy ``k/2 w^2`` per area of the vertical displacement w, as an integral."""

    name = "foundation"

    def __init__(self, scene: Scene, k: float, cell_tags: Any = None) -> None:
        w = scene.u[2]

        def variation(v: Any, q: Any, dx: Any) -> Any:
            return (k / 2 * w**2 * q + k * w * v[2]) * dx

        self.integral = Integral(scene.V, variation, cell_tags=cell_tags)

    def sums(self, x: Any, out: Any) -> None:
        assert self.integral is not None
        out[0] = self.integral.value

    def add_gradient(self, x: Any, sums: Any, g: Any) -> None:
        assert self.integral is not None
        self.unknowns.add_to_vertices(self.integral.gradient, g)


def refused(call: Any, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        call()
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize("kind", [Springs, StiffSprings])
def test_springs_share_the_load_with_the_supports(comm: MPI.Intracomm, kind: Any) -> None:
    scene = sheet(comm, 8)
    scene.add_term(kind())
    assert scene.energies == {"springs": 0.0} and scene.terms[0].name == "springs"
    solver = Solver(scene)
    step = solver.advance(pressure=0.01)
    assert step.verification is not None and step.verification.passed
    owned = scene.u.x.array[: 3 * scene.V.dofmap.index_map.size_local].reshape(-1, 3)
    energy = comm.allreduce(0.01 * float(np.vdot(owned, owned)))
    assert scene.energies["springs"] == pytest.approx(energy, rel=1e-12)
    springs = comm.allreduce(0.02 * owned.sum(axis=0))
    support = solver.reactions("boundary").total
    np.testing.assert_allclose(springs - support, (0, 0, 100.0), atol=1e-5)
    alone = sheet(comm, 8)
    Solver(alone).advance(pressure=0.01)
    assert scene.volume < 0.98 * alone.volume


def test_stiffness_in_h0_spares_iterations(comm: MPI.Intracomm) -> None:
    taken = {}
    for kind in (Springs, StiffSprings):
        scene = sheet(comm, 8)
        scene.add_term(kind(k=1.0))
        taken[kind] = Solver(scene).advance(pressure=0.01).outcome.evaluations
    assert taken[StiffSprings] < taken[Springs]


@pytest.mark.ranks
def test_with_cables(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 8, "unstructured")
    solver = advanced(Solver(scene), pressure=0.01)
    cable = scene.lay_cable(CABLE, [(0.0, 31.0), (100.0, 52.0)], tension=5.0)
    scene.add_term(StiffSprings())
    step = solver.advance(L0={cable: 0.98 * cable.L0})
    assert step.verification is not None and step.verification.passed and cable.tension > 5.0
    assert set(scene.energies) == {"membrane", "pressure", "cables", "penalty", "springs"}
    owned = scene.u.x.array[: 3 * scene.V.dofmap.index_map.size_local].reshape(-1, 3)
    springs = comm.allreduce(0.02 * owned.sum(axis=0))
    supports = solver.reactions("boundary").total
    np.testing.assert_allclose(springs - supports, (0, 0, 100.0), atol=1e-4)


def test_weight_of_a_flat_sheet(comm: MPI.Intracomm) -> None:
    """As by the package's own dead load; a flat sheet has no stiffness against it."""
    own, twin = sheet(comm, 8), sheet(comm, 8)
    weights = (0.0, 0.0, -0.1)
    own.add_term(Springs(0.0, 0.0, weights))
    added = Solver(own).advance().outcome
    area = 100.0**2
    twin.put_load((0.0, 0.0, -0.1 * 81 / area))
    dead = Solver(twin).advance(load=1.0).outcome
    assert added.converged and added.evaluations < 2 * dead.evaluations
    low = [comm.allreduce(s.positions()[:, 2].min(initial=0.0), MPI.MIN) for s in (own, twin)]
    assert low[0] == pytest.approx(low[1], rel=0.1) and low[0] < -1.0


@pytest.mark.ranks
def test_an_integral_joins_the_pass_over_the_mesh(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 8)
    term = Foundation(scene, 1e-3)
    rates = taylor_test(term, scene.u)
    assert rates.gradient > 1.9 and rates.stiffness is None
    scene.add_term(term)
    step = Solver(scene).advance(pressure=0.01)
    assert step.verification is not None and step.verification.passed
    assert scene.energies["foundation"] > 0.0


def test_taylor_test_of_a_right_term(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 8)
    before = scene.u.x.array.copy()
    assert taylor_test(Springs(c=0.01), scene.u).stiffness is None
    rates = taylor_test(StiffSprings(c=0.01), scene.u)
    assert rates.gradient == pytest.approx(2, abs=0.1)
    assert rates.stiffness == pytest.approx(3, abs=0.1)
    assert taylor_test(StiffSprings(), scene.u).stiffness == np.inf  # a quadratic energy
    assert taylor_test(Springs(0.0, 0.0, (1, 2, 3)), scene.u).gradient == np.inf
    np.testing.assert_array_equal(scene.u.x.array, before)
    scene.add_term(term := StiffSprings())
    Solver(scene).advance(pressure=0.01)
    layout = term.unknowns
    taylor_test(term, scene.u)
    assert term.unknowns is layout


def test_taylor_test_of_a_wrong_term(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 8)

    class Wrong(StiffSprings):
        factor, shear, twice = 1.0, 0.0, 1.0

        def attach(self, unknowns: Any) -> None:
            super().attach(unknowns)
            self.pair = ElementPattern(np.array([0, 2]), np.array([0, 1]))
            self.patterns = (self.pattern, self.pair)

        def add_gradient(self, x: Any, sums: Any, g: Any) -> None:
            super().add_gradient(x, sums, g)
            g *= self.factor

        def add_stiffness(self, x: Any, sums: Any, A: Any) -> None:
            super().add_stiffness(x, sums, A)
            self.pattern.values[:] = (self.twice - 1) * np.eye(3)
            self.pattern.add(A)
            self.pair.values[2] = self.shear  # below the diagonal
            self.pair.add(A)

    term = Wrong(c=0.01)
    taylor_test(term, scene.u)
    term.factor = 1.001
    refused(lambda: taylor_test(term, scene.u), "gradient of 'springs'", "power 1.")
    term.factor, term.twice = 1.0, 1.1
    refused(lambda: taylor_test(term, scene.u), "stiffness of 'springs'", "semidefinite")
    assert taylor_test(term, scene.u, stiffness="semidefinite").stiffness is None
    term.twice = -100.0
    refused(lambda: taylor_test(term, scene.u, stiffness="semidefinite"), "not semidefinite")
    term.shear = 1.0
    refused(lambda: taylor_test(term, scene.u), "not symmetric")


@pytest.mark.ranks
def test_bad_terms_are_refused(comm: MPI.Intracomm) -> None:
    scene = sheet(comm, 4)

    class Bad(Springs):
        pass

    def bad(**attributes: Any) -> Any:
        term = Bad()
        for name, value in attributes.items():
            setattr(term, name, value)
        return lambda: scene.add_term(term)

    refused(lambda: scene.add_term(Springs), "Springs", "EnergyTerm")  # type: ignore[arg-type]
    refused(bad(name=""), "name", "Bad")
    for name in ("pressure", "bars", "pond", "wind", "held lines"):  # in the scene or not
        refused(bad(name=name), f"'{name}' is the name of a term of the package", "Bad")
    refused(bad(n_sums=0), "n_sums", "'springs'")
    refused(bad(sums=lambda x, out: None), "sums of 'springs'", "finite")
    refused(bad(energy=lambda sums: np.inf), "energy of 'springs'", "finite")
    refused(bad(add_gradient=lambda x, s, g: g.fill(np.nan)), "add_gradient", "finite")
    refused(bad(add_gradient=lambda x, s, g: x.fill(1.0)), "changes the displacements")
    refused(bad(integral=ufl.dx), "integral of 'springs'", "scene.V")
    tagged = Foundation(scene, 1.0, cell_tags=object())
    refused(
        lambda: scene.add_term(tagged), "'foundation'", "cell tags of its own", "factor by cell"
    )
    assert scene.terms == () and scene.energies == {}
    scene.add_term(Springs())
    refused(lambda: scene.add_term(Springs()), "'springs' already")
    with pytest.raises(TypeError, match="add_gradient"):
        type("Half", (EnergyTerm,), {"name": "half", "sums": lambda *_: None})()


def test_checkpoints_know_the_terms(comm: MPI.Intracomm, folder: Path) -> None:
    folder = folder / "kept"

    def made(*terms: EnergyTerm) -> Solver:
        scene = sheet(comm, 4)
        for term in terms:
            scene.add_term(term)
        return Solver(scene)

    solver = made(Springs())
    solver.advance(pressure=0.01)
    solver.save(folder)
    refused(lambda: made().load(folder), "added terms", "springs")
    again = made(Springs())
    again.load(folder)
    assert again.scene.energies == solver.scene.energies
    for own in (solver, again):
        own.advance(pressure=0.02)
    assert again.scene.energies["springs"] == pytest.approx(solver.scene.energies["springs"])


class Wear(Springs):
    """Springs to where the vertices were at the end of the step before."""

    name = "wear"
    has_history = True

    def attach(self, unknowns: Any) -> None:
        super().attach(unknowns)
        if not hasattr(self, "rest"):
            self.rest, self.begun, self.ended = np.zeros((unknowns.n_vertices, 3)), 0, 0

    def sums(self, x: Any, out: Any) -> None:
        super().sums(x[: self.unknowns.n_vertices] - self.rest, out)

    def add_gradient(self, x: Any, sums: Any, g: Any) -> None:
        n = self.unknowns.n_vertices
        super().add_gradient(x[:n] - self.rest, sums, g)

    def begin_step(self, x: Any) -> None:
        self.begun += 1

    def commit(self, x: Any, sums: Any) -> None:
        self.rest, self.ended = x[: self.unknowns.n_vertices].copy(), self.ended + 1


@pytest.mark.ranks
def test_a_term_with_history(comm: MPI.Intracomm, folder: Path) -> None:
    scene = sheet(comm, 4)
    scene.add_term(wear := Wear(k=0.05))
    solver = Solver(scene)
    first = solver.advance(pressure=0.01).energies["wear"]
    # a step also begins for states that are looked at before it is solved
    assert wear.begun >= 1 and wear.ended == 1 and first > 0.0
    assert solver.advance().energies["wear"] < 0.5 * first
    refused(lambda: solver.save(folder / "kept"), "'wear' has a history")
    other = Solver(scene, results=folder / "run", resume=False)
    refused(lambda: other.advance(pressure=0.02), "'wear' has a history")
