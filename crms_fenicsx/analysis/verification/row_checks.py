"""Sideways balance of cables along lines of the mesh that slide, in plain numpy.

Where a cable rests on its row, a shift of the stress-free place X of a vertex across the row does
no work. With the section forces S of the cells around, their energy per area phi, their areas A and
the gradients n of the shape function there, the force on X is Eshelby's (Phil. Trans. R. Soc. A
244, 1951)

    sum A (phi n - F^T P n),    P = F S,

here from the final places; where the membrane is held and its place follows X, the forces on the
place are added, and friction along the cable, pulled back by the mean F. Divided by the cable's
contact forces it is the part of them that is unbalanced.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from mpi4py import MPI

from crms_fenicsx.analysis.equilibrium.shift_contribution import ShiftContribution
from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.verification.cable_forces import FLAT, is_tense
from crms_fenicsx.cabling.cables.numbering import CableNumbering
from crms_fenicsx.cabling.cables.points_on_edges import VERTEX
from crms_fenicsx.cabling.cables.strip import StripShape
from crms_fenicsx.cabling.contact.contact_force import cable_over, contact_forces, forces_at
from crms_fenicsx.cabling.paths.held_vertices import along_boundary
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array, Integers, ints
from crms_fenicsx.model.cable import HOLDS
from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.model.tolerances import TOL


def row_checks(
    system: System, loads: Array, shape: StripShape, beside: Mapping[LaidCable, Array]
) -> dict[LaidCable, dict[str, float]]:
    """Errors of the taut cables that slide sideways along lines: unbalanced sideways forces, and
    those at vertices of their rows that do not shift, relative to their contact forces. Collective.
    Shapes and units: loads (n_local, 3), beside (n, 3) at each cable's nodes (force)."""
    assert system.cables is not None
    numbering = system.cables.numbering
    rows = {
        c: cable for c, cable in enumerate(numbering.cables)
        if system.slide and cable.taut and cable.takes_line
    }  # fmt: skip
    if not rows:
        return {}
    vertices, nodes = numbering.shifts.vertices, numbering.nodes
    pulls = {c: _pulls(cable) for c, cable in rows.items()}
    forces: Array = np.zeros((len(vertices), 3))
    bounds = np.zeros(len(vertices))
    if system.shifts is not None:
        forces = _forces_on_cells(system.shifts, loads, shape)
    at, grip = dict[int, tuple[Integers, Integers]](), dict[int, Array]()
    for c, cable in rows.items():
        own = slice(*nodes.starts[c : c + 2])
        on = np.flatnonzero((nodes.kind[own] == VERTEX) & ~nodes.lifted[own])
        place = np.searchsorted(vertices, nodes.support[own][on, 0])
        shifts = np.append(vertices, -1)[place] == nodes.support[own][on, 0]
        at[c] = on[shifts], place[shifts]
        pull = pulls[c] + beside.get(cable, 0.0)
        np.subtract.at(forces, at[c][1], pull[at[c][0]] * numbering.shifts.held[at[c][1], None])
        grip[c] = _bounds(cable, shape)
        np.add.at(bounds, at[c][1], grip[c][at[c][0]])
        np.add.at(forces, at[c][1], _rubbing(cable, at[c][0], shape))
    beyond = np.einsum("mij,mj->mi", numbering.shifts.projectors, forces)
    size = norm(beyond)
    left = np.maximum(size - bounds, 0.0)
    found = {}
    for c, cable in rows.items():
        least = FLAT * cable.tension if is_tense(cable) else np.inf
        contact = max(float(np.linalg.norm(pulls[c])), least)
        press = max(float(norm(pulls[c]).sum()), least)
        aside = _held_aside(numbering, c, at[c][0], grip[c], shape, beside.get(cable))
        found[cable] = {
            "sideways balance": float(np.linalg.norm(left[at[c][1]])) / contact,
            "held where its line stays": aside / press,
        }
    return found


def _pulls(cable: LaidCable) -> Array:
    """Forces (n, 3) of a cable at its nodes, from its tensions; zero at its ends and off the
    membrane."""
    contacts, pulls = cable.contacts(), np.zeros((len(cable.state.nodes), 3))
    ways = np.diff(cable.state.positions[contacts], axis=0)
    ways *= (cable.part_tensions / np.maximum(norm(ways), 1e-300))[:, None]
    pulls[contacts[1:-1]] = np.diff(ways, axis=0)
    return pulls


def _rubbing(cable: LaidCable, nodes: Integers, shape: StripShape) -> Array:
    """Friction along a cable at nodes (m,) of its row, as forces (m, 3) on the fabric's places."""
    grip = cable.state.law.axial
    if grip is None:
        return np.zeros((len(nodes), 3))
    at = np.searchsorted(cable.contacts(), nodes)
    jumps = np.diff(cable.part_tensions, prepend=0.0, append=0.0)[at]
    rubs = np.array([cable.state.nodes[k].support in grip.supports for k in nodes], dtype=bool)
    return np.where(rubs, jumps, 0.0)[:, None] * cable_over(cable, ints(nodes), shape)


