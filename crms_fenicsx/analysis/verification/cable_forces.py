"""Force balance of the cables with the membrane, and vertices with loads only."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import (
    contact_forces,
    forces_at,
    held_nodes,
    wrap_angles,
)
from crms_fenicsx.cabling.contact.lift_off import Polylines, is_foot
from crms_fenicsx.cabling.paths.held_vertices import held_runs
from crms_fenicsx.cabling.paths.path_change import leaves_cells
from crms_fenicsx.energy.minimization.outcome import NO_STRAIN
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.surface.points import EdgePoint
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import SAME_PLACE, TOL


def plain_vertices(system: System) -> Integers:
    """This rank's free vertices away from taut cables and bars; overwrites `g`. Collective."""
    scene, unknowns, potential = system.scene, system.unknowns, system.potential
    n = unknowns.n_vertices
    plain: Booleans = np.logical_not(np.any(unknowns.held[:n], axis=1))
    if unknowns.bounds is not None:
        plain &= potential.x[:n, 2] > unknowns.bounds[0][:n, 2]
    if system.cables is not None and system.cables.taut:
        assert system.cables.tables is not None
        near = scene.V.dofmap.list[system.cables.tables.folded.cells].ravel()
        folded = np.zeros((n + unknowns.n_ghost_vertices, 3))
        folded[near] = 1.0
        potential.g[:] = 0.0
        unknowns.add_to_vertices(folded, potential.g)
        unknowns.gather_forces(potential.g_vector, potential.g)
        plain &= potential.g[:n, 0] == 0.0
    for vertex in scene.frame.vertices:
        rank, dof = scene.frame.home(vertex)
        if rank == scene.comm.rank:
            plain[dof] = False
    return np.flatnonzero(plain)


def section_forces(scene: Scene) -> float:
    """Magnitude of the membrane's forces in a section through it (force)."""
    materials = scene.materials.values()
    modulus = max(m.reference_modulus for m in materials)
    prestress = max(float(np.abs(m.prestress_vector).max()) for m in materials)
    stored = abs(scene.energies.get("membrane", 0.0))
    return float(prestress * scene.membrane.size + np.sqrt(2 * modulus * stored))


SMOOTH = 0.3
"""Least coefficient of friction for normalising forces beyond the bounds: unequal cells carry some
0.02 of the contact force sideways, more than slight friction does."""

FLAT = 1e-3
"""Turn (rad) that normalises the forces of a cable without contact force."""

IN_LINE = 3
"""Number of consecutive vertices that make a line of the mesh."""


def is_tense(cable: LaidCable) -> bool:
    """Whether the cable has a tension beyond rounding."""
    return cable.tension > NO_STRAIN * cable.cable.EA


def contacts(
    cable: LaidCable, on_mesh: Booleans, on_edge: Integers, shape: StripShape, pulls: Array
) -> dict[str, float]:
    """Outward pull of the cable on the membrane, given at its nodes, and its depth below it."""
    depth = 0.0
    pull = float(pulls.max(initial=0.0)) if is_tense(cable) else 0.0
    touched = np.array(cable.contacts())
    lifted = [
        k for k in np.flatnonzero(cable.state.lifted) if on_mesh[k] and not is_foot(cable, int(k))
    ]
    for k in lifted:
        point, s = cable.state.nodes[k].point, float(cable.state.fractions[k])
        assert point is not None
        if isinstance(point, EdgePoint) and (on_edge[k] or not TOL.inside < s < 1 - TOL.inside):
            continue
        after = int(np.searchsorted(touched, k))
        span = norm(
            cable.state.positions[touched[after - 1 : after + 1]] - cable.state.positions[k]
        )
        if span.min() <= 1e-9 * cable.length:  # its edge lies beyond an end of the span
            continue
        place = shape.mean(*cable.interpolation(int(k)))
        normal, cell = shape.normals_and_sizes([point.support])
        depth = max(depth, -float((cable.state.positions[k] - place) @ normal[0]) / float(cell[0]))
    return {"pull on the membrane": pull, "depth below the membrane": depth}


def outward_pulls(scene: Scene, lines: Polylines, shape: StripShape) -> Array:
    """Outward pulls of the cables at all nodes, relative to the tension; where cables lie on each
    other at a vertex, of each with those above it. Zero where a cable is not to lift off."""
    nodes, cables = lines.nodes, scene.cables
    found = np.zeros(len(nodes.kind))
    lifts = np.array([cable.taut and cable.lifts_off for cable in cables], dtype=bool)
    may = lifts[nodes.cable] & lines.on_membrane
    rows = np.flatnonzero(may & ~lines.shared)
    found[rows] = lines.pulls(rows, *shape.around(nodes.on(shape.strip.simplices)[rows]))
    if lines.shared.any():
        table, sums = lines.pulls_of_stacks(shape, cables, may)
        found[table[table >= 0]] = sums[table >= 0]
    return found


def below_others(scene: Scene, lines: Polylines, shape: StripShape) -> dict[LaidCable, float]:
    """Depths of cables below those that they lie over, relative to the cells, where they cross at
    a vertex or apart from each other."""
    some = [one for one in scene.net.crossings if one.separated or len(one.support) == 1]
    depths: dict[LaidCable, float] = {}
    if some:
        gaps, sizes = lines.gaps(shape, some, 4)  # farther than their search looks
        for one, depth in zip(some, -gaps / sizes, strict=True):
            upper = scene.cables[one.upper]
            depths[upper] = max(float(depth), depths.get(upper, 0.0))
    return depths


