"""Cables put on known paths over the membrane: typed nodes, lengths, tension, friction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from types import MappingProxyType
from typing import Literal

import numpy as np

from crms_fenicsx.cabling.cables.clamping import bonded_parts, bonds_of
from crms_fenicsx.cabling.cables.strip import NOBODY, Strip, StripShape
from crms_fenicsx.cabling.contact.lift_off import drape
from crms_fenicsx.cabling.paths.path_change import fractions_of, nodes_of
from crms_fenicsx.foundation.meshes.edge_table import EdgeTable, edge_keys
from crms_fenicsx.foundation.meshes.smooth_surface import SmoothSurface, arc_lengths_on
from crms_fenicsx.foundation.meshes.triangles import mix
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, ints
from crms_fenicsx.foundation.runtime.errors import InputError, PathError
from crms_fenicsx.foundation.surface.corridor import cell_between
from crms_fenicsx.foundation.surface.path import Path
from crms_fenicsx.foundation.surface.points import EdgePoint, SurfacePoint, VertexPoint
from crms_fenicsx.model.cable import HOLDS, Cable
from crms_fenicsx.model.cable_state import CableLaw, CableNode, CableState, End, LaidAs, StepStart
from crms_fenicsx.model.friction import Friction
from crms_fenicsx.model.laid_cable import LaidCable, polyline_length
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE

MeasuredOn = Literal["surface", "facets"]


@dataclass(frozen=True)
class MembraneBelow:
    """What laying cables needs of the membrane below their paths, the same on all ranks."""

    membrane: Membrane
    shape: StripShape
    held: frozenset[int]  # vertices held in all directions, among those at the ends of paths
    in_fold: Mapping[SurfacePoint, Array]  # places (3,) in folds of other cables (length)

    @classmethod
    def of(
        cls,
        membrane: Membrane,
        shape: StripShape,
        ways: Sequence[Path],
        in_fold: Mapping[SurfacePoint, Array] = MappingProxyType({}),
    ) -> MembraneBelow:
        """The membrane below some paths, from the shape of the cells around. Collective."""
        strip = shape.strip
        ends = {v for way in ways for k in (0, -1) for v in way.points[k].support}
        own = strip.owner == membrane.comm.rank
        corners = np.isin(strip.cells[own], np.array(sorted(ends), dtype=np.int64))
        dofs = membrane.V.dofmap.list[strip.local[own]][corners]
        held = strip.cells[own][corners][membrane.held[dofs].all(axis=1)]
        every = membrane.comm.allgather(np.unique(held))
        return cls(membrane, shape, frozenset(ints(np.concatenate(every))), in_fold)

    @cached_property
    def smooth(self) -> SmoothSurface:
        """The smooth surface through the vertices."""
        strip = self.shape.strip
        solid = strip.cells[strip.is_outer & (strip.owner != NOBODY)]
        return SmoothSurface.of(self.shape.current, np.searchsorted(strip.vertices, solid))

    @cached_property
    def free_edges(self) -> Integers:
        """Sorted keys of the edges with one cell that are not held over their whole length."""
        strip = self.shape.strip
        table = EdgeTable.of(strip.cells)
        held = edge_keys(np.array(sorted(strip.held_edges), dtype=np.int64))
        return np.setdiff1d(table.keys[table.counts == 1], held, assume_unique=True)

    def ends(self, way: Path) -> tuple[End, End]:
        """How the first and last end of a cable on a path are held."""

        def end(anchor: object, point: SurfacePoint) -> End:
            if anchor is not None:
                return "off"
            if isinstance(point, VertexPoint):
                return "held" if point.vertex in self.held else "tied"
            on_edge = isinstance(point, EdgePoint) and point.edge in self.shape.strip.held_edges
            return "held" if on_edge else "tied"

        return end(way.start_anchor, way.points[0]), end(way.end_anchor, way.points[-1])


def put(
    below: MembraneBelow,
    name: str,
    cable: Cable,
    way: Path,
    laid_as: LaidAs,
    *,
    L0: float | None,
    tension: float | None,
    measured_on: MeasuredOn,
) -> LaidCable:
    """Type the points of a path and put a cable on it, without adding it to a net. Collective."""
    _refuse_joints_on_the_membrane(name, laid_as.joints, way)
    shape, strip = below.shape, below.shape.strip
    nodes = nodes_of(way.points, strip, below.ends(way))
    positions = _positions(nodes, way, shape)
    folded = _put_in_folds(nodes, positions, below.in_fold, SAME_PLACE * below.membrane.size)
    off = np.array([k.point is not None and strip.over_hole(k.support) for k in nodes], dtype=bool)
    if HOLDS[laid_as.hold].sideways and _follows_free_edge(way, below):
        laid_as = replace(laid_as, hold="pocket")
    hold = laid_as.hold
    state = CableState(
        nodes, positions, fractions_of(nodes), off, np.full_like(positions, np.nan),
        CableLaw(_held_kind(cable, laid_as), L0=1.0, length=0.0, tension=0.0), laid_as,
    )  # fmt: skip
    laid = LaidCable(name, state)
    _refuse_folds(below.membrane, strip, laid)
    if laid.lifts_off:
        drape(laid, shape)
    length = polyline_length(laid.state.positions[laid.contacts()])
    if length == 0.0:
        raise PathError(f"lay_cable: the path of {name!r} has no length.")
    smooth = length
    if L0 is None and measured_on == "surface" and cable.law == "total" and hold != "bonded":
        smooth = _smooth_length(laid, below, folded)
    L0 = smooth / (1 + (tension or 0.0) / cable.EA) if L0 is None else float(L0)
    force = cable.EA / L0 * max(smooth - L0, 0.0)
    laid.update(L0=L0, length=length, tension=force, taut=cable.law == "step" or force > 0)
    if cable.law == "step":
        laid.update(step_start=StepStart(force, length, force * (length - L0) / 2))
    if hold == "bonded":
        laid.update(bonds=bonds_of(laid))
        laid.update(parts=bonded_parts(laid))
    elif cable.along > 0:
        from crms_fenicsx.cabling.friction.axial import initial_state

        laid.update(axial=initial_state(laid, shape))
    if laid.cable.sideways is not None and laid.cable.sideways.law == "step":
        from crms_fenicsx.cabling.friction.lateral import start_elements
        from crms_fenicsx.cabling.friction.slip import material_curve

        start_elements(laid, material_curve(laid, shape), shape)
    return laid


def _held_kind(cable: Cable, laid_as: LaidAs) -> Cable:
    """The cable without friction in directions in which it is fixed."""
    free = HOLDS[laid_as.hold]
    if free.sideways or (cable.sideways is None and free.along):
        return cable
    if not free.along or not cable.along:
        return replace(cable, friction=0.0)
    assert isinstance(cable.friction, Friction)
    along = Friction(0.0, along=cable.along, tolerance=cable.friction.tolerance)
    return replace(cable, friction=along)


def _refuse_joints_on_the_membrane(
    name: str, joints: tuple[str | None, str | None], path: Path
) -> None:
    """Reject a cable that ends at a joint on the membrane."""
    for joint, anchor in zip(joints, (path.start_anchor, path.end_anchor), strict=True):
        if joint is not None and anchor is None:
            raise PathError(
                f"lay_cable: {name!r} ends at the joint {joint!r}, which lies on the membrane; let "
                "the bars end at a vertex there instead, scene.vertex_at(...), and the cable "
                "too."
            )


def _put_in_folds(
    nodes: Sequence[CableNode],
    positions: Array,
    in_fold: Mapping[SurfacePoint, Array],
    reach: float,
) -> set[SurfacePoint]:
    """Move nodes to the folds in `in_fold`, and return the points moved farther than `reach`."""
    moved = set[SurfacePoint]()
    for k, node in enumerate(nodes):
        if node.point is not None and node.point in in_fold:
            fold = in_fold[node.point]
            if np.linalg.norm(fold - positions[k]) > reach:
                moved.add(node.point)
            positions[k] = fold
    return moved


def check_law(
    name: str, cable: Cable, laid_as: LaidAs, L0: float | None, tension: float | None
) -> None:
    """Check the laws and the length of a new cable."""
    hold, line = laid_as.hold, laid_as.line
    if line is not None and HOLDS[hold].sideways and cable.sideways is not None:
        if cable.sideways.law == "step":
            raise InputError(
                f"lay_cable: {name!r} lies along {line!r}, a line of the mesh that slides with it, "
                'but its friction has law="step", that of an edge which a cable crosses; use '
                'law="coulomb", or lay it by its path, without `along`.'
            )
    if line is None and cable.diameter > 0.0:
        raise InputError(
            f"lay_cable: {name!r} has the diameter {cable.diameter:g} but lies across the cells of "
            "the mesh, where cables do not touch side by side; lay it along a line of the mesh, or "
            "leave its diameter out."
        )
    if hold == "bonded" and cable.law == "step":
        raise InputError(
            f'lay_cable: {name!r} is bonded, but its law "step" has one tension for the whole '
            'cable; use law="total".'
        )
    if L0 is not None and tension is not None:
        raise InputError(f"lay_cable: {name!r} got both L0 and tension; pass one of them.")
    for key, value in (("L0", L0), ("tension", tension)):
        if value is not None:
            checks.positive(f"lay_cable: {name!r} with {key}", value)


def check_distance(membrane: Membrane, cables: Sequence[LaidCable], new: int) -> None:
    """Check that the last `new` cables lie as far from others as their diameters need.
    Collective."""
    if any(one.cable.diameter > 0.0 for one in cables[-new:]):
        from crms_fenicsx.cabling.contact.side_by_side import refuse_too_near

        refuse_too_near(membrane, cables, new)


def _follows_free_edge(path: Path, below: MembraneBelow) -> bool:
    """Whether a path runs from vertex to vertex along free boundary edges of the membrane."""
    vertices = [point.support[0] for point in path.points if len(point.support) == 1]
    if len(vertices) < max(len(path.points), 2):
        return False
    keys = edge_keys(np.array([*pairwise(vertices)]))
    return bool(np.isin(keys, below.free_edges).all())


def _smooth_length(cable: LaidCable, below: MembraneBelow, folded: Set[SurfacePoint]) -> float:
    """Length of a cable's path on the smooth surface through the vertices. Facets lie inside it: in
    a stiff membrane they shorten the path by as much as the cable's elastic strain."""
    strip, nodes = below.shape.strip, cable.contacts()
    on = np.array([
        node.point is not None and node.kind != "edge slider" and node.point not in folded
        for node in (cable.state.nodes[k] for k in nodes)
    ])  # fmt: skip
    found = [cable.interpolation(k) for k, is_on in zip(nodes, on, strict=True) if is_on]
    corners = np.array([(*(strip.row_of[v] for v in ids), 0, 0)[:3] for ids, _ in found])
    weights = np.array([(*share, 0.0, 0.0)[:3] for _, share in found])
    points, normals = cable.state.positions[nodes], np.zeros((len(nodes), 3))
    if on.any():
        offsets, normals[on] = below.smooth.raised(corners, weights)
        points[on] += offsets
    ends_on = on | np.array([cable.state.nodes[k].kind == "edge slider" for k in nodes])
    straight = (np.diff(nodes) > 1) | ~ends_on[:-1] | ~ends_on[1:]
    for i in np.flatnonzero(~straight) if len(strip.covers) else ():
        straight[i] = strip.over_hole(
            cell_between(
                cable.state.nodes[nodes[i]].support, cable.state.nodes[nodes[i + 1]].support
            )
        )
    return float(arc_lengths_on(points, normals, straight).sum())


