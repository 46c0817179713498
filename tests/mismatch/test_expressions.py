"""The expressions (17)-(20) against loops solved directly, any size, with and without disturbances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from trueplant.errors import LoopError, Refused, UsageError
from trueplant.mismatch import (
    closed_form,
    closed_form_covariance,
    consistency,
    joint,
    plant_covariance,
    standard_errors,
)

N_S = 7


def complex_normal(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


class Loop:
    """Random matrices at N_S points; u solves u = Q (F r - y), y = G u + v."""

    def __init__(self, rng, n, n_experiments=None, v=0.0, two_degrees=False):
        n_experiments = n_experiments or n
        self.G = complex_normal(rng, N_S, n, n)
        self.Ghat = self.G + 0.3 * complex_normal(rng, N_S, n, n)
        self.Q = complex_normal(rng, N_S, n, n) + 2 * np.eye(n)
        self.F = complex_normal(rng, N_S, n, n) + 2 * np.eye(n) if two_degrees else None
        self.R = complex_normal(rng, N_S, n, n_experiments)
        self.V = v * complex_normal(rng, N_S, n, n_experiments)
        reference = self.R if self.F is None else self.F @ self.R
        self.U = np.linalg.solve(np.eye(n) + self.Q @ self.G, self.Q @ (reference - self.V))
        self.Y = self.G @ self.U + self.V
        self.E = self.Y - self.Ghat @ self.U


@settings(deadline=None, max_examples=40, derandomize=True)
@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(0, 3), st.sampled_from([0.0, 0.7]), st.booleans())
def test_closed_form_is_exact(seed, n, extra, v, two_degrees):
    loop = Loop(np.random.default_rng(seed), n, n + extra, v, two_degrees)
    found = closed_form(loop.R, loop.E, loop.Ghat, loop.Q, loop.V, loop.F)
    scale = np.max(found.condition) * np.max(np.linalg.cond(np.eye(n) - found.X)) * np.max(np.linalg.cond(loop.Q))
    np.testing.assert_allclose(found.plant, loop.G, atol=1e-14 * scale * 100)
    np.testing.assert_allclose(found.delta, loop.G - loop.Ghat, atol=1e-14 * scale * 100)


@settings(deadline=None, max_examples=20, derandomize=True)
@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(0, 2))
def test_joint_equals_closed_form_without_noise(seed, n, extra):
    loop = Loop(np.random.default_rng(seed), n, n + extra)
    closed = closed_form(loop.R, loop.E, loop.Ghat, loop.Q)
    other = joint(loop.R, loop.Y, loop.U, loop.Ghat)
    np.testing.assert_allclose(other.X, closed.X, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(other.delta, closed.delta, rtol=1e-5, atol=1e-7)


def test_X_is_delta_Q_S():
    loop = Loop(np.random.default_rng(1), 3)
    found = closed_form(loop.R, loop.E, loop.Ghat, loop.Q)
    S = np.linalg.inv(np.eye(3) + loop.G @ loop.Q)
    np.testing.assert_allclose(found.X, (loop.G - loop.Ghat) @ loop.Q @ S, atol=1e-11)
    np.testing.assert_allclose(np.eye(3) - found.X, (np.eye(3) + loop.Ghat @ loop.Q) @ S, atol=1e-11)


def test_small_mismatch_keeps_its_digits():
    """The form without subtraction: a mismatch of 1e-9 of the plant is found to better than 1e-5 of itself."""
    rng = np.random.default_rng(3)
    loop = Loop(rng, 2)
    delta = 1e-9 * complex_normal(rng, N_S, 2, 2)
    G = loop.Ghat + delta
    U = np.linalg.solve(np.eye(2) + loop.Q @ G, loop.Q @ loop.R)
    found = closed_form(loop.R, delta @ U, loop.Ghat, loop.Q)
    np.testing.assert_allclose(found.delta, delta, rtol=1e-5)


def test_joint_needs_no_square_plant():
    rng = np.random.default_rng(4)
    G = complex_normal(rng, N_S, 3, 2)
    W = complex_normal(rng, N_S, 2, 4)
    U = complex_normal(rng, N_S, 2, 2) @ W
    np.testing.assert_allclose(joint(W, G @ U, U).plant, G, atol=1e-10)
    wide = complex_normal(rng, N_S, 2, 3)
    W = complex_normal(rng, N_S, 3, 3)
    U = complex_normal(rng, N_S, 3, 3) @ W
    found = joint(W, wide @ U, U)
    np.testing.assert_allclose(found.plant, wide, atol=1e-9)
    np.testing.assert_array_equal(found.plant, found.delta)


def test_infinite_controller_gain_gives_the_plant_at_rest():
    """At s = 0 integral action makes e = (G - Ghat) G^-1 r whatever the controller."""
    G = np.array([[[2.0, 0.5], [0.3, 1.5]]], dtype=complex)
    Ghat = np.array([[[1.8, 0.4], [0.4, 1.7]]], dtype=complex)
    R = np.eye(2, dtype=complex)[None]
    Q = np.array([[[np.inf, 0.0], [0.0, complex(np.nan, np.nan)]]], dtype=complex)
    E = (G - Ghat) @ np.linalg.inv(G)
    np.testing.assert_allclose(closed_form(R, E, Ghat, Q).plant, G, rtol=1e-12)


def test_setpoints_that_move_together_are_refused():
    loop = Loop(np.random.default_rng(5), 2)
    R = loop.R.copy()
    R[:, 1] = 3 * R[:, 0]
    with pytest.raises(Refused, match="move in proportion"):
        closed_form(R, loop.E, loop.Ghat, loop.Q)
    with pytest.raises(Refused, match="1 experiments for 2"):
        closed_form(R[:, :, :1], loop.E[:, :, :1], loop.Ghat, loop.Q)
    R[:, 1] = 0
    with pytest.raises(Refused, match="set-point 2 does not move"):
        joint(R, loop.Y, loop.U)


def test_a_single_bad_frequency_is_marked_and_the_rest_is_answered():
    loop = Loop(np.random.default_rng(6), 2)
    R = loop.R.copy()
    R[2, :, 1] = 2j * R[2, :, 0]
    found = closed_form(R, loop.E, loop.Ghat, loop.Q)
    assert found.usable.tolist() == [True, True, False] + [True] * 4
    assert np.isnan(found.plant[2]).all()
    np.testing.assert_allclose(found.plant[3:], loop.G[3:], atol=1e-9)


def test_condition_does_not_depend_on_units():
    loop = Loop(np.random.default_rng(7), 2)
    first = closed_form(loop.R, loop.E, loop.Ghat, loop.Q).condition
    units = np.array([1e6, 1.0])[:, None]
    np.testing.assert_allclose(joint(units * loop.R, loop.Y, loop.U).condition, first, rtol=0.5)


def test_nonsquare_plants_and_wrong_shapes_get_a_message():
    loop = Loop(np.random.default_rng(8), 2)
    with pytest.raises(LoopError, match="joint form"):
        closed_form(loop.R, loop.E, loop.Ghat[:, :, :1], loop.Q)
    with pytest.raises(UsageError, match="Q must have shape"):
        closed_form(loop.R, loop.E, loop.Ghat, loop.Q[:3])
    with pytest.raises(LoopError, match="no inverse"):
        closed_form(loop.R, loop.E, loop.Ghat, np.zeros_like(loop.Q))
    with pytest.raises(Refused, match="cannot tell 2 inputs apart"):
        joint(loop.R[:, :1], loop.Y, loop.U)


def test_consistency_is_zero_for_the_declared_law_and_two_for_the_opposite_action():
    loop = Loop(np.random.default_rng(9), 2, v=0.4, two_degrees=True)
    assert consistency(loop.R, loop.Y, loop.U, loop.Q, loop.F).max() < 1e-12
    np.testing.assert_allclose(consistency(loop.R, loop.Y, loop.U, -loop.Q, loop.F), 2.0, rtol=1e-12)
    wrong = loop.Q.copy()
    wrong[:, 0] *= 1.5
    gap = consistency(loop.R, loop.Y, loop.U, wrong, loop.F)
    np.testing.assert_allclose(gap[:, 0], 0.5, rtol=1e-12)
    assert gap[:, 1].max() < 1e-12


@pytest.mark.parametrize("n_experiments", [2, 5])
def test_first_order_covariance_of_both_forms_matches_many_noisy_runs(n_experiments):
    rng = np.random.default_rng(10)
    G = np.array([[1.0, 0.3 + 0.2j], [-0.2j, 0.8]])
    Ghat, Q = 0.8 * G, np.array([[1.0, 0.2], [0.0, 1.5 - 0.5j]])
    R = complex_normal(rng, 1, 2, n_experiments)
    root = 0.01 * np.array([[1.0, 0.0], [0.5j, 0.7]])
    runs = 4000
    V = root @ complex_normal(rng, runs, 2, n_experiments)
    tile = np.tile(R, (runs, 1, 1))
    U = np.linalg.solve(np.eye(2) + Q @ G, Q @ (tile - V))
    Y = G @ U + V
    U0 = np.linalg.solve(np.eye(2) + Q @ G, Q @ R)
    many = (runs, 2, 2)
    by_joint = joint(tile, Y, U).plant
    by_closed = closed_form(tile, Y - Ghat @ U, np.broadcast_to(Ghat, many), np.broadcast_to(Q, many)).plant
    expected = standard_errors(plant_covariance(U0, (root @ root.conj().T)[None]), (2, 2))[0]
    # both forms reach the bound when the system of equations is square; least squares on R loses some beyond it
    for estimate in (by_joint, by_closed):
        seen = np.sqrt(np.mean(np.abs(estimate - G) ** 2, axis=0))
        assert np.all(seen > 0.95 * expected)
        assert np.all(seen < (1.05 if n_experiments == 2 else 1.6) * expected)


def test_covariance_of_X_carries_over_to_the_plant():
    rng = np.random.default_rng(11)
    loop = Loop(rng, 2)
    X = closed_form(loop.R, loop.E, loop.Ghat, loop.Q).X
    root = 1e-5 * complex_normal(rng, 4, 4)
    runs = 4000
    dX = (root @ complex_normal(rng, runs, 4, 1)).reshape(runs, 2, 2).transpose(0, 2, 1)
    k = 3
    many = (runs, 2, 2)
    identity = np.broadcast_to(np.eye(2, dtype=complex), many)
    noisy = closed_form(
        identity, X[k] + dX, np.broadcast_to(loop.Ghat[k], many), np.broadcast_to(loop.Q[k], many)
    ).plant
    covariance = closed_form_covariance(X[[k]], loop.G[[k]], loop.Q[[k]], (root @ root.conj().T)[None])
    seen = np.sqrt(np.mean(np.abs(noisy - loop.G[k]) ** 2, axis=0))
    np.testing.assert_allclose(seen, standard_errors(covariance, (2, 2))[0], rtol=0.05)
