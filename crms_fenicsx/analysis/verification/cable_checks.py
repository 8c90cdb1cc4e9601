"""Checks of the cables in equilibrium, in plain numpy from the positions of their nodes.

Length, tensions, places on edges and contact are computed anew from the positions and compared with
the cable's state. See `analysis.verification.verifier`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.verification.cable_forces import (
    below_others,
    contacts,
    forces,
    is_tense,
    outward_pulls,
)
from crms_fenicsx.analysis.verification.report import ROUNDED, UNBALANCED, Check
from crms_fenicsx.analysis.verification.row_checks import row_checks
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.points_on_edges import positions_of
from crms_fenicsx.cabling.cables.strip import Strip, StripShape
from crms_fenicsx.cabling.contact.lift_off import Polylines
from crms_fenicsx.foundation.meshes.triangles import lists, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints
from crms_fenicsx.foundation.surface.points import Edge, EdgePoint
from crms_fenicsx.model.cable_state import Crossing
from crms_fenicsx.model.laid_cable import LaidCable

LIMITS = {
    "ends of cables off their place": 1e-9,
    "nodes off their edges": 1e-6,
    "breaks in the path": 0.0,
    "crossing cables apart": 1e-9,
    "clamps that hold nothing": 0.0,
    "unbalanced forces of cables": UNBALANCED,
    "tension against length": 1e-6,
    "compression": 0.0,
    "slack cable too short": 1e-9,
    "pull at the ends": 1e-6,
    "pull on the membrane": 0.2,
    "depth below the membrane": 1e-3,
    "depth below another cable": 1e-3,
    "held by a line of the mesh": 0.03,
    "held by vertices": 0.05,
    "depth in a cable beside": 0.01,
    "sideways balance": UNBALANCED,
    "held where its line stays": 0.05,
    "sideways force without friction": 0.3,
    "friction beyond its bound": 0.1,
    "friction along beyond its bound": 0.01,
    "negative dissipation": 1e-12,
}
"""Largest error of each check, relative to the single cable: places to its length or to the edge,
its length to its elongation, other forces to its tension or to its contact force; see
docs/theory/verification.md. "pull on the membrane" allows a point that was released and touched
down again in the same step, where it stays. A cable half a cell beside its place on a line of the
mesh would be held sideways by 0.1 of its contact force."""

MESH_DEPENDENT = {
    "pull on the membrane", "depth below the membrane", "depth below another cable",
    "friction beyond its bound", "held by a line of the mesh", "held by vertices",
    "sideways force without friction", "unbalanced forces of cables", "sideways balance",
    "held where its line stays", "depth in a cable beside",
}  # fmt: skip
"""Checks that depend on the mesh size, or on forces that are small beside the scene's largest, by
which the solver stops: a state that fails them is doubtful."""


@dataclass(frozen=True)
class _Nodes:
    """Tables of a cable's nodes."""

    # ids, weights: (n, 3) vertices that a node lies on, and their weights; sliding points use their
    # fractions instead
    ids: Integers
    weights: Array
    # on, slides: (n,) whether a node lies on the mesh, and whether it slides along an edge
    on: Booleans
    slides: Booleans
    on_edge: Integers  # (n,) number of cable points touching the membrane on a node's edge
    breaks: int  # number of consecutive node pairs without a common cell

    @classmethod
    def of(cls, cable: LaidCable, strip: Strip, points: Mapping[Edge, int]) -> _Nodes:
        n = len(cable.state.nodes)
        ids = np.full((n, 3), strip.vertices[0], dtype=np.int64)
        weights = np.zeros((n, 3))
        on_edge = np.zeros(n, dtype=np.int64)
        for k, node in enumerate(cable.state.nodes):
            if node.point is not None:
                own, share = node.interpolation()
                ids[k, : len(own)], weights[k, : len(own)] = own, share
            if isinstance(node.point, EdgePoint):
                on_edge[k] = points.get(node.point.edge, 0)
        supports = [cable.state.nodes[k].support for k in cable.path_nodes()]
        both = (tuple(sorted({*a, *b})) for a, b in itertools.pairwise(supports))
        return cls(
            ids,
            weights,
            np.array([k.point is not None and k.kind != "crossing" for k in cable.state.nodes]),
            np.array([k.slides for k in cable.state.nodes]),
            on_edge,
            sum(not strip.rows(pair) for pair in both),
        )


