"""Recovered values of the membrane at its vertices, reinforcement, and the utilisation judged.

Cells have one value each, which jumps from cell to cell and belongs to none of its points in
particular. The recovered value of a vertex is the mean of the cells around it, weighted by area (O.
C. Zienkiewicz and J. Z. Zhu, 1987); only cells of one material and one pair of strengths are
averaged. It is exact where the field is uniform. Where the field is linear it is exact at vertices
whose cells lie symmetrically, and elsewhere, such as at edges, off by the gradient times a part of
a cell, so that it converges with the cells' size.

At a point support, a bar's end, the end of a held edge and a re-entrant corner, the section forces
of the continuum are infinite: finer cells have larger ones, without end. Fabric is therefore
reinforced there, by further layers or a plate, and its strength judged outside of this patch, whose
radius is a length of the structure and not of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from dolfinx.mesh import exterior_facet_indices

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers
from crms_fenicsx.foundation.runtime.checks import as_counted
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.strengths import ALL
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.results.cable_and_bar_results import Force, triple
from crms_fenicsx.results.membrane_results import MembraneResults, nodal_means
from crms_fenicsx.results.quantities import summed


@dataclass(frozen=True)
class Patch:
    """Reinforcement around a corner of the membrane.

    Attributes
    ----------
    at : (3,)
        Stress-free place of the corner (length).
    radius
        Of the patch, on the stress-free membrane (length).
    reason
        Why it is a corner: "support", "bar", "cable", "end of a held edge", "re-entrant"; or
        "named", if only `Scene.set_strengths` says so.
    given
        Whether the radius is that of `Scene.set_strengths`.
    """

    at: Force
    radius: float
    reason: str
    given: bool


REASONS = ("support", "bar", "end of a held edge", "re-entrant", "named")


def patches(scene: Scene) -> dict[str, Patch]:
    """The membrane's reinforcement by name, the same on all ranks. Collective.

    A patch has the name of its point group, or else "corner 1", "corner 2" ...
    """
    membrane = scene.membrane
    own = membrane.V.dofmap.index_map.size_local
    reason, group = _reasons(scene)[:own], np.full(own, "", dtype=object)
    for name in sorted(membrane.mesh.points, key=as_counted):
        dofs = membrane.vertices(name)
        dofs = dofs[dofs < own]
        group[dofs[group[dofs] == ""]] = name
        if name in membrane.patches:
            group[dofs] = name
            reason[dofs] = np.minimum(reason[dofs], REASONS.index("named"))
    mine = [
        (triple(membrane.stress_free[row]), str(group[row]), REASONS[reason[row]])
        for row in np.flatnonzero(reason < len(REASONS))
    ]
    found = [*chain.from_iterable(scene.comm.allgather(mine))]
    for cable in scene.cables:
        for k in (0, -1):
            if cable.hold != "bonded" and cable.state.nodes[k].kind != "anchor":  # on free fabric
                place = triple(cable.state.reference_positions[k])
                away = [float(np.linalg.norm(np.subtract(place, at))) for at, _, _ in found]
                if min(away, default=np.inf) > SAME_PLACE * membrane.size:
                    found.append((place, "", "cable"))
    return _named(membrane, sorted(found))


def _named(membrane: Membrane, found: list[tuple[Force, str, str]]) -> dict[str, Patch]:
    """The patches at places, with their groups and reasons, by unique names."""
    places = np.array([place for place, _, _ in found]).reshape(-1, 3)
    groups = [group for _, group, _ in found]
    named = dict[str, Patch]()
    for number, (place, group, reason) in enumerate(found, 1):
        radius = membrane.patches.get(group, membrane.patches.get(ALL))
        given = radius is not None
        if radius is None:
            away = np.linalg.norm(places - np.array(place), axis=1)
            radius = 0.05 * float(np.min(away[away > 0.0], initial=membrane.size))
        single = group and groups.count(group) == 1
        name = group if single else f"{group or 'corner'} {number}"
        named[name] = Patch(place, radius, reason, given)
    return {name: named[name] for name in sorted(named, key=as_counted)}


def _reasons(scene: Scene) -> Integers:
    """Number in `REASONS` of each vertex, with ghosts; their count elsewhere. Collective."""
    membrane = scene.membrane
    mesh, held = membrane.mesh.mesh, membrane.held
    ends = edge_ends(membrane.V)
    own = mesh.topology.index_map(1).size_local
    rim = np.zeros(len(ends), dtype=bool)
    mesh.topology.create_connectivity(1, 2)
    rim[exterior_facet_indices(mesh.topology)] = True
    both = held[ends[:, 0]] & held[ends[:, 1]]
    marks = np.stack([both.any(axis=1), rim & both.all(axis=1), rim & ~both.any(axis=1)], axis=1)
    beside = summed(membrane.V, ends[:own], np.repeat(marks[:own, None].astype(float), 2, axis=1))
    corners = membrane.V.dofmap.list[: mesh.topology.index_map(2).size_local]
    x = membrane.stress_free[corners]
    sides = np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x
    across = np.linalg.norm(np.cross(*sides), axis=2)
    angles = np.arctan2(across, np.einsum("nki,nki->nk", *sides))
    angle = summed(membrane.V, corners, np.repeat(angles[..., None], 3, axis=2))[:, 0]
    pulled = np.zeros(len(held), dtype=bool)
    for vertex in scene.frame.vertices:
        rank, dof = scene.frame.home(vertex)
        pulled[dof] |= rank == scene.comm.rank
    alone, fixed, free = beside[:, 0] == 0, beside[:, 1] > 0, beside[:, 2] > 0
    reason = np.full(len(held), len(REASONS))
    reason[free & ~fixed & (angle > np.deg2rad(210.0))] = REASONS.index("re-entrant")
    reason[fixed & free] = REASONS.index("end of a held edge")
    reason[alone & pulled] = REASONS.index("bar")
    reason[alone & held.any(axis=1)] = REASONS.index("support")
    return reason


def reinforced(places: Array, corners: dict[str, Patch]) -> Booleans:
    """Whether stress-free places (..., 3) lie in a patch."""
    within = np.zeros(places.shape[:-1], dtype=bool)
    for patch in corners.values():
        within |= np.linalg.norm(places - np.array(patch.at), axis=-1) <= patch.radius
    return within


def recovered(results: MembraneResults, name: str) -> Array:
    """Values of a quantity at the corners of this rank's cells, (n, 3), means of the cells around
    of the same material and strengths; NaN where these have none. Collective."""
    values, kinds = results.values(name), _kinds(results)
    space = results.membrane.nodal_values
    corners = space.dofmap.list[: len(values)]
    found = np.full((len(values), 3), np.nan)
    present = np.concatenate(results.comm.allgather(np.unique(kinds)))
    for kind in np.unique(present):
        own = kinds == kind
        masked = np.where(own, values, np.nan)
        means = nodal_means(results.membrane, name, masked, results.stress_free_areas)
        found[own] = means.x.array[corners[own]]
    return found


def _kinds(results: MembraneResults) -> Integers:
    """Number of the material and strengths of this rank's cells, the same on all ranks, (n,)."""
    membrane, n = results.membrane, len(results.state)
    tags = np.zeros(n, dtype=np.int64)
    if membrane.cell_tags is not None:
        tags += membrane.cell_tags.values[:n]
    strengths = np.zeros(n, dtype=np.int64)
    for number, part in enumerate(membrane.strengths, 1):
        strengths[slice(None) if part == ALL else results.parts[part]] = number
    return np.asarray(tags * (len(membrane.strengths) + 1) + strengths)


