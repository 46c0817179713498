"""What noise with a memory leaves open: by dense matrices, and by the promise of its variances. Simulated records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.special import gammaln

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import Row, RowFit, Spec, fit_row, levels, pieces_of
from trueplant.identify.covariance import inflation, small_samples
from trueplant.identify.memory import _before, _grown, _pieces, _told, memory_heights, remembering
from trueplant.identify.noise import choose_order, fit_ar
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix

FOPDT = Structure.parse("fopdt")
TRUTH = np.array([2.0, 12.0, 3.4])
LAW = Controller.diagonal([PID(Kc=0.3, Ti=12.0, sample_time=1.0)])


def noise(rng, d, samples, burnt=4000):
    """(samples, 1) white noise summed up by (1 - 1/q)^-d, by the gamma function; unit innovations."""
    k = np.arange(1, samples + burnt)
    taps = np.concatenate([[1.0], np.exp(gammaln(k + d) - gammaln(k + 1) - gammaln(d)) if d else np.zeros(k.size)])
    return np.convolve(rng.standard_normal(samples + burnt), taps)[burnt : samples + burnt, None]


def fitted(seed: int, d: float, samples: int = 1500, std: float = 0.05, missing: float = 0.0) -> RowFit:
    """One loop whose set-point moves a few times, under noise of a memory; the noise model as an estimate has it."""
    rng = np.random.default_rng(seed)
    v, r = std * noise(rng, d, samples), random_switching(rng, samples, 1, 300.0)
    plant = TransferMatrix(((FOPDT.transfer(TRUTH),),), "min")
    segment = segment_of(simulate(plant, LAW, r, 1.0, v=v))
    row = Row((Spec(0, FOPDT, tuple(TRUTH)),), pieces_of([segment], 0))
    y, valid = row.measured(0)
    if missing:
        gone = replace(row.pieces[0], valid=rng.random(samples) > missing)
        row = replace(row, pieces=(gone,))
        valid = gone.valid
    errors = y - row.response(TRUTH, 0)
    errors = errors - errors.mean()
    order = choose_order([errors], [valid], 30)
    return fit_row(row, TRUTH, fit_ar([errors], [valid], order)[0])


def memory_growth(fit: RowFit) -> np.ndarray:
    """(size,) of the variances."""
    growth = remembering(fit)
    return np.diag((growth.along * growth.factors) @ growth.along.T) / np.diag(fit.covariance)


@pytest.mark.parametrize("d", [0.0, 0.4, 1.0])
def test_restricted_likelihood_and_squares_are_those_of_dense_matrices(d):
    """The covariance of the noise as a matrix, its inverse and determinant by numpy; against those at no memory."""
    fit = fitted(1, 0.5, 300)
    (piece,) = _pieces(fit)
    errors, columns = piece.rows[0], piece.rows[1:].T
    k = np.arange(1, 300)

    def dense(memory):
        taps = np.concatenate([[1.0], np.exp(gammaln(k + memory) - gammaln(k + 1) - gammaln(memory))])
        root = toeplitz(taps, np.zeros(300)) if memory else np.eye(300)
        inverse = np.linalg.inv(root @ root.T)
        prior = fit.variance * np.concatenate([fit.row.prior.normal_equations(fit.theta)[0], np.zeros(2)])
        pull = fit.variance * np.concatenate([fit.row.prior.normal_equations(fit.theta)[1], np.zeros(2)])
        information = columns.T @ inverse @ columns + np.diag(prior) + np.diag([0, 0, 0, *piece.known])
        slope = columns.T @ inverse @ errors
        shift, moving = np.zeros(5), np.array([0, 1, 3, 4])  # not the dead time
        shift[moving] = np.linalg.solve(information[np.ix_(moving, moving)], (slope - pull)[moving])
        left = 300 - 5
        away = fit.variance * fit.row.prior.penalty(fit.theta)
        whole = errors @ inverse @ errors + away - (slope - pull) @ shift
        variance = whole / left
        squares = variance * np.linalg.inv(information) + np.outer(shift, shift)
        determinant = np.linalg.slogdet(information)[1] - np.linalg.slogdet(inverse)[1]
        of_others = determinant + np.linalg.slogdet(np.linalg.inv(information)[:3, :3])[1]
        return left * np.log(variance) + determinant, 298 * np.log(whole / 298) + of_others, squares[:3, :3]

    own = {memory: _told(fit, [piece.with_memory(memory)], np.zeros(0), 0) for memory in (0.0, d)}
    assert columns.shape[1] == 5
    (deviance, height, squares), (at_none, height_at_none, _) = dense(d), dense(0.0)
    np.testing.assert_allclose(own[d].squares, squares, rtol=1e-6, atol=1e-9 * np.abs(squares).max())
    np.testing.assert_allclose(own[d].deviance - own[0.0].deviance, deviance - at_none, atol=1e-5)
    np.testing.assert_allclose(own[d].height - own[0.0].height, height - height_at_none, atol=1e-5)


def test_each_independent_sum_grows_by_itself():
    """Of two lags of one size only the difference is open: the sum and the gain are as well known as they were."""
    between = np.array([0.0, 1.0, -1.0, 0.0])
    covariance = np.diag([0.04, 0.01, 0.01, 0.0]) + 9.0 * np.outer(between, between)
    covariance[0, 1] = covariance[1, 0] = covariance[0, 2] = covariance[2, 0] = 0.005
    free = np.array([True, True, True, False])
    growth = _grown(covariance, covariance + 300.0 * np.outer(between, between), free)
    larger = (growth.along * growth.factors) @ growth.along.T
    together = np.array([0.0, 1.0, 1.0, 0.0])
    np.testing.assert_allclose(growth.sums @ covariance @ growth.sums.T, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(growth.along @ growth.sums, np.diag(free), atol=1e-9)
    np.testing.assert_allclose(larger, covariance + 300.0 * np.outer(between, between), atol=1e-8)
    np.testing.assert_allclose(together @ larger @ together, together @ covariance @ together, rtol=1e-6)
    smaller = _grown(covariance, 0.5 * covariance, free)
    np.testing.assert_array_equal(smaller.factors, 1.0)


def test_heights_rise_as_the_likelihood_does_and_by_less_where_slow_noise_hides_it():
    """Each parameter held two standard errors off: 4 under white noise; for gains under 1/f noise, about 2."""

    def rises(seed, d, samples, index):
        fit, free = fitted(seed, d, samples), np.ones(3, dtype=bool)
        free[index] = False
        off = fit.theta + 2 * np.sqrt(np.diag(fit.covariance)) * ~free
        away = fit_row(fit.row, off, fit.ar, free=free)
        return away.left * np.log(away.cost / fit.cost), np.diff(memory_heights([fit, away]))[0]

    for index in range(3):
        own, high = np.array([rises(seed, 0.0, 4000, index) for seed in range(4)]).T
        np.testing.assert_allclose(high, own, rtol=0.2)
    own, high = np.array([rises(seed, 0.5, 1500, 0) for seed in range(8)]).T
    assert np.median(own) > 3.5 and np.median(high) < 3.0


def test_a_fit_beside_a_kink_of_its_dead_time_is_as_high_as_it_is():
    """White noise, the dead time three standard errors off: a straight step from there would lead to the minimum."""
    for seed in range(4):
        fit = fitted(seed, 0.0, 4000)
        off = fit.theta + np.array([0.0, 0.0, 3 * np.sqrt(fit.covariance[2, 2])])
        held = fit_row(fit.row, off, fit.ar, free=np.array([True, True, False]))
        own = held.left * np.log(held.cost / fit.cost)
        assert own > 6
        stuck = replace(held, free=np.ones(3, dtype=bool))
        np.testing.assert_allclose(np.diff(memory_heights([fit, stuck]))[0], own, rtol=0.2)


def test_white_noise_widens_nothing_and_1_f_noise_gains_before_dead_times():
    assert np.all(memory_growth(fitted(3, 0.0, 4000)) < 1.1)
    growth = np.median([memory_growth(fitted(seed, 0.5)) for seed in range(8)], axis=0)
    assert growth[0] > 2 and growth[2] < 1.3


def test_initial_states_that_the_noise_model_cancels_widen_nothing():
    """Three lags beside an autoregression with a root near them: what the fit makes of their states may be anything."""
    structure, truth = Structure.parse("sopdt+lag"), np.array([2.0, 19.0, 10.5, 6.0, 3.4])
    plant, ar = TransferMatrix(((structure.transfer(truth),),), "min"), np.array([-0.9881, 0.0239, 0.0239])
    law = Controller.diagonal([PID(Kc=0.3, Ti=25.0, sample_time=1.0)])
    for seed in range(6):
        rng = np.random.default_rng(seed)
        v = coloured(rng, 2000, 1, [1, *ar], [1], 0.007)
        segment = segment_of(simulate(plant, law, random_switching(rng, 2000, 1, 60.0), 1.0, v=v))
        row = Row((Spec(0, structure, tuple(truth)),), pieces_of([segment], 0))
        assert np.all(memory_growth(fit_row(row, truth, ar)) < 1.5)


def test_likelihood_ratios_leave_to_the_largest_noise_model_what_slow_noise_could_explain():
    """Both would count it twice, and elements that a record shows clearly would not be found."""
    for d, least, most in ((0.0, 1.0, 1.05), (0.5, 1.7, np.inf)):
        fits = [fitted(seed, d) for seed in range(8)]
        more = np.median([inflation(fit, 0.95)[0] / small_samples(fit, 0.95)[0] for fit in fits])
        assert least <= more < most


def test_a_gain_under_1_f_noise_is_as_unsure_as_it_says():
    """60 records with few moves: the rms z-score of the gain is 1 within 0.3 (0.999, chi-square); without memory more.

    The noise model's own uncertainty counts elsewhere.
    """
    fits = [fitted(seed, 0.5) for seed in range(60)]
    bare = np.array([(fit.theta[0] - 2.0) / np.sqrt(fit.covariance[0, 0]) for fit in fits])
    grown = bare / np.sqrt([memory_growth(fit)[0] for fit in fits])

    assert np.sqrt(np.mean(bare**2)) > 1.5
    assert 0.7 < np.sqrt(np.mean(grown**2)) < 1.3


def test_samples_that_are_missing_change_little():
    """Three in a hundred: each cuts the record for the noise model of the fit."""
    for seed in range(4):
        fits = [fitted(seed, 0.5, missing=share) for share in (0.0, 0.03)]
        whole, gaps = (np.sqrt(memory_growth(fit) * np.diag(fit.covariance)) for fit in fits)
        np.testing.assert_allclose(gaps, whole, rtol=0.3)


def test_a_fit_without_noise_grows_by_nothing():
    fit = fitted(1, 0.0, 400, std=0.0)
    assert np.all(np.isfinite(memory_growth(fit)))


@pytest.mark.holds("identify.REMEMBERS")
def test_noise_is_an_autoregression_as_likely_as_not():
    """From none to a walk, each other memory alike: a short record cannot tell, and 1/f noise shows in a long one."""
    before = _before()
    assert 0.4 < before[1:].sum() < 0.6 and before.sum() == pytest.approx(1)
    assert levels.MEMORIES[0] == 0.0 and levels.MEMORIES[-1] == 1.0
