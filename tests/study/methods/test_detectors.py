"""The published detectors in a whole analysis: on request only, and in the result as documented."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from support.simulated import BLT, WOOD_BERRY, coloured, wood_berry
from support.two_loops import CONTROLLERS, project, scaled
from trueplant import detect, run
from trueplant.errors import ProjectError
from trueplant.loop import simulate
from trueplant.project.tables import Detector


def written(folder, simulation):
    columns = {"t": simulation.t}
    for name, values in (("sp", simulation.r), ("op", simulation.u), ("pv", simulation.y)):
        columns |= {f"{name}{k + 1}": values[:, k] for k in range(2)}
    pl.DataFrame(columns).write_csv(folder / "record.csv")


def test_the_names_of_the_project_file_are_those_of_the_detectors():
    assert Detector.__args__ == detect.DETECTORS


@pytest.mark.slow
def test_detectors_run_on_request_and_leave_the_verdicts_alone(tmp_path):
    written(tmp_path, wood_berry(21, samples=1200, plant=scaled(1, 0, 1.5)))
    plain = run(project(tmp_path, controller=CONTROLLERS))
    asked = run(project(tmp_path, controller=CONTROLLERS, analysis={"detectors": list(detect.DETECTORS)}))
    assert "detectors" not in plain.to_dict()["methods"]
    assert [e.verdict for e in plain.elements] == [e.verdict for e in asked.elements]
    entries = {entry["name"]: entry for entry in asked.to_dict()["methods"]["detectors"]}
    assert tuple(entries) == detect.DETECTORS
    found = {(x["input"], x["output"]): x for x in entries["partial-correlation"]["elements"]}
    changed = found["reflux", "bottom"]
    assert changed["flagged"] and changed["statistic"] > changed["threshold"]
    assert not found["reflux", "top"]["flagged"]


def test_a_detector_for_routine_data_answers_where_the_analysis_refuses(tmp_path):
    v = coloured(np.random.default_rng(22), 3000, 2, [1, -0.8], [1], 0.3)
    written(tmp_path, simulate(WOOD_BERRY, BLT, np.zeros((3000, 2)), 1.0, v=v))
    result = run(project(tmp_path, analysis={"detectors": ["one-class", "stepwise"]}))
    one_class, stepwise = result.to_dict()["methods"]["detectors"]
    assert result.status == "refused"
    assert one_class["refused"] is None and len(one_class["elements"]) == 4
    assert "set-point" in stepwise["refused"]


def test_an_unknown_detector_is_an_error_of_the_project(tmp_path):
    with pytest.raises(ProjectError, match="detectors"):
        project(tmp_path, analysis={"detectors": ["psychic"]})
