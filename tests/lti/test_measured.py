"""Measured step responses: what they say of any input, time and frequency."""

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.signal import lfilter

from trueplant.errors import FormulaError
from trueplant.lti import MeasuredStep, largest_difference, sampled_response, tf
from trueplant.mismatch.sampling import sampled_frequency_response

LAG = tf("2 exp(-3.3 s)/(10 s + 1)")
RAMP = tf("0.5 exp(-2.5 s)/(s (4 s + 1))")


def test_fir_and_step_coefficients_say_the_same():
    coefficients = np.array([0.0, 0.3, 0.9, 1.4, 1.6])
    step = MeasuredStep.of(coefficients, 2.0)
    fir = MeasuredStep.of([0.0, 0.3, 0.6, 0.5, 0.2], 2.0, "fir")
    assert np.allclose(step.values, fir.values) and step.values[0] == 0.0
    assert np.allclose(step.fir, [0.0, 0.0, 0.3, 0.6, 0.5, 0.2])


@settings(deadline=None)
@given(seed=st.integers(0, 999))
def test_convolution_with_the_fir_is_the_response_to_any_held_input(seed):
    """Against the exact sampled response of the transfer function that the coefficients are of."""
    u = np.random.default_rng(seed).standard_normal(60)
    measured = MeasuredStep.of_system(LAG, 1.0, 59)
    assert np.allclose(np.convolve(measured.fir, u)[:60], sampled_response(LAG, u, 1.0), atol=1e-10)


def test_sampled_frequency_response_is_that_of_python_control():
    measured = MeasuredStep.of_system(LAG, 1.5, 20)
    w = np.geomspace(0.01, np.pi / 1.5, 30)
    z = control.TransferFunction(measured.fir, [1.0, *np.zeros(20)], dt=1.5)
    assert np.allclose(measured.sampled_frequency_response(w), z(np.exp(1j * w * 1.5)), rtol=1e-10)


@pytest.mark.parametrize(("system", "count"), [(LAG, 400), (RAMP, 400)], ids=["rests", "ramp"])
def test_long_responses_have_the_sampled_frequency_response_of_their_system(system, count):
    w = np.geomspace(0.01, 3.0, 30)
    measured = MeasuredStep.of_system(system, 1.0, count)
    exact = sampled_frequency_response(system, w, 1.0)
    assert measured.integrating == (system is RAMP)
    assert np.allclose(measured.sampled_frequency_response(w), exact, rtol=1e-8)


def test_frequency_response_is_the_transform_of_the_slope_between_the_coefficients():
    measured = MeasuredStep(np.array([0.2, 0.7, 1.5, 1.2]), 2.0)
    slopes = np.diff(measured.values) / 2.0
    for w in (0.1, 0.7, 1.5):
        expected = 0.2 + sum(
            slope * quad(lambda t, part=part, w=w: part(w * t), 2.0 * k, 2.0 * k + 2.0)[0] * unit
            for k, slope in enumerate(slopes)
            for part, unit in ((np.cos, 1.0), (np.sin, -1j))
        )
        assert measured.frequency_response(np.array([w]))[0] == pytest.approx(expected, rel=1e-10)
    assert np.isnan(measured.frequency_response(np.array([1.6]))).all()


def test_fine_coefficients_have_the_continuous_frequency_response():
    w = np.geomspace(0.01, 1.0, 20)
    for system in (LAG, RAMP):
        measured = MeasuredStep.of_system(system, 0.02, 10_000)
        assert np.allclose(measured.frequency_response(w), system(1j * w), rtol=2e-3)


def test_response_at_any_time():
    measured = MeasuredStep(np.array([0.0, 1.0, 4.0]), 2.0)
    assert np.allclose(measured([-1.0, 0.0, 1.0, 3.0, 4.0, 10.0]), [0.0, 0.0, 0.5, 2.5, 4.0, 4.0])
    ramp = MeasuredStep(np.array([0.0, 1.0, 4.0]), 2.0, integrating=True)
    assert np.allclose(ramp([4.0, 10.0]), [4.0, 13.0])


def test_a_response_that_was_cut_off_has_not_settled():
    assert MeasuredStep.of_system(tf("1/(10 s + 1)"), 1.0, 30).settled
    assert not MeasuredStep.of_system(tf("1/(10 s + 1)"), 1.0, 10).settled
    assert not MeasuredStep.of_system(RAMP, 1.0, 50).settled


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_noise_of_a_step_test_does_not_pass_for_a_response_that_still_moves(colour: float):
    """Slow noise of 2.5 % of the gain: hardly any settled response is taken for one that surely moves."""
    rng = np.random.default_rng(8)
    exact = MeasuredStep.of_system(tf("exp(-3 s)/(12 s + 1)"), 1.0, 90)
    cut = MeasuredStep.of_system(tf("exp(-3 s)/(12 s + 1)"), 1.0, 15)
    white = rng.standard_normal((1000, 150))
    noise = 0.025 * np.sqrt(1 - colour**2) * lfilter([1], [1, -colour], white)[:, -90:]
    noisy = [replace(exact, values=exact.values + np.r_[0.0, one]) for one in noise]
    assert sum(not one.settled and not one.settled_is_unclear for one in noisy) <= 20
    assert not cut.settled and not cut.settled_is_unclear
    ramp = MeasuredStep.of_system(RAMP, 1.0, 90)
    assert not ramp.settled and not ramp.settled_is_unclear


def test_difference_is_a_share_of_the_gain_and_counts_what_was_cut_off():
    measured = MeasuredStep.of_system(tf("2/(10 s + 1)"), 1.0, 30)
    error, at = largest_difference(measured, tf("2/(10 s + 1)"))
    assert error == pytest.approx(np.exp(-3) / (1 - np.exp(-3))) and at == 30.0
    error, at = largest_difference(MeasuredStep.of_system(LAG, 1.0, 200), LAG * 1.1)
    assert error == pytest.approx(0.1, rel=1e-6) and at == 200.0


@pytest.mark.parametrize(
    ("values", "h", "said"),
    [
        ([0.0], 1.0, "at least two"),
        ([0.0, np.nan], 1.0, "coefficient 1"),
        ([0.0, 1.0], 0.0, "above 0"),
        ([[0.0, 1.0], [0.0, 1.0]], 1.0, "one list"),
    ],
)
def test_what_is_no_response(values, h, said):
    with pytest.raises(FormulaError, match=said):
        MeasuredStep(np.array(values), h)
