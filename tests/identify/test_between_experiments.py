"""Several experiments: mean and spread against brute-force integration and by Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from trueplant.identify import levels
from trueplant.identify.between_experiments import _mixture


def test_one_parameter_is_the_posterior_of_the_random_effects_model():
    """Mean and variance over a fine grid of plant and spread, by Bayes' rule alone."""
    values, errors = np.array([1.9, 2.3, 2.05]), np.array([0.08, 0.1, 0.05])
    size = 2.0
    spread = np.linspace(0, 1, 1201)[:, None]
    plant = np.linspace(-1, 5, 3001)[None, :]
    log = -0.5 * (spread / levels.BETWEEN_RUNS) ** 2
    for value, error in zip(values, errors, strict=True):
        log = log + norm.logpdf(value, plant, np.hypot(error, spread * size))
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean = float(np.sum(weight * plant))
    variance = float(np.sum(weight * (plant - mean) ** 2))
    pooled = float(np.sum(values / errors**2) / np.sum(errors**-2.0))
    least = float(1 / np.sum(errors**-2.0))
    found = _mixture(values[:, None], (errors**2)[:, None, None], np.array([size]), np.array([True]))
    assert found.shift[0] == pytest.approx(mean - pooled, abs=0.05 * np.sqrt(variance))
    assert found.added[0, 0] == pytest.approx(variance - least, rel=0.05)
    assert found.spread[0] == pytest.approx(float(np.sum(weight * spread)), rel=0.05)


@pytest.mark.parametrize("runs", [2, 4, 6])
def test_intervals_cover_the_mean_plant_over_the_prior_of_the_spread(runs):
    """2,000 simulated sets of runs: three standard deviations of 95 % coverage by the binomial are 1.5 %."""
    rng = np.random.default_rng(runs)
    gain = np.array([True, False, False])
    truth = np.array([2.0, 10.0, 15.0])
    root = np.diag([0.03, 0.05, 0.02]) @ np.array([[1, 0, 0], [0.5, 0.9, 0], [0, 0.3, 0.95]])
    covariance = np.broadcast_to(np.outer(truth, truth) * (root @ root.T), (runs, 3, 3))
    covered = []
    for _ in range(2000):
        spreads = np.abs(rng.normal(0, levels.BETWEEN_RUNS, 2))
        relative = np.where(gain, *spreads) * rng.standard_normal((runs, 3)) + rng.standard_normal((runs, 3)) @ root.T
        theta = truth * (1 + relative)
        found = _mixture(theta, covariance, truth, gain)
        pooled = theta.mean(axis=0)
        sigma = np.sqrt(np.diag(covariance[0] / runs + found.added))
        covered.append(np.abs(pooled + found.shift - truth) < norm.ppf(0.975) * sigma)
    assert np.all(np.abs(np.mean(covered, axis=0) - 0.95) < 0.025)


def test_the_spread_grows_smoothly_with_the_difference():
    """Runs that differ by three standard errors and runs that differ by none are treated by one formula."""
    covariance = np.broadcast_to(np.eye(1) * 1e-4, (2, 1, 1))
    added = [
        float(_mixture(np.array([[1.0], [1.0 + d]]), covariance, np.ones(1), np.array([True])).added[0, 0])
        for d in np.linspace(0, 0.2, 41)
    ]
    steps = np.diff(added)
    assert np.all(steps > -1e-6) and np.max(steps) < 0.1 * added[-1]
