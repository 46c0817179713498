"""Unmeasured disturbances: the filter against dense algebra, the plant told from them, what is recovered.

All records here are simulated.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.detect import elements_found, judge_elements
from trueplant.disturbance import DisturbedFit, Part, fit_with_disturbance, likelihood_p, recover
from trueplant.disturbance.kalman import smoothed, whitened
from trueplant.disturbance.models import system_of
from trueplant.errors import UsageError
from trueplant.identify import OutputEstimate, Spec, identify_output, pieces_of
from trueplant.identify.levels import SEARCHED_FREEDOM
from trueplant.loop import Simulation, simulate, step_disturbance
from trueplant.lti import TransferMatrix, sampled_response
from trueplant.lti.structure import structure_of
from trueplant.mismatch import fit_locally
from trueplant.record import Segment
from trueplant.result.budget import Source
from trueplant.study.plant.disturbance import resting_on

H = 0.7
PARTS = [Part("step", 0.3), Part("drift", 0.02), Part("ar1", 0.5, 4.0)]


def kernel(t: np.ndarray) -> np.ndarray:
    """Covariance of the three parts in continuous time: Wiener process, its integral, Ornstein-Uhlenbeck."""
    early, late = np.minimum.outer(t, t), np.maximum.outer(t, t)
    walk, slope = 0.3**2 * early, 0.02**2 * (early**2 * late / 2 - early**3 / 6)
    return walk + slope + 0.5**2 * np.exp(-(late - early) / 4.0)


def observed(samples: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return H * np.arange(samples), rng.standard_normal((samples, 3)), rng.random(samples) > 0.2


def test_innovations_are_those_of_the_dense_gaussian():
    t, y, valid = observed(80, 1)
    e, logs = whitened(system_of(PARTS, 0.2, H), y, valid)
    covariance = kernel(t)[np.ix_(valid, valid)] + 0.2**2 * np.eye(valid.sum())
    assert np.allclose(e.T @ e, y[valid].T @ np.linalg.solve(covariance, y[valid]), rtol=1e-10)
    assert logs == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-10)


def test_smoother_is_dense_conditioning():
    t, y, valid = observed(80, 2)
    system = system_of(PARTS, 0.2, H)
    found = smoothed(system, y, valid)
    prior = kernel(t)
    gain = prior[:, valid] @ np.linalg.inv(prior[np.ix_(valid, valid)] + 0.2**2 * np.eye(valid.sum()))
    assert np.allclose(np.einsum("i,kim->km", system.C, found.value), gain @ y[valid], atol=1e-10)
    variance = np.einsum("i,kij,j->k", system.C, found.covariance, system.C)
    assert np.allclose(variance, np.diag(prior - gain @ prior[valid]), atol=1e-10)


def test_gains_that_have_settled_change_nothing():
    """First order and noise, 600 samples with a gap late in them: the dense answer still."""
    rng = np.random.default_rng(3)
    t, y, valid = H * np.arange(600), rng.standard_normal((600, 1)), np.ones(600, dtype=bool)
    valid[[400, 401, 405]] = False
    e, logs = whitened(system_of([Part("ar1", 0.5, 4.0)], 0.2, H), y, valid)
    covariance = 0.25 * np.exp(-np.abs(np.subtract.outer(t, t)) / 4)[np.ix_(valid, valid)] + 0.04 * np.eye(valid.sum())
    assert (e.T @ e)[0, 0] == pytest.approx((y[valid].T @ np.linalg.solve(covariance, y[valid]))[0, 0], rel=1e-9)
    assert logs == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)


def test_steady_gain_is_that_of_python_control():
    import control

    system = system_of([Part("step", 0.3), Part("ar1", 0.5, 4.0)], 0.2, H)
    _, P, _ = control.dlqe(system.A, np.eye(2), system.C[None, :], system.Q, np.array([[system.noise]]))
    one = np.zeros((400, 1))
    one[-1] = 1.0
    e, _ = whitened(system, one, np.ones(400, dtype=bool))
    # dlqe's P is the covariance before a measurement
    assert 1 / e[-1, 0] ** 2 == pytest.approx(float(system.C @ P @ system.C) + system.noise, rel=1e-6)


def test_shock_statistic_is_the_gain_in_likelihood():
    t, y, valid = observed(60, 4)
    system = system_of(PARTS, 0.2, H)
    found = smoothed(system, y, valid).shock[25, 0]
    jump = (np.arange(60) >= 25).astype(float)[valid]
    covariance = kernel(t)[np.ix_(valid, valid)] + 0.2**2 * np.eye(valid.sum())
    weighted = np.linalg.solve(covariance, jump)
    assert np.allclose(found, weighted @ y[valid] / np.sqrt(weighted @ jump), rtol=1e-9)


def test_senseless_parts_are_refused():
    for wrong in (("jump", 1.0), ("step", 0.0), ("ar1", 1.0), ("step", 1.0, 3.0), ("ar1", 1.0, -1.0)):
        with pytest.raises(UsageError):
            Part(*wrong)


# -- a large unmeasured step ------------------------------------------------------------------------------------


def scaled(i: int, j: int, factor: float) -> TransferMatrix:
    rows = [list(row) for row in WOOD_BERRY.elements]
    rows[i][j] = rows[i][j] * factor
    return TransferMatrix(tuple(tuple(row) for row in rows))


PLANT = scaled(1, 0, 1.3)
STRUCTURES = {(i, j): structure_of(WOOD_BERRY[i, j]) for i in range(2) for j in range(2)}
TRUE = {place: structure_of(PLANT[place])[1] for place in STRUCTURES}
SIZE = 8.0


def stepped(seed: int, samples: int = 1200, size: float = SIZE) -> Simulation:
    """Wood-Berry with one gain 30 % higher, a load step of four times the set-point moves, AR(1) noise of 0.1."""
    rng = np.random.default_rng(seed)
    r = random_switching(rng, samples, 2, 20.0)
    v = coloured(rng, samples, 2, [1, -0.8], [1], 0.1)
    v += step_disturbance(samples, 1.0, samples // 3 + 0.5, [size, -size])
    return simulate(PLANT, BLT, r, 1.0, v=v)


def direct(simulation: Simulation, i: int) -> OutputEstimate:
    specs = tuple(Spec(j, STRUCTURES[i, j][0], tuple(STRUCTURES[i, j][1])) for j in range(2))
    found = identify_output([segment_of(simulation)], i, specs)
    assert found is not None
    return found


def together(simulation: Simulation, i: int, std: float = 0.2) -> DisturbedFit:
    return fit_with_disturbance(direct(simulation, i).fit, [Part("step", std)])


def errors(found: DisturbedFit, i: int) -> np.ndarray:
    return np.asarray(found.theta - np.concatenate([TRUE[i, 0], TRUE[i, 1]]))


def test_mismatch_under_a_large_unmeasured_step():
    """(18) as it stands has no digit left; with the disturbance estimated along all parameters are within a few %."""
    simulation = stepped(0)
    broken = fit_locally(
        [segment_of(simulation)], {p: s for p, (s, _) in STRUCTURES.items()}, WOOD_BERRY, "closed-form", BLT
    )
    assert max(abs(broken.parameters[p][0] / TRUE[p][0] - 1) for p in TRUE) > 0.5
    for i in range(2):
        found = together(simulation, i)
        assert found.jumps == ((401,),)
        assert np.all(np.abs(errors(found, i)) < 3.3 * found.std_errors)
        assert np.all(np.abs(errors(found, i)[[0, 3]]) < 0.05 * np.abs(found.theta[[0, 3]]))


@pytest.mark.slow
def test_intervals_cover_under_a_step():
    """15 seeded runs of 12 parameters, at most 22 of 180 outside.

    Passes with 0.997 at the level of 5 %, with 0.027 at 20 % (parameters correlated as here).
    """
    outside = 0
    for seed in range(10, 25):
        simulation = stepped(seed)
        for i in range(2):
            found = together(simulation, i)
            outside += int(np.sum(np.abs(errors(found, i)) > 1.96 * found.std_errors))
    assert outside <= 22


def test_a_step_that_is_declared_but_absent_costs_little():
    simulation = stepped(3, size=0.0)
    for i in range(2):
        plain, found = direct(simulation, i), together(simulation, i)
        assert found.jumps == ((),)
        assert np.all(found.std_errors < 1.6 * np.sqrt(np.diag(plain.covariance)))
        assert np.all(np.abs(errors(found, i)) < 3.3 * found.std_errors)


def test_recovered_disturbance():
    simulation = stepped(1)
    found = recover(segment_of(simulation), PLANT, {0: [Part("step", 0.2)], 1: [Part("step", 0.2)]})
    assert found.jumps == ((401,), (401,))
    late = slice(402, None)
    truth = simulation.v - simulation.v[0]
    assert np.allclose(np.mean(found.declared[late], axis=0), [SIZE, -SIZE], atol=0.15)
    assert np.max(np.abs(found.declared[100:400])) < 0.3
    # all of v, noise included, is there: with no white noise in the record it is known but for its level at the start
    level = np.mean(found.value[100:] - truth[100:], axis=0)
    assert np.all(np.abs(level) < 0.3)
    assert np.std(found.value[100:] - truth[100:] - level) < 0.03


def test_recovered_std_is_honest():
    """Record with white noise of 0.2 over a first-order disturbance: 95 % of the error within 1.96 std.

    Of 80 such records 80 pass, and none with a std that 20 % of the error exceeds.
    """
    rng = np.random.default_rng(5)
    samples = 3000
    v = coloured(rng, samples, 2, [1, -0.95], [1], 0.5)
    simulation = simulate(WOOD_BERRY, BLT, random_switching(rng, samples, 2, 20.0), 1.0, v=v, noise=0.2, seed=5)
    found = recover(segment_of(simulation), WOOD_BERRY)
    error = found.value - v
    error -= error.mean(axis=0)
    share = np.mean(np.abs(error) < 1.96 * found.std)
    assert 0.92 < share < 0.99
    assert np.std(error) < 0.75 * 0.2
    assert np.all(found.declared == 0)


def test_a_drift_is_recovered():
    """Slope of 0.01 a minute from t = 0: what is found rises by it."""
    rng = np.random.default_rng(6)
    samples = 1200
    drift = 0.01 * np.arange(samples)[:, None] * np.array([1.0, -0.5])
    v = coloured(rng, samples, 2, [1, -0.5], [1], 0.1) + drift
    simulation = simulate(WOOD_BERRY, BLT, random_switching(rng, samples, 2, 20.0), 1.0, v=v)
    found = recover(segment_of(simulation), WOOD_BERRY, {0: [Part("drift", 1e-3)], 1: [Part("drift", 1e-3)]})
    assert np.allclose(found.declared[-1] - found.declared[100], drift[-1] - drift[100], atol=0.2)


def test_measured_disturbances_are_not_recovered_twice():
    feed = TransferMatrix.of([["3.8 exp(-8.1 s)/(14.9 s + 1)"], ["4.9 exp(-3.4 s)/(13.2 s + 1)"]])
    rng = np.random.default_rng(7)
    samples = 1000
    d = random_switching(rng, samples, 1, 60.0)
    v = coloured(rng, samples, 2, [1, -0.5], [1], 0.05) + sampled_response(feed, d, 1.0, "linear")
    simulation = simulate(WOOD_BERRY, BLT, random_switching(rng, samples, 2, 20.0), 1.0, v=v)
    segment = segment_of(simulation)
    with_feed = replace(segment, d=d)
    rows = zip(WOOD_BERRY.elements, feed.elements, strict=True)
    whole = TransferMatrix(tuple((*a, *b) for a, b in rows))
    assert np.nanstd(recover(with_feed, whole).raw) < 0.06
    assert np.nanstd(recover(with_feed, WOOD_BERRY).raw) > 1.0


def test_a_plant_of_another_shape_is_refused():
    with pytest.raises(UsageError, match="must agree"):
        recover(segment_of(stepped(2, samples=400)), TransferMatrix.of([["1/(s + 1)"]]))


def test_an_output_that_was_not_measured_is_left_open():
    segment = segment_of(stepped(2, samples=400))
    y = segment.y.copy()
    y[15:, 0] = np.nan
    found = recover(replace(segment, y=y), WOOD_BERRY)
    assert np.isnan(found.value[:, 0]).all()
    assert np.isfinite(found.value[:, 1]).all()


def test_gaps_are_bridged():
    """A quarter of PV lost in stretches: what is recovered there is known less well, and covers.

    Of 80 such records the coverage of 80 passes, and of none with a std that 20 % of the error exceeds.
    """
    rng = np.random.default_rng(8)
    v = coloured(rng, 2000, 2, [1, -0.97], [1], 0.5)
    segment = segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 2000, 2, 20.0), 1.0, v=v))
    lost = (np.arange(2000) % 80 < 20) & (np.arange(2000) > 100)
    found = recover(replace(segment, y=np.where(lost[:, None], np.nan, segment.y)), WOOD_BERRY)
    error = (found.value - v) - np.mean((found.value - v)[~lost], axis=0)
    # outside the gaps there is the level's own uncertainty, of the order of 0.1
    assert np.all(
        np.min(found.std[lost & (np.arange(2000) % 80 == 10)], axis=0) > 2 * np.median(found.std[~lost], axis=0)
    )
    assert 0.9 < np.mean(np.abs(error[lost]) < 1.96 * found.std[lost]) < 0.99


def test_records_without_noise_are_told_apart_exactly():
    rng = np.random.default_rng(9)
    v = step_disturbance(1000, 1.0, 400.0, [3.0, 0.0])
    simulation = simulate(PLANT, BLT, random_switching(rng, 1000, 2, 20.0), 1.0, v=v)
    for i in range(2):
        assert np.allclose(together(simulation, i).theta, np.concatenate([TRUE[i, 0], TRUE[i, 1]]), rtol=1e-4)


# -- mismatch or disturbance? ----------------------------------------------------------------------------------


def test_likelihood_test_of_the_model():
    """The gain that changed is not the model's; one that did not may be, also under the disturbance as declared."""
    simulation = stepped(4)
    found = together(simulation, 1)
    gain = np.array([0])
    assert likelihood_p(found, gain, np.array([6.6])) < 1e-6
    assert likelihood_p(found, np.array([3]), np.array([-19.4])) > 1e-3
    assert likelihood_p(found, gain, np.array([6.6]), largest=True) < 0.05


