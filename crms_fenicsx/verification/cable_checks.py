"""What must be true of the cables in an equilibrium, checked on their positions in plain numpy.

What a cable's state says of itself (length, tensions, places on edges, where it touches) is worked
out again from where its points are in space. See `crms_fenicsx.verification.verifier`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from crms_fenicsx.cables.numbering import CableNumbering
from crms_fenicsx.cables.strip import Strip
from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.contact_force import contact_forces, wrap_angles
from crms_fenicsx.contact.lift_off import is_foot, may_lift, outward_pulls
from crms_fenicsx.equilibrium.system import System
from crms_fenicsx.friction.gripped_nodes import held_nodes
from crms_fenicsx.meshes.triangles import norm
from crms_fenicsx.model.crossing import Crossing
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import INSIDE
from crms_fenicsx.paths.held_vertices import held_runs
from crms_fenicsx.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.surface.points import Edge, EdgePoint
from crms_fenicsx.verification.report import Check

LIMITS = {
    "ends of cable off their place": 1e-9,
    "nodes off their edges": 1e-6,
    "breaks in the path": 0.0,
    "crossing cables apart": 1e-9,
    "tension against length": 1e-9,
    "compression": 0.0,
    "slack cable too short": 1e-9,
    "pull at the ends": 1e-6,
    "pull on the membrane": 0.2,
    "depth below the membrane": 1e-3,
    "held by a line of the mesh": 0.03,
    "held by vertices": 0.05,
    "friction beyond its bound": 0.06,
    "friction along beyond its bound": 3e-3,
    "negative dissipation": 1e-12,
}
"""What is checked of each cable, and how far it may be from true: places relative to the scene or
the edge, lengths to the unstressed length, tensions to the axial stiffness, other forces to the
tension, or to the membrane's own nodal forces where those are larger. A cable pulls where it
touched down on a point at which it was let go in the same step: there it stays. What holds a cable
sideways is relative to the force with which it presses there, or on the whole: it would be 0.1 on a
line of the mesh half a cell beside its place."""

IN_LINE = 3
"""Vertices in a row from which on they are a line of the mesh."""

CRUDE = {
    "pull on the membrane", "depth below the membrane", "friction beyond its bound",
    "held by vertices",
}  # fmt: skip
"""Checks that depend on how coarse the mesh is: a state that fails them is doubtful."""


@dataclass(frozen=True)
class _Nodes:
    """A cable's nodes as tables.

    Attributes
    ----------
    ids, weights : (n, 3)
        Vertices on which a node lies, and their weights; those of sliding points are found from
        their fractions.
    on, slides : (n,)
        Whether a node has a place on the mesh, and slides along an edge.
    on_edge : (n,)
        How many points of cables that touch the membrane lie on a node's edge.
    breaks
        How often two nodes in a row do not lie on one cell.
    """

    ids: Integers
    weights: Array
    on: Booleans
    slides: Booleans
    on_edge: Integers
    breaks: int

    @classmethod
    def of(cls, cable: LaidCable, strip: Strip, points: Mapping[Edge, int]) -> _Nodes:
        n = len(cable.nodes)
        ids = np.full((n, 3), strip.vertices[0], dtype=np.int64)
        weights = np.zeros((n, 3))
        on_edge = np.zeros(n, dtype=np.int64)
        for k, node in enumerate(cable.nodes):
            if node.point is not None:
                own, share = node.interpolation()
                ids[k, : len(own)], weights[k, : len(own)] = own, share
            if isinstance(node.point, EdgePoint):
                on_edge[k] = points.get(node.point.edge, 0)
        on_path = cable.path_nodes()
        supports = [p.support for k in on_path if (p := cable.nodes[k].point) is not None]
        both = (tuple(sorted({*a, *b})) for a, b in itertools.pairwise(supports))
        return cls(
            ids,
            weights,
            np.array([k.point is not None and k.kind != "crossing" for k in cable.nodes]),
            np.array([k.slides for k in cable.nodes]),
            on_edge,
            sum(not strip.rows(pair) for pair in both),
        )


class CableVerifier:
    """Checks the cables of a solved state; keeps tables of their nodes while these stay."""

    def __init__(self) -> None:
        self._numbering: CableNumbering | None = None
        self._nodes: list[_Nodes] = []

    def check(self, system: System, ends: Array, force: float) -> list[Check]:
        """Check all cables. Collective.

        Parameters
        ----------
        system
            The potential that was minimised, with the forces of supports in its gradient.
        ends : (n, 2, 3)
            Where the cables' first and last nodes were told to be.
        force
            The scene's force: norm of one kind of nodal forces.
        """
        nodal = force / np.sqrt(system.unknowns.n_global)
        assert system.cables is not None
        scene, numbering = system.scene, system.cables.numbering
        if numbering is not self._numbering:
            self._numbering = numbering
            points = {edge: len(members) for edge, members in numbering.on_edge.items()}
            self._nodes = [_Nodes.of(cable, numbering.strip, points) for cable in scene.cables]
        shape = scene.net.strip_shape()
        parts, pulls = _parts_and_pulls(system)
        found: dict[str, tuple[float, str]] = {}
        joints = {joint.name: joint.position for joint in scene.joints}
        for c, (cable, nodes) in enumerate(zip(scene.cables, self._nodes, strict=True)):
            for k, name in enumerate(cable.joints):
                if name is not None:
                    ends[c, k] = joints[name]
            values = _places(cable, nodes, ends[c], scene.membrane.size, shape)
            values["breaks in the path"] = float(nodes.breaks)
            if cable.taut:
                values |= _tensions(cable, parts[c])
                values["pull at the ends"] = pulls[c]
                if not cable.sleeve:
                    values |= _contacts(cable, nodes, shape, nodal)
                values |= _held(cable, shape, nodal)
                values |= _friction(cable, shape, nodal)
            elif cable.cable.law == "total":
                short = np.linalg.norm(np.diff(cable.positions[cable.contacts()], axis=0), axis=1)
                strain = float(short.sum()) / cable.L0 - 1
                values["slack cable too short"] = max(strain, abs(cable.tension) / cable.cable.EA)
            for name, value in values.items():
                value = np.inf if np.isnan(value) else value
                if value >= found.get(name, (0.0, ""))[0]:
                    found[name] = value, cable.name
        apart = [
            float(np.linalg.norm(np.diff([c.positions[k] for c, k in pair], axis=0)))
            for pair in _crossings(scene.cables, scene.net.crossings)
        ]
        if apart:
            found["crossing cables apart"] = max(apart) / scene.membrane.size, ""
        names = [name for name in LIMITS if name in found]
        worst = np.array([found[name][0] for name in names])
        scene.comm.Allreduce(MPI.IN_PLACE, worst, op=MPI.MAX)
        return [
            Check(name, float(value), LIMITS[name], found[name][1], name not in CRUDE)
            for name, value in zip(names, worst, strict=True)
        ]


def _parts_and_pulls(system: System) -> tuple[list[Array], list[float]]:
    """For each cable the lengths of its parts between contacts, and an error of its ends' forces.

    Lengths are the smoothed ones that the potential has, of the positions that the cables have.
    The error is that of the tension along the end, as its anchor carries it, relative to it.
    Collective.
    """
    assert system.cables is not None
    cables, tables = system.scene.cables, system.cables.tables
    numbering = system.cables.numbering
    starts = np.cumsum([0] + [len(cable.nodes) for cable in cables])
    local = np.zeros(starts[-1] + 2 * len(cables))
    if tables is not None and len(tables.links):
        x = np.concatenate([cable.positions for cable in cables])
        first, second = tables.links.T
        d, eps = np.linalg.norm(x[second] - x[first], axis=1), tables.eps
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.where(d < eps, d / eps, 1.0)
        short = eps * (3 / 8 + 3 / 4 * u**2 - 1 / 8 * u**4)
        np.add.at(local, first, np.where(d < eps, short, d))
    for c, cable in enumerate(cables):
        for i, end in enumerate((cable.start, cable.end)):
            k = cable.node_of(end.which)
            given = cable.nodes[k].kind == "anchor" and cable.joints[i] is None
            if cable.taut and given and numbering.is_mine(c, k):
                beside = cable.positions[cable.contacts()[1 if i == 0 else -2]]
                if np.linalg.norm(cable.positions[k] - beside) > 1e-6 * cable.length:
                    force = system.potential.g[numbering.block(c, k)]
                    error = np.linalg.norm(force - end.reaction)
                    local[starts[-1] + 2 * c + i] = error / max(cable.tension, 1e-300)
    total = np.zeros_like(local)
    system.scene.comm.Allreduce(local, total)
    parts = []
    for c, cable in enumerate(cables):
        parts.append(total[starts[c] : starts[c + 1]][cable.contacts()[:-1]])
    errors = total[starts[-1] :].reshape(-1, 2).max(axis=1)
    # What is not told apart from rounding of the length is no error of a small tension.
    return parts, [
        float(e) if cable.tension > 1e-9 * cable.cable.EA else 0.0
        for e, cable in zip(errors, cables, strict=True)
    ]


def _places(
    cable: LaidCable, nodes: _Nodes, ends: Array, size: float, shape: StripShape
) -> dict[str, float]:
    """Distances of the nodes from where they say that they are."""
    x = cable.positions
    away = [
        float(np.linalg.norm(x[k] - ends[k])) for k in (0, -1) if cable.nodes[k].kind == "anchor"
    ]
    touches = nodes.on & ~cable.lifted
    corners = shape.current[np.searchsorted(shape.strip.vertices, nodes.ids)]
    s = cable.fractions
    weights = np.where(nodes.slides[:, None], np.stack([1 - s, s, 0 * s], axis=1), nodes.weights)
    edge = norm(corners[:, 1] - corners[:, 0])
    edge = np.where(edge > 0.0, edge, size)
    straight = touches & ~nodes.slides
    folds = touches & nodes.slides
    if cable.taut:  # what lies on an edge that folds is at a share of the edge's length
        rails = folds & np.array([node.kind == "rail" for node in cable.nodes])
        straight |= rails
        folds &= ~rails
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
        "ends of cable off their place": max(away, default=0.0) / size,
        "nodes off their edges": float(errors.max()),
    }


def _tensions(cable: LaidCable, parts: Array) -> dict[str, float]:
    """Tensions against the lengths of the cable's parts."""
    EA, L0, length = cable.cable.EA, cable.L0, float(parts.sum()) - cable.excess
    spans: Array = np.zeros(0)
    of_part: Integers = np.zeros(0, dtype=np.int64)
    if cable.axial is not None and len(cable.axial.spans):
        from crms_fenicsx.friction.axial import gripped_nodes

        passed = np.searchsorted(gripped_nodes(cable), cable.contacts()[:-1], side="right")
        of_part = passed.astype(np.int64)
        spans = np.asarray(np.bincount(of_part, parts), dtype=np.float64)
    start = cable.step_start
    if start is not None:
        force = start.tension + EA / start.length * (length - start.length)
        return {"tension against length": abs(cable.tension - force) / EA}
    errors = [abs(cable.tension / EA - max(length / L0 - 1, 0.0)), abs(cable.length - length) / L0]
    if cable.axial is not None and len(spans):
        unstressed = np.diff([0.0, *cable.axial.arcs, L0 + cable.excess])
        # By elongations, as the strain of a short span is rounded.
        told = unstressed * np.bincount(of_part, cable.part_tensions) / np.bincount(of_part) / EA
        by_law = np.maximum(spans - unstressed, 0.0)
        errors.append(float(np.abs(told - by_law).max()) / L0)
    return {
        "tension against length": max(errors),
        "compression": max(-float(cable.tensions.min()), -cable.tension) / EA,
    }


