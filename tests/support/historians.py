"""The record of the demo as the events of a historian, and projects that name one."""

from __future__ import annotations

import functools
import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import polars as pl

from trueplant.cli.analyse import demo_text
from trueplant.project import Project
from trueplant.project.simulation import as_file, simulate_record

START = datetime(2026, 10, 1, tzinfo=UTC)
END = START + timedelta(hours=6)
TAGS = ("pv1", "sp1", "pv2", "sp2", "op1", "op2")
SECRET = "s3cr3t!/päss"
"""What must be found nowhere. Its characters are written differently in a URL."""


@functools.cache
def record() -> bytes:
    """record.csv of the demo splitter: 300 minutes, a sample every 6 s."""
    return as_file(simulate_record(Project.from_toml(demo_text("splitter"))), "record.csv")


@functools.cache
def events() -> pl.DataFrame:
    """The same as events: tag, time, value."""
    wide = pl.read_csv(record())
    micro = (wide["t"] * 60e6).round().cast(pl.Int64)
    stamps = pl.select(pl.lit(START).dt.cast_time_unit("us") + pl.duration(microseconds=micro)).to_series()
    stamped = wide.drop("t").with_columns(stamps.alias("time"))
    long = stamped.unpivot(TAGS, index="time", variable_name="tag", value_name="value")
    return long.select("tag", "time", pl.col("value").cast(pl.Float64)).sort("time", "tag", maintain_order=True)


def at(stamp: datetime) -> str:
    return stamp.isoformat()


def project(source: dict[str, Any], start: datetime = START, end: datetime = END, data: str = "") -> str:
    """The demo's project file with a historian instead of its record."""
    from trueplant.project.document import to_toml

    text = demo_text("splitter")
    own = f"[data]\nfrom = {at(start)}\nto = {at(end)}\n{data}\n{to_toml({'data': {'source': source}})}\n"
    head, tail = text.split("[data]\n")
    tail = tail[tail.index("[[output]]") :]
    whole = head + own + tail
    assert tomllib.loads(whole)["data"]["source"] == source
    return whole


def written(folder: Path, source: dict[str, Any], **said: Any) -> Path:
    """That project in a folder."""
    place = folder / "project.toml"
    place.write_text(project(source, **said), encoding="utf-8")
    return place


def leaves(folder: Path) -> set[str]:
    """Names of all files in a folder."""
    return {path.name for path in folder.rglob("*") if path.is_file()}
