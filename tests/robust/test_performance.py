"""Robust performance against published cases, and against perturbed plants looked at on their own."""

from __future__ import annotations

import numpy as np
import pytest

from trueplant.errors import UsageError
from trueplant.loop import PID, Controller, Linear, simulate, unstable_poles
from trueplant.lti import TransferFunction, TransferMatrix, tf
from trueplant.plants import mill, splitter
from trueplant.robust import (
    Full,
    diagonal,
    gain_and_dead_time_weight,
    generalised_plant,
    mu,
    performance_weight,
    perturbed_plant,
    robust_performance,
    uncertainty_blocks,
    worst_gain,
)
from trueplant.robust.peaks import sharpened

UNCERTAINTY, PERFORMANCE = gain_and_dead_time_weight(0.1, 0.2), performance_weight(0.05, 1 / 0.45)
"""(31) and (32) of the mill."""

DC = np.array([[87.8, -86.4], [108.2, -109.6]])
COLUMN = TransferMatrix.of([[f"{gain}/(75 s + 1)" for gain in row] for row in DC])
INVERSE = Controller(
    {
        (i, j): Linear(TransferFunction.rational(0.7 * np.linalg.inv(DC)[i, j] * np.array([75.0, 1.0]), [1.0, 1e-5]))
        for i in range(2)
        for j in range(2)
    },
    2,
    2,
)
COLUMN_WEIGHTS = tf("(s + 0.2)/(0.5 s + 1)"), tf("0.5 (10 s + 1)/(10 s + 1e-5)")


def met(peak, value: float, rel: float) -> bool:
    return peak.upper == pytest.approx(value, rel=rel) and peak.lower == pytest.approx(peak.upper, rel=1e-3)


def test_mill_nominal():
    case = mill()
    result = robust_performance(case.model, case.controller, UNCERTAINTY, PERFORMANCE)
    assert result.stable and result.passes
    assert met(result.RP, 0.9728, 1e-4) and result.RP.frequency == pytest.approx(0.889, abs=1e-3)
    assert met(result.RS, 0.155, 5e-3) and met(result.NP, 0.841, 5e-4)
    full = robust_performance(case.model, case.controller, UNCERTAINTY, PERFORMANCE, structure="input full")
    assert met(full.RP, 1.0207, 1e-4) and not full.passes


@pytest.mark.parametrize(("variant", "value", "below"), [("printed", 4.964, None), ("eq37", 1.426, 0.09)])
def test_perturbed_mill_is_worst_at_rest(variant, value, below):
    case = mill(variant)
    result = robust_performance(case.plant, case.controller, UNCERTAINTY, PERFORMANCE)
    assert met(result.RP, value, 2e-4) and result.RP.frequency == 0 and not result.passes
    if below:
        assert result.w[result.performance[:, 1] > 1].max() == pytest.approx(below, rel=0.2)


def test_limit_at_rest_is_the_closed_form():
    """S ~ s (G0 K/Ti)^-1, so wP S -> wB (G0 K/Ti)^-1 for wP = (s/M + wB)/s."""
    case = mill("eq37")
    result = robust_performance(case.plant, case.controller, UNCERTAINTY, PERFORMANCE)
    slope = case.plant.dc_gain @ np.diag([-2.0 / 3.3, 0.42 / 5.2])
    assert result.nominal[0] == pytest.approx(0.05 * np.linalg.norm(np.linalg.inv(slope), 2), rel=1e-6)


def test_distillation_column_of_the_textbook():
    w = np.logspace(-3, 3, 61)
    N = generalised_plant(COLUMN, INVERSE, *COLUMN_WEIGHTS, 1j * w)
    blocks = (*uncertainty_blocks((2, 2), "input"), Full(2))
    result = mu(N, blocks)
    assert result.upper.max() == pytest.approx(5.7726, abs=5e-5) and result.lower.max() == pytest.approx(
        5.7726, abs=5e-5
    )
    assert mu(N[:, :2, :2], blocks[:2]).upper.max() == pytest.approx(0.5242, abs=5e-5)
    assert np.linalg.norm(N[:, 2:, 2:], ord=2, axis=(1, 2)).max() == pytest.approx(0.5, abs=5e-5)
    peak = robust_performance(COLUMN, INVERSE, *COLUMN_WEIGHTS).RP
    assert 5.7726 < peak.upper < 5.80 and peak.frequency == pytest.approx(w[result.upper.argmax()], rel=0.15)
    low, high = worst_gain(N[28:36], blocks, 2)
    assert high.max() == pytest.approx(44.92, abs=5e-3) and low.max() == pytest.approx(high.max(), rel=1e-4)