class CableVerifier:
    """Checks the cables of a solved state; keeps the tables of their nodes until these change."""

    def __init__(self) -> None:
        self._numbering: CableNumbering | None = None
        self._nodes: list[_Nodes] = []
        self.doubts: dict[LaidCable, list[Check]] = {}
        """Checks by which each cable of the last state is doubtful."""

    def check(self, system: System, ends: Array, loads: Array) -> list[Check]:
        """Check all cables. Collective. Shapes: ends (n, 2, 3), loads (n_local, 3)."""
        assert system.cables is not None
        scene, numbering = system.scene, system.cables.numbering
        if numbering is not self._numbering:
            self._numbering = numbering
            on, strip = numbering.points, numbering.strip
            pairs = lists(strip.vertices[strip.simplices.corners[on.edges, :2]])
            points = {(a, b): n for (a, b), n in zip(pairs, ints(on.counts[on.edges]), strict=True)}
            self._nodes = [_Nodes.of(cable, numbering.strip, points) for cable in scene.cables]
        shape = scene.net.strip_shape()
        parts, pulls, free = _parts_and_forces(system)
        found: dict[str, tuple[float, str]] = {}
        joints = {joint.name: joint.position for joint in scene.joints}
        self.doubts = {}
        held = [cable.keeps_line or not system.slide for cable in scene.cables]
        lines = Polylines(scene.net.nodes, positions_of(scene.cables), np.array(held, dtype=bool))
        outward, depths = outward_pulls(scene, lines, shape), below_others(scene, lines, shape)
        beside, depths_beside = _beside(system) if scene.net.may_touch else ({}, {})
        rows = row_checks(system, loads, shape, beside)
        for c, (cable, nodes) in enumerate(zip(scene.cables, self._nodes, strict=True)):
            for k, name in enumerate(cable.state.laid.joints):
                if name is not None:
                    ends[c, k] = joints[name]
            values = _places(cable, nodes, ends[c], shape)
            values["breaks in the path"] = float(nodes.breaks)
            if cable.taut:
                values |= _tensions(cable, parts[c])
                values["pull at the ends"] = pulls[c]
                if cable.lifts_off:
                    own = outward[slice(*lines.nodes.starts[c : c + 2])]
                    values |= contacts(cable, nodes.on, nodes.on_edge, shape, own)
                if cable in depths:
                    values["depth below another cable"] = depths[cable]
                if cable in depths_beside:
                    values["depth in a cable beside"] = depths_beside[cable]
                values |= forces(cable, shape, free[c], beside.get(cable))
                values |= rows.get(cable, {})
            elif cable.cable.law == "total":
                short = np.linalg.norm(
                    np.diff(cable.state.positions[cable.contacts()], axis=0), axis=1
                )
                strain = float(short.sum()) / cable.L0 - 1
                values["slack cable too short"] = max(strain, abs(cable.tension) / cable.cable.EA)
            for name, value in values.items():
                value = np.inf if np.isnan(value) else value
                if name in MESH_DEPENDENT and value > LIMITS[name]:
                    check = Check(name, value, LIMITS[name], cable.name, binding=False)
                    self.doubts.setdefault(cable, []).append(check)
                if value >= found.get(name, (0.0, ""))[0]:
                    found[name] = value, cable.name
        if apart := _apart(scene):
            found["crossing cables apart"] = max(apart), ""
        if scene.clamps:
            found["clamps that hold nothing"] = float(_open_clamps(scene)), ""
        names = [name for name in LIMITS if name in found]
        worst = np.array([found[name][0] for name in names])
        scene.comm.Allreduce(MPI.IN_PLACE, worst, op=MPI.MAX)
        return [
            Check(name, float(value), LIMITS[name], found[name][1], name not in MESH_DEPENDENT)
            for name, value in zip(names, worst, strict=True)
        ]


def _beside(system: System) -> tuple[dict[LaidCable, Array], dict[LaidCable, float]]:
    """Forces (n, 3) at the nodes of cables that touch others side by side, and how much nearer
    they are than both radii, relative to these. Collective."""
    from crms_fenicsx.cabling.contact.side_by_side import overlaps

    return system.forces_beside(), overlaps(system.scene.net)


