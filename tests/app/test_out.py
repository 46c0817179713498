"""What is taken along: the numbers of the result in every form, under safe names, and the plant as the model."""

from __future__ import annotations

import csv
import io
import time
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from app.asking import Visitor
from app.results import CHANGED, SAME, STILL, TUNED, UNSAFE, result_json, with_result, words
from trueplant.app.downloads import as_csv, download, safe_name
from trueplant.app.faceplates import Faceplate, faceplates, shown_by, vendor_names
from trueplant.cli import main
from trueplant.errors import LoopError
from trueplant.loop import PID
from trueplant.output import read_results
from trueplant.project import Project
from trueplant.result import ControllerSettings, LoopRetuning, ProposedSettings
from trueplant.tune import Notation, Settings, pid_of
from trueplant.tune.vendors import VENDORS, Vendor, vendor_of

PAGE = "/out?project=project.toml"
SPANS = (50.0, 20.0)
"""Of OP and PV in TUNED."""


def settled(visitor: Visitor, path: str) -> dict[str, Any]:
    """The errand when it has ended."""
    for _ in range(600):
        told: dict[str, Any] = visitor.ask("GET", path).json()
        if told["state"] != "running":
            return told
        time.sleep(0.1)
    raise AssertionError(f"it does not end: {told}")


@pytest.fixture
def tuned(tmp_path: Path) -> Path:
    return with_result(tmp_path, TUNED)


def a_loop(folder: Path) -> LoopRetuning:
    return read_results(folder / "project-result").controllers[0]


# -- settings ------------------------------------------------------------------------------------------------------


def test_settings_are_those_of_the_result(tuned: Path) -> None:
    document = result_json(tuned)["controllers"][0]
    chosen = next(p for p in document["proposals"] if p["method"] == document["recommended"])
    said = words(Visitor.inside(tuned).ask("GET", PAGE).text)
    for now, new in ((document["current"]["shown"], chosen["shown"]),):
        assert f"{now['gain']:.4g}" in said and f"{new['gain']:.4g}" in said
        assert f"{now['integral']:.4g}" in said and f"{new['integral']:.4g}" in said
    assert "Enter these." in said


@pytest.mark.parametrize("system", VENDORS, ids=lambda one: one.name)
def test_another_systems_numbers_are_the_same_law(tuned: Path, system: Vendor) -> None:
    loop = a_loop(tuned)
    found = shown_by(loop, system, SPANS)
    for declared, shown in ((loop.current, found.current), (loop.chosen, found.chosen)):
        assert declared is not None and shown is not None and declared.settings is not None and shown.shown is not None
        own = declared.settings
        law = PID(
            form=own.form or "", Kc=own.Kc, Ti=own.Ti, Td=own.Td or 0.0, alpha=own.alpha or 0.0, action=own.action
        )
        given = shown.shown
        notation = Notation(
            form=system.form,
            gain=system.gain,
            derivative_filter=system.derivative_filter,
            time_unit=system.time_unit,
            gain_unit="percent of span",
            op_span=SPANS[0],
            pv_span=SPANS[1],
        )
        settings = Settings(given.gain, given.integral, given.derivative or 0.0, given.derivative_filter, given.action)
        again = pid_of(settings, notation, loop.time_unit)
        assert again.parallel == pytest.approx(law.parallel, rel=1e-9)


def test_a_systems_page_is_in_its_units(tuned: Path) -> None:
    visitor, now = Visitor.inside(tuned), result_json(tuned)["controllers"][0]["current"]["settings"]
    html = visitor.ask("GET", "/api/out/faceplate?project=project.toml&vendor=Yokogawa%20CENTUM").json()["html"]
    said = words(html)
    assert f"Proportional band (%) {100 / (now['Kc'] * SPANS[1] / SPANS[0]):.4g}" in said
    assert f"Integral time (s) {now['Ti']:.4g}" in said and "Action reverse" in said
    assert not UNSAFE.search(html)


