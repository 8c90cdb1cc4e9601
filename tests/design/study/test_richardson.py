"""Limits and error bars of sequences whose limits are known."""

import math

import numpy as np
import pytest

from crms_fenicsx.design.study.convergence import extrapolated


def levels(limit, *parts, n=3):
    """Values with errors c h^p of the parts (c, p)."""
    h = 0.5 ** np.arange(n)
    return list(limit + sum(c * h**p for c, p in parts))


@pytest.mark.parametrize("limit", [-3.0, 0.0, 250.0])
@pytest.mark.parametrize("c", [-7.0, 0.02])
def test_order_2_is_extrapolated_exactly(limit, c):
    found = extrapolated(levels(limit, (c, 2.0)), size=100.0)
    assert found.regular
    assert found.order == pytest.approx(2.0, abs=1e-6)
    assert found.limit == pytest.approx(limit, abs=1e-9 * max(abs(limit), 1.0))
    finest = abs(c) / 16
    assert found.bar == pytest.approx(1.25 * finest, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("p", [1.3, 1.6, 2.4, 2.9])
def test_bars_hold_the_limit_of_other_orders(p):
    found = extrapolated(levels(100.0, (10.0, p)))
    assert found.regular
    assert found.order == pytest.approx(p)
    assert abs(found.limit - 100.0) <= found.bar < 20 * abs(found.limit - 100.0)


def test_other_orders_have_another_factor_of_safety():
    for p, factor in ((1.6, 3.0), (1.8, 1.25), (2.2, 1.25), (2.4, 3.0)):
        values = levels(100.0, (10.0, p))
        error = abs(values[-1] - values[-2]) / (2.0 ** min(p, 2.0) - 1.0)
        assert extrapolated(values).bar == pytest.approx(factor * error)


@pytest.mark.parametrize("second", [-1.5, -0.5, 0.5, 1.5])
def test_bars_hold_the_limit_of_two_orders(second):
    found = extrapolated(levels(10.0, (1.0, 2.0), (second, 3.0)))
    assert abs(found.limit - 10.0) <= found.bar


def test_scatter_has_a_bar_as_wide_as_itself():
    found = extrapolated([1.0, 1.3, 1.1])
    assert (found.limit, found.regular) == (1.1, False)
    assert found.bar == pytest.approx(0.2)
    assert math.isnan(found.order)
    assert "oscillate" in found.remark


def test_growing_differences_are_told():
    found = extrapolated([1.0, 1.1, 1.4])
    assert not found.regular
    assert found.bar == pytest.approx(0.4)
    assert "grow" in found.remark


def test_slow_convergence_is_no_order_2():
    found = extrapolated(levels(1.0, (1.0, 0.8)))
    assert not found.regular
    assert found.order == pytest.approx(0.8)
    assert abs(found.limit - 1.0) <= 1.2 * found.bar
    assert found.remark == "low order"


def test_coarsest_level_far_off_does_not_make_the_bar_small():
    """The second difference is near zero by chance."""
    found = extrapolated([8.0, 13.73, 13.77])
    assert not found.regular
    assert found.bar > 0.5


def test_first_mesh_far_off_shows_no_order():
    found = extrapolated(levels(1.0, (-0.9, 2.0)))
    assert not found.regular
    assert found.bar == pytest.approx(0.9 * 3 / 16)
    assert found.remark == "the coarsest is too coarse"


def test_two_levels_count_all_of_their_difference():
    found = extrapolated([3.0, 2.7])
    assert found.limit == pytest.approx(2.6)
    assert found.bar == pytest.approx(0.3)
    assert not found.regular


def test_rounding_is_no_convergence():
    """Components that are zero by symmetry, beside others of their vector."""
    found = extrapolated([1e-13, -3e-12, 2e-13], size=5.0)
    assert found.regular
    assert found.bar == pytest.approx(5e-7)
    assert found.remark == "the same on all levels"


def test_later_levels_count() -> None:
    rough, regular = [13.0, 10.5], levels(8.0, (1.0, 2.0))
    found, later = extrapolated(rough + regular), extrapolated(regular, size=13.0)
    assert (found.limit, found.bar, found.order) == (later.limit, later.bar, later.order)


@pytest.mark.parametrize("last", [(0.02, 0.005), (0.02, -0.001), (1e-9, 1e-9)])
def test_levels_that_went_to_and_fro_are_remembered(last: tuple[float, float]) -> None:
    """The last two differences are small by chance, or look like order 2, or like nothing."""
    found = extrapolated([*np.cumsum([5.0, 0.8, -0.6, *last])])
    assert not found.regular
    assert found.bar == pytest.approx(0.6 / 4**2)
    assert "oscillate" in found.remark or found.remark == "no order: differences grow"


@pytest.mark.parametrize(("smooth", "n", "due"), [(0.0, 3, 0.94), (0.0, 5, 0.98), (1.0, 4, 0.97)])
def test_bars_hold_limits_of_values_that_scatter(smooth: float, n: int, due: float) -> None:
    """Errors that are h^2 times a random number on each level, and a regular part."""
    rng, held, trials = np.random.default_rng(0), 0, 2000
    h = 0.5 ** np.arange(n)
    for part in rng.uniform(-1.0, 1.0, (trials, n)):
        found = extrapolated(list(100.0 + h**2 * (part + smooth)))
        held += abs(found.limit - 100.0) <= found.bar
    assert held > due * trials


@pytest.mark.parametrize(
    "values", [(1.0, 1.01, 1.1), (1.0, 1.02, 1.01)], ids=["grow", "oscillating"]
)
def test_values_of_several_equilibria_have_a_wide_bar(values: tuple[float, ...]) -> None:
    """Three times their range, about the finest; where they have an order nothing changes."""
    found = extrapolated(values, scattered=True)
    assert found.limit == values[-1]
    assert found.bar == pytest.approx(3 * (max(values) - min(values)))
    assert "several equilibria" in found.remark
    regular = levels(100.0, (10.0, 2.0))
    assert extrapolated(regular, scattered=True) == extrapolated(regular)
