"""Vertices of the mesh that hold a cable sideways.

A fold point slides along its edge until the cable's force is perpendicular to it. A node on a
vertex cannot slide, nor can a fold point within the smoothing length of a vertex, and the mesh
carries the cable's lateral pull there, in the surface and perpendicular to the cable. Friction may
carry part of it; in equilibrium it carries all, and a freely sliding cable is held nowhere.

A cable along a mesh line presses a valley into it, which it cannot leave at one vertex alone, since
the others keep the valley in place. So consecutive vertices form a run, which is left as a whole.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import forces_at
from crms_fenicsx.foundation.meshes.triangles import arc_lengths
from crms_fenicsx.foundation.runtime.arrays import Array, ints
from crms_fenicsx.foundation.surface.points import edge_of
from crms_fenicsx.model.cable_state import CableNode
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL


@dataclass(frozen=True)
class HeldVertex:
    """A vertex that a cable visits or has reached."""

    vertex: int  # its id
    nodes: tuple[int, ...]  # the cable's nodes there, in order
    # lateral force of the cable minus friction, positive to its left seen from outside (force)
    pull: float
    allowed: float  # rounding threshold of the pull (force)

    @property
    def excess(self) -> float:
        """Pull beyond the rounding threshold (force); negative below it."""
        return abs(self.pull) - self.allowed


@dataclass(frozen=True)
class VertexRun:
    """Consecutive vertices that a cable is to pass on one side."""

    vertices: tuple[int, ...]  # ids, in path order
    to_left: bool  # whether the vertices are to the left of the cable afterwards, seen from outside
    excess: float  # lateral force on them, beyond the thresholds (force)

    @property
    def key(self) -> tuple[int, ...]:
        """1 if the vertices are left to the cable's left, else -1, and these."""
        return (1 if self.to_left else -1, *self.vertices)

    @classmethod
    def of(cls, part: Sequence[HeldVertex]) -> VertexRun:
        """Run of consecutive vertices."""
        pull = sum(one.pull for one in part)
        excess = abs(pull) - sum(one.allowed for one in part)
        return cls(tuple(one.vertex for one in part), pull > 0.0, excess)


def held_vertices(cable: LaidCable, shape: StripShape) -> list[HeldVertex]:
    """Vertices that a taut cable visits or has reached, in path order; none for a cable in an edge,
    which belongs there. With friction all nodes on edges at a vertex are combined, as only their
    sum is meaningful; some may have lifted off where the cable bends inward against the vertex."""
    near = {} if cable.keeps_line else _near(cable, shape)
    if not near:
        return []
    grip = cable.state.law.lateral
    at = near if grip is None else _at(cable)
    at = {vertex: nodes for vertex, nodes in at.items() if vertex in near}
    nodes = sorted({k for some in at.values() for k in some if not cable.state.lifted[k]})
    # By node of the cable; zero where it has lifted off.
    press, pull, bound = np.zeros((3, len(cable.state.nodes)))
    press[nodes], pull[nodes] = forces_at(cable, nodes, shape)
    if grip is not None:
        from crms_fenicsx.cabling.friction.lateral import friction_forces

        carried = friction_forces(cable, shape)
        for k in nodes:
            row = grip.row_of.get(cable.state.nodes[k].support)
            if row is not None:
                pull[k] -= carried[row]
                bound[k] = grip.bounds[row]
    of = np.repeat(np.arange(len(at)), [len(some) for some in at.values()])
    every = [k for some in at.values() for k in some]
    down, force, most = (np.bincount(of, f[every], len(at)) for f in (press, pull, bound))
    uneven = TOL.uneven * np.abs(down) if grip is None else TOL.sliding * most
    allowed = TOL.contact * cable.tension + uneven
    sums = zip(*(f.tolist() for f in (force, allowed)), strict=True)
    found = [
        HeldVertex(vertex, tuple(some), *own)
        for (vertex, some), own in zip(at.items(), sums, strict=True)
    ]
    return sorted(found, key=lambda held: (held.nodes[0], held.nodes[-1], held.vertex))


