"""Wrong samples of PV: found where they are, nowhere else, and told from shocks to the plant. Simulated records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import identify_matrix, specs_of
from trueplant.identify.fit import evaluate
from trueplant.identify.spikes import _explained, _pieces, find_spikes, without_spikes
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix

PLANT = TransferMatrix.of([["2 exp(-3 s)/(10 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.4, Ti=10.0, sample_time=1.0)])


def record(seed: int, v: np.ndarray, spikes: dict[int, float] | None = None):
    """One loop; PV is wrong by so much at these samples, which the controller does not see."""
    r = random_switching(np.random.default_rng(seed), len(v), 1, 100.0)
    segment = segment_of(simulate(PLANT, LAW, r, 1.0, v=v))
    y = segment.y.copy()
    for k, size in (spikes or {}).items():
        y[k] += size
    return replace(segment, y=y)


def walk(seed: int, samples: int = 1500) -> np.ndarray:
    return 0.02 * np.cumsum(np.random.default_rng(seed).standard_normal((samples, 1)), axis=0)


def fit_of(segment):
    return identify_matrix([segment], PLANT, specs_of(PLANT))[0].fit


def found_in(segment) -> list[int]:
    """Before any is left out: the estimate of the record as it is, looked at once."""
    clean = fit_of(segment)
    bare = replace(clean.row.pieces[0], y=segment.y[:, 0], valid=np.ones(len(segment), dtype=bool))
    return [round(time) for _, time in find_spikes(replace(clean, row=replace(clean.row, pieces=(bare,))))]


def test_spikes_in_a_walk_are_found_beside_each_other_too():
    """Of 6 to 10 steps of the walk; two of them within reach of the noise model, one near the end."""
    spikes = {20: 0.2, 300: 0.12, 302: -0.15, 900: 0.13, 1497: -0.2}
    assert found_in(record(1, walk(1), spikes)) == sorted(spikes)


def test_a_shock_to_the_plant_is_no_spike():
    """PV goes on from where a shock of 12 steps has put it."""
    v = walk(2)
    v[700:] += 0.24
    assert found_in(record(2, v)) == []


@pytest.mark.parametrize("noise", ["white", "AR", "walk"])
def test_hardly_ever_is_a_sample_left_out_of_a_record_without_spikes(noise):
    """Of 20 records each one would be 1 in 5, two 1 in 60."""
    found = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        v = walk(seed) if noise == "walk" else coloured(rng, 1500, 1, [1, -0.9 * (noise == "AR")], [1], 0.05)
        found += len(found_in(record(seed, v))) > 0
    assert found <= 2


def test_what_a_spike_explains_is_what_the_likelihood_gains_without_its_sample():
    """Put right by the size that is found, the squares of the prediction errors fall by as much as is said."""
    fit = fit_of(record(3, walk(3)))
    (piece,) = _pieces(fit)
    size, explained = _explained(piece, np.concatenate([[1.0], fit.ar]))
    at, before = 800, evaluate(fit.row, fit.theta, fit.ar, fit.weights)
    y = fit.row.pieces[0].y.copy()
    y[at] -= size[at]
    right = replace(fit.row, pieces=(replace(fit.row.pieces[0], y=y),))
    after = evaluate(right, fit.theta, fit.ar, fit.weights)
    assert before.power[0, 0] - after.power[0, 0] == pytest.approx(explained[at], rel=0.05)


def test_a_spike_that_is_left_out_no_longer_moves_the_plant():
    """Ten of them, 5 to 15 steps of the walk: the error of the dead time is as without them."""
    rng = np.random.default_rng(5)
    spikes = dict(zip(rng.choice(1500, 10, replace=False), 0.02 * rng.uniform(5, 15, 10), strict=True))
    clean, wrong = (identify_matrix([record(5, walk(5), some)], PLANT, specs_of(PLANT))[0] for some in ({}, spikes))
    own, other = (np.sqrt(np.diag(one.fit.covariance)) for one in (clean, wrong))
    np.testing.assert_allclose(other, own, rtol=0.25)
    assert np.all(np.abs(wrong.theta - clean.theta) < own)


def test_only_the_sample_of_that_output_and_experiment_is_left_out():
    segment = record(1, walk(1))
    two = [segment, replace(segment, experiment=1)]
    one, other = without_spikes(two, {0: [(1, 7.0)]})
    assert np.isfinite(one.y).all()
    assert np.flatnonzero(np.isnan(other.y[:, 0])).tolist() == [7]
