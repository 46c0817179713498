"""What is not known of the noise model: factors on variances, by other ways and by their promise. Simulated records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import f, norm, ttest_1samp

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import Row, RowFit, Spec, fit_row, levels, pieces_of
from trueplant.identify.covariance import inflated, inflation, joint_freedom, noise_freedom, told_at
from trueplant.identify.fit import evaluate, restriction_of
from trueplant.identify.likelihood import held_at, ratio_p
from trueplant.identify.longest_noise import restricted
from trueplant.identify.noise import fit_ar
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix

FOPDT = Structure.parse("fopdt")
TRUTH = np.array([2.0, 12.0, 3.4])
LAW = Controller.diagonal([PID(Kc=0.3, Ti=12.0, sample_time=1.0)])


def fitted(seed: int, pole: float, order: int, samples: int = 600) -> RowFit:
    """One loop under AR(1) noise, fitted from the truth."""
    rng = np.random.default_rng(seed)
    v = coloured(rng, samples, 1, [1, -pole], [1], 0.2)
    plant = TransferMatrix(((FOPDT.transfer(TRUTH),),), "min")
    segment = segment_of(simulate(plant, LAW, random_switching(rng, samples, 1, 60.0), 1.0, v=v))
    row = Row((Spec(0, FOPDT, tuple(TRUTH)),), pieces_of([segment], 0))
    begun = fit_row(row, TRUTH, np.zeros(0), iterations=0)
    y, valid = row.measured(0)
    errors = y - row.response(TRUTH, 0)
    return fit_row(row, TRUTH, fit_ar([errors - errors.mean()], [valid], order)[0], weights=begun.weights)


def test_variances_move_with_the_noise_model_as_finite_differences_say():
    """To 6 %: with the noise model the initial states move as well, and the derivatives by lags with them."""
    fit = fitted(1, 0.9, 3)
    step = 1e-5

    def log_variances(ar):
        whole = evaluate(fit.row, fit.theta, ar, fit.weights)
        unit = fit.cost / fit.count
        prior = np.diag(fit.row.prior.normal_equations(fit.theta)[0]) * (unit - whole.unit)
        return np.log(np.diag(np.linalg.inv(whole.information[:3, :3] + prior)))

    moves = [(log_variances(fit.ar + d) - log_variances(fit.ar - d)) / (2 * step) for d in step * np.eye(3)]
    np.testing.assert_allclose(-2 * told_at(restriction_of(fit), fit.ar), np.column_stack(moves), rtol=0.06, atol=0.06)


def test_variances_of_sums_of_parameters_move_as_finite_differences_say():
    fit, sums, step = fitted(1, 0.9, 3), np.array([[1.0, 0.2, 0.0], [0.0, 1.0, -2.0]]), 1e-5
    restriction = restriction_of(fit)

    def log_variances(ar):
        return np.log(np.diag(sums @ restriction.told(ar).covariance @ sums.T))

    moves = [(log_variances(fit.ar + d) - log_variances(fit.ar - d)) / (2 * step) for d in step * np.eye(3)]
    np.testing.assert_allclose(-2 * told_at(restriction, fit.ar, sums), np.column_stack(moves), rtol=0.06, atol=0.06)


def test_a_joint_test_has_the_freedom_of_its_parts(monkeypatch):
    """F of independent t of 8, 50, 400 degrees of freedom: their mean square has the mean of F(3, joint)."""
    fit = fitted(1, 0.9, 12)
    alone = noise_freedom(fit)
    for k in range(3):
        np.testing.assert_allclose(joint_freedom(fit, np.array([k])), alone[k], rtol=1e-9)
    together = joint_freedom(fit, np.arange(3))
    assert alone.min() < together < 3 * alone.max()
    parts = np.array([8.0, 50.0, 400.0])
    monkeypatch.setattr("trueplant.identify.covariance.noise_freedom", lambda *_: parts)
    joint = joint_freedom(fit, np.arange(3))
    squares = np.random.default_rng(1).standard_t(parts, (400_000, 3)) ** 2
    np.testing.assert_allclose(np.mean(squares), joint / (joint - 2), rtol=0.01)
    drawn = np.quantile(squares.mean(axis=1), [0.95, 0.99])
    np.testing.assert_allclose(f.isf([0.05, 0.01], 3, joint), drawn, rtol=0.06)
    assert np.all(f.isf([0.05, 0.01], 3, parts.min()) > 1.2 * drawn)


def test_what_the_fit_takes_is_the_slope_of_a_log_determinant():
    """The determinant of the whitened derivatives and unknowns together, each filtered by scipy."""
    fit = fitted(2, 0.9, 2)
    _, gradient = fit.row.response_and_gradient(fit.theta, 0)
    columns = np.column_stack([gradient, fit.row.nuisance(fit.theta, 0)])

    def half_log_determinant(ar):
        white = lfilter([1.0, *ar], [1.0], columns, axis=0)[2:]
        white /= np.linalg.norm(columns, axis=0)
        return 0.5 * np.linalg.slogdet(white.T @ white)[1]

    step = 1e-5
    slopes = [
        (half_log_determinant(fit.ar + d) - half_log_determinant(fit.ar - d)) / (2 * step) for d in step * np.eye(2)
    ]
    assert fit.row.nuisance_count > 0
    np.testing.assert_allclose(restriction_of(fit).penalty(fit.ar)[1], slopes, rtol=0.05)


def test_restricted_likelihood_of_a_noise_model_is_that_of_dense_matrices():
    """The plant held: what is fitted beside the pole of the noise is an operating point and a free response."""
    held = held_at(fitted(2, 0.98, 1, 300), np.arange(3), TRUTH)
    restriction = restriction_of(held)
    ((rows, _, may_be),), (y, _) = restriction.pieces, held.row.measured(0)
    errors, columns = y - held.row.response(TRUTH, 0), rows[3:].T
    assert columns.shape[1] == held.row.nuisance_count == 2

    def dense(pole):
        white, left = lfilter([1, -pole], [1], columns, axis=0)[1:], lfilter([1, -pole], [1], errors)[1:]
        left = left - white @ np.linalg.lstsq(white, left, rcond=None)[0]
        return len(left) * np.log(left @ left) + np.linalg.slogdet(white.T @ white + np.diag(may_be))[1]

    def own(pole):
        point = evaluate(replace(held.row, restricted=restriction), TRUTH, np.array([-pole]), held.weights)
        return point.count * np.log(point.cost), 2 * point.slope[3] / point.unit

    poles, step = np.array([0.88, 0.9, 0.93, 0.94, 0.96]), 1e-6
    slopes = [(dense(pole - step) - dense(pole + step)) / (2 * step) for pole in poles]
    np.testing.assert_allclose(np.diff([own(pole)[0] for pole in poles]), np.diff([dense(p) for p in poles]), atol=1e-6)
    np.testing.assert_allclose([own(pole)[1] for pole in poles], slopes, rtol=0.02, atol=0.5)


def test_ratios_of_noise_that_is_known_from_few_errors_make_f_tests():
    """The mean of normal errors of unknown size: -2 log likelihood rises by t squared, which is F(1, n - 1)."""
    errors = np.random.default_rng(1).standard_normal(9) + 1.0
    told = ttest_1samp(errors, 0.0)
    np.testing.assert_allclose(ratio_p(told.statistic**2, 1, 8.0), told.pvalue)
    np.testing.assert_allclose(ratio_p(7.0, 3, 1e9), ratio_p(7.0, 3), rtol=1e-6)
    assert ratio_p(20.0, 3, 8.0) > 30 * ratio_p(20.0, 3)


@pytest.mark.slow
def test_restricted_likelihood_gives_slow_noise_back_what_the_fit_takes():
    """60 records of 300 samples with the pole 0.98, one loop: least squares forget it sooner."""
    fits = [fitted(seed, 0.98, 1, 300) for seed in range(60)]
    plain, given_back = (np.array([-fit.ar[0] for fit in some]) for some in (fits, [restricted(fit) for fit in fits]))
    assert np.mean(given_back > plain) > 0.85
    assert abs(np.mean(given_back) - 0.98) < 0.8 * abs(np.mean(plain) - 0.98)


def test_rows_that_are_not_kept_say_the_same(monkeypatch):
    fit = fitted(2, 0.9, 2)
    kept, ar = restriction_of(fit), fit.ar + 0.05
    monkeypatch.setattr(levels, "SEARCHED_ERRORS", 0)
    anew = restriction_of(fit)
    assert isinstance(kept.pieces, tuple) and not isinstance(anew.pieces, tuple)
    np.testing.assert_array_equal(anew.penalty(ar)[1], kept.penalty(ar)[1])
    np.testing.assert_array_equal(told_at(anew, ar), told_at(kept, ar))


def test_inflated_covariances_are_larger_along_every_sum():
    """By the eigenvalues of the difference, and by the variances of the parameters as `inflation` has them."""
    for seed in range(4):
        fit = fitted(seed, 0.97, 2)
        wide, own = inflated(fit, 0.95), fit.covariance
        apart = np.sqrt(np.diag(own))
        assert np.linalg.eigvalsh((wide - own) / np.outer(apart, apart)).min() > -1e-12
        np.testing.assert_allclose(inflation(fit, 0.95), np.diag(wide) / np.diag(own), rtol=1e-12)
        held = held_at(fit, np.array([2]), fit.theta[[2]])
        np.testing.assert_allclose(inflated(held, 0.95)[2], held.covariance[2], atol=1e-20)
        assert inflation(held, 0.95)[2] == 1.0


def test_noise_that_is_white_or_long_known_widens_nothing():
    assert np.all(inflation(fitted(3, 0.0, 1, 6000), 0.95) < 1.01)
    slow = inflation(fitted(3, 0.97, 1), 0.95)
    assert slow[0] > 1.1 and slow[2] < 1.05, "the gain is told by slow moves, the dead time by fast ones"


@pytest.mark.slow
def test_intervals_of_gains_cover_under_slow_noise():
    """400 records of 600 samples under AR(1) noise with the pole 0.97.

    356 or more covered (89 %) passes with 0.99 at a coverage of 92 %, which is what the first order leaves where the
    record holds so few time constants of its noise, and with 0.01 at 85 %.
    """
    z = norm.ppf(0.975)
    fits = [fitted(100 + seed, 0.97, 1) for seed in range(400)]
    apart = np.array([(fit.theta[0] - 2.0) / np.sqrt(fit.covariance[0, 0]) for fit in fits])
    factors = np.array([inflation(fit, 0.95)[0] for fit in fits])
    covered, plain = np.sum(np.abs(apart) < z * np.sqrt(factors)), np.sum(np.abs(apart) < z)
    assert 356 <= covered <= 392
    assert plain < covered - 8
