"""A valve at its end while OP goes on: declared, undeclared, or not there. All records are simulated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from support.simulated import coloured, random_switching
from trueplant import Project, Result
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.record import Segment
from trueplant.study import levels
from trueplant.study.data import valve_ends
from trueplant.study.data.valve_ends import Answers, found_end
from trueplant.study.pipeline import analyse

PLANT = TransferMatrix.of([["2 exp(-3.3 s)/(12 s + 1)"]], "min")
LAW = Controller.diagonal([PID(Kc=0.8, Ti=12.0, sample_time=1.0)])
SAMPLES = 2000


def record(seed: int, end: float = np.inf, std: float = 0.3, **more: Any) -> Segment:
    """A loop whose OP goes on beyond an upper end by what the controller still asks for."""
    rng = np.random.default_rng(seed)
    r = 3 * random_switching(rng, SAMPLES, 1, 80.0)
    v = coloured(rng, SAMPLES, 1, [1, -0.88], [1], std * np.sqrt(1 - 0.88**2))
    s = simulate(PLANT, LAW, r, 1.0, v=v, limits=np.array([[-np.inf, end]]), **more)
    u = np.where(s.u >= end, s.u + 0.8 * np.maximum(s.r - s.y, 0), s.u)
    return Segment(0, 1.0, s.t, s.r, u, s.y, s.d, np.ones((SAMPLES, 1), dtype=bool), ("written",))


def end_of(segment: Segment) -> tuple[float, float] | None:
    return found_end(Answers.of([segment], 0), 1)


def test_an_end_that_nobody_declared_is_found_where_it_is_above_or_below() -> None:
    segments = [record(seed, end=1.8) for seed in range(8)]
    turned = [replace(one, u=-one.u, y=-one.y, r=-one.r) for one in segments]
    above, below = ([found for one in ones if (found := end_of(one)) is not None] for ones in (segments, turned))
    assert sum(low == -np.inf and abs(high - 1.8) < 0.15 for low, high in above) >= 6
    assert sum(high == np.inf and abs(low + 1.8) < 0.15 for low, high in below) >= 6


@pytest.mark.slow
def test_none_is_found_where_op_acts_throughout() -> None:
    assert not any(end_of(record(seed)) for seed in range(100, 400))


def test_a_gain_that_varies_with_op_is_no_end() -> None:
    """A valve whose flow rises with the square of its stem: what OP adds grows less and less the lower it is."""
    for seed in range(6):
        segment = record(seed, std=0.1)
        u = segment.u[:, 0] + 0.05 * segment.u[:, 0] ** 2
        plain = simulate(PLANT, None, np.zeros((SAMPLES, 1)), 1.0, u=segment.u).y
        bent = simulate(PLANT, None, np.zeros((SAMPLES, 1)), 1.0, u=u[:, None]).y
        assert end_of(replace(segment, y=segment.y + bent - plain)) is None


def test_ends_are_asked_for_at_four_thousand_samples() -> None:
    segment = record(1)
    answers = Answers.of([segment] * 12, 0)
    (rows,) = answers.outputs
    assert 2800 < len(rows.now) < 5600


def test_tried_are_ends_with_up_to_two_thirds_of_the_record_beyond() -> None:
    assert max(levels.END_SHARES) == 0.65 and min(levels.END_SHARES) > 0
    assert valve_ends._beyond([record(1, end=1.8)], 0, (-9.0, 1.8))
    assert not valve_ends._beyond([record(1, end=1.8)], 0, (-9.0, 9.0))


PROJECT = """
time_unit = "min"
data = {files = ["p.csv"], time = "t"}
output = [{name = "y", pv = "pv", sp = "sp"}]
input = [{name = "u", op = "op", limits = LIMITS}]
model = [{output = "y", input = "u", tf = "2 exp(-3.3 s)/(12 s + 1)"}]
"""


def analysed(segment: Segment, limits: list[float]) -> Result:
    columns = {"t": segment.t, "sp": segment.r[:, 0], "op": segment.u[:, 0], "pv": segment.y[:, 0]}
    return analyse(Project.from_toml(PROJECT.replace("LIMITS", str(limits))), frames=[columns])


def test_what_an_op_moves_that_acts_no_more_is_not_answered_until_its_limits_are_declared() -> None:
    segment = record(30, end=1.8)
    refused = analysed(segment, [-20.0, 20.0])
    assert refused.status == "refused" and refused.elements[0].verdict == "not identifiable"
    (reason,) = [reason for reason in refused.reasons if reason.code == "refuted"]
    assert "OP of u seems to act up to about 1.8 only" in reason.message and reason.where == "y"
    assert not set(refused.reasons) & set(refused.notes)
    answered = analysed(segment, [-20.0, 1.8])
    assert answered.elements[0].verdict == "unchanged"
    for p, true in zip(answered.elements[0].parameters, (2.0, 12.0, 3.3), strict=True):
        assert abs(p.plant - true) < 4 * p.std_error
