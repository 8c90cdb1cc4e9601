"""Friction with stick, and the paper's friction element: twins, Taylor, bounds of the stiffness."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from friction_scene import friction_square
from taylor import TermOnPoints, gradient_order, is_semidefinite, noise, stiffness_error
from term_scene import on_mesh

from crms_fenicsx.cabling.cables.node_positions import NodePositions
from crms_fenicsx.cabling.friction.slip import node_slips
from crms_fenicsx.energy.terms.lateral_friction import (
    LateralFriction,
    Slips,
    friction_energy,
)
from crms_fenicsx.energy.terms.paper.cable_elements import FrictionElementEnergy, FrictionElements
from crms_fenicsx.energy.terms.segments import edge_fractions
from crms_fenicsx.model.friction import Friction


def potential(s, F, eps):
    """F eps f(s/eps), and its derivative, in words of the module's head."""
    y = abs(s) / eps
    f = y**2 - y**3 / 3 if y < 1 else y - 1 / 3
    return F * eps * f, np.sign(s) * F * min(2 * y - y**2, 1.0) if y < 1 else np.sign(s) * F


def mollified(slips, F=2.0, eps=0.1):
    """Energies and forces of single nodes by the kernel."""
    n = len(slips)
    force = np.zeros(n)
    energies = [
        friction_energy(np.array([s]), np.array([F]), np.array([eps]), force[k : k + 1])
        for k, s in enumerate(slips)
    ]
    return np.array(energies), force


def test_potential_of_the_slip():
    slips = np.concatenate([np.linspace(-0.3, 0.3, 61), [0.1, -0.1, 1e-12, 0.0]])
    energies, forces = mollified(slips)
    twins = np.array([potential(s, 2.0, 0.1) for s in slips])
    np.testing.assert_allclose(energies, twins[:, 0], rtol=1e-14, atol=0)
    np.testing.assert_allclose(forces, twins[:, 1], rtol=1e-13, atol=0)


def test_all_nodes_add_up():
    rng = np.random.default_rng(0)
    s, F, eps = rng.normal(size=20), rng.uniform(1, 2, 20), rng.uniform(0.1, 2, 20)
    force = np.zeros(20)
    energy = friction_energy(s, F, eps, force)
    twins = np.array([potential(*row) for row in zip(s, F, eps, strict=True)])
    assert energy == pytest.approx(twins[:, 0].sum(), rel=1e-14)
    np.testing.assert_allclose(force, twins[:, 1], rtol=1e-12)


def test_force_is_mobilised_at_eps_and_never_grows():
    """Exactly F from eps on: a law that only tends to it creeps. Smooth where it gets there."""
    _, forces = mollified(np.array([0.1, 0.1000001, 1.0, 1e6]))
    assert np.all(forces == 2.0)
    _, (before, at) = mollified(np.array([0.1 * (1 - 1e-4), 0.1]))
    assert 0 <= at - before < 2.0 * 1e-7  # a kink would give 1e-4


def fraction_twin(X, blocks, place):
    """Share of the polyline's length before the node; of a shift the part across the row."""
    if len(blocks) == 1:
        return X[blocks[0]] @ place
    sizes = np.linalg.norm(np.diff(X[blocks], axis=0), axis=1)
    return sizes[:place].sum() / sizes.sum()


