"""D-K iteration: its parts by their definitions; the textbook's column, where slycot is installed."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from trueplant.errors import UsageError
from trueplant.loop import unstable_poles
from trueplant.lti import TransferMatrix, tf
from trueplant.plants import skogestad_distillation
from trueplant.robust import generalised_plant, robust_performance
from trueplant.tune import dk_iteration
from trueplant.tune.mu_synthesis import (
    Corners,
    _balanced,
    _closed,
    _generalised,
    _realised,
    _response,
    _scaled,
    _shortened,
    fit_size,
)
from trueplant.tune.state_space import StateSpace, realised

CASE = skogestad_distillation()
W = np.logspace(-3, 3, 61)
SLYCOT = "slycot is GPL, so a user's own choice: install trueplant[hinf] for D-K iteration"


def of_controller(controller) -> StateSpace:
    """A state-space form of a stable controller of transfer functions."""
    rows = [[controller.entries[i, j].tf for j in range(controller.n_y)] for i in range(controller.n_u)]
    return realised(TransferMatrix(tuple(map(tuple, rows))), 1)


def test_size_is_fitted_where_it_can_be():
    exact = Corners(3.0, np.array([0.02, 5.0]), np.array([0.3, 40.0]))
    size = np.abs(exact.response(1j * W))
    found = fit_size(W, size, np.ones(61), 2)
    np.testing.assert_allclose(np.abs(found.response(1j * W)), size, rtol=1e-5)
    assert np.all(found.zeros > 0) and np.all(found.poles > 0)
    # what it cannot follow it follows better with more corners
    bump = 1 + 5 / (1 + np.log(W) ** 2)
    errors = [np.abs(np.log(np.abs(fit_size(W, bump, np.ones(61), k).response(1j * W)) / bump)).max() for k in (1, 4)]
    assert errors[1] < 0.3 * errors[0]


def test_parts_in_series_have_the_response_of_the_whole():
    corners = Corners(3.0, np.array([0.02, 5.0]), np.array([0.3, 40.0]))
    s = 1j * W
    for inverse in (False, True):
        product = np.prod([_response(part, s)[:, 0, 0] for part in corners.parts(inverse)], axis=0)
        np.testing.assert_allclose(product, corners.response(s) ** (-1 if inverse else 1), rtol=1e-10)


def test_plant_closed_by_a_controller_is_N_of_robust_performance():
    P = _generalised(realised(CASE.model, 1), _realised(CASE.uncertainty), _realised(CASE.performance))
    s = 1j * W
    N = _closed(_response(P, s), _response(of_controller(CASE.controller), s), 2, 2)
    expected = generalised_plant(CASE.model, CASE.controller, CASE.uncertainty, CASE.performance, s)
    np.testing.assert_allclose(N, expected, rtol=1e-6, atol=1e-8)
    scalings = [Corners(2.0, np.array([1.0]), np.array([3.0])), Corners(0.3, np.array([7.0]), np.array([0.1]))]
    scaled = _closed(_response(_scaled(P, scalings, 2), s), _response(of_controller(CASE.controller), s), 2, 2)
    d = np.stack([*(each.response(s) for each in scalings), np.ones(61), np.ones(61)], axis=1)
    np.testing.assert_allclose(scaled, d[:, :, None] * expected / d[:, None, :], rtol=1e-6, atol=1e-8)


def test_balancing_keeps_the_response_and_leaves_out_what_does_nothing():
    plant = realised(CASE.model, 1)
    found = _balanced(plant, 1e-9)
    assert len(plant.A) == 4 and len(found.A) == 2
    np.testing.assert_allclose(_response(found, 1j * W), CASE.model(1j * W), rtol=1e-8)
    reach = [_response(_shortened(plant, lambda law, n=n: len(law.A) >= n), 1j * W) for n in (1, 2)]
    error = [np.abs(r - CASE.model(1j * W)).max() for r in reach]
    assert error[1] < 1e-6 < error[0]


def test_without_slycot_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "slycot", None)
    with pytest.raises(UsageError, match=r"trueplant\[hinf\]"):
        dk_iteration(CASE.model, CASE.uncertainty, CASE.performance, W)


def test_the_column_of_the_textbook():
    """Skogestad and Postlethwaite (2005), section 8.12: 0.974 is the best there; four rounds come near."""
    pytest.importorskip("slycot", reason=SLYCOT)
    found = dk_iteration(CASE.model, CASE.uncertainty, CASE.performance, W)
    assert found.rounds[0].mu == pytest.approx(1.18, abs=0.01)
    peaks = [each.mu for each in found.rounds]
    assert 0.974 < min(peaks) < 1.03 and np.all(np.diff(peaks) < 0.005)
    for each in found.rounds:
        assert each.mu <= each.gamma * 1.01
    assert unstable_poles(CASE.model, found.controller) == 0
    # what it says of the reduced controller is what robust_performance says of it, and far from the inverse's 5.77
    again = robust_performance(CASE.model, found.controller, CASE.uncertainty, CASE.performance)
    assert found.robustness.RP.upper == pytest.approx(again.RP.upper, rel=1e-9) and again.RP.upper < 1.08
    inside = (again.w >= W[0]) & (again.w <= W[-1])
    assert again.performance[inside, 1].max() <= 1.02 * min(peaks)


def test_an_integrator_in_the_weight_makes_the_controller_integrate():
    pytest.importorskip("slycot", reason=SLYCOT)
    found = dk_iteration(CASE.model, CASE.uncertainty, "(0.5 s + 0.05)/s", W, rounds=2)
    assert found.robustness.RP.upper < 1.1
    low = np.array([1e-7j])
    S = np.linalg.inv(np.eye(2) + CASE.model(low) @ found.controller(low))
    assert np.linalg.norm(S[0], 2) < 1e-4


def test_wrong_input_is_named():
    pytest.importorskip("slycot", reason=SLYCOT)
    with pytest.raises(UsageError, match="at least 9 rising frequencies"):
        dk_iteration(CASE.model, CASE.uncertainty, CASE.performance, [1.0, 2.0])
    with pytest.raises(UsageError, match="one fraction without dead time"):
        dk_iteration(CASE.model, tf("0.2 exp(-s)"), CASE.performance, W)
    with pytest.raises(UsageError, match="unstable pole"):
        dk_iteration(CASE.model, CASE.uncertainty, "1/(s - 1)", W)
    with pytest.raises(UsageError, match="at least one round"):
        dk_iteration(CASE.model, CASE.uncertainty, CASE.performance, W, rounds=0)
