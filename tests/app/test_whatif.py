"""What-ifs say what the analysis says, from where the record worked, and the newest position goes first."""

from __future__ import annotations

import re
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.asking import Visitor
from app.results import TUNED, UNSAFE, result_json, with_result
from app.tried import short
from trueplant.app import whatif_answers
from trueplant.app.mailbox import Mailbox
from trueplant.cli import main
from trueplant.notebook.analysis import load
from trueplant.project import Project
from trueplant.study.loops.situation import NotReady, in_hand, situation_of
from trueplant.study.loops.whatif import WhatIf

PROJECT = "?project=project.toml"
OURS = "certain-share"
NEAR = {"rel": 0.01, "abs": 1e-9}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return short(tmp_path)


def asked(folder: Path, kind: str, **what: Any) -> dict[str, Any]:
    """The answer of the process, given in this one."""
    request = {"kind": kind, "page": "a", "folder": str(folder / "project-result"), **what}
    return whatif_answers.answer(request, lambda: False)


def preset(opened: dict[str, Any], name: str) -> dict[str, Any]:
    return {loop["input"]: loop["presets"][name]["settings"] for loop in opened["loops"]}


def today(opened: dict[str, Any]) -> dict[str, Any]:
    return {loop["input"]: dict(loop["today"]) for loop in opened["loops"]}


# -- numbers -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", [OURS, "simc"])
def test_a_preset_has_the_numbers_of_the_result(folder: Path, method: str) -> None:
    opened = asked(folder, "open")
    found = asked(folder, "numbers", settings=preset(opened, method))
    for loop in result_json(folder)["controllers"]:
        proposal = next(one for one in loop["proposals"] if one["method"] == method)
        said, own = found["loops"][loop["input"]]["tried"], proposal["metrics"]["plant"]
        assert said["Ms"] == pytest.approx(own["Ms"], **NEAR)
        assert said["overshoot"] == pytest.approx(own["setpoint"]["overshoot"], **NEAR)
        assert said["settling"] == pytest.approx(own["setpoint"]["settling"], **NEAR)
        assert said["load_error"] == pytest.approx(own["load"]["iae"], **NEAR)
        assert said["op_moves"] == pytest.approx(own["setpoint"]["total_variation"], **NEAR)
        assert said["op_noise"] == pytest.approx(own["noise"]["op_variation"], **NEAR)
        assert said["share"] == pytest.approx(proposal["drawn"]["share"], abs=0.005)  # on another grid of frequencies


def test_today_is_what_the_result_says_of_today(folder: Path) -> None:
    opened = asked(folder, "open")
    found = asked(folder, "numbers", settings=today(opened))
    assert found["state"] == "same"
    for loop in result_json(folder)["controllers"]:
        own, said = loop["current"]["metrics"]["plant"], found["loops"][loop["input"]]
        assert said["today"] == said["tried"]
        assert said["today"]["Ms"] == pytest.approx(own["Ms"], **NEAR)
        assert said["today"]["load_error"] == pytest.approx(own["load"]["iae"], **NEAR)


def test_what_the_analysis_recommends_is_recommended_with_its_price(tmp_path: Path) -> None:
    folder = with_result(tmp_path, TUNED)
    (loop,) = result_json(folder)["controllers"]
    assert loop["recommended"] == OURS
    found = asked(folder, "numbers", settings=preset(asked(folder, "open"), OURS))
    assert found["state"] == "recommended"
    # the share of plants is counted on another grid of frequencies
    assert found["sentence"].partition("; ")[2] == loop["reason"].partition("; ")[2]
    assert re.search(r"error of a load step -\d+ %", found["sentence"])
    assert "OP moves" in found["loops"]["u"]["price"] and "Ms" in found["loops"]["u"]["price"]


def test_what_is_kept_is_not_worth_a_change(folder: Path) -> None:
    opened = asked(folder, "open")
    settings = today(opened)
    for one in settings.values():
        one["Kc"] *= 1.02
    assert asked(folder, "numbers", settings=settings)["state"] == "keep"


def test_settings_beyond_the_limits_are_named(folder: Path) -> None:
    opened = asked(folder, "open")
    settings = today(opened)
    settings["reflux"]["Kc"] *= 9
    fast = asked(folder, "numbers", settings=settings)
    assert fast["state"] == "no"
    assert "crossover" in fast["loops"]["reflux"]["beyond"] and "crossover" not in fast["loops"]["fuel_gas"]["beyond"]
    assert "vouches" in fast["sentence"]
    settings["fuel_gas"]["Kc"] *= 40
    wild = asked(folder, "numbers", settings=settings)
    assert wild["state"] == "no"
    assert wild["loops"]["fuel_gas"]["beyond"]["Ms"] == "unstable"
    assert wild["loops"]["fuel_gas"]["beyond"]["share"] == "below 95 %"
    assert wild["loops"]["fuel_gas"]["tried"]["stable"] is False


