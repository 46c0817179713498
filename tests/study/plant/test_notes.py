"""What is said of how far experiments differ. All records are simulated."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

from support.one_loop import one_loop, single
from support.simulated import coloured, random_switching
from trueplant import Project, run
from trueplant.identify import FoundLoad, Spec
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import Structure, TransferMatrix
from trueplant.record.types import Load
from trueplant.result import Code
from trueplant.study.plant import identified
from trueplant.study.plant.notes import time_unit_note


def test_only_what_was_estimated_is_said_to_differ(tmp_path: Path) -> None:
    """Two runs of one loop without a dead time, whose gains are 1.6 and 2.4: nothing is said of dead times."""
    law = Controller.diagonal([PID(Kc=0.4, Ti=8.0, sample_time=1.0)])
    for k, gain in enumerate((1.6, 2.4)):
        rng = np.random.default_rng(k)
        plant = TransferMatrix.of([[f"{gain}/(8 s + 1)"]], "min")
        v = coloured(rng, 800, 1, [1, -0.8], [1], 0.1)
        record = simulate(plant, law, random_switching(rng, 800, 1, 40.0), 1.0, v=v)
        columns = {"t": record.t, "sp": record.r[:, 0], "op": record.u[:, 0], "pv": record.y[:, 0]}
        pl.DataFrame(columns).write_csv(tmp_path / f"run{k}.csv")
    made = Project(
        time_unit="min",
        data={"time": "t"},
        experiment=[{"file": "run0.csv"}, {"file": "run1.csv"}],
        output=[{"name": "level", "pv": "pv", "sp": "sp"}],
        input=[{"name": "valve", "op": "op"}],
        model=[{"output": "level", "input": "valve", "tf": "2/(8 s + 1)"}],
    )
    result = run(Project.from_toml(made.to_toml(), tmp_path))
    (said,) = (note.message for note in result.notes if note.code == Code.RUNS_DISAGREE)
    assert "gains differ by some" in said and "lags by some" in said
    assert "dead times" not in said


def test_a_structure_that_is_too_simple_is_said_once(tmp_path: Path) -> None:
    """Declared first order, true a slow tail: one note, that it was kept; and no plant that moved for certain."""
    plant = TransferMatrix.of([["2 (120 s + 1) exp(-13.4 s)/((300 s + 1)(40 s + 1))"]])
    record = one_loop(5, plant, samples=4000, std=0.05)
    notes = single(tmp_path, record, "2 exp(-13.4 s)/(150 s + 1)", structure="fopdt").notes
    (said,) = (note for note in notes if note.code == Code.UNDERMODELLED)
    assert "It was kept" in said.message and said.where == "u -> y"
    assert not [note for note in notes if "was not the same throughout" in note.message]


def test_a_step_that_may_be_none_is_not_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that other structures explain as well: its interval holds 0, and the other's does not."""
    found = [FoundLoad(0, Load(0, 10.0), 5.0, 3.0), FoundLoad(0, Load(0, 20.0), 5.0, 1.0)]
    monkeypatch.setattr(identified, "found_loads", lambda _: found)
    record = SimpleNamespace(calendar=SimpleNamespace(text=lambda time: f"{time:g} s"))
    project = SimpleNamespace(analysis=SimpleNamespace(confidence=0.95), experiments=[SimpleNamespace(name="run.csv")])
    study = SimpleNamespace(
        project=project, screened=[SimpleNamespace(record=record)], columns=("heating",), input_unit=lambda _: "%"
    )
    (note,) = identified._loads(study, {})
    assert "at 20 s like heating by 5 ± 2 %" in note.message and "10 s" not in note.message


@pytest.mark.holds("study.TIME_UNIT")
@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([1 / 60, 1 / 60], "60 times as fast"),
        ([1 / 60, 1 / 42], "60 times as fast"),
        ([1 / 60, 1 / 20], ""),
        ([70.0, 85.0], "60 times as slowly"),
        ([3600.0, 3000.0], "3600 times as slowly"),
        ([1.0, 1.0], ""),
        ([8.0, 8.0], ""),
        ([60.0, 1.0], ""),
    ],
)
def test_times_of_another_unit_are_told_from_other_times(times: list[float], said: str) -> None:
    """Two elements, whose lags and dead times are so many times those of the model."""
    model = TransferMatrix.of([["2 exp(-3 s)/(10 s + 1)", "1/(5 s + 1)"]], "min")
    specs = [Spec(j, Structure.parse("fopdt")) for j in range(2)]
    theta = np.array([2.5, 10 * times[0], 3 * times[0], 0.8, 4 * times[1], 1 * times[1]])
    row = SimpleNamespace(specs=specs, slices=(slice(0, 3), slice(3, 6)))
    found: Any = SimpleNamespace(estimates={0: SimpleNamespace(row=row, theta=theta)})
    study: Any = SimpleNamespace(model=model, project=SimpleNamespace(time_unit="min"))
    notes = time_unit_note(study, found)
    assert [note.code for note in notes] == [Code.TIME_UNIT] * bool(said)
    assert all(said in note.message and "time_unit (min)" in note.message for note in notes)
