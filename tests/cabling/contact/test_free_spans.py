"""Free spans of several cables at once, against loops over their nodes."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from cabled_square import put
from strip_roof import along, roof

from crms_fenicsx.cabling.cables.points_on_edges import NodeTable
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.active_set import ActiveSet
from crms_fenicsx.cabling.contact.free_spans import FreeSpans, Gap, under
from crms_fenicsx.cabling.contact.lift_off import is_foot, size_at
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.surface.points import CellPoint, EdgePoint
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.laid_cable import LaidCable


def slow_bends(cables: list[LaidCable], c: int, k: int) -> list[Array]:
    """Points where the other cables fold the edge under a node, in order."""
    own = cables[c].state.nodes[k]
    points = [
        (float(other.state.fractions[m]), d, m)
        for d, other in enumerate(cables)
        for m, node in enumerate(other.state.nodes)
        if d != c and other.taut and not other.state.lifted[m]
        if isinstance(node.point, EdgePoint) and node.point.support == own.support
    ]
    return [cables[d].state.positions[m] for _, d, m in sorted(points)]


def slow_gaps(cables: list[LaidCable], c: int, shape: StripShape) -> dict[int, Gap]:
    """Gaps at the lifted nodes of one cable."""
    cable, found = cables[c], {}
    for a, b in pairwise(cable.contacts()):
        for k in range(a + 1, b):
            if cable.state.nodes[k].kind != "crossing" and not is_foot(cable, k):
                ends = (cable.state.positions[a], cable.state.positions[b])
                found[k] = under(
                    cable.state.nodes[k].support, ends, shape, slow_bends(cables, c, k)
                )
    return found


def net(seed: int) -> tuple[StripShape, list[LaidCable]]:
    """Cables over the same edges of a hilly roof, lifted here and there, the last one slack."""
    rng = np.random.default_rng(seed)
    shape = roof(rng.uniform(0.0, 0.3, 6).tolist())
    cables = [along(shape, (-1.0, 0.5, 0.0), (6.0, 0.5, 0.0))[0] for _ in range(4)]
    for cable in cables:
        n = len(cable.state.nodes)
        nodes = list(cable.state.nodes)
        nodes[1] = CableNode("tied", CellPoint((0, 1, 6), (0.3, 0.4, 0.3)))  # the anchor's foot
        nodes[4] = CableNode("crossing", CellPoint((1, 2, 7), (0.3, 0.4, 0.3)))
        cable.update(nodes=tuple(nodes), taut=cable is not cables[-1])
        fractions = np.where(np.isnan(cable.state.fractions), np.nan, rng.uniform(0.2, 0.8, n))
        cable.update(fractions=fractions, lifted=rng.random(n) < 0.6)
        put(cable, "lifted", [0, -1], False)
        cable.update(positions=cable.state.positions + rng.uniform(-0.3, 0.3, (n, 3)))
    return shape, cables


@pytest.mark.parametrize("seed", range(8))
def test_gaps_of_all_cables_are_those_of_loops_over_their_nodes(seed: int) -> None:
    shape, cables = net(seed)
    chosen = np.array([True, False, True, True])
    free = FreeSpans(cables, NodeTable.of(cables), shape, chosen, folded=True)
    expected = [(c, k, gap) for c in (0, 2, 3) for k, gap in slow_gaps(cables, c, shape).items()]
    at = [(int(free.nodes.cable[row]), int(free.nodes.place[row])) for row in free.rows]
    assert at == [(c, k) for c, k, _ in expected] and len(at) > 5
    for found, (_, _, gap) in zip(free.gaps(np.arange(len(at))), expected, strict=True):
        for one, other in zip(found, gap, strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("height", [-0.1, 0.0, 0.05])
def test_nodes_are_moved_onto_spans_and_captured_where_these_are_low(height: float) -> None:
    shape, cables = net(1)
    free = FreeSpans(cables, NodeTable.of(cables), shape, np.ones(4, dtype=bool), folded=True)
    count = 0
    for c, cable in enumerate(cables):
        gaps, x = slow_gaps(cables, c, shape), cable.state.positions
        low = {
            k
            for k, gap in gaps.items()
            if gap.inside and gap.gap < height * size_at(shape, cable.state.nodes[k].support)
        }
        assert low <= free.captured(c, height).keys()  # others pass beside a vertex
        free.move(c)
        count += len(low)
        for a, b in pairwise(cable.contacts()):
            for k in range(a + 1, b):
                flat = x[a] + (k - a) / (b - a) * (x[b] - x[a])
                place = gaps[k].above if k in gaps else flat
                np.testing.assert_array_equal(cable.state.positions[k], place)
    assert count > 2


@pytest.mark.parametrize("before", [None, 2.0, 2.5])
def test_spans_low_above_the_membrane_close_but_not_beside_a_released_contact(
    before: float | None,
) -> None:
    """Folds around one vertex bulge together: where one contact pulled off, the next one would."""
    shape = roof([0.0, -0.02, -0.02, -0.02, 0.0])
    cable, at = along(shape)
    cable.update(lifted=np.isin(np.arange(9), range(1, 8)))
    pulled = set() if before is None else {(cable.name, cable.state.nodes[at[before]].support)}
    memory = SimpleNamespace(released=pulled, settled=set(), has_rested=lambda _: False)
    active = ActiveSet(SimpleNamespace(cables=[cable]), memory)  # type: ignore[arg-type]
    free = FreeSpans([cable], NodeTable.of([cable]), shape, np.ones(1, dtype=bool))
    active.only_lifted = True
    texts = active._change(0, [], free, ())
    assert not active.only_lifted  # paths must not change together with it
    apart = {None: [], 2.0: [1.5, 2.0, 2.5], 2.5: [2.0, 2.5, 3.0]}[before]
    assert [x for x, k in at.items() if cable.state.lifted[k]] == apart
    assert len(texts) == 7 - len(apart)
