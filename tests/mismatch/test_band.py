"""The plant as estimated against the band of the non-parametric response. All records are simulated."""

from __future__ import annotations

import numpy as np
import pytest

from support.chance import most
from support.simulated import BLT, WOOD_BERRY, coloured, random_switching, segment_of
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.mismatch import local_response, periodic_response
from trueplant.mismatch.band import within_band


def response(seed):
    rng = np.random.default_rng(seed)
    r = random_switching(rng, 4000, 2, 20.0)
    record = simulate(WOOD_BERRY, BLT, r, 1.0, v=coloured(rng, 4000, 2, [1, -0.8], [1], 0.1))
    return local_response([segment_of(record)], "joint", WOOD_BERRY)


def with_first(text: str) -> TransferMatrix:
    first = TransferMatrix.of([[text]], "min")[0, 0]
    return TransferMatrix(((first, WOOD_BERRY[0, 1]), WOOD_BERRY.elements[1]), "min")


def test_the_true_plant_lies_within():
    """400 tests of 100 seeded records, at most 9 alarms: passes with 0.992 at the level of 1 %, with 0.040 at 4 %."""
    alarms = sum(int(np.sum(within_band(response(seed), WOOD_BERRY).p_value < 0.01)) for seed in range(100))
    assert alarms <= most(400, 0.01)


@pytest.mark.parametrize("text", ["14.5 exp(-1.4 s)/(16.7 s + 1)", "12.8 exp(-1.4 s)/((9 s + 1) (8 s + 1))"])
def test_another_gain_and_a_second_lag_lie_outside_and_leave_the_others_alone(text):
    for seed in range(4):
        test = within_band(response(seed), with_first(text))
        assert test.p_value[0, 0] < 1e-3
        assert np.min(test.p_value.ravel()[1:]) > 1e-4
        assert 0.01 < test.worst[0, 0] < 1


def test_the_true_plant_lies_within_the_averages_over_periods_too():
    """150 seeded records of 5 periods, 5 % level: three degrees of freedom a line, half of the lines in noise.

    The closed form passes with 0.992 at that level, with less than 1e-3 at 20 %; the joint form, which is right to
    first order only and comes to about 9 %, with 0.97 at that and with 0.022 at 20 %.
    """
    wave = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 20), 10)
    plant = TransferMatrix.of([["2 exp(-1.3 s)/(5 s + 1)"]])
    law = Controller.diagonal([PID(Kc=0.8, Ti=5.0, sample_time=0.5)])
    alarms = {"joint": 0, "closed-form": 0}
    for seed in range(150):
        v = coloured(np.random.default_rng(seed), 1000, 1, [1, -0.8], [1], 0.1)
        segment = segment_of(simulate(plant, law, np.tile(wave, 5)[:, None], 0.5, v=v))
        for method in alarms:
            found = periodic_response([segment], method, plant, law, near=True)
            alarms[method] += int(within_band(found, plant).p_value[0, 0] < 0.05)
    print(f"\n{alarms} of 150")
    assert alarms["closed-form"] <= most(150, 0.05)
    assert alarms["joint"] <= 20  # to first order in errors of up to 15 %: about 9 %


def test_another_gain_lies_outside_of_the_averages():
    wave = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 20), 10)
    plant, other = (TransferMatrix.of([[f"{gain} exp(-1.3 s)/(5 s + 1)"]]) for gain in (2.0, 2.3))
    law = Controller.diagonal([PID(Kc=0.8, Ti=5.0, sample_time=0.5)])
    v = coloured(np.random.default_rng(0), 2000, 1, [1, -0.8], [1], 0.05)
    found = periodic_response([segment_of(simulate(plant, law, np.tile(wave, 10)[:, None], 0.5, v=v))], "joint", plant)
    assert within_band(found, other).p_value[0, 0] < 1e-6
    assert within_band(found, plant).p_value[0, 0] > 0.01
