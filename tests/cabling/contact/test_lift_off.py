"""Cables from anchors beyond the boundary: where they touch the membrane, and where they do not.

The reference figures are extrapolated from meshes whose lines carry the cable, so that they need
no fold elements: N = 32, 64, 128 give order 2.
"""

from __future__ import annotations

import numpy as np
import pytest
from cabled_square import CABLE, KINDS, PRESSURE, advanced, order, place, sheet
from contact_checks import deepest, strongest_pull

from crms_fenicsx import PathError, Solver
from crms_fenicsx.cabling.cables.points_on_edges import fractions_of, positions_of
from crms_fenicsx.cabling.contact.lift_off import (
    Polylines,
    is_foot,
    may_lift,
    released,
)
from crms_fenicsx.model.tolerances import TOL

ANCHORS = [(-5.0, 50.0, 8.0), (105.0, 50.0, 8.0)]
T_EXACT, W_EXACT, Z_EXACT = 148.667, -335.00, 8.6635


def held_down(comm, n: int, kind: str = "structured", L0: float = 109.5, **how):
    scene = sheet(comm, n, kind)
    cable = scene.lay_cable(CABLE, ANCHORS, L0=L0, **how)
    solver = advanced(Solver(scene), pressure=PRESSURE)
    return scene, cable, solver


def free_height(comm, n: int) -> tuple[float, float]:
    """Height and energy of the square without cables."""
    scene = sheet(comm, n)
    Solver(scene).advance(pressure=PRESSURE)
    return top(scene), scene.energy


def top(scene) -> float:
    return max(scene.comm.allgather(float(scene.positions()[:, 2].max(initial=-np.inf))))


@pytest.mark.ranks
@pytest.mark.parametrize("kind", ["on mesh lines", *KINDS])
def test_cable_that_touches_in_part_converges(comm, kind: str) -> None:
    """The contact ends at points of edges: T and z scatter by a fraction of a cell's error."""
    sizes, W = ((8, 16, 32) if kind == "on mesh lines" else (9, 17, 33)), []
    for n in sizes:
        scene, cable, _ = held_down(comm, n, "structured" if kind == "on mesh lines" else kind)
        assert cable.state.lifted.any() and not cable.state.lifted[1:-1].all()
        W.append(scene.energy - W_EXACT)
    assert order([1 / n for n in sizes], W) > 1.9
    assert cable.tension == pytest.approx(T_EXACT, rel=1e-4)
    x = place(cable, 50.0)
    assert x[1] == pytest.approx(50.0, abs=0.02 * 100 / n)
    assert x[2] == pytest.approx(Z_EXACT, abs=0.0025)


