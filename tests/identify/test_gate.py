"""Estimates that predict worse than the model are not given, and no others. All records here are simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from support.chance import most
from support.forced import forced
from support.one_loop import LAG, one_loop
from support.simulated import random_switching, segment_of
from trueplant.identify import identify_matrix, simulate_piece, specs_of, unanswered, worse_than_model
from trueplant.identify.gate import _p_value
from trueplant.identify.unanswered import WhyUnanswered
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

LEVEL = 0.01


def lag(gain: float = 2.0, tau: float = 60.0, dead: float = 13.4) -> TransferMatrix:
    return TransferMatrix.of([[f"{gain} exp(-{dead} s)/({tau} s + 1)"]])


def repeats(seed: int, *plants: TransferMatrix, samples: int = 600, std: float = 0.3) -> list[Segment]:
    """One experiment for each plant."""
    runs = [one_loop(100 * seed + k, plant, samples, std) for k, plant in enumerate(plants)]
    return [segment_of(run, k) for k, run in enumerate(runs)]


def refused(segments: list[Segment], level: float = LEVEL) -> bool:
    return bool(worse_than_model(identify_matrix(segments, LAG, specs_of(LAG)), LAG, level))


def apart(rng: np.random.Generator, share: float, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Prediction errors of two predictions whose difference has `size` standard deviations of noise in all; the truth
    lies between them, at this share of the way from the first to the second."""
    e = rng.standard_normal(400)
    delta = np.where(np.arange(400) % 100 < 40, np.sin(np.pi * np.arange(400) % 100 / 40), 0.0)
    delta *= size / np.linalg.norm(delta)
    return e + share * delta, e - (1 - share) * delta


def test_two_equally_wrong_predictions_are_told_apart_at_the_level():
    rng = np.random.default_rng(0)
    p = [_p_value(*([e] for e in apart(rng, 0.5, 4.0)), (0.0, 0.0), 3)[0] for _ in range(4000)]
    assert np.sum(np.array(p) < LEVEL) <= most(4000, LEVEL)
    assert np.mean(np.array(p) < 0.1) == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("size", [4.0, 8.0])
def test_the_power_is_that_of_the_likelihood_ratio(size):
    """With the second prediction right and known noise, x'x rises by a normal number: size**2 ± 2 size."""
    rng = np.random.default_rng(1)
    p = [_p_value(*([e] for e in apart(rng, 1.0, size)), (0.0, 0.0), 1)[0] for _ in range(1000)]
    assert np.mean(np.array(p) < 0.05) == pytest.approx(norm.sf(norm.isf(0.05) - size / 2), abs=0.05)


def test_what_an_estimate_owns_up_to_is_not_held_against_it():
    e = apart(np.random.default_rng(2), 1.0, 8.0)
    known, _ = _p_value([e[0]], [e[1]], (0.0, 0.0), 3)
    owned, _ = _p_value([e[0]], [e[1]], (64.0, 2 * 64.0**2), 3)
    assert known < 1e-3
    assert owned > 0.05


def test_an_estimate_of_the_unchanged_plant_passes():
    assert not refused(repeats(1, LAG))
    assert not refused(repeats(2, LAG, LAG, LAG))


@pytest.mark.slow
@pytest.mark.parametrize("spread", [0.0, 0.15])
def test_level_over_many_records(spread):
    """Of a plant that is the model, and of plants that have changed. At 5 %, which fewer records can tell."""
    rng = np.random.default_rng(3)
    factors = np.exp(spread * rng.standard_normal((70, 3)))
    plants = [lag(2 * a, 60 * b, 13.4 * c) for a, b, c in factors]
    assert sum(refused(repeats(s, plant, samples=1000), 0.05) for s, plant in enumerate(plants)) <= most(70, 0.05)


@pytest.mark.slow
def test_level_over_repeats_of_one_rig():
    """Runs that differ in truth, about the model: some of them it predicts better than their mean does."""
    rng = np.random.default_rng(4)
    count = 0
    for seed in range(70):
        factors = np.exp(0.08 * rng.standard_normal((3, 3)))
        segments = repeats(1000 + seed, *(lag(2 * a, 60 * b, 13.4 * c) for a, b, c in factors))
        count += refused(segments, 0.05)
    assert count <= most(70, 0.05)


