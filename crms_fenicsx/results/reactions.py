"""Reactions of supports, anchors and held joints; residual and tangent for coupled solvers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from crms_fenicsx.analysis.equilibrium.system import System
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.energy.minimization.initial_hessian import stiffen_across_sliders
from crms_fenicsx.energy.minimization.potential import Potential
from crms_fenicsx.foundation.dofs.block_patterns import StiffnessMatrix
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.meshes.triangles import closest_on_segments
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.foundation.runtime.checks import as_counted
from crms_fenicsx.foundation.runtime.errors import InputError, as_text
from crms_fenicsx.model.bar import Joint
from crms_fenicsx.model.membrane import COMPONENTS, Marker, Membrane
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.model.versions import UNBALANCED
from crms_fenicsx.results.quantities import summed

AT = 1e3 * SAME_PLACE
"""Distance, relative to the membrane's size, up to which an end coincides with the membrane."""


@dataclass(frozen=True)
class HeldEnd:
    """An end held by an anchor or joint, its place, and the reaction on it, (3,)."""

    name: str
    place: Array
    force: Array
    joint: str = ""  # name of the joint


def held_ends(scene: Scene) -> list[HeldEnd]:
    """Ends of cables and bars held by anchors or joints, and loads on held joints."""
    found = []
    for cable in scene.cables:
        for k, end in enumerate((cable.start, cable.end)):
            if cable.state.nodes[-k].kind == "anchor" and cable.state.laid.joints[k] is None:
                beside = -2 if k else 1
                place = cable.state.positions[beside if cable.ends[k] == "held" else -k]
                found.append(HeldEnd(f"{cable.name} {end.which}", place, end.reaction))
    for joint in scene.joints:
        if joint.held.any():
            found += _at_joint(scene, joint)
    return found


def _at_joint(scene: Scene, joint: Joint) -> list[HeldEnd]:
    """Ends and loads at a held joint; their sum is its reaction."""
    forces = {bar.name: -bar.pull(joint) for bar in scene.bars if joint in (bar.start, bar.end)}
    for cable in scene.cables:
        for end, name in zip((cable.start, cable.end), cable.state.laid.joints, strict=True):
            if name == joint.name and cable.taut:
                forces[f"{cable.name} {end.which}"] = end.reaction
    for load in scene.loads:
        if joint.name in load.joints:
            forces[load.name] = -load.factor * np.array(load.joints[joint.name])
    place = joint.position
    return [
        HeldEnd(name, place, np.where(joint.held, x, 0.0), joint.name) for name, x in forces.items()
    ]


def hung_bars(scene: Scene) -> list[tuple[int, HeldEnd]]:
    """Bar ends at this rank's owned vertices, with their dofs and the reactions on them."""
    found = []
    for vertex in scene.frame.vertices:
        rank, dof = scene.frame.home(vertex)
        if rank == scene.comm.rank and scene.held[dof].any():
            held, place = scene.held[dof], scene.positions()[dof]
            found += [
                (dof, HeldEnd(bar.name, place, np.where(held, -bar.pull(vertex), 0.0)))
                for bar in scene.bars if vertex in (bar.start, bar.end)
            ]  # fmt: skip
    return found


def _are_at(membrane: Membrane, dofs: Indices | Integers, places: Sequence[Array]) -> Booleans:
    """Which places lie at vertices `dofs` (ghosts included) or on an edge of two. Collective."""
    if not places:
        return np.zeros(0, dtype=bool)
    marked, ends = np.zeros(len(membrane.held), dtype=bool), edge_ends(membrane.V)
    marked[dofs] = True
    points = membrane.positions()
    edges = np.concatenate([points[ends[marked[ends].all(axis=1)]], points[dofs, None][:, [0, 0]]])
    near = np.array([gap(place, edges) <= AT * membrane.size for place in places])
    return np.asarray(membrane.comm.allreduce(near.astype(np.int64))) > 0


def gap(place: Array, edges: Array) -> float:
    """Distance of a place, (3,), from the nearest of edges (k, 2, 3); infinite without any."""
    gaps = closest_on_segments(edges[:, 0], edges[:, 1] - edges[:, 0], place)[2]
    return float(gaps.min(initial=np.inf))


def ends_at(
    scene: Scene, dofs: Indices | Integers, ends: Sequence[HeldEnd], others: Sequence[Array] = ()
) -> list[HeldEnd]:
    """Ends that lie at vertices `dofs` or at other given places. Collective."""
    near = _are_at(scene.membrane, dofs, [end.place for end in ends])
    for place in others:
        away = [np.linalg.norm(end.place - place) for end in ends]
        near |= np.array(away) <= AT * scene.membrane.size
    return [end for end, there in zip(ends, near, strict=True) if there]


