"""What a state says: stresses and strains of the membrane, reactions, the volume gained."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.deformed_surface import folded_shape
from crms_fenicsx.runtime.arrays import Array, Integers
from crms_fenicsx.runtime.compat import geometry_dofmap

if TYPE_CHECKING:
    from crms_fenicsx.equilibrium.system import System
    from crms_fenicsx.scene import Marker, Scene


FLAT = 1e-12
"""Smallest squared stretch that a cell is taken to have, so that a collapsed one has directions."""


@dataclass(frozen=True)
class MembraneResults:
    """Values in this rank's owned cells, by local cell number.

    Principal values are (n, 2), the larger first, and their directions unit vectors in space,
    (n, 2, 3). Where both values are equal, as in a slack cell, the directions are any. A folded
    cell has the values of the triangle that it unfolds to; its directions and its normal are those
    of the triangle of its three corners.

    Attributes
    ----------
    strains
        Principal Green-Lagrange strains.
    second_piola, second_piola_directions
        Second Piola-Kirchhoff section forces (force per length); directions in the stress-free
        surface.
    true_forces, true_directions
        True (Cauchy) section forces, per current length, ``F S F^T / J`` with J the ratio of the
        areas (force per length); directions in the current surface.
    state : (n,) int
        2 taut, 1 wrinkled, 0 slack.
    normals : (n, 3)
        Current unit normals.
    areas : (n,)
        Current areas (length squared).
    folded : (n,) bool
        Whether a cable in tension folds the cell.
    """

    strains: Array
    second_piola: Array
    second_piola_directions: Array
    true_forces: Array
    true_directions: Array
    state: npt.NDArray[np.int8]
    normals: Array
    areas: Array
    folded: npt.NDArray[np.bool_]


def membrane_results(system: System) -> MembraneResults:
    """Evaluate the membrane at the scene's current state. Collective.

    Parameters
    ----------
    system
        The scene's potential; it is brought to the scene's state.
    """
    _update(system)
    scene, membrane = system.scene, system.membrane
    values = membrane.cell_results()
    n = len(values)
    folded = np.zeros(n, dtype=bool)
    if system.tables is not None:
        # It leaves the folded cells' values behind, and is collective: ranks without any join in.
        system.potential.sum_up()
        cells = system.tables.folded.cells
        if len(cells):
            values[cells] = system.folds.cell_results()
            folded[cells] = True
    E = _symmetric(values[:, 0], values[:, 1], values[:, 2] / 2)
    S = _symmetric(values[:, 3], values[:, 4], values[:, 5])

    axes = membrane.material_axes(np.arange(n, dtype=np.int32))
    before, after = _edge_vectors(scene)
    # Columns of F are the current images of the material axes: edges = components x images.
    components = np.einsum("nki,nai->nka", before, axes)
    images = np.linalg.solve(components, after)
    normal = np.cross(images[:, 0], images[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]

    # With U the root of C = F^T F, F S F^T = R (U S U) R^T: one symmetric problem in the plane.
    squared, Q = np.linalg.eigh(np.eye(2) + 2 * E)
    stretch = np.sqrt(np.maximum(squared, FLAT))
    J = stretch.prod(axis=1)
    U = np.einsum("nij,nj,nkj->nik", Q, stretch, Q)
    true_forces, turned = _principal(U @ S @ U / J[:, None, None])
    unturned = np.linalg.solve(U, np.swapaxes(turned, 1, 2))  # columns: eigenvectors of S C / J
    first = np.einsum("na,nai->ni", unturned[:, :, 0], images)
    first /= np.linalg.norm(first, axis=1)[:, None]

    second_piola, directions = _principal(S)
    return MembraneResults(
        strains=_principal(E)[0],
        second_piola=second_piola,
        second_piola_directions=np.einsum("nka,nai->nki", directions, axes),
        true_forces=true_forces,
        true_directions=np.stack([first, np.cross(normal, first)], axis=1),
        state=np.rint(values[:, 6]).astype(np.int8),
        normals=normal,
        areas=J * np.linalg.norm(np.cross(before[:, 0], before[:, 1]), axis=1) / 2,
        folded=folded,
    )


def _symmetric(a: Array, b: Array, c: Array) -> Array:
    """Matrices (n, 2, 2) with diagonal a, b and c off it."""
    return np.stack([np.stack([a, c], axis=-1), np.stack([c, b], axis=-1)], axis=-2)


def _principal(tensors: Array) -> tuple[Array, Array]:
    """Principal values (n, 2), larger first, and their directions as rows, (n, 2, 2)."""
    ascending, columns = np.linalg.eigh(tensors)
    values: Array = ascending[:, ::-1]
    return values, np.swapaxes(columns, 1, 2)[:, ::-1]


def _edge_vectors(scene: Scene) -> tuple[Array, Array]:
    """Two sides of the owned cells, stress-free and current, (n, 2, 3) each."""
    mesh = scene.mesh.mesh
    owned = mesh.topology.index_map(2).size_local
    x = mesh.geometry.x[geometry_dofmap(mesh)[:owned]]
    u = scene.u.x.array.reshape(-1, 3)[scene.V.dofmap.list[:owned]]
    before: Array = np.asarray(x[:, 1:] - x[:, :1], dtype=np.float64)
    return before, before + (u[:, 1:] - u[:, :1])


def _update(system: System) -> None:
    """Bring a system to its scene's state, in a new layout if the scene got new parts."""
    if system.built_for != system.scene.changes:
        system.rebuild()
    system.pull()