def test_without_spans_no_other_system_can_be_shown(tmp_path: Path) -> None:
    with_result(tmp_path, TUNED.replace("span = [0, 50]", ""))
    visitor = Visitor.inside(tmp_path)
    said = words(visitor.ask("GET", "/api/out/faceplate?project=project.toml&vendor=Foxboro%20I/A").json()["html"])
    assert "the spans of OP u and PV y are not declared: give them on the screen Tags" in said
    assert "Gain" in said  # as the project declares them


def test_a_form_that_cannot_say_the_law_is_refused_by_name(tuned: Path) -> None:
    loop = a_loop(tuned)
    assert loop.current.settings is not None
    short = replace(loop, current=replace(loop.current, settings=replace(loop.current.settings, Td=6.0, alpha=0.1)))
    with pytest.raises(LoopError, match="no series form"):
        shown_by(short, vendor_of("Foxboro I/A"), SPANS)


def test_every_system_of_the_room_can_be_chosen(tuned: Path) -> None:
    text = Visitor.inside(tuned).ask("GET", PAGE).text
    assert vendor_names() == [one.name for one in VENDORS] and all(
        f"<option>{n}</option>" in text for n in vendor_names()
    )
    result, project = read_results(tuned / "project-result"), Project.load(tuned / "project.toml")
    assert [bool(one.problem) for one in faceplates(result, project, "DeltaV")] == [False]
    answer = Visitor.inside(tuned).ask("GET", "/api/out/faceplate?project=project.toml&vendor=Acme")
    assert answer.status == 422 and "Acme" in answer.json()["error"]


def test_a_candidate_stands_beside_what_is_recommended_in_the_same_form(tuned: Path) -> None:
    result, project = read_results(tuned / "project-result"), Project.load(tuned / "project.toml")
    (loop,) = result.controllers
    assert loop.current.settings is not None and loop.current.settings.Kc is not None
    tried = replace(loop.current.settings, Kc=2 * loop.current.settings.Kc)

    def shown(settings: ControllerSettings) -> list[Faceplate]:
        more = (*loop.proposals, ProposedSettings("by hand", "", settings))
        return faceplates(replace(result, controllers=(replace(loop, proposals=more),)), project, "Foxboro")

    first, own = shown(tried)
    assert (first.own, own.own, first.problem, own.problem) == (False, True, "", "")
    (band,) = (one for one in own.shown.settings if one.label == "Proportional band (%)")
    assert float(band.new) == pytest.approx(float(band.now) / 2, rel=2e-3)
    assert len(shown(loop.current.settings)) == 1  # as today


def test_settings_are_asked_for_and_that_can_be_undone(tmp_path: Path) -> None:
    with_result(tmp_path)
    visitor = Visitor.inside(tmp_path)
    assert "No new settings were asked for." in words(visitor.ask("GET", PAGE).text)
    assert visitor.post("/api/out/tuning?project=project.toml", {}).json()["can_undo"] is True
    assert tomllib.loads((tmp_path / "project.toml").read_text())["tuning"] == {}
    assert "The project asks for new settings now" in words(visitor.ask("GET", PAGE).text)
    assert visitor.post("/api/out/tuning?project=project.toml", {}).status == 422
    assert visitor.post("/api/project/undo?project=project.toml", {}).status == 200
    assert (tmp_path / "project.toml").read_text() == CHANGED


# -- files ---------------------------------------------------------------------------------------------------------


def got(visitor: Visitor, name: str) -> Any:
    return visitor.ask("GET", f"/out/file?project=project.toml&name={name}")


def test_files_are_those_of_the_result_under_safe_names(tuned: Path) -> None:
    visitor = Visitor.inside(tuned)
    for name in ("result.json", "curves.json", "plant.toml", "report.html"):
        answer = got(visitor, name)
        assert answer.content == (tuned / "project-result" / name).read_bytes()
        assert answer.headers["content-disposition"].startswith(f'attachment; filename="project-{name}"')
    assert "shift.html" in got(visitor, "shift.html").headers["content-disposition"]


