"""The change that would just have been found: against its definition, and by how often it is found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from trueplant.detect import detectable_change, least_known
from trueplant.detect.detectable import worth_knowing_of
from trueplant.lti import Structure

FOPDT = Structure.parse("fopdt")
THETA = np.array([-2.0, 10.0, 5.0])


@pytest.mark.parametrize(("errors", "share"), [((0.1, 0.1, 0.1), 0.05), ((0.02, 1.5, 0.1), 0.15), ((0, 0, 1.5), 0.1)])
def test_the_largest_share_of_gain_lag_and_dead_time_plus_lag(errors, share):
    found = detectable_change(FOPDT, THETA, np.diag(np.square(errors)), 1, 0.05, 10.0)
    assert found == pytest.approx(share * (norm.isf(0.025) + norm.ppf(0.8)))


@pytest.mark.holds("detect.POWER")
def test_a_change_of_that_size_is_found_in_four_of_five_records():
    """10,000 estimates of a gain among 4 elements, tested at 5 % over all: 0.80 within 4 standard deviations."""
    covariance = np.diag([0.2, 0.1, 0.1]) ** 2
    change = detectable_change(FOPDT, THETA, covariance, 4, 0.05, 10.0) * 2.0
    z = change / 0.2 + np.random.default_rng(1).standard_normal(10_000)
    assert np.mean(2 * norm.sf(np.abs(z)) < 0.05 / 4) == pytest.approx(0.8, abs=0.016)


def test_what_is_known_together_counts_together():
    """Two delayed terms: either gain is known to 100 %, their sum to 5 %; the dead times to 40 %, their mean to 5 %."""
    structure = Structure.parse("fopdt+delayed")
    theta = np.array([3.0, -1.0, 10.0, 4.0, 6.0])
    share = 0.05 * (norm.isf(0.025) + norm.ppf(0.8))

    def pair(single, mean):
        """Equal variances whose sum has the standard deviation `mean`."""
        return np.array([[single**2, mean**2 / 2 - single**2], [mean**2 / 2 - single**2, single**2]])

    covariance = np.zeros((5, 5))
    covariance[:2, :2], covariance[3:, 3:] = pair(2.0, 0.05 * 2.0), pair(4.0, 2 * 0.05 * 15.0)
    assert detectable_change(structure, theta, covariance, 1, 0.05, 10.0) == pytest.approx(share)


def test_a_lag_that_the_model_has_at_0_is_measured_as_a_dead_time():
    """0.3 of the lag of 0.1 and the dead time of 20, while the model says nothing of the lag: 3 times the lag."""
    theta, covariance, told = (
        np.array([2.0, 0.1, 20.0]),
        np.diag([0.001, 0.3, 0.001]) ** 2,
        norm.isf(0.025) + norm.ppf(0.8),
    )
    for model, share in (((2.0, 0.0, 20.0), 0.3 / 20.1), ((2.0, 0.2, 20.0), 3.0), ((), 3.0)):
        found = detectable_change(FOPDT, theta, covariance, 1, 0.05, 0.1, model=model)
        assert found == pytest.approx(told * share)
    worth = [worth_knowing_of(FOPDT, theta, model, 0.2, 0.1) for model in ((2.0, 0.0, 20.0), (2.0, 0.1, 20.0))]
    assert worth[0] == pytest.approx([0.4, 4.02, 4.02]) and worth[1] == pytest.approx([0.4, 0.02, 4.02])


def test_nothing_known_is_infinite():
    assert detectable_change(FOPDT, THETA, np.full((3, 3), np.inf), 1, 0.05, 10.0) == np.inf
    assert detectable_change(FOPDT, np.array([0.0, 10.0, 5.0]), np.eye(3), 1, 0.05, 10.0) == np.inf


def test_an_element_that_the_model_lacks_is_measured_by_what_pv_does():
    told = norm.isf(0.025) + norm.ppf(0.8)
    covariance = np.diag([0.1, 30.0, 30.0]) ** 2
    assert detectable_change(FOPDT, np.array([0.01, 10.0, 5.0]), covariance, 1, 0.05, 10.0, 4.0) == pytest.approx(
        told * 0.025
    )


@pytest.mark.parametrize(
    ("errors", "named"), [((1.0, 0.1, 0.1), "gain"), ((0.01, 9.0, 0.1), "lag"), ((0.01, 0.1, 9.0), "dead time")]
)
def test_what_is_known_least_is_named(errors, named):
    assert least_known(FOPDT, THETA, np.diag(np.square(errors)), 10.0) == named
