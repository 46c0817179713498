"""Closed-loop frequency functions: identities, and the loop they describe against the simulator."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import IllPosedLoop, LoopError
from trueplant.loop import (
    PID,
    Controller,
    complementary,
    loop_functions,
    sensitivity,
    simulate,
)
from trueplant.plants import mill, splitter

CASE = mill()
S = 0.02 + 1j * np.geomspace(1e-3, 30, 50)


def test_functions_of_the_loop_satisfy_their_definitions():
    rng = np.random.default_rng(0)
    g = rng.normal(size=(30, 2, 3)) + 1j * rng.normal(size=(30, 2, 3))
    q = rng.normal(size=(30, 3, 2)) + 1j * rng.normal(size=(30, 3, 2))
    loop = loop_functions(g, q)
    eye = np.eye(2)
    assert np.allclose((eye + g @ q) @ loop.S, eye)
    assert np.allclose(loop.S + loop.T, eye)
    assert np.allclose(loop.QS, q @ loop.S)
    assert np.allclose(loop.SG, loop.S @ g)
    # push-through: Q S = (I + Q G)^-1 Q
    assert np.allclose(loop.QS, np.linalg.solve(np.eye(3) + q @ g, q))
    assert np.allclose(sensitivity(g, q), loop.S)
    assert np.allclose(complementary(g, q), loop.T)


def test_callables_and_arrays_agree():
    by_array = loop_functions(CASE.model(S), CASE.controller(S))
    by_call = loop_functions(CASE.model, CASE.controller, S)
    assert np.array_equal(by_array.S, by_call.S)
    with pytest.raises(LoopError, match="give the points"):
        sensitivity(CASE.model, CASE.controller)


def test_small_complementary_sensitivity_keeps_its_digits():
    t = complementary(CASE.model, CASE.controller, np.array([1e9j]))
    loop = CASE.model(np.array([1e9j])) @ CASE.controller(np.array([1e9j]))
    assert np.allclose(t, loop, rtol=1e-6, atol=0)


def test_singular_loop_is_named():
    with pytest.raises(IllPosedLoop, match="singular"):
        sensitivity(np.full((1, 1, 1), -1.0 + 0j), np.ones((1, 1, 1), complex))


def test_continuous_loop_in_time_transforms_to_its_frequency_function():
    # on Re s = sigma the transform of the response to a step from rest is exact up to the step's quadrature
    case = splitter()
    h, sigma = 0.0025, 0.2
    s = sigma + 1j * np.linspace(0, 2, 12)
    r = np.zeros((round(120 / h), 2))
    r[:, 1] = 1.0
    sim = simulate(case.plant, case.controller, r, h)
    decay = np.exp(-np.outer(s, sim.t))
    u = decay @ sim.u * ((1 - np.exp(-s * h)) / s)[:, None]
    y = (decay @ sim.y) * h
    loop = loop_functions(case.plant, case.controller, s)
    assert np.max(np.abs(u - loop.QS[:, :, 1] / s[:, None])) < 2e-5 * np.max(np.abs(u))
    assert np.max(np.abs(y - loop.T[:, :, 1] / s[:, None])) < 2e-5 * np.max(np.abs(y))


def test_held_op_and_plant_give_the_output_in_frequency_too():
    # y = G u with the exact transform of the held OP, whatever the controller: only y's quadrature is left
    controller = Controller.diagonal([PID(Kc=-2.0, Ti=3.3, sample_time=0.05), PID(Kc=0.42, Ti=5.2, sample_time=0.05)])
    h = 0.005
    r = np.zeros((round(80 / h), 2))
    r[:, 0], r[4000:, 1] = 1.0, -2.0
    sim = simulate(CASE.plant, controller, r, h)
    s = 0.4 + 1j * np.linspace(0, 3, 20)
    decay = np.exp(-np.outer(s, sim.t))
    u = decay @ sim.u * ((1 - np.exp(-s * h)) / s)[:, None]
    y = (decay @ sim.y) * h
    expected = (CASE.plant(s) @ u[:, :, None])[:, :, 0]
    assert np.max(np.abs(y - expected)) < 2e-5 * np.max(np.abs(y))
