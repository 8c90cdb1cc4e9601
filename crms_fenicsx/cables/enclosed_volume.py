"""The volume between two shapes of a membrane."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from crms_fenicsx.cables.cable_net import CableNet
from crms_fenicsx.cables.deformed_surface import folded_shape
from crms_fenicsx.energies.pressure_rim import gain, rim_of
from crms_fenicsx.runtime.arrays import Array, pointers, runs
from crms_fenicsx.surface.polygons import fan_facets


def gained_volume(net: CableNet) -> float:
    """Volume between the stress-free and the current cells under pressure (length cubed).

    Collective. A pressure p does the work p V on it. While their rim is held, or slides in planes,
    it is that between the two surfaces and the planes; if it moves else, what its way sweeps out as
    seen from the stress-free membrane's centre counts too.
    """
    membrane = net.membrane
    V, mesh = membrane.V, membrane.mesh.mesh
    shape = folded_shape(net)
    owned = mesh.topology.index_map(2).size_local
    plain = membrane.pressed[:owned].copy()
    plain[shape.cells] = False
    cells = V.dofmap.list[:owned]
    X, u = shape.stress_free - membrane.centre, shape.points - shape.stress_free
    local = _volume_change(X, u, cells[plain]).sum()
    starts, corners, cell = shape.pieces
    pressed = np.flatnonzero(membrane.pressed[cell])
    sizes = np.diff(starts)[pressed]
    facets, weights = fan_facets(pointers(sizes), corners[runs(starts[pressed], sizes)])
    # Pieces of a folded cell together are, stress-free, the cell: their changes add up.
    local += np.sum(weights * _volume_change(X, u, facets))
    rim = rim_of(membrane)
    local += rim.factors @ gain(*(places.reshape(-1)[rim.components] for places in (X, u)))
    return float(membrane.comm.allreduce(float(local)))


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
