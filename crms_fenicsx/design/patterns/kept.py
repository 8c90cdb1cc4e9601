"""What a roof sewn of pieces keeps of the scene of its form: supports, bars, cables, loads."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.analysis.scene.frame import FrameState
from crms_fenicsx.design.patterns.pieces import Pieces
from crms_fenicsx.energy.terms.residual_stress import ResidualStress
from crms_fenicsx.foundation.meshes.edge_table import edge_keys, edges_of
from crms_fenicsx.foundation.meshes.membrane_mesh import vertex_ids
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, floats, ints
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.model.bar import BarEnd, BarState, Joint, JointState, MeshVertex, PlacedBar
from crms_fenicsx.model.cable import HOLDS
from crms_fenicsx.model.laid_cable import LaidCable, polyline_length
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.membrane_load import Area, MembraneLoad, fixed_direction_load, wind_load
from crms_fenicsx.model.tolerances import SAME_PLACE

Scalar = TypeVar("Scalar", bound=np.generic)


def kept_options(scene: Scene, pieces: Pieces) -> dict[str, Any]:
    """Refuse by name what the scene sewn from the pieces of a scene's mesh cannot keep, and return
    the options of `Scene` that it keeps. Collective."""
    membrane = scene.membrane
    if scene.mesh.edges is not pieces.origin.mesh.edges:  # which all its scenes share
        raise InputError(
            "sew: the pieces were not cut from the mesh of this scene; cut scene.mesh, or make the "
            "scene on the mesh that was cut, as found.scene(...) does for found.mesh."
        )
    if membrane.moved is not None:
        raise InputError(
            "sew: lines of the mesh have slid with the scene's cables, so that it is no longer the "
            "mesh that was cut; pass a scene without load steps, with these cables in pockets."
        )
    own = [term.name for term in scene.terms if not isinstance(term, ResidualStress)]
    if own:
        raise InputError(
            f"sew: {own[0]!r} is a term of your own, for the mesh that was cut; pass a scene "
            "without it, and add one to the sewn scene."
        )
    edges = pieces.origin.surface.table.keys
    for cable in scene.cables:
        _check_cable(cable, edges)
    _check_supports(scene, pieces)
    return {
        "strain": scene.strain_law, "pressure": scene.pressure_law, "penalty": scene.penalty,
        "literal_penalty": scene.literal_penalty, "pressure_on": membrane.pressure_on,
    }  # fmt: skip


def _check_cable(cable: LaidCable, edges: Integers) -> None:
    """Refuse a cable that does not lie on edges of the mesh that was cut, given by their sorted
    keys, or slides with them."""
    row = _row(cable)
    steps = edge_keys(np.array([*pairwise(row)], dtype=np.int64).reshape(-1, 2))
    points = sum(node.kind != "anchor" for node in cable.state.nodes)
    if len(row) < max(points, 2) or not np.isin(steps, edges).all():
        raise InputError(
            f"sew: the cable {cable.name!r} lies across cells of the mesh, which are cut; cut a "
            "mesh that has its line, found.along(...) or meshes.along(...), with the cable on it "
            "in a pocket, or remove it, and lay it on the sewn scene."
        )
    if cable.state.laid.line is not None and HOLDS[cable.hold].sideways:
        raise InputError(
            f"sew: the cable {cable.name!r} slides sideways with a line of the mesh, which cells "
            'sewn from flat pieces cannot follow; lay it with hold="pocket", or remove it, and lay '
            "it on the sewn scene by its path, without along=."
        )


def _check_supports(scene: Scene, pieces: Pieces) -> None:
    """Refuse supports that have moved, and ends of bars and single supports that were moved along
    an edge onto a seam. Collective."""
    membrane, surface = scene.membrane, pieces.origin.surface
    held = _by_vertex(membrane, membrane.held)
    u = _by_vertex(membrane, membrane.u.x.array.reshape(-1, 3))
    least = SAME_PLACE * membrane.size
    for v in ints(np.flatnonzero(norm(np.where(held, u, 0.0)) > least)):
        raise InputError(
            f"sew: the support at {as_text(surface.points[v])} has been moved; pass a scene with "
            "it at its place in the form, and move it in the sewn one."
        )
    moved = norm(pieces.surface.points[: len(held)] - surface.points) > least
    pairs = surface.table.vertices
    both = (held[pairs[:, 0]] & held[pairs[:, 1]]).astype(int)
    beside = np.zeros(held.shape, dtype=int)
    np.add.at(beside, pairs, both[:, None])
    single = np.logical_and(held, beside < 2).any(axis=1)
    ends = {
        vertex.number: next(f"the end of {bar.name!r}" for bar in scene.bars
                            if vertex in (bar.start, bar.end))
        for vertex in scene.frame.vertices
    }  # fmt: skip
    for v in ints(np.flatnonzero(moved)):
        if single[v] or v in ends:
            raise InputError(
                f"sew: {ends.get(v, 'the support')} at {as_text(surface.points[v])} is a vertex "
                "that the cut moved onto a seam nearby; make it a point group of the mesh, which "
                "stays in its place, or lead the seam elsewhere."
            )


def _by_vertex(membrane: Membrane, values: NDArray[Scalar]) -> NDArray[Scalar]:
    """Values (n, ...) of all vertices by their numbers in the mesh as given, from those of this
    rank's degrees of freedom. Collective."""
    index = membrane.V.dofmap.index_map
    n = index.size_local
    whole = np.zeros((index.size_global, *values.shape[1:]), dtype=values.dtype)
    for ids, part in membrane.comm.allgather((membrane.vertex_ids[:n], values[:n])):
        whole[ids] = part
    return whole


