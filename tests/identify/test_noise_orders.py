"""Orders of the noise model: what each leaves of a signal, against least squares by numpy."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.identify import levels
from trueplant.identify.noise import _left_by_order, _moments, lagged, whitened_valid


@pytest.mark.parametrize("missing", [0.0, 0.02])
def test_each_order_leaves_what_least_squares_leaves(missing: float) -> None:
    rng = np.random.default_rng(4)
    v, valid = np.cumsum(rng.standard_normal(800)), rng.random(800) >= missing
    sums = _moments([v], [valid], 12)
    left = _left_by_order(sums.gram, sums.moment, sums.power, levels.LOST**2)
    use = whitened_valid(12, valid)
    columns, now = lagged(v, 12)[use], v[12:][use]
    for order in range(13):
        errors = now - columns[:, :order] @ np.linalg.lstsq(columns[:, :order], now, rcond=None)[0]
        assert left[order] == pytest.approx(errors @ errors, rel=1e-8)


def test_lags_that_say_the_same_explain_nothing_more() -> None:
    v = np.tile([1.0, -2.0, 3.0], 100)
    sums = _moments([v], [np.ones(300, dtype=bool)], 9)
    left = _left_by_order(sums.gram, sums.moment, sums.power, levels.LOST**2)
    assert left[3:] == pytest.approx(np.zeros(7), abs=1e-8 * sums.power)
    assert np.all(np.diff(left) <= 0)
