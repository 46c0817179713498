"""Servers that histories are read from, filled with the demo's record and started by the tests."""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from support import historians
from support.command import ENVIRONMENT

TESTS = Path(__file__).parents[1]
DEMANDED = os.environ.get("TRUEPLANT_TEST_SERVERS") == "1"
"""Then a server that cannot be started fails a test instead of skipping it."""


@dataclass
class Served:
    """A historian that runs, as a project names it."""

    source: dict[str, Any]
    variables: dict[str, str] = field(default_factory=dict)
    """Of the environment, for its secrets."""
    more: Any = None


def unavailable(reason: str) -> None:
    """Skip, or fail where servers are demanded."""
    if DEMANDED:
        pytest.fail(f"TRUEPLANT_TEST_SERVERS=1, but {reason}")
    pytest.skip(reason)


def imported(name: str) -> None:
    try:
        __import__(name)
    except ImportError:
        unavailable(f"{name} is not installed")


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


# -- files ----------------------------------------------------------------------------------------------------


def lake(folder: Path, events: pl.DataFrame) -> Served:
    """Partitioned by day and tag."""
    days = events.with_columns(pl.col("time").dt.strftime("%Y-%m-%d").alias("day"))
    for (day, tag), own in days.group_by("day", "tag"):
        place = folder / "lake" / f"day={day}" / f"tag={tag}"
        place.mkdir(parents=True, exist_ok=True)
        own.drop("day", "tag").write_parquet(place / "part.parquet")
    return Served({"kind": "parquet", "path": "lake/**/*.parquet", "hive": True})


def sqlite(folder: Path, events: pl.DataFrame) -> Served:
    quality = events["quality"].to_list() if "quality" in events.columns else ["good"] * events.height
    with sqlite3.connect(folder / "history.db") as database:
        database.execute("create table history (tag text, ts text, value real, quality text)")
        rows = zip(
            events["tag"], events["time"].dt.strftime("%Y-%m-%dT%H:%M:%S.%6fZ"), events["value"], quality, strict=True
        )
        database.executemany("insert into history values (?, ?, ?, ?)", rows)
    database.close()
    query = "select tag, ts, value, quality from history where tag in :tags and ts >= :from and ts < :to"
    return Served({"kind": "sqlite", "path": "history.db", "query": query})


# -- PostgreSQL -----------------------------------------------------------------------------------------------


def postgresql(server: Any, events: pl.DataFrame) -> Served:
    quality = events["quality"].to_list() if "quality" in events.columns else ["good"] * events.height
    server.psql("drop table if exists history; create table history (tag text, ts timestamptz, val numeric, q int);")
    codes = {"good": 192, "uncertain": 64, "bad": 0}
    stamps = events["time"].dt.strftime("%Y-%m-%d %H:%M:%S.%6f+00")
    rows = [
        f"('{tag}','{ts}',{'null' if value is None else value!r},{codes[word]})"
        for tag, ts, value, word in zip(events["tag"], stamps, events["value"], quality, strict=True)
    ]
    for first in range(0, len(rows), 5000):
        server.psql(f"insert into history values {','.join(rows[first : first + 5000])};")
    query = "select tag, ts, val::float8, q from history where tag = any(:tags) and ts >= :from and ts < :to"
    source = {"kind": "postgresql", "url_env": "TRUEPLANT_TEST_URL", "query": query, "quality": "opc"}
    return Served(source, {"TRUEPLANT_TEST_URL": server.get_uri()}, server)


# -- OPC UA ---------------------------------------------------------------------------------------------------


@contextmanager
def opcua_process(folder: Path, events: pl.DataFrame, **said: Any) -> Iterator[subprocess.Popen[str]]:
    """A server in a process of its own; it is there when this is entered."""
    place = folder / f"events-{said['port']}.parquet"
    events.write_parquet(place)
    environment = ENVIRONMENT | {"PYTHONPATH": f"{TESTS}{os.pathsep}{ENVIRONMENT['PYTHONPATH']}"}
    command = [sys.executable, "-m", "support.opcua_server", json.dumps({"events": str(place)} | said)]
    server = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None and server.stderr is not None
        if server.stdout.readline() != "ready\n":
            pytest.fail(f"the OPC UA server did not start: {server.stderr.read()}")
        yield server
    finally:
        server.kill()
        server.communicate()


@contextmanager
def opcua(folder: Path, events: pl.DataFrame, **said: Any) -> Iterator[Served]:
    imported("asyncua")
    port = said.pop("port", None) or free_port()
    with opcua_process(folder, events, port=port, **said) as server:
        source = {"kind": "opcua", "url": f"opc.tcp://127.0.0.1:{port}/", "tag": "ns=2;s={}", "page": 1000}
        yield Served(source, more=server)


# -- PI Web API -----------------------------------------------------------------------------------------------


@contextmanager
def pi(folder: Path, events: pl.DataFrame) -> Iterator[Served]:
    imported("cryptography")
    import base64

    from support import certificates
    from support.pi_server import PiServer

    own, key = certificates.make(folder, "pi", "urn:test:pi")
    pair = base64.b64encode(f"reader:{historians.SECRET}".encode()).decode()
    server = PiServer(events, certificates.serving(own, key), f"Basic {pair}")
    source = {
        "kind": "pi", "url": f"https://127.0.0.1:{server.port}/piwebapi", "server": "PISRV", "auth": "basic",
        "user": "reader", "password_env": "TRUEPLANT_TEST_PI", "ca": "pi.pem", "page": 700,
    }  # fmt: skip
    try:
        yield Served(source, {"TRUEPLANT_TEST_PI": historians.SECRET}, server)
    finally:
        server.close()
