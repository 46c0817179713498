"""Total delay and phase against closed forms, and against differences of the response itself."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.lti import Structure
from trueplant.lti.delay import phase, total_delay

CASES = {
    "fopdt": [2.0, 10.0, 3.0],
    "sopdt+lead": [-1.5, 12.0, 4.0, -2.5, 1.2],
    "sopdt+delayed": [4.0, -3.9, 6.0, 2.0, 0.2, 0.67],
    "integrator+lag": [0.3, 5.0, 2.0],
    "pair+lead": [1.7, 0.4, 0.3, 3.0, 0.8],
    "gain": [2.5],
}


@pytest.mark.parametrize("w", [0.0, 0.07, 0.4])
def test_of_a_first_order_element(w):
    """tau/(1 + (w tau)^2) + theta, its derivatives by hand."""
    gain, tau, theta = CASES["fopdt"]
    value, gradient = total_delay(Structure.parse("fopdt"), np.array([gain, tau, theta]), w)
    assert value == pytest.approx(tau / (1 + (w * tau) ** 2) + theta)
    by_tau = (1 - (w * tau) ** 2) / (1 + (w * tau) ** 2) ** 2
    np.testing.assert_allclose(gradient, [0.0, by_tau, 1.0], atol=1e-12)


def test_at_rest_it_is_lags_less_leads_and_the_weighted_dead_time():
    value, _ = total_delay(Structure.parse("sopdt+lead"), np.array(CASES["sopdt+lead"]), 0.0)
    assert value == pytest.approx(12.0 + 4.0 + 2.5 + 1.2)
    value, gradient = total_delay(Structure.parse("sopdt+delayed"), np.array(CASES["sopdt+delayed"]), 0.0)
    mean = (4.0 * 0.2 - 3.9 * 0.67) / 0.1
    assert value == pytest.approx(8.0 + mean)
    np.testing.assert_allclose(gradient, [(0.2 - mean) / 0.1, (0.67 - mean) / 0.1, 1.0, 1.0, 40.0, -39.0])
    value, _ = total_delay(Structure.parse("pair+lead"), np.array(CASES["pair+lead"]), 0.0)
    assert value == pytest.approx(2 * 0.3 / 0.4 - 3.0 + 0.8)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("w", [0.05, 0.3, 1.1])
def test_it_is_the_slope_of_the_phase(name, w):
    structure, p = Structure.parse(name), np.array(CASES[name])
    value, gradient = total_delay(structure, p, w)
    near = w + np.array([-1e-5, 1e-5])
    turned = np.diff(np.unwrap(np.angle(structure.transfer(p)(1j * near))))[0] / 2e-5
    assert value == pytest.approx(-turned, rel=1e-6, abs=1e-7)
    for k, size in enumerate(np.eye(p.size) * 1e-6):
        slope = (total_delay(structure, p + size, w)[0] - total_delay(structure, p - size, w)[0]) / 2e-6
        assert gradient[k] == pytest.approx(slope, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_the_phase_is_that_of_the_response_followed_from_low_frequencies(name):
    structure, p = Structure.parse(name), np.array(CASES[name])
    w = np.geomspace(1e-5, 3.0, 4000)
    followed = np.unwrap(np.angle(structure.transfer(p)(1j * w)))
    own = np.array([phase(structure, p, one) for one in w])
    np.testing.assert_allclose(np.exp(1j * own), np.exp(1j * followed), atol=1e-9)
    if structure.delayed == 1:  # two terms together may turn any number of times on the way
        np.testing.assert_allclose(own, followed, atol=1e-9)