@dataclass(frozen=True)
class Reactions:
    """Forces with which supports hold the membrane.

    Attributes
    ----------
    total : (3,)
        Their sum (force), on all ranks.
    positions, forces : (n, 3)
        This rank's owned vertices, where they are now, and the force on each; zero in directions
        that are not held.
    """

    total: Array
    positions: Array
    forces: Array


def reactions(system: System, where: str | Marker) -> Reactions:
    """Forces that the supports of vertices exert on the membrane. Collective.

    They include what a cable hands on that passes over held edges, and not the pull of a cable's
    end, which is its anchor's: `crms_fenicsx.model.laid_cable.CableEnd.reaction`.

    Parameters
    ----------
    system
        The scene's potential; it is brought to the scene's state.
    where
        Vertices, as for `Scene.vertices`.

    Raises
    ------
    InputError
        As `Scene.vertices`.
    """
    dofs = system.scene.vertices(where)
    _update(system)
    potential, unknowns = system.potential, system.unknowns
    potential.sum_up()
    vector, g = unknowns.vector()
    # The potential -p (V - V0) has the pressure's forces as gradient only inside the boundary.
    potential_only = system.scene.pressure_law == "total"
    for term in potential.terms:
        if not (potential_only and term.name == "pressure"):
            term.add_gradient(potential.x, potential.sums_of(term), g)
    if potential_only and system.scene.pressure != 0.0:
        _subtract_pressure(system, g)
    _leave_ends_to_anchors(system, g)
    _hand_on_rails(system, g)
    unknowns.gather_forces(vector, g)
    owned = dofs[dofs < unknowns.n_vertices]
    forces = np.where(system.scene.held[owned], g[owned], 0.0)
    vector.destroy()
    total = _sum_over_ranks(system.scene, forces)
    return Reactions(total, system.scene.positions()[owned], forces)


def _subtract_pressure(system: System, g: Array) -> None:
    """Subtract a third of the pressure on each facet at its corners."""
    corners, vectors = pressed_facets(system)
    np.subtract.at(g, corners, system.scene.pressure / 3 * vectors[:, None, :])


def pressed_facets(system: System) -> tuple[Integers, Array]:
    """This rank's current facets under pressure, by plain geometry.

    Returns
    -------
    corners : (n, 3)
        Blocks; facets of folded cells that belong to a mean over fans overlap.
    vectors : (n, 3)
        Area vectors (length squared), outward, times the facets' weights in the mean.
    """
    unknowns, owned = system.unknowns, system.scene.mesh.mesh.topology.index_map(2).size_local
    dofs = system.scene.V.dofmap.list[:owned][system.plain_pressed.x.array[:owned] > 0.5]
    corners = unknowns.vertex_blocks()[dofs]
    weights: Array = np.ones(len(dofs))
    if system.tables is not None:
        facets = system.tables.facets
        corners = np.concatenate([corners, facets.corners])
        weights = np.concatenate([weights, facets.weights])
    # By components: rows of three take numpy five times as long.
    places = np.ascontiguousarray((unknowns.X + system.potential.x).T)
    start = places.take(corners[:, 0], axis=1)
    (a, b, c), (d, e, f) = (places.take(corners[:, k], axis=1) - start for k in (1, 2))
    vectors = np.array([b * f - c * e, c * d - a * f, a * e - b * d])
    vectors *= weights / 2
    return corners, vectors.T


