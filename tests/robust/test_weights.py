"""Weights against the errors they stand for."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import UsageError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferMatrix, tf
from trueplant.plants import wood_berry
from trueplant.robust import (
    covariance_weight,
    covering_weight,
    gain_and_dead_time_weight,
    performance_weight,
    robust_performance,
    set_weight,
    uncertainty_weight,
)

W = np.geomspace(1e-3, 1e3, 4001)


def gain_and_dead_time_error(gain: float, dead_time: float, w: np.ndarray) -> np.ndarray:
    """Largest |k e^(-j w t) - 1| over |k - 1| <= gain, |t| <= dead_time, on a dense mesh of both."""
    k = np.linspace(1 - gain, 1 + gain, 3)[:, None, None]
    t = np.linspace(0, dead_time, 400)[:, None]
    return np.abs(k * np.exp(-1j * w * t) - 1).max(axis=(0, 1))


def test_published_weights():
    s = 1j * W
    printed = (0.21 * s + 0.1) / (0.1 * s + 1)
    assert gain_and_dead_time_weight(0.1, 0.2)(s) == pytest.approx(printed, rel=1e-12)
    assert uncertainty_weight(0.1, 0.21, 2.1)(s) == pytest.approx(printed, rel=1e-12)
    assert performance_weight(0.05, 1 / 0.45)(s) == pytest.approx((0.45 * s + 0.05) / s, rel=1e-12)


def test_performance_weight_has_the_limits_of_its_parameters():
    weight = performance_weight(bandwidth=0.3, M=2.0, A=1e-3)
    assert abs(weight(0)) == pytest.approx(1e3) and abs(weight(1e9j)) == pytest.approx(0.5, rel=1e-6)


@pytest.mark.parametrize("gain", [0.0, 0.1, 0.5])
def test_gain_and_dead_time_weight_stands_for_the_error(gain):
    w = np.geomspace(0.02, 20, 300)
    exact = gain_and_dead_time_error(gain, 0.7, w)
    simple = np.abs(gain_and_dead_time_weight(gain, 0.7)(1j * w)) / exact
    assert 0.82 < simple.min() < 0.84 and w[simple.argmin()] == pytest.approx(2.6 / 0.7, rel=0.05)
    covering = np.abs(gain_and_dead_time_weight(gain, 0.7, covers=True)(1j * w)) / exact
    assert covering.min() > 1 - 1e-4 and covering.max() < 1.3


def first_order(theta: np.ndarray) -> np.ndarray:
    s = 1j * np.geomspace(0.01, 3, 25)
    return (theta[0] * np.exp(-theta[2] * s) / (theta[1] * s + 1))[:, None, None]


@pytest.mark.parametrize("kind", ["input", "output", "additive"])
def test_covariance_weight_is_the_largest_error_on_the_ellipsoid(kind):
    theta = np.array([2.0, 5.0, 1.5])
    root = 1e-4 * np.array([[1.0, 0, 0], [0.8, 3.0, 0], [-0.2, 0.3, 0.6]])
    weight = covariance_weight(first_order, theta, root @ root.T, kind, confidence=0.9)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radius = np.sqrt(6.251388631170325)  # 90 % of chi-square with 3 degrees of freedom
    nominal = first_order(theta)
    errors = np.array([first_order(theta + radius * root @ d) - nominal for d in directions])[..., 0, 0]
    sizes = np.abs(errors if kind == "additive" else errors / nominal[:, 0, 0]).max(axis=0)
    assert np.all(sizes <= weight * 1.001) and np.all(sizes > 0.99 * weight)


def test_covariance_weight_holds_the_promised_share_of_plants():
    """600 plants each: passes with 0.998 where 20 % lie outside, as promised, with less than 1e-6 where 80 % do."""
    shape = TransferMatrix.of([["-0.58/(10 s + 1)", "4 exp(-3 s)/(15 s + 1)"], ["0", "3.8 exp(-0.5 s)/(2.8 s + 1)"]])
    base = shape(1j * np.geomspace(0.01, 1, 12))

    def response(theta: np.ndarray) -> np.ndarray:
        return base * np.array([[theta[0], theta[1]], [1.0, theta[2]]])

    spread = np.diag([0.02, 0.03, 0.01]) ** 2
    for kind in ("input", "output"):
        weight = covariance_weight(response, np.ones(3), spread, kind, confidence=0.8)
        rng = np.random.default_rng(1)
        plants = np.array([response(theta) for theta in rng.multivariate_normal(np.ones(3), spread, 600)])
        inverse = np.linalg.inv(base)
        errors = inverse @ (plants - base) if kind == "input" else (plants - base) @ inverse
        inside = np.all(np.linalg.norm(errors, ord=2, axis=(2, 3)) <= weight, axis=1)
        assert inside.mean() > 0.8 - 3 * np.sqrt(0.8 * 0.2 / 600)


def test_covering_weight_covers_and_finds_a_weight_of_its_own_form():
    w = np.geomspace(1e-2, 1e2, 60)
    own = tf("(2 s + 0.1)/(0.8 s + 1)")
    found = covering_weight(w, np.abs(own(1j * w)))
    assert np.abs(found(1j * w)) == pytest.approx(np.abs(own(1j * w)), rel=1e-3)
    error = gain_and_dead_time_error(0.1, 0.2, w)
    cover = np.abs(covering_weight(w, error)(1j * w)) / error
    assert cover.min() >= 1 - 1e-9 and np.mean(np.log(cover)) < 0.2


def test_weight_of_a_set_is_the_error_of_its_worst_member():
    """Gains within 10 % and dead times up to 0.7: for a single element the closed mesh of both, of any kind."""
    w = np.geomspace(0.02, 20, 120)
    k, t = np.linspace(0.9, 1.1, 3)[:, None], np.linspace(0, 0.7, 400)[:, None, None]
    nominal = 3 / (5j * w + 1)
    members = (nominal * k * np.exp(-1j * w * t)).reshape(-1, w.size)[..., None, None]
    expected = gain_and_dead_time_error(0.1, 0.7, w)
    for kind in ("input", "output"):
        assert set_weight(nominal[:, None, None], members, kind) == pytest.approx(expected, rel=1e-12)
    additive = set_weight(nominal[:, None, None], members, "additive")
    assert additive == pytest.approx(expected * np.abs(nominal), rel=1e-12)


@pytest.mark.parametrize("kind", ["input", "output", "additive"])
def test_robust_performance_under_the_weight_of_a_set_holds_for_each_member(kind):
    """Wood and Berry's column with perturbed gains, lags and dead times: the promise is looked at plant by plant."""
    case = wood_berry()
    law = Controller.diagonal([PID(Kc=0.375, Ti=8.29), PID(Kc=-0.0754, Ti=23.6)])
    rng = np.random.default_rng(5)
    gains, lags, dead = [[12.8, -18.9], [6.6, -19.4]], [[16.7, 21.0], [10.9, 14.4]], [[1.0, 3.0], [7.0, 3.0]]

    def member() -> TransferMatrix:
        g, tau, theta = (np.array(x) * rng.uniform(0.97, 1.03, (2, 2)) for x in (gains, lags, dead))
        return TransferMatrix.of(
            [[f"{g[i, j]} exp(-{theta[i, j]} s)/({tau[i, j]} s + 1)" for j in range(2)] for i in range(2)]
        )

    plants = [member() for _ in range(12)]
    w = np.geomspace(1e-5, 30, 400)
    size = set_weight(case.model(1j * w), np.array([p(1j * w) for p in plants]), kind)
    weight, asked = covering_weight(w, size), tf("(0.25 s + 0.005)/(s + 1e-9)")
    structure = kind if kind == "additive" else f"{kind} full"
    found = robust_performance(case.model, law, weight, asked, structure)
    assert found.passes
    for plant in plants:
        assert unstable_poles(plant, law) == 0
        S = np.linalg.inv(np.eye(2) + plant(1j * w) @ law(1j * w))
        assert np.max(np.abs(asked(1j * w)) * np.linalg.norm(S, ord=2, axis=(1, 2))) < 1


