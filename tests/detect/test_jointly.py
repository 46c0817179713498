"""Verdicts where all outputs are estimated together. All records are simulated."""

from __future__ import annotations

import numpy as np

from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.detect.elements import elements_found, judge_elements
from trueplant.identify import identify_matrix, specs_of
from trueplant.loop import simulate
from trueplant.lti import TransferMatrix


def test_a_change_that_only_both_outputs_together_show_is_found():
    """Each output alone tells the gain a fifth as well, and would not have shown a change of a tenth."""
    rng = np.random.default_rng(2)
    r, root = random_switching(rng, 1200, 2, 20.0), np.linalg.cholesky([[1, 0.995], [0.995, 1]])
    v = coloured(rng, 1200, 2, [1, -0.5], [1], 0.5) @ root.T
    first, second = WOOD_BERRY.elements
    plant = TransferMatrix(((first[0] * 1.1, first[1]), second), "min")
    segment = segment_of(simulate(plant, BLT, r, 1.0, v=v))
    estimates = identify_matrix([segment], WOOD_BERRY, specs_of(WOOD_BERRY))
    verdicts = judge_elements(elements_found(WOOD_BERRY, estimates), estimates)
    assert all(estimate.jointly for estimate in estimates.values())
    low, high = estimates[0].intervals[0]
    assert low < 1.1 * 12.8 < high and low > 12.8
    assert [place for place, one in verdicts.items() if str(one.verdict) == "changed"] == [(0, 0)]