def _contacts(cable: LaidCable, nodes: _Nodes, shape: StripShape, nodal: float) -> dict[str, float]:
    """How hard the cable pulls the membrane outward, and how deep it runs below it."""
    pull = depth = 0.0
    on = [k for k in may_lift(cable) if not cable.lifted[k]]
    supports = [p.support for k in on if (p := cable.nodes[k].point) is not None]
    if on:
        pull = float(outward_pulls(cable, on, *shape.normals_and_sizes(supports)).max())
        pull *= cable.tension / max(cable.tension, nodal)
    contacts = np.array(cable.contacts())
    lifted = [k for k in np.flatnonzero(cable.lifted) if nodes.on[k] and not is_foot(cable, int(k))]
    for k in lifted:
        point, s = cable.nodes[k].point, float(cable.fractions[k])
        assert point is not None
        if isinstance(point, EdgePoint) and (nodes.on_edge[k] or not INSIDE < s < 1 - INSIDE):
            continue
        after = int(np.searchsorted(contacts, k))
        span = norm(cable.positions[contacts[after - 1 : after + 1]] - cable.positions[k])
        if span.min() <= 1e-9 * cable.length:  # its edge lies beyond an end of the span
            continue
        place = shape.mean(*cable.interpolation(int(k)))
        normal, cell = shape.normals_and_sizes([point.support])
        depth = max(depth, -float((cable.positions[k] - place) @ normal[0]) / float(cell[0]))
    return {"pull on the membrane": max(pull, 0.0), "depth below the membrane": depth}


