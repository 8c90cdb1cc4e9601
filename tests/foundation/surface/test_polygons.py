"""Polygons cut along chords and split into facets, against loops."""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations

import numpy as np
from polygon_twins import facets_of, split_cells, split_slowly


def cut_cells(seed: int) -> tuple[list[list[int]], list[list[list[int]]]]:
    """Polygons with up to four chords: some cross, lie along sides or end inside or elsewhere."""
    rng = np.random.default_rng(seed)
    rims, chords = [], []
    for n in rng.integers(3, 12, 40).tolist():
        numbers = rng.permutation(100)
        rim, inside = numbers[:n].tolist(), numbers[n:].tolist()
        own: list[list[int]] = []
        for _ in range(rng.integers(0, 5)):
            ends = rng.choice(n, 2, replace=False)
            own.append([rim[k] for k in ends])
        for one, other in combinations(own, 2):  # wherever it is: a point that both have
            if rng.random() < 0.5:
                shared = inside.pop()
                for chord in (one, other):
                    chord.insert(int(rng.integers(1, len(chord))), shared)
        if own and rng.random() < 0.3:
            own[-1][0] = inside.pop()
        rims.append(rim)
        chords.append(own)
    return rims, chords


def test_cells_are_cut_as_one_after_the_other() -> None:
    parts = 0
    for seed in range(20):
        rims, chords = cut_cells(seed)
        found = split_cells(rims, chords)
        assert found == [split_slowly(*cell) for cell in zip(rims, chords, strict=True)]
        parts += sum(map(len, found))
    assert parts > 1500


def test_facets_are_those_of_the_fans() -> None:
    rng = np.random.default_rng(3)
    polygons = [rng.permutation(20)[:n].tolist() for n in rng.integers(3, 9, 30).tolist()]
    facets, weights = facets_of(polygons)
    rows = zip(facets.tolist(), weights.tolist(), strict=True)
    found = [(tuple(sorted(facet)), weight) for facet, weight in rows]
    expected: list[tuple[tuple[int, ...], float]] = []
    for polygon in polygons:
        n, own = len(polygon), defaultdict(float)
        for k in range(n):
            ring = polygon[k:] + polygon[:k]
            for i in range(1, n - 1):
                own[tuple(sorted((ring[0], ring[i], ring[i + 1])))] += 1 / n
        expected += own.items()
        count = len(own)
        assert sorted(found[:count]) == sorted(own.items())
        del found[:count]
    assert not found and len(expected) == len(facets)
