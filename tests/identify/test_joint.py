"""All outputs from one fit, where a disturbance reaches several of them. All records are simulated."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from support.joint_bound import joint_bound
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of, wood_berry
from trueplant import plants
from trueplant.identify import Spec, identify_matrix, identify_output, shared_disturbance, specs_of
from trueplant.identify.fit import fit_row
from trueplant.identify.joint import _chosen_order, fit_jointly, fit_until_white, whiteness_p
from trueplant.identify.shared_disturbance import predicted_outputs, related_at_once
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.sampled import sampled_response
from trueplant.lti.structure import structure_of

TRUTH = [np.concatenate([structure_of(WOOD_BERRY[i, j])[1] for j in range(2)]) for i in range(2)]


def row_of(model, i) -> list[Spec]:
    return [spec for (row, _), spec in sorted(specs_of(model).items()) if row == i]


def separate(segment, model=WOOD_BERRY):
    return [identify_output([segment], i, row_of(model, i)) for i in range(2)]


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


def test_the_likelihood_of_all_rises_as_the_joint_covariance_says(crossed):
    """By 1 a standard error off, of each gain of each output."""
    joint = fit_until_white([estimate.fit for estimate in crossed])
    for i in range(2):
        for k in (0, 3):
            sigma = np.sqrt((joint.covariance[i] - np.diag(joint.moved[i] ** 2))[k, k])
            for way in (-1, 1):
                risen = joint.rise(i)(np.array([k]), joint.theta[i][[k]] + way * sigma)
                assert risen == pytest.approx(1.0, rel=0.15)


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


@pytest.mark.parametrize("lost", [0, 9])
def test_the_order_of_the_vector_autoregression_does_not_depend_on_units(lost):
    """Of first order, in three pieces, whole or with every ninth sample lost."""
    rng = np.random.default_rng(3)
    v = np.split(lfilter([1], [1, -0.7], rng.standard_normal((1500, 2)), axis=0), 3)
    valid = [np.arange(500) % lost != lost - 1 if lost else np.ones(500, dtype=bool) for _ in v]
    fits = [SimpleNamespace(ar=np.zeros(5))] * 2
    assert {_chosen_order([unit * x for x in v], valid, fits) for unit in (1e-3, 1.0, 1e3)} == {1}


def test_the_joint_fit_does_not_depend_on_units():
    """The same record with the second PV, and its model, in a thousandth of its unit."""
    segment = segment_of(wood_berry(5, 1500))
    scale = np.array([1.0, 1000.0])
    other = TransferMatrix(
        tuple(tuple(float(k) * cell for cell in row) for k, row in zip(scale, WOOD_BERRY.elements, strict=True))
    )
    plain, scaled = (
        fit_jointly([one.fit for one in separate(s, model)])
        for s, model in ((segment, WOOD_BERRY), (dataclasses.replace(segment, y=segment.y * scale), other))
    )
    assert plain.ar.shape == scaled.ar.shape
    assert scaled.theta[1][[1, 2, 4, 5]] == pytest.approx(plain.theta[1][[1, 2, 4, 5]], rel=1e-3)


def test_what_a_fit_holds_the_joint_fit_holds():
    alone = separate(segment_of(wood_berry(9, 1500)))
    free = np.array([True, True, False, True, True, True])
    theta = np.where(free, alone[0].fit.theta, 0.0)
    held = fit_row(alone[0].fit.row, theta, alone[0].fit.ar, free=free)
    joint = fit_jointly([held, alone[1].fit], 1)
    assert joint.theta[0][2] == 0.0 and joint.covariance[0][2, 2] < 1e-20


def test_a_dead_time_that_is_held_is_no_surer_for_the_outputs_together():
    """Two that the models do not have and the record does not show, of 0.3 s: they may be there all the same."""
    declared = [
        ["2/((40 s + 1)(5 s + 1))", "0.5 exp(-9 s)/(30 s + 1)"],
        ["0.4 exp(-7 s)/(35 s + 1)", "-1.5/(25 s + 1)"],
    ]
    model = TransferMatrix.of(declared)
    true = TransferMatrix.of([["2 exp(-0.3 s)/((40 s + 1)(5 s + 1))", declared[0][1]], declared[1]])
    law = Controller.diagonal([PID(Kc=1.0, Ti=40.0, sample_time=1.0), PID(Kc=-1.0, Ti=30.0, sample_time=1.0)])
    rng = np.random.default_rng(3)
    e = rng.standard_normal((2500, 2)) @ np.linalg.cholesky(np.array([[1.0, 0.8], [0.8, 1.0]])).T
    v = lfilter([0.05], [1, -0.8], e, axis=0)
    record = segment_of(simulate(true, law, random_switching(rng, 2500, 2, 60.0), 1.0, v=v))
    found = identify_matrix([record], model, specs_of(model))
    assert all(one.jointly for one in found.values())
    held = [(found[0], 3, 0.3), (found[1], 5, 0.0)]
    for one, index, dead_time in held:
        assert not one.fit.free[index] and one.theta[index] == 0
        low, high = one.intervals[index]
        assert low == 0 and dead_time < high < 2 and np.sqrt(one.covariance[index, index]) > 0.05


@pytest.mark.parametrize("missing", [False, True])
def test_disturbances_are_found_to_pass_from_output_to_output_whatever_is_missing(missing):
    """Seen in PV 1 three samples before PV 2, in two experiments, of which PV 2 may be missing in the first."""
    segments = []
    for k in range(2):
        rng = np.random.default_rng(40 + k)
        e = coloured(rng, 903, 1, [1, -0.9], [1], 0.4)[:, 0]
        v = np.column_stack([e[3:], 1.5 * e[:-3]]) + 0.03 * rng.standard_normal((900, 2))
        segments.append(segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 900, 2, 20.0), 1.0, v=v), k))
    if missing:
        segments[0] = dataclasses.replace(segments[0], y=segments[0].y * [1.0, np.nan])
    found = {i: identify_output(segments, i, row_of(WOOD_BERRY, i)) for i in range(2)}
    assert predicted_outputs(found) == {1: [0]}


def test_outliers_of_two_outputs_that_meet_are_no_disturbance_of_both(monkeypatch):
    """400 pairs of unrelated errors, one in a hundred tenfold: 1 % pass for related, at most 2.5 % (0.995)."""
    rng = np.random.default_rng(1)
    errors = rng.standard_normal((800, 1500)) * np.where(rng.random((800, 1500)) < 0.01, 10.0, 1.0)
    monkeypatch.setattr(shared_disturbance, "weighted_errors", lambda fit: [errors[fit.number]])
    piece = SimpleNamespace(h=1.0, times=np.arange(1500.0), experiment=0)
    row = SimpleNamespace(pieces=[piece], stride=1)
    found = [SimpleNamespace(fit=SimpleNamespace(row=row, number=k)) for k in range(800)]

    def related(test) -> int:
        return sum(bool(test({0: one, 1: other})) for one, other in zip(found[::2], found[1::2], strict=True))

    assert related(predicted_outputs) <= 10 and related(related_at_once) <= 10
    monkeypatch.setattr(shared_disturbance, "normal_scores", lambda errors: errors)
    assert related(predicted_outputs) > 15, "as they are, more do"
