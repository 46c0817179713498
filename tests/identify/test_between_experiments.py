"""Several experiments: mean and spread against brute-force integration and by Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import identify_matrix, levels, specs_of
from trueplant.identify.between_experiments import _mixture
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix


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
    found = _mixture(values[:, None], (errors**2)[:, None, None], np.array([pooled]), np.array([size]), np.array([0]))
    assert found.shift[0] == pytest.approx(mean - pooled, abs=0.05 * np.sqrt(variance))
    assert found.added[0, 0] == pytest.approx(variance - least, rel=0.05)
    assert found.spread[0] == pytest.approx(float(np.sum(weight * spread)), rel=0.05)


@pytest.mark.parametrize("runs", [2, 4, 6])
def test_intervals_cover_the_mean_plant_over_the_prior_of_the_spread(runs):
    """2,000 simulated sets of runs: three standard deviations of 95 % coverage by the binomial are 1.5 %."""
    rng = np.random.default_rng(runs)
    kinds = np.array([0, 1, 2])
    truth = np.array([2.0, 10.0, 15.0])
    root = np.diag([0.03, 0.05, 0.02]) @ np.array([[1, 0, 0], [0.5, 0.9, 0], [0, 0.3, 0.95]])
    covariance = np.broadcast_to(np.outer(truth, truth) * (root @ root.T), (runs, 3, 3))
    covered = []
    for _ in range(2000):
        spreads = np.abs(rng.normal(0, levels.BETWEEN_RUNS, 3))
        relative = spreads * rng.standard_normal((runs, 3)) + rng.standard_normal((runs, 3)) @ root.T
        theta = truth * (1 + relative)
        pooled = theta.mean(axis=0)
        found = _mixture(theta, covariance, pooled, truth, kinds)
        sigma = np.sqrt(np.diag(covariance[0] / runs + found.added))
        covered.append(np.abs(pooled + found.shift - truth) < norm.ppf(0.975) * sigma)
    assert np.all(np.abs(np.mean(covered, axis=0) - 0.95) < 0.025)


def test_the_spread_grows_smoothly_with_the_difference():
    """Runs that differ by three standard errors and runs that differ by none are treated by one formula."""
    covariance = np.broadcast_to(np.eye(1) * 1e-4, (2, 1, 1))
    added = [
        float(_mixture(np.array([[1.0], [1.0 + d]]), covariance, np.ones(1), np.ones(1), np.array([0])).added[0, 0])
        for d in np.linspace(0, 0.2, 41)
    ]
    steps = np.diff(added)
    assert np.all(steps > -1e-6) and np.max(steps) < 0.1 * added[-1]


@pytest.mark.parametrize(("apart", "error", "share"), [(0.0, 0.5, 1.0), (0.5, 0.02, 0.0)])
def test_the_pooled_estimate_counts_where_runs_agree_and_not_where_they_are_far_apart(apart, error, share):
    """A fit of one plant to runs of several may end anywhere: here a standard error of the runs' mean above it."""
    theta = np.array([[1.0 - apart], [1.0 + apart], [1.0]])
    covariance = np.full((3, 1, 1), error**2)
    pooled = 1.0 + error / np.sqrt(3)
    found = _mixture(theta, covariance, np.array([pooled]), np.ones(1), np.array([0]))
    taken = (pooled + found.shift[0] - 1.0) / (pooled - 1.0)
    assert taken == pytest.approx(share, abs=0.05)


def test_runs_whose_dead_times_are_far_apart_are_found_each():
    """From the dead time between them, the search of neither run comes to its own."""
    own = (0.6, 7.5)
    records = []
    for k, dead in enumerate(own):
        rng = np.random.default_rng(k)
        plant = TransferMatrix.of([[f"2 exp(-{dead} s)/(8 s + 1)"]], "min")
        law = Controller.diagonal([PID(Kc=0.4, Ti=8.0, sample_time=1.0)])
        v = coloured(rng, 800, 1, [1, -0.8], [1], 0.2)
        records.append(segment_of(simulate(plant, law, random_switching(rng, 800, 1, 40.0), 1.0, v=v), experiment=k))
    model = TransferMatrix.of([["2 exp(-4 s)/(8 s + 1)"]], "min")
    runs = identify_matrix(records, model, specs_of(model))[0].runs
    assert runs is not None and not runs.agree
    for theta, covariance, dead in zip(runs.theta, runs.covariance, own, strict=True):
        assert np.all(np.abs(theta - [2.0, 8.0, dead]) < 4 * np.sqrt(np.diag(covariance)))