def random_slips(seed=0):
    """Four nodes on three edges, two of them on one, and three at vertices that shift, two of them
    where rows cross; all of them around eps. Shifts start from zero."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(11, 3)) * 3
    X[9:] = 0.0
    edges = [([0, 1, 2, 3], 1), ([0, 1, 2, 3], 2), ([4, 5, 6], 1), ([3, 7, 8], 1)]
    across = np.zeros((7, 3))
    across[4:] = rng.normal(size=(3, 3))
    edges += [([9], across[4]), ([10], across[5]), ([10], across[6])]
    pointers = np.cumsum([0, *(len(blocks) for blocks, _ in edges)]).astype(np.int32)
    blocks = np.concatenate([blocks for blocks, _ in edges]).astype(np.int32)
    place = np.array([at for _, at in edges[:4]] + [0] * 3, dtype=np.int32)
    slope = np.array([3.0, -2.0, 1.5, 2.5, 0.8, 1.2, -0.9])
    fractions = np.array([fraction_twin(X, b, at) for b, at in edges])
    slip = np.array([0.02, -0.06, 0.3, -0.5, 0.01, -0.07, 0.4])
    bound = np.array([2.0, 1.0, 0.5, 3.0, 1.5, 2.5, 0.7])
    offset = slip - slope * fractions
    table = Slips(pointers, blocks, place, slope, offset, bound, np.full(7, 0.1), across)
    return X, edges, table


def slip_twin(edges, table, x):
    """Energy from the places on the edges alone."""
    slips = [
        slope * fraction_twin(x, blocks, at) + offset
        for (blocks, at), slope, offset in zip(edges, table.slope, table.offset, strict=True)
    ]
    return np.array(slips), sum(
        potential(s, F, eps)[0] for s, F, eps in zip(slips, table.bound, table.eps, strict=True)
    )


def test_places_on_edges_and_their_gradients():
    X, edges, table = random_slips()
    edges = edges[:4]
    fractions, gradients = np.zeros(7), np.ones((len(table.blocks), 3))
    x = np.random.default_rng(1).normal(size=X.shape) * 0.1
    edge_fractions(X, x, table.pointers, table.blocks, table.place, fractions, gradients)
    for k, (blocks, at) in enumerate(edges):
        assert fractions[k] == pytest.approx(fraction_twin(X + x, blocks, at), rel=1e-14)
        for q, block in enumerate(blocks):
            for i in range(3):
                step = np.zeros_like(X)
                step[block, i] = 1e-6
                up, down = (fraction_twin(X + x + s * step, blocks, at) for s in (1, -1))
                # central differences: error of the order 1e-12, rounding 1e-16/1e-6
                found = gradients[table.pointers[k] + q, i]
                assert found == pytest.approx((up - down) / 2e-6, abs=1e-9)


@pytest.mark.parametrize("together", [(0, 1), (1, 2), (2, 3)])
def test_points_of_an_edge_that_coincide_give_finite_forces(together):
    X, edges, table = random_slips()
    X[together[1]] = X[together[0]]
    energy, g = TermOnPoints(LateralFriction(table), X).value(np.zeros_like(X))
    assert energy == pytest.approx(slip_twin(edges, table, X)[1], rel=1e-13)
    assert np.all(np.isfinite(g))


def test_an_edge_without_length_holds_nothing():
    X, _, table = random_slips()
    X[[5, 6]] = X[4]
    energy, g = TermOnPoints(LateralFriction(table), X).value(np.zeros_like(X))
    assert np.isfinite(energy)
    np.testing.assert_array_equal(g[[4, 5, 6]], 0.0)


def test_energy_and_gradient():
    X, edges, table = random_slips()
    f = TermOnPoints(LateralFriction(table), X)
    for seed in range(5):
        x, d = 0.01 * np.random.default_rng(seed).normal(size=(2, *X.shape))
        assert f.value(x)[0] == pytest.approx(slip_twin(edges, table, X + x)[1], rel=1e-12)
        np.testing.assert_allclose(
            f.term.slips, slip_twin(edges, table, X + x)[0], rtol=0, atol=1e-14
        )
        # the second derivative of f jumps at -eps, 0 and eps where |y|^3 is not smooth
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.1)


def test_other_forces_for_the_same_nodes():
    X, _, table = random_slips()
    f = TermOnPoints(LateralFriction(table), X)
    energy, g = f.value(0 * X)
    f.term.renew(replace(table, bound=2 * table.bound))
    twice, g2 = f.value(0 * X)
    assert twice == pytest.approx(2 * energy, rel=1e-15)
    np.testing.assert_allclose(g2, 2 * g, rtol=1e-15)


def test_shifts_count_from_where_their_blocks_are():
    """Which tied vertices follow: their slip does not depend on it."""
    X, _, table = random_slips()
    x = 0.01 * np.random.default_rng(2).normal(size=X.shape)
    far = X.copy()
    far[9:] += 7.0
    found = [TermOnPoints(LateralFriction(table), places).value(x) for places in (X, far)]
    assert found[0][0] == found[1][0]
    np.testing.assert_array_equal(found[0][1], found[1][1])


def straight_edge(slip, bound=2.0, eps=0.1):
    """One node on a straight edge of length 2; moving it along the edge is its only slip."""
    X = np.array([(0.0, 0, 0), (0.8, 0, 0), (2.0, 0, 0)])
    table = Slips(
        np.array([0, 3], dtype=np.int32), np.arange(3, dtype=np.int32),
        np.array([1], dtype=np.int32), np.array([2.0]), np.array([slip - 0.8]),
        np.array([bound]), np.array([eps]), np.zeros((1, 3)),
    )  # fmt: skip
    along = np.zeros((3, 3))
    along[1, 0] = 1.0
    return TermOnPoints(LateralFriction(table), X), along


def test_stiffness_is_exact_as_the_slip_vanishes():
    f, along = straight_edge(0.0)
    # the tangent 2 F/eps (1 - |s|/eps) is off by h/eps from the central difference
    for h in (1e-4, 1e-6):
        assert stiffness_error(f, np.zeros((3, 3)), along, h) < 2 * h / 0.1


@pytest.mark.parametrize("slip", [1e-3, 0.03, 0.09, 0.1, 0.2, 5.0, -0.04, -0.3])
def test_stiffness_is_that_of_a_parabola_above_the_potential(slip):
    """It touches at the present slip with the force, so that steps with it go down."""
    f, along = straight_edge(slip)
    zero = np.zeros((3, 3))
    energy, g = f.value(zero)
    curvature = float(f.dot(along, f.times(zero, along)))
    force = f.dot(g, along)
    assert curvature == pytest.approx(abs(force / slip), rel=1e-12)
    for t in np.linspace(-0.7, 1.0, 41):
        above = energy + t * force + t**2 / 2 * curvature
        assert f.value(t * along)[0] <= above + 1e-13
    if abs(slip) < 0.3:  # parabola and potential are even in the slip: they touch there as well
        other = f.value(-2 * slip * along)[0]
        twin = energy - 2 * slip * force + 2 * slip**2 * curvature
        assert other == pytest.approx(twin, rel=1e-9)


def test_stiffness_is_semidefinite_and_above_the_tangent():
    """Of nodes that slide along straight edges; bent edges turn, which is left out."""
    X, _, table = random_slips()
    f = TermOnPoints(LateralFriction(table), X)
    assert is_semidefinite(f.matrix(0 * X))
    assert np.abs(f.matrix(0 * X)).max() > 0.1
    for slip in (0.0, 0.05, -0.08, 0.3):
        f, along = straight_edge(slip)
        up, down = (f.value(s * 1e-5 * along)[1] for s in (1, -1))
        tangent = f.dot(up - down, along) / 2e-5
        # at zero slip the difference is short of the tangent by h/eps of it
        assert f.dot(along, f.times(0 * f.X, along)) >= tangent * (1 - 1e-3)


def test_hessian():
    """Of nodes that stick and that slide, on edges that bend: against differences of gradients."""
    X, _, table = random_slips()
    f = TermOnPoints(LateralFriction(table), X)
    f.term.add_stiffness = f.term.add_hessian
    kinds = set()
    for seed in range(5):
        x, d = 0.02 * np.random.default_rng(seed).normal(size=(2, *X.shape))
        up, down = (f.value(x + s * 1e-5 * d)[1] for s in (1, -1))
        np.testing.assert_allclose(
            f.times(x, d), (up - down) / 2e-5, rtol=0, atol=1e-6 * np.abs(up - down).max() / 2e-5
        )
        kinds |= {bool(sticks) for sticks in np.abs(f.term.slips) < f.term.table.eps}
    assert kinds == {True, False}


def frozen_slips(scene):
    """Slips of all cables, as linear functions of the places on the edges."""
    shape = scene.net.strip_shape()
    return [node_slips(cable, cable.state.law.lateral.curve, shape) for cable in scene.cables]


def energy_by_hand(scene, frozen):
    """Energy of all nodes, from their places on the edges."""
    total = 0.0
    for cable, slips in zip(scene.cables, frozen, strict=True):
        slip = slips.slope * cable.state.fractions[slips.nodes] + slips.offset
        eps = cable.cable.sideways.tolerance * slips.size
        for s, e, support in zip(slip, eps, slips.supports, strict=True):
            total += potential(s, cable.state.law.lateral.at(support), e)[0]
    return total


def slid(system, size):
    """Displacements (n, 3) of the owned points: fold points moved along their edges a little."""
    unknowns, numbering = system.unknowns, system.cables.numbering
    x = unknowns.vector()[1]
    rng = np.random.default_rng(3)
    for (c, k), number in numbering.numbers.items():
        shift = rng.uniform(-size, size)
        block, cable = numbering.blocks[number], system.scene.cables[c]
        if block >= 0 and cable.state.nodes[k].slides:
            a, b = (unknowns.X[numbering.vertex(v)] for v in cable.state.nodes[k].point.support)
            x[block] = shift * (b - a)
    return x[: unknowns.n_owned].copy()


@pytest.mark.ranks
def test_term_of_a_scene(comm):
    """Nodes that stick and nodes that slide, two on one edge, and edge sliders."""
    system = friction_square(comm, Friction(0.4, tolerance=0.01))
    f = on_mesh(system, "LateralFriction")
    term = f.potential.terms[0]
    sizes = comm.allreduce(np.bincount(np.diff(term.table.pointers), minlength=5))
    assert sizes[3] > 10 and sizes[4] > 2
    assert comm.allreduce(int(system.unknowns.n_sliders)) > 0
    # nothing has slipped at the start of the step
    energy, _ = f.value(np.zeros((system.unknowns.n_owned, 3)))
    assert abs(energy) < 1e-20
    frozen = frozen_slips(system.scene)
    x = slid(system, 0.02)
    energy, _g = f.value(x)
    y = np.abs(term.slips) / term.table.eps
    assert comm.allreduce(int(np.sum(y > 1))) > 3 < comm.allreduce(int(np.sum(y < 0.9)))
    NodePositions(system.cables.numbering, system.unknowns).gather(f.potential.x)
    assert energy == pytest.approx(energy_by_hand(system.scene, frozen), rel=1e-10)
    d = noise(system.unknowns.X[: system.unknowns.n_owned], 99)
    steps = 0.002 * 0.25 ** np.arange(6)
    assert gradient_order(f, x, d, steps) == pytest.approx(2, abs=0.05)
    points = d.copy()
    points[: system.unknowns.n_vertices] = 0.0
    assert gradient_order(f, x, points, steps) == pytest.approx(2, abs=0.05)
    assert is_semidefinite(f.matrix(x))


def random_elements(seed=0):
    """Three friction elements, one at the last end of its edge; slips around eps."""
    rng = np.random.default_rng(seed)
    X, left, slips = rng.normal(size=(9, 3)), rng.normal(size=(3, 3)), np.array([0.03, -0.5, 0.08])
    left /= np.linalg.norm(left, axis=1)[:, None]
    blocks = np.arange(9, dtype=np.int32).reshape(3, 3)
    weights = np.array([(-1, 1, 0), (0, 1, -1), (-1, 1, 0)])
    way = np.einsum("nq,nqi->ni", weights, X[blocks])
    slopes = weights[:, :, None] * left[:, None]
    offset = slips - np.sum(left * way, axis=1)
    table = FrictionElements(blocks, slopes, offset, np.array([2.0, 1.0, 3.0]), np.full(3, 0.1))
    return X, weights, left, table


def test_paper_element():
    """w = F |s|, smoothed over eps, with s = d . (x_p - x_v) from the step's start."""
    X, weights, left, table = random_elements()
    f = TermOnPoints(FrictionElementEnergy(table), X)
    for seed in range(5):
        x, d = 0.03 * np.random.default_rng(seed).normal(size=(2, *X.shape))
        energy, g = f.value(x)
        twin, forces = 0.0, np.zeros_like(X)
        for k, (first, point, last) in enumerate(table.blocks):
            vertex = last if weights[k, 2] else first
            slip = left[k] @ (X[point] + x[point] - X[vertex] - x[vertex]) + table.offset[k]
            w, force = potential(slip, table.bound[k], 0.1)
            twin += w
            forces[point] += force * left[k]
            forces[vertex] -= force * left[k]
        assert energy == pytest.approx(twin, rel=1e-12)
        np.testing.assert_allclose(g, forces, rtol=0, atol=1e-12)
        assert gradient_order(f, x, d) == pytest.approx(2, abs=0.1)
        assert is_semidefinite(f.matrix(x))


