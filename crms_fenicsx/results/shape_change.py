"""Detect whether a roof has collapsed or turned over between two states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.foundation.meshes.triangles import double_areas, norm
from crms_fenicsx.foundation.runtime.arrays import Array

ENCLOSES = 0.02
"""Volume between roof and rim, relative to area to 3/2, from which a roof encloses a volume."""


@dataclass(frozen=True)
class Shape:
    """Shape of this rank's cells in a state of a scene."""

    apex: Array  # (3,) mean of the held vertices in the first state (length)
    vectors: Array  # (m, 3) areas times unit normals (length squared)
    volume: float  # between the cells and the apex: the cone over the rim (length cubed)
    area: float  # of the cells (length squared)


@dataclass(frozen=True)
class ShapeChange:
    """Change of a shape."""

    # volume between roof and rim, relative to that before; None if the roof enclosed none
    volume: float | None
    turned: float  # share of the former area turned by more than 90 degrees


def shape_of(scene: Scene, apex: Array | None = None) -> Shape:
    """Present shape and volume, about the held vertices' mean or a given apex. Collective."""
    comm, own = scene.comm, scene.mesh.mesh.topology.index_map(2).size_local
    places, n = scene.positions(), scene.V.dofmap.index_map.size_local
    if apex is None:
        held = scene.held[:n].any(axis=1)
        held = held if comm.allreduce(int(held.sum())) else np.ones(n, dtype=bool)
        apex = comm.allreduce(places[:n][held].sum(axis=0)) / comm.allreduce(int(held.sum()))
    corners = places[scene.V.dofmap.list[:own]]
    vectors = double_areas(corners) / 2
    volume = float(((corners.mean(axis=1) - apex) * vectors).sum()) / 3
    volume, area = comm.allreduce(np.array([volume, norm(vectors).sum()])).tolist()
    return Shape(apex, vectors, volume, area)


def shape_change(before: Shape, scene: Scene) -> ShapeChange:
    """Change since an earlier shape. Collective."""
    now = shape_of(scene, before.apex)
    turned = np.einsum("mi,mi->m", before.vectors, now.vectors) < 0.0
    share = scene.comm.allreduce(float(norm(before.vectors)[turned].sum())) / before.area
    encloses = abs(before.volume) > ENCLOSES * before.area**1.5
    return ShapeChange(now.volume / before.volume if encloses else None, share)
