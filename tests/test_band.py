"""The plant as estimated against the band of the non-parametric response. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.loop import simulate
from trueplant.lti import TransferMatrix
from trueplant.mismatch import local_response
from trueplant.mismatch.band import within_band


@pytest.fixture(scope="module")
def responses():
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        r = random_switching(rng, 4000, 2, 20.0)
        record = simulate(WOOD_BERRY, BLT, r, 1.0, v=coloured(rng, 4000, 2, [1, -0.8], [1], 0.1))
        found.append(local_response([segment_of(record)], "joint", WOOD_BERRY))
    return found


def with_first(text: str) -> TransferMatrix:
    first = TransferMatrix.of([[text]], "min")[0, 0]
    return TransferMatrix(((first, WOOD_BERRY[0, 1]), WOOD_BERRY.elements[1]), "min")


def test_the_true_plant_lies_within(responses):
    """24 tests at the level of 1 %."""
    alarms = sum(int(np.sum(within_band(response, WOOD_BERRY).p_value < 0.01)) for response in responses)
    assert alarms <= 2


@pytest.mark.parametrize("text", ["14.5 exp(-1.4 s)/(16.7 s + 1)", "12.8 exp(-1.4 s)/((9 s + 1) (8 s + 1))"])
def test_another_gain_and_a_second_lag_lie_outside_and_leave_the_others_alone(responses, text):
    for response in responses[:4]:
        test = within_band(response, with_first(text))
        assert test.p_value[0, 0] < 1e-3
        assert np.min(test.p_value.ravel()[1:]) > 1e-4
        assert 0.01 < test.worst[0, 0] < 1