def held_there(
    scene: Scene, forces: Array, dofs: Indices | Integers, ends: Sequence[HeldEnd]
) -> tuple[Array, dict[str, Array]]:
    """Reactions on the membrane, (3,), and on ends and bars by name. Collective."""
    own = [end for dof, end in hung_bars(scene) if dof in dofs]
    hung = [*chain.from_iterable(scene.comm.allgather(own))]
    membrane = scene.comm.allreduce(forces.sum(axis=0))
    membrane -= sum((end.force for end in hung), np.zeros(3))
    parts = dict[str, Array]()
    for end in (*ends, *hung):
        parts[end.name] = parts.get(end.name, np.zeros(3)) + end.force
    return membrane, parts


@dataclass(frozen=True, repr=False)
class Reactions:
    """Reactions of the supports, anchors and held joints at a place.

    Attributes
    ----------
    total : (3,)
        Sum of the reactions (force), on all ranks.
    membrane : (3,)
        Reaction on the membrane, its loads and cables that pass over held edges.
    parts
        Reactions on ends of cables and bars, and on loads at joints, (3,) each, by name: "ridge
        start", "guy 1".
    positions, forces : (n, 3)
        This rank's owned vertices in their current positions, and the reaction at each, on the
        membrane and on bars that end there; zero in free directions.
    per_length : (n, 3)
        Reactions per length of held edges (force per length): each vertex's reaction over half the
        current length of the adjacent named edges held in that direction, at a corner of several
        groups all of them; NaN without such edges.
    in_equilibrium
        Whether the scene was unchanged since its last load step.
    """

    total: Array
    membrane: Array
    parts: Mapping[str, Array]
    positions: Array
    forces: Array
    per_length: Array
    in_equilibrium: bool

    def __repr__(self) -> str:
        """One line."""
        words = [f"total {as_text(self.total)}"]
        words += [f"{name} {as_text(force)}" for name, force in list(self.parts.items())[:4]]
        words += ["..."] if len(self.parts) > 4 else []
        words += [f"vertices of this rank: {len(self.forces)}"]
        return f"Reactions({', '.join(words + ([] if self.in_equilibrium else [UNBALANCED]))})"


def reactions(system: System, where: str | Marker) -> Reactions:
    """Reactions of held vertices, anchors and held joints at a place. Collective."""
    scene = system.scene
    dofs, joints = _place(scene, where)
    every = support_forces(system)
    owned = dofs[dofs < len(every)]
    forces = every[owned]
    ends = ends_at(scene, dofs, held_ends(scene), joints)
    membrane, parts = held_there(scene, forces, owned, ends)
    lengths = held_lengths(scene.membrane)[owned]
    per_length = np.where(lengths > 0.0, forces / np.where(lengths > 0.0, lengths, 1.0), np.nan)
    total = membrane + sum(parts.values(), np.zeros(3))
    places, settled = scene.positions()[owned], scene.in_equilibrium()
    return Reactions(total, membrane, parts, places, forces, per_length, settled)


def _place(scene: Scene, where: str | Marker) -> tuple[Indices, list[Array]]:
    """Vertices selected by `where`, with ghosts, and the place of a named joint. Collective."""
    joints = {joint.name: joint.position for joint in scene.joints if joint.held.any()}
    mesh = scene.mesh
    if not isinstance(where, str) or where in mesh.edges or where in mesh.points:
        return scene.vertices(where), []
    if where not in joints:
        known = ", ".join(sorted({*mesh.edges, *mesh.points, *joints}, key=as_counted))
        raise InputError(
            f"reactions: there is no group of vertices or held joint {where!r}; there are {known}."
        )
    away = np.linalg.norm(scene.positions() - joints[where], axis=1)
    dofs: Indices = np.flatnonzero(away <= AT * scene.membrane.size).astype(np.int32)
    return dofs, [joints[where]]


def support_forces(system: System) -> Array:
    """Reactions at this rank's owned vertices, 0 where free, (n, 3). Collective."""
    g = nodal_forces(system)
    n = system.unknowns.n_vertices
    forces: Array = np.where(system.scene.held[:n], g[:n], 0.0)
    return forces


