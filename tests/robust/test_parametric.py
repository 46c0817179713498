"""Real errors of gains and dead times: the algebra on its own, plants of the set drawn, and the worst of them."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import UsageError
from trueplant.loop import PID, Controller, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix, tf
from trueplant.plants import mill
from trueplant.robust import (
    ElementErrors,
    gain_and_dead_time_weight,
    parametric_loop,
    parametric_performance,
    performance_weight,
    robust_performance,
)

PERFORMANCE = performance_weight(0.05, 1 / 0.45)


def changed(plant: TransferMatrix, gain: np.ndarray, later: np.ndarray) -> TransferMatrix:
    rows = []
    for i, row in enumerate(plant.elements):
        rows.append([])
        for j, element in enumerate(row):
            terms = (TransferFunction.rational(t.num, t.den, t.dead_time + later[i, j]) for t in element.terms)
            rows[-1].append(sum(terms, TransferFunction()) * float(1 + gain[i, j]))
    return TransferMatrix(tuple(map(tuple, rows)), plant.time_unit)


def weighted_error(plant: TransferMatrix, controller: Controller, w: np.ndarray) -> np.ndarray:
    S = np.linalg.inv(np.eye(plant.shape[0]) + plant(1j * w) @ controller(1j * w))
    return np.abs(PERFORMANCE(1j * w)) * np.linalg.norm(S, ord=2, axis=(1, 2))


@pytest.mark.parametrize("inputs", [False, True])
def test_closing_N_gives_the_loop_of_the_changed_plant(inputs):
    """For numbers drawn at random; dead times turn by less than 3 at low frequencies and by more at high ones."""
    case = mill()
    rng = np.random.default_rng(1)
    a, tau = np.array([[0.1, 0.0], [0.2, 0.3]]), np.array([[0.1, 0.2], [0.0, 0.13]])
    errors = ElementErrors.of(case.model, a, tau)
    weight = tf("(0.2 s + 0.1)/(0.1 s + 1)")
    loop = parametric_loop(case.model, case.controller, errors, PERFORMANCE, weight if inputs else None)
    w = np.geomspace(0.05, 60, 40)
    N, n = loop.system(w), loop.system(w).shape[1] - 2
    gain, later = rng.uniform(-1, 1, size=(2, 2, 2))
    at_input = rng.normal(size=(2, 2)) @ [1, 1j] / 3 * inputs
    delta = np.zeros((40, n, n), complex)
    turned = loop.turns(w)
    for k, (i, j) in enumerate(loop.gains):
        delta[:, k, k] = gain[i, j]
    for k, (i, j) in enumerate(loop.dead_times):
        angle = w * tau[i, j]
        number = np.where(
            turned[:, k],
            (1 - np.exp(-1j * angle * later[i, j])) / 2,
            np.tan(angle * later[i, j] / 2) / np.tan(np.minimum(angle, 3) / 2),
        )
        assert np.all(np.abs(number) <= 1)
        delta[:, len(loop.gains) + k, len(loop.gains) + k] = number
    for j in range(2 * inputs):
        delta[:, n - 2 + j, n - 2 + j] = at_input[j]
    assert np.any(turned) and not np.all(turned)
    closed = N[:, n:, n:] + N[:, n:, :n] @ delta @ np.linalg.solve(np.eye(n) - N[:, :n, :n] @ delta, N[:, :n, n:])
    s = 1j * w
    G = changed(case.model, a * gain, tau * later)(s) * (1 + weight(s)[:, None, None] * at_input)
    S = np.linalg.inv(np.eye(2) + G @ case.controller(s))
    assert closed == pytest.approx(PERFORMANCE(s)[:, None, None] * S, rel=1e-9, abs=1e-9)


@pytest.fixture(scope="module")
def judged():
    case = mill("eq37")
    loop = parametric_loop(case.model, case.controller, ElementErrors.of(case.model, 0.05, 0.1), PERFORMANCE)
    return case, loop, parametric_performance(loop)


def test_no_plant_of_the_set_exceeds_what_the_peak_allows(judged):
    """200 plants, half of them with every error at its limit."""
    case, loop, result = judged
    assert result.passes and result.RP.lower > 0.9
    rng = np.random.default_rng(2)
    w = np.geomspace(1e-4, 100, 150)
    largest = 0.0
    for k in range(200):
        gain, later = rng.uniform(-1, 1, size=(2, 2, 2))
        if k % 2:
            gain, later = np.sign(gain), np.sign(later)
        plant = changed(case.model, 0.05 * gain, 0.1 * later)
        largest = max(largest, weighted_error(plant, case.controller, w).max())
        if k < 40:
            assert unstable_poles(plant, case.controller) == 0
    assert largest < 1
    # and the set is not far from what it is said to be
    assert largest > 0.97 * result.RP.lower
    assert loop.blocks(loop.turns(np.array([0.1]))[0]).__len__() == 8


def test_the_worst_plant_is_one_of_gains_and_dead_times(judged):
    case, loop, result = judged
    worst = loop.moved(result.worst, result.worst_frequency)
    reached = weighted_error(worst, case.controller, np.array([result.worst_frequency]))[0]
    assert reached == pytest.approx(result.RP.lower, rel=1e-6)
    assert np.all(result.performance[:, 0] <= result.performance[:, 1])
    for i in range(2):
        for j in range(2):
            ratio = worst[i, j].dc_gain / case.model[i, j].dc_gain
            assert abs(ratio - 1) <= 0.05 / result.RP.lower * (1 + 1e-9)


def test_complex_errors_of_the_same_size_are_worse(judged):
    case, *_ = judged
    loop = parametric_loop(case.model, case.controller, ElementErrors.of(case.model, 0.05), PERFORMANCE)
    real = parametric_performance(loop)
    weights = [0.05 * case.model[i, j] for i in range(2) for j in range(2)]
    complex_ = robust_performance(case.model, case.controller, weights, PERFORMANCE, "elements")
    assert real.RP.upper <= complex_.RP.upper * (1 + 1e-6) and real.RS.upper < 0.9 * complex_.RS.upper


def test_single_loop_on_a_grid():
    """Gain and dead time of one element: the worst of 40 000 plants at each of some frequencies."""
    plant, law = TransferMatrix.of([["2 exp(-3 s)/(8 s + 1)"]]), Controller.diagonal([PID(Kc=2 / 3, Ti=8.0)])
    loop = parametric_loop(plant, law, ElementErrors.of(plant, 0.2, 0.8), performance_weight(0.05, 2.0))
    result = parametric_performance(loop)
    for k in range(5, result.w.size, 9):
        s = 1j * result.w[k]
        size = 1 / result.performance[k, 0]
        t = np.tan(result.w[k] * 0.8 / 2)
        if result.w[k] * 0.8 >= 3 or size * t > 50:
            continue
        factor = (1 + 0.2 * size * np.linspace(-1, 1, 201))[:, None]
        eta = size * np.linspace(-1, 1, 201)
        L = (plant([s]) @ law([s]))[0, 0, 0] * factor * (1 - 1j * t * eta) / (1 + 1j * t * eta)
        largest = np.max(np.abs(loop.performance[0](s) / (1 + L)))
        assert largest == pytest.approx(result.performance[k, 0], rel=1e-3)


def test_beside_a_complex_error_at_the_inputs():
    case = mill()
    weight = gain_and_dead_time_weight(0.05, 0.05)
    errors = ElementErrors.of(case.model, [[0.05, 0], [0, 0]])
    both = parametric_performance(parametric_loop(case.model, case.controller, errors, PERFORMANCE, weight))
    alone = robust_performance(case.model, case.controller, weight, PERFORMANCE)
    assert alone.RP.upper * 1.001 < both.RP.lower <= both.RP.upper and alone.RS.upper < both.RS.upper


def test_wrong_input_is_named():
    case = mill()
    with pytest.raises(UsageError, match="the plant's shape"):
        ElementErrors.of(case.model, [0.1, 0.2])
    with pytest.raises(UsageError, match="0 or more"):
        ElementErrors.of(case.model, -0.1)
    with pytest.raises(UsageError, match="no element has an error"):
        ElementErrors.of(case.model)
    unstable = Controller.diagonal([PID(Kc=100.0), PID(Kc=100.0)])
    loop = parametric_loop(case.model, unstable, ElementErrors.of(case.model, 0.1), PERFORMANCE)
    assert not parametric_performance(loop).stable
    plant, law = TransferMatrix.of([["2/(8 s + 1)"]]), Controller.diagonal([PID(Kc=1.0, Ti=8.0)])
    early = parametric_loop(plant, law, ElementErrors.of(plant, 0.0, 0.5), 0.5)
    with pytest.raises(UsageError, match="no longer than the dead times themselves"):
        early.moved(np.array([[-1.0 + 0j]]), 1.0)