def test_wrong_weights_are_named():
    with pytest.raises(UsageError, match="kind of uncertainty"):
        set_weight(np.ones((2, 1, 1)), np.ones((3, 2, 1, 1)), "both")
    with pytest.raises(UsageError, match="needs the shape"):
        set_weight(np.ones((2, 1, 1)), np.ones((2, 1, 1)))
    with pytest.raises(UsageError, match='take kind "additive"'):
        set_weight(np.ones((2, 1, 2)), np.ones((3, 2, 1, 2)))
    with pytest.raises(UsageError, match="tau must be a number above 0"):
        uncertainty_weight(0.1, 0.0, 2.0)
    with pytest.raises(UsageError, match="A must be a number of 0 or more"):
        performance_weight(0.1, 2.0, -1.0)
    with pytest.raises(UsageError, match="dead_time must be"):
        gain_and_dead_time_weight(0.1, float("nan"))
    with pytest.raises(UsageError, match="kind of uncertainty"):
        covariance_weight(first_order, np.ones(3), np.eye(3), "both")
    with pytest.raises(UsageError, match="3 by 3"):
        covariance_weight(first_order, np.ones(3), np.eye(2))
    with pytest.raises(UsageError, match="semi-definite"):
        covariance_weight(first_order, np.ones(3), -np.eye(3))
    with pytest.raises(UsageError, match="confidence"):
        covariance_weight(first_order, np.ones(3), np.eye(3), confidence=95.0)
    with pytest.raises(UsageError, match="as many magnitudes"):
        covering_weight([1.0], [1.0])
    with pytest.raises(UsageError, match="above 0"):
        covering_weight([1.0, 2.0], [1.0, 0.0])
