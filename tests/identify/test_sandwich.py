"""Standard errors where the noise changes its size: against Monte Carlo, and against the likelihood's own."""

from __future__ import annotations

from types import SimpleNamespace as Stub

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest

from support.simulated import WOOD_BERRY, random_switching, segment_of, wood_berry
from trueplant.identify import Row, Spec, fit_row, identify_output, pieces_of, prediction_errors, sandwich, specs_of
from trueplant.identify.sandwich import correlated_lags, plant_covariance, sandwich_covariance
from trueplant.identify.validate import squares_p
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import Structure
from trueplant.record.types import Segment

FOPDT = Structure.parse("fopdt")
TRUTH = np.array([2.0, 10.0, 3.3])
SPEC = Spec(0, FOPDT, tuple(TRUTH))
SAMPLES = 1500


def step_test(seed, loud=4.0):
    """Open loop; for 15 samples after each move the noise is `loud` times as large, as where a valve is being moved."""
    rng = np.random.default_rng(seed)
    u = random_switching(rng, SAMPLES, 1, 60.0)
    moved = np.diff(u[:, 0], prepend=u[0, 0]) != 0
    size = np.where(np.convolve(moved, np.ones(15))[:SAMPLES] > 0, loud, 1.0)
    y = sampled_response(FOPDT.transfer(TRUTH), u[:, 0] - u[0, 0], 1.0)
    y = y + 0.3 * size * rng.standard_normal(SAMPLES)
    none = np.zeros((SAMPLES, 0))
    return Segment(
        0, 1.0, np.arange(SAMPLES) * 1.0, none, u, y[:, None], none, np.ones((SAMPLES, 1), bool), ("zoh",), False
    )


def fitted(segment):
    return fit_row(Row((SPEC,), pieces_of([segment], 0)), TRUTH, np.zeros(0))


def test_standard_errors_are_those_of_monte_carlo():
    fits = [fitted(step_test(seed)) for seed in range(300)]
    spread = np.std([fit.theta for fit in fits], axis=0)
    own = np.sqrt(np.mean([np.diag(plant_covariance(fit)) for fit in fits], axis=0))
    robust = np.sqrt(np.mean([np.diag(sandwich_covariance(fit)) for fit in fits], axis=0))
    plain = np.sqrt(np.mean([np.diag(fit.covariance) for fit in fits], axis=0))
    assert own == pytest.approx(spread, rel=0.12)
    # in no direction less than the likelihood says, which for a gain told in quiet times is too much
    assert np.all(robust > 0.95 * spread) and np.all(robust < 1.25 * spread)
    # What moves tell of the time constant and the dead time, they tell while the noise is loud.
    assert np.all(plain[1:] < 0.8 * spread[1:])


def test_loud_noise_after_moves_widens_what_moves_tell_and_even_noise_hardly_anything():
    loud = identify_output([step_test(7)], 0, [SPEC])
    assert loud.uneven and loud.tests.size_p < 1e-6
    assert np.all(np.diag(loud.covariance)[1:] > 1.3 * np.diag(loud.fit.covariance)[1:])
    ratios = []
    for seed in range(8):
        even = identify_output([step_test(seed, 1.0)], 0, [SPEC])
        ratios.append(np.diag(even.covariance)[:2] / np.diag(even.fit.covariance)[:2])
    assert np.all(np.mean(ratios, axis=0) < 1.2) and np.min(ratios) >= 1


@pytest.mark.holds("identify.BARTLETT", "identify.MOST_CORRELATED")
@pytest.mark.parametrize("rho", [0.5, 0.97, 1.0])
def test_lags_are_those_of_andrews(rho):
    """His formula for one autoregression of first order: 1.1447 (4 rho^2 n / ((1 - rho)^2 (1 + rho)^2))^(1/3)."""
    n = 200_000
    scores = lfilter([1.0], [1.0, -rho], np.random.default_rng(3).standard_normal(n))[None]
    believed = min(rho, 0.97)
    expected = 1.1447 * np.cbrt(4 * believed**2 * n / ((1 - believed) ** 2 * (1 + believed) ** 2))
    assert correlated_lags([scores, np.zeros((1, 0))]) == pytest.approx(expected, rel=0.03)
    assert correlated_lags([np.zeros((2, 50))]) == 0