def test_settings_that_hold_for_too_few_plants_are_not_recommended(folder: Path) -> None:
    settings = today(asked(folder, "open"))
    settings["fuel_gas"]["Ti"] = 0.8
    found = asked(folder, "numbers", settings=settings)
    beyond = found["loops"]["fuel_gas"]["beyond"]
    assert found["state"] == "no" and beyond["Ms"] == "above 1.59" and beyond["share"] == "below 95 %"
    assert "95 % is asked for" in found["sentence"]


# -- curves --------------------------------------------------------------------------------------------------------


def test_curves_begin_where_the_record_worked_and_keep_the_limits(folder: Path) -> None:
    opened = asked(folder, "open")
    loop = opened["loops"][0]
    assert loop["op_limits"] == [0.0, 100.0] and 30 < loop["op"] < 70 and 115 < loop["pv"] < 125
    settings = today(opened)
    found = asked(folder, "curves", settings=settings, loop="reflux", step=2.0, load=5.0)
    for kind in ("set-point", "load"):
        for signal in ("pv", "op"):
            both = found["curves"][kind][signal]
            assert both["today"] == both["tried"]
            low, middle, high = (np.array(both["tried"][key]) for key in ("low", "middle", "high"))
            assert (low <= middle).all() and (middle <= high).all()
    assert found["curves"]["set-point"]["pv"]["tried"]["middle"][0] == pytest.approx(loop["pv"], rel=1e-4)
    assert found["curves"]["load"]["op"]["tried"]["middle"][0] == pytest.approx(loop["op"], abs=0.5)
    assert found["curves"]["set-point"]["pv"]["tried"]["middle"][-1] == pytest.approx(loop["pv"] + 2, abs=0.05)
    settings["reflux"]["Kc"] *= 9
    wild = asked(folder, "curves", settings=settings, loop="reflux", step=20.0, load=5.0)
    op = wild["curves"]["set-point"]["op"]["tried"]
    assert min(op["low"]) == 0.0 and max(op["high"]) <= 100.0
    assert wild["curves"]["set-point"]["op"]["today"] != op


def test_an_op_that_rests_on_its_limit_is_told(folder: Path) -> None:
    opened = asked(folder, "open")
    found = asked(folder, "curves", settings=today(opened), loop="reflux", step=0.5, load=95.0, wider=2)
    assert found["at_limit"]["tried"] == 1.0
    assert found["span"] == pytest.approx(4 * opened["loops"][0]["span"])


def test_numbers_are_given_up_when_a_slider_moves_on(folder: Path) -> None:
    request = {"kind": "numbers", "page": "a", "folder": str(folder / "project-result"), "settings": {}}
    with pytest.raises(whatif_answers.GivenUp):
        whatif_answers.answer(request, lambda: True)


# -- blocked -------------------------------------------------------------------------------------------------------


def test_blocked_with_the_reason_while_the_replay_disagrees(folder: Path) -> None:
    found = load(folder / "project-result")
    assert found.project is not None
    situation = situation_of(found.project, found.result)
    assert in_hand(situation) is situation.today
    checks = found.result.methods.controller_consistency
    wrong = replace(checks[1], confirmed=False, message="the controller has changed: until noon it was another")
    methods = replace(found.result.methods, controller_consistency=(checks[0], wrong))
    disagrees = situation_of(found.project, replace(found.result, methods=methods))
    with pytest.raises(NotReady, match="replay of fuel_gas disagrees.*until noon"):
        WhatIf(disagrees)


def test_nothing_is_tried_without_a_controller_or_a_plant(folder: Path) -> None:
    found = load(folder / "project-result")
    assert found.project is not None
    bare = found.project.model_copy(update={"controllers": []})
    with pytest.raises(NotReady, match="no controller is declared"):
        WhatIf(situation_of(bare, found.result))
    with pytest.raises(NotReady, match="no plant to try settings on"):
        situation_of(found.project, replace(found.result, plant=None))


# -- the order of questions ----------------------------------------------------------------------------------------


def test_a_newer_position_overtakes_an_older_one_of_the_same_page() -> None:
    box = Mailbox(("curves", "numbers"))
    first, second, other = ({"kind": "curves", "page": page, "id": k} for k, page in enumerate("aab"))
    assert box.put(first) is None
    assert box.put(second) is first
    assert box.put(other) is None
    assert box.has("curves", "a") and not box.has("numbers", "a")
    assert [box.take(), box.take()] == [second, other]


def test_curves_are_taken_before_numbers() -> None:
    box = Mailbox(("curves", "numbers"))
    for kind in ("numbers", "plan", "curves"):
        box.put({"kind": kind, "page": "a"})
    assert [(box.take() or {})["kind"] for _ in range(3)] == ["curves", "numbers", "plan"]


def test_who_waits_is_woken_by_a_question_and_by_the_end() -> None:
    box, taken = Mailbox(()), []
    waiting = threading.Thread(target=lambda: taken.extend([box.take(), box.take()]))
    waiting.start()
    box.put({"kind": "open", "id": 1})
    while not taken and waiting.is_alive():
        box.close()
        waiting.join(0.01)
    box.close()
    waiting.join(5)
    assert not waiting.is_alive() and taken[-1] is None