def nodal_forces(system: System) -> Array:
    """Unbalanced forces at this rank's blocks (force), including the reactions. Collective."""
    system.update()
    potential, unknowns = system.potential, system.unknowns
    potential.sum_up()
    vector, g = unknowns.vector()
    # The gradient of the potential -p (V - V0) is the pressure force only inside the boundary.
    potential_only = system.scene.pressure_law == "total"
    for term in potential.terms:
        if not (potential_only and term.name == "pressure") and term.name != "pond":
            term.add_gradient(potential.x, potential.sums_of(term), g)
    if potential_only and system.scene.pressure != 0.0:
        corners, vectors = system.pressed_facets()
        np.subtract.at(g, corners, system.scene.pressure / 3 * vectors[:, None, :])
    if system.ponds is not None:
        system.ponds.add_pressure(potential, g, -1.0)
    _leave_ends_to_anchors(system, g)
    _hand_on_edge_sliders(system, g)
    g[unknowns.shifts] = 0.0  # forces on stress-free places are no forces in space
    following = _held_on_rows(system)  # these would pass their forces on to their places
    at_supports = g[following]
    g[following] = 0.0
    unknowns.gather_forces(vector, g)
    forces = g[: unknowns.n_owned].copy()
    if unknowns.n_shifts:
        g[:] = 0.0
        g[following] = at_supports
        unknowns.add_ghosts(vector)
        forces += g[: unknowns.n_owned]
    vector.destroy()
    return forces


def held_groups(membrane: Membrane) -> dict[str, tuple[str, Indices]]:
    """Directions and local vertices, with ghosts, of groups held as a whole. Collective."""
    mesh, found = membrane.mesh, {}
    groups = [(name, 1, mesh.edges[name]) for name in sorted(mesh.edges, key=as_counted)]
    groups += [(name, 0, mesh.points[name]) for name in sorted(mesh.points, key=as_counted)]
    for name, dimension, members in groups:
        dofs = fem.locate_dofs_topological(membrane.V, dimension, members)
        free = membrane.comm.allreduce(np.count_nonzero(~membrane.held[dofs], axis=0))
        directions = "".join(letter for letter, k in COMPONENTS.items() if not free[k])
        if directions:
            found[name] = directions, dofs
    return found


def held_lengths(membrane: Membrane, group: str | None = None) -> Array:
    """Half the length of held edges around each vertex, by direction, (n, 3). Collective."""
    own = membrane.mesh.mesh.topology.index_map(1).size_local
    groups = [edges for name, edges in membrane.mesh.edges.items() if group in (None, name)]
    edges = np.unique(np.concatenate(groups))
    edges = edges[edges < own]
    ends = edge_ends(membrane.V)[edges]
    places = membrane.positions()
    half = np.linalg.norm(places[ends[:, 1]] - places[ends[:, 0]], axis=1) / 2
    both = membrane.held[ends].all(axis=1)
    return summed(membrane.V, ends.T, half[:, None] * both)


def _leave_ends_to_anchors(system: System, g: Array) -> None:
    """Move the pull of cable ends at held places of the membrane to their anchors."""
    # There the cable has no length, and the gradient splits the end's pull arbitrarily.
    if system.cables is None:
        return
    numbering = system.cables.numbering
    for c, cable in enumerate(numbering.cables):
        for end in (cable.start, cable.end):
            k = cable.node_of(end.which)
            if cable.state.nodes[k].kind != "anchor" or not cable.taut:
                continue
            anchor = numbering.numbers[c, k]
            near = 1 if k == 0 else k - 1  # a lifted end's span has a direction
            if numbering.owners[anchor] == numbering.rank and not cable.state.lifted[near]:
                block, beside = numbering.block(c, k), numbering.block(c, near)
                g[beside] += g[block] - end.reaction
                g[block] = end.reaction


def _hand_on_edge_sliders(system: System, g: Array) -> None:
    """Distribute cable forces on held edges, along which they slide, to the edges' ends."""
    if system.cables is not None:
        edge_sliders = system.cables.numbering.edge_sliders
        blocks, ends, s = edge_sliders.blocks, edge_sliders.ends, edge_sliders.known_fractions()
        share = np.stack([1 - s, s], axis=1)
        np.add.at(g, ends, share[:, :, None] * g[blocks][:, None, :])
        g[blocks] = 0.0


def _held_on_rows(system: System) -> Indices:
    """Local blocks of the held vertices that follow their stress-free places."""
    if system.cables is None:
        return np.zeros(0, dtype=np.int32)
    numbering = system.cables.numbering
    here = (numbering.shift_blocks >= 0) & numbering.shifts.held
    return np.asarray(numbering.shifted_blocks[here])