def test_a_huge_disturbance_could_have_been_the_mismatch():
    """Declared fifty times as large as anything in the record, the random walk explains all: nothing is certain."""
    simulation = stepped(5, samples=600, size=0.0)
    found = together(simulation, 1, std=10.0)
    assert likelihood_p(found, np.array([0]), np.array([6.6]), largest=True) > 0.05


def test_the_p_value_of_an_element_is_that_of_the_disturbance_likelihood():
    """Not of the fit without the disturbance, from which the parameters are not."""
    simulation = stepped(4)
    estimate = direct(simulation, 1)
    found = fit_with_disturbance(estimate.fit, [Part("step", 0.2)])
    resting = resting_on(estimate, found, 0.95)
    assert np.array_equal(resting.theta, found.theta) and resting.unprofiled is None
    for column in range(2):
        index, model = np.arange(3 * column, 3 * column + 3), STRUCTURES[1, column][1]
        assert resting.likelihood_ratio_p(index, model) == pytest.approx(likelihood_p(found, index, model), rel=1e-9)
        other = estimate.likelihood_ratio_p(index, model)
        assert other != pytest.approx(likelihood_p(found, index, model), rel=1e-3, abs=0)
        assert resting.absence_p(column) < 1e-9
    doubtless = replace(resting, rise=lambda index, values: 0.0)
    judged = judge_elements(elements_found(WOOD_BERRY, {1: doubtless}), {1: doubtless})
    assert all(verdict.p_adjusted == 1.0 for verdict in judged.values())