def _refuse_folds(membrane: Membrane, strip: Strip, cable: LaidCable) -> None:
    """Reject a cable that would fold cells whose material has no compiled law. Collective."""
    edges = {node.point.edge for node in cable.state.nodes if isinstance(node.point, EdgePoint)}
    rows = {row for edge in edges - strip.held_edges for row in strip.rows(edge)}
    mine = [row for row in sorted(rows) if strip.owners[row] == membrane.comm.rank]
    membrane.refuse_folds(strip.local[mine].astype(np.int32), f"lay_cable: {cable.name!r}")


def _positions(nodes: Sequence[CableNode], path: Path, shape: StripShape) -> Array:
    """Positions of nodes at laying; an anchor without a place of its own is at the path's end."""
    ends = {
        k: (path.points[k], anchor)
        for k, anchor in ((0, path.start_anchor), (-1, path.end_anchor))
        if nodes[k].kind == "anchor"
    }
    if 0 in ends:
        nodes = [CableNode("tied", ends[0][0]), *nodes[1:]]
    if -1 in ends:
        nodes = [*nodes[:-1], CableNode("tied", ends[-1][0])]
    found = [node.interpolation() for node in nodes]
    rows = np.array([[*(shape.strip.row_of[v] for v in ids), 0, 0][:3] for ids, _ in found])
    weights = np.array([[*share, 0.0, 0.0][:3] for _, share in found])
    positions = mix(weights, shape.current[rows])
    for k, (_, anchor) in ends.items():
        if anchor is not None:
            positions[k] = anchor
    return positions