@dataclass(frozen=True)
class JudgedUtilisation:
    """The utilisation that summaries, reports and pictures use."""

    # (n, 3, 3) recovered at the corners of this rank's cells: along warp, along weft, and of the
    # major principal force in isotropic material; NaN where there is no such direction
    ratios: Array
    limits: Array  # (n, 3) design strengths of the cells that these ratios refer to
    patched: Booleans  # (n, 3) which corners lie in reinforcement
    # (n,) largest difference of a cell's own value from those at its corners out of reinforcement
    spread: Array

    @property
    def corners(self) -> Array:
        """The larger ratio at each corner, (n, 3)."""
        return np.asarray(np.fmax.reduce(self.ratios, axis=2))

    @property
    def judged(self) -> Array:
        """Values at the corners, (n, 3), NaN in reinforcement."""
        return np.where(self.patched, np.nan, self.corners)

    @property
    def shown(self) -> Array:
        """As `judged`, with the largest other value of the cell where it has any, to draw it."""
        most = np.max(self.judged, axis=1, initial=-np.inf, where=~self.patched)
        most = np.where(np.isfinite(most), most, np.nan)
        return np.where(self.patched, most[:, None], self.corners)


def judged_utilisation(results: MembraneResults, patches: dict[str, Patch]) -> JudgedUtilisation:
    """Recover the utilisation and mark the corners in reinforcement. Collective."""
    n, plain = len(results.state), results.membrane.isotropic
    strengths: Array = np.full((n, 2), np.nan)
    for part, one in results.design.items():
        strengths[slice(None) if part == ALL else results.parts[part]] = one.design
    forces: Array = np.full((n, 3, 3), np.nan)
    for k, name in enumerate(("warp", "weft", "true force 1")):
        if name in results.names:
            own = plain if name == "true force 1" else ~plain
            forces[own, :, k] = recovered(results, name)[own]
    limits = np.column_stack([strengths, strengths.min(axis=1)])
    ratios = np.maximum(forces / limits[:, None], 0.0)
    patched = reinforced(results.surface.stress_free, patches)[results.membrane.V.dofmap.list[:n]]
    found = JudgedUtilisation(ratios, limits, patched, np.zeros(n))
    away = np.abs(found.corners - results.values("utilisation")[:, None])
    return replace(found, spread=np.max(away, axis=1, initial=0.0, where=~patched))


def at_facets(results: MembraneResults, corners: Array) -> Array:
    """Values (m, 3) at the corners of the facets of the current surface, linear in each cell
    between those at its corners (n, 3)."""
    surface = results.surface
    dofs = results.membrane.V.dofmap.list[surface.parents]
    x = surface.stress_free[dofs]
    places = surface.stress_free[surface.triangles]
    sides = x[:, 1:] - x[:, :1]
    product = np.einsum("nai,nbi->nab", sides, sides)
    away = np.einsum("nki,nai->nka", places - x[:, :1], sides)
    share = np.einsum("nab,nkb->nka", np.linalg.inv(product), away)
    weights = np.concatenate([1.0 - share.sum(axis=2, keepdims=True), share], axis=2)
    return np.einsum("nkv,nv->nk", weights, corners[surface.parents])
