"""What the variances of an estimate are made of, against what each step says it adds. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from support.budgets import parts_of
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of, wood_berry
from trueplant import tf
from trueplant.identify import Spec, identify_output, levels
from trueplant.identify.between_samples import covariance_between_samples
from trueplant.identify.covariance import inflation, initial_state_share, least_covariance
from trueplant.identify.joint import fit_jointly, fit_until_white
from trueplant.identify.matrix import specs_of
from trueplant.identify.output import averaged
from trueplant.identify.sandwich import sandwich_covariance
from trueplant.identify.shared_disturbance import together, widened_for_shared_disturbance
from trueplant.identify.strides import Sampling
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import structure_of
from trueplant.record import Segment
from trueplant.result import Source


def rows(segments: list[Segment], timing: float = 0.0):
    specs = specs_of(WOOD_BERRY)
    own = [[spec for (row, _), spec in sorted(specs.items()) if row == i] for i in range(2)]
    found = {i: identify_output(segments, i, own[i], sampling=Sampling(timing=timing)) for i in range(2)}
    return {i: estimate for i, estimate in found.items() if estimate is not None}


@pytest.fixture(scope="module")
def plain():
    return rows([segment_of(wood_berry(9, 2000))], timing=0.05)


def test_noise_starts_and_rounding_are_what_their_steps_say(plain):
    for estimate in plain.values():
        parts, fit = parts_of(estimate), estimate.fit
        own = np.diag(fit.covariance)
        np.testing.assert_allclose(parts[Source.NOISE], own)
        np.testing.assert_allclose(parts[Source.SLOW_NOISE], own * (inflation(fit, 0.95) - 1), rtol=1e-9)
        np.testing.assert_allclose(parts[Source.START], own * initial_state_share(fit))
        least = least_covariance(estimate.row, estimate.theta, np.full(2, 0.05)) + covariance_between_samples(fit, 0.05)
        np.testing.assert_allclose(parts[Source.ROUNDING], np.diag(least))
        assert np.all(np.diag(least)[estimate.row.is_dead_time] >= 0.05**2)
        np.testing.assert_allclose(parts[Source.PROFILE], np.diag(estimate.covariance - estimate.unprofiled))


def test_profiles_widen_the_standard_errors_of_dead_times_and_what_moves_with_these_follows():
    for estimate in rows([segment_of(wood_berry(9, 2000))]).values():
        shares = parts_of(estimate)[Source.PROFILE] / np.diag(estimate.covariance)
        assert shares[estimate.row.is_dead_time].max() > 5 * shares[~estimate.row.is_dead_time].max() > 0


def test_wald_need_not_count_what_likelihood_ratios_do(plain):
    for estimate in plain.values():
        parts = parts_of(estimate)
        counted = (Source.SLOW_NOISE, Source.NOISE_MODEL, Source.MINIMA)
        by_ratio = np.diag(estimate.unprofiled - estimate.beside_ratio)
        np.testing.assert_allclose(by_ratio, sum(parts[source] for source in counted), rtol=1e-6, atol=1e-12)
        assert widened_for_shared_disturbance(estimate, [1], 0.95).beside_ratio is None
        shifts = 0.1 * np.abs(estimate.theta)[None]
        wider = averaged(estimate, shifts, np.ones(1), 0.95, Source.VALVE)
        np.testing.assert_allclose(np.diag(wider.beside_ratio - estimate.beside_ratio), shifts[0] ** 2)


def test_a_valve_adds_the_squares_of_what_it_would_move(plain):
    estimate = plain[0]
    shifts = np.array([np.zeros(estimate.theta.size), 0.1 * np.abs(estimate.theta)])
    wider = averaged(estimate, shifts, np.array([0.75, 0.25]), 0.95, Source.VALVE)
    np.testing.assert_allclose(parts_of(wider)[Source.VALVE], 0.25 * shifts[1] ** 2)
    again = averaged(wider, shifts, np.array([0.5, 0.5]), 0.95, Source.VALVE)
    np.testing.assert_allclose(parts_of(again)[Source.VALVE], 0.75 * shifts[1] ** 2)


def test_a_disturbance_of_several_outputs_widens(plain):
    wider = widened_for_shared_disturbance(plain[0], [1], 0.95)
    more = (levels.SHARED_FACTOR**2 - 1) * np.diag(plain[0].covariance)
    np.testing.assert_allclose(parts_of(wider)[Source.SHARED_DISTURBANCE], more)


def test_the_joint_fit_begins_a_budget_of_its_own(plain):
    joint = fit_until_white([estimate.fit for estimate in plain.values()])
    better = together(plain, 0.95)
    assert joint is not None and better is not None
    longer = fit_jointly([estimate.fit for estimate in plain.values()], joint.ar.shape[0])
    assert longer is not None
    for i, estimate in better.items():
        parts, before = parts_of(estimate), parts_of(plain[i])
        moved = joint.moved[i] ** 2
        assert moved.any()
        np.testing.assert_allclose(parts[Source.NOISE], np.diag(longer.covariance[i]), rtol=1e-6)
        np.testing.assert_allclose(parts[Source.NOISE_MODEL], before[Source.NOISE_MODEL] + moved)
        for kept in (Source.SLOW_NOISE, Source.START, Source.ROUNDING, Source.MINIMA):
            np.testing.assert_allclose(parts[kept], before[kept])


def test_experiments_add_their_spread():
    changed = TransferMatrix(tuple(tuple(element * 1.2 for element in row) for row in WOOD_BERRY.elements))
    segments = [segment_of(wood_berry(1, 1200)), segment_of(wood_berry(2, 1200, plant=changed), 1)]
    for estimate in rows(segments).values():
        parts = parts_of(estimate)
        assert estimate.runs is not None
        np.testing.assert_allclose(parts[Source.EXPERIMENTS], np.diag(estimate.runs.added))
        share = parts[Source.EXPERIMENTS] / np.diag(estimate.covariance)
        assert np.all(share[estimate.row.is_gain] > 0.5)


def test_noise_that_comes_and_goes_has_a_part_of_its_own():
    rng = np.random.default_rng(3)
    v = coloured(rng, 2000, 2, [1, -0.8], [1], 0.3) * (1 + 3 * (np.arange(2000) // 250 % 2))[:, None]
    record = segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 2000, 2, 20.0), 1.0, v=v))
    for estimate in rows([record]).values():
        assert estimate.uneven
        more = np.diag(sandwich_covariance(estimate.fit) - estimate.fit.covariance)
        np.testing.assert_allclose(
            parts_of(estimate)[Source.COLOUR], more, atol=1e-9 * np.diag(estimate.covariance).max()
        )


def test_a_structure_that_is_too_simple_leaves_the_noise_model_open():
    """An inverse response, of which a first order is estimated: every noise model weighs its error otherwise."""
    rng = np.random.default_rng(5)
    plant = TransferMatrix.of([["2 (-6 s + 1) exp(-2 s)/((10 s + 1)(8 s + 1))"]])
    law = Controller.diagonal([PID(Kc=0.3, Ti=15.0, sample_time=1.0)])
    r = random_switching(rng, 2000, 1, 80.0)
    record = segment_of(simulate(plant, law, r, 1.0, v=coloured(rng, 2000, 1, [1, -0.5], [1], 0.03)))
    structure, values = structure_of(tf("2 exp(-2 s)/(20 s + 1)"))
    estimate = identify_output([record], 0, [Spec(0, structure, tuple(values))])
    assert estimate is not None and estimate.undermodelled
    assert np.any(parts_of(estimate)[Source.NOISE_MODEL] > 0.1 * np.diag(estimate.covariance))


def test_a_dead_time_that_was_left_out_counts():
    """Neither the model nor the record shows one: the other parameters may be as the fit with it has them."""
    rng = np.random.default_rng(6)
    plant = TransferMatrix.of([["2/(10 s + 1)"]])
    law = Controller.diagonal([PID(Kc=0.5, Ti=15.0, sample_time=1.0)])
    found = []
    for _ in range(4):
        r = random_switching(rng, 1000, 1, 80.0)
        record = segment_of(simulate(plant, law, r, 1.0, v=coloured(rng, 1000, 1, [1, -0.5], [1], 0.1)))
        structure, values = structure_of(tf("2/(12 s + 1)"))
        estimate = identify_output([record], 0, [Spec(0, structure, tuple(values))])
        assert estimate is not None
        parts = parts_of(estimate)
        left_out = ~estimate.fit.free
        assert not np.any(parts[Source.LEFT_OUT][left_out])
        if left_out.any():
            assert parts[Source.PROFILE][left_out] == pytest.approx(np.diag(estimate.covariance)[left_out], rel=1e-3)
            found.append(np.any(parts[Source.LEFT_OUT] > 0))
    assert any(found)