def test_hessian_of_paper_elements():
    """Of nodes that stick and that slide: against differences of gradients."""
    X, _, _, table = random_elements()
    f = TermOnPoints(FrictionElementEnergy(table), X)
    f.term.add_stiffness = f.term.add_hessian
    x, d = 0.01 * np.random.default_rng(1).normal(size=(2, *X.shape))
    up, down = (f.value(x + s * 1e-5 * d)[1] for s in (1, -1))
    size = np.abs(up - down).max() / 2e-5
    np.testing.assert_allclose(f.times(x, d), (up - down) / 2e-5, rtol=0, atol=1e-6 * size)
    sticks = np.abs(f.term.slips) < table.eps
    assert sticks.any() and not sticks.all()


def test_some_paper_elements():
    """A term of the elements at chosen blocks, as local relaxation makes it."""
    X, _, _, table = random_elements()
    term = TermOnPoints(FrictionElementEnergy(table), X).term
    some = term.elements_on(np.arange(9) == 4)
    np.testing.assert_array_equal(some.blocks, table.blocks[1:2])
    f = TermOnPoints(term.of_elements(some, np.zeros(1)), X)
    assert f.value(0 * X)[0] == pytest.approx(potential(-0.5, 1.0, 0.1)[0], rel=1e-12)
    assert term.elements_on(np.zeros(9, dtype=bool)) is None


