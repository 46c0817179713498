"""The run screen: what the data are good for, an analysis by one button, and the same numbers as the command line's."""

from __future__ import annotations

import asyncio
import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from app.asking import PORT, Visitor
from app.results import CHANGED, STILL, result_json, with_result, words
from trueplant.app.checked import told_check
from trueplant.app.command_lines import run_line, track_line
from trueplant.app.folder import Folder
from trueplant.cli import main
from trueplant.project import Project
from trueplant.study.check import check

PAGE = "/run?project=project.toml"


def numbers(document: dict[str, Any]) -> dict[str, Any]:
    """Of a result.json: all but where and by which version it was made."""
    return {key: value for key, value in document.items() if key not in ("provenance", "files")}


def follow(visitor: Visitor, job: str) -> list[dict[str, Any]]:
    """All that the page is told of a job, until it ends; the page stays open."""
    path, query = "/api/run/events", f"project=project.toml&id={job}"
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        await asyncio.Event().wait()
        raise AssertionError

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "asgi": {"version": "3.0", "spec_version": "2.3"},
        "http_version": "1.1",
        "method": "GET",
        "scheme": "http",
        "path": path,
        "raw_path": path.encode(),
        "root_path": "",
        "query_string": query.encode(),
        "headers": [(name.encode(), value.encode()) for name, value in visitor.headers("GET").items()],
        "client": ("127.0.0.1", 50000),
        "server": ("127.0.0.1", PORT),
    }
    asyncio.run(asyncio.wait_for(visitor.app(scope, receive, send), 120))
    assert sent[0]["status"] == 200
    assert dict(sent[0]["headers"])[b"content-type"].startswith(b"text/event-stream")
    lines = [line for line in b"".join(one.get("body", b"") for one in sent).decode().split("\n\n") if line]
    assert all(line.startswith("data: ") for line in lines)
    return [json.loads(line.removeprefix("data: ")) for line in lines]


@pytest.fixture
def visitor(tmp_path: Path) -> Any:
    with_result(tmp_path)
    found = Visitor.inside(tmp_path)
    yield found
    found.app.state.jobs.close()
    if hasattr(found.app.state, "trends"):
        found.app.state.trends.aside.close()


@pytest.mark.slow
def test_a_run_gives_what_the_command_gives(visitor: Visitor, tmp_path: Path) -> None:
    before = result_json(tmp_path)
    (tmp_path / "project-result" / "result.json").unlink()
    for name in ("report.html", "plant.toml", "curves.json"):
        (tmp_path / "project-result" / name).unlink()
    job = visitor.post("/api/run/start?project=project.toml", {}).json()
    assert job["state"] == "waiting" and job["finished"] is False
    again = visitor.post("/api/run/start?project=project.toml", {})
    assert again.status == 422 and "is running already" in again.json()["error"]
    assert job["id"] in visitor.ask("GET", PAGE).text  # who comes back sees it
    told = follow(visitor, job["id"])
    assert told[-1]["state"] == "done" and told[-1]["headline"] == before["headline"]
    names = [stage["name"] for stage in told[-1]["stages"]]
    assert "estimating y" in names and names[-1] == "writing the files"
    assert numbers(result_json(tmp_path)) == numbers(before)
    assert told[-1]["id"] in visitor.ask("GET", PAGE).text
    second = visitor.post("/api/run/start?project=project.toml", {}).json()
    assert any(one["left"] is not None for one in follow(visitor, second["id"]))


def test_a_run_that_is_cancelled_leaves_what_was_there(visitor: Visitor, tmp_path: Path) -> None:
    files = {path.name: path.read_bytes() for path in (tmp_path / "project-result").iterdir()}
    job = visitor.post("/api/run/start?project=project.toml", {}).json()
    told = visitor.post("/api/run/cancel?project=project.toml", {"id": job["id"]}).json()
    assert told["state"] == "cancelled" and told["error"] == ""
    assert [one["state"] for one in follow(visitor, job["id"])] == ["cancelled"]
    assert {path.name: path.read_bytes() for path in (tmp_path / "project-result").iterdir()} == files


def test_jobs_are_told_to_the_pages_of_their_own_project(visitor: Visitor, tmp_path: Path) -> None:
    (tmp_path / "other.toml").write_text(CHANGED)
    job = visitor.post("/api/run/start?project=project.toml", {}).json()
    assert visitor.ask("GET", f"/api/run/events?project=other.toml&id={job['id']}").status == 404
    assert visitor.post("/api/run/cancel?project=other.toml", {"id": job["id"]}).status == 404
    assert visitor.ask("GET", "/api/run/events?project=project.toml&id=none").status == 404
    visitor.post("/api/run/cancel?project=project.toml", {"id": job["id"]})