def test_the_parameters_as_csv(tuned: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(got(Visitor.inside(tuned), "parameters.csv").text)))
    element = result_json(tuned)["elements"][0]
    assert [row["parameter"] for row in rows] == [p["name"] for p in element["parameters"]]
    for row, p in zip(rows, element["parameters"], strict=True):
        assert float(row["plant"]) == p["plant"] and float(row["low"]) == p["ci"][0]
        assert float(row["std_error"]) == p["std_error"] and row["changed"] == str(p["changed"])


def test_the_settings_as_csv(tuned: Path) -> None:
    rows = list(csv.DictReader(io.StringIO(got(Visitor.inside(tuned), "settings.csv").text)))
    loop = result_json(tuned)["controllers"][0]
    chosen = next(p for p in loop["proposals"] if p["method"] == loop["recommended"])["settings"]
    assert {row["key"]: float(row["new"]) for row in rows} == {
        key: value for key, value in chosen.items() if isinstance(value, int | float)
    }


@pytest.mark.parametrize("name", ["", "../project.toml", "project.toml", "record.csv", "/etc/passwd", "result.json\0"])
def test_other_files_are_not_given(tuned: Path, name: str) -> None:
    from urllib.parse import quote

    assert got(Visitor.inside(tuned), quote(name)).status == 404


@pytest.mark.parametrize(
    ("given", "safe"),
    [
        ("plain.csv", "plain.csv"),
        ("../../etc/passwd", "_.._etc_passwd"),
        ('a"b\r\nSet-Cookie: x.csv', "a_b__Set-Cookie_ x.csv"),
        (".hidden", "hidden"),
        ("...", "file"),
        ("Ofen 3 – Süd.toml", "Ofen 3 – Süd.toml"),
        ("a" * 300 + ".json", "a" * 100 + ".json"),
        ("con:aux|nul.csv", "con_aux_nul.csv"),
    ],
)
def test_names_of_files_are_safe_anywhere(given: str, safe: str) -> None:
    assert safe_name(given) == safe
    header = download("x", given).headers["content-disposition"]
    assert header.isascii() and header.count('"') == 2 and "\n" not in header and "\r" not in header


def test_a_sheet_program_runs_nothing() -> None:
    lines = as_csv(["name", "value"], [["=cmd|' /c calc'!A0", -1.5], ["@x", None], ["+1", True]]).splitlines()
    assert lines == ["name,value", "'=cmd|' /c calc'!A0,-1.5", "'@x,", "'+1,True"]


def test_report_and_sheet_are_cut_off_from_the_app(tuned: Path) -> None:
    visitor = Visitor.inside(tuned)
    for page in ("report", "shift"):
        answer = visitor.ask("GET", f"/out/{page}?project=project.toml")
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("sandbox ") and "allow-same-origin" not in policy and "script-src" not in policy
        assert "Content-Security-Policy" in answer.text  # of its own
    assert result_json(tuned)["shift"] in words(visitor.ask("GET", "/out/shift?project=project.toml").text)


def test_a_report_that_was_not_written_is_drawn(tuned: Path) -> None:
    before = (tuned / "project-result" / "report.html").read_bytes()
    (tuned / "project-result" / "report.html").unlink()
    answer = Visitor.inside(tuned).ask("GET", "/out/report?project=project.toml")
    assert answer.status == 200 and len(answer.content) > len(before) / 2


def test_a_refusal_has_no_plant_and_says_so(tmp_path: Path) -> None:
    with_result(tmp_path, STILL, 3)
    visitor = Visitor.inside(tmp_path)
    page = visitor.ask("GET", PAGE).text
    assert "plant.toml</th>" not in page and "no settings can be found for it" in words(page)
    assert got(visitor, "plant.toml").status == 404
    said = visitor.ask("GET", "/api/out/acceptable?project=project.toml").json()
    assert said["state"] == "refused" and "is a refusal" in said["message"]


