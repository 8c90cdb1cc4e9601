"""Corners where the membrane's section forces have no limit as cells become finer, and the
reinforcement around them.

At a point support, a bar's end, the end of a held edge and a re-entrant corner, the section forces
of the continuum are infinite: finer cells have larger ones, without end. Fabric is therefore
reinforced there, by further layers or a plate, and its strength judged outside of this patch, whose
radius is a length of the structure and not of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import exterior_facet_indices

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Indices, Integers
from crms_fenicsx.model.membrane import Membrane
from crms_fenicsx.model.strengths import ALL
from crms_fenicsx.model.tolerances import SAME_PLACE
from crms_fenicsx.results.cable_and_bar_results import Force, triple

SHARE = 0.05
"""Radius of a patch by default, relative to the distance to the next corner."""

INWARD = np.deg2rad(210.0)
"""Angle of the membrane at a free edge's vertex from which the corner is re-entrant."""


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
    for name in sorted(membrane.mesh.points):
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
            radius = SHARE * float(np.min(away[away > 0.0], initial=membrane.size))
        single = group and groups.count(group) == 1
        name = group if single else f"{group or 'corner'} {number}"
        named[name] = Patch(place, radius, reason, given)
    return named


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
    beside = _summed(membrane, ends[:own], np.repeat(marks[:own, None].astype(float), 2, axis=1))
    corners = membrane.V.dofmap.list[: mesh.topology.index_map(2).size_local]
    x = membrane.stress_free[corners]
    sides = np.roll(x, -1, axis=1) - x, np.roll(x, 1, axis=1) - x
    across = np.linalg.norm(np.cross(*sides), axis=2)
    angles = np.arctan2(across, np.einsum("nki,nki->nk", *sides))
    angle = _summed(membrane, corners, np.repeat(angles[..., None], 3, axis=2))[:, 0]
    pulled = np.zeros(len(held), dtype=bool)
    for vertex in scene.frame.vertices:
        rank, dof = scene.frame.home(vertex)
        pulled[dof] |= rank == scene.comm.rank
    alone, fixed, free = beside[:, 0] == 0, beside[:, 1] > 0, beside[:, 2] > 0
    reason = np.full(len(held), len(REASONS))
    reason[free & ~fixed & (angle > INWARD)] = REASONS.index("re-entrant")
    reason[fixed & free] = REASONS.index("end of a held edge")
    reason[alone & pulled] = REASONS.index("bar")
    reason[alone & held.any(axis=1)] = REASONS.index("support")
    return reason


def _summed(membrane: Membrane, dofs: Indices, values: Array) -> Array:
    """Sums (n, 3) at the vertices of values (m, k, 3) at those of edges or cells, dofs (m, k)."""
    found = fem.Function(membrane.V)
    sums: Array = found.x.array.reshape(-1, 3)
    np.add.at(sums, dofs, values)
    found.x.scatter_reverse(la.InsertMode.add)
    found.x.scatter_forward()
    return sums.copy()


def reinforced(places: Array, corners: dict[str, Patch]) -> Booleans:
    """Whether stress-free places (..., 3) lie in a patch."""
    within = np.zeros(places.shape[:-1], dtype=bool)
    for patch in corners.values():
        within |= np.linalg.norm(places - np.array(patch.at), axis=-1) <= patch.radius
    return within