def held_runs(cable: LaidCable, shape: StripShape) -> list[VertexRun]:
    """Runs of vertices that hold a cable, in path order, and the sides on which it leaves them.
    Without friction these follow the displacements of a string between the run's ends under the
    pulls: near the ends the cable's turn may pull the other way. With friction each vertex is left
    to the side of its pull. Neighbours left to different sides are in different runs."""
    held = held_vertices(cable, shape)
    if cable.state.law.lateral is not None:  # it sticks to the others
        held = [one for one in held if one.excess > 0.0]
    runs = [VertexRun.of(part) for row in _rows(held, cable) for part in _parts(row, cable)]
    return [run for run in runs if run.excess > 0.0]


def _parts(row: Sequence[HeldVertex], cable: LaidCable) -> list[list[HeldVertex]]:
    """Split a row into parts left to the same side."""
    contacts = cable.contacts()
    arc = arc_lengths(cable.state.positions[contacts])
    at = np.searchsorted(contacts, [one.nodes[0] for one in row])
    ends = max(int(at[0]) - 1, 0), min(int(at[-1]) + 1, len(arc) - 1)
    places = np.concatenate([arc[[ends[0]]], arc[at], arc[[ends[1]]]])
    moved = np.array([one.pull for one in row])
    if cable.state.law.lateral is None:
        moved = string_displacements(places, moved)
        moved[np.abs(moved) < 1e-9 * np.abs(moved).max()] = 0.0  # rounding at the string's ends
    starts = [0, *np.flatnonzero(moved[1:] * moved[:-1] <= 0.0) + 1, len(row)]
    return [list(row[a:b]) for a, b in pairwise(starts)]


def string_displacements(places: Array, forces: Array) -> Array:
    """Displacements (n,) of a string of unit tension, held at its ends, under forces in between.
    Shapes and units: places (n + 2,) (length), forces (n,) (relative to the tension)."""
    shear = np.concatenate([[0.0], -np.cumsum(forces)])
    moved = np.concatenate([[0.0], np.cumsum(shear * np.diff(places))])
    straight = moved[-1] * (places - places[0]) / max(places[-1] - places[0], 1e-300)
    return np.asarray((moved - straight)[1:-1])


def _rows(held: Sequence[HeldVertex], cable: LaidCable) -> list[list[HeldVertex]]:
    """Rows of consecutive vertices."""
    at = {k: i for i, k in enumerate(cable.path_nodes())}
    rows: list[list[HeldVertex]] = []
    for one in held:
        # consecutive, or with one point of the path between them
        if rows and at[one.nodes[0]] - at[rows[-1][-1].nodes[-1]] <= 2:
            rows[-1].append(one)
        else:
            rows.append([one])
    return rows


def _near(cable: LaidCable, shape: StripShape) -> dict[int, list[int]]:
    """Vertices that a cable's nodes are on or close to, except along the membrane's boundary, off
    which it can only slide."""
    near = TOL.pressed if cable.state.law.lateral is None else TOL.gripped
    nodes, lifted, fractions = cable.state.nodes, cable.state.lifted, cable.state.fractions
    boundary = along_boundary(nodes, shape)
    found: dict[int, list[int]] = defaultdict(list)
    # near an edge's end or beyond it, or not on an edge
    beside = np.flatnonzero(~((near <= fractions) & (fractions <= 1 - near)))
    for k in ints(beside[(0 < beside) & (beside < len(nodes) - 1)]):
        if nodes[k].slides:
            found[nodes[k].support[int(fractions[k] > 0.5)]].append(k)
        elif nodes[k].kind == "vertex" and not (lifted[k] or k in boundary):
            found[nodes[k].support[0]].append(k)
    return dict(found)


def _at(cable: LaidCable) -> dict[int, list[int]]:
    """All nodes on edges at each vertex."""
    found: dict[int, list[int]] = defaultdict(list)
    for k, node in enumerate(cable.state.nodes[1:-1], start=1):
        if node.kind == "vertex" or node.slides:
            for vertex in node.support:
                found[vertex].append(k)
    return dict(found)


def along_boundary(nodes: Sequence[CableNode], shape: StripShape) -> set[int]:
    """Nodes on vertices to or from which a cable runs along the boundary."""
    found = set[int]()
    for k, (a, b) in enumerate(pairwise(nodes)):
        if a.kind == b.kind == "vertex" and a.support != b.support:
            if len(shape.strip.solid_rows(edge_of(a.support[0], b.support[0]))) == 1:
                found |= {k, k + 1}
    return found