def test_commands_stand_on_the_page_and_work(tuned: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = words(Visitor.inside(tuned).ask("GET", PAGE).text)
    monkeypatch.chdir(tuned)
    for line in (
        "report project-result",
        "report project-result --shift",
        "bundle project.toml --out project-bundle.zip",
    ):
        assert f"trueplant {line}" in said
        assert main(line.split()) == 0
    assert "trueplant accept project-result --project project.toml" in said and "trueplant run project.toml" in said


# -- accept --------------------------------------------------------------------------------------------------------


def test_accepting_writes_what_the_command_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = with_result(tmp_path / "ours"), with_result(tmp_path / "theirs")
    monkeypatch.chdir(theirs)
    assert main(["accept", "project-result", "--project", "project.toml"]) == 0
    visitor = Visitor.inside(ours)
    ready = visitor.ask("GET", "/api/out/acceptable?project=project.toml").json()
    assert ready == {"state": "ready", "message": "", "changes": ["u → y"], "kept": [], "doubts": []}
    answer = visitor.post("/api/out/accept?project=project.toml", {})
    assert answer.status == 200 and "the model is now the plant for 1 element (u -> y)" in answer.json()["said"][0]
    for name in ("project.toml", "project.toml.bak"):
        assert (ours / name).read_bytes() == (theirs / name).read_bytes()
    assert visitor.post("/api/project/undo?project=project.toml", {}).status == 200
    assert (ours / "project.toml").read_text() == CHANGED


def test_accepting_what_has_changed_needs_a_yes(tmp_path: Path) -> None:
    with_result(tmp_path)
    (tmp_path / "project.toml").write_text(f"{CHANGED}\n# a word\n")
    visitor = Visitor.inside(tmp_path)
    state = visitor.ask("GET", "/api/out/acceptable?project=project.toml").json()
    assert state["state"] == "changed" and "project.toml has changed" in state["message"]
    refused = visitor.post("/api/out/accept?project=project.toml", {})
    assert refused.status == 422 and "project.toml has changed" in refused.json()["error"]
    assert not (tmp_path / "project.toml.bak").exists()
    assert visitor.post("/api/out/accept?project=project.toml", {"force": True}).status == 200
    assert 'tf = "2.6' in (tmp_path / "project.toml").read_text()


def test_nothing_is_accepted_where_nothing_changed(tmp_path: Path) -> None:
    with_result(tmp_path, SAME)
    visitor = Visitor.inside(tmp_path)
    state = visitor.ask("GET", "/api/out/acceptable?project=project.toml").json()
    assert state["state"] == "refused" and "nothing has changed or was found" in state["message"]
    assert visitor.post("/api/out/accept?project=project.toml", {"force": True}).status == 422
    assert (tmp_path / "project.toml").read_text() == SAME


# -- bundle --------------------------------------------------------------------------------------------------------


def test_the_bundle_is_that_of_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_result(tmp_path)
    visitor = Visitor.inside(tmp_path)
    assert visitor.ask("GET", "/out/bundle?project=project.toml").status == 404
    assert visitor.post("/api/out/bundle?project=project.toml", {}).json()["state"] == "running"
    told = settled(visitor, "/api/out/bundle-state?project=project.toml")
    assert told["state"] == "done", told
    content = visitor.ask("GET", "/out/bundle?project=project.toml").content
    assert zipfile.ZipFile(io.BytesIO(content)).namelist() == told["files"]
    monkeypatch.chdir(tmp_path)
    assert main(["bundle", "project.toml", "--out", "again.zip"]) == 0
    assert Path("again.zip").read_bytes() == content
    visitor.post("/api/out/bundle?project=project.toml", {})
    second = settled(visitor, "/api/out/bundle-state?project=project.toml")
    assert (
        second["state"] == "failed" and "is there already" in second["error"] and str(tmp_path) not in second["error"]
    )
    visitor.post("/api/out/bundle?project=project.toml", {"replace": True})
    assert settled(visitor, "/api/out/bundle-state?project=project.toml")["state"] == "done"


def test_page_before_a_run(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(CHANGED)
    answer = Visitor.inside(tmp_path).ask("GET", PAGE)
    assert answer.status == 200 and "Run the analysis first." in words(answer.text)