def _bounds(cable: LaidCable, shape: StripShape) -> Array:
    """Friction forces that may act sideways at a cable's nodes, (n,)."""
    if not cable.has_coulomb or cable.cable.sideways is None:
        return np.zeros(len(cable.state.nodes))
    most = 1.1 * cable.cable.sideways.at_rest  # set by the contact forces of the last update
    return np.asarray(most * contact_forces(cable, shape).bearing)


def _held_aside(
    numbering: CableNumbering, c: int, shifting: Integers, grip: Array, shape: StripShape,
    beside: Array | None,
) -> float:  # fmt: skip
    """Sum of a cable's sideways forces, beyond friction, at vertices within its row that do not
    shift: not along the membrane's boundary, at clamps, nor where another cable is sewn on."""
    nodes, cable = numbering.nodes, numbering.cables[c]
    own = slice(*nodes.starts[c : c + 2])
    vertex = nodes.size[own] == 1
    stays = (nodes.kind[own] == VERTEX) & ~nodes.lifted[own]
    stays[1:-1] &= vertex[:-2] & vertex[2:]
    left_out = [0, -1, *cable.clamped, *along_boundary(cable.state.nodes, shape)]
    stays[shifting] = stays[left_out] = False
    sewn = np.array([not HOLDS[other.hold].sideways for other in numbering.cables], dtype=bool)
    others = nodes.support[(nodes.size == 1) & sewn[nodes.cable], 0]
    (k,) = np.nonzero(stays & ~np.isin(nodes.support[own][:, 0], others))
    lateral = np.abs(forces_at(cable, ints(k), shape, beside)[1])
    return float(np.maximum(lateral - grip[k] - TOL.contact * cable.tension, 0.0).sum())


def _forces_on_cells(contribution: ShiftContribution, loads: Array, shape: StripShape) -> Array:
    """Forces (m, 3) of the cells around on the stress-free places that shift, and where these carry
    held vertices the forces of cells and loads on them. Needs the stresses of an evaluated
    potential. Collective."""
    numbering, term = contribution.numbering, contribution.energy
    shifts, strip, simplices = numbering.shifts, numbering.strip, numbering.strip.simplices
    at = np.full(len(simplices.vertices), -1)
    at[np.searchsorted(simplices.vertices, shifts.vertices)] = np.arange(len(shifts.vertices))
    mine = (strip.owner == numbering.rank) & (at[simplices.cells] >= 0).any(axis=1)
    corners = simplices.cells[mine]
    axes, load, law = term.table.axes, term.table.loads, term.table.parameters
    X, x = shape.stress_free[corners], shape.current[corners]
    sides = np.einsum("nki,nai->nka", X[:, 1:] - X[:, :1], axes)
    inner = np.linalg.inv(sides).transpose(0, 2, 1)
    n = np.concatenate([-inner.sum(axis=1, keepdims=True), inner], axis=1)
    areas = np.abs(np.linalg.det(sides)) / 2
    F = np.einsum("nki,nka->nia", x, n)
    E = (np.einsum("nia,nib->nab", F, F) - np.eye(2)) / 2
    strain = np.stack([E[:, 0, 0], E[:, 1, 1], 2 * E[:, 0, 1]], axis=1)
    s, taut = term.results[:, 3:6], term.results[:, 6] == 2.0
    rest, prestress = law[:, 9:12], law[:, 12:15]  # energies count from the stress-free shape
    phi = np.where(
        taut, np.sum(strain * (prestress + s), axis=1),
        np.sum((strain + rest) * s - rest * prestress, axis=1),
    ) / 2  # fmt: skip
    phi += np.sum(strain * term.table.residual, axis=1)
    s = s + term.table.residual
    S = s[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    on_places = np.einsum("n,nia,nab,nkb->nki", areas, F, S, n)
    inplane = (areas * phi)[:, None, None] * n - np.einsum("nia,nki->nka", F, on_places)
    inplane += np.einsum("nia,ni->na", F, load)[:, None]
    parts = np.einsum("nka,nai->nki", inplane, axes)
    rows, found = at[corners], np.zeros((len(shifts.vertices), 3))
    parts += np.where((rows >= 0) & shifts.held[rows], 1.0, 0.0)[:, :, None] * on_places
    np.add.at(found, rows[rows >= 0], parts[rows >= 0])
    here = np.flatnonzero((numbering.shift_blocks >= 0) & shifts.held)
    found[here] -= loads[numbering.shifted_blocks[here]]
    numbering.u.function_space.mesh.comm.Allreduce(MPI.IN_PLACE, found, op=MPI.SUM)
    return found
