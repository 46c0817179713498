"""The weak prior about the model: its derivatives, what it leaves alone, and what it holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import Row, Spec, fit_row, identify_output, pieces_of
from trueplant.identify.levels import PRIOR_SPREAD, SEARCHED_FREEDOM
from trueplant.identify.likelihood import held_at, ratio_p, rise, without_element
from trueplant.identify.prior import Prior
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix

STRUCTURE = Structure.parse("pair+lag+lead+delayed")
MODEL = np.array([2.0, -0.7, 8.0, 0.2, 0.6, -1.5, 3.0, 5.0])


def record(structure, theta, seed=1, samples=1500):
    """One loop under slow PI control with a switching set-point and coloured noise (simulated)."""
    rng = np.random.default_rng(seed)
    plant = TransferMatrix(((structure.transfer(theta),),), "min")
    law = Controller.diagonal([PID(Kc=0.3, Ti=12.0, sample_time=1.0)])
    r = random_switching(rng, samples, 1, 60.0)
    return segment_of(simulate(plant, law, r, 1.0, v=coloured(rng, samples, 1, [1, -0.8], [1], 0.1)))


def test_slope_is_the_derivative_and_the_density_is_normal_in_the_logarithm():
    prior, rng = Prior.about(STRUCTURE, MODEL), np.random.default_rng(2)
    assert prior.penalty(MODEL) == 0.0
    for _ in range(20):
        theta = MODEL * np.exp(rng.normal(0, 1, MODEL.size))
        slope = prior.normal_equations(theta)[1]
        for k in range(MODEL.size):
            step = np.zeros(MODEL.size)
            step[k] = 1e-6 * max(abs(theta[k]), 1e-3)
            difference = (prior.penalty(theta + step) - prior.penalty(theta - step)) / (4 * step[k])
            assert difference == pytest.approx(slope[k], rel=1e-4, abs=1e-8)
    # Time constants by their logarithm; what may be negative is so where it is large.
    tripled = MODEL.copy()
    tripled[2] *= 3
    assert prior.penalty(tripled) == pytest.approx(np.log(3.0) ** 2)
    thousand, million = MODEL.copy(), MODEL.copy()
    thousand[0] *= 1e3
    million[0] *= 1e6
    assert np.sqrt(prior.penalty(million)) - np.sqrt(prior.penalty(thousand)) == pytest.approx(np.log(1e3), rel=1e-6)


def test_where_there_is_no_model_there_is_no_prior():
    prior = Prior.about(STRUCTURE, None)
    assert prior.penalty(MODEL) == 0.0 and not np.any(prior.normal_equations(MODEL)[0])


def test_what_the_record_determines_is_left_alone_however_far_from_the_model():
    """A gain 30 times, a lag 5 times the model's: within a tenth of a standard error of the fit without a model."""
    fopdt, truth = Structure.parse("fopdt"), np.array([2.0, 10.0, 3.3])
    pieces = pieces_of([record(fopdt, truth)], 0)
    far = Row((Spec(0, fopdt, (truth[0] / 30, truth[1] / 5, 1.0)),), pieces)
    alone = Row((Spec(0, fopdt),), pieces)
    fits = [fit_row(row, truth, np.array([-0.8])) for row in (far, alone)]
    sigma = np.sqrt(np.diag(fits[1].covariance))
    assert np.all(np.abs(fits[0].theta - fits[1].theta) < 0.1 * sigma)
    assert np.allclose(np.sqrt(np.diag(fits[0].covariance)), sigma, rtol=0.02)


def test_a_lag_that_a_lead_cancels_stays_near_the_model():
    """sopdt+lead where the record shows hardly more than one lag: 20 records, no parameter runs away."""
    structure, truth = Structure.parse("sopdt+lead"), np.array([2.0, 10.0, 4.0, 3.5, 3.3])
    spec = Spec(0, structure, tuple(truth))
    worst, without = 0.0, 0.0
    for seed in range(20):
        segment = record(structure, truth, seed, 600)
        found = identify_output([segment], 0, [spec])
        worst = max(worst, float(np.max(np.abs(np.log(np.abs(found.theta[1:3]) / truth[1:3])))))
        row = replace(found.row, specs=(Spec(0, structure),))
        free = fit_row(row, truth * [1.0, 1.5, 0.7, 1.0, 1.0], found.fit.ar)
        without = max(without, float(np.max(np.abs(np.log(np.abs(free.theta[1:3]) / truth[1:3])))))
    assert worst < 1.5 * PRIOR_SPREAD < without


def test_verdicts_count_slow_noise_as_intervals_do():
    """A likelihood ratio is divided by the factors for what is not known of the noise model."""
    fopdt, truth = Structure.parse("fopdt"), np.array([2.0, 10.0, 3.3])
    found = identify_output([record(fopdt, truth, 4, 600)], 0, [Spec(0, fopdt, tuple(truth))])
    index, values = np.arange(3), truth * [1.1, 1.1, 1.0]
    plain = ratio_p(rise(found.fit, held_at(found.fit, index, values)), 3)
    assert np.all(found.factor > 1) and np.all(found.ratio_factor > 1)
    assert found.likelihood_ratio_p(index, values) == pytest.approx(
        chi2.sf(chi2.isf(plain, 3) / found.ratio_factor.mean(), 3)
    )
    assert found.absence_p(0) >= ratio_p(rise(found.fit, without_element(found.fit, 0)), SEARCHED_FREEDOM + 3)


def test_an_input_that_stands_still_leaves_the_others_as_they_are():
    """What the record says of them is the same with and without it, but for the initial states that it brings along."""
    fopdt, truth = Structure.parse("fopdt"), np.array([2.0, 10.0, 3.3])
    alone = record(fopdt, truth, 4, 600)
    both = replace(alone, u=np.column_stack([alone.u, np.full(len(alone), 3.0)]), free=np.ones((len(alone), 2), bool))
    one = Row((Spec(0, fopdt, tuple(truth)),), pieces_of([alone], 0))
    two = Row((*one.specs, Spec(1, fopdt, tuple(truth))), pieces_of([replace(both, hold=("zoh", "zoh"))], 0))
    ar = np.array([-0.5])
    few = fit_row(one, truth, ar).standard_errors_by_data
    more = fit_row(two, np.tile(truth, 2), ar).standard_errors_by_data
    np.testing.assert_allclose(more[:3], few, rtol=0.15)
    assert np.all(more[[3, 5]] > 1e6)
