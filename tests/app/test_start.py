"""The requests of the screen Start: files come into the folder, none is overwritten without asking."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from app.asking import Answer, Visitor
from app.plant_files import german_csv
from trueplant.app import levels
from trueplant.project import Project


@pytest.fixture
def visitor(tmp_path: Path) -> Visitor:
    return Visitor.inside(tmp_path)


def put(visitor: Visitor, name: str, content: bytes | Iterator[bytes], overwrite: bool = False) -> Answer:
    path = f"/api/start/upload?name={quote(name)}&overwrite={int(overwrite)}"
    return visitor.ask("PUT", path, content, {"content-type": "application/octet-stream"})


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_file_comes_in_pieces_and_stays_what_it_was(visitor: Visitor, tmp_path: Path) -> None:
    answer = put(visitor, "a b.csv", iter([b"t,pv", b"1,op1\n", b"1,2,3\n"]))
    assert answer.json() == {"data": "a b.csv", "bytes": 16}
    assert (tmp_path / "a b.csv").read_bytes() == b"t,pv1,op1\n1,2,3\n"
    assert put(visitor, "a b.csv", b"other").json() == {"exists": "a b.csv"}
    assert (tmp_path / "a b.csv").read_bytes().startswith(b"t,pv1")
    assert put(visitor, "a b.csv", b"other", overwrite=True).json()["bytes"] == 5
    assert (tmp_path / "a b.csv").read_bytes() == b"other"
    assert names(tmp_path) == ["a b.csv"]


@pytest.mark.parametrize(
    ("name", "status"),
    [("", 400), (".hidden.csv", 400), ("project.toml", 400), ("x.exe", 400), ("a\nb.csv", 400), ("..", 400)],
)
def test_names_that_are_not_taken(visitor: Visitor, tmp_path: Path, name: str, status: int) -> None:
    answer = put(visitor, name, b"x")
    assert answer.status == status and "error" in answer.json()
    assert names(tmp_path) == []


@pytest.mark.parametrize("name", ["../out.csv", "/etc/out.csv", "..\\..\\out.csv", "deep/er/out.csv"])
def test_a_file_never_leaves_the_folder(visitor: Visitor, tmp_path: Path, name: str) -> None:
    assert put(visitor, name, b"x,y\n").json()["data"] == "out.csv"
    assert names(tmp_path) == ["out.csv"] and not (tmp_path.parent / "out.csv").exists()


def test_a_link_out_of_the_folder_is_not_written_through(tmp_path: Path) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    (tmp_path / "other.csv").write_text("mine")
    (folder / "link.csv").symlink_to(tmp_path / "other.csv")
    assert put(Visitor.inside(folder), "link.csv", b"x", overwrite=True).status == 404
    assert (tmp_path / "other.csv").read_text() == "mine"


def test_a_file_that_is_too_long_leaves_nothing(
    visitor: Visitor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(levels, "UPLOAD", 1000)
    answer = put(visitor, "long.csv", iter([b"x" * 600, b"x" * 600]))
    assert answer.status == 413
    assert put(visitor, "long.csv", b"x" * 1200).status == 413
    assert put(visitor, "empty.csv", b"").status == 400
    assert names(tmp_path) == []


def test_a_file_is_looked_at_and_becomes_a_project(visitor: Visitor, tmp_path: Path) -> None:
    german_csv(tmp_path / "März export.csv")
    look = visitor.post("/api/start/look", {"data": "März export.csv", "time_zone": "Europe/Berlin"}).json()
    assert (look["project"], look["zone"], len(look["rows"])) == ("März export.toml", "Europe/Berlin", 12)
    given: dict[str, Any] = {"data": "März export.csv", "project": look["project"], "time_zone": "Europe/Berlin"}
    assert visitor.post("/api/start/make", given).json() == {"made": "März export.toml"}
    assert Project.load(tmp_path / "März export.toml").data.time_zone == "Europe/Berlin"
    assert visitor.post("/api/start/make", given).json() == {"exists": "März export.toml"}
    again = visitor.post("/api/start/look", {"data": "März export.csv"}).json()
    assert again["project"] == "März export-2.toml"
    assert visitor.post("/api/start/make", given | {"time_zone": "", "overwrite": True}).json() == {
        "made": "März export.toml"
    }
    assert Project.load(tmp_path / "März export.toml").data.time_zone is None
    undone = visitor.post("/api/project/undo?project=M%C3%A4rz%20export.toml", {})
    assert undone.status == 200 and Project.load(tmp_path / "März export.toml").data.time_zone == "Europe/Berlin"


@pytest.mark.parametrize(
    "given",
    [
        {"data": "../x.csv"},
        {"data": "none.csv"},
        {"data": ""},
        {"data": "words.csv"},
        {"data": "words.csv", "project": "x.exe"},
        {"data": "words.csv", "project": "../../x.toml"},
    ],
)
def test_what_cannot_be_read_is_one_message(visitor: Visitor, tmp_path: Path, given: dict[str, str]) -> None:
    (tmp_path / "words.csv").write_text("these are words\nand nothing else\n")
    for path in ("/api/start/look", "/api/start/make"):
        answer = visitor.post(path, given)
        assert answer.status in (400, 404, 422)
        message = answer.json()["error"]
        assert message and str(tmp_path) not in message
    assert names(tmp_path) == ["words.csv"]


def test_a_demo_is_written_into_the_folder_and_not_over_what_is_there(visitor: Visitor, tmp_path: Path) -> None:
    assert visitor.post("/api/start/demo", {"name": "splitter"}).json() == {"made": "demo-splitter/project.toml"}
    project = tmp_path / "demo-splitter" / "project.toml"
    assert Project.load(project).experiments[0].path.is_file()
    project.write_text(project.read_text() + "\n# mine\n")
    assert visitor.post("/api/start/demo", {"name": "splitter"}).status == 200
    assert project.read_text().endswith("# mine\n")
    (tmp_path / "demo-mill").mkdir()
    (tmp_path / "demo-mill" / "record.csv").write_text("mine")
    assert visitor.post("/api/start/demo", {"name": "mill"}).status == 422
    assert (tmp_path / "demo-mill" / "record.csv").read_text() == "mine"
    assert visitor.post("/api/start/demo", {"name": "../x"}).status == 400


def test_a_historian_is_written_without_a_secret(visitor: Visitor, tmp_path: Path) -> None:
    given = {
        "project": "hist.toml",
        "kind": "sqlite",
        "path": "hist.db",
        "query": "select tag, time, value from h where tag in (:tags) and time >= :from and time < :to",
        "from": "2026-10-01T00:00:00+02:00",
        "to": "2026-10-02T00:00:00+02:00",
        "time_unit": "min",
        "loops": [{"name": "fic1", "pv": "F1.PV", "op": "F1.OP"}],
    }
    assert visitor.post("/api/start/historian", given).json() == {"made": "hist.toml"}
    source = Project.load(tmp_path / "hist.toml").data.source
    assert source is not None and source.path == "hist.db"
    refused = visitor.post("/api/start/historian", given | {"project": "b.toml", "password_env": "secret word"})
    assert refused.status == 200  # a file has no password: the field is not of its kind
    assert "secret" not in (tmp_path / "b.toml").read_text()
    wrong = visitor.post(
        "/api/start/historian", given | {"project": "c.toml", "kind": "pi", "server": "S", "url": "http://x"}
    )
    assert wrong.status == 422 and "https://" in wrong.json()["error"]
    assert not (tmp_path / "c.toml").exists()


def test_the_page_lists_what_is_in_the_folder(visitor: Visitor, tmp_path: Path) -> None:
    german_csv(tmp_path / "a<b>.csv")
    visitor.post("/api/start/demo", {"name": "splitter"})
    text = visitor.ask("GET", "/start?data=a%3Cb%3E.csv").text
    assert "a&lt;b&gt;.csv" in text and "demo-splitter/project.toml" in text and "a<b>" not in text
    left = re.search(r'<script type="application/json" id="data">(.*?)</script>', text)
    assert left is not None and json.loads(left[1]) == {"chosen": "a<b>.csv"}
