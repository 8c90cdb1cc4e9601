"""Vertices of held rims that make way for the ends of rows that slide along these."""

from __future__ import annotations

import numpy as np

from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Booleans, Integers
from crms_fenicsx.model.membrane import Membrane


def within_held_rims(membrane: Membrane, sliding: Integers) -> Booleans:
    """Whether each local vertex (n,) lies within a part of the rim that is held in all directions
    and displaced alike, but at the vertices `sliding` (k,) along it: it may come to lie anywhere
    there. Collective."""
    surface, own = membrane.first_surface, membrane.V.dofmap.index_map.size_local
    held, u = np.zeros(len(surface.rim), dtype=bool), np.zeros((len(surface.rim), 3))
    mine = membrane.vertex_ids[:own], membrane.held[:own].all(axis=1), membrane.owned_u
    for ids, some, ways in membrane.comm.allgather(mine):
        held[ids], u[ids] = some, ways.reshape(-1, 3)
    u[sliding] = np.nan
    a, b = surface.rims.T
    apart = norm(u[a] - u[b]) > np.maximum(surface.least[a], surface.least[b])
    even = np.repeat(held[a] & held[b] & ~apart, 2)
    found, edges = (np.bincount(surface.rims.ravel(), w, len(held)) for w in (even, None))
    return np.asarray(((edges == 2) & (found == 2))[membrane.vertex_ids])
