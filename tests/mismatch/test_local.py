"""Local polynomial responses and the parameters read from them: exact without noise, calibrated with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.simulated import coloured, random_switching, segment_of
from trueplant.errors import LoopError, Refused, UsageError
from trueplant.loop import PID, Controller, alternating_steps, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import Structure
from trueplant.mismatch import fit_locally, local_response, sampled_frequency_response, speaking_band

FOPDT = Structure.parse("fopdt")
H = 0.5
PLANT = TransferMatrix.of([["2 exp(-1.3 s)/(5 s + 1)"]])
MODEL = TransferMatrix.of([["1.6 exp(-1.3 s)/(6 s + 1)"]])
LOOP = Controller.diagonal([PID(Kc=0.8, Ti=5.0, sample_time=H)])
TRUTH = np.array([2.0, 5.0, 1.3])

PLANT2 = TransferMatrix.of(
    [["-0.58 exp(-1.03 s)/(10 s + 1)", "4 exp(-3.03 s)/(15 s + 1)"], ["0", "3.8 exp(-0.53 s)/(2.8 s + 1)"]]
)
MODEL2 = TransferMatrix.of(
    [["-0.464 exp(-1.03 s)/(12 s + 1)", "3.2 exp(-3.03 s)/(18 s + 1)"], ["0", "3.8 exp(-0.53 s)/(2.8 s + 1)"]]
)
LOOP2 = Controller.diagonal([PID(Kc=-1, Ti=8, Td=0.5, sample_time=0.1), PID(Kc=0.5, Ti=2, sample_time=0.1)])


def steps(n, *instants):
    """A set-point that toggles between 0 and 1 at these samples."""
    r = np.zeros(n)
    for k in instants:
        r[k:] = 1 - r[k]
    return r


def one_loop(seed, noise, samples=800):
    r = steps(samples, 40, 150, 290, 370, 500, 640)[:, None]
    return segment_of(simulate(PLANT, LOOP, r, H, noise=noise, seed=seed))


def two_loops(noise=0.0, seed=0):
    r = np.stack([steps(3000, 100, 1100, 2100), steps(3000, 600, 1600, 2600)], axis=1)
    return segment_of(simulate(PLANT2, LOOP2, r, 0.1, noise=noise, seed=seed))


def test_open_loop_response_is_the_exact_sampled_one():
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], (6000, 2))
    plant = TransferMatrix.of([["2 exp(-1.3 s)/(5 s + 1)", "1/(s + 1)"], ["-1 exp(-0.2 s)/(3 s + 1)", "0.5"]])
    segment = segment_of(simulate(plant, None, np.zeros((6000, 2)), H, u=u))
    found = local_response([segment], "direct")
    truth = sampled_frequency_response(plant, found.w, H)
    assert np.max(np.abs(found.sampled - truth)) < 0.01 * np.max(np.abs(truth))
    below = found.w < 0.2 * np.pi / H
    error = np.abs(found.value - plant(1j * found.w))[below]
    error[:, 1, 1] = 0.0  # an element without lag has aliases at all frequencies
    assert np.max(error) < 0.02 * np.max(np.abs(truth))


@pytest.mark.parametrize("method", ["joint", "closed-form"])
def test_a_perfect_model_leaves_no_error_without_noise(method):
    found = local_response([two_loops()], method, PLANT2, LOOP2)
    truth = sampled_frequency_response(PLANT2, found.w, 0.1)
    np.testing.assert_allclose(found.sampled, truth, atol=1e-8)
    np.testing.assert_allclose(found.value, PLANT2(1j * found.w), atol=1e-8)


@pytest.mark.parametrize("method", ["joint", "closed-form"])
def test_rounds_take_the_systematic_error_out(method):
    """Model with gains 20 % too small, time constants 20 % too long; 300 min, three steps of each set-point."""
    structures = {(0, 0): FOPDT, (0, 1): FOPDT, (1, 1): FOPDT}
    fit = fit_locally([two_loops(noise=0.005)], structures, MODEL2, method, LOOP2)
    truth = {(0, 0): [-0.58, 10, 1.03], (0, 1): [4, 15, 3.03], (1, 1): [3.8, 2.8, 0.53]}
    for element, expected in truth.items():
        np.testing.assert_allclose(fit.parameters[element][:2], expected[:2], rtol=0.02)
        np.testing.assert_allclose(fit.parameters[element][2], expected[2], atol=0.03)
    assert fit.plant[1, 0].is_zero


def test_rounds_of_17_about_a_wrong_plant_begin_anew():
    """At 2 rad/min noise looks weak by chance in one window, by which a dead time of 8.5 for 2.3 suits the response.

    Linear about that plant, (17) confirms it: 91, 75 and 81 standard errors off, and 70 without an end to the rounds.
    """
    plant = TransferMatrix.of([["2 exp(-2.3 s)/(15 s + 1)"]])
    model = TransferMatrix.of([["1.6 exp(-2.3 s)/(15 s + 1)"]])
    law = Controller.diagonal([PID(Kc=1.5, Ti=15.0, sample_time=1.0)])
    for seed, std in ((271_000, 0.2), (230_000, 0.2), (279_000, 0.1), (264_000, 0.2)):
        rng = np.random.default_rng(seed)
        r, v = random_switching(rng, 1500, 1, 60.0), coloured(rng, 1500, 1, [1, -0.8], [1], std)
        record = segment_of(simulate(plant, law, r, 1.0, v=v))
        fit = fit_locally([record], {(0, 0): FOPDT}, model, "closed-form", law)
        error = (fit.parameters[0, 0] - [2.0, 15.0, 2.3]) / np.sqrt(np.diag(fit.covariance[0, 0]))
        assert fit.converged and np.max(np.abs(error)) < 4


@pytest.mark.parametrize("method", ["joint", "closed-form"])
def test_standard_errors_of_the_response_are_those_of_many_runs(method):
    """60 seeded runs with coloured noise; the first four windows, where noise does not yet hide the loop.

    Each error against its own run's claim: in 2 of the runs the noise looks like a walk, and errors are claimed larger.
    """
    rng = np.random.default_rng(5)
    squares = []
    r = steps(1500, 40, 300, 500, 850, 1000, 1300)[:, None]
    for _ in range(60):
        v = coloured(rng, 1500, 1, [1, -0.6], [1], 0.05)
        found = local_response([segment_of(simulate(PLANT, LOOP, r, H, noise=v))], method, PLANT, LOOP, near=True)
        errors = np.abs(found.sampled - sampled_frequency_response(PLANT, found.w, H))[:12, 0, 0]
        squares.append((errors / found.std[:12, 0, 0]) ** 2)
    ratio = np.mean(squares, axis=0)
    print(method, ratio.round(2))
    assert 0.8 < ratio.mean() < 1.2
    assert np.all((ratio > 0.4) & (ratio < 2.0))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["joint", "closed-form"])
def test_intervals_cover_the_truth(method):
    """200 seeded runs: 95 % intervals of gain, time constant and dead time, from a model that is 20 % off.

    Each of the three passes with 0.997 at the level of 5 %, with less than 1e-3 at 20 %.
    """
    inside, settled = [], 0
    for seed in range(200):
        fit = fit_locally([one_loop(seed, 0.05)], {(0, 0): FOPDT}, MODEL, method, LOOP)
        error = np.sqrt(np.diag(fit.covariance[0, 0]))
        inside.append(np.abs(fit.parameters[0, 0] - TRUTH) < 1.96 * error)
        settled += fit.converged
    coverage = np.mean(inside, axis=0)
    print(f"\n{method}: coverage of gain, time constant, dead time {coverage}, settled {settled}/200")
    assert np.all((coverage >= 0.895) & (coverage <= 0.985))
    assert settled > 190


LEVEL = TransferMatrix.of([["0.05 exp(-0.5 s)/s"]], "min")
LEVEL_LOOP = Controller.diagonal([PID(Kc=2.0, Ti=40.0, sample_time=H)])


def level_loop(seed):
    """A level under a load that walks: most frequencies of a square wave say nothing of it."""
    r = alternating_steps(2000, H, 150.0, [2.0])
    v = np.cumsum(np.random.default_rng(seed).normal(0, 0.02, (2000, 1)), axis=0)
    return segment_of(simulate(LEVEL, LEVEL_LOOP, r, H, v=v, noise=0.01, seed=seed))


@pytest.mark.parametrize("method", ["joint", "closed-form"])
def test_a_level_under_a_walking_load_is_never_confidently_wrong(method):
    """24 seeded runs, each with slope and dead time; beyond 4 standard errors is 1 in 15,000 by chance."""
    far = []
    for seed in range(24):
        fit = fit_locally([level_loop(seed)], {(0, 0): Structure.parse("integrator")}, LEVEL, method, LEVEL_LOOP)
        far.append(np.abs(fit.parameters[0, 0] - [0.05, 0.5]) / np.sqrt(np.diag(fit.covariance[0, 0])))
    print(f"\n{method}: farthest {np.max(far):.1f} standard errors, mean square {np.mean(np.square(far)):.2f}")
    assert np.max(far) < 4.5
    assert np.mean(np.square(far)) < 2


def test_a_minimum_nearly_as_deep_widens_the_error():
    """Few lines of one run leave two dead times, 8.4 and 0.9 min, with slopes of either sign."""
    fit = fit_locally([level_loop(8)], {(0, 0): Structure.parse("integrator")}, LEVEL, "joint", LEVEL_LOOP)
    error = np.sqrt(np.diag(fit.covariance[0, 0]))
    assert fit.parameters[0, 0][0] < 0 < fit.parameters[0, 0][0] + 2 * error[0]
    assert error[0] > 0.04


def test_experiments_with_one_setpoint_moving_each_are_combined():
    segments = []
    for k in range(2):
        r = np.zeros((1800, 2))
        r[:, k] = steps(1800, 200, 700, 1000, 1400)
        run = simulate(PLANT2, LOOP2, r, 0.1, noise=0.01, seed=k)
        segments.append(segment_of(run, k))
    structures = {(0, 0): FOPDT, (0, 1): FOPDT, (1, 1): FOPDT}
    fit = fit_locally(segments, structures, MODEL2, "closed-form", LOOP2)
    for element, gain in {(0, 0): -0.58, (0, 1): 4.0, (1, 1): 3.8}.items():
        error = np.sqrt(fit.covariance[element][0, 0])
        assert abs(fit.parameters[element][0] - gain) < 4 * error
        assert error < 0.05 * abs(gain)


def test_speaking_band_ends_where_noise_takes_over():
    quiet = local_response([one_loop(1, 0.002)], "closed-form", MODEL, LOOP)
    loud = local_response([one_loop(1, 0.05)], "closed-form", MODEL, LOOP)
    (first,), (second,) = speaking_band(quiet, PLANT)[0], speaking_band(loud, PLANT)[0]
    assert first is not None
    assert second is not None
    assert first[0] == quiet.w[0]
    assert first[1] > 1.5 * second[1]
    silent = replace(loud, std=10 * np.abs(loud.sampled))
    assert speaking_band(silent, PLANT) == ((None,),)


def test_a_square_wave_speaks_at_once_and_noise_alone_does_not():
    """Between its lines a square wave says nothing, and the band is whole; beyond, noise is larger than the level's."""
    found = local_response([level_loop(7)], "joint", LEVEL)
    ((low, high),) = speaking_band(found, LEVEL)[0]
    print(f"\nspeaks from {low:.3g} to {high:.3g} rad/min")
    assert low < 0.2
    assert 0.2 < high < 2.0


