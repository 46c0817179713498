"""The exact sampled frequency response against simulation, the sum over aliases and python-control."""

from __future__ import annotations

import control
import numpy as np
import pytest

from trueplant.errors import FormulaError
from trueplant.lti import TransferMatrix, tf
from trueplant.lti.sampled import sampled_response
from trueplant.mismatch import hold_response, sampled_frequency_response

W = np.array([0.05, 0.4, 1.3, 3.0])


@pytest.mark.parametrize("hold", ["zoh", "linear", "written"])
@pytest.mark.parametrize(
    "formula",
    [
        "2",
        "3 exp(-1.5 s)",
        "2 exp(-0.73 s)/(3 s + 1)",
        "4 (1 - 1.1 exp(-0.47 s)) exp(-0.2 s)/((2 s + 1)(6 s + 1))",
        "(s + 3) exp(-0.5 s)/(s + 1)",
        "(-4 s + 0.5)/(s^2 + s + 4)",
    ],
)
def test_sampled_response_reproduces_a_sinusoid_in_steady_state(formula, hold):
    h, n = 0.5, 400
    g = tf(formula)
    t = h * np.arange(n)
    for w, value in zip(W, sampled_frequency_response(g, W, h, hold), strict=True):
        y = sampled_response(g, np.cos(w * t), h, hold) + 1j * sampled_response(g, np.sin(w * t), h, hold)
        np.testing.assert_allclose(y[-20:], value * np.exp(1j * w * t[-20:]), atol=1e-11)


@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_sampled_response_is_the_sum_over_aliases(hold):
    h = 0.5
    g = tf("2 exp(-0.73 s)/((3 s + 1)(0.5 s + 1))")
    aliases = W[:, None] + 2 * np.pi / h * np.arange(-4000, 4001)[None, :]
    value = (g(1j * aliases) * hold_response(aliases, h, hold)).sum(axis=1)
    np.testing.assert_allclose(sampled_frequency_response(g, W, h, hold), value, atol=1e-7)


def test_sampled_response_agrees_with_python_control():
    h = 0.3
    discrete = control.sample_system(control.tf([1.0, 0.4], [2.0, 1.0, 0.7]), h, "zoh")
    found = sampled_frequency_response(tf("(s + 0.4) exp(-0.6 s)/(2 s^2 + s + 0.7)"), W, h)
    np.testing.assert_allclose(found, discrete(np.exp(1j * W * h)) * np.exp(-0.6j * W), rtol=1e-10)


def test_matrix_holds_are_one_for_each_input():
    g = TransferMatrix.of([["1/(s + 1)", "1/(s + 1)"], ["0", "1/s"]])
    value = sampled_frequency_response(g, W, 0.2, ("zoh", "linear"))
    np.testing.assert_allclose(value[:, 0, 1], sampled_frequency_response(g[0, 1], W, 0.2, "linear"))
    assert np.all(value[:, 1, 0] == 0)
    assert np.all(np.abs(value[:, 0, 0] - value[:, 0, 1]) > 1e-4)
    np.testing.assert_allclose(value[:, 1, 1], 0.1 * (1 + np.exp(-0.2j * W)) / (1 - np.exp(-0.2j * W)), rtol=1e-9)


def test_improper_elements_are_refused():
    with pytest.raises(FormulaError, match="improper"):
        sampled_frequency_response(tf("s"), W, 0.1)
    with pytest.raises(FormulaError, match="hold must be"):
        hold_response(W, 0.1, "cubic")
