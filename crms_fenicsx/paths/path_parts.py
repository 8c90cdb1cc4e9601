"""Parts of a cable's path: lifted ones, those near vertices, those at crossings."""

from __future__ import annotations

import itertools

import numpy as np

from crms_fenicsx.model.laid_cable import LaidCable
from crms_fenicsx.runtime.arrays import flags


def is_crossed(cable: LaidCable) -> bool:
    """Whether a cable is in contact with another one that crosses it.

    The surface on which geodesics are found does not have the points inside cells where cables
    press each other in. So geodesics know where cables bend to within the angles by which they do
    so there only, and propose paths on fine meshes where cables would not go.
    """
    return any(node.crossing is not None for node in cable.nodes)


def lifted_runs(cable: LaidCable) -> list[tuple[bool, range]]:
    """The parts of a path that are lifted, and those that are not: indices of their points."""
    lifted = flags(cable.lifted)
    off = [lifted[k] for k in cable.path_nodes()]
    starts = [k for k in range(len(off)) if k == 0 or off[k] != off[k - 1]]
    return [(off[a], range(a, b)) for a, b in itertools.pairwise([*starts, len(off)])]


def vertices_near(cable: LaidCable, near: float) -> set[int]:
    """Vertices near which a cable's points slide, within a part of the edge."""
    nodes, fractions = cable.nodes, cable.fractions
    beside = np.flatnonzero((np.minimum(fractions, 1 - fractions) < near) & ~cable.lifted)
    at = [(nodes[k].support, int(fractions[k] > 0.5)) for k in beside if nodes[k].slides]
    return {support[end] for support, end in at}