def test_long_run_variances_are_closer_to_the_truth_than_with_lags_that_are_always_as_many():
    """Scores without correlation, and with 0.5 from one to the next, whose variance of the sum is known."""

    def found(scores, lags):
        products = [scores[lag:] @ scores[: scores.size - lag] for lag in range(lags + 1)]
        return (products[0] + 2 * sum((1 - k / (lags + 1)) * products[k] for k in range(1, lags + 1))) / scores.size

    for rho in (0.0, 0.5):
        errors = []
        for seed in range(200):
            white = np.random.default_rng(seed).standard_normal(1600)
            scores, true = lfilter([1.0], [1.0, -rho], white)[100:], (1 - rho) ** -2
            errors.append([found(scores, lags) / true - 1 for lags in (correlated_lags([scores[None]]), 25)])
        chosen, always = np.sqrt(np.mean(np.square(errors), axis=0))
        assert chosen < (0.4 if rho == 0 else 1.0) * always


def test_no_standard_error_is_below_that_of_the_likelihood():
    fit = fitted(step_test(3, loud=0.2))
    more = sandwich_covariance(fit) - fit.covariance
    scale = np.sqrt(np.diag(fit.covariance))
    assert np.linalg.eigvalsh(more / np.outer(scale, scale)).min() > -1e-9


def test_not_by_rounding_either(monkeypatch):
    """Covariances that differ by nothing, of parameters of which one is as good as fixed: 50 at random."""
    rng = np.random.default_rng(7)
    for _ in range(50):
        root = rng.standard_normal((6, 6)) * np.array([1e-15, 1e-3, 1e-2, 1.0, 10.0, 1e2])[:, None]
        plain = root @ root.T
        monkeypatch.setattr(sandwich, "plant_covariance", lambda fit, own=plain: own)
        assert np.all(np.diag(sandwich_covariance(Stub(covariance=plain)) - plain) >= 0)


def test_p_values_are_uniform_for_even_errors_and_tiny_for_a_burst():
    """300 seeded runs: uniform passes with 0.99, and with less than 1e-3 where 20 % of p-values are below 5 %."""
    rng = np.random.default_rng(1)
    p = [squares_p([rng.standard_normal(800)]) for _ in range(300)]
    assert kstest(p, "uniform").pvalue > 0.01
    e = rng.standard_normal(800)
    e[300:400] *= 3
    e[::50] = np.nan
    assert squares_p([e]) < 1e-6
    assert squares_p([np.zeros(800)]) == squares_p([e[:30]]) == 1.0


def test_a_parameter_of_which_nothing_is_known_stays_unknown():
    """No dynamics are to be seen of an input that never moves."""
    still = step_test(5)
    still.u[:] = still.u[0]
    covariance = sandwich_covariance(fitted(still))
    # what is left is the prior about the model: a standard deviation of one in logarithms, or in asinh(value / unit)
    gain, lag, dead_time = TRUTH
    expected = [np.hypot(gain, gain), lag, np.hypot(lag + dead_time, dead_time)]
    assert np.sqrt(np.diag(covariance)) == pytest.approx(expected, rel=0.02)


def test_runs_of_unlike_noise_are_of_one_size_as_the_fit_weights_them():
    runs = [segment_of(wood_berry(20 + k, 700, noise), k) for k, noise in enumerate((0.1, 0.6))]
    row = [spec for (i, _), spec in sorted(specs_of(WOOD_BERRY).items()) if i == 0]
    found = identify_output(runs, 0, row)
    assert found.tests.size_p > 0.01
    assert squares_p([prediction_errors(found.fit)]) < 1e-20
