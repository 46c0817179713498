"""Errors against the past of a signal where both have outliers. All numbers are drawn, each with its seed."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.identify.portmanteau import correlogram, normal_scores

LAGS = 25
LEVEL = 1e-3


def p_value(e, x):
    return correlogram(normal_scores([e]), LAGS, [x]).p_value()


def with_outliers(rng, n):
    return rng.standard_normal(n) * np.where(rng.random(n) < 0.01, 10, 1)


def test_outliers_that_meet_are_no_relation():
    rng = np.random.default_rng(0)
    pairs = [(with_outliers(rng, 1500), with_outliers(rng, 1500)) for _ in range(2000)]
    assert sum(p_value(e, x) < LEVEL for e, x in pairs) <= 6  # 2 expected
    as_they_are = [correlogram([e], LAGS, [x]).p_value() for e, x in pairs]
    assert sum(p < LEVEL for p in as_they_are) > 20


@pytest.mark.parametrize(("size", "seen"), [(1.0, 0.8), (1.5, 0.98)])
def test_what_follows_rare_steps_is_seen(size, seen):
    rng = np.random.default_rng(1)
    x = np.diff(np.sign(np.sin(np.arange(1500) / 40)), prepend=0.0)
    after = np.convolve(x, np.concatenate([[0.0], np.exp(-np.arange(15) / 8)]))[:1500] * size
    found = [p_value(after / 2 + rng.standard_normal(1500), x) < LEVEL for _ in range(200)]
    assert np.mean(found) > seen


def test_scores_keep_order_gaps_and_pieces():
    one, other = normal_scores([np.array([3.0, np.nan, 100.0]), np.array([-2.0, 3.0])])
    assert np.isnan(one[1]) and one.size == 3 and other.size == 2
    assert other[0] < one[0] == other[1] < one[2]
    assert one[2] == pytest.approx(-other[0])
