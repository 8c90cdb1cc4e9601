"""Contact of cables side by side as a function of places: derivatives, balance, a slow twin."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from taylor import TermOnPoints, gradient_order, noise, stiffness_error

from crms_fenicsx.energy.terms.side_contact import Facing, SideContact

Array = npt.NDArray[Any]


class Exact(TermOnPoints):
    """The same with exact second derivatives."""

    def matrix(self, x: Array) -> Array:
        self.term.add_stiffness = self.term.add_hessian
        return super().matrix(x)


def facing(least: float = 0.6) -> tuple[Facing, Array]:
    """Two bent rows of four vertices, every one facing the whole other row: within a segment, at a
    corner, and beyond the end."""
    t = np.arange(4.0)
    one = np.stack([t, 0.1 * np.sin(2 * t), 0.05 * t**2], axis=1)
    other = np.stack([0.9 * t + 0.3, 0.4 + 0.05 * np.cos(3 * t), 0.1 - 0.05 * t], axis=1)
    rows = [[v, 4, 5, 6, 7] for v in range(4)] + [[v, 0, 1, 2, 3] for v in range(4, 8)]
    blocks = np.array(rows, dtype=np.int32)
    pointers = np.arange(0, 41, 5, dtype=np.int32)
    stiffness = np.linspace(20.0, 60.0, 8)
    return Facing(pointers, blocks.ravel(), np.full(8, least), stiffness), np.append(one, other, 0)


def slow_energy(table: Facing, x: Array) -> float:
    """By a search along Hermite's cubics, whose slopes are those of the chords beside."""
    total, s = 0.0, np.linspace(0.0, 1.0, 100001)[:, None]
    for e, (k, D) in enumerate(zip(table.stiffness, table.least, strict=True)):
        v, *chain = table.blocks[table.pointers[e] : table.pointers[e + 1]]
        P, d = x[chain], np.inf
        slopes = np.concatenate([P[1:2] - P[:1], (P[2:] - P[:-2]) / 2, P[-1:] - P[-2:-1]])
        for a, b, u, w in zip(P[:-1], P[1:], slopes[:-1], slopes[1:], strict=True):
            rise = s * s * (3 - 2 * s)
            curve = a + rise * (b - a) + s * (1 - s) ** 2 * u - s * s * (1 - s) * w
            d = min(d, np.linalg.norm(x[v] - curve, axis=1).min())
        total += 0.5 * k * max(D - d, 0.0) ** 2
    return total


def test_energy() -> None:
    table, X = facing()
    f = TermOnPoints(SideContact(table), X)
    for seed in range(4):
        x = 0.05 * noise(X, seed)
        energy = f.value(x)[0]
        assert energy > 0.1
        assert energy == pytest.approx(slow_energy(table, X + x), rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_derivatives(seed: int) -> None:
    """To second order, with contact within segments and at ends, and without."""
    table, X = facing()
    f = Exact(SideContact(table), X)
    x, d = 0.05 * noise(X, seed), noise(X, seed + 50)
    f.value(x)
    ends = np.isinf(f.term._ways[f.term._force > 0.0, 2, 0])
    assert ends.any() and not ends.all()
    assert gradient_order(f, x, d) == pytest.approx(2.0, abs=0.1)
    assert stiffness_error(f, x, d, 1e-6) < 1e-8
    K = f.matrix(x)
    assert np.abs(K - K.T).max() <= 1e-12 * np.abs(K).max()


def test_stiffness_is_semidefinite() -> None:
    table, X = facing()
    K = TermOnPoints(SideContact(table), X).matrix(np.zeros_like(X))
    assert np.linalg.eigvalsh(K).min() >= -1e-12 * np.abs(K).max()
    assert np.abs(K).max() > 1.0


def test_forces_balance() -> None:
    """Their sums and moments vanish, and no force acts beyond the least distance."""
    table, X = facing()
    g = TermOnPoints(SideContact(table), X).value(np.zeros_like(X))[1]
    assert np.abs(g).max() > 1.0
    assert np.abs(g.sum(axis=0)).max() < 1e-13 * np.abs(g).sum()
    assert np.abs(np.cross(X, g).sum(axis=0)).max() < 1e-13 * np.abs(g).sum()
    apart, X = facing(0.1)
    energy, g = TermOnPoints(SideContact(apart), X).value(np.zeros_like(X))
    assert energy == 0.0 and not g.any()


def test_parts_of_a_table() -> None:
    """Terms of some elements add up to the whole."""
    table, X = facing()
    chosen = np.zeros(8, dtype=bool)
    chosen[:2] = True
    whole = SideContact(table)
    some = whole.elements_on(chosen)
    assert isinstance(some, Facing) and len(some.least) == 6  # two vertices and what faces them
    rest = table.some(np.setdiff1d(np.arange(8), table.rows_on(chosen)))
    x = 0.05 * noise(X, 1)
    parts = [TermOnPoints(SideContact(t), X).value(x) for t in (some, rest)]
    energy, g = TermOnPoints(whole, X).value(x)
    assert energy == pytest.approx(parts[0][0] + parts[1][0], rel=1e-14)
    assert np.allclose(g, parts[0][1] + parts[1][1], rtol=0, atol=1e-13 * np.abs(g).max())
