"""What the verdict says is what result.json says, for an answer, for none, and for a refusal."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest

from app.asking import Visitor
from app.results import CHANGED, SAME, STILL, UNSAFE, demo, result_json, with_result, words
from support.pages import Page
from trueplant.app.screens.verdict import to_do
from trueplant.output import read_results
from trueplant.report import tables
from trueplant.result import Code, Reason
from trueplant.result.parameter_words import word_of
from trueplant.result.shift_words import Action

PAGE = "/verdict?project=project.toml"


def opened(visitor: Visitor, output: str, source: str) -> dict[str, Any]:
    query = urlencode({"project": "project.toml", "output": output, "input": source})
    answer = visitor.ask("GET", f"/api/verdict/element?{query}")
    assert answer.status == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def numbers(encoded: Any) -> np.ndarray[Any, Any]:
    """An array as plotly packs it."""
    if isinstance(encoded, list):
        return np.array([np.nan if one is None else one for one in encoded], dtype=float)
    return np.frombuffer(base64.b64decode(encoded["bdata"]), dtype=encoded["dtype"]).astype(float)


def told_the_same(folder: Path) -> None:
    """Page and elements against the files of the result."""
    visitor, document = Visitor.inside(folder), result_json(folder)
    result = read_results(folder / "project-result")
    answer = visitor.ask("GET", PAGE)
    assert answer.status == 200
    page = Page(answer.text)
    assert page.by_id("shift") == document["shift"]
    assert page.by_id("headline") == document["headline"].replace("->", "→")
    assert page.by_id("action").startswith(to_do(result).title)
    said = words(answer.text)
    for note in document["notes"]:
        assert note["message"].replace("->", "→") in said
    buttons = {(a["data-output"], a["data-input"]): text for a, text in page.all("button") if "data-output" in a}
    assert set(buttons) == {(e["output"], e["input"]) for e in document["elements"]}
    for element in document["elements"]:
        assert element["verdict"] in buttons[element["output"], element["input"]]
        assert f"grade {element['grade']}" in buttons[element["output"], element["input"]]
    for one in result.elements:
        element_is_told(result, one, opened(visitor, one.output, one.input))


def element_is_told(result: Any, element: Any, found: dict[str, Any]) -> None:
    assert not UNSAFE.search(found["html"])
    said = words(found["html"])
    assert str(element.verdict) in said and element.tf_plant in said
    scale = tables.percent_scale(result.elements)
    for p in element.parameters:
        row = tables.parameter_row(p, scale)
        assert f"{row.name} {row.unit}".strip() in said
        assert f"{row.model} {row.plant} {row.interval}" in said
    for one in element.budget:
        assert all(part.source.value in said for part in one.parts if part.share >= 0.01)
    i, j = result.curves.outputs.index(element.output), result.curves.inputs.index(element.input)
    figures = list(found["figures"].values())
    assert len(figures) == 2 + len(result.curves.trends)
    step, bode, trend = figures[:3]
    drawn = next(t for t in step["data"] if t["meta"]["role"] == "plant")
    plant = result.curves.step_plant[:, i, j]
    assert numbers(drawn["y"]) == pytest.approx(plant[: numbers(drawn["y"]).size], rel=1e-4, abs=1e-6)
    sizes = next(t for t in bode["data"] if t["meta"]["role"] == "model")
    known = np.abs(result.curves.bode_model[:, i, j])
    assert numbers(sizes["y"]) == pytest.approx(known, rel=1e-4, nan_ok=True)
    assert {t["meta"]["role"] for t in trend["data"]} >= {"measured", "plant", "model", "setpoint"}


def test_page_and_elements_say_what_the_result_says(tmp_path: Path) -> None:
    told_the_same(with_result(tmp_path))


def test_no_change_is_told_as_such(tmp_path: Path) -> None:
    told_the_same(with_result(tmp_path, SAME))
    said = words(Visitor.inside(tmp_path).ask("GET", PAGE).text)
    assert "Nothing to do now." in said and "unchanged" in said


def test_a_changed_plant_under_unknown_controllers_is_not_nothing_to_do(tmp_path: Path) -> None:
    with_result(tmp_path)
    known = read_results(tmp_path / "project-result")
    unknown = replace(known, robustness=None)
    assert "no action now" in known.shift and to_do(known).title == "Nothing to do now"
    assert "whether today's tuning suits that is not known" in unknown.shift
    assert to_do(unknown).title == "See whether the tuning still suits it"


def test_a_plant_that_changed_during_the_record_is_not_nothing_to_do(tmp_path: Path) -> None:
    with_result(tmp_path)
    known = read_results(tmp_path / "project-result")
    moved = Reason(Code.CAUSE_MOVED_MEANWHILE, "the plant was not the same throughout the record", "y, a.csv")
    result = replace(known, notes=(moved,))
    assert result.action is Action.GET_DATA and to_do(result).title == "Find out what it does now"
    assert to_do(result).links[0][0] == "track"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["splitter", "mill"])
def test_the_demos_say_what_their_results_say(tmp_path: Path, name: str) -> None:
    told_the_same(demo(tmp_path, name))


def test_a_refusal_shows_the_trend_that_it_rests_on(tmp_path: Path) -> None:
    with_result(tmp_path, STILL, 3)
    document, answer = result_json(tmp_path), Visitor.inside(tmp_path).ask("GET", PAGE)
    page = Page(answer.text)
    assert page.by_id("shift") == document["shift"] and document["status"] == "refused"
    assert page.by_id("headline") == document["headline"].replace("->", "→")
    assert page.by_id("action").startswith("Get data.")
    drawings = [a for a, _ in page.all("svg") if a.get("class") == "still"]
    assert [a["aria-label"] for a in drawings] == ["Trend of y", "Trend of u"]
    assert "SP does not move, 0" in words(answer.text)
    assert not [a for a, _ in page.all("button") if "data-output" in a]


def test_common_notes_are_folded_and_causes_come_first(tmp_path: Path) -> None:
    with_result(tmp_path)
    text = Visitor.inside(tmp_path).ask("GET", PAGE).text
    common = next(n["message"] for n in result_json(tmp_path)["notes"] if n["code"] == "one-experiment")
    folded = text[text.index("What holds for most records") :]
    assert common in words(folded) and common not in words(text.split("<details")[0])


def test_what_changed_is_said_in_plain_words(tmp_path: Path) -> None:
    with_result(tmp_path)
    element = read_results(tmp_path / "project-result").elements[0]
    moved = Page(opened(Visitor.inside(tmp_path), "y", "u")["html"])
    said = next(text for a, text in moved.all("p") if a.get("class") == "moved")
    assert [word_of(p.name) for p in element.parameters if p.changed] == ["gain"]
    assert said.startswith("gain 2 → 2.6") and "%" in said


def test_a_project_that_has_changed_since_is_said(tmp_path: Path) -> None:
    with_result(tmp_path)
    visitor = Visitor.inside(tmp_path)
    assert 'id="stale"' not in visitor.ask("GET", PAGE).text
    (tmp_path / "project.toml").write_text(f"{CHANGED}\n# a word\n", encoding="utf-8")
    assert "The project has changed since" in Page(visitor.ask("GET", PAGE).text).by_id("stale")


def test_without_a_result_the_way_to_one_is_shown(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(CHANGED, encoding="utf-8")
    visitor = Visitor.inside(tmp_path)
    answer = visitor.ask("GET", PAGE)
    assert answer.status == 200 and "There is no result of this project yet" in words(answer.text)
    assert 'href="/run?project=project.toml"' in answer.text
    assert visitor.ask("GET", "/api/verdict/element?project=project.toml&output=y&input=u").status == 404


@pytest.mark.parametrize("named", ["../elsewhere", "/etc", "nowhere", "project-result/../.."])
def test_results_are_those_of_the_folder(tmp_path: Path, named: str) -> None:
    with_result(tmp_path)
    visitor = Visitor.inside(tmp_path)
    assert visitor.ask("GET", f"/verdict?{urlencode({'result': named})}").status == 404
    assert visitor.ask("GET", "/verdict?result=project-result").status == 200


def test_a_new_result_is_read_again(tmp_path: Path) -> None:
    with_result(tmp_path)
    visitor = Visitor.inside(tmp_path)
    before = Page(visitor.ask("GET", PAGE).text).by_id("shift")
    with_result(tmp_path / "other", SAME)
    for file in (tmp_path / "other" / "project-result").iterdir():
        file.replace(tmp_path / "project-result" / file.name)
    assert Page(visitor.ask("GET", PAGE).text).by_id("shift") != before


def test_a_result_that_is_of_two_analyses_is_one_message(tmp_path: Path) -> None:
    with_result(tmp_path)
    (tmp_path / "project-result" / "curves.json").write_text("{}", encoding="utf-8")
    answer = Visitor.inside(tmp_path).ask("GET", PAGE)
    assert answer.status == 422 and "are not of one analysis" in answer.text and str(tmp_path) not in answer.text


def test_pages_hold_nothing_that_the_policy_forbids(tmp_path: Path) -> None:
    with_result(tmp_path)
    text = Visitor.inside(tmp_path).ask("GET", PAGE).text
    assert not UNSAFE.search(text)


def test_names_from_the_project_are_text(tmp_path: Path) -> None:
    with_result(tmp_path, CHANGED.replace('"u"', '"<b>u</b>"'))
    visitor = Visitor.inside(tmp_path)
    text = visitor.ask("GET", PAGE).text
    assert "<b>" not in text and "&lt;b&gt;u" in text
    assert "<b>" not in opened(visitor, "y", "<b>u</b>")["html"]


def test_without_curves_the_numbers_stand(tmp_path: Path) -> None:
    with_result(tmp_path)
    (tmp_path / "project-result" / "curves.json").unlink()
    visitor = Visitor.inside(tmp_path)
    page = visitor.ask("GET", PAGE)
    assert page.status == 200 and result_json(tmp_path)["shift"] in words(page.text)
    found = opened(visitor, "y", "u")
    assert found["figures"] == {} and "Nothing is drawn of it" in words(found["html"])
    gain = read_results(tmp_path / "project-result").elements[0].parameters[0]
    assert tables.parameter_row(gain, 100.0).plant in words(found["html"])


def test_the_way_out_is_that_of_the_same_result(tmp_path: Path) -> None:
    with_result(tmp_path)
    (tmp_path / "project-result").rename(tmp_path / "kept")
    visitor = Visitor.inside(tmp_path)
    asked = "project=project.toml&result=kept"
    assert f'href="/out/report?{asked.replace("&", "&amp;")}"' in visitor.ask("GET", f"/verdict?{asked}").text
    out = visitor.ask("GET", f"/out?{asked}").text
    assert f'href="/verdict?{asked.replace("&", "&amp;")}"' in out and "trueplant report kept" in words(out)
    assert visitor.ask("GET", f"/out/file?{asked}&name=result.json").status == 200
    assert visitor.ask("GET", "/out/file?project=project.toml&name=result.json").status == 404
