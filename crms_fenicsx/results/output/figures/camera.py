"""Camera: projection, lighting and visibility."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers


@dataclass(frozen=True)
class Camera:
    """A viewer looking at a point."""

    # viewer's position in degrees: azimuth counter-clockwise from the x axis, elevation above the
    # horizontal plane; (-90, 90) is the plan with x to the right
    azimuth: float
    elevation: float
    centre: ArrayLike  # (3,) point in the picture's centre (length)
    distance: float = np.inf  # from viewer to centre; infinite: parallel projection

    @property
    def axes(self) -> Array:
        """Unit vectors to the right, upwards and towards the viewer, as rows (3, 3)."""
        a, e = np.radians([self.azimuth, self.elevation])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        return np.array([right, np.cross(towards, right), towards])

    def project(self, points: ArrayLike) -> Array:
        """Projections (..., 3), right, up and towards the viewer; straight lines stay straight."""
        seen = (np.asarray(points, dtype=np.float64) - np.asarray(self.centre)) @ self.axes.T
        return seen / (1.0 - seen[..., 2:] / self.distance)

    def place(self, seen: Array) -> Array:
        """Points (..., 3) of given projections: the inverse of `project`."""
        return seen / (1.0 + seen[..., 2:] / self.distance) @ self.axes + np.asarray(self.centre)


def brightness(camera: Camera, corners: Array) -> tuple[Array, Array]:
    """Diffuse and specular light, 0 to 1, on triangles (m, 3, 3) lit from both sides."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, sizes, out=np.zeros_like(normals), where=sizes > 0) @ camera.axes.T
    normals[normals[:, 2] < 0] *= -1.0
    light = np.array([-0.70, 0.45, 0.56])
    light /= np.linalg.norm(light)
    halfway = light + np.array([0.0, 0.0, 1.0])
    halfway /= np.linalg.norm(halfway)
    return np.clip(normals @ light, 0.0, 1.0), np.clip(normals @ halfway, 0.0, 1.0) ** 24


def visible(samples: Array, corners: Array, tolerance: float) -> Booleans:
    """Whether points (s, 3) are hidden by no triangle of (m, 3, 3), (s,)."""
    seen = np.ones(len(samples), dtype=bool)
    if len(corners) == 0 or len(samples) == 0:
        return seen
    sample, triangle = _candidates(samples, corners)
    a, b, c = (corners[triangle, i] for i in range(3))
    p = samples[sample]
    area = _cross(b - a, c - a)
    edge_on = np.abs(area) <= 1e-14 * np.ptp(corners[..., :2]) ** 2
    area[edge_on] = np.inf
    v = _cross(p - a, c - a) / area
    w = _cross(b - a, p - a) / area
    inside = (v >= 0) & (w >= 0) & (v + w <= 1) & ~edge_on
    nearness = a[:, 2] + v * (b[:, 2] - a[:, 2]) + w * (c[:, 2] - a[:, 2])
    seen[sample[inside & (nearness > p[:, 2] + tolerance)]] = False
    return seen


def _cross(a: Array, b: Array) -> Array:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _candidates(samples: Array, corners: Array) -> tuple[Integers, Integers]:
    """Pairs (sample, triangle) that share a bin of a grid over the picture."""
    bins = int(np.clip(np.sqrt(len(corners)), 1, 256))
    low = corners[..., :2].min(axis=(0, 1))
    cell = np.maximum(np.ptp(corners[..., :2], axis=(0, 1)), 1e-300) / bins

    def bin_of(xy: Array) -> Integers:
        return np.clip(np.floor((xy - low) / cell), 0, bins - 1).astype(np.int64)

    first, last = bin_of(corners[..., :2].min(axis=1)), bin_of(corners[..., :2].max(axis=1))
    across, upright = (last - first + 1).T
    triangle, k = offsets_within(across * upright)
    in_bin = (first[triangle, 0] + k % across[triangle]) * bins + (
        first[triangle, 1] + k // across[triangle]
    )
    triangle = triangle[np.argsort(in_bin, kind="stable")]
    starts = np.concatenate([[0], np.cumsum(np.bincount(in_bin, minlength=bins * bins))])

    column, row = bin_of(samples[:, :2]).T
    home = column * bins + row
    sample, k = offsets_within(starts[home + 1] - starts[home])
    return sample, triangle[starts[home[sample]] + k]


def offsets_within(counts: Integers) -> tuple[Integers, Integers]:
    """Each index i `counts[i]` times, and a counter 0, 1, ... of the repetitions."""
    index = np.repeat(np.arange(len(counts)), counts)
    return index, np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