def _apart(scene: Scene) -> list[float]:
    """Distances between the points of crossing cables, relative to the shorter one."""
    return [
        float(np.linalg.norm(a.state.positions[i] - b.state.positions[k])) / min(a.length, b.length)
        for (a, i), (b, k) in _crossings(scene.cables, scene.net.crossings)
    ]


def _parts_and_forces(system: System) -> tuple[list[Array], list[float], list[float]]:
    """Lengths of spans between contacts, and errors of end and nodal forces. Collective."""
    assert system.cables is not None
    cables, tables = system.scene.cables, system.cables.tables
    numbering, g = system.cables.numbering, system.potential.g
    held = system.unknowns.held
    starts = np.cumsum([0] + [len(cable.state.nodes) for cable in cables])
    local = np.zeros(starts[-1] + 3 * len(cables))
    if tables is not None and len(tables.links):
        x = np.concatenate([cable.state.positions for cable in cables])
        first, second = tables.links.T
        d, eps = np.linalg.norm(x[second] - x[first], axis=1), tables.eps
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.where(d < eps, d / eps, 1.0)
        short = eps * (3 / 8 + 3 / 4 * u**2 - 1 / 8 * u**4)
        np.add.at(local, first, np.where(d < eps, short, d))
    for c, cable in enumerate(cables):
        errors = local[starts[-1] + 3 * c :][:3]
        for i, end in enumerate((cable.start, cable.end)):
            k = cable.node_of(end.which)
            given = cable.state.nodes[k].kind == "anchor" and cable.state.laid.joints[i] is None
            if cable.taut and given and numbering.is_mine(c, k):
                beside = cable.state.positions[cable.contacts()[1 if i == 0 else -2]]
                if np.linalg.norm(cable.state.positions[k] - beside) > 1e-6 * cable.length:
                    force = g[numbering.block(c, k)]
                    error = np.linalg.norm(force - end.reaction)
                    errors[i] = error / max(cable.tension, 1e-300)
        if cable.taut:
            known = numbering.node_blocks[starts[c] + np.array(cable.contacts()[1:-1], dtype=int)]
            blocks = known[(known >= 0) & (known < system.unknowns.n_owned)]
            errors[2] = np.sum(np.where(held[blocks], 0.0, g[blocks]) ** 2)
    total = np.zeros_like(local)
    system.scene.comm.Allreduce(local, total)
    parts = []
    for c, cable in enumerate(cables):
        parts.append(total[starts[c] : starts[c + 1]][cable.contacts()[:-1]])
    sums = total[starts[-1] :].reshape(-1, 3)
    pulls = [
        float(e) if is_tense(cable) else 0.0
        for e, cable in zip(sums[:, :2].max(axis=1), cables, strict=True)
    ]
    return parts, pulls, [float(free) ** 0.5 for free in sums[:, 2]]


