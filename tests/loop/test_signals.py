"""Generated set-points and disturbances have the statistics that they are declared with."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import LoopError
from trueplant.loop import alternating_steps, ar1, arma, drift, random_steps, step_disturbance


def test_random_steps_switch_at_the_declared_mean_interval():
    r = random_steps(200_000, 1.0, 20.0, [1.0, 2.5], seed=1)
    assert set(np.unique(r[:, 0])) == {-1.0, 1.0}
    assert set(np.unique(r[:, 1])) == {-2.5, 2.5}
    changes = np.sum(np.diff(r, axis=0) != 0, axis=0)
    # Poisson: 10000 expected, standard deviation 100; a second change in one sample is not seen (2.5 %)
    assert np.all(np.abs(changes - 200_000 * -np.expm1(-1 / 20)) < 400)
    assert abs(np.corrcoef(r.T)[0, 1]) < 0.05
    assert np.array_equal(r, random_steps(200_000, 1.0, 20.0, [1.0, 2.5], seed=1))


def test_alternating_steps_move_one_channel_at_a_time():
    r = alternating_steps(100, 0.1, 2.0, [1.0, 3.0])
    assert np.all(r[:20] == 0)
    assert np.array_equal(np.unique(r[20:40], axis=0), [[1.0, 0.0]])
    assert np.all(r[40:60] == 0)
    assert np.array_equal(np.unique(r[60:80], axis=0), [[0.0, 3.0]])
    assert np.all(np.count_nonzero(r, axis=1) <= 1)


def test_step_disturbance_begins_on_its_sample():
    v = step_disturbance(10, 0.1, 0.3, [2.0, -1.0])
    assert np.array_equal(np.flatnonzero(v[:, 0]), np.arange(3, 10))
    assert np.all(v[3:, 1] == -1.0)


def test_ar1_has_its_deviation_and_correlation_from_the_first_sample_on():
    many = np.concatenate([ar1(40, 0.5, 3.0, 0.7, seed)[None, :, 0] for seed in range(4000)])
    assert np.std(many[:, 0]) == pytest.approx(0.7, rel=0.05)
    assert np.std(many[:, -1]) == pytest.approx(0.7, rel=0.05)
    assert np.corrcoef(many[:, 0], many[:, 6])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.05)


def test_arma_has_its_deviation_and_first_correlation():
    v = arma(400_000, [1.0, 0.5], [1.0, -0.85], [2.0], seed=5)[:, 0]
    # variance (1 + 2 a c + c^2)/(1 - a^2), first covariance (a + c)(1 + a c)/(1 - a^2), with pole a
    a, c = 0.85, 0.5
    assert np.std(v) == pytest.approx(2.0, rel=0.02)
    assert np.corrcoef(v[1:], v[:-1])[0, 1] == pytest.approx((a + c) * (1 + a * c) / (1 + 2 * a * c + c * c), abs=0.01)


def test_drift_spreads_with_the_square_root_of_time():
    ends = [drift(401, 0.25, 0.3, seed)[-1, 0] for seed in range(3000)]
    assert np.std(ends) == pytest.approx(0.3 * np.sqrt(100.0), rel=0.05)
    assert drift(5, 0.25, 0.3, 1)[0, 0] == 0.0


def test_signals_that_cannot_be_are_named():
    with pytest.raises(LoopError, match="stationary"):
        arma(10, [1.0], [1.0, -1.0], 1.0, seed=0)
    with pytest.raises(LoopError, match="mean_interval"):
        random_steps(10, 1.0, 0.5, 1.0, seed=0)
    with pytest.raises(LoopError, match="time_constant"):
        ar1(10, 1.0, 0.0, 1.0, seed=0)
    with pytest.raises(LoopError, match="interval"):
        alternating_steps(10, 1.0, 0.5, 1.0)
