"""Spikes that only the estimate finds, in a whole analysis of simulated records."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from support.simulated import random_switching
from trueplant import Project, run
from trueplant.loop import PID, Controller, simulate
from trueplant.lti import TransferMatrix
from trueplant.study.data.prepare import prepare
from trueplant.study.plant.identified import identify
from trueplant.study.study import quiet

LAW = Controller.diagonal([PID(Kc=0.66, Ti=10.0, sample_time=1.0)])
SAMPLES = 1500
PROJECT = """
time_unit = "min"
data = {files = ["run.csv"], time = "t"}
output = [{name = "y", pv = "pv", sp = "sp"KEEP}]
input = [{name = "u", op = "op"}]
model = [{output = "y", input = "u", tf = "2 exp(-3.3 s)/(10 s + 1)"}]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One loop under a random walk in steps of 0.05, and 15 spikes of 0.5 that screening cannot tell from it."""
    rng = np.random.default_rng(7)
    places = rng.choice(np.arange(50, SAMPLES - 50), 15, replace=False)
    v = np.cumsum(0.05 * rng.standard_normal((SAMPLES, 1)), axis=0)
    v[places] += 0.4 * rng.choice([-1.0, 1.0], (15, 1))
    plant = TransferMatrix.of([["2 exp(-3.3 s)/(10 s + 1)"]], "min")
    found = simulate(plant, LAW, random_switching(rng, SAMPLES, 1, 40.0), 1.0, v=v)
    here = tmp_path_factory.mktemp("spikes")
    columns = {"t": found.t, "sp": found.r[:, 0], "op": found.u[:, 0], "pv": found.y[:, 0]}
    pl.DataFrame(columns).write_csv(here / "run.csv")
    return here, places


def project(folder, keep=""):
    return Project.from_toml(PROJECT.replace("KEEP", keep), folder)


def test_a_note_says_how_many_there_are_and_the_first_of_them(folder):
    here, places = folder
    result = run(project(here))
    (note,) = (note for note in result.notes if note.code == "spikes")
    screened = sum(
        f["samples"] for table in result.to_dict()["data"] for f in table["findings"] if f["kind"] == "spike"
    )
    assert 0 < screened < 8
    assert note.where == "y, run.csv"
    assert f"in {15 - screened} samples, first at " in note.message
    assert any(f"at {place} min" in note.message for place in places)
    assert 'keep = ["spike"]' in note.message


def test_they_are_where_they_were_and_what_was_taken_off_is_nothing_of_the_record(folder):
    here, places = folder
    study = prepare(project(here), quiet)
    found = identify(study, quiet)
    (raw,), (taken,) = study.segments, found.segments
    assert raw.spikes is None
    assert np.allclose(np.nan_to_num(taken.y + taken.spikes), np.nan_to_num(raw.y))
    assert set(np.flatnonzero(taken.spikes[:, 0])) <= set(places)
    assert found.estimates[0].row.spike_count == np.count_nonzero(taken.spikes)


def test_a_project_that_keeps_them_has_them_in_the_estimate(folder):
    result = run(project(folder[0], ', keep = ["spike"]'))
    assert not any(note.code == "spikes" for note in result.notes)
    study = prepare(project(folder[0], ', keep = ["spike"]'), quiet)
    assert identify(study, quiet).estimates[0].row.spike_count == 0
