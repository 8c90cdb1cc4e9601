"""Contact of two cables where they cross."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from crms_fenicsx.cables.strip_positions import StripShape
from crms_fenicsx.contact.gap import apparent_crossing
from crms_fenicsx.contact.lift_off import DEPTH, PULL, link_at, outward_pulls
from crms_fenicsx.model.crossing import Crossing
from crms_fenicsx.model.laid_cable import LaidCable


def parting(
    crossings: Sequence[Crossing], cables: Sequence[LaidCable], shape: StripShape
) -> list[int]:
    """Numbers of the crossings at which the upper cable pulls the lower one up."""
    by_upper: dict[int, list[int]] = defaultdict(list)
    for number, crossing in enumerate(crossings):
        if not crossing.separated:
            by_upper[crossing.upper].append(number)
    found = []
    for c, own in by_upper.items():
        upper = cables[c]
        at = {node.crossing: k for k, node in enumerate(upper.nodes)}
        nodes = [at[number] for number in own]
        on = [n for n, k in enumerate(nodes) if not upper.lifted[k]]
        supports = [crossings[own[n]].support for n in on]
        pulls = outward_pulls(upper, [nodes[n] for n in on], *shape.normals_and_sizes(supports))
        found += [own[n] for n, pull in zip(on, pulls, strict=True) if pull > PULL]
    return found


def joins(crossing: Crossing, cables: Sequence[LaidCable], shape: StripShape) -> bool:
    """Whether two cables that have parted would run through each other."""
    if not crossing.separated:
        return False
    normal = shape.normal(crossing.support)
    (a, b), (c, d) = (
        link_at(cables[number], k)
        for number, k in zip((crossing.lower, crossing.upper), crossing.links, strict=True)
    )
    s, t = (min(max(x, 0.0), 1.0) for x in apparent_crossing(a, b, c, d, normal))
    gap = float((c + t * (d - c) - a - s * (b - a)) @ normal)
    return gap < -DEPTH * float(np.linalg.norm(b - a))