def weighted_error(plant, controller, performance, w) -> np.ndarray:
    s = 1j * np.atleast_1d(w)
    S = np.linalg.inv(np.eye(plant.shape[0]) + plant(s) @ controller(s))
    return np.abs(performance(s)) * np.linalg.norm(S, ord=2, axis=(1, 2))


@pytest.mark.parametrize("structure", ["input", "input full", "output", "output full", "additive", "elements"])
def test_worst_plant_reaches_the_bound_and_no_other_in_the_set_does(structure):
    case = mill("eq37")
    uncertainty = {"additive": tf("0.1"), "elements": [tf("0.1"), 0.0, "0.2/(s + 1)", 0.05]}.get(structure, UNCERTAINTY)
    result = robust_performance(case.model, case.controller, uncertainty, PERFORMANCE, structure)
    assert result.RP.upper == pytest.approx(result.RP.lower, rel=1e-6)
    size, w = np.linalg.norm(result.worst, 2), result.worst_frequency
    assert size == pytest.approx(1 / result.RP.lower, rel=1e-6)
    worst = perturbed_plant(case.model, uncertainty, result.worst, w, structure)
    assert weighted_error(worst, case.controller, PERFORMANCE, w)[0] == pytest.approx(result.RP.lower, rel=1e-5)
    assert unstable_poles(worst, case.controller) == 0

    rng = np.random.default_rng(3)
    frequencies = np.geomspace(0.01, 30, 40)
    for _ in range(30):
        delta = rng.normal(size=result.worst.shape) + 1j * rng.normal(size=result.worst.shape)
        if structure in ("input", "output", "elements"):
            delta = np.diag(np.diag(delta) / np.abs(np.diag(delta)))
        else:
            u, _, vh = np.linalg.svd(delta)
            delta = u[:, :1] @ vh[:1]
        plant = perturbed_plant(case.model, uncertainty, size * delta, float(rng.uniform(0.1, 3)), structure)
        assert np.all(weighted_error(plant, case.controller, PERFORMANCE, frequencies) < result.RP.upper)


def test_perturbation_beyond_robust_stability_destabilises():
    case = mill("eq37")
    strong = tf("(1.2 s + 0.6)/(0.1 s + 1)")
    w = np.geomspace(0.05, 30, 400)
    N = generalised_plant(case.model, case.controller, strong, PERFORMANCE, 1j * w)
    result = mu(N[:, :2, :2], diagonal(2))
    k = int(np.argmax(result.lower))
    for factor, stable in ((0.99, True), (1.01, False)):
        plant = perturbed_plant(case.model, strong, factor * result.delta[k], w[k])
        assert (unstable_poles(plant, case.controller) == 0) is stable


@pytest.mark.parametrize("variant", ["printed", "eq37"])
def test_perturbation_at_rest_is_a_change_of_gains(variant):
    """No factor with a lag far beyond the slowest of the loop."""
    case = mill(variant)
    result = robust_performance(case.plant, case.controller, UNCERTAINTY, PERFORMANCE)
    assert result.RP.frequency == 0
    worst = perturbed_plant(case.plant, UNCERTAINTY, result.worst, result.worst_frequency)
    assert min(abs(p) for row in worst.elements for e in row for p in e.poles) > 0.1
    w = result.worst_frequency
    assert weighted_error(worst, case.controller, PERFORMANCE, w)[0] == pytest.approx(result.RP.lower, rel=1e-5)


def test_worst_plant_can_be_simulated():
    case = mill("eq37")
    result = robust_performance(case.model, case.controller, UNCERTAINTY, PERFORMANCE)
    worst = perturbed_plant(case.model, UNCERTAINTY, result.worst, result.worst_frequency)
    run = simulate(worst, case.controller, np.tile([1.0, 0.0], (6000, 1)), 0.02)
    assert np.all(np.isfinite(run.y)) and run.y[-1] == pytest.approx([1.0, 0.0], abs=0.02)


