"""The screen Plan: the plans of the result, what their moves do within the limits, and limits that are written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.asking import Visitor
from app.results import SAME, UNSAFE, result_json, with_result, words
from app.tried import short
from trueplant.app import whatif_answers
from trueplant.lti import UncertainPlant
from trueplant.notebook.analysis import load
from trueplant.project import Project
from trueplant.result import MoreData, PlannedMove
from trueplant.study.experiment.excursion import excursion
from trueplant.study.loops.situation import Situation, situation_of

PROJECT = "?project=project.toml"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return short(tmp_path)


def situation(folder: Path) -> Situation:
    found = load(folder / "project-result")
    assert found.project is not None
    return situation_of(found.project, found.result)


def test_the_page_says_what_the_result_plans(folder: Path) -> None:
    plans = result_json(folder)["more_data"]
    assert plans and plans[0]["moves"]
    page = Visitor.inside(folder).ask("GET", f"/plan{PROJECT}")
    assert page.status == 200 and not UNSAFE.search(page.text)
    said = words(page.text)
    for plan in plans:
        assert plan["sentence"][1:] in said
        for row in plan["settles"]:
            assert f"{row['input']} -> {row['output']}".replace("_", " ") in said
    assert page.text.count('data-drawn="wanted"') == len(plans)


def test_moves_and_what_they_do(folder: Path) -> None:
    plan = result_json(folder)["more_data"][0]
    answer = Visitor.inside(folder).post(f"/api/plan/excursion{PROJECT}", {"plan": 0, "page": "a"})
    assert answer.status == 200, answer.text
    found = answer.json()
    request = {"kind": "plan", "folder": str(folder / "project-result"), "plan": 0}
    assert found == json.loads(json.dumps(whatif_answers.answer(request, lambda: False)))
    assert found["closed"] and found["t"][-1] > plan["length"]
    signals = {(one["is"], one["name"]): one for one in found["signals"]}
    for move in plan["moves"]:
        one = signals["PV", move["name"]]
        moved = np.array(one["moved"])
        assert np.ptp(moved) == pytest.approx(2 * move["size"], rel=1e-3)
        assert moved[-1] == pytest.approx(moved.mean(), abs=move["size"])  # back where it began
        low, middle, high = (np.array(one["band"][key]) for key in ("low", "middle", "high"))
        assert (low <= middle).all() and (middle <= high).all()
        assert one["far"][0] <= low.min() and high.max() <= one["far"][1]
    for name in ("reflux", "fuel_gas"):
        least, most = signals["OP", name]["far"]
        assert 0 <= least < most <= 100
    assert Visitor.inside(folder).post(f"/api/plan/excursion{PROJECT}", {"plan": 7}).status == 422


def test_an_excursion_is_the_simulation_of_its_plant(folder: Path) -> None:
    """Of a plant without doubt: one move up and down comes to rest on both levels."""
    here = situation(folder)
    sure = replace(here, known=UncertainPlant(here.known.nominal, {}))
    plan = MoreData("", (PlannedMove("set-point", "vaporisation", 2.0, "%", 60.0),), length=120.0)
    found = excursion(sure, plan)
    pv, t = found.pv[1], found.t
    assert np.ptp(pv, axis=1).max() == 0.0
    middle = float(here.y0[1])
    assert pv[np.searchsorted(t, 59.0), 1] == pytest.approx(middle + 2, abs=0.01)
    assert pv[np.searchsorted(t, 119.0), 1] == pytest.approx(middle - 2, abs=0.01)
    assert pv[-1, 1] == pytest.approx(middle, abs=0.02)
    assert found.farthest[1, 1] > middle + 2  # the loop overshoots


def test_an_op_that_is_moved_by_hand(folder: Path) -> None:
    here = situation(folder)
    sure = replace(here, known=UncertainPlant(here.known.nominal, {}), today=None, declared=None)
    plan = MoreData("", (PlannedMove("OP", "fuel_gas", 1.0, "%", 60.0),), length=120.0)
    found = excursion(sure, plan)
    assert not found.closed and found.moved.shape[1] == 2
    gain = here.known.nominal[1, 1].dc_gain
    at = np.searchsorted(found.t, 59.0)
    assert found.pv[1][at, 1] == pytest.approx(here.y0[1] + gain, rel=1e-3)
    assert found.op[1][at, 1] == pytest.approx(here.u0[1] + 1)


def limits(visitor: Visitor, low: float | None, high: float | None, longest: float | None = None) -> Any:
    row = {"table": "output", "name": "vaporisation", "low": low, "high": high}
    return visitor.post(f"/api/plan/limits{PROJECT}", {"limits": [row], "longest": longest})


def test_limits_are_written_and_taken_out(demo_folder: Path) -> None:
    visitor, file = Visitor.inside(demo_folder), demo_folder / "project.toml"
    before = file.read_text()
    assert limits(visitor, 25.5, 33, 120).status == 200
    project = Project.load(file)
    assert project.outputs[1].limits == (25.5, 33.0) and project.analysis.longest_test == 120.0
    assert all(line in file.read_text() for line in before.splitlines() if line.startswith("#"))
    assert limits(visitor, None, None).status == 200
    project = Project.load(file)
    assert project.outputs[1].limits is None and project.analysis.longest_test is None


def test_wrong_limits_say_why_and_leave_the_file(demo_folder: Path) -> None:
    visitor, file = Visitor.inside(demo_folder), demo_folder / "project.toml"
    before = file.read_bytes()
    for low, high, said in ((5.0, None, "give both limits"), (9.0, 5.0, "low below high")):
        answer = limits(visitor, low, high)
        assert answer.status == 422 and said in answer.json()["error"]
    assert limits(visitor, 1.0, 2.0, -3.0).status == 422
    wrong = {"limits": [{"table": "model", "name": "x"}], "longest": None}
    assert visitor.post(f"/api/plan/limits{PROJECT}", wrong).status == 400
    assert file.read_bytes() == before


def test_what_is_not_worth_a_test_says_because(tmp_path: Path) -> None:
    folder = with_result(tmp_path, SAME.replace("[simulate]", "[analysis]\nlongest_test = 0.5\n\n[simulate]", 1))
    plans = result_json(folder)["more_data"]
    page = words(Visitor.inside(folder).ask("GET", f"/plan{PROJECT}").text)
    for plan in plans:
        assert plan["sentence"][1:] in page
    if not plans:
        assert "No test is needed" in page
    assert "Trying it out" not in page


def test_without_a_result_the_page_says_so(demo_folder: Path) -> None:
    page = Visitor.inside(demo_folder).ask("GET", f"/plan{PROJECT}")
    assert page.status == 200 and "no result" in page.text and "/run?project=project.toml" in page.text
    assert Visitor.inside(demo_folder).post(f"/api/plan/excursion{PROJECT}", {"plan": 0}).status == 404
