"""Grip of the membrane on a cable along its axis: history, friction bounds, dissipation.

The history is the cable's place on the stress-free membrane when the last load step ended, as for
friction sideways (`crms_fenicsx.friction.slip`), and there the unstressed arc of the cable that would
rest at each place: the arc that sat there, less the elastic slip. A node looks up the place nearest
to its own. So nothing is lost when the cable also slides sideways, and over vertices.

The friction bound of a node follows from the angle of wrap and the tension there, which the
minimisation does not know yet: it is held while the potential is minimised. Then the law
``T2/T1 = exp(mu theta)`` itself is solved for the lengths found (`crms_fenicsx.energies.capstan_chain`),
and gives the bounds for the next pass. Only lengths and angles change from pass to pass, little.
A cable of which no bounds are known yet begins without friction: its lengths then are near to
those sought, whereas one that sticks would have those that the movement of its ends tears it to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.contact_force import edge_directions, turns, wrap_angles
from crms_fenicsx.contact.lift_off import is_foot
from crms_fenicsx.friction.aitken import Pace
from crms_fenicsx.friction.lateral import held_nodes, succession
from crms_fenicsx.friction.slip import Support, material_place
from crms_fenicsx.model.friction_history import AxialGrip, MaterialCurve
from crms_fenicsx.model.laid_cable import COINCIDENT, LaidCable
from crms_fenicsx.runtime.arrays import Array

SETTLED = 1e-4
"""Change of the tensions, relative to the sum of the bounds, below which these have settled. What
is sharper than sideways costs one short pass here."""
LEAST_PART = 0.01
"""Least part of a change of the bounds that is taken."""


@dataclass(frozen=True)
class RestPlaces:
    """What rests at the nodes that friction holds: ``slope * s + offset``, s their places on edges.

    Attributes
    ----------
    nodes
        Their numbers.
    slope, offset, rest : (n,)
        The rest is that at their current places (length).
    size : (n,)
        Size of the stress-free cells around (length).
    """

    nodes: list[int]
    slope: Array
    offset: Array
    rest: Array
    size: Array


def laid_grip(cable: LaidCable, shape: StripShape) -> AxialGrip:
    """Grip of a cable that has the same strain everywhere, as one that has just been laid."""
    supports = _supports(cable)
    n = len(supports)
    curve, rest = _curve(cable, shape, [], np.zeros(0))
    none, zero = np.zeros(0), np.zeros(n)
    return AxialGrip(
        curve, rest, supports, zero, zero, none, none, none, zero
    )  # fmt: skip


def _supports(cable: LaidCable) -> tuple[Support, ...]:
    """Places of the nodes that friction can hold along the cable.

    Not the held vertex that an anchor lies on: between the two there is no cable.
    """
    last = len(cable.nodes) - 1
    supports = []
    for k in held_nodes(cable):
        node, anchor = cable.nodes[k], {1: 0, last - 1: last}.get(k)
        if anchor is not None and node.kind == "vertex" and cable.nodes[anchor].kind == "anchor":
            away = np.linalg.norm(cable.positions[k] - cable.positions[anchor])
            if away <= COINCIDENT * cable.length:
                continue
        assert node.point is not None
        supports.append(node.point.support)
    return tuple(supports)


def is_aligned(cable: LaidCable) -> bool:
    """Whether the grip has the nodes that friction can hold now."""
    return cable.axial is None or not cable.taut or cable.axial.supports == _supports(cable)


def gripped_nodes(cable: LaidCable) -> list[int]:
    """Numbers of the nodes that the grip has, which stay while its potential is minimised."""
    assert cable.axial is not None
    own = set(cable.axial.supports)
    return [
        k
        for k in held_nodes(cable)
        if (point := cable.nodes[k].point) is not None and point.support in own
    ]


def align_axial(cable: LaidCable) -> None:
    """Bring the bounds to the nodes that the cable has now."""
    grip = cable.axial
    if grip is None or (now := _supports(cable)) == grip.supports:
        return
    stays, rows, heirs = succession(grip.supports, now)
    bounds, eps, slips = np.zeros((3, len(now)))
    bounds[stays], eps[stays], slips[stays] = grip.bounds[rows], grip.eps[rows], grip.slips[rows]
    for gone, new in heirs:
        bounds[new] += grip.bounds[gone].sum() / len(new)
        eps[new] += grip.eps[gone].sum() / len(new)
    cable.state.axial = replace(grip, supports=now, bounds=bounds, eps=eps, slips=slips)


def rest_places(cable: LaidCable, shape: StripShape) -> RestPlaces:
    """What rests at a cable's nodes, and how that changes along their edges.

    Notes
    -----
    A fold point that is moved along its edge by v takes the cable's material along by v . t, with t
    the mean of the cable's directions before and after: divided by the stretch, this is the slope.
    With it the forces of the tensions T1 and T2 and of friction on the fold point sum up to
    ``(T1 + T2)/2 (t2 - t1)`` along the edge, which vanishes on a geodesic as without friction.
    """
    grip = cable.axial
    assert grip is not None
    nodes, contacts, direction = gripped_nodes(cable), cable.contacts(), turns(cable)
    places = np.array([material_place(cable, k, shape) for k in nodes]).reshape(-1, 3)
    slope, size = np.zeros((2, len(nodes)))
    for i, k in enumerate(nodes):
        point = cable.nodes[k].point
        assert point is not None
        size[i] = shape.stress_free_size(point.support)
        if cable.nodes[k].slides and k in direction:
            at = contacts.index(k)
            stretch = 1 + cable.part_tensions[at - 1 : at + 1].mean() / cable.cable.EA
            edge = edge_directions(cable, [k], shape)[0] * _edge_length(cable, k, shape)
            slope[i] = edge @ np.add(*direction[k]) / (2 * stretch)
    rest = _rest_at(grip, places)
    fractions = np.where(np.isnan(cable.fractions[nodes]), 0.0, cable.fractions[nodes])
    return RestPlaces(nodes, slope, rest - slope * fractions, rest, size)


def _edge_length(cable: LaidCable, k: int, shape: StripShape) -> float:
    """Length of the edge of a node, through the node."""
    point = cable.nodes[k].point
    assert point is not None
    return float(sum(np.linalg.norm(shape.at(v) - cable.positions[k]) for v in point.support))


def _rest_at(grip: AxialGrip, places: Array) -> Array:
    """Unstressed arcs that rest at places on the stress-free membrane (length)."""
    at, _, parts = grip.curve.nearest(places)
    if np.any(parts < 0):  # the cable was nowhere on the membrane
        return np.zeros(len(places))
    first, last = grip.curve.arc[[0, -1]]
    inside = np.clip(at, first, last)
    # beyond its ends, the cable as it is on the whole
    rate = (grip.rest[-1] - grip.rest[0]) / (last - first)
    return np.interp(inside, grip.curve.arc, grip.rest) + rate * (at - inside)


class AxialLag:
    """Brings the bounds of one cable in a load step to those of the state that they lead to."""

    settled = SETTLED

    def __init__(self, cable: LaidCable) -> None:
        self.cable = cable
        self._pace = Pace(LEAST_PART)

    def renew(self, shape: StripShape) -> float:
        """Take the bounds from the current state.

        Returns
        -------
        Change of the tension that follows from them, relative to their sum.
        """
        from crms_fenicsx.energies.capstan_chain import LAW, find_slips

        cable, grip = self.cable, self.cable.axial
        assert grip is not None
        strain = cable.length / cable.L0 - 1
        if not cable.taut or strain <= 0.0 or len(grip.spans) != len(grip.supports) + 1:
            return 0.0
        friction, EA = cable.cable.friction, cable.cable.EA
        places = rest_places(cable, shape)
        wrap = cable.cable.along * wrap_angles(cable, shape)[places.nodes]
        # The slip of a node that just holds, relative to what its force stretches one cell by: so
        # sticking is much stiffer than the cable on every mesh, however stiff the cable is.
        eps = np.where(wrap > 0, friction.tolerance * places.size * wrap * strain, 1.0)  # type: ignore[union-attr]
        slips, unstressed = grip.slips.copy(), np.zeros(len(grip.spans))
        L0 = cable.L0 + cable.excess
        find_slips(LAW, grip.spans, places.rest, L0, wrap, eps, slips, unstressed)
        strains = (grip.spans - unstressed) / unstressed
        bounds = EA * capstan_bounds(np.sqrt(strains[1:] * strains[:-1]), wrap, slips / eps)
        total, used = float(bounds.sum()), float(grip.bounds.sum())
        if used == 0.0 == total:
            return 0.0
        # What counts is the tension: as nodes move along their edges, neighbours share differently.
        error = np.abs(np.cumsum(bounds - grip.bounds)).max()
        change = float(error) / max(total, 1e-3 * used)
        if change > self.settled:  # the state found stays the one that belongs to its bounds
            tensions = _by_link(cable, EA * strains)
            if used > 0.0:
                part = self._pace.of(grip.supports, bounds - grip.bounds)
                # Where nothing holds the cable, now or before, eps has no meaning.
                before = np.where(grip.bounds > 0.0, grip.eps, eps)
                eps = (1 - part) * before + part * np.where(wrap > 0.0, eps, before)
                bounds = (1 - part) * grip.bounds + part * bounds
            cable.state.axial = replace(grip, bounds=bounds, eps=eps, tensions=tensions)
        return change


def capstan_bounds(mean: Array, wrap: Array, y: Array) -> Array:
    """Friction bounds with which the potential has the tensions of the law, relative to EA.

    Parameters
    ----------
    mean : (n,)
        Geometric mean of the strains beside each node.
    wrap : (n,)
        Coefficient of friction times angle of wrap.
    y : (n,)
        Slip relative to the one at which friction is fully mobilised.

    Notes
    -----
    With the tensions T1 and T2 and ``P = T + T^2/(2 EA)``, the work of the tension per unstressed
    arc, it is ``(P2 - P1)/f'(y)``; the difference ``T2 - T1 = 2 sqrt(T1 T2) sinh(wrap/2)`` of a
    node that slides is written so that it stays accurate for small angles.
    """
    share = np.minimum(np.abs(y), 1.0)
    z = wrap * share * (2.0 - share)
    return wrap * (mean * _sinhc(z / 2) + mean**2 * _sinhc(z))


def _sinhc(x: Array) -> Array:
    """sinh(x)/x."""
    small = np.abs(x) < 1e-4
    return np.where(small, 1 + x**2 / 6, np.sinh(x) / np.where(small, 1.0, x))


def found(
    cable: LaidCable, spans: Array, unstressed: Array, tensions: Array, slips: Array, loss: float
) -> None:
    """Take the state of a solve.

    Parameters
    ----------
    cable
        Its tension is set, from its length.
    spans, unstressed, tensions : (n + 1,)
        Lengths (length) and tensions (force) between the nodes that friction holds.
    slips, loss
        As in `AxialGrip`.
    """
    grip = cable.axial
    assert grip is not None
    cable.state.tension = cable.cable.EA / cable.L0 * max(cable.length - cable.L0, 0.0)
    cable.state.axial = replace(
        grip,
        tensions=_by_link(cable, tensions),
        spans=spans.copy(),
        arcs=np.cumsum(unstressed)[:-1],
        slips=slips.copy(),
        loss=loss,
    )


def _by_link(cable: LaidCable, of_spans: Array) -> Array:
    """Values of spans for the cable's parts between the nodes that it touches."""
    span = np.searchsorted(gripped_nodes(cable), cable.contacts()[:-1], side="right")
    return np.asarray(of_spans[span])


