"""Two results, a track and a site's audit: the pages say what the saved files say."""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from app.asking import Visitor
from app.results import CHANGED, SAME, STILL, UNSAFE, with_result, words
from support.pages import Page
from trueplant.app.audited import audit_loops, audits
from trueplant.app.folder import Folder
from trueplant.cli import main
from trueplant.detect.beside import compare_results
from trueplant.fleet.page import headline
from trueplant.fleet.rank import Ranked, ranked, table
from trueplant.fleet.row import ElementRow, Finding, LoopRow, Outcome
from trueplant.output import read_results
from trueplant.result import ElementVerdict


@pytest.fixture
def two(tmp_path: Path) -> Path:
    with_result(tmp_path / "before", SAME)
    with_result(tmp_path / "after", CHANGED)
    return tmp_path


BOTH = "first=before/project-result&second=after/project-result"


def test_two_results_are_compared_as_by_the_command(
    two: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    visitor = Visitor.inside(two)
    text = visitor.ask("GET", f"/compare?{BOTH}").text
    found = compare_results(*(read_results(two / name / "project-result") for name in ("before", "after")))
    assert Page(text).by_id("found") == found.headline.replace("->", "→")
    gain = found.elements[0].parameters[0]
    assert gain.differs and f"▲ beyond chance {gain.difference:.3f}" in words(text)
    assert "unchanged, then changed" in words(text) and not UNSAFE.search(text)
    monkeypatch.chdir(two)
    assert main(["compare", "before/project-result", "after/project-result", "--json"]) == 0
    assert visitor.ask("GET", f"/compare/file?{BOTH}").json() == json.loads(capsys.readouterr().out)
    assert "trueplant compare before/project-result after/project-result" in words(text)


def test_all_saved_results_can_be_chosen(two: Path) -> None:
    page = Page(Visitor.inside(two).ask("GET", "/compare").text)
    values = [a["value"] for a, _ in page.all("option") if a["value"]]
    assert sorted(values) == sorted(["before/project-result", "after/project-result"] * 2)


def test_one_result_is_not_enough(tmp_path: Path) -> None:
    with_result(tmp_path)
    assert "two are needed" in words(Visitor.inside(tmp_path).ask("GET", "/compare").text)


@pytest.mark.parametrize("named", ["nowhere", "../before", "/etc"])
def test_results_elsewhere_are_not_compared(two: Path, named: str) -> None:
    answer = Visitor.inside(two).ask("GET", f"/compare?first=before/project-result&second={named}")
    assert answer.status == 404 and "message" in answer.text


# -- track ---------------------------------------------------------------------------------------------------------


def settled(visitor: Visitor) -> dict[str, Any]:
    for _ in range(900):
        told: dict[str, Any] = visitor.ask("GET", "/api/track/state?project=project.toml").json()
        if told["state"] != "running":
            return told
        time.sleep(0.1)
    raise AssertionError(f"it does not end: {told}")


def test_a_track_is_that_of_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_result(tmp_path)
    visitor = Visitor.inside(tmp_path)
    assert visitor.ask("GET", "/track/page?project=project.toml").status == 404
    assert visitor.post("/api/track/start?project=project.toml", {"precision": 10}).json()["state"] == "running"
    assert visitor.post("/api/track/start?project=project.toml", {"precision": 10}).status == 422
    told = settled(visitor)
    assert told["state"] == "done", told
    text = visitor.ask("GET", "/track?project=project.toml").text
    saved = json.loads((tmp_path / "project-track" / "track.json").read_text())
    assert Page(text).by_id("headline") == told["headline"].replace("->", "→")
    for element in saved["elements"]:
        assert f"{element['input']} → {element['output']}" in words(text)
    assert not UNSAFE.search(text)
    assert (
        visitor.ask("GET", "/track/page?project=project.toml").headers["content-security-policy"].startswith("sandbox")
    )
    monkeypatch.chdir(tmp_path)
    assert main(["track", "project.toml", "--out", "again"]) in (0, 3)
    again = json.loads(Path("again/track.json").read_text())
    assert {**again, "provenance": None} == {**saved, "provenance": None}


@pytest.mark.parametrize("precision", [0, -1, 101, "ten", None])
def test_a_precision_is_a_percentage(tmp_path: Path, precision: object) -> None:
    with_result(tmp_path)
    answer = Visitor.inside(tmp_path).post("/api/track/start?project=project.toml", {"precision": precision})
    assert answer.status == 400 and "percent" in answer.json()["error"]


def test_a_track_can_be_cancelled(tmp_path: Path) -> None:
    with_result(tmp_path)
    visitor = Visitor.inside(tmp_path)
    visitor.post("/api/track/start?project=project.toml", {"precision": 10})
    assert visitor.post("/api/track/cancel?project=project.toml", {}).json()["state"] == "cancelled"
    assert not (tmp_path / "project-track" / "track.json").exists()


# -- audit ---------------------------------------------------------------------------------------------------------


def row(key: str, **said: Any) -> LoopRow:
    return LoopRow(key, said.pop("outcome", Outcome.ANALYSED), "0", 1.0, None, 600.0, **said)


def element(verdict: ElementVerdict, importance: float | None = None) -> ElementRow:
    return ElementRow("y", "u", verdict, "A", importance, "loop", "gain +30 %", 0.001, 0.1)


def site(folder: Path) -> Sequence[Ranked]:
    """An audit of four loops; the first has its result in the folder."""
    with_result(folder / "units", CHANGED)
    changed = row("k1", elements=(element(ElementVerdict.CHANGED, 0.4),), findings=(Finding.PLANT,), action="retune")
    loops = ranked(
        [
            Ranked("FC4", "units/gone.toml", row("k4", elements=(element(ElementVerdict.UNCHANGED),))),
            Ranked(
                "FC3", "units/bad.toml", row("k3", outcome=Outcome.FAILED, text="units/bad.toml: is not valid TOML")
            ),
            Ranked("FC2", "units/project.toml", row("k2", outcome=Outcome.REFUSED, text="no set-point <b>changes</b>")),
            Ranked("FC1", "units/project.toml", changed, {("y", "u"): "2026-10-05T01-00-00Z"}),
        ]
    )
    run = folder / "audit" / "run=2026-11-01T02-00-00Z"
    run.mkdir(parents=True)
    table("Works", loops).write_parquet(run / "audit.parquet")
    (folder / "audit" / "results").mkdir()
    (folder / "units" / "project-result").rename(folder / "audit" / "results" / "k1")
    return loops


def test_an_audit_is_shown_as_it_was_ranked(tmp_path: Path) -> None:
    loops = site(tmp_path)
    folder = Folder(tmp_path)
    assert [(one.site, one.when) for one in audits(folder)] == [("audit", "2026-11-01 02:00 UTC")]
    said, lines = audit_loops(folder, "audit/run=2026-11-01T02-00-00Z")
    assert said == headline(loops)
    assert [(x.name, x.kind) for x in lines] == [(x.name, x.verdict) for x in loops]
    assert [x.name for x in lines] == ["FC1", "FC3", "FC2", "FC4"]
    first = lines[0]
    assert (first.matters, first.since, first.action, first.grade) == ("0.4", "2026-10-05", "retune", "A")
    assert (first.project, first.result) == ("units/project.toml", "audit/results/k1")
    assert [x.project for x in lines[1:]] == ["", "units/project.toml", ""]


def test_an_audit_leads_into_each_loop(tmp_path: Path) -> None:
    site(tmp_path)
    visitor = Visitor.inside(tmp_path)
    text = visitor.ask("GET", "/audit").text
    page = Page(text)
    rows = [text for a, text in page.all("tr") if "data-kind" in a]
    assert len(rows) == 4 and "plant changed" in rows[0] and "is not valid TOML" in rows[1]
    assert "<b>" not in text and not UNSAFE.search(text)
    link = next(a["href"] for a, said in page.all("a") if said == "FC1")
    assert link == "/verdict?project=units%2Fproject.toml&result=audit%2Fresults%2Fk1"
    verdict = visitor.ask("GET", link)
    assert verdict.status == 200 and read_results(tmp_path / "audit/results/k1").shift in words(verdict.text)
    asked = f"/api{link.replace('?', '/element?')}&output=y&input=u"
    assert visitor.ask("GET", asked).status == 200
    ranking = list(csv.reader(io.StringIO(visitor.ask("GET", "/audit/file?audit=audit/run=2026-11-01T02-00-00Z").text)))
    assert [line[1] for line in ranking] == ["loop", "FC1", "FC3", "FC2", "FC4"]


def test_without_an_audit_the_way_to_one_is_said(tmp_path: Path) -> None:
    assert "trueplant audit SITE.toml" in words(Visitor.inside(tmp_path).ask("GET", "/audit").text)
    assert Visitor.inside(tmp_path).ask("GET", "/audit?audit=../x").status == 404


def test_a_table_that_is_no_audit_is_one_message(tmp_path: Path) -> None:
    run = tmp_path / "audit" / "run=2026-11-01T02-00-00Z"
    run.mkdir(parents=True)
    (run / "audit.parquet").write_bytes(b"PAR1 no")
    answer = Visitor.inside(tmp_path).ask("GET", "/audit")
    assert answer.status == 422 and "cannot be read" in answer.text and str(tmp_path) not in answer.text


@pytest.mark.slow
def test_a_real_audit_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_result(tmp_path / "one", CHANGED)
    with_result(tmp_path / "two", STILL, 3)
    (tmp_path / "site.toml").write_text(
        'name = "Works"\n[[loops]]\nprojects = "*/project.toml"\n[audit]\nworkers = 0\n'
    )
    monkeypatch.chdir(tmp_path)
    assert main(["audit", "site.toml", "--out", "audit"]) == 0
    folder = Folder(tmp_path)
    _, lines = audit_loops(folder, audits(folder)[0].name)
    assert len(lines) == 2 and lines[0].kind == "plant changed"
    assert all(x.project and x.result for x in lines)
