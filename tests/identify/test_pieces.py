"""A record in pieces whose past nobody knows. All records are simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.simulated import coloured, random_switching, segment_of
from trueplant.identify import identify_matrix, specs_of
from trueplant.identify.likelihood import held_at, rise
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record.types import Segment

TRUTH = np.array([1.15, 6.6, 9.8])
PLANT = TransferMatrix.of([["1.15 exp(-9.8 s)/(6.6 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.29, Ti=6.6, sample_time=1.0)])


def pieces(seed: int, level: float) -> list[Segment]:
    """A fifth of one loop's record, in pieces of some 60 samples, PV about a level; AR(1) disturbance, pole 0.75."""
    rng = np.random.default_rng(seed)
    v = coloured(rng, 6000, 1, [1, -0.75], [1], 0.14)
    whole = segment_of(simulate(PLANT, LAW, random_switching(rng, 6000, 1, 60.0), 1.0, v=v))
    lengths, gaps = rng.geometric(1 / 60, 60), rng.geometric(1 / 240, 60)
    found = []
    for first, length in zip(np.cumsum(lengths + gaps) - lengths, lengths, strict=True):
        part = slice(int(first), int(first + length))
        if length > 10 and part.stop < 6000:
            cut = {name: getattr(whole, name)[part] for name in ("t", "r", "u", "d", "free")}
            found.append(replace(whole, y=whole.y[part] + level, **cut))
    return found


@pytest.mark.parametrize("seed", range(3))
def test_a_level_of_pv_changes_nothing(seed):
    """Near a walk a noise model cancels levels: PV at 50 once held it there, and the dead time came out as 0."""
    estimates = [identify_matrix(pieces(seed, level), PLANT, specs_of(PLANT))[0] for level in (0.0, 50.0, -3000.0)]
    errors = np.sqrt(np.diag(estimates[0].covariance))
    for estimate in estimates[1:]:
        assert np.all(np.abs(estimate.theta - estimates[0].theta) < 0.01 * errors)
        assert np.allclose(np.sqrt(np.diag(estimate.covariance)), errors, rtol=0.01)
    assert np.all(np.abs(estimates[0].theta - TRUTH) < 3.5 * errors)


def test_a_ratio_of_likelihoods_counts_the_errors_that_are_free():
    """The starts and levels of the pieces leave fewer of them: `rise` and the deviances say the same."""
    fit = identify_matrix(pieces(1, 0.0), PLANT, specs_of(PLANT))[0].fit
    held = held_at(fit, np.array([0]), np.array([1.3]))
    assert fit.count - fit.left > 30
    assert held.deviance - fit.deviance == pytest.approx(rise(fit, held), rel=1e-9)
