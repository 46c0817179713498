"""Measured disturbances in a whole analysis: their hold declared, found and said, or left open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import trueplant as tp
from support.budgets import sources_of
from trueplant.result import Code, Source

LOOP = """
time_unit = "min"
[data]
files = ["record.csv"]
time = "t"
[[output]]
name = "y"
pv = "pv"
sp = "sp"
[[input]]
name = "u"
op = "op"
actuator = "other"
[[disturbance]]
name = "feed"
column = "f"
hold = "HOLD"
[[model]]
output = "y"
input = "u"
tf = "2 exp(-3.3 s)/(10 s + 1)"
[[model]]
output = "y"
input = "feed"
tf = "1.5 exp(-2.3 s)/(6 s + 1)"
[[controller]]
input = "u"
output = "y"
Kc = 0.66
Ti = 10
sample_time = 1
[simulate]
duration = 1500
sample_time = 1
seed = 3
setpoints = [
    {time = 100, output = "y", value = 1},
    {time = 500, output = "y", value = -1},
    {time = 900, output = "y", value = 1},
]
[[simulate.loads]]
at = "feed"
kind = "noise"
std = 1
time_constant = 5
[[simulate.loads]]
at = "y"
kind = "noise"
std = NOISE
time_constant = 5
"""


def result_of(folder: Path, hold: str, noise: float, declared: str = "") -> tp.Result:
    """A record whose feed runs so, analysed with that declared, or with nothing."""
    text = LOOP.replace("HOLD", hold).replace("NOISE", str(noise))
    tp.simulate(tp.Project.from_toml(text)).write_csv(folder / "record.csv")
    said = text.replace(f'hold = "{hold}"', f'hold = "{declared}"' if declared else "")
    return tp.run(tp.Project.from_toml(said, folder)).result


def dead_time(result: tp.Result) -> tuple[float, float]:
    (element,) = [e for e in result.elements if e.input == "feed"]
    (found,) = [p for p in element.parameters if p.name == "dead_time"]
    return found.ci


@pytest.mark.parametrize("hold", ["zoh", "linear"])
def test_the_hold_is_found_and_said(tmp_path, hold):
    result = result_of(tmp_path, hold, 0.03)
    (note,) = [n for n in result.notes if n.code == Code.HOLD]
    assert note.where == "feed" and f'hold = "{hold}"' in note.message
    low, high = dead_time(result)
    assert high < low + 0.3
    # one interval of 95 % may miss: by three standard errors, not by more
    assert abs(2.3 - (low + high) / 2) < 1.5 * (high - low) / 2
    assert all(e.verdict == "unchanged" for e in result.elements)


def test_what_is_declared_is_taken_and_not_spoken_of(tmp_path):
    right = result_of(tmp_path, "zoh", 0.03, declared="zoh")
    assert not [n for n in right.notes if n.code == Code.HOLD]
    low, high = dead_time(right)
    assert low < 2.3 < high
    wrong = result_of(tmp_path, "zoh", 0.03, declared="linear")
    low, high = dead_time(wrong)
    assert 2.6 < (low + high) / 2 < 3.0


def test_what_the_record_cannot_tell_is_left_open_and_alarms_nobody(tmp_path):
    result = result_of(tmp_path, "zoh", 0.3)
    assert not [n for n in result.notes if n.code == Code.HOLD]
    low, high = dead_time(result)
    assert low < 2.3 and high > 2.7
    assert [e.verdict for e in result.elements if e.input == "feed"] != ["changed"]
    assert np.isfinite([low, high]).all()
    assert Source.HOLD in sources_of(result)
    (feed,) = [e for e in result.elements if e.input == "feed"]
    (budget,) = [b for b in feed.budget if b.parameter == "dead_time"]
    assert {part.source: part.share for part in budget.parts}[Source.HOLD] > 0.01