@pytest.mark.ranks
def test_paper_elements_of_a_scene(comm):
    """Their work begins at zero, and its gradient pulls points and nearer vertices together."""
    system = friction_square(comm, Friction(0.4, law="step", tolerance=0.01))
    f = on_mesh(system, "FrictionElementEnergy")
    term = f.potential.terms[0]
    assert comm.allreduce(len(term.table.blocks)) > 15
    energy, _ = f.value(np.zeros((system.unknowns.n_owned, 3)))
    assert abs(energy) < 1e-20
    x = slid(system, 0.02)
    energy, _ = f.value(x)
    y = np.abs(term.slips) / term.table.eps
    assert comm.allreduce(int(np.sum(y > 1))) > 3 < comm.allreduce(int(np.sum(y < 0.9)))
    d = noise(system.unknowns.X[: system.unknowns.n_owned], 99)
    assert gradient_order(f, x, d, 0.002 * 0.25 ** np.arange(6)) == pytest.approx(2, abs=0.05)
    assert is_semidefinite(f.matrix(x))
    NodePositions(system.cables.numbering, system.unknowns).gather(f.potential.x)
    shape, twin = system.scene.net.strip_shape(), 0.0
    for cable in system.scene.cables:
        slips, own = (
            node_slips(cable, cable.state.law.lateral.curve, shape),
            cable.state.law.lateral.elements,
        )
        for k, support, size in zip(slips.nodes, slips.supports, slips.size, strict=True):
            row = cable.state.law.lateral.row_of[support]
            assert own.vertices[row] in support
            way = cable.state.positions[k] - shape.at(own.vertices[row])
            slip = own.left[row] @ way + own.offset[row]
            twin += potential(slip, cable.state.law.lateral.bounds[row], 0.01 * size)[0]
    assert energy == pytest.approx(twin, rel=1e-10)
