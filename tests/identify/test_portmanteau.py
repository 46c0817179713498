"""Errors against the past of a signal where both have outliers. All numbers are drawn, each with its seed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from trueplant.identify.autoregression import Lags
from trueplant.identify.portmanteau import correlogram, normal_scores, relation_beyond

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


def test_what_groups_of_lags_explain_is_what_they_take_off_the_squares():
    """By least squares on the single lags, with and without the groups, of two records with gaps."""
    rng = np.random.default_rng(2)
    lags, explained = Lags(5, 6), []
    errors = [np.where(rng.random(n) < 0.05, np.nan, rng.standard_normal(n)) for n in (300, 200, 10)]
    past = [rng.standard_normal(e.size) for e in errors]
    rows, now = [], []
    for e, x in zip(errors[:2], past[:2], strict=True):
        parts = zip(lags.starts, lags.ends, strict=True)
        columns = [sum(x[lags.reach - lag : x.size - lag] for lag in range(first, last + 1)) for first, last in parts]
        there = np.isfinite(e[lags.reach :])
        rows.append(np.column_stack(columns)[there])
        now.append(e[lags.reach :][there])
    whole, y = np.vstack(rows), np.concatenate(now)
    for columns in (whole[:, :5], whole):
        explained.append(y @ y - np.sum((y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) ** 2))
    found = relation_beyond(errors, past, lags)
    assert found.freedom == 6
    assert found.statistic == pytest.approx((explained[1] - explained[0]) / (y @ y / y.size), rel=1e-8)


def test_without_relation_it_is_chi_square():
    rng = np.random.default_rng(3)
    lags = Lags(25, 8)

    def p(e, x):
        return correlogram([e], 25, [x]).p_value(beyond=relation_beyond([e], [x], lags))

    found = [p(rng.standard_normal(2000), rng.standard_normal(2000)) for _ in range(400)]
    assert kstest(found, "uniform").pvalue > 0.01


def test_what_answers_after_many_samples_is_seen_by_groups_of_them():
    """A response that begins 200 samples late and takes 300: a hundredth of the variance of 6,000 errors."""
    rng, late = np.random.default_rng(4), np.zeros(500)
    late[200:] = np.exp(-np.arange(300) / 100) / 75
    near, far = [], []
    for _ in range(50):
        x = rng.standard_normal(6000)
        e = rng.standard_normal(6000) + np.convolve(x, late)[:6000]
        correlations = correlogram([e], LAGS, [x])
        near.append(correlations.p_value())
        far.append(correlations.p_value(beyond=relation_beyond([e], [x], Lags(25, 14))))
    assert np.mean(np.array(near) < 0.05) < 0.2
    assert np.mean(np.array(far) < 0.05) > 0.8


def test_nothing_is_said_of_no_groups_and_of_what_does_not_move():
    e, x = np.random.default_rng(5).standard_normal(100), np.zeros(100)
    assert relation_beyond([e], [x], Lags(25)) == relation_beyond([e], [x], Lags(5, 5)) == (0.0, 0)