# -- the page and its requests -------------------------------------------------------------------------------------


def test_the_page_and_its_process(folder: Path) -> None:
    visitor = Visitor.inside(folder)
    page = visitor.ask("GET", f"/whatif{PROJECT}")
    assert page.status == 200 and not UNSAFE.search(page.text)
    opened = visitor.post(f"/api/whatif/open{PROJECT}", {"page": "a"})
    assert opened.status == 200, opened.text
    settings = preset(opened.json(), "simc")
    said = {"page": "a", "settings": settings, "loop": "fuel_gas", "step": 1, "load": 5}
    curves = visitor.post(f"/api/whatif/curves{PROJECT}", said).json()
    assert curves["loop"] == "fuel_gas" and curves["milliseconds"] > 0
    here = asked(folder, "curves", **{key: said[key] for key in ("settings", "loop", "step", "load")})
    assert curves["curves"] == here["curves"]
    units = dict.fromkeys(settings, "engineering")
    numbers = visitor.post(f"/api/whatif/numbers{PROJECT}", {**said, "gain_units": units, "changed": ["reflux"]}).json()
    assert numbers["loops"] == asked(folder, "numbers", settings=settings)["loops"]
    assert numbers["text"].startswith("[[candidate]]") and "fuel_gas" not in numbers["text"]
    wrong = visitor.post(f"/api/whatif/curves{PROJECT}", {**said, "settings": {"fuel_gas": {"Kc": "much"}}})
    assert wrong.status == 422 and wrong.json()["error"] == "Kc must be a number"


def test_without_a_result_the_page_says_so(demo_folder: Path) -> None:
    visitor = Visitor.inside(demo_folder)
    page = visitor.ask("GET", f"/whatif{PROJECT}")
    assert page.status == 200 and "/run?project=project.toml" in page.text and "no result" in page.text
    answer = visitor.post(f"/api/whatif/open{PROJECT}", {})
    assert answer.status == 404 and "run it first" in answer.json()["error"]


def saved(visitor: Visitor, folder: Path, **more: float) -> Any:
    settings = {"reflux": {"form": "ideal", "Kc": 1.4, "Ti": 6.5, "Td": 0.5, "alpha": 0.1, "action": "direct", **more}}
    said = {"settings": settings, "changed": ["reflux"], "gain_units": {"reflux": "engineering"}}
    return visitor.post(f"/api/whatif/save{PROJECT}", said)


def test_settings_are_saved_as_a_candidate_and_all_else_stays(folder: Path) -> None:
    visitor, file = Visitor.inside(folder), folder / "project.toml"
    before = file.read_text()
    assert saved(visitor, folder).status == 200
    after = file.read_text()
    assert after.startswith(before.rstrip())
    (law,) = Project.load(file).candidates
    assert (law.input, law.output, law.Kc, law.Ti, law.sample_time) == ("reflux", "top_temperature", 1.4, 6.5, 0.1)
    assert saved(visitor, folder, Kc=1.5).status == 200  # the second takes the place of the first
    assert [law.Kc for law in Project.load(file).candidates] == [1.5]
    assert visitor.post(f"/api/project/undo{PROJECT}", {}).status == 200
    assert file.read_text() == after
    assert saved(visitor, folder, Ti=-1.0).status == 422
    assert file.read_text() == after


def test_settings_are_asked_for(demo_folder: Path) -> None:
    visitor = Visitor.inside(demo_folder)
    assert Project.load(demo_folder / "project.toml").tuning is None
    assert visitor.post(f"/api/whatif/tuning{PROJECT}", {}).status == 200
    assert Project.load(demo_folder / "project.toml").tuning is not None


@pytest.mark.slow
def test_the_command_line_judges_a_candidate_as_the_page_did(folder: Path) -> None:
    visitor = Visitor.inside(folder)
    opened = asked(folder, "open")
    settings = today(opened)
    settings["reflux"] |= {"Kc": 1.4, "Ti": 6.5}
    shown = asked(folder, "numbers", settings=settings)
    assert saved(visitor, folder).status == 200
    assert main(["run", str(folder / "project.toml"), "--out", str(folder / "project-result")]) == 0
    for loop in result_json(folder)["controllers"]:
        own = next(one for one in loop["proposals"] if one["method"] == "by hand")
        said = shown["loops"][loop["input"]]["tried"]
        assert own["metrics"]["plant"]["Ms"] == pytest.approx(said["Ms"], rel=1e-6)
        assert own["metrics"]["plant"]["load"]["iae"] == pytest.approx(said["load_error"], rel=1e-6)
        assert own["drawn"]["share"] == pytest.approx(said["share"], abs=0.005)
    assert "by hand" in {preset for loop in asked(folder, "open")["loops"] for preset in loop["presets"]}