def _by_cell(membrane: Membrane, values: Array) -> Array:
    """Values (m, ...) of all cells by their numbers in the mesh as given, from this rank's.
    Collective."""
    topology = membrane.mesh.mesh.topology
    numbers = np.asarray(topology.original_cell_index, dtype=np.int64)[: len(values)]
    whole = np.zeros((topology.index_map(2).size_global, *values.shape[1:]))
    for own, part in membrane.comm.allgather((numbers, values)):
        whole[own] = part
    return whole


def _row(cable: LaidCable) -> list[int]:
    """Numbers of the vertices of the mesh through which a cable leads."""
    points = (node.point for node in cable.state.nodes if node.kind != "anchor")
    return [point.support[0] for point in points if point is not None and len(point.support) == 1]


def keep(scene: Scene, sewn: Scene, pieces: Pieces) -> None:
    """Give the sewn scene what a checked scene of the same form has beside its membrane.
    Collective."""
    _keep_supports(scene.membrane, sewn.membrane, pieces)
    _keep_frame(scene, sewn, pieces)
    _keep_cables(scene, sewn, pieces)
    for load in scene.loads:
        sewn.loads.add(_load(load, scene.membrane, sewn.membrane, pieces))
    sewn.loads.update(ponds=scene.ponds)
    sewn.air.state = scene.air.state
    if scene.floor_level is not None:
        sewn.floor(scene.floor_level)
    sewn.membrane.strengths = scene.membrane.strengths
    sewn.membrane.patches = scene.membrane.patches
    sewn.design.cables, sewn.design.limits = scene.design.cables, scene.design.limits
    sewn.versions.change_model()


def _keep_supports(old: Membrane, new: Membrane, pieces: Pieces) -> None:
    """Hold the same vertices and edges, and new vertices on edges with both ends held.
    Collective."""
    held = np.zeros((len(pieces.surface.points), 3), dtype=bool)
    given = _by_vertex(old, old.held)
    held[: len(given)] = given
    for (a, b), inner in pieces.origin.cuts.items():
        held[list(inner)] = given[a] & given[b]
    new.held[:] = held[new.vertex_ids]
    found = old.comm.allgather(_edge_keys(old)[old.held_edges])
    edges = edges_of(np.unique(np.concatenate(found)))
    parts = [pair for edge in edges for pair in pairwise(pieces.origin.chain(*edge))]
    keys = edge_keys(np.array(parts, dtype=np.int64).reshape(-1, 2))
    new.held_edges[:] = np.isin(_edge_keys(new), keys)


def _edge_keys(membrane: Membrane) -> Integers:
    """Keys of this rank's edges by their vertices' numbers in the mesh as given."""
    mesh = membrane.mesh.mesh
    return edge_keys(vertex_ids(mesh)[mesh.topology.connectivity(1, 0).array.reshape(-1, 2)])


