"""What a structure that was found leaves open of where PV settles, in simulated records that end before it does."""

from __future__ import annotations

import numpy as np
import pytest

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import Spec, identify_matrix
from trueplant.identify.estimate import estimate_row
from trueplant.identify.further_lag import further, log_odds, with_further_lags
from trueplant.identify.likelihood import held_at, rise
from trueplant.identify.output import OutputEstimate
from trueplant.identify.pieces import pieces_of
from trueplant.identify.row import Row
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.record import Segment
from trueplant.result.budget import Source

LAW = Controller.diagonal([PID(Kc=4.0, Ti=40.0, sample_time=1.0)])
OVEN = "0.65 (250 s + 1)(30 s + 1) exp(-0.5 s)/((400 s + 1)(150 s + 1)(8 s + 1))"
"""Four to six minutes until it settles, of which a record of five minutes under control shows little."""
MODEL = Spec(0, Structure.parse("fopdt"), (0.8, 200.0, 2.0))


def record(seed: int, samples: int = 300, noise: float = 0.003, plant: str = OVEN) -> Segment:
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, samples, 1, 60.0), coloured(rng, samples, 1, [1, -0.8], [1], noise)
    return segment_of(simulate(TransferMatrix.of([[plant]], "s"), LAW, r, 1.0, v=v))


def found(segment: Segment) -> OutputEstimate:
    model = TransferMatrix.of([["0.8 exp(-2 s)/(200 s + 1)"]], "s")
    return identify_matrix([segment], model, {(0, 0): MODEL}, structures=True)[0]


def covers(estimate: OutputEstimate, gain: float) -> bool:
    low, high = estimate.intervals[0]
    return bool(low <= gain <= high)


@pytest.mark.slow
def test_a_gain_that_the_record_did_not_see_is_not_given_for_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    records = [record(seed) for seed in range(16)]
    with monkeypatch.context() as bare:
        bare.setattr("trueplant.identify.structures.with_further_lags", lambda estimate, *_: estimate)
        sure = [found(one) for one in records]
    estimates = [found(one) for one in records]
    # The slow half of the plant, which a search that begins at equal lags alone misses in every third record.
    assert all(str(one.row.specs[0].structure) == "sopdt+lead" for one in estimates)
    assert all(Source.STRUCTURE in one.budget.parts for one in estimates)
    assert sum(covers(one, 0.65) for one in sure) <= 8
    assert sum(covers(one, 0.65) for one in estimates) >= 13


@pytest.mark.parametrize("seed", [3, 15, 20])
def test_a_structure_that_is_left_open_counts_with_the_richer_one(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nine tenths of the gain come by a lag as long as the record, under slow noise: fast noise alone would show it."""
    rng = np.random.default_rng(seed)
    r, v = random_switching(rng, 250, 1, 60.0), coloured(rng, 250, 1, [1, -0.99], [1], 0.02)
    plant = TransferMatrix.of([["0.65 (34 s + 1) exp(-0.5 s)/((250 s + 1)(10 s + 1))"]], "s")
    segment = segment_of(simulate(plant, LAW, r, 1.0, v=v))
    estimate = found(segment)
    assert 0.01 < estimate.structure_p[0] < 0.05
    assert not estimate.rejected and not estimate.kept
    assert covers(estimate, 0.65) and Source.STRUCTURE in estimate.budget.parts
    monkeypatch.setattr("trueplant.identify.structures.with_richer", lambda estimate, *_: estimate)
    assert not covers(found(segment), 0.65)


def test_so_does_an_element_beside_it_whose_structure_suffices(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two set-points that move together: what the one element may lack would change the other."""
    rng = np.random.default_rng(13)
    r, v = np.tile(random_switching(rng, 400, 2, 60.0)[:, :1], 2), coloured(rng, 400, 2, [1, -0.8], [1], 0.005)
    across = "0.2 exp(-5 s)/(150 s + 1)"
    plant = TransferMatrix.of([[OVEN, across], [across, "0.65 exp(-2 s)/(180 s + 1)"]], "s")
    both = Controller.diagonal([PID(Kc=4.0, Ti=40.0, sample_time=1.0)] * 2)
    segment = segment_of(simulate(plant, both, r, 1.0, v=v))
    elements = ["0.8 exp(-2 s)/(200 s + 1)", "0.25 exp(-5 s)/(180 s + 1)"]
    model = TransferMatrix.of([elements, elements[::-1]], "s")
    specs = {(0, 0): MODEL, (0, 1): Spec(1, MODEL.structure, (0.25, 180.0, 5.0))}

    def row() -> OutputEstimate:
        return identify_matrix([segment], model, specs, structures=True)[0]

    estimate = row()
    assert estimate.structure_p[1] < 0.05 < estimate.structure_p[0]
    assert not estimate.rejected and covers(estimate, 0.65)
    monkeypatch.setattr("trueplant.identify.structures.with_richer", lambda estimate, *_: estimate)
    assert not covers(row(), 0.65)


def test_what_a_long_record_shows_stays_known() -> None:
    estimate = found(record(0, 8000, 0.05, "0.65 (30 s + 1) exp(-0.5 s)/((150 s + 1)(8 s + 1))"))
    assert 0 in estimate.rejected and covers(estimate, 0.65)
    assert np.abs(estimate.intervals[0] - 0.65).max() < 0.02


def test_nothing_is_added_where_no_structure_was_replaced_nor_without_noise() -> None:
    estimate = found(record(0, 600, 0.01, "0.8 exp(-2 s)/(200 s + 1)"))
    assert not estimate.rejected
    assert with_further_lags(estimate, [], 0.95) is estimate
    assert Source.STRUCTURE not in estimate.budget.parts
    silent = pieces_of([record(0, 300, 0.0, "0.8 exp(-2 s)/(200 s + 1)")], 0)
    exact = estimate_row(Row((MODEL,), silent), 200.0)
    assert further(exact, 0) == []


@pytest.mark.parametrize("seed", range(3))
def test_odds_are_those_of_an_integral_over_the_further_lag_and_lead(seed: int) -> None:
    """Of the likelihood, the others fitted anew everywhere, over normal log lag and asinh lead, by sums on a grid."""
    spec = Spec(0, Structure.parse("sopdt+lead"), (0.65, 150.0, 8.0, 30.0, 0.5))
    segment = record(seed, 600, 0.02, "0.65 (30 s + 1) exp(-0.5 s)/((150 s + 1)(8 s + 1))")
    fit = estimate_row(Row((spec,), pieces_of([segment], 0)), 150.0)
    richer = max(further(fit, 0), key=lambda one: log_odds(one, fit, 0))
    structure = richer.row.specs[0].structure
    index = np.array([np.flatnonzero(structure.is_lag)[-1], np.flatnonzero(structure.is_lead)[-1]])
    prior = richer.row.prior
    steps = np.arange(-3.0, 3.01, 0.4)
    lags = prior.model[index[0]] * np.exp(steps)
    leads = prior.unit[index[1]] * np.sinh(np.arcsinh(prior.model[index[1]] / prior.unit[index[1]]) + steps)
    total = 0.0
    for lag in lags:
        for lead in leads:
            there = held_at(richer, index, np.array([lag, lead]))
            total += np.exp((rise(there, fit) - rise(fit, there)) / 2)
    assert log_odds(richer, fit, 0) == pytest.approx(np.log(total * 0.4**2 / (2 * np.pi)), abs=0.7)