def test_single_loop_in_closed_form():
    """For one loop mu of N is |wP S| + |wI T|."""
    plant, law = TransferMatrix.of([["2 exp(-3 s)/(8 s + 1)"]]), Controller.diagonal([PID(Kc=2 / 3, Ti=8.0)])
    weight, asked = gain_and_dead_time_weight(0.2, 0.5), performance_weight(0.05, 2.0)
    result = robust_performance(plant, law, weight, asked)
    s = 1j * result.w
    S = 1 / (1 + plant(s)[:, 0, 0] * law(s)[:, 0, 0])
    T = plant(s)[:, 0, 0] * law(s)[:, 0, 0] * S
    assert result.performance[:, 1] == pytest.approx(np.abs(asked(s) * S) + np.abs(weight(s) * T), rel=1e-7)
    assert result.stability[:, 1] == pytest.approx(np.abs(weight(s) * T), rel=1e-9)
    dense = 1j * np.geomspace(0.01, 3, 20_001)
    around = plant(dense)[:, 0, 0] * law(dense)[:, 0, 0]
    exact = (np.abs(asked(dense)) + np.abs(weight(dense) * around)) / np.abs(1 + around)
    assert result.RP.upper == pytest.approx(exact.max(), rel=1e-6)


def test_peaks_of_a_light_resonance_are_not_missed():
    plant, law = (
        TransferMatrix.of([["1/(s^2 + 0.0004 s + 1)"]]),
        Controller.diagonal([PID(form="parallel", Kp=0.0, Ki=1e-4)]),
    )
    result = robust_performance(plant, law, 0.1, 0.5)
    dense = 1j * np.linspace(0.999, 1.001, 200_001)
    S = 1 / (1 + plant(dense)[:, 0, 0] * law(dense)[:, 0, 0])
    assert result.NP.upper == pytest.approx(0.5 * np.abs(S).max(), rel=1e-6)


def test_each_channel_may_have_its_own_weights():
    case = splitter()
    both = robust_performance(case.plant, case.controller, [0.1, 0.0], ["(0.5 s + 0.01)/s", 0.4])
    one = robust_performance(case.plant, case.controller, 0.1, ["(0.5 s + 0.01)/s", 0.4])
    assert both.RP.upper < one.RP.upper and both.RS.upper < one.RS.upper


def test_what_the_loop_cannot_meet_is_infinite():
    plant, law = TransferMatrix.of([["2/(8 s + 1)"]]), Controller.diagonal([PID(Kc=2.0)])
    result = robust_performance(plant, law, 0.1, performance_weight(0.05, 2.0))
    assert np.isinf(result.NP.upper) and np.isinf(result.RP.upper) and result.RP.frequency == 0
    assert result.RS.upper == pytest.approx(0.08, rel=1e-6)  # 0.1 T(0)
    unstable = robust_performance(plant, Controller.diagonal([PID(Kc=-2.0)]), 0.1, 0.5)
    assert not unstable.stable and not unstable.passes and np.isinf(unstable.RS.lower)


def test_wrong_input_is_named():
    case = mill()
    with pytest.raises(UsageError, match="3 weights for 2 channels"):
        robust_performance(case.model, case.controller, [0.1, 0.1, 0.1], PERFORMANCE)
    with pytest.raises(UsageError, match="structure must be one of"):
        robust_performance(case.model, case.controller, 0.1, PERFORMANCE, structure="both")
    with pytest.raises(UsageError, match="unstable pole"):
        robust_performance(case.model, case.controller, "0.1/(s - 1)", PERFORMANCE)
    with pytest.raises(UsageError, match="shape"):
        perturbed_plant(case.model, 0.1, np.eye(3), 1.0)
    with pytest.raises(UsageError, match="frequency above 0"):
        perturbed_plant(case.model, 0.1, np.eye(2), 0.0)
    with pytest.raises(UsageError, match="between 1 and 1"):
        worst_gain(np.ones((1, 2, 2)), diagonal(2), 2)


def test_a_flat_bound_has_its_peak_towards_frequency_0():
    """Whichever point of the grid the last digit prefers; a peak that stands out stays where it is."""
    w = np.concatenate([[1e-9], np.geomspace(1e-3, 10.0, 60)])

    def flat(at):
        upper = np.where(at < 0.02, 1.5 + 1e-9 * np.sin(1e4 * at), 1.5 / (1 + at))
        return upper, upper

    found = sharpened(flat, lambda at: at, w, *flat(w))
    assert (found.frequency, found.upper) == (0.0, pytest.approx(1.5, rel=1e-8))

    def resonant(at):
        upper = 1 / np.abs(1 - at**2 + 0.5j * at)
        return upper, upper

    assert sharpened(resonant, lambda at: at, w, *resonant(w)).frequency == pytest.approx(np.sqrt(0.875), rel=1e-3)
