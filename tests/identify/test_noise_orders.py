"""Orders of the noise model: what each leaves of a signal, against least squares by numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trueplant.identify import levels, noise
from trueplant.identify.autoregression import Lags, bridge, furthest, whitened_valid
from trueplant.identify.noise import _left_by_order, _moments, _sums_of, fit_autoregression, lagged

Array = np.ndarray


def walk(missing: float) -> tuple[Array, Array]:
    rng = np.random.default_rng(4)
    return np.cumsum(rng.standard_normal(800)), rng.random(800) >= missing


def by_coefficient(v: Array, lags: Lags, reach: int) -> Array:
    """(n - reach, order) what each coefficient multiplies, lag by lag."""
    each = lagged(v, reach)
    parts = zip(lags.starts, lags.ends, strict=True)
    return np.column_stack([np.zeros((len(each), 0)), *(each[:, a - 1 : b].sum(axis=1) for a, b in parts)])


@pytest.mark.parametrize("missing", [0.0, 0.02])
def test_each_order_leaves_what_least_squares_leaves(missing: float) -> None:
    v, valid = walk(missing)
    sums = _moments([v], [valid], Lags(12))
    left = _left_by_order(sums.gram, sums.moment, sums.power, levels.LOST**2)
    use = whitened_valid(12, valid)
    columns, now = lagged(v, 12)[use], v[12:][use]
    for order in range(13):
        errors = now - columns[:, :order] @ np.linalg.lstsq(columns[:, :order], now, rcond=None)[0]
        assert left[order] == pytest.approx(errors @ errors, rel=1e-8)


@pytest.mark.parametrize("chunk", [16_384, 100])
@pytest.mark.parametrize("single", [12, 10, 3, 0])
@pytest.mark.parametrize("missing", [0.0, 0.005])
def test_each_number_of_groups_leaves_what_least_squares_leaves(
    missing: float, single: int, chunk: int, monkeypatch: Any
) -> None:
    """By the sums of the finest groups alone, of two records, one of which is the shorter by a gap."""
    monkeypatch.setattr(noise, "CHUNK", chunk)
    v, valid = walk(missing)
    parts, reach = [slice(0, 500), slice(510, 800)], 60
    most, lags = furthest(12, reach), furthest(single, reach)
    signals, measured = [v[part] for part in parts], [valid[part] for part in parts]
    sums = _moments(signals, measured, most)
    uses = [most.predicted(ok, most.reach) for ok in measured]
    filled = [bridge(x, ok) for x, ok in zip(signals, measured, strict=True)]
    seen = [by_coefficient(x, lags, most.reach)[use] for x, use in zip(filled, uses, strict=True)]
    now = np.concatenate([x[most.reach :][use] for x, use in zip(signals, uses, strict=True)])
    columns, own = np.vstack(seen), sums.of(_sums_of(most, lags))
    left = _left_by_order(own.gram, own.moment, own.power, levels.LOST**2)
    assert sums.count == now.size > 100 and left.size == lags.order + 1 > 10
    for order in range(lags.order + 1):
        errors = now - columns[:, :order] @ np.linalg.lstsq(columns[:, :order], now, rcond=None)[0]
        assert left[order] == pytest.approx(errors @ errors, rel=1e-7)


@pytest.mark.parametrize("lags", [Lags(), Lags(4), Lags(3, 6), Lags(0, 15)])
def test_coefficients_are_those_of_least_squares(lags: Lags) -> None:
    v, valid = walk(0.005)
    use = lags.predicted(valid, lags.reach)
    columns, now = by_coefficient(bridge(v, valid), lags, lags.reach)[use], v[lags.reach :][use]
    found = fit_autoregression([v], [valid], lags)
    assert found.lags == lags
    assert found.coefficients == pytest.approx(-np.linalg.lstsq(columns, now, rcond=None)[0], rel=1e-5, abs=1e-7)


def test_lags_that_say_the_same_explain_nothing_more() -> None:
    v = np.tile([1.0, -2.0, 3.0], 100)
    sums = _moments([v], [np.ones(300, dtype=bool)], Lags(9))
    left = _left_by_order(sums.gram, sums.moment, sums.power, levels.LOST**2)
    assert left[3:] == pytest.approx(np.zeros(7), abs=1e-8 * sums.power)
    assert np.all(np.diff(left) <= 0)