def test_what_op_did_between_its_samples_counts_beside_a_declared_disturbance_as_well():
    """The fit with the disturbance sees it no more than the one without."""
    estimate = direct(stepped(4), 1)
    found = fit_with_disturbance(estimate.fit, [Part("step", 0.2)])
    least, runs = np.outer(*2 * [np.arange(1.0, 1 + estimate.theta.size)]), np.eye(estimate.theta.size)
    resting = resting_on(replace(estimate, uncounted={Source.ROUNDING: least, Source.EXPERIMENTS: runs}), found, 0.95)
    assert np.allclose(resting.covariance, found.covariance + least + runs)
    assert np.allclose(resting.budget.parts[Source.ROUNDING], np.diag(least))
    assert np.allclose(resting.budget.parts[Source.EXPERIMENTS], 1.0)
    assert np.all(np.diff(resting.intervals) >= 1.9 * np.arange(1.0, 1 + estimate.theta.size)[:, None])


def test_an_absent_element_costs_the_search_for_it():
    """Under a declared disturbance too: lag and dead time of an element that the model lacks were searched for."""
    estimate = replace(
        direct(stepped(4, samples=400), 1), rise=lambda index, values: 12.0 if values[0] == 0 else np.nan
    )
    assert estimate.absence_p(0) == pytest.approx(chi2.sf(12.0, SEARCHED_FREEDOM + 3))