def test_an_error_is_its_one_message(visitor: Visitor, tmp_path: Path) -> None:
    (tmp_path / "record.csv").unlink()
    job = visitor.post("/api/run/start?project=project.toml", {}).json()
    last = follow(visitor, job["id"])[-1]
    assert last["state"] == "failed" and "record.csv does not exist" in last["error"]
    assert str(tmp_path) not in last["error"]


def test_a_refusal_is_an_answer(tmp_path: Path) -> None:
    with_result(tmp_path, STILL, 3)
    visitor = Visitor.inside(tmp_path)
    job = visitor.post("/api/run/start?project=project.toml", {}).json()
    last = follow(visitor, job["id"])[-1]
    visitor.app.state.jobs.close()
    assert last["state"] == "refused" and last["headline"] == result_json(tmp_path)["headline"]


@pytest.mark.slow
def test_files_that_no_run_wrote_are_asked_for(visitor: Visitor, tmp_path: Path) -> None:
    assert 'id="blocked"' not in visitor.ask("GET", PAGE).text
    (tmp_path / "project-result" / "report.html").write_text("mine")
    page = visitor.ask("GET", PAGE).text
    assert "report.html is there already" in words(page) and 'id="force"' in page
    job = visitor.post("/api/run/start?project=project.toml", {}).json()
    assert follow(visitor, job["id"])[-1]["state"] == "failed"
    assert (tmp_path / "project-result" / "report.html").read_text() == "mine"
    job = visitor.post("/api/run/start?project=project.toml", {"force": True}).json()
    assert follow(visitor, job["id"])[-1]["state"] == "done"


def test_the_check_is_told_before_a_run(visitor: Visitor, tmp_path: Path) -> None:
    told = visitor.ask("GET", "/api/run/check?project=project.toml").json()
    assert told == json.loads(json.dumps(told_check(check(Project.load(tmp_path / "project.toml")))))
    assert told["usable"] is True and told["reasons"] == []
    assert told["records"][0]["said"].startswith("601 samples, 0 to 300 s")
    assert "sp moved" in told["records"][0]["moves"][0]
    (tmp_path / "record.csv").rename(tmp_path / "elsewhere.csv")
    said = visitor.ask("GET", "/api/run/check?project=project.toml").json()["error_said"]
    assert "record.csv does not exist" in said and str(tmp_path) not in said
    (tmp_path / "project.toml").write_text("time_unit = 1")
    said = visitor.ask("GET", "/api/run/check?project=project.toml").json()["error_said"]
    assert "project.toml" in said and str(tmp_path) not in said


def test_what_is_to_be_mended_names_its_screen(tmp_path: Path) -> None:
    with_result(tmp_path, STILL, 3)
    found = check(Project.load(tmp_path / "project.toml"))
    told = told_check(found)
    assert told["usable"] is False and told["headline"] == found.headline
    assert [(one["message"], one["screen"]) for one in told["reasons"]] == [("", "trends")]


def test_what_the_last_run_said_stands_there(visitor: Visitor, tmp_path: Path) -> None:
    assert result_json(tmp_path)["shift"] in words(visitor.ask("GET", PAGE).text)
    assert "trueplant run project.toml" in words(visitor.ask("GET", PAGE).text)


def test_commands_write_where_the_app_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    below = tmp_path / "unit 3"
    below.mkdir()
    (below / "my plant.toml").write_text(CHANGED)
    project = Folder(tmp_path).project("unit 3/my plant.toml")
    line = run_line(project)
    assert line == "trueplant run 'unit 3/my plant.toml' --out 'unit 3/my plant-result'"
    assert tmp_path / "unit 3/my plant-result" == project.out
    assert track_line(project, 5) == (
        "trueplant track 'unit 3/my plant.toml' --out 'unit 3/my plant-track' --precision 5"
    )
    (tmp_path / "plant.toml").write_text(CHANGED)
    assert run_line(Folder(tmp_path).project("plant.toml")) == "trueplant run plant.toml"
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "unit 3/my plant.toml", "--out", "unit 3/record.csv"]) == 0
    assert main(shlex.split(line)[1:]) == 0 and (project.out / "result.json").is_file()
