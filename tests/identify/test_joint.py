"""All outputs from one fit, where a disturbance reaches several of them. All records are simulated."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from support.joint_bound import joint_bound
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of, wood_berry
from trueplant import plants
from trueplant.identify import Spec, identify_matrix, identify_output, specs_of
from trueplant.identify.joint import fit_jointly, fit_until_white, whiteness_p
from trueplant.loop import simulate
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import structure_of

TRUTH = [np.concatenate([structure_of(WOOD_BERRY[i, j])[1] for j in range(2)]) for i in range(2)]


def separate(segment):
    specs = specs_of(WOOD_BERRY)
    rows: list[list[Spec]] = [[spec for (row, _), spec in sorted(specs.items()) if row == i] for i in range(2)]
    return [identify_output([segment], i, row) for i, row in enumerate(rows)]


@pytest.fixture(scope="module")
def crossed():
    """Wood-Berry under its own feed disturbance, which is not measured."""
    rng = np.random.default_rng(72)
    feed = coloured(rng, 2500, 1, [1, -0.9], [1], 0.3)[:, 0]
    model = plants.wood_berry().disturbance
    v = np.column_stack([sampled_response(model[i, 0], feed, 1.0, "linear") for i in range(2)])
    v += coloured(rng, 2500, 2, [1], [1], 0.05)
    return separate(segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 2500, 2, 20.0), 1.0, v=v)))


def test_a_common_disturbance_foretold_by_one_output_helps_the_other(crossed):
    joint = fit_until_white([estimate.fit for estimate in crossed])
    assert joint is not None and joint.converged
    assert whiteness_p(joint) > 0.05
    z = [(t - true) / np.sqrt(np.diag(c)) for t, c, true in zip(joint.theta, joint.covariance, TRUTH, strict=True)]
    assert np.all(np.abs(z) < 3.5)
    alone = np.concatenate([(e.theta - true) / true for e, true in zip(crossed, TRUTH, strict=True)])
    together = np.concatenate([(t - true) / true for t, true in zip(joint.theta, TRUTH, strict=True)])
    assert np.linalg.norm(together) < 0.5 * np.linalg.norm(alone)


def test_an_autoregression_that_is_too_short_leaves_errors_that_are_not_white(crossed):
    assert whiteness_p(fit_jointly([estimate.fit for estimate in crossed], 1)) < 1e-6


def test_with_unrelated_disturbances_it_is_the_fit_of_each_output():
    alone = separate(segment_of(wood_berry(9, 2000)))
    joint = fit_jointly([estimate.fit for estimate in alone], 1)
    for estimate, theta, covariance in zip(alone, joint.theta, joint.covariance, strict=True):
        sigma = np.sqrt(np.diag(estimate.fit.covariance))
        assert np.all(np.abs(theta - estimate.fit.theta) < 0.3 * sigma)
        assert np.sqrt(np.diag(covariance)) == pytest.approx(sigma, rel=0.1)


def test_what_reaches_all_outputs_at_once_is_used_up_to_the_joint_bound():
    """Eight records whose disturbances are correlated 0.8: each output alone stays far above it."""
    sigma = 0.3**2 * (1 - 0.8**2) * np.array([[1.0, 0.8], [0.8, 1.0]])
    ratios, z = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        v = coloured(rng, 1500, 2, [1, -0.8], [1], 0.3) @ np.linalg.cholesky(sigma / sigma[0, 0]).T
        segment = segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 1500, 2, 20.0), 1.0, v=v))
        bound = np.sqrt(joint_bound(segment, TRUTH, -0.8, sigma))
        found = identify_matrix([segment], WOOD_BERRY, specs_of(WOOD_BERRY)).values()
        ratios.append(np.sqrt(np.concatenate([np.diag(one.covariance) for one in found])) / bound)
        z.append((np.concatenate([one.theta for one in found]) - np.concatenate(TRUTH)) / bound)
        alone = np.sqrt(np.concatenate([np.diag(one.fit.covariance) for one in found])) / bound
        assert alone[2] > 1.5
    typical = np.median(ratios, axis=0)  # with what slow noise and colour add to each output
    assert np.all((typical > 0.9) & (typical < 1.35))
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15


def test_rows_that_do_not_share_their_samples_are_left_alone():
    one, other = (separate(segment_of(wood_berry(9, samples))) for samples in (500, 600))
    assert fit_jointly([one[0].fit, other[1].fit]) is None


def test_too_few_whole_samples_are_left_alone():
    """Seven of ten PVs missing here and there: hardly a sample has its whole past."""
    rng = np.random.default_rng(70)
    record = segment_of(wood_berry(70, 1500))
    y = np.where(rng.random(record.y.shape) < 0.7, np.nan, record.y)
    assert fit_jointly([e.fit for e in separate(dataclasses.replace(record, y=y))], 4) is None
