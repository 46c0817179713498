"""Noise models whose far lags share coefficients: against scipy, explicit sums and the best that can be foretold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are, toeplitz
from scipy.signal import lfilter

from trueplant.identify.autoregression import NO_NOISE_MODEL, Autoregression, Lags, bridge, furthest, whiten
from trueplant.identify.noise import choose_lags, fit_ar, fit_autoregression

Array = np.ndarray
SOME = [Lags(), Lags(3), Lags(3, 6), Lags(0, 12), Lags(30, 8)]
FEW = st.integers(0, 35), st.integers(0, 12)


def model(lags: Lags, seed: int = 1) -> Autoregression:
    return Autoregression(np.random.default_rng(seed).standard_normal(lags.order), lags)


def taps_of(ar: Autoregression) -> Array:
    """Lag by lag, from the first and the last lag of each coefficient."""
    taps = np.eye(1, ar.lags.reach + 1)[0]
    for a, first, last in zip(ar.coefficients, ar.lags.starts, ar.lags.ends, strict=True):
        taps[first : last + 1] = a
    return taps


def white(*shape: int, seed: int = 2) -> Array:
    return np.random.default_rng(seed).standard_normal(shape)


# -- which lags ------------------------------------------------------------------------------------------------------


def test_the_nearest_lags_have_a_coefficient_each_and_groups_widen_as_they_recede() -> None:
    assert Lags(2, 12).ends.tolist() == [1, 2, 3, 4, 5, 6, 7, 9, 11, 14, 17, 21, 26, 32]
    assert Lags(2, 12).starts.tolist() == [1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 18, 22, 27]
    assert Lags(13, 2).starts.tolist()[-2:] == [14, 15] and Lags(13, 2).ends.tolist()[-2:] == [14, 17]
    far = Lags(0, 30)
    widths = (far.ends - far.starts + 1)[far.starts >= 20]
    assert np.all(np.abs(widths / far.starts[far.starts >= 20] - 0.25) < 0.05)
    assert NO_NOISE_MODEL.reach == Lags().reach == Lags().order == Lags().starts.size == 0


@given(*FEW)
def test_groups_are_what_is_left_of_the_same_ones(single: int, groups: int) -> None:
    lags = Lags(single, groups)
    assert lags.order == single + groups == lags.starts.size == lags.ends.size
    covered = [lag for first, last in zip(lags.starts, lags.ends, strict=True) for lag in range(first, last + 1)]
    assert covered == list(range(1, lags.reach + 1))
    assert lags.ends[:single].tolist() == list(range(1, single + 1))
    assert set(lags.ends[single:]) <= set(Lags(0, 40).ends)


@given(*FEW, st.integers(0, 200))
def test_within_leaves_what_does_not_reach_further_and_no_less(single: int, groups: int, reach: int) -> None:
    found = Lags(single, groups).within(reach)
    assert found.reach <= reach
    assert found.single == min(single, reach) and found.groups <= groups
    assert found.groups == groups or Lags(found.single, found.groups + 1).reach > reach


@given(st.integers(0, 35), st.integers(0, 300))
def test_the_furthest_goes_as_far_as_it_may(single: int, reach: int) -> None:
    found = furthest(single, reach)
    assert found.single == min(single, reach)
    assert found.reach <= reach < Lags(found.single, found.groups + 1).reach


@pytest.mark.parametrize("lags", SOME)
def test_sums_over_the_lags_of_each_coefficient(lags: Lags) -> None:
    by_lag = white(3, lags.reach)
    parts = zip(lags.starts, lags.ends, strict=True)
    expected = np.array([by_lag[:, a - 1 : b].sum(axis=1) for a, b in parts]).reshape(lags.order, 3).T
    np.testing.assert_allclose(lags.summed(by_lag), expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(lags.summed(by_lag[0]), expected[0], rtol=1e-12, atol=1e-12)


# -- what a noise model does -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("waits", [0, 25, 70])
@pytest.mark.parametrize("lags", SOME)
def test_whitening_is_a_filter(lags: Lags, waits: int) -> None:
    """Signals of more than two blocks, about a level of a thousand."""
    ar = replace(model(lags), waits=waits)
    x = 1e3 + white(2500, 2)
    assert ar.order == lags.order and ar.reach == max(lags.reach, waits)
    np.testing.assert_array_equal(ar.taps, taps_of(ar))
    expected = lfilter(ar.taps, [1.0], x, axis=0)[ar.reach :]
    close = {"rtol": 0, "atol": 1e-12 * np.sum(np.abs(ar.taps)) * np.abs(x).max()}
    np.testing.assert_allclose(ar.whiten(x), expected, **close)
    np.testing.assert_allclose(ar.whiten(x[:, 1]), expected[:, 1], **close)
    np.testing.assert_allclose(ar.whitened_rows(np.ascontiguousarray(x.T), 40), expected[40:].T, **close)
    short = x[: ar.reach // 2 + 1]
    assert ar.whiten(short).shape == (max(len(short) - ar.reach, 0), 2)


def test_a_model_of_single_lags_filters_by_its_coefficients() -> None:
    coefficients, x = np.array([-0.9, 0.3]), white(50)
    np.testing.assert_array_equal(Autoregression.plain(coefficients).taps, [1.0, -0.9, 0.3])
    np.testing.assert_allclose(whiten(coefficients, x), x[2:] - 0.9 * x[1:-1] + 0.3 * x[:-2], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("waits", [0, 70])
@pytest.mark.parametrize("lags", SOME)
def test_the_past_is_what_coefficients_multiply(lags: Lags, waits: int) -> None:
    """Sums sample by sample; and prediction errors are linear in the coefficients."""
    ar, v = replace(model(lags), waits=waits), 10 + white(300)
    past, laid = lags.past(v, ar.reach), np.zeros((lags.order + 1, 300 - ar.reach))
    assert lags.past(v, ar.reach, laid[1:]).base is laid and not laid[0].any()
    np.testing.assert_array_equal(laid[1:], past)
    for row, first, last in zip(past, lags.starts, lags.ends, strict=True):
        sums = [sum(v[k - lag] for lag in range(first, last + 1)) for k in range(ar.reach, 300)]
        np.testing.assert_allclose(row, sums, rtol=1e-11)
    np.testing.assert_allclose(ar.whiten(v), v[ar.reach :] + ar.coefficients @ past, rtol=0, atol=1e-9)


@pytest.mark.parametrize("lags", SOME)
def test_near_taps_are_those_of_lags_with_a_coefficient_each(lags: Lags) -> None:
    ar = model(lags)
    alone = int(np.sum(lags.ends == np.arange(1, lags.order + 1)))
    np.testing.assert_array_equal(ar.near_taps, ar.taps[: alone + 1])
    assert alone >= min(lags.order, max(lags.single, 7))


def test_a_prediction_error_is_valid_if_all_that_it_reaches_was_measured() -> None:
    measured = white(400) < 2.3
    for ar in (model(Lags(3, 6)), replace(model(Lags(3, 6)), waits=20)):
        assert ar.valid(measured).tolist() == ar.lags.predicted(measured, ar.reach).tolist()
        assert 0 < ar.valid(measured).sum() < 400 - ar.reach
        assert not ar.valid(measured[: ar.reach]).size


def test_other_coefficients_leave_lags_and_waiting_as_they_are() -> None:
    ar = replace(model(Lags(2, 4)), waits=50)
    other = ar.with_coefficients(np.ones(6))
    assert (other.lags, other.waits) == (ar.lags, 50) and other.coefficients.tolist() == [1.0] * 6


# -- what is chosen --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [1, 2, 5])
def test_an_autoregression_of_single_lags_takes_no_groups(order: int) -> None:
    v = lfilter([1.0], np.r_[1.0, np.zeros(order - 1), -0.8], white(4000))
    assert choose_lags([v], [np.ones(v.size, dtype=bool)], 100) == Lags(order)


@pytest.mark.parametrize("louder", [5.0, 50.0])
def test_slow_drifts_below_measurement_noise_are_foretold_as_well_as_can_be(louder: float) -> None:
    """A pole of 1,000 samples and white noise of so many times its innovation, 60,000 samples, seed 3.

    The best is a Kalman filter, whose innovation variance the Riccati equation tells; the model's is that of the true
    autocovariance, and so has no sampling error. As many coefficients of single lags lose more than twice as much.
    """
    rng, pole, n = np.random.default_rng(3), np.exp(-1 / 1000), 60_000
    v = lfilter([1.0], [1.0, -pole], rng.standard_normal(n)) + louder * rng.standard_normal(n)
    one = np.eye(1)
    best = float(solve_discrete_are(pole * one, one, one, louder**2 * one)[0, 0]) + louder**2

    def foretold(taps: Array) -> float:
        covariance = pole ** np.arange(taps.size) / (1 - pole**2)
        covariance[0] += louder**2
        return float(taps @ toeplitz(covariance) @ taps)

    given = [v], [np.ones(n, dtype=bool)]
    lags = choose_lags(*given, n // 40)
    own = foretold(fit_autoregression(*given, lags).taps)
    single = foretold(Autoregression.plain(fit_ar(*given, lags.order)[0]).taps)
    assert lags.groups > 0 and lags.order < 40
    assert best < own < 1.01 * best
    assert own - best < (single - best) / 2


# -- missing samples -------------------------------------------------------------------------------------------------


@given(st.lists(st.booleans(), min_size=1, max_size=60), st.integers(0, 9), st.integers(0, 6), st.integers(0, 9))
def test_samples_are_predicted_where_the_near_ones_were_measured_and_few_of_the_far_ones_miss(
    measured: list[bool], single: int, groups: int, waits: int
) -> None:
    """Sample by sample: of the far past no more than three in a row may miss, between others."""
    ok, lags = np.array(measured), Lags(single, groups)
    reach = max(lags.reach, waits)
    near = next((lag - 1 for lag, last in zip(lags.starts, lags.ends, strict=True) if last > lag), reach)
    near = min(near, lags.order)
    bridged = [
        ok[k]
        or any(
            k - a >= 0 and k + b < ok.size and ok[k - a] and ok[k + b] and a + b <= 4
            for a in range(1, 4)
            for b in range(1, 4)
        )
        for k in range(ok.size)
    ]
    expected = [bool(ok[k - near : k + 1].all() and all(bridged[k - reach : k + 1])) for k in range(reach, ok.size)]
    assert lags.predicted(ok, reach).tolist() == expected


def test_missing_samples_are_bridged_by_those_beside_them() -> None:
    measured = np.array([True, False, False, True, True, False, True])
    assert bridge(np.array([1.0, 9, 9, 4, 2, 9, 8]), measured).tolist() == [1, 2, 3, 4, 2, 5, 8]


@pytest.mark.parametrize("lags", [Lags(7, 12), Lags(3)])
def test_one_sample_in_a_hundred_that_misses_costs_the_near_past_alone(lags: Lags) -> None:
    """Of the drift in 20,000 samples: its noise model is found as well as without gaps, to 0.5 % of the variance."""
    rng = np.random.default_rng(5)
    v = lfilter([1.0], [1.0, -np.exp(-1 / 1000)], rng.standard_normal(20_000)) + 5 * rng.standard_normal(20_000)
    measured = rng.random(v.size) > 0.01
    whole = fit_autoregression([v], [np.ones(v.size, dtype=bool)], lags)
    part = fit_autoregression([np.where(measured, v, 0.0)], [measured], lags)
    errors = [np.var(one.whiten(v)) for one in (whole, part)]
    assert errors[1] < 1.005 * errors[0]
    near = 7 if lags.groups else 3
    assert part.valid(measured).mean() == pytest.approx(0.99 ** (near + 1), abs=0.01)