@dataclass(frozen=True)
class Residual:
    """Unbalanced forces, the gradient of the potential energy.

    Attributes
    ----------
    membrane
        On the membrane's vertices (force), a function on `Scene.V`, ghosts included. At supports:
        the support forces.
    joints
        On the joints (force), (3,), by name, on all ranks.
    vector
        On all unknowns (force), zero for held ones. Each rank stores the membrane's vertices first,
        in the order of the owned degrees of freedom of `Scene.V`, then cable points and shifts of
        the stress-free places of vertices of lines that slide (where a held vertex follows its
        place, with the forces on it); the first rank stores joints last. Without cables and joints
        it is a vector of `Scene.V`.
    """

    membrane: fem.Function
    joints: dict[str, Array]
    vector: PETSc.Vec

    def destroy(self) -> None:
        """Free the vector. Collective."""
        self.vector.destroy()


@dataclass(frozen=True)
class Tangent:
    """Tangent stiffness, for the unknowns of `Residual.vector`.

    Rows and columns of held unknowns are those of the identity.

    Attributes
    ----------
    matrix
        Second derivatives of the potential energy (force per length): of type "aij"; or, where one
        quantity such as a cable length or a sealed volume couples very many unknowns, of type
        "lrc", the sum of `sparse` and a few dyads.
    sparse
        The tangent without these dyads, of type "aij", for preconditioners; identical to `matrix`
        if there are none.
    inexact
        Names of terms with an inexact tangent: friction (a law of forces), the paper's step-wise
        laws, wind (its turning is missing), pressure on a sliding rim, and your own terms
        without ``exact_hessian = True``. None if all is exact.
    """

    matrix: PETSc.Mat
    sparse: PETSc.Mat
    inexact: tuple[str, ...]

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        self.matrix.destroy()
        self.sparse.destroy()


def residual(system: System) -> Residual:
    """Unbalanced forces in a scene's present state; see `Residual`. Collective."""
    forces = nodal_forces(system)
    scene, unknowns = system.scene, system.unknowns
    membrane = fem.Function(scene.V, name="residual")
    owned = unknowns.n_vertices
    membrane.x.array[: 3 * owned] = forces[:owned].ravel()
    membrane.x.scatter_forward()
    joints: dict[str, Array] = {}
    if system.bars is not None:
        own = forces[system.bars.blocks.joint_blocks] if scene.comm.rank == 0 else None
        joints = dict(zip((j.name for j in scene.joints), scene.comm.bcast(own), strict=True))
    system.potential.evaluate()
    vector = PETSc.Vec().createMPI(
        (3 * unknowns.n_owned, 3 * unknowns.n_global), bsize=3, comm=scene.comm
    )
    system.potential.free_gradient(vector)
    return Residual(membrane, joints, vector)


def tangent(system: System) -> Tangent:
    """Tangent stiffness in a scene's present state; see `Tangent`. Collective."""
    system.update()
    potential = system.potential
    potential.evaluate()
    whole, sparse = _exact_matrix(potential)
    inexact = {term.name: None for term in potential.terms if not term.exact_hessian}
    inexact |= {load.name: None for load in system.scene.loads if load.is_active_wind}
    return Tangent(whole, sparse, tuple(inexact))


def _exact_matrix(potential: Potential) -> tuple[PETSc.Mat, PETSc.Mat]:
    """Second derivatives at the potential's current state, which must be evaluated, as
    `Tangent.matrix` and `Tangent.sparse`. Rows and columns of held components, of those
    across sliders and of points that no term touches are the identity's."""
    unknowns = potential.unknowns
    n, held = unknowns.n_owned, unknowns.held[: unknowns.n_owned]
    stiffness = StiffnessMatrix(unknowns, potential.patterns())
    potential.add_stiffness(stiffness, exact=True)
    stiffness.assemble()
    A = stiffness.petsc
    if unknowns.comm.allreduce(unknowns.n_sliders):
        stiffen_across_sliders(A, unknowns, 1.0)
    diagonal = A.getDiagonal()
    idle = ~diagonal.array.reshape(-1, 3).any(axis=1)
    idle[: unknowns.n_vertices] = False
    diagonal.destroy()
    rows = np.flatnonzero(held | idle[:, None]) + 3 * unknowns.start
    A.zeroRowsColumns(rows.astype(PETSc.IntType), diag=1.0)
    stiffnesses, columns = potential.dyad_columns(held, exact=True)
    if not len(stiffnesses):
        return A, A
    size = ((3 * n, 3 * unknowns.n_global), (None, len(stiffnesses)))
    U = PETSc.Mat().createDense(size, array=columns, comm=unknowns.comm)
    values = PETSc.Vec().createWithArray(stiffnesses, comm=PETSc.COMM_SELF)
    whole = PETSc.Mat().createLRC(A, U, values, U)
    U.destroy()
    values.destroy()
    return whole, A