@pytest.mark.parametrize(
    "wrong", [{2: 9 * 13.4}, {1: 300.0}, {0: -1.0}], ids=["dead time too long", "lag too long", "wrong sign"]
)
def test_wrong_minima_are_refused(wrong):
    segments = repeats(5, LAG, LAG, LAG, samples=1000, std=0.2)
    (estimate,) = identify_matrix(segments, LAG, specs_of(LAG)).values()
    assert not worse_than_model({0: estimate}, LAG)
    found = worse_than_model({0: forced(estimate, wrong)}, LAG)
    assert found[0].p_value < LEVEL
    assert found[0].ratio > 1


def test_different_plants_taken_for_one_are_refused():
    """The estimate of both, without the spread between them, beside the model of the first."""
    segments = repeats(6, LAG, lag(4.0), samples=1500, std=0.1)
    (estimate,) = identify_matrix(segments, LAG, specs_of(LAG)).values()
    fit = estimate.fit
    as_one = replace(estimate, runs=None, theta=fit.theta, covariance=fit.covariance)
    found = worse_than_model({0: as_one}, LAG)
    assert found[0].experiment == 0
    # with the spread in its covariance it says how far it is off either plant
    assert estimate.disputed
    assert not worse_than_model({0: estimate}, LAG)


def test_an_estimate_that_is_refuted_answers_nothing():
    (estimate,) = identify_matrix(repeats(7, LAG), LAG, specs_of(LAG)).values()
    assert not unanswered(estimate)
    why = WhyUnanswered.MODEL_PREDICTS_BETTER
    found = unanswered(estimate.without_answers(why, "so it is"))
    assert {k: (one.why, one.text) for k, one in found.items()} == dict.fromkeys(range(3), (why, "so it is"))


def test_an_output_without_a_model_is_not_compared():
    nothing = TransferMatrix.of([["0"]])
    (spec,) = specs_of(LAG).values()
    estimates = identify_matrix(repeats(8, LAG), nothing, {(0, 0): replace(spec, initial=None)})
    assert estimates
    assert worse_than_model(estimates, nothing) == {}


def integrating(seed: int) -> Segment:
    """0.05 exp(-3.4 s)/s under PI control, with a random walk on its output."""
    rng = np.random.default_rng(seed)
    law = Controller.diagonal([PID(Kc=2.0, Ti=40.0, sample_time=1.0)])
    walk = 0.1 * np.cumsum(rng.standard_normal((1000, 1)), axis=0)
    return segment_of(
        simulate(TransferMatrix.of([["0.05 exp(-3.4 s)/s"]]), law, random_switching(rng, 1000, 1, 100.0), 1.0, v=walk)
    )


@pytest.mark.slow
def test_an_integrating_plant_with_a_wandering_disturbance():
    """The true plant beside a model 20 % off: simulated from OP it often loses, by prediction errors it does not."""
    model, true = TransferMatrix.of([["0.04 exp(-3.4 s)/s"]]), TransferMatrix.of([["0.05 exp(-3.4 s)/s"]])
    theta = np.array([0.05, 3.4])
    lost = taken = kept = 0
    for seed in range(40):
        (estimate,) = identify_matrix([integrating(seed)], model, specs_of(model)).values()
        taken += bool(worse_than_model({0: estimate}, model))
        held = estimate.validation
        held = None if held is None else replace(held, trained=replace(held.trained, theta=theta))
        kept += bool(worse_than_model({0: replace(estimate, theta=theta, validation=held)}, model))
        (piece,) = estimate.row.pieces
        by_model, by_plant = (
            np.sum((piece.y - simulate_piece(piece, [(0, matrix[0, 0])], []))[piece.valid] ** 2)
            for matrix in (model, true)
        )
        lost += bool(by_plant > by_model)
    assert lost > 20
    assert taken <= 1
    assert kept <= 1
