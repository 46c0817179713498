"""PI Web API over TLS: pages, states that are no values, a server that is busy, slow or gone, and who is trusted."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from support import historians
from trueplant import connect
from trueplant.cli import main
from trueplant.connect import levels
from trueplant.connect.pi import _number, _pause, _word
from trueplant.errors import SourceError
from trueplant.project import Project

EXPECTED = historians.events().sort("tag", "time")


@pytest.fixture
def served(serve, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(levels, "PAUSE", 0.001)
    return serve("pi", historians.events())


def fetched(folder: Path, source: dict[str, Any]) -> pl.DataFrame:
    connect.fetch(Project.load(historians.written(folder, source)), refresh=True)
    return pl.read_parquet(folder / "project-snapshot.parquet")


@pytest.mark.parametrize("page", [2, 1000, 3000, 3001, 3002, 150_000])
def test_pages_overlap_and_lose_nothing(served, tmp_path: Path, page: int):
    if page == 2:  # half of all requests: only an hour of it
        served.more.items = {tag: items[:40] for tag, items in served.more.items.items()}
        served.more.stamps = {tag: stamps[:40] for tag, stamps in served.more.stamps.items()}
    found = fetched(tmp_path, served.source | {"page": page})
    expected = EXPECTED.filter(pl.col("time").cum_count().over("tag") <= (40 if page == 2 else 5000))
    assert found.drop("quality").equals(expected)
    assert all("maxCount=" in request for request in served.more.requests if "/recorded" in request)


def test_more_events_on_one_stamp_than_a_page_is_an_error(served, tmp_path: Path):
    items = served.more.items["pv1"]
    served.more.items["pv1"] = items[:10] + [items[10]] * 5 + items[11:]
    served.more.stamps["pv1"] = [item["Timestamp"] for item in served.more.items["pv1"]]
    with pytest.raises(SourceError, match="3 or more events of pv1"):
        fetched(tmp_path, served.source | {"page": 3})


def test_a_busy_server_is_asked_again_when_it_says(served, tmp_path: Path):
    served.more.before = lambda number: (503, {"Retry-After": "0"}) if number % 3 == 0 else None
    assert fetched(tmp_path, served.source).drop("quality").equals(EXPECTED)
    served.more.before = lambda number: (429, {}) if number % 4 == 0 else None
    assert fetched(tmp_path, served.source).drop("quality").equals(EXPECTED)


def test_a_server_that_stays_busy_leaves_nothing(served, tmp_path: Path, capsys):
    before = historians.leaves(tmp_path) | {"project.toml"}
    historians.written(tmp_path, served.source)
    served.more.before = lambda number: (503, {}) if number > 8 else None
    assert main(["run", "project.toml"]) == 4
    assert "HTTP 503" in capsys.readouterr().err
    assert historians.leaves(tmp_path) == before


def test_a_server_that_hangs_up_is_connected_to_again(served, tmp_path: Path):
    def hang_up(number: int) -> None:
        if number in (9, 10, 15):
            raise ConnectionError

    served.more.before = hang_up
    assert fetched(tmp_path, served.source).drop("quality").equals(EXPECTED)


def test_a_slow_server_is_waited_for_and_a_dead_one_is_not(served, tmp_path: Path):
    served.more.before = lambda number: time.sleep(0.02)
    assert fetched(tmp_path, served.source).drop("quality").equals(EXPECTED)
    served.more.before = lambda number: time.sleep(1.0)
    with pytest.raises(SourceError, match=r"does not answer \(TimeoutError"):
        fetched(tmp_path, served.source | {"timeout": 0.1})


def test_a_server_that_is_gone_in_the_middle_leaves_nothing(served, tmp_path: Path, capsys):
    before = historians.leaves(tmp_path) | {"project.toml"}
    historians.written(tmp_path, served.source)

    def die(number: int) -> None:
        if number > 12:
            raise ConnectionError

    served.more.before = die
    assert main(["run", "project.toml"]) == 4
    err = capsys.readouterr().err
    assert "does not answer" in err and err.count("\n") == 1
    assert historians.leaves(tmp_path) == before


def test_only_a_trusted_server_is_spoken_to(served, tmp_path: Path):
    with pytest.raises(SourceError, match=r"is not trusted .*data\.source\.ca"):
        fetched(tmp_path, {key: value for key, value in served.source.items() if key != "ca"})
    assert served.more.requests == []
    (tmp_path / "wrong.pem").write_text("no certificate")
    with pytest.raises(Exception, match="holds no certificate in PEM form"):
        fetched(tmp_path, served.source | {"ca": "wrong.pem"})


def test_a_wrong_password_is_said_once_and_not_shown(served, tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setenv("TRUEPLANT_TEST_PI", "wr0ng-secret")
    historians.written(tmp_path, served.source)
    assert main(["fetch", "project.toml"]) == 4
    err = capsys.readouterr().err
    assert "HTTP 401" in err and "wr0ng" not in err and len(served.more.requests) == 1


def test_a_token(served, tmp_path: Path):
    served.more.authorization = "Bearer t0ken"
    (tmp_path / "token").write_text("t0ken\n")
    keys = ("kind", "url", "server", "ca")
    source = {key: served.source[key] for key in keys} | {"auth": "bearer", "token_file": "token"}
    assert fetched(tmp_path, source).drop("quality").equals(EXPECTED)


def test_redirections_are_not_followed(served, tmp_path: Path):
    served.more.before = lambda number: (302, {"Location": "https://127.0.0.1:1/elsewhere"})
    with pytest.raises(SourceError, match="HTTP 302"):
        fetched(tmp_path, served.source)


@pytest.mark.parametrize(
    ("item", "value", "word"),
    [
        ({"Value": 1.5, "Good": True}, 1.5, "good"),
        ({"Value": 1.5, "Good": True, "Questionable": True}, 1.5, "uncertain"),
        ({"Value": 1.5, "Good": False}, 1.5, "bad"),
        ({"Value": {"Name": "AUTO", "Value": 1, "IsSystem": False}, "Good": True}, 1.0, "good"),
        ({"Value": {"Name": "No Data", "Value": 248, "IsSystem": True}, "Good": True}, None, "bad"),
        ({"Value": 1.5, "Good": True, "Errors": [{"FieldName": "Value", "Message": ["no"]}]}, 1.5, "bad"),
        ({"Value": "text", "Good": True}, None, "bad"),
        ({"Value": None, "Good": True}, None, "bad"),
        ({"Value": 1.5}, 1.5, "bad"),
    ],
)
def test_what_counts_as_a_value(item: dict[str, Any], value: float | None, word: str):
    number = _number(item["Value"])
    assert (number, _word(item, number)) == (value, word)


def test_how_long_a_server_wants_us_to_wait():
    assert (_pause("7"), _pause(""), _pause("soon")) == (7.0, 0.0, 0.0)
    assert _pause("Wed, 21 Oct 2015 07:28:00 GMT") < 0
