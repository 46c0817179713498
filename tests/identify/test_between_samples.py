"""OP that moves between its recorded samples. All records are simulated."""

from __future__ import annotations

import numpy as np

from support.chance import most
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of, wood_berry
from trueplant.identify import identify_matrix, identify_output, specs_of
from trueplant.identify.between_samples import covariance_between_samples
from trueplant.loop import simulate
from trueplant.lti import TransferMatrix
from trueplant.lti.structure import structure_of
from trueplant.record.types import Segment

FOPDT = TransferMatrix.of([["-0.7/(12 s + 1)"]])
TRUTH = [np.concatenate([structure_of(WOOD_BERRY[i, j])[1] for j in range(2)]) for i in range(2)]


def every(segment: Segment, n: int) -> Segment:
    """The record of a historian that keeps each n-th sample."""
    rows = {name: np.ascontiguousarray(getattr(segment, name)[::n]) for name in ("t", "r", "u", "y", "d", "free")}
    return Segment(segment.experiment, n * segment.h, hold=segment.hold, **rows)


def test_a_record_that_is_fine_enough_moves_gains_and_lags_by_little_more_than_chance():
    """Lags of 17 and 21 samples; the dead time of one sample falls between those that are left."""
    row = [spec for (i, _), spec in sorted(specs_of(WOOD_BERRY).items()) if i == 0]
    moved = []
    for seed in range(6):
        fit = identify_output([segment_of(wood_berry(60 + seed, 2000))], 0, row).fit
        moved.append(np.sqrt(np.diag(covariance_between_samples(fit, 0.05)) / np.diag(fit.covariance)))
    assert np.all(np.median(moved, axis=0)[[0, 1, 3, 4]] < 3)
    assert np.median(moved, axis=0)[2] > 10


def test_gains_and_lags_are_covered_where_the_controller_scans_eight_times_a_sample():
    missed, without, index = 0, 0, [0, 1, 3, 4]  # gains and lags
    for seed in range(12):
        rng = np.random.default_rng(900 + seed)
        v = coloured(rng, 8000, 2, [1, -0.95], [1], 0.3)
        fine = segment_of(simulate(WOOD_BERRY, BLT, random_switching(rng, 8000, 2, 200.0), 0.5, v=v))
        record = every(fine, 8)
        for i, found in identify_matrix([record], WOOD_BERRY, specs_of(WOOD_BERRY), timing=record.h / 2).items():
            low, high = found.intervals[index].T
            missed += int(np.sum((TRUTH[i][index] < low) | (TRUTH[i][index] > high)))
            bare = np.sqrt(np.diag(found.covariance - covariance_between_samples(found.fit, record.h / 2)))
            without += int(np.sum(np.abs(found.theta - TRUTH[i])[index] > 1.96 * bare[index]))
    assert missed <= most(96, 0.05) < without
