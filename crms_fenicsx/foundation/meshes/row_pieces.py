"""Vertices spread along pieces of rows, all pieces at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from crms_fenicsx.foundation.meshes.triangles import dot, norm
from crms_fenicsx.foundation.runtime.arrays import Array, Booleans, Integers, ints, pointers

Between = tuple[Integers, Array, Integers, Integers, Array]
"""Points (k,) and their places (k, 3), the points between whose former places they are, and the
weights (k,) of the second ones of these."""


class RowPieces:
    """Lines of points (m, 3) which keep their ends, and between these the proportions of their
    first places."""

    def __init__(self, pieces: Sequence[Integers], first: Array, least: Array) -> None:
        """Lines of three or more points by their numbers; their first places (m, 3), and lengths
        (m,) by which no point moves."""
        self.points = np.concatenate([np.zeros(0, dtype=np.int64), *pieces])
        counts = np.array([len(piece) for piece in pieces], dtype=np.int64)
        self._starts, self._least = pointers(counts), least[self.points]
        self._of = np.repeat(np.arange(len(pieces)), counts)
        every = np.arange(len(self.points))
        self._shares, _ = self._arcs(first[self.points], every)
        self._sharp: Booleans = np.zeros(len(every), dtype=bool)
        self._sharp = self._turned(first[self.points])

    def spread(self, places: Array, onto: Callable[[Integers, Array], Array]) -> Between:
        """Where the points of pieces that have lost their proportions come to lie so that they have
        them again, on a surface onto which a function takes points (k,) from places (k, 3) in
        between their former ones (m, 3)."""
        line = places[self.points]
        kept = np.flatnonzero(self._kept(line))
        known, total = self._arcs(line[kept], kept)
        change = np.ones(len(line), dtype=bool)
        change[kept] = np.abs(known - self._shares[kept]) * total[kept] > self._least[kept]
        changed = np.zeros(len(self._starts) - 1, dtype=bool)
        changed[self._of[change]] = True
        inner = np.flatnonzero(changed[self._of])
        inner = inner[(self._shares[inner] > 0.0) & (self._shares[inner] < 1.0)]
        arcs, every, new = self._shares.copy(), np.arange(len(line)), line.copy()
        for last in (*9 * (False,), True):
            k, weights = self._within(arcs, known, kept)
            before, after = kept[k[inner]], kept[k[inner] + 1]
            new[inner] = onto(self.points[inner], mixed(line, before, after, weights[inner]))
            chords, total = self._arcs(new, every)
            off = np.abs(chords - self._shares) * total > self._least
            if last or not off[inner].any():
                break
            k, weights = self._within(self._shares, chords, every)
            arcs = (1.0 - weights) * arcs[k] + weights * arcs[k + 1]
        points = self.points
        return points[inner], new[inner], points[before], points[after], weights[inner]

    def _within(self, wanted: Array, known: Array, points: Integers) -> tuple[Integers, Array]:
        """For all points, those of some (k,) before them, by arc lengths as shares of the piece's,
        and their weights between these and the next ones."""
        ends = self._of[points]
        k = np.searchsorted(2 * ends + known, 2 * self._of + wanted, side="right") - 1
        first = np.searchsorted(ends, self._of)
        last = np.searchsorted(ends, self._of, side="right") - 2
        k = np.clip(k, first, last)
        step = known[k + 1] - known[k]
        return k, (wanted - known[k]) / np.where(step > 0.0, step, 1.0)

    def _arcs(self, places: Array, points: Integers) -> tuple[Array, Array]:
        """Arc lengths of points at places (k, 3) as shares of their pieces', and these for all."""
        of, column = self._of[points], points - self._starts[self._of[points]]
        steps = np.zeros((len(self._starts) - 1, np.diff(self._starts).max(initial=0)))
        same = of[1:] == of[:-1]
        steps[of[1:][same], column[1:][same]] = norm(np.diff(places, axis=0))[same]
        arcs = np.cumsum(steps, axis=1)
        total = arcs[:, -1] if len(arcs) else np.zeros(0)
        size = np.where(total > 0.0, total, 1.0)
        return arcs[of, column] / size[of], total[self._of]

    def _turned(self, places: Array) -> Booleans:
        """Whether each inner point is a turn of more than a right angle that it was not at first,
        as an end that has moved along its piece makes it."""
        steps = np.diff(places, axis=0)
        turned = np.zeros(len(places), dtype=bool)
        turned[1:-1] = dot(steps[1:], steps[:-1]) < 0.0
        turned[self._starts[:-1]] = turned[self._starts[1:] - 1] = False
        return turned & ~self._sharp

    def _kept(self, places: Array) -> Booleans:
        """Whether each point lies before the ends of its piece, which may have moved along it."""
        kept, turned = np.ones(len(places), dtype=bool), self._turned(places)
        beside = turned[self._starts[:-1] + 1] | turned[self._starts[1:] - 2]
        for piece in ints(np.flatnonzero(beside)):
            points = list(range(self._starts[piece], self._starts[piece + 1]))
            for _ in range(2):  # from either end
                while len(points) > 2 and not self._sharp[points[1]]:
                    steps = np.diff(places[points[:3]], axis=0)
                    if dot(steps[0], steps[1]) >= 0.0:
                        break
                    kept[points.pop(1)] = False
                points.reverse()
        return kept


def mixed(places: Array, before: Integers, after: Integers, weights: Array) -> Array:
    """Places (k, 3) between others, by the weights (k,) of the second ones."""
    w = weights[:, None]
    return np.asarray((1.0 - w) * places[before] + w * places[after])
