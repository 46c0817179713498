"""Short records: dead times that nobody declared, noise that the fit takes along. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from simulated import random_switching, segment_of
from trueplant.identify import Spec, identify_output
from trueplant.identify.small import inflation
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import Structure

FOPDT = Structure.parse("fopdt")
LAW = Controller.diagonal([PID(Kc=0.5, Ti=10.0, sample_time=1.0)])


def estimated(plant: str, start: tuple[float, float, float], seed: int, samples: int = 1500, std: float = 0.05):
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, 1, 30.0)
    noise = std * rng.standard_normal((samples, 1))
    record = simulate(TransferMatrix.of([[plant]], "min"), LAW, r, 1.0, noise=noise)
    return identify_output([segment_of(record)], 0, [Spec(0, FOPDT, start)])


def test_no_dead_time_is_read_into_a_record_that_shows_none():
    """Of 12 records one in twenty would show one by chance."""
    dead = np.array([estimated("2/(12 s + 1)", (1.6, 15.0, 0.0), seed).theta[2] for seed in range(12)])
    assert np.sum(dead > 0) <= 2


def test_its_interval_still_says_how_large_it_could_be():
    estimate = estimated("2/(12 s + 1)", (1.6, 15.0, 0.0), 3)
    assert estimate.theta[2] == 0
    low, high = estimate.intervals[2]
    assert low == 0 and 0 < high < 1


def test_a_dead_time_that_the_record_shows_is_found_although_the_model_has_none():
    estimate = estimated("2 exp(-2.3 s)/(12 s + 1)", (1.6, 15.0, 0.0), 4)
    assert estimate.theta[2] == pytest.approx(2.3, abs=4 * np.sqrt(estimate.covariance[2, 2]))
    assert estimate.intervals[2, 0] > 0


def test_a_declared_dead_time_is_always_estimated():
    assert estimated("2/(12 s + 1)", (1.6, 15.0, 0.5), 5).fit.free.all()


def test_slow_noise_widens_more_than_fast_noise_and_short_records_more_than_long_ones():
    rng = np.random.default_rng(0)
    short, long = (estimated("2/(12 s + 1)", (1.6, 15.0, 0.0), 6, n).fit for n in (300, 6000))
    assert 1 < inflation(long, 0.95) < 1.01 < inflation(short, 0.95) < 1.2
    slow = np.cumsum(rng.standard_normal((1500, 1)) * 0.02, axis=0)
    r = random_switching(rng, 1500, 1, 30.0)
    record = simulate(TransferMatrix.of([["2/(12 s + 1)"]], "min"), LAW, r, 1.0, v=slow)
    wandering = identify_output([segment_of(record)], 0, [Spec(0, FOPDT, (1.6, 15.0, 0.0))]).fit
    assert inflation(wandering, 0.95) > 1.5
