"""Supports of a form, and directions in which its vertices move."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from crms_fenicsx.design.form_finding.film import Film
from crms_fenicsx.design.form_finding.form_cables import EdgeLine
from crms_fenicsx.foundation.dofs.layout import edge_ends
from crms_fenicsx.foundation.runtime import checks
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import InputError, as_text, raised_together
from crms_fenicsx.model.membrane import Membrane

LYING = 0.1
"""Part of a direction left free by supports up to which the direction counts as held."""


class Directions:
    """Splits the free directions of vertices into those across a form and those within it.

    Across are the surface normal, at cables the two directions square to the cable, and where
    cables end or meet all directions; a vertex that moves within leaves the form unchanged. At a
    `guided` vertex, held in some directions, forces within the surface count as well. `across`,
    `within`, `counted` (where forces must balance) and `along` (cables) are projectors, (n, 3, 3).
    """

    def __init__(self, membrane: Membrane, film: Film, lines: Sequence[EdgeLine]) -> None:
        self._film, self._lines = film, lines
        n = membrane.V.dofmap.index_map.size_local
        self.free = ~membrane.held[:n]
        ids = membrane.vertex_ids[:n]
        vertices = np.concatenate([np.zeros(0, dtype=np.int64), *(line.ids for line in lines)])
        numbers, count = np.unique(vertices, return_counts=True)
        ends = [line.ids[[0, -1]] for line in lines]
        inner = np.setdiff1d(numbers[count == 1], np.concatenate([numbers[:0], *ends]))
        self.on_cable = np.isin(ids, inner)
        on_any = np.isin(ids, numbers)
        self._joint = on_any & ~self.on_cable
        self.guided = ~on_any & self.free.any(axis=1) & ~self.free.all(axis=1)
        self.across, self.within, self.counted, self.along = np.zeros((4, n, 3, 3))

    def take(self) -> None:
        """Update the directions to the current shape. Collective."""
        film, free = self._film, self.free[:, :, None] * np.eye(3)
        normal = self._freed(film.growth())
        along = sum((line.tangents(len(film.start)) for line in self._lines), 0.0 * film.start)
        tangent = self._freed(film.gathered(along)) * self.on_cable[:, None]
        held = self.on_cable | self._joint
        self.across = normal[:, :, None] * normal[:, None, :]
        self.across[held] = (free - tangent[:, :, None] * tangent[:, None, :])[held]
        self.within = free - self.across
        self.counted = np.where(self.guided[:, None, None], free, self.across)
        self.along = np.where(self.on_cable[:, None, None], self.within, 0.0)

    def _freed(self, vectors: Array) -> Array:
        """Free components of vectors (n, 3) as unit vectors, zero if almost none is free."""
        lengths = np.linalg.norm(vectors, axis=1)
        parts = np.where(self.free, vectors, 0.0)
        sizes = np.linalg.norm(parts, axis=1)
        sizes = np.where(sizes > LYING * lengths, sizes, np.inf)
        return np.asarray(parts / sizes[:, None])


Lift = Sequence[float] | Callable[[Array], Array]
"""A displacement (3,), or a function of start positions (3, n) that returns (3, n)."""


def hold(membrane: Membrane, fixed: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Hold groups; return the held directions by group. Collective."""
    if isinstance(fixed, str) or not isinstance(fixed, Sequence | Mapping) or not fixed:
        raise InputError(
            f'find_form: fixed = {fixed!r}; give the groups that are held, as in ["boundary"].'
        )
    supports = dict(fixed) if isinstance(fixed, Mapping) else dict.fromkeys(fixed, "xyz")
    for group, directions in supports.items():
        if not isinstance(group, str):
            raise InputError(f"find_form: fixed has {group!r}; give names of groups of the mesh.")
        membrane.hold(group, directions, new_edges=True)
    held = membrane.comm.allreduce(membrane.held.any(axis=0).astype(int))
    free = "".join(letter for letter, count in zip("xyz", held, strict=True) if not count)
    if free:
        raise InputError(
            f"find_form: fixed = {fixed!r} holds nothing along {free}; hold a group there too."
        )
    return supports


def group_sums(membrane: Membrane, groups: Iterable[str], forces: Array) -> dict[str, Array]:
    """Sum (3,) of the forces (n, 3) on this rank's owned vertices, per group. Collective."""
    sums = {}
    for group in groups:
        dofs = membrane.vertices(group)
        sums[group] = membrane.comm.allreduce(forces[dofs[dofs < len(forces)]].sum(axis=0))
    return sums


def lifts(membrane: Membrane, lifted: Mapping[str, Lift]) -> Array:
    """Displacements of this rank's owned vertices, (n, 3). Collective."""
    lift = np.full_like(membrane.stress_free, np.nan)
    for group, by in lifted.items():
        dofs = membrane.vertices(group)
        with raised_together(membrane.comm):
            places = membrane.stress_free[dofs]
            if callable(by):
                what = f"find_form: the function that lifts {group!r}"
                ways = checks.returned(what, by(places.T), places.T, places.T.shape).T
            else:
                ways = np.tile(checks.vector(f"find_form: lifted[{group!r}]", by), (len(dofs), 1))
            for bad, what in (
                (~membrane.held[dofs] & (ways != 0.0), "is not held in that direction"),
                (~np.isnan(lift[dofs]) & (lift[dofs] != ways), "another group moves elsewhere"),
            ):
                if bad.any():
                    k = int(np.argmax(bad.any(axis=1)))
                    raise InputError(
                        f"find_form: {group!r} is lifted by {as_text(ways[k])} at "
                        f"{as_text(places[k])}, which {what}; hold what is lifted, to one place."
                    )
            lift[dofs] = ways
    return np.nan_to_num(lift, nan=0.0)


def check_free_edges(membrane: Membrane, lines: Sequence[EdgeLine]) -> None:
    """Refuse free edges without a cable. Collective."""
    topology = membrane.mesh.mesh.topology
    edges = membrane.mesh.edges["boundary"]
    edges = edges[edges < topology.index_map(1).size_local]
    held = [membrane.mesh.edges[line.cable.group] for line in lines]
    edges = np.setdiff1d(edges, np.concatenate([*held, np.zeros(0, np.int32)]))
    ends = edge_ends(membrane.V)[edges]
    fixed = np.asarray(membrane.held[ends].any(axis=2))
    free = ends[~fixed.all(axis=1)]
    count = membrane.comm.allreduce(len(free))
    places = membrane.comm.allgather(membrane.stress_free[free[:1]].mean(axis=1))
    if count:
        place = as_text(np.concatenate(places)[0])
        raise InputError(
            f"find_form: {count} edges at the rim are neither held nor have a cable, one at "
            f"{place}; the film would draw them in. Fix them, or give them a FormCable."
        )


def rim_centre(membrane: Membrane, lift: Array, inflated: bool) -> Array:
    """Mean position of the rim, or centre of a membrane without a rim. Collective."""
    edges = membrane.open_edges
    ends = np.unique(edges.vertices)
    if inflated:
        free = ends[~membrane.held[ends].all(axis=1)]
        found = np.concatenate(membrane.comm.allgather(membrane.stress_free[free[:1]]))
        if len(found):
            raise InputError(
                "find_form: there is pressure, but the rim is not held in all directions at "
                f"{as_text(found[0])}; hold the rim."
            )
    own = ends[ends < membrane.V.dofmap.index_map.size_local]
    places = (membrane.stress_free + lift)[own]
    total = membrane.comm.allreduce(np.array([*places.sum(axis=0), len(own)]))
    return np.asarray(total[:3] / total[3]) if total[3] else membrane.centre