def test_missing_samples_are_bridged_and_said():
    whole = one_loop(2, 0.01)
    y = whole.y.copy()
    y[200:210] = np.nan
    found = local_response([replace(whole, y=y)], "closed-form", MODEL, LOOP)
    assert found.notes == ("experiment 1, output 1: 10 missing samples were bridged by straight lines",)
    before = local_response([whole], "closed-form", MODEL, LOOP)
    assert before.notes == ()
    np.testing.assert_allclose(found.sampled[:6], before.sampled[:6], rtol=0.1)
    y[200:500] = np.nan
    with pytest.raises(Refused, match="38 % of output 1 is missing"):
        local_response([replace(whole, y=y)], "joint", MODEL)


def test_setpoints_that_cannot_be_told_apart_are_refused():
    segment = two_loops(0.01)
    same = replace(segment, r=np.repeat(segment.r[:, :1], 2, axis=1))
    with pytest.raises(Refused, match="too much alike"):
        local_response([same], "joint")
    with pytest.raises(Refused, match="set-point 2 does not move"):
        local_response([replace(segment, r=segment.r * [1.0, 0.0])], "joint")
    with pytest.raises(Refused, match="set-points are missing"):
        local_response([replace(segment, r=segment.r * np.nan)], "joint")
    with pytest.raises(Refused, match="too short"):
        local_response([replace(segment, r=segment.r[:20], u=segment.u[:20], y=segment.y[:20])], "direct")
    with pytest.raises(Refused, match="no usable segment"):
        local_response([])


def test_what_a_method_lacks_is_named():
    segment = one_loop(0, 0.01)
    with pytest.raises(LoopError, match="needs a model and a declared controller"):
        local_response([segment], "closed-form", MODEL)
    with pytest.raises(UsageError, match="method must be"):
        local_response([segment], "magic")
    with pytest.raises(UsageError, match="different sample times"):
        local_response([segment, replace(segment, h=0.7)])