@pytest.mark.ranks
@pytest.mark.parametrize("seed", range(10))
def test_random_anchors_neither_pull_nor_penetrate(comm, seed: int) -> None:
    """A few thousandths of the tension are the mesh's: normals turn from cell to cell."""
    rng = np.random.default_rng(seed)
    n, kind = int(rng.integers(7, 12)), KINDS[seed % 3]
    ends = [(-rng.uniform(1, 10), rng.uniform(8, 92), rng.uniform(0, 10)),
            (100 + rng.uniform(1, 10), rng.uniform(8, 92), rng.uniform(0, 10))]  # fmt: skip
    scene = sheet(comm, n, kind)
    L0 = 0.995 * float(np.linalg.norm(np.subtract(*ends)))
    cable = scene.lay_cable(CABLE, ends, L0=L0)
    Solver(scene).advance(pressure=PRESSURE)
    assert cable.taut
    assert strongest_pull(scene, cable) < 5e-3
    assert deepest(scene, cable) < 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_anchors_that_go_up_and_down_again_leave_no_trace(comm, kind: str) -> None:
    scene, cable, solver = held_down(comm, 11, kind)
    energy, T, touching = scene.energy, cable.tension, len(cable.contacts())
    solver.advance(move={cable: (0.0, 0.0, 2.0)}, steps=2)
    assert len(cable.contacts()) < touching
    solver.advance(move={cable: (0.0, 0.0, -2.0)}, steps=2)
    assert len(cable.contacts()) == touching
    assert scene.energy == pytest.approx(energy, rel=1e-6)
    assert cable.tension == pytest.approx(T, rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_cable_that_slackens_and_tightens_gets_its_folds_back(comm, kind: str) -> None:
    scene, cable, solver = held_down(comm, 11, kind)
    energy, T, touching = scene.energy, cable.tension, cable.contacts()
    solver.advance(L0={cable: 112.0})
    assert not cable.taut and cable.tension == 0.0
    solver.advance(L0={cable: 109.5})
    assert cable.contacts() == touching
    assert scene.energy == pytest.approx(energy, rel=1e-6)
    assert cable.tension == pytest.approx(T, rel=1e-6)


def test_slack_cable_leaves_the_membrane_as_it_is_without_cables(comm) -> None:
    scene, cable, _ = held_down(comm, 9, "structured", L0=112.0)
    assert not cable.taut
    height, energy = free_height(comm, 9)
    assert scene.energy == pytest.approx(energy, rel=1e-10)
    assert top(scene) == pytest.approx(height, rel=1e-8)


@pytest.mark.ranks
def test_cable_lifts_off_altogether(comm) -> None:
    """It is a straight bar then, and the membrane that without cables."""
    scene, cable, solver = held_down(comm, 9)
    solver.advance(move={cable: (0.0, 0.0, 6.0)}, steps=2)
    assert cable.state.lifted[1:-1].all()
    assert cable.tension == pytest.approx(32000.0 * 0.5 / 109.5, rel=1e-9)
    height, energy = free_height(comm, 9)
    assert scene.energy - scene.energies["cables"] == pytest.approx(energy, rel=1e-9)
    assert top(scene) == pytest.approx(height, rel=1e-6)
    solver.advance(move={cable: (0.0, 0.0, -6.0)}, steps=2)
    again, other, _ = held_down(comm, 9)
    assert scene.energy == pytest.approx(again.energy, rel=1e-6)
    assert cable.tension == pytest.approx(other.tension, rel=1e-6)


def test_sleeve_pulls_the_membrane_outward(comm) -> None:
    """A cable from a mast, shortened: in a sleeve it cannot leave the place under the mast."""
    heights = {}
    for sleeve in (True, False):
        scene = sheet(comm, 9, "unstructured")
        solver = advanced(Solver(scene), pressure=PRESSURE)
        free = top(scene)
        cable = scene.lay_cable(
            CABLE, [(50, 47, 13), (103, 47, -1)], hold="sleeve" if sleeve else "outside"
        )
        solver.advance(L0={cable: 0.99 * cable.L0})
        assert cable.taut and cable.state.lifted.any() != sleeve
        heights[sleeve] = top(scene)
    assert heights[True] > free + 0.5
    assert heights[False] < free


@pytest.mark.parametrize("kind", KINDS)
def test_cable_from_a_mast_runs_free_and_then_lies_on_the_membrane(comm, kind: str) -> None:
    scene = sheet(comm, 11, kind)
    solver = advanced(Solver(scene), pressure=PRESSURE)
    cable = scene.lay_cable(CABLE, [(50.0, 47.0, 13.0), (103.0, 47.0, -1.0)])
    solver.advance(L0={cable: 0.998 * cable.L0})
    touching = [k for k in cable.contacts() if cable.state.nodes[k].kind in ("fold", "vertex")]
    assert touching and cable.state.lifted[1 : touching[0]].all()
    assert cable.tension > 1.0
    assert strongest_pull(scene, cable) < 5e-3
    assert deepest(scene, cable) < 1e-6


@pytest.mark.ranks
@pytest.mark.parametrize("kind", KINDS)
def test_contacts_are_released_as_one_by_one(comm, kind: str) -> None:
    """In a state that is none of equilibrium: some press, some pull; some are lifted already."""
    scene, cable, _ = held_down(comm, 9, kind)
    rng, shape, found = np.random.default_rng(1), scene.net.strip_shape(), 0
    on_membrane = [k for k, node in enumerate(cable.state.nodes) if node.point is not None]
    for part in (0.0, 0.1, 0.3):
        x = cable.state.positions.copy()
        x[on_membrane, 2] += rng.uniform(-1.0, 1.0, len(on_membrane))
        lifted = rng.random(len(x)) < part
        lifted[[0, -1]] = False
        cable.update(positions=x, lifted=lifted)
        slow = []
        for k in may_lift(cable):
            if not lifted[k]:
                normal, size = shape.normals_and_sizes([cable.state.nodes[k].support])
                pull = Polylines.of([cable]).pulls(np.array([k]), normal, size)[0]
                if pull > TOL.contact or is_foot(cable, k):
                    slow.append(k)
        assert released(cable, shape) == slow
        found += len(slow)
    assert found > 5


@pytest.mark.parametrize("kind", ["unstructured", "rotated"])
def test_a_cable_that_slides_off_the_edge_is_an_error(comm, kind: str) -> None:
    """Over a corner, with its anchors dragged away from the membrane."""
    scene = sheet(comm, 9, kind)
    solver = advanced(Solver(scene), pressure=PRESSURE)
    cable = scene.lay_cable(CABLE, [(-18, 32, -4), (32, -18, -4)])
    with pytest.raises(PathError, match=r"'cable 1' has slid off the membrane's edge at \["):
        for _ in range(8):
            span = float(np.linalg.norm(cable.state.positions[-1] - cable.state.positions[0]))
            solver.advance(move={cable: (-2, -2, 0)}, L0={cable: 0.999 * span})
    assert len(solver.steps) > 3 and cable.tension > 100.0  # the last good state


@pytest.mark.parametrize(
    "first, way, pressure", [(20 + 6 * 60 / 23, 60 / 23, PRESSURE), (27.5, 2.5, PRESSURE / 100)]
)
def test_span_that_passes_a_vertex_on_the_other_side_than_its_path(
    comm, first: float, way: float, pressure: float
) -> None:
    """Pulled deep into a coarse membrane, the cable ends up below it beside a vertex of its path,
    beyond the ends of edges that the path crosses there; laid anew it finds its place."""
    scene = sheet(comm, 12)
    cable = scene.lay_cable(CABLE, [(0.0, first), (100.0, 20.0)], L0=100.0)
    solver = advanced(Solver(scene), pressure=pressure)
    solver.advance(move={cable.start: (0.0, way, 0.0)})
    assert deepest(scene, cable) < 1e-3
    fresh = sheet(comm, 12)
    other = fresh.lay_cable(CABLE, [(0.0, first + way), (100.0, 20.0)], L0=100.0)
    Solver(fresh).advance(pressure=pressure)
    assert scene.energy == pytest.approx(fresh.energy, rel=1e-6)
    assert cable.tension == pytest.approx(other.tension, rel=1e-6)


def test_fold_points_that_have_approached_each_other_are_told(comm) -> None:
    """Two points on edges of a cell, moved together away from their common vertex."""
    scene, cable, _ = held_down(comm, 9, "unstructured")
    shape, nodes = scene.net.strip_shape(), scene.net.nodes
    places, fractions = positions_of([cable]), fractions_of([cable])
    assert Polylines(nodes, places).collapsed(shape, fractions) == set()
    length = np.linalg.norm(np.diff(places, axis=0), axis=1)
    slides = np.array([node.slides for node in cable.state.nodes]) & ~cable.state.lifted
    k = max(np.flatnonzero(slides[1:] & slides[:-1]), key=lambda k: length[k])
    places[k + 1] = places[k] + 0.4 * (places[k + 1] - places[k])
    assert Polylines(nodes, places).collapsed(shape, fractions) == {0}
