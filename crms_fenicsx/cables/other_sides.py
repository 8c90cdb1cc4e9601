"""Other sides of vertices: paths that the string does not tell, tried by their energy.

Where the fold points of a cable are pressed against a vertex, its energy may be lower on the other
side; and a cable that others cross is not where the string says (see `retrace`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from crms_fenicsx.cables.network import BLOCKED

if TYPE_CHECKING:
    from crms_fenicsx.cables.retrace import Retracer

NEAR = 0.1
"""Part of an edge: so near to a vertex a polish tries its other side."""

HALVINGS = 2
"""How often cables that have passed vertices together, and are rejected, are tried by halves."""

GAIN = 1e-5
"""Energy, relative to the sum of all kinds, by which a round must lower it for another one. Meshes
of 64 cells a side err by a hundred times as much."""


class OtherSides:
    """What is tried in one load step, in rounds.

    In a round all cables that pass near a vertex are led around its other side at once, and if that
    is rejected each half of them, and each half of these.

    Parameters
    ----------
    paths
        The paths of the cables.
    polish
        Whether to try every vertex near which a cable passes, and not only those against which it
        is pressed.
    """

    def __init__(self, paths: Retracer, polish: bool) -> None:
        self.paths, self.near = paths, NEAR if polish else BLOCKED
        self._groups: list[tuple[int, list[tuple[int, int]]]] = []  # with how often halved
        self._energy = math.inf
        self._halved = 0

    def next(self, energy: float, scale: float) -> list[tuple[int, int]]:
        """Lead cables around the other side of vertices.

        Parameters
        ----------
        energy
            That of the state that is there (force x length).
        scale
            Sum of the sizes of all kinds of energy.

        Returns
        -------
        (cable, vertex); none where there is nothing left to try.
        """
        while near := self.paths.near_vertices(self.near):
            if not self._groups:
                if self._energy - energy < GAIN * scale:
                    break
                self._energy = energy
                self._groups = [(0, near)]
            self._halved, group = self._groups.pop()
            passed = self.paths.pass_vertices([one for one in group if one in near])
            if passed:
                return passed
        return []

    def halve(self, passed: list[tuple[int, int]]) -> bool:
        """Try the halves of what was rejected later, or never again; say whether the former."""
        half = len(passed) // 2
        if half == 0 or self._halved == HALVINGS:
            self.paths.note_passed(passed)
            return False
        self._groups += [(self._halved + 1, part) for part in (passed[half:], passed[:half])]
        return True