def forces(
    cable: LaidCable, shape: StripShape, free: float, beside: Array | None
) -> dict[str, float]:
    """Force errors of a cable relative to its contact force, with forces of cables `beside` it
    (n, 3)."""
    ways = np.diff(cable.state.positions[cable.contacts()], axis=0)
    (long,) = np.nonzero(norm(ways) > SAME_PLACE * cable.length)  # shorter spans have no direction
    ways = ways[long] * (cable.part_tensions[long] / norm(ways[long]))[:, None]
    turns = norm(np.diff(ways, axis=0))
    least = FLAT * cable.tension if is_tense(cable) else np.inf
    own = max(float(np.linalg.norm(turns)), least)
    values = {"unbalanced forces of cables": free / own}
    press = max(float(turns.sum()), least)
    values |= _held(cable, shape, press)
    if leaves_cells(cable):
        # An edge carries the forces if it is much stiffer than the cable's tension.
        normal, pull = forces_at(cable, _folds(cable), shape)
        beyond = np.maximum(np.abs(pull) - TOL.uneven * np.abs(normal), 0.0)
        values["sideways force without friction"] = float(beyond.sum()) / press
    return values | _friction(cable, shape, least, beside)


def _held(cable: LaidCable, shape: StripShape, press: float) -> dict[str, float]:
    """Lateral forces that vertices exert on a cable, relative to its contact force."""
    # Smoothed lengths keep a cable off the vertices by `smoothing` cells, even where a straight one
    # runs through them: it turns by as much at both ends of a run.
    own = 2 * TOL.smoothing * cable.tension
    runs = held_runs(cable, shape)
    held = [(len(run.vertices), max(run.excess - own, 0.0) / press) for run in runs]
    return {
        "held by a line of the mesh": max((f for n, f in held if n >= IN_LINE), default=0.0),
        "held by vertices": sum(f for _, f in held),
    }


def _folds(cable: LaidCable) -> list[int]:
    """Nodes that slide freely on mesh edges and touch no other cable."""
    blocked = cable.blocked
    return [
        k
        for k in held_nodes(cable)
        if cable.state.nodes[k].kind == "fold" and not cable.state.nodes[k].touches_cable
        if k not in blocked
    ]


def _friction(
    cable: LaidCable, shape: StripShape, least: float, beside: Array | None
) -> dict[str, float]:
    """Friction forces beyond their bounds, relative to the contact force; negative dissipation."""
    values: dict[str, float] = {}
    friction = cable.cable.sideways
    if friction is None and cable.state.law.axial is None:
        return values
    from crms_fenicsx.cabling.friction.axial import gripped_nodes
    from crms_fenicsx.cabling.friction.lateral import energies

    if friction is not None and cable.has_coulomb and cable.state.law.lateral is not None:
        forces = contact_forces(cable, shape, beside)
        bounds = friction.at_rest * forces.bearing
        if friction.cone:
            bounds[held_nodes(cable)] *= _left_sideways(cable, shape)
        # Leave out held edges: there the cable may turn so far that its lateral direction differs
        # from that on the stress-free membrane, on which slip is measured.
        shifting = {*cable.state.law.lateral.shifting}
        rows = [k for k in held_nodes(cable) if cable.state.nodes[k].support in shifting]
        free = _folds(cable) + rows
        beyond = np.maximum(np.abs(forces.lateral[free]) - bounds[free], 0.0).sum()
        most = max(friction.at_rest, SMOOTH) * float(forces.bearing.sum())
        values["friction beyond its bound"] = float(beyond) / max(most, least)
        heat = energies(cable, shape)[1]
        values["negative dissipation"] = -heat / max(cable.tension * cable.length, 1e-300)
    if cable.state.law.axial is not None and len(cable.state.law.axial.spans):
        nodes = [k for k in gripped_nodes(cable) if k not in cable.clamped]
        tensions = cable.part_tensions
        at = np.searchsorted(cable.contacts(), nodes)
        before, after = tensions[at - 1], tensions[at]
        angles = cable.cable.along * wrap_angles(cable, shape)[nodes]
        bounds = 2 * np.sqrt(before * after) * np.sinh(angles / 2)
        beyond = np.maximum(np.abs(after - before) - bounds, 0.0).sum()
        whole = max(float(bounds.sum()), least)
        values["friction along beyond its bound"] = float(beyond) / whole
        heat = -cable.state.law.axial.loss / max(cable.tension * cable.length, 1e-300)
        values["negative dissipation"] = max(values.get("negative dissipation", 0.0), heat)
    return values


def _left_sideways(cable: LaidCable, shape: StripShape) -> Array:
    """Part of the lateral friction bounds left by the axial friction in the cone."""
    nodes = held_nodes(cable)
    left = np.ones(len(nodes))
    if cable.state.law.axial is None or not len(cable.state.law.axial.spans):
        return left
    at = np.searchsorted(cable.contacts(), nodes)
    most = cable.cable.along * wrap_angles(cable, shape)[nodes]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.abs(np.log(cable.part_tensions[at] / cable.part_tensions[at - 1])) / most
    share = np.where(most > 0.0, np.minimum(share, 1.0), 0.0)
    return np.asarray(np.sqrt(1 - share**2))