# -- jumps in the fit ------------------------------------------------------------------------------------------


def test_a_jump_that_is_known_is_a_level_of_its_own():
    """Free of noise: with the jump given the fit is exact, and without it is not."""
    rng = np.random.default_rng(10)
    v = step_disturbance(800, 1.0, 300.0, [3.0, 0.0])
    segment = segment_of(simulate(PLANT, BLT, random_switching(rng, 800, 2, 20.0), 1.0, v=v))
    specs = [Spec(j, STRUCTURES[0, j][0], tuple(STRUCTURES[0, j][1])) for j in range(2)]
    true = np.concatenate([TRUE[0, 0], TRUE[0, 1]])
    told, untold = (identify_output([replace(segment, jumps=jumps)], 0, specs) for jumps in (((300,), ()), ()))
    assert told is not None and untold is not None
    assert np.allclose(told.theta, true, rtol=1e-5)
    assert not np.allclose(untold.theta, true, rtol=1e-3)


def test_jumps_keep_their_place_when_segments_are_joined_and_cut():
    whole = segment_of(stepped(2, samples=400))

    def part(a: int, b: int, jumps: tuple[int, ...]) -> Segment:
        arrays = {name: getattr(whole, name)[a:b] for name in ("t", "r", "u", "y", "d", "free")}
        return replace(whole, **arrays, jumps=(jumps, ()))

    (piece,) = pieces_of([part(0, 150, (40,)), part(160, 400, (20, 100))], 0)
    assert piece.jumps == (40, 180, 260)
    assert piece.from_sample(100, 250).jumps == (80,)
    assert pieces_of([part(0, 150, (40,))], 1)[0].jumps == ()
