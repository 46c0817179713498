"""The sampled response is exact: against closed forms, other libraries and itself on a finer grid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm as scipy_expm
from scipy.signal import cont2discrete, lfilter

from trueplant.errors import FormulaError
from trueplant.lti import TransferMatrix, sampled_response, tf
from trueplant.lti.sampled import expm, rows_response

ELEMENTS = [
    "2 exp(-3.4 s)/(5 s + 1)",
    "4 (1 - 0.9938 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))",
    "0.3 exp(-0.7 s)/s",
    "(-6400 s + 1600)/(s^4 + 5 s^3 + 408 s^2 + 416 s + 1600)",
    "(-4 s + 0.5) exp(-8 s)/(s^2 + s + 4)",
    "(2 s + 1)/(5 s + 1)",
    "3 exp(-0.25 s)",
]


def test_step_response_of_a_lag_with_fractional_dead_time():
    t = np.arange(200) * 0.5
    expected = np.where(t > 3.4, 2 * (1 - np.exp(-np.maximum(t - 3.4, 0) / 5)), 0)
    y = sampled_response(tf("2 exp(-3.4 s)/(5 s + 1)"), np.ones(200), 0.5)
    assert np.max(np.abs(y - expected)) < 1e-14


def test_ramp_response_of_a_lag_under_linear_hold():
    t = np.arange(300) * 0.1
    late = np.maximum(t - 0.73, 0)
    expected = 2 * (late - 5 + 5 * np.exp(-late / 5))
    y = sampled_response(tf("2 exp(-0.73 s)/(5 s + 1)"), t, 0.1, "linear")
    assert np.max(np.abs(y - expected)) < 1e-12


@pytest.mark.parametrize("formula", ELEMENTS)
@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_the_same_on_a_finer_grid(formula, hold):
    rng = np.random.default_rng(1)
    u = np.cumsum(rng.standard_normal(120))
    u[0] = 0.0  # a linear hold rises from 0 before the record
    h, fine = 0.5, 10
    at = np.arange(119 * fine + 1) / fine
    refined = np.interp(at, np.arange(120), u) if hold == "linear" else u[np.floor(at + 1e-9).astype(int)]
    y = sampled_response(tf(formula), u, h, hold)
    z = sampled_response(tf(formula), refined, h / fine, hold)
    if formula == "3 exp(-0.25 s)" and hold == "zoh":
        # A held input seen after half a sample of pure delay is the one before.
        assert np.array_equal(y[1:], 3 * u[:-1])
        return
    assert np.max(np.abs(y - z[::fine])) < 1e-9 * np.max(np.abs(y))


@pytest.mark.parametrize(
    "formula",
    [
        "1/((2 s + 1)(6 s + 1))",
        "(3 s + 1)/((2 s + 1)(6 s + 1)(s + 1))",
        "(-6400 s + 1600)/(s^4 + 5 s^3 + 408 s^2 + 416 s + 1600)",
        "1/((s^4 + 5 s^3 + 408 s^2 + 416 s + 1600)(0.2 s + 1))",
    ],
)
def test_against_scipy_discretisation(formula):
    system = tf(formula)
    term = system.terms[0]
    u = np.random.default_rng(2).standard_normal(400)
    h, samples = 0.05, 7
    num, den, _ = cont2discrete((term.num, term.den), h)
    expected = lfilter(num.ravel(), den, np.concatenate([np.zeros(samples), u[:-samples]]))
    y = sampled_response(system * tf(f"exp(-{samples * h} s)"), u, h)
    assert np.max(np.abs(y - expected)) < 1e-7 * np.max(np.abs(expected))


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 60))
@settings(max_examples=60, deadline=None)
def test_matrix_exponential_against_scipy(seed, size):
    m = np.random.default_rng(seed).standard_normal((4, 4)) * size
    expected = scipy_expm(m)
    assert np.max(np.abs(expm(m) - expected)) <= 1e-11 * max(size, 1) * np.max(np.abs(expected))


def test_matrix_adds_its_elements_each_with_its_hold():
    G = TransferMatrix.of([["1/(s + 1)", "2 exp(-0.3 s)/(3 s + 1)"]])
    u = np.random.default_rng(3).standard_normal((50, 2))
    y = sampled_response(G, u, 0.2, ("zoh", "linear"))
    expected = sampled_response(G[0, 0], u[:, 0], 0.2) + sampled_response(G[0, 1], u[:, 1], 0.2, "linear")
    assert np.allclose(y[:, 0], expected, rtol=1e-14)


def test_improper_systems_and_unknown_holds_are_refused():
    with pytest.raises(FormulaError, match="improper"):
        sampled_response(tf("s + 1"), np.ones(5), 0.1)
    with pytest.raises(FormulaError, match="hold"):
        sampled_response(tf("1/(s + 1)"), np.ones(5), 0.1, "cubic")


@pytest.mark.parametrize("hold", ["zoh", "linear"])
@pytest.mark.parametrize("samples", [60, 61, 65])
def test_thinned_responses_are_those_of_every_sample(hold, samples):
    u = np.random.default_rng(samples).standard_normal(samples)
    for states in range(6):
        num, den = np.zeros((2, states + 1)), np.poly(-0.3 * np.arange(1, states + 1))
        num[0, -2:], num[1, -1] = [1.0, 3.0][-states - 1 :], 2.0
        whole = rows_response(num, den, 2.3, u, 0.5, hold)
        for every in (1, 2, 6):
            assert np.array_equal(rows_response(num, den, 2.3, u, 0.5, hold, every), whole[:, ::every])


@pytest.mark.parametrize("dead_time", [1e300, np.inf, np.nan, -2.5])
def test_a_dead_time_out_of_all_bounds_does_no_harm(dead_time):
    """A search may try it: later than the record there is no response, and no number gives none."""
    u = np.linspace(0.0, 1.0, 50)
    y = rows_response(np.array([[0.0, 1.0]]), np.array([1.0, 0.5]), dead_time, u, 1.0)
    assert y.shape == (1, 50)
    if np.isnan(dead_time):
        assert np.isnan(y).all()
    elif dead_time > 0:
        assert not y.any()
