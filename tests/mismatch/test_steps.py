"""From step coefficients back to the transfer function that they are of."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from trueplant.errors import FormulaError
from trueplant.lti import MeasuredStep, Structure, structure_of, tf
from trueplant.mismatch.steps import fit_step

GAINS = st.floats(0.01, 100).flatmap(lambda g: st.sampled_from([g, -g]))


@settings(max_examples=25, deadline=None)
@given(gain=GAINS, tau=st.floats(2.0, 30.0), late=st.floats(0.0, 2.0), h=st.floats(0.5, 1.5))
def test_first_order_comes_back_with_its_dead_time_off_the_grid(gain, tau, late, h):
    dead_time = late * tau
    system = tf(f"{gain!r} exp(-{dead_time!r} s)/({tau!r} s + 1)")
    fitted = fit_step(MeasuredStep.of_system(system, h, int((7 * tau + dead_time) / h)))
    assert str(fitted.structure) == "fopdt"
    assert np.allclose(structure_of(fitted.system)[1], [gain, tau, dead_time], rtol=1e-4, atol=1e-4 * tau)
    assert fitted.error < 2e-3


@settings(max_examples=15, deadline=None)
@given(gain=GAINS, tau=st.floats(5.0, 30.0), ratio=st.floats(0.2, 0.7), late=st.floats(0.1, 1.0))
def test_second_order_comes_back(gain, tau, ratio, late):
    system = tf(f"{gain!r} exp(-{late * tau!r} s)/(({tau!r} s + 1)({ratio * tau!r} s + 1))")
    measured = MeasuredStep.of_system(system, tau / 12, 120)
    fitted = fit_step(measured, Structure.parse("sopdt"))
    assert np.allclose(structure_of(fitted.system)[1], [gain, tau, ratio * tau, late * tau], rtol=1e-4)
    assert str(fit_step(measured).structure) == "sopdt"


@pytest.mark.parametrize(
    ("formula", "h", "count", "structure"),
    [
        ("0.5 exp(-2.5 s)/s", 1.0, 30, "integrator"),
        ("-0.02 exp(-1.7 s)/(s (7 s + 1))", 1.0, 60, "integrator+lag"),
        ("2 exp(-1.2 s)/(25 s^2 + 4 s + 1)", 1.0, 150, "pair"),
        ("3 (-4 s + 1) exp(-2.2 s)/((10 s + 1)(6 s + 1))", 1.0, 120, "sopdt+lead"),
        ("2.5 (20 s + 1) exp(-3 s)/((30 s + 1)(4 s + 1))", 2.0, 150, "sopdt+lead"),
        ("1.5", 1.0, 10, "gain"),
    ],
)
def test_the_smallest_structure_that_suffices(formula, h, count, structure):
    system = tf(formula)
    fitted = fit_step(MeasuredStep.of_system(system, h, count))
    assert structure_of(fitted.system)[0] == Structure.parse(structure)
    w = np.geomspace(0.3 / (count * h), 2 / h, 40)
    assert np.allclose(fitted.system(1j * w), system(1j * w), rtol=2e-3)
    assert fitted.error < 2e-3


def test_error_says_what_a_structure_that_is_too_simple_misses():
    """A lag cannot follow an inverse response: what it misses is its largest undershoot or more."""
    measured = MeasuredStep.of_system(tf("3 (-4 s + 1)/((10 s + 1)(6 s + 1))"), 1.0, 120)
    fitted = fit_step(measured, Structure.parse("fopdt"))
    worst = np.max(np.abs(measured.values - MeasuredStep.of_system(fitted.system, 1.0, 120).values)) / 3
    assert fitted.error == pytest.approx(worst, rel=1e-2) and fitted.error > -measured.values.min() / 3
    assert 0 < fitted.at < 60


def test_noise_is_not_explained_by_more_parameters():
    rng = np.random.default_rng(3)
    exact = MeasuredStep.of_system(tf("2 exp(-3.37 s)/(10 s + 1)"), 1.0, 70)
    found = []
    for _ in range(20):
        noise = np.concatenate([[0.0], 0.02 * 2 * rng.standard_normal(70)])
        found.append(fit_step(MeasuredStep(exact.values + noise, 1.0)))
    assert sum(str(one.structure) == "fopdt" for one in found) >= 17
    gains = np.array([structure_of(one.system)[1][0] for one in found if str(one.structure) == "fopdt"])
    # the standard error of a mean over some 40 settled coefficients
    assert np.all(np.abs(gains - 2) < 4 * 0.04 / np.sqrt(40))


def test_more_parameters_than_coefficients_are_refused():
    few = MeasuredStep.of_system(tf("2/(3 s + 1)"), 2.0, 8)
    with pytest.raises(FormulaError, match="8 coefficients are too few for the 10 parameters"):
        fit_step(few, Structure.parse("sopdt+lag+lag+lead+lead+delayed"))


def test_impulse_responses_are_not_taken_for_step_responses():
    washed_out = MeasuredStep(MeasuredStep.of_system(tf("2 exp(-3 s)/(10 s + 1)"), 1.0, 80).fir, 1.0)
    with pytest.raises(FormulaError, match="ends where it began"):
        fit_step(washed_out)


def test_nothing_stays_nothing():
    fitted = fit_step(MeasuredStep(np.zeros(20), 1.0))
    assert fitted.system.is_zero and fitted.error == 0.0


@pytest.mark.parametrize("follows", [0.0, 0.8])
def test_scatter_of_the_coefficients_says_how_far_the_parameters_are_off(follows):
    """95 % intervals from the covariance, over simulated step tests with independent errors, and with slow ones."""
    exact = MeasuredStep.of_system(tf("2 exp(-3.4 s)/(10 s + 1)"), 1.0, 90)
    rng, inside = np.random.default_rng(1), []
    for _ in range(150):
        slow = lfilter([np.sqrt(1 - follows**2)], [1, -follows], rng.standard_normal(190))[-90:]
        noise = np.concatenate([[0.0], 0.02 * slow])
        fitted = fit_step(MeasuredStep(exact.values + noise, 1.0), Structure.parse("fopdt"))
        assert fitted.covariance is not None
        off = structure_of(fitted.system)[1] - [2.0, 10.0, 3.4]
        inside.append(np.abs(off) < 1.96 * np.sqrt(np.diag(fitted.covariance)))
    # four standard errors of a share of 150
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 150))


def test_exact_coefficients_have_exact_parameters():
    fitted = fit_step(MeasuredStep.of_system(tf("2 exp(-3.4 s)/((10 s + 1)(4 s + 1))"), 1.0, 90))
    assert fitted.covariance is not None
    assert np.all(np.sqrt(np.diag(fitted.covariance)) < 1e-6)