def commit_axial(cable: LaidCable, shape: StripShape) -> None:
    """End a load step: what rests now at the cable's place is where the next step begins."""
    grip = cable.axial
    if grip is None:
        return
    if not cable.taut:
        cable.state.axial = replace(laid_grip(cable, shape), dissipated=grip.dissipated + grip.loss)
        return
    held = np.where(grip.bounds > 0, np.clip(grip.slips, -grip.eps, grip.eps), 0.0)
    curve, rest = _curve(cable, shape, gripped_nodes(cable), grip.arcs - held)
    cable.state.axial = replace(
        grip, curve=curve, rest=rest, slips=held, loss=0.0, dissipated=grip.dissipated + grip.loss
    )


def _curve(
    cable: LaidCable, shape: StripShape, nodes: list[int], arcs: Array
) -> tuple[MaterialCurve, Array]:
    """Where a cable is over the stress-free membrane, and the arcs that rest at its points.

    Places under the cable where it is off the membrane count as well: there it may touch down.
    """
    last = len(cable.nodes) - 1
    on = [k for k in cable.rim() if not (0 < k < last and is_foot(cable, k))]
    points = np.array([material_place(cable, k, shape) for k in on]).reshape(-1, 3)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    arc = np.concatenate([np.zeros(min(len(points), 1)), np.cumsum(steps)])
    none = np.zeros(len(on))
    curve = MaterialCurve(points, arc, np.zeros(len(on), dtype=np.int64), none, none)
    way = np.linalg.norm(np.diff(cable.positions, axis=0), axis=1)
    passed = np.concatenate([[0.0], np.cumsum(way)])
    rest = np.interp(passed, passed[[0, *nodes, last]], [0.0, *arcs, cable.L0 + cable.excess])
    return curve, rest[on]
