"""Records that no structure describes: their halves count as two experiments. All records are simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import OutputEstimate, counting_halves, identify_output, specs_of
from trueplant.identify.halves import in_halves
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment
from trueplant.result.budget import Source

PLANT = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)"]])
SPECS = list(specs_of(PLANT).values())


def half(seed: int, share: float, experiment: int) -> Segment:
    """600 samples of the loop with so much of the gain."""
    rng = np.random.default_rng(seed)
    law = Controller.diagonal([PID(Kc=0.6, Ti=10.0, sample_time=1.0)])
    plant = TransferMatrix.of([[f"{2 * share} exp(-3.3 s)/(10 s + 1)"]])
    r, v = random_switching(rng, 600, 1, 40.0), coloured(rng, 600, 1, [1, -0.8], [1], 0.1)
    return segment_of(simulate(plant, law, r, 1.0, v=v), experiment)


def joined(one: Segment, other: Segment) -> Segment:
    columns = {
        name: np.concatenate([getattr(one, name), getattr(other, name)]) for name in ("r", "u", "y", "d", "free")
    }
    return replace(one, t=np.arange(len(one.t) + len(other.t)) * one.h, **columns)


def following(estimate: OutputEstimate) -> OutputEstimate:
    """The same, its prediction errors called related to what OP does."""
    return replace(estimate, tests=replace(estimate.tests, cross_p=np.array([1e-6])))


@pytest.fixture(scope="module")
def moved() -> OutputEstimate:
    """A gain of 1.7 in the first half and of 2.3 in the second."""
    found = identify_output([joined(half(1, 0.85, 0), half(2, 1.15, 0))], 0, SPECS)
    assert found is not None
    return found


def test_they_are_as_far_apart_as_two_experiments(moved):
    """What they add is what the same halves add that are given as two experiments."""
    runs = identify_output([half(1, 0.85, 0), half(2, 1.15, 1)], 0, SPECS).runs
    counted = counting_halves(following(moved), 0.95)
    assert counted.halves.theta == pytest.approx(runs.theta, rel=0.05)
    assert np.sqrt(np.diag(counted.halves.added)) == pytest.approx(np.sqrt(np.diag(runs.added)), rel=0.1)
    assert counted.covariance == pytest.approx(moved.covariance + counted.halves.added)
    assert counted.budget.parts[Source.STRUCTURE] == pytest.approx(np.diag(counted.halves.added))
    (low, high), (own_low, own_high) = counted.intervals[0], moved.intervals[0]
    assert low < 2.0 < high and high - low > 1.5 * (own_high - own_low)


def test_they_are_not_asked_where_the_structure_suffices(moved):
    plain = replace(moved, tests=replace(moved.tests, cross_p=np.array([0.5])))
    assert counting_halves(plain, 0.95) is plain


def test_they_are_not_asked_where_a_richer_structure_was_counted_for(moved):
    kept = replace(following(moved), kept=(0,))
    assert counting_halves(kept, 0.95) is kept


def test_records_too_short_to_be_halved_stay_as_they_are(moved):
    short = replace(moved.fit, row=replace(moved.row, pieces=moved.row.between(0, 20)), weights=np.ones(1))
    kept = replace(following(moved), fit=short)
    assert counting_halves(kept, 0.95) is kept


def test_halves_have_every_sample_once(moved):
    pieces = in_halves(moved.fit).row.pieces
    assert [piece.experiment for piece in pieces] == [0, 1]
    assert sum(piece.y.size for piece in pieces) == 1200
    seen = [int(piece.valid.sum()) for piece in pieces]
    assert abs(seen[0] - seen[1]) <= 1