def _places(cable: LaidCable, nodes: _Nodes, ends: Array, shape: StripShape) -> dict[str, float]:
    """Distances of the nodes from their places in the cable's state."""
    x, length = cable.state.positions, max(cable.length, 1e-300)
    away = [
        float(np.linalg.norm(x[k] - ends[k]))
        for k in (0, -1)
        if cable.state.nodes[k].kind == "anchor"
    ]
    touches = nodes.on & ~cable.state.lifted
    corners = shape.current[np.searchsorted(shape.strip.vertices, nodes.ids)]
    s = cable.state.fractions
    weights = np.where(nodes.slides[:, None], np.stack([1 - s, s, 0 * s], axis=1), nodes.weights)
    # Nodes on vertices take the size of the cells around: their edge may be much longer.
    edge = norm(corners[:, 1] - corners[:, 0])
    some = [k for k in np.flatnonzero(nodes.weights[:, 0] == 1.0) if touches[k]]
    supports = [p.support for k in some if (p := cable.state.nodes[k].point) is not None]
    if supports:
        edge[some] = shape.normals_and_sizes(supports)[1]
    edge = np.where(edge > 0.0, edge, cable.length)
    straight = touches & ~nodes.slides
    folds = touches & nodes.slides
    if cable.taut:  # on an edge that folds, a node lies at a share of the edge's length
        edge_sliders = folds & np.array([node.kind == "edge slider" for node in cable.state.nodes])
        straight |= edge_sliders
        folds &= ~edge_sliders
    else:
        straight |= folds
        folds = np.zeros_like(folds)
    off = norm(x - np.einsum("nk,nki->ni", weights, corners)) / edge
    before, after = norm(x - corners[:, 0]), norm(x - corners[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.abs(before / (before + after) - s)
    outside = np.maximum(np.maximum(-s, s - 1), 0.0)
    errors = np.concatenate(
        [off[straight], share[folds & (nodes.on_edge == 1)], outside[folds], [0.0]]
    )
    return {
        "ends of cables off their place": max(max(away, default=0.0) - _rounding(x), 0.0) / length,
        "nodes off their edges": float(errors.max()),
    }


def _rounding(positions: Array) -> float:
    """Error of a distance due to rounding of coordinates (length)."""
    return ROUNDED * float(np.abs(positions).max(initial=0.0))


def _tensions(cable: LaidCable, parts: Array) -> dict[str, float]:
    """Errors of tensions against span lengths, relative to the elongation."""
    EA, L0, length = cable.cable.EA, cable.L0, float(parts.sum()) - cable.state.law.smoothing_length
    spans: Array = np.zeros(0)
    of_part: Integers = np.zeros(0, dtype=np.int64)
    if cable.state.law.axial is not None and len(cable.state.law.axial.spans):
        from crms_fenicsx.cabling.friction.axial import gripped_nodes

        passed = np.searchsorted(gripped_nodes(cable), cable.contacts()[:-1], side="right")
        of_part = passed.astype(np.int64)
        spans = np.asarray(np.bincount(of_part, parts), dtype=np.float64)
    rounding = ROUNDED + _rounding(cable.state.positions) / L0
    start = cable.state.law.step_start
    if start is not None:
        force = start.tension + EA / start.length * (length - start.length)
        error = max(abs(cable.tension - force) / EA - rounding, 0.0)
        strain = max(abs(cable.tension), abs(force)) / EA
        return {"tension against length": error / max(strain, 1e-300)}
    errors = [abs(cable.length - length) / L0]
    if cable.state.law.parts is not None and cable.state.law.axial is None:
        of_part = cable.parts_of(cable.contacts()[:-1]).astype(np.int64)
        own = np.bincount(of_part, parts, len(cable.part_lengths)) - cable.state.law.parts.smoothing
        longer = np.maximum(own - cable.part_lengths, 0.0)
        errors.append(
            float(np.abs(cable.state.law.parts.tensions / EA * cable.part_lengths - longer).max())
            / L0
        )
    else:
        errors.append(abs(cable.tension / EA - max(length / L0 - 1, 0.0)))
    if cable.state.law.axial is not None and len(spans):
        unstressed = np.diff(
            [0.0, *cable.state.law.axial.arcs, L0 + cable.state.law.smoothing_length]
        )
        # Compare elongations, as the strain of a short span is dominated by rounding.
        told = unstressed * np.bincount(of_part, cable.part_tensions) / np.bincount(of_part) / EA
        by_law = np.maximum(spans - unstressed, 0.0)
        errors.append(float(np.abs(told - by_law).max()) / L0)
    strain = max(abs(cable.tension) / EA, length / L0 - 1, 1e-300)
    return {
        "tension against length": max(max(errors) - rounding, 0.0) / strain,
        "compression": max(-float(cable.tensions.min()), -cable.tension) / EA,
    }


def _open_clamps(scene: Scene) -> int:
    """Number of clamps between taut cables that lack a point on one of them."""
    count = 0
    for clamp in scene.clamps:
        cables = [scene.cable(name) for name in clamp.cables]
        if all(cable.taut for cable in cables):
            pairs = zip(cables, clamp.at, strict=True)
            count += any(
                cable.state.law.parts is None
                or not np.any(np.abs(cable.state.law.parts.at - at) < 1e-9)
                for cable, at in pairs
            )
    return count


def _crossings(
    cables: Sequence[LaidCable], crossings: Sequence[Crossing]
) -> list[list[tuple[LaidCable, int]]]:
    """Pairs of nodes at which crossing cables touch each other."""
    nodes: dict[int, list[tuple[LaidCable, int]]] = {}
    for cable in cables:
        for k, node in enumerate(cable.state.nodes):
            number = node.crossing
            if number is None or crossings[number].separated:
                continue
            if cable.taut and not cable.state.lifted[k]:
                nodes.setdefault(number, []).append((cable, k))
    return [pair for pair in nodes.values() if len(pair) == 2]
