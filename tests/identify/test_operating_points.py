"""Levels of an output in two experiments at different OPs. All records are simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from support.simulated import coloured, random_switching, segment_of
from trueplant.arrays import Array
from trueplant.identify import identify_matrix, operating_points, specs_of
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

PLANT = TransferMatrix.of([["1.3 exp(-5 s)/(9 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.4, Ti=9.0, sample_time=1.0)])
GAIN, RECORDS = 1.3, 60


def experiment(rng: np.random.Generator, k: int, pole: float, op: float, bias: float) -> Segment:
    """From sample 200 on, so that nothing is at rest; OP about `op`, and PV where it settles for that, and a bias."""
    size = 1000
    v = coloured(rng, size, 1, [1, -pole], [1], 0.3)
    whole = segment_of(simulate(PLANT, LAW, random_switching(rng, size, 1, 25.0), 1.0, v=v), k)
    cut = {name: getattr(whole, name)[200:] for name in ("t", "r", "d", "free")}
    return replace(whole, u=whole.u[200:] + op, y=whole.y[200:] + GAIN * op + bias, **cut)


def difference(seed: int, pole: float, bias: float) -> tuple[float, float]:
    """That of the levels, and its standard error."""
    rng = np.random.default_rng(seed)
    segments = [experiment(rng, 0, pole, 30.0, 0.0), experiment(rng, 1, pole, 34.0, bias)]
    fit = identify_matrix(segments, PLANT, specs_of(PLANT))[0].fit
    starts: dict[int, Array] = {k: segment.u[0] for k, segment in enumerate(segments)}
    found = operating_points(fit, fit.theta, fit.covariance, starts, np.zeros(1))
    assert found.experiments == (0, 1)
    contrast = np.array([-1.0, 1.0])
    return float(contrast @ found.levels), float(np.sqrt(contrast @ found.covariance @ contrast))


@pytest.mark.parametrize("pole", [0.5, 0.95])
def test_the_difference_of_levels_is_as_sure_as_it_says(pole):
    """Gains' errors count with the OPs' distance, slow noise with its length: 60 records."""
    found = np.array([difference(seed, pole, 2.0) for seed in range(RECORDS)])
    z = (found[:, 0] - 2.0) / found[:, 1]
    assert np.mean(np.abs(z) < norm.isf(0.025)) >= 0.87
    assert 0.75 < z.std() < 1.25


def test_a_slow_noise_tells_less_of_a_level():
    assert difference(3, 0.98, 2.0)[1] > 1.5 * difference(3, 0.5, 2.0)[1]


def test_elements_outside_the_row_take_their_share_of_the_level():
    """A fixed element with a gain of 2 and its input 4 higher in the second experiment: its level is 8 lower."""
    rng = np.random.default_rng(8)
    segments = [experiment(rng, k, 0.5, 0.0, 0.0) for k in range(2)]
    fit = identify_matrix(segments, PLANT, specs_of(PLANT))[0].fit
    inputs = [np.array([segment.u[0, 0], 4.0 * k]) for k, segment in enumerate(segments)]
    both, alone = (
        operating_points(fit, fit.theta, fit.covariance, dict(enumerate(inputs)), fixed).levels
        for fixed in (np.array([0.0, 2.0]), np.zeros(2))
    )
    assert np.allclose(alone - both, [0.0, 8.0])
