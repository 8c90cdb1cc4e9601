"""What a row of vertices that slides runs into, in words with a remedy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crms_fenicsx.analysis.equilibrium.kept_vertices import kept_vertices
from crms_fenicsx.analysis.scene import Scene
from crms_fenicsx.cabling.cables.row_shifts import fixed_vertices
from crms_fenicsx.foundation.meshes.triangles import norm
from crms_fenicsx.foundation.runtime.arrays import Array
from crms_fenicsx.foundation.runtime.errors import as_text
from crms_fenicsx.model.laid_cable import LaidCable

COLLAPSED = 1e-3
"""Ratio of a cell's area to its first one below which it has collapsed: each solve takes a share of
what is left, so that rows that draw each other together would never end."""


def collapse_words(scene: Scene, place: Array, near: Sequence[LaidCable]) -> str:
    """Words on cells that collapse at a stress-free place (3,) with some rows near it, the nearest
    first. Collective."""
    slides = [cable.name for cable in near if cable.taut and cable.takes_line]
    stays = [cable.name for cable in near if cable.name not in slides]
    where = f"cells near {as_text(place)} collapse"
    if len(slides) > 1:
        close = f"{slides[0]} and {slides[1]} come so close to each other that {where} between them"
        if all(cable.cable.diameter > 0.0 for cable in near if cable.name in slides[:2]):
            return (
                f"{close} before they touch, to less than a thousandth of their first areas; lay "
                "the lines nearer to each other, or hold them with slide=False"
            )
        return (
            f"{close}: give both cables their diameters, at which they touch side by side, lay one "
            "of them by its path, without `along`, lay them further apart, or hold the lines with "
            "slide=False"
        )
    who = slides[0] if slides else "the cables"
    what = stays[0] if stays else _nearest(scene, place)
    between = f", between it and {what}, which it cannot pass" if what else ""
    return (
        f"{who} would slide so far that {where}{between}; lay it nearer to where it comes to rest, "
        f"lay it by its path, without `along`, or hold the lines with slide=False"
    )


def _nearest(scene: Scene, place: Array) -> str:
    """What keeps the vertices that are nearest to a place of those that never move; "" if none do.
    Collective."""
    membrane, kept = scene.membrane, kept_vertices(scene)
    held = membrane.held.any(axis=1)
    all_fixed = fixed_vertices(membrane, kept)
    ways = norm(membrane.stress_free - place)
    reasons = {
        "a support": all_fixed & held,
        "what is fixed to the fabric there: a joint, a cable's end or a force on a vertex": kept,
        "the border of another part or material": all_fixed & ~held & ~kept,
    }
    mine = [float(np.where(mask, ways, np.inf).min(initial=np.inf)) for mask in reasons.values()]
    every = np.min(scene.comm.allgather(mine), axis=0)
    nearest = int(np.argmin(every))
    return list(reasons)[nearest] if np.isfinite(every[nearest]) else ""
