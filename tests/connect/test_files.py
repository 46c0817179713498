"""The lake and SQLite: what their files can hold, and that nothing is written to them."""

from __future__ import annotations

import sqlite3
from datetime import timedelta
from pathlib import Path

import polars as pl
import pytest

from support import historians
from trueplant import connect
from trueplant.cli import main
from trueplant.errors import DataError, ProjectError, SourceError
from trueplant.project import Project


def fetched(folder: Path, source: dict[str, object], **said) -> pl.DataFrame:
    connect.fetch(Project.load(historians.written(folder, source, **said)), refresh=True)
    return pl.read_parquet(folder / "project-snapshot.parquet")


EXPECTED = historians.events().sort("tag", "time")

# -- the lake -------------------------------------------------------------------------------------------------


def test_a_lake_with_other_names_and_a_local_clock(tmp_path: Path):
    local = historians.events().with_columns(
        pl.col("time").dt.convert_time_zone("Europe/Oslo").dt.replace_time_zone(None)
    )
    local.select(ts="time", name="tag", v="value", other=pl.lit(1)).write_parquet(tmp_path / "lake.parquet")
    source = {"kind": "parquet", "path": "lake.parquet", "columns": ["name", "ts", "v"], "time_zone": "Europe/Oslo"}
    assert fetched(tmp_path, source).drop("quality").equals(EXPECTED)
    with pytest.raises(DataError, match=r"set data\.source\.time_zone"):
        fetched(tmp_path, {key: value for key, value in source.items() if key != "time_zone"})
    with pytest.raises(DataError, match=r"has no column 'tag'.*It has: ts, name, v, other"):
        fetched(tmp_path, {key: value for key, value in source.items() if key != "columns"})


def test_codes_in_a_lake_need_a_meaning(tmp_path: Path):
    historians.events().with_columns(quality=pl.lit(0)).write_parquet(tmp_path / "lake.parquet")
    with pytest.raises(DataError, match=r"data\.source\.quality"):
        fetched(tmp_path, {"kind": "parquet", "path": "lake.parquet"})
    assert set(fetched(tmp_path, {"kind": "parquet", "path": "lake.parquet", "quality": "pi"})["quality"]) == {"good"}
    assert set(fetched(tmp_path, {"kind": "parquet", "path": "lake.parquet", "quality": "opc"})["quality"]) == {"bad"}


def test_a_lake_that_is_not_there_or_no_lake(tmp_path: Path):
    with pytest.raises(SourceError, match=r"correct data\.source\.path"):
        fetched(tmp_path, {"kind": "parquet", "path": "none/*.parquet"})
    (tmp_path / "lake.parquet").write_text("no lake")
    with pytest.raises(SourceError, match="cannot be read as Parquet"):
        fetched(tmp_path, {"kind": "parquet", "path": "lake.parquet"})


# -- SQLite ---------------------------------------------------------------------------------------------------

QUERY = "select tag, ts, value from history where tag in :tags and ts >= :from and ts < :to"
SQLITE = {"kind": "sqlite", "path": "history.db", "query": QUERY}


def database(folder: Path, stamps: pl.Expr, kind: str = "text") -> None:
    rows = historians.events().with_columns(stamps.alias("ts"))
    own = sqlite3.connect(folder / "history.db")
    own.execute(f"create table history (tag text, ts {kind}, value real)")
    own.executemany("insert into history values (?, ?, ?)", rows.select("tag", "ts", "value").rows())
    own.commit()
    own.close()


@pytest.mark.parametrize(
    ("form", "zone"),
    [("%Y-%m-%d %H:%M:%S", "UTC"), ("%Y-%m-%dT%H:%M:%S.%3f", "UTC"), ("%Y-%m-%dT%H:%M:%SZ", None)],
)
def test_sqlite_stamps_as_text(tmp_path: Path, form: str, zone: str | None):
    database(tmp_path, pl.col("time").dt.strftime(form))
    assert fetched(tmp_path, SQLITE | ({"time_zone": zone} if zone else {})).drop("quality").equals(EXPECTED)


