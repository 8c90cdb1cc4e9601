"""Contact of two cables where they cross."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.gap import _nearest
from crms_fenicsx.contact.lift_off import DEPTH, PULL, link_at, outward_pulls
from crms_fenicsx.model.crossing import Crossing
from crms_fenicsx.model.laid_cable import LaidCable


def parting(
    crossings: Sequence[Crossing], cables: Sequence[LaidCable], shape: StripShape
) -> list[Crossing]:
    """The crossings at which the upper cable pulls the lower one up."""
    by_upper: dict[int, list[Crossing]] = defaultdict(list)
    for crossing in crossings:
        if not crossing.apart:
            by_upper[crossing.upper].append(crossing)
    found = []
    for c, own in by_upper.items():
        upper = cables[c]
        number = {id(node.crossing): k for k, node in enumerate(upper.nodes) if node.crossing}
        nodes = [number[id(crossing)] for crossing in own]
        on = [n for n, k in enumerate(nodes) if not upper.lifted[k]]
        pulls = outward_pulls(
            upper, [nodes[n] for n in on], *shape.normals_and_sizes([own[n].support for n in on])
        )
        found += [own[n] for n, pull in zip(on, pulls, strict=True) if pull > PULL]
    return found


def joins(crossing: Crossing, cables: Sequence[LaidCable], shape: StripShape) -> bool:
    """Whether two cables that have parted would run through each other."""
    if not crossing.apart:
        return False
    normal = shape.normal(crossing.support)
    (a, b), (c, d) = (
        link_at(cables[number], k)
        for number, k in zip((crossing.lower, crossing.upper), crossing.links, strict=True)
    )
    s, t = (min(max(x, 0.0), 1.0) for x in _nearest(a, b, c, d, normal))
    gap = float((c + t * (d - c) - a - s * (b - a)) @ normal)
    return gap < -DEPTH * float(np.linalg.norm(b - a))