def _leave_ends_to_anchors(system: System, g: Array) -> None:
    """Take the pull of cable ends off the held places of the membrane that they lie on.

    Between an anchor and the place of the membrane under it the cable has no length and its force
    no direction: the gradient splits the end's pull between the two at random.
    """
    network = system.network
    if network is None:
        return
    for c, cable in enumerate(network.cables):
        for end in (cable.start, cable.end):
            k = cable.node_of(end.which)
            if cable.nodes[k].kind != "anchor" or not cable.taut:
                continue
            anchor = network.numbers[c, k]
            near = 1 if k == 0 else k - 1  # if lifted, there is a span, which has a direction
            if network.owners[anchor] == network.rank and not cable.lifted[near]:
                block, beside = network.block(c, k), network.block(c, near)
                g[beside] += g[block] - end.reaction
                g[block] = end.reaction


def _hand_on_rails(system: System, g: Array) -> None:
    """Give the forces of cables on held edges that they slide along to the edges' ends."""
    if system.unknowns.n_rails:
        assert system.network is not None
        blocks, ends, s = system.network.rail_table()
        share = np.stack([1 - s, s], axis=1)
        np.add.at(g, ends, share[:, :, None] * g[blocks][:, None, :])
        g[blocks] = 0.0


def _sum_over_ranks(scene: Scene, vectors: Array) -> Array:
    """Sum of all ranks' vectors (n, 3), (3,)."""
    total = np.zeros(3)
    scene.comm.Allreduce(np.asarray(vectors.sum(axis=0)), total)
    return total


def gained_volume(scene: Scene) -> float:
    """Volume between the stress-free and the current cells under pressure (length cubed).

    Collective. A pressure p does the work p V on it. While their rim is held, or slides in planes,
    it is that between the two surfaces and the planes; if it moves else, what its way sweeps out as
    seen from the stress-free membrane's centre counts too.
    """
    from crms_fenicsx.energies.pressure_rim import gain

    V, mesh = scene.V, scene.mesh.mesh
    shape = folded_shape(scene)
    owned = mesh.topology.index_map(2).size_local
    plain = scene.pressed[:owned].copy()
    plain[shape.cells] = False
    cells = V.dofmap.list[:owned]
    X, u = shape.stress_free - scene.centre, shape.points - shape.stress_free
    local = _volume_change(X, u, cells[plain]).sum()
    pieces = [corners for cell, corners in shape.pieces if scene.pressed[cell]]
    if pieces:
        from crms_fenicsx.surface.polygons import fan_facets

        corners, weights = fan_facets(pieces)
        # Pieces of a folded cell together are, stress-free, the cell: their changes add up.
        local += np.sum(weights * _volume_change(X, u, corners))
    rim = scene.rim()
    local += rim.factors @ gain(*(places.reshape(-1)[rim.components] for places in (X, u)))
    return float(scene.comm.allreduce(float(local)))


def _volume_change(X: Array, u: Array, triangles: npt.NDArray[np.integer]) -> Array:
    """Volume between each triangle and the origin, current less stress-free, (n,).

    Term by term, so that a small change is not lost in a large volume.
    """
    a, h = X[triangles], u[triangles]
    d, s = a[:, 1:] - a[:, :1], h[:, 1:] - h[:, :1]
    n0 = np.cross(d[:, 0], d[:, 1])
    change = np.cross(d[:, 0], s[:, 1]) + np.cross(s[:, 0], d[:, 1]) + np.cross(s[:, 0], s[:, 1])
    at, moved = a.mean(axis=1), h.mean(axis=1)
    volume: Array = np.sum(moved * (n0 + change) + at * change, axis=1) / 6
    return volume
