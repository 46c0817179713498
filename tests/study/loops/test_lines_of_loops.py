"""Where the lines are of settings that are tried and of records that are replayed: each held from both of its sides."""

from __future__ import annotations

from types import SimpleNamespace as Stub
from typing import Any

import numpy as np
import pytest

from trueplant.loop import PID, Controller
from trueplant.result.recommendation_words import Outlook
from trueplant.study.loops import metrics, whatif
from trueplant.study.loops.candidates import BY_HAND

LAW = Controller.diagonal([PID(Kc=1.0, Ti=10.0)])


@pytest.mark.holds("study.REPLAY_STEPS")
@pytest.mark.parametrize(("thousands", "answered"), [(300, True), (600, False)])
def test_a_disturbance_is_replayed_over_four_hundred_thousand_steps(
    thousands: int, answered: bool, monkeypatch: Any
) -> None:
    """A thousand of them in each sample of the record."""
    done = Stub(t=None, r=0.0, y_true=0.0, u=None)
    monkeypatch.setattr(metrics, "simulate", lambda *given, **named: done)
    rest = np.zeros((thousands, 1))
    around: Any = Stub(disturbance=Stub(h=1.0, v=rest, r=rest), step=0.001)
    plant: Any = Stub(shape=(1, 1))
    assert (metrics.replayed(plant, LAW, around) is not None) is answered


@pytest.mark.holds("study.SAME_CROSSOVER")
@pytest.mark.parametrize(("now", "fast"), [(1.007, False), (1.015, True)])
def test_a_crossover_that_is_read_off_a_grid_may_be_higher_by_a_hundredth(
    now: float, fast: bool, monkeypatch: Any
) -> None:
    monkeypatch.setattr(whatif, "crossover", lambda *given: now)
    found = Stub(method=BY_HAND, outlook=Outlook.CHANGE)
    monkeypatch.setattr(whatif, "recommend", lambda *given: found)
    monkeypatch.setattr(whatif, "recommendation_sentence", lambda found: "")
    hand = Stub(place=(0, 0), input="u", highest=1.0, why="")
    situation = Stub(project=Stub(time_unit="min"), known=Stub(nominal={(0, 0): None}))
    tried: Any = Stub(loops=[hand], situation=situation, judged_today=None, limits=None)
    judged: Any = Stub(keeps=lambda limits: True)
    verdict = whatif.WhatIf.verdict(tried, LAW, judged)
    assert bool(verdict.too_fast) is fast
    assert verdict.recommended is not fast


@pytest.mark.holds("study.TRIED_SPAN")
def test_curves_are_drawn_for_twice_as_long_as_they_take_to_settle() -> None:
    step = Stub(settling=10.0)
    today = Stub(metrics={(0, 0): Stub(plant=Stub(setpoint=step, load=step))})
    tried: Any = Stub(judged_today=today, judge=Stub(around=Stub(step=0.1)))
    hand: Any = Stub(place=(0, 0), retuning=None)
    assert 15 < whatif.WhatIf.span(tried, hand) < 30


@pytest.mark.holds("study.TRIED_SLOWER")
@pytest.mark.parametrize(("way", "least", "most"), [("slow", 70.0, 150.0), ("fast", 0.7, 1.5)])
def test_an_integral_time_may_be_tried_that_is_ten_times_todays_or_a_tenth(way: str, least: float, most: float) -> None:
    tried: Any = Stub(today=LAW)
    entry = whatif.WhatIf._all(tried, way).entries[0, 0]
    assert isinstance(entry, PID)
    kp, ki, _, _ = entry.parallel
    assert least < kp / ki < most