def _keep_frame(scene: Scene, sewn: Scene, pieces: Pieces) -> None:
    """Joints and bars, free joints at their first places."""
    joints: dict[BarEnd, Joint] = {}
    for one in scene.joints:
        place = np.where(one.held, one.position, one.first)
        joints[one] = Joint(one.name, JointState(one.first, one.held, place, np.zeros(3)))
    bars: dict[PlacedBar, BarState] = {}
    for bar in scene.bars:
        ends, places = list[BarEnd](), list[Array]()
        for end in (bar.start, bar.end):
            if isinstance(end, MeshVertex):
                places.append(pieces.surface.points[end.number])
                x, y, z = floats(places[-1])
                ends.append(MeshVertex(end.number, (x, y, z)))
            else:
                ends.append(joints[end])
                places.append(joints[end].position)
        state = BarState(bar.bar, ends[0], ends[1], bar.L0, np.array(places))
        bars[PlacedBar(bar.name, state)] = state
    sewn.frame.state = FrameState({one: one.state for one in joints.values()}, bars)


def _keep_cables(scene: Scene, sewn: Scene, pieces: Pieces) -> None:
    """Cables and their clamps, along the same edges. Vertices that the cut moved along these
    change their polygons, and unstressed lengths with them, so that tensions stay. Collective."""
    least, origin, points = SAME_PLACE * scene.membrane.size, pieces.origin, pieces.surface.points
    for cable in scene.cables:
        laid, nodes, at = cable.state.laid, cable.state.nodes, cable.state.positions
        row = _row(cable)
        legs = [origin.chain(a, b)[1:] for a, b in pairwise(row)]
        line = points[[row[0], *(v for leg in legs for v in leg)]]
        path: list[Any] = [*line] if laid.line is None else [*line[[0, -1]]]
        before, now = polyline_length(origin.surface.points[row]), polyline_length(line)
        anchors, whole = list[Any](), before
        for k, beside in ((0, 1), (-1, -2)):
            joint, span = laid.joints[k], float(np.linalg.norm(at[k] - at[beside]))
            off = nodes[k].kind == "anchor" and span > least
            anchors.append([at[k] if joint is None else sewn.joint(joint)] if off else [])
            whole += off * span
        path = [*anchors[0], *path, *anchors[1]]
        sewn.lay_cable(
            cable.cable, path, along=laid.line, L0=cable.L0 * (1.0 + (now - before) / whole),
            hold=cable.hold, layer=cable.layer, name=cable.name,
        )  # fmt: skip
    for clamp in scene.clamps:
        sewn.clamp(*clamp.cables, near=[points[clamp.vertex]], slip=clamp.slip)


def _load(load: MembraneLoad, old: Membrane, new: Membrane, pieces: Pieces) -> MembraneLoad:
    """A load on the sewn membrane, on its cells as on those they were cut from. Collective."""
    of_cells = load.material if load.suction is None else load.suction
    if of_cells is None:
        forces = np.zeros((len(pieces.surface.points), 3))
        np.add.at(forces, old.vertex_ids, load.forces)
        total = old.comm.allreduce(forces)
        n = new.V.dofmap.index_map.size_local
        nodal = np.zeros(new.held.shape)
        nodal[:n] = total[new.vertex_ids[:n]]
        return replace(load, forces=nodal)
    parent = pieces.origin.parents[np.asarray(new.mesh.mesh.topology.original_cell_index)]
    own = _by_cell(old, of_cells)
    if load.suction is not None:
        coefficients: Array = np.asarray(-own[parent] / load.peak)
        found = wind_load(new, load.peak, lambda x, n: coefficients, load.name)
    else:
        if not load.weighs:  # the same forces on the form
            x = pieces.origin.surface.points[pieces.origin.surface.cells]
            areas = norm(double_areas(x)) / 2
            own = own * (_by_cell(old, old.cell_areas) / areas)[:, None]
        per: Area = "material" if load.weighs else "surface"
        found = fixed_direction_load(new, lambda x, n: own[parent].T, load.name, per)
    return replace(found, factor=load.factor, basis=load.basis, joints=load.joints)