def test_sqlite_stamps_of_a_local_clock(tmp_path: Path):
    database(tmp_path, pl.col("time").dt.convert_time_zone("America/New_York").dt.strftime("%Y-%m-%d %H:%M:%S"))
    assert fetched(tmp_path, SQLITE | {"time_zone": "America/New_York"}).drop("quality").equals(EXPECTED)


def test_sqlite_stamps_as_numbers(tmp_path: Path):
    database(tmp_path, pl.col("time").dt.epoch("ms"), "integer")
    query = "select tag, ts, value from history where tag in :tags and ts >= 1000 * :from_unix and ts < 1000 * :to_unix"
    assert fetched(tmp_path, SQLITE | {"query": query}).drop("quality").equals(EXPECTED)


def test_text_among_numbers_is_bad_and_kills_nothing(tmp_path: Path):
    database(tmp_path, pl.col("time").dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
    own = sqlite3.connect(tmp_path / "history.db")
    own.execute("update history set value = 'Bad Input' where tag = 'pv1' and ts like '%:05:00Z'")
    own.commit()
    own.close()
    found = fetched(tmp_path, SQLITE).filter(pl.col("tag") == "pv1")
    bad = found.filter(pl.col("quality") == "bad")
    assert found.height == 3001 and bad["value"].null_count() == bad.height == 5


def test_sqlite_is_only_read(tmp_path: Path):
    database(tmp_path, pl.col("time").dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
    before = (tmp_path / "history.db").read_bytes()
    for query in ("delete from history where tag in :tags and ts >= :from and ts < :to returning tag, ts, value",):
        with pytest.raises(ProjectError, match="historians are only read"):
            fetched(tmp_path, SQLITE | {"query": query})
    assert (tmp_path / "history.db").read_bytes() == before


def test_a_query_that_takes_for_ever_is_ended(tmp_path: Path):
    database(tmp_path, pl.col("time").dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
    query = (
        "with recursive n(k) as (select 1 union all select k + 1 from n) "
        "select tag, ts, value from history, n where tag in :tags and ts >= :from and ts < :to and k < 0"
    )
    with pytest.raises(SourceError, match=r"did not answer within 0\.5 s"):
        fetched(tmp_path, SQLITE | {"query": query, "timeout": 0.5})


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("select tag, ts, value from history", "has no :tags"),
        ("select tag, ts, value from history where tag in :tags and ts >= :from", "has no :to"),
        (QUERY.replace("value", "nope"), "no such column: nope"),
        (QUERY.replace("tag, ts, value", "tag, ts"), "gives 2 columns"),
    ],
)
def test_mistakes_in_a_query(tmp_path: Path, query: str, words: str):
    database(tmp_path, pl.col("time").dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
    with pytest.raises((ProjectError, DataError), match=words):
        fetched(tmp_path, SQLITE | {"query": query})


def test_what_is_no_database(tmp_path: Path, monkeypatch, capsys):
    (tmp_path / "history.db").write_bytes(b"no database at all, but long enough to be looked at" * 10)
    historians.written(tmp_path, SQLITE)
    monkeypatch.chdir(tmp_path)
    assert main(["fetch", "project.toml"]) == 4
    assert "cannot be read as an SQLite file" in capsys.readouterr().err
    (tmp_path / "history.db").unlink()
    assert main(["fetch", "project.toml"]) == 4
    assert "does not exist" in capsys.readouterr().err
    assert not (tmp_path / "history.db").exists()


def test_only_the_window_is_kept_though_more_is_asked_for(tmp_path: Path):
    database(tmp_path, pl.col("time").dt.strftime("%Y-%m-%dT%H:%M:%SZ"))
    end = historians.START + timedelta(minutes=30)
    found = fetched(tmp_path, SQLITE, end=end)
    assert found.drop("quality").equals(EXPECTED.filter(pl.col("time") < end))