def _held(cable: LaidCable, shape: StripShape, nodal: float) -> dict[str, float]:
    """The forces with which the mesh holds a cable sideways, to those with which the cable presses.

    A cable that is at rest because it lies on vertices, or has run into them, is not where it would
    be on another mesh. At single ones that depends on how coarse the mesh is.
    """
    values = {"held by a line of the mesh": 0.0, "held by vertices": 0.0}
    runs = held_runs(cable, shape)
    if runs:
        ways = np.diff(cable.positions[cable.contacts()], axis=0)
        ways *= (cable.part_tensions / np.maximum(norm(ways), 1e-300))[:, None]
        press = float(norm(np.diff(ways, axis=0)).sum())
        values["held by vertices"] = sum(run.excess for run in runs) / max(press, nodal)
        lines = [run.excess / max(run.press, nodal) for run in runs if len(run.vertices) >= IN_LINE]
        values["held by a line of the mesh"] = max(lines, default=0.0)
    return values


def _friction(cable: LaidCable, shape: StripShape, nodal: float) -> dict[str, float]:
    """Friction forces, as the cable's way in space says, against contact forces; and heat."""
    values: dict[str, float] = {}
    friction = cable.cable.sideways
    if friction is None and cable.axial is None:
        return values
    from crms_fenicsx.friction.axial import gripped_nodes
    from crms_fenicsx.friction.lateral import energies

    if friction is not None and cable.has_coulomb and cable.grip is not None:
        forces = contact_forces(cable, shape)
        bounds = friction.at_rest * forces.bearing
        # At a held edge the cable may turn by so much that its sides there and on the stress-free
        # membrane, on which slip is measured, are not the same.
        free = [
            k
            for k in held_nodes(cable)
            if cable.nodes[k].kind == "fold"
            and k not in cable.blocked
            and cable.nodes[k].crossing is None
        ]
        excess = np.maximum(np.abs(forces.lateral[free]) - bounds[free], 0.0).sum()
        values["friction beyond its bound"] = float(excess) / max(cable.tension, nodal)
        heat = energies(cable, shape)[1]
        values["negative dissipation"] = -heat / max(cable.tension * cable.length, 1e-300)
    if cable.axial is not None and len(cable.axial.spans):
        nodes, tensions = gripped_nodes(cable), cable.part_tensions
        at = np.searchsorted(cable.contacts(), nodes)
        before, after = tensions[at - 1], tensions[at]
        angles = cable.cable.along * wrap_angles(cable, shape)[nodes]
        bounds = 2 * np.sqrt(before * after) * np.sinh(angles / 2)
        excess = np.max(np.abs(after - before) - bounds, initial=0.0)
        largest = max(float(tensions.max()), 1e-300)
        values["friction along beyond its bound"] = float(excess) / largest
        heat = -cable.axial.loss / max(cable.tension * cable.length, 1e-300)
        values["negative dissipation"] = max(values.get("negative dissipation", 0.0), heat)
    return values


def _crossings(
    cables: Sequence[LaidCable], crossings: Sequence[Crossing]
) -> list[list[tuple[LaidCable, int]]]:
    """The two nodes of each crossing at which the cables touch each other."""
    nodes: dict[int, list[tuple[LaidCable, int]]] = {}
    for cable in cables:
        for k, node in enumerate(cable.nodes):
            number = node.crossing
            if number is None or crossings[number].separated:
                continue
            if cable.taut and not cable.lifted[k]:
                nodes.setdefault(number, []).append((cable, k))
    return [pair for pair in nodes.values() if len(pair) == 2]
